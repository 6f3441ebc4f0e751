"""The variables of ISO programs: numbered and named parameters, system variables, expressions."""

import math
import re

import numpy as np

from twin.program.expressions import Expression, Null, WordError, as_number, no_value
from twin.program.flow import Flow
from twin.program.frames import INDEX, OTHER, ROTARY, Frame, rotation, shifted
from twin.program.state import State

_TOOL_TABLE = {10: ("length", True), 11: ("length", False), 12: ("radius", True), 13: ("radius", False)}
"""Tool data of a Fanuc from #10001, #11001, #12001 and #13001 on: the quantity, and whether it is its wear."""
_TOOLS_OTHERWISE = range(2001, 2801)
"""Tool tables with different numbers on Fanuc and Haas."""
_EXISTS = re.compile(r"EXISTS\s*\[\s*#")
LETTERS = "XYZABCUVW"


SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
"""Zero offsets in the order of G10 P and of the variables; additional ones are G54.1P1 and so on."""


class Offsets:
    """Zero offsets by name, the shifts of G92 and G52, and the reference points of G28 and G30."""

    def __init__(self, state: State) -> None:
        self.state = state
        self.systems: dict[str, np.ndarray] = {}
        self.turned: dict[str, float] = {}  # deg, by system
        self.shift_kept, self.shift_on = np.zeros(5), False  # G92 (LinuxCNC: also G52)
        self.local = np.zeros(5)  # G52 of Fanuc
        self.reference = {28: state.frame_table("G28"), 30: state.frame_table("G30")}
        self.choose("G54")

    @property
    def shift(self) -> np.ndarray:
        """The shift of G92 in force (5,)."""
        return self.shift_kept if self.shift_on else np.zeros(5)

    def choose(self, name: str) -> None:
        """Select a zero offset."""
        self.system = name
        self.set_frames()

    def of(self, name: str) -> np.ndarray:
        """A zero offset (5,), of the program or the machine file."""
        return self.systems[name] if name in self.systems else self.state.frame_table(name)

    def set_frames(self) -> None:
        """The zero offset in force with its rotation, G92 and G52."""
        system = Frame(rotation(2, self.turned.get(self.system, 0.0)), self.of(self.system))
        self.state.set_frames(system=system, shift=shifted(self.shift), local=shifted(self.local.copy()))


