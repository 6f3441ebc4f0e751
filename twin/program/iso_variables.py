"""The variables of ISO programs: numbered and named parameters, system variables, expressions."""

from __future__ import annotations

import math

import numpy as np

from twin.program.expressions import FANUC, ISO, Expression, Null, WordError
from twin.program.flow import Flow
from twin.program.iso_frames import IsoFrames
from twin.program.state import INDEX, OTHER, ROTARY, State

_TOOL_TABLE = {10: ("length", True), 11: ("length", False), 12: ("radius", True), 13: ("radius", False)}
"""Tool data of a Fanuc from #10001, #11001, #12001 and #13001 on: the quantity, and whether it is its wear."""
_TOOLS_OTHERWISE = range(2001, 2801)
"""Tool tables with different numbers on Fanuc and Haas."""


class IsoVariables:
    """Values of variables and expressions."""

    def __init__(self, state: State, flow: Flow, frames: IsoFrames) -> None:
        self.state, self.flow, self.frames = state, flow, frames
        self.numbers: dict[int, float] = {}
        self.names: dict[str, float] = {}
        self.returned_value = (0.0, 0.0)
        self.home = {28: self.state.frame_table("G28"), 30: self.state.frame_table("G30")}

    def number_of(self, text: str, column: int) -> float:
        """The value of an expression."""
        expression = self.expression(text, 0, column)
        value = expression.whole()
        if isinstance(value, str):
            raise WordError("a number is needed here", column)
        return value

    def expression(self, text: str, at: int, column: int = 1) -> Expression:
        if not self.state.linuxcnc and ("AND" in text or "OR" in text):
            self.state.note("AND, OR, XOR work on the bits of whole numbers, as on a Fanuc; in .ngc files they are logical")
        return Expression(text, ISO if self.state.linuxcnc else FANUC, self._named, self._hash, at, column)

    def _named(self, expression: Expression, name: str, at: int) -> float:
        if name.startswith("EXISTS") and expression.peek() == "[":
            expression.at += 1
            if expression.peek() != "#":
                raise expression.fail("EXISTS[..] needs a parameter, e.g. EXISTS[#<depth>]")
            expression.at += 1
            key = self.key(expression)
            if expression.peek() != "]":
                raise expression.fail("bracket of EXISTS is not closed")
            expression.at += 1
            try:
                value = self._read(key, at)
                return float(self.state.linuxcnc or not isinstance(value, Null))
            except WordError:
                return 0.0
        raise expression.fail(f"'{name}' is not a value; a number, #variable or [expression] is needed", at)

    def key(self, expression: Expression) -> int | str:
        """The parameter after a #: its number or name."""
        if expression.peek() == "<":
            end = expression.text.find(">", expression.at)
            if end < 0:
                raise expression.fail("the name of a parameter is not closed with '>'")
            name = expression.text[expression.at + 1 : end].replace(" ", "")
            expression.at = end + 1
            return name
        at = expression.at
        number = expression.atom()
        if isinstance(number, str) or number != int(number) or number < 0:
            raise expression.fail("the number of a variable is a whole number from 0", at)
        return int(number)

    def _hash(self, expression: Expression, at: int) -> float:
        value = self._read(self.key(expression), expression.column + at)
        if self.state.reads is not None:
            self.state.reads.append(value)
        return value

    def _read(self, key: int | str, column: int) -> float:
        frame = self.flow.frame
        if isinstance(key, str):
            if key in frame.variables:
                return frame.variables[key]
            if key in self.names:
                return self.names[key]
            if (value := self._predefined(key)) is not None:
                return value
            if isinstance(given := self.state.given(f"#<{key.lower()}>"), float):
                return given
            raise WordError(
                f"parameter #<{key.lower()}> has no value; set it before, or give '#<{key.lower()}>' in the table [variables] of the machine file",
                column,
            )
        if key == 0:
            return Null(0.0)
        if key <= (30 if self.state.linuxcnc else 33):
            return frame.variables.get(key, Null(0.0))
        if (value := self._system_value(key)) is not None:
            return value
        if key in self.numbers:
            return self.numbers[key]
        if self.state.linuxcnc and key > 5602:
            raise WordError(f"parameter #{key} is out of range, 5602 is the last", column)
        if isinstance(given := self.state.given(f"#{key}"), float):
            return given
        if not self.state.linuxcnc and key >= 1000:
            raise WordError(
                f"system variable #{key} has no value here; set it in the program, or give '#{key}' in the table [variables] of the machine file",
                column,
            )
        return Null(0.0)

    def assign(self, name: str, value: float, column: int) -> None:
        """Not needed: ISO has no FOR."""
        raise NotImplementedError

    def write(self, key: int | str, value: float, column: int) -> None:
        frame = self.flow.frame
        if isinstance(key, str):
            if key.startswith(("_INI[", "_HAL[")) or (self._predefined(key) is not None and key not in frame.variables):
                raise WordError(f"#<{key.lower()}> belongs to the control; choose another name", column)
            (self.names if key.startswith("_") else frame.variables)[key] = value
        elif key == 0 or (self.state.linuxcnc and key > 5602):
            raise WordError(f"#{key} cannot be set", column)
        elif key == 3000 and not self.state.linuxcnc:
            raise WordError("the program stops itself with an alarm (#3000); correct what it asks for", column)
        elif key <= 33 if not self.state.linuxcnc else key <= 30:
            frame.variables[key] = value
        elif self.state.linuxcnc and (5420 <= key <= 5428 or 5400 <= key <= 5413):
            raise WordError(f"#{key} belongs to the control and cannot be set", column)
        elif not self.state.linuxcnc and key in _TOOLS_OTHERWISE:
            raise WordError(
                f"#{key} writes the tool table, which Fanuc and Haas number differently; use G10 L10 to L13, or #10001 to #13999", column
            )
        elif not self.state.linuxcnc and (tool := _of_tool(key)) is not None:
            name, (what, wear) = tool
            self.state.tools.set_value(name, what, value * self.state.unit, wear=wear)
        elif 5221 <= key <= 5390 and (n := (key - 5201) // 20) in self.frames.systems and 1 <= (k := (key - 5200) % 20) <= 10:
            self._write_system(n, k, value)
        else:
            self.numbers[key] = value

    def _write_system(self, n: int, k: int, value: float) -> None:
        """A zero offset by its parameter, #5221 and on."""
        if k == 10:
            self.frames.turned[n] = value
        elif 1 <= k <= 6 and (name := self.state.slot_of.get("XYZABC"[k - 1], "XYZABC"[k - 1])) in INDEX:
            self.frames.systems[n] = self.frames.systems[n].copy()
            self.frames.systems[n][INDEX[name]] = math.radians(value) if name in ROTARY else value * 1e-3
        elif value:
            raise WordError("an offset of B U V W cannot be set on this machine", 1)
        if n == self.frames.system:
            self.state.set_frames()

    def _own(self, values: np.ndarray, k: int) -> float:
        """Component k (1 to 9: X Y Z A B C U V W) in the unit of the program."""
        if not 1 <= k <= 9 or (name := self.state.slot_of.get("XYZABCUVW"[k - 1], "XYZABCUVW"[k - 1])) not in INDEX:
            return 0.0
        value = float(values[INDEX[name]])
        return math.degrees(value) if name in ROTARY else value / self.state.unit

    def _system_value(self, key: int) -> float | None:
        fanuc = not self.state.linuxcnc
        if 5420 <= key < 5429 or (fanuc and (5001 <= key <= 5006 or 5041 <= key <= 5046)):
            k = key - 5419 if key >= 5420 else key - (5000 if key < 5040 else 5040)
            name = self.state.slot_of.get("XYZABCUVW"[k - 1], "XYZABCUVW"[k - 1])
            if name in OTHER:
                return math.degrees(self.state.other_axes[name]) if name == "B" else self.state.other_axes[name] / self.state.unit
            return self._own(self.frames.place(), k)
        if self.state.linuxcnc and 5440 <= key < 5449:
            return self._own(np.array([*self.state.out.position[:3], *self.state.out.settle()]), key - 5439)
        if 5021 <= key <= 5029:
            return self._own(np.array(self.state.out.position), key - 5020)
        if key == 5210:
            return float(self.frames.shift_on)
        if 5211 <= key <= 5219:
            factor = self.state.unit / 1e-3 if key - 5210 not in (4, 5, 6) else 1.0  # stored in mm
            return self._own(self.frames.shift if self.frames.shift_on else self.frames.shift_kept, key - 5210) * factor + 0.0
        if key == 5220:
            return float(self.frames.system)
        if 5221 <= key <= 5390 and (n := (key - 5201) // 20) in self.frames.systems and 1 <= (k := (key - 5200) % 20) <= 10:
            if k == 10:
                return self.frames.turned[n]
            return self._own(self.frames.systems[n], k) * (self.state.unit / 1e-3 if k not in (4, 5, 6) else 1.0)
        if 5161 <= key <= 5169 or 5181 <= key <= 5189:
            base = 28 if key < 5180 else 30
            return self._own(self.home[base], key - (5160 if base == 28 else 5180)) * (self.state.unit / 1e-3)
        if fanuc and (tool := _of_tool(key)) is not None:
            name, (what, wear) = tool
            known = self.state.tools.value(name, what, wear=wear)
            return known / self.state.unit if known is not None else 0.0 if wear else None
        if fanuc and 4001 <= key <= 4120:
            return self._modal_value(key)
        if key == 5400 and self.state.linuxcnc:
            return float(self.state.tools.name) if self.state.tools.name.isdigit() else 0.0
        return None

    def _modal_value(self, key: int) -> float | None:
        """Values of #4001 to #4120 of a Fanuc: the active codes."""
        modes = self.state.out.modes
        values: dict[int, float] = {
            4001: float(self.state.motion or 0), 4002: float(self.state.plane), 4003: 90.0 + (not self.state.absolute), 4005: float(modes.feed_mode),
            4006: 21.0 if self.state.unit == 1e-3 else 20.0, 4007: 40.0 if self.state.comp is None else 41.0 if self.state.comp.offset > 0 else 42.0,
            4010: 98.0 + (not self.state.retract_to_start), 4014: 53.0 + self.frames.system if self.frames.system <= 6 else 54.1,
            4109: 0.0 if math.isnan(self.state.feed) else self.state.feed, 4119: modes.spindle, 4120: float(self.state.tools.name) if self.state.tools.name.isdigit() else 0.0,
        }  # fmt: skip
        return values.get(key)

    def _predefined(self, name: str) -> float | None:
        place = {"_X": 1, "_Y": 2, "_Z": 3, "_A": 4, "_B": 5, "_C": 6, "_U": 7, "_V": 8, "_W": 9}
        if name in place:
            return self._system_value(5419 + place[name])
        if name in ("_ABS_X", "_ABS_Y", "_ABS_Z", "_ABS_A", "_ABS_C"):
            return self._own(np.array(self.state.out.position), place[name[4:]])
        values = {
            "_VALUE": lambda: self.returned_value[0], "_VALUE_RETURNED": lambda: self.returned_value[1],
            "_LINE": lambda: float(self.state.line), "_METRIC": lambda: float(self.state.unit == 1e-3), "_IMPERIAL": lambda: float(self.state.unit != 1e-3),
            "_ABSOLUTE": lambda: float(self.state.absolute), "_INCREMENTAL": lambda: float(not self.state.absolute),
            "_FEED": lambda: 0.0 if math.isnan(self.state.feed) else self.state.feed, "_RPM": lambda: self.state.out.modes.spindle,
            "_CCOMP": lambda: float(self.state.comp is not None), "_PLANE": lambda: self.state.plane * 10.0, "_COORD_SYSTEM": lambda: _system_number(self.frames.system),
            "_TASK": lambda: 0.0, "_CURRENT_TOOL": lambda: float(self.state.tools.name) if self.state.tools.name.isdigit() else 0.0,
            "_CALL_LEVEL": lambda: float(len(self.flow.frames) - 1), "_REMAP_LEVEL": lambda: 0.0,
        }  # fmt: skip
        return values[name]() if name in values else None


def _of_tool(key: int) -> tuple[str, tuple[str, bool]] | None:
    """Tool and quantity of a variable of the tool table; None for another variable."""
    entry = _TOOL_TABLE.get(key // 1000)
    return None if entry is None or key % 1000 == 0 else (str(key % 1000), entry)


def _system_number(number: int) -> float:
    return 10.0 * (53 + number) if number <= 6 else 590.0 + number - 6
