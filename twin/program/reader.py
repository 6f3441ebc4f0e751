"""What the readers of all languages share: the control composed of its parts, formulas, plain blocks, subprograms beside the program."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
import math
from pathlib import Path
import re
from typing import Any

from twin.machine.machine import Machine
from twin.program import moves as mv
from twin.program.build import Collector
from twin.program.control import Control
from twin.program.corners import Corners
from twin.program.expressions import Expression, Grammar, Value, as_number
from twin.program.flow import Call, Flow, Statement
from twin.program.source import Folder, Unit
from twin.program.state import OF_MOVES, Block, Item, State

NO_GROUP = "((?!))?"
ADD_CALL = "add it, or list it in [program] calls_without_motion of the machine file if it moves no axis"


MODES: dict[float | str, tuple[str, Any]] = {
    **{number: ("motion", number) for number in range(4)},
    17: ("plane", 17), 18: ("plane", 18), 19: ("plane", 19), 90: ("absolute", True), 91: ("absolute", False),
    90.1: ("centre_absolute", True), 91.1: ("centre_absolute", False), 98: ("retract_to_start", True), 99: ("retract_to_start", False),
    **{number: ("rounding", min(number, 642)) for number in (60, 64, *range(641, 647))},
    **{number: ("stop_window", f"G{number}") for number in (601, 602, 603)}, 450: ("corners_meet", False), 451: ("corners_meet", True),
    **dict.fromkeys(("ORIWKS", "ORIVECT", "ORIPLANE"), ("workpiece_orientation", True)),
    **dict.fromkeys(("ORIMKS", "ORIAXES"), ("workpiece_orientation", False)),
    "FFWON": ("feedforward", True), "FFWOF": ("feedforward", False), "BRISK": ("brisk", True), "SOFT": ("brisk", False),
    "ORIRPY": ("angles_are_rpy", True), "ORIEULER": ("angles_are_rpy", False), **dict.fromkeys(("ORIVIRT1", "ORIRPY2"), ("angles_are_rpy", None)),
}  # fmt: skip
"""G code or name -> the mode of the moves or of the state that it sets, and its value."""


def set_mode(m: Reader, _: object, word: float | str) -> None:
    """A word that only sets a mode."""
    name, value = MODES[word]
    if name in OF_MOVES:
        m.out.change(**{name: value})
    else:
        setattr(m.state, name, value)


class Reader:
    """One program under one control; a language adds its lines, values, words and calls."""

    grammar: Grammar
    variable: Callable[[Expression, str, int], Value]
    """The value of a name at a column of an expression."""
    hashed: Callable[[Expression, int], Value] | None = None
    """The value of what follows a `#`."""
    assign: Callable[..., None]
    other: Callable[[Statement, Call], None]
    """Carries out a statement that the flow does not know."""
    plain_now: Callable[[], bool]
    """Whether no mode of the language acts on a block of coordinates alone."""
    plain_block: re.Pattern[str]
    """A block of coordinates alone; its groups: number, G0 or G1, x y z A C, the tool axis, F. `NO_GROUP` stands for a word that a language lacks."""

    def __init__(self, path: Path, machine: Machine, language: str, unit: Unit, frames: Iterable[str]) -> None:
        self.state = State(path, machine, language, frames)
        self.out: Collector = self.state.out
        self.control = Control(self.state)
        self.corners = Corners(self.control)
        self.flow = Flow(unit, self.state, self)
        self.folder = Folder(path, self.out.files)

    @property
    def reading(self) -> Path:
        """The file whose blocks run."""
        return self.flow.frames[-1].unit.path if self.flow.frames else self.state.path

    def run(self) -> None:
        """Read all blocks; `out` holds the moves."""
        self.flow.run()
        self.corners.release()
        self.control.compensate(0, 0.0)

    def expression(self, text: str, column: int = 1) -> Expression:
        """An expression that begins at `column`."""
        return Expression(text, self.grammar, self.variable, self.hashed, column)

    def value_of(self, text: str, column: int) -> Value:
        """The value of an expression: a number or a text."""
        return self.expression(text, column).whole()

    def number_of(self, text: str, column: int) -> float:
        """The value of an expression or condition (1 true, 0 false)."""
        return as_number(self.value_of(text, column), column)

    def runs_into(self, what: str, column: int) -> None:
        """The end of the file, or a subprogram, is reached without the end of the program, which it stands for."""

    def feed_word(self, value: float) -> float:
        """The feed of an F word."""
        return value

    def values_first(self, b: Block, units: Mapping[float, tuple[float, bool]], before_unit: bool, note: str = "") -> Item | None:
        """G93 to G95, the unit, F and S, which count before the rest of a block; returns the F word.

        `units`: G code -> unit [m], and whether F counts in it; `before_unit`: F counts in the unit before, as `note` says.
        """
        s, codes, feed = self.state, b.codes, b.w.pop("F", None)
        for number in (93, 94, 95):
            if number in codes:
                s.set_feed_mode(number)
        if feed is not None and before_unit:
            s.set_feed(feed.value, feed.column)
        for code in units.keys() & codes:
            unit, of_feed = units[code]
            if feed is not None and note and unit != s.unit:
                s.note(note)
            s.set_unit(unit, feed=of_feed)
        if feed is not None and not before_unit:
            s.set_feed(feed.value, feed.column)
        if "S" in b.w:
            s.set_spindle(b.take("S"))
        return feed

    def fast(self, text: str, line: int) -> bool:
        """Execute a block of coordinates alone; False if it must be read word by word."""
        state, out, corners = self.state, self.out, self.corners
        if not state.plain or corners.held is not None or not self.plain_now():
            return False
        match = self.plain_block.match(text)
        if not match:
            return False
        number, g, x, y, z, a, c, i, j, k, f = match.groups()
        motion = state.motion if g is None else int(g)
        if motion not in (0, 1) or (i is not None and not out.modes.traori):
            return False
        if f == "MAX":
            motion = 0
        elif f is not None:
            state.line = line
            state.set_feed(self.feed_word(float(f)))
        if g is not None:
            state.motion = motion
        if x is y is z is a is c is i is None:
            return True
        state.line, state.block = line, int(number) if number else -1
        kind = mv.LINE if motion else mv.RAPID
        if motion and not state.feed > 0.0:
            self.control.feed_given(state.feed)
        position, frame, unit = out.position, state.offset, state.unit
        corners.last = None
        for axis, text_of in enumerate((x, y, z)):
            if text_of is not None:
                position[axis] = float(text_of) * unit + frame[axis]
        tilt = turn = math.nan
        if a is not None:
            position[3] = tilt = math.radians(float(a)) + frame[3]
        if c is not None:
            position[4] = turn = math.radians(float(c)) + frame[4]
        tool_axis = None
        if i is not None:
            tool_axis = float(i), float(j), float(k)
            position[3] = position[4] = math.nan
        out.add(kind, (*position[:3], tilt, turn), tool_axis, state.feed if motion else math.inf, line, state.block)
        return True

    def moves_nothing(self, *names: str) -> bool:
        """Whether the machine file lists a call, by one of its names, as one without motion; it is noted."""
        listed = {str(name).upper() for name in self.state.settings.get("calls_without_motion", [])}
        if still := not listed.isdisjoint(names):
            self.state.note(f"{names[0]}: the machine file lists it as moving no axis")
        return still