class IsoValues:
    """Parameters: #1 to #33 (LinuxCNC: #30) and names belong to one program, the others to all."""

    def __init__(self, state: State, flow: Flow) -> None:
        self.state, self.flow = state, flow
        self.offsets, self.fanuc = Offsets(state), not state.linuxcnc
        self.numbers: dict[int, float] = {}
        self.names: dict[str, float] = {}
        self.returned_value = (0.0, 0.0)

    def variable(self, e: Expression, name: str, at: int) -> float:
        """EXISTS[#..]; other names are none."""
        match = _EXISTS.match(e.text, at)
        if match is None:
            text = f"'{name}' is not a value; a number, #variable or [expression] is needed"
            raise e.fail("EXISTS[..] needs a parameter, e.g. EXISTS[#<depth>]" if name.startswith("EXISTS") else text, at)
        e.at = match.end()
        key = self.key(e)
        if e.peek() != "]":
            raise e.fail("bracket of EXISTS is not closed")
        e.at += 1
        try:
            value = self._read(key, at)
            return float(not self.fanuc or not isinstance(value, Null))
        except WordError:
            return 0.0

    def hashed(self, e: Expression, at: int) -> float:
        """The value of the parameter behind a #."""
        return self._read(self.key(e), e.column + at)

    def key(self, e: Expression) -> int | str:
        """The parameter after a #: its number or name."""
        if e.peek() == "<":
            end = e.text.find(">", e.at)
            if end < 0:
                raise e.fail("the name of a parameter is not closed with '>'")
            name = e.text[e.at + 1 : end].replace(" ", "")
            e.at = end + 1
            return name
        at = e.at
        number = as_number(e.atom(), e.column + at)
        if number != int(number) or number < 0:
            raise e.fail("the number of a variable is a whole number from 0", at)
        return int(number)

    def _read(self, key: int | str, column: int) -> float:
        own = self.flow.frame.variables
        if isinstance(key, str):
            found = own.get(key, self.names.get(key))
            if found is None and (found := self._predefined(key)) is None:
                found = self.state.given(name := f"#<{key.lower()}>")
                if not isinstance(found, float):
                    raise WordError(no_value(f"parameter {name}"), column)
            return found
        if key == 0:
            return Null(0.0)
        if key <= (33 if self.fanuc else 30):
            return own.get(key, Null(0.0))
        if (value := self._system_value(key)) is not None:
            return value
        if key in self.numbers:
            return self.numbers[key]
        if not self.fanuc and key > 5602:
            raise WordError(f"parameter #{key} is out of range, 5602 is the last", column)
        if isinstance(given := self.state.given(f"#{key}"), float):
            return given
        if self.fanuc and key >= 1000:
            raise WordError(no_value(f"system variable #{key}"), column)
        return Null(0.0)

    def write(self, key: int | str, value: float, column: int) -> None:
        """Assign a value to a parameter."""
        own, m = self.flow.frame.variables, self.offsets
        if isinstance(key, str):
            if key.startswith(("_INI[", "_HAL[")) or (self._predefined(key) is not None and key not in own):
                raise WordError(f"#<{key.lower()}> belongs to the control; choose another name", column)
            (self.names if key.startswith("_") else own)[key] = value
        elif key == 0 or (not self.fanuc and key > 5602):
            raise WordError(f"#{key} cannot be set", column)
        elif key == 3000 and self.fanuc:
            raise WordError("the program stops itself with an alarm (#3000); correct what it asks for", column)
        elif key <= (33 if self.fanuc else 30):
            own[key] = value
        elif not self.fanuc and (5420 <= key <= 5428 or 5400 <= key <= 5413):
            raise WordError(f"#{key} belongs to the control and cannot be set", column)
        elif self.fanuc and key in _TOOLS_OTHERWISE:
            raise WordError(
                f"#{key} writes the tool table, which Fanuc and Haas number differently; use G10 L10 to L13, or #10001 to #13999", column
            )
        elif self.fanuc and (tool := _of_tool(key)) is not None:
            name, (what, wear) = tool
            self.state.tools.set_value(name, what, value * self.state.unit, wear=wear)
        elif (place := self._of_system(key)) is not None:
            n, k = place
            if k == 10:
                m.turned[n] = value
            elif (letter := self._slot(k)) in INDEX:
                m.systems[n] = m.of(n).copy()
                m.systems[n][INDEX[letter]] = math.radians(value) if letter in ROTARY else value * 1e-3
            elif value:
                raise WordError("an offset of B U V W cannot be set on this machine")
            if n == m.system:
                m.set_frames()
        else:
            self.numbers[key] = value

    # ------------------------------------------------------------------ values of the control

    def _of_system(self, key: int) -> tuple[str, int] | None:
        """Zero offset and component (1 to 9, 10 its rotation) of #5221 and on."""
        n, k = (key - 5221) // 20, (key - 5200) % 20
        return (SYSTEMS[n], k) if 0 <= n < len(SYSTEMS) and 1 <= k <= 10 else None

    def _slot(self, k: int) -> str:
        """The axis of component k (1 to 9)."""
        return self.state.slot_of.get(LETTERS[k - 1], LETTERS[k - 1]) if 1 <= k <= 9 else ""

    def _own(self, values: np.ndarray, k: int, stored: bool = False) -> float:
        """Component k in the unit of the program; `stored`: the control keeps lengths in mm."""
        name = self._slot(k)
        if name not in INDEX:
            return 0.0
        value = float(values[INDEX[name]])
        return math.degrees(value) if name in ROTARY else value / (1e-3 if stored else self.state.unit)

    def place(self) -> np.ndarray:
        """Program coordinates (5,)."""
        angles = self.state.out.settle() if any(map(math.isnan, self.state.out.position[3:])) else np.array(self.state.out.position[3:])
        return np.concatenate([self.state.here(), angles - np.array(self.state.offset[3:])])

    def _system_value(self, key: int) -> float | None:
        m, s, fanuc = self.offsets, self.state, self.fanuc
        if 5420 <= key < 5429 or (fanuc and (5001 <= key <= 5006 or 5041 <= key <= 5046)):
            k = key - 5419 if key >= 5420 else key - (5000 if key < 5040 else 5040)
            name = self._slot(k)
            if name in OTHER:
                return math.degrees(s.other_axes[name]) if name == "B" else s.other_axes[name] / s.unit
            return self._own(self.place(), k)
        if not fanuc and 5440 <= key < 5449:
            return self._own(np.array([*s.out.position[:3], *s.out.settle()]), key - 5439)
        if 5021 <= key <= 5029:
            return self._own(np.array(s.out.position), key - 5020)
        for first, values in ((5211, m.shift_kept), (5161, m.reference[28]), (5181, m.reference[30])):
            if first <= key < first + 9:
                return self._own(values, key - first + 1, stored=True) + 0.0
        if (place := self._of_system(key)) is not None:
            n, k = place
            return m.turned.get(n, 0.0) if k == 10 else self._own(m.of(n), k, stored=True)
        if fanuc and (tool := _of_tool(key)) is not None:
            name, (what, wear) = tool
            known = s.tools.value(name, what, wear=wear)
            return known / s.unit if known is not None else 0.0 if wear else None
        if key in (5210, 5220):
            return float(m.shift_on if key == 5210 else (*SYSTEMS, m.system).index(m.system) + 1)
        if key == 5400 and not fanuc:
            return self._tool()
        modes = s.out.modes
        return {
            4001: float(s.motion or 0), 4002: float(s.plane), 4003: 90.0 + (not s.absolute), 4005: float(modes.feed_mode),
            4006: 21.0 if s.unit == 1e-3 else 20.0, 4007: 40.0 if s.comp is None else 41.0 if s.comp.offset > 0 else 42.0,
            4010: 98.0 + (not s.retract_to_start), 4014: float(m.system[1:].split("P")[0]),
            4109: 0.0 if math.isnan(s.feed) else s.feed, 4119: modes.spindle, 4120: self._tool(),
        }.get(key) if fanuc and 4001 <= key <= 4120 else None  # fmt: skip

    def _tool(self) -> float:
        """The number of the tool in the spindle."""
        return float(self.state.tools.name) if self.state.tools.name.isdigit() else 0.0

    def _predefined(self, name: str) -> float | None:
        """Named parameters of LinuxCNC."""
        s = self.state
        if len(name) == 2 and name[0] == "_" and name[1] in LETTERS:
            return self._system_value(5420 + LETTERS.index(name[1]))
        if name in ("_ABS_X", "_ABS_Y", "_ABS_Z", "_ABS_A", "_ABS_C"):
            return self._own(np.array(s.out.position), LETTERS.index(name[5]) + 1)
        values = {
            "_VALUE": lambda: self.returned_value[0], "_VALUE_RETURNED": lambda: self.returned_value[1],
            "_LINE": lambda: s.line, "_METRIC": lambda: s.unit == 1e-3, "_IMPERIAL": lambda: s.unit != 1e-3,
            "_ABSOLUTE": lambda: s.absolute, "_INCREMENTAL": lambda: not s.absolute,
            "_FEED": lambda: 0.0 if math.isnan(s.feed) else s.feed, "_RPM": lambda: s.out.modes.spindle,
            "_CCOMP": lambda: s.comp is not None, "_PLANE": lambda: s.plane * 10.0, "_COORD_SYSTEM": lambda: 10.0 * float(self.offsets.system[1:].split("P")[0]),
            "_TASK": lambda: 0.0, "_CURRENT_TOOL": self._tool, "_CALL_LEVEL": lambda: len(self.flow.frames) - 1, "_REMAP_LEVEL": lambda: 0.0,
        }  # fmt: skip
        return float(values[name]()) if name in values else None  # type: ignore[operator]


def _of_tool(key: int) -> tuple[str, tuple[str, bool]] | None:
    """Tool and quantity of a variable of the tool table; None for another variable."""
    entry = _TOOL_TABLE.get(key // 1000)
    return None if entry is None or key % 1000 == 0 else (str(key % 1000), entry)
