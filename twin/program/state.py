"""The modal state of the control, for all languages: frame, modes, units, tools; and the words of their tables, printed in docs/program_words.md.

Program coordinates x become machine coordinates by the frame: M x + offset (`matrix`, `offset`; the matrix turns, mirrors and
scales). Lengths are in m and rad; a front end converts the programmed values.

A word ACTS: it changes the motion or the meaning of later words. NOTE: understood, without effect on the simulation, noted once.
REFUSED: known but not simulated; the text says what to do.
"""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twin.errors import InputError
from twin.machine.machine import Machine
from twin.program import arcs
from twin.program.build import DEFAULT_ANGLE_TOLERANCE, DEFAULT_TOLERANCE, Collector
from twin.program.compensation import Compensation
from twin.program.expressions import WordError, needed
from twin.program.frames import INDEX, NO_FRAME, OTHER, ROTARY, Frame
from twin.program.tools import Tools

INCH = 0.0254

MODES = ("motion", "plane", "absolute", "centre_absolute", "retract_to_start", "corners_meet", "angles_are_rpy")
OF_MOVES = ("rounding", "tolerance", "angle_tolerance", "adis", "adispos", "stop_window", "brisk", "feedforward", "workpiece_orientation")
"""Modes that are kept and brought back as they are: of the state, and of the moves."""


class Word(NamedTuple):
    """A word of a language: kind, meaning, what carries it out (reader, block, word), and its modal group: a block takes one word of a group."""

    kind: str
    meaning: str
    handler: Callable[..., None] | None = None
    group: str = ""


ACTS, NOTE, REFUSED = "acts", "note", "refused"
NOTHING = "understood, no effect on the motion"
STOPS: Word = Word(ACTS, "exact stop, then on")
UNKNOWN = Word(NOTE, "not known: what it does is set by the builder of the machine; here it changes nothing")
"""An M code that stands in no table."""


def named(kind: str, meaning: str, names: str, handler: Callable[..., None] | None = None, group: str = "") -> dict[str, Word]:
    """Words with one meaning; names of several words are separated by commas."""
    return dict.fromkeys(names.split(", ") if "," in names else names.split(), Word(kind, meaning, handler, group))


class Item(NamedTuple):
    """A word of a block: its number, how it counts ('', AC, IC, DC, ACP, ACN) and its column."""

    value: float
    how: str = ""
    column: int = 1


@dataclass
class Block:
    """The words of one block; each step takes away the words that it uses, so a word that remains is an error."""

    g: list[tuple[float, int]] = field(default_factory=list)  # number and column
    m: list[int] = field(default_factory=list)
    w: dict[str, Item] = field(default_factory=dict)
    column: int = 1  # of the G code in hand

    @property
    def codes(self) -> set[float]:
        """The G codes."""
        return {number for number, _ in self.g}

    def put(self, name: str, item: Item) -> None:
        """Add a word."""
        if name in self.w:
            raise WordError(f"{name} occurs twice in the block; keep one", item.column)
        self.w[name] = item

    def take(self, name: str, default: float = 0.0) -> float:
        """Take a word away; its value."""
        return self.w.pop(name).value if name in self.w else default

    def need(self, name: str, text: str, column: int = 1) -> Item:
        """Take a word away that must be there; `text`: the fault if it is not."""
        return needed(self.w.pop(name, None), text, column)

    def pick(self, *names: str) -> dict[str, Item]:
        """Take words away."""
        return {n: self.w.pop(n) for n in names if n in self.w}

    def all_used(self) -> None:
        """Refuse a word that no step of the block has used."""
        for name, item in self.w.items():
            raise WordError(f"{name} has no use in this block; remove it, or add what it belongs to", item.column)


class State:
    """The modal state while blocks are executed; the module docstring defines the frames."""

    after_compensation = False  # the next move leads from the compensated path and must be straight

    def __init__(self, path: Path, machine: Machine, language: str, frames: Iterable[str]) -> None:
        self.path, self.machine = path, machine
        self.linuxcnc, self.iso = language == "linuxcnc", language in ("linuxcnc", "iso")
        self.frames = dict.fromkeys(frames, NO_FRAME)
        """Frames by name, the outermost first; a tilted plane is `plane`."""
        self.out = Collector(path, machine)
        self.motion: int | None = 1
        self.settings: Mapping[str, Any] = machine.document.get("program", {})
        self.feed = float(self.settings.get("feed_mm_min", math.nan))  # till the first F
        self.feed_word = "F (mm/min, deg/min for A and C alone) in or before this block"
        self.override = 1.0  # OVR
        self.plane = 17
        self.absolute = True
        self.centre_absolute = False  # G90.1
        self.unit = 1e-3
        self.matrix: np.ndarray | None = None  # None: no turning
        self.offset = [0.0] * 5
        self.other_axes = dict.fromkeys(OTHER, 0.0)
        self.comp: Compensation | None = None
        self.programmed = np.zeros(3)  # place on the contour, while the tool follows it at a distance
        self.fixed_axis: np.ndarray | None = None  # tool axis of a swivelled plane, part frame
        self.tilted = self.tilt_switched = False  # whether a tilted plane is in force; whether it switched TRAORI on
        self.shifted: dict[int, float] = {}  # axis whose offset has changed -> its position then
        self.retract_to_start = True  # G98
        self.corners_meet = False  # G451
        self.angles_are_rpy: bool | None = None  # ORIRPY, ORIEULER
        self.compensation_words = ("RL or RR", "R0") if language == "klartext" else ("G41 or G42", "G40")
        self.line, self.block = 0, -1
        self.tools = Tools(self.out, machine, self.iso)
        own = self.out.kinematics.letters
        self.slot_of = dict(zip([*own, *(n for n in "XYZAC" if n not in own)], [*"XYZAC", *(n for n in own if n not in "XYZAC")]))
        """Letter of a program -> letter of its place here: A is the tilting axis, C the turning one."""

    # ------------------------------------------------------------------ places

    def here(self) -> np.ndarray:
        """Program coordinates (3,) of the tool; inside G41 or G42 those on the contour."""
        if self.comp is not None or self.after_compensation:
            return self.programmed.copy()
        return self.to_program(np.array(self.out.position[:3]))

    def to_program(self, machine: np.ndarray) -> np.ndarray:
        """Machine coordinates (3,) in the frame in force."""
        way = machine - self.offset[:3]
        return way if self.matrix is None else np.linalg.solve(self.matrix, way)

    def to_machine(self, point: np.ndarray) -> np.ndarray:
        """Program coordinates (3,) converted to machine coordinates."""
        turned = point if self.matrix is None else self.matrix @ point
        return turned + self.offset[:3]

    def si(self, name: str, value: float) -> float:
        """A programmed coordinate in m or rad."""
        return math.radians(value) if name in ("A", "B", "C") else value * self.unit

    def is_relative(self, how: str) -> bool:
        """Whether a coordinate counts from the position."""
        return how == "IC" or (how == "" and not self.absolute)

    def outside_compensation(self, what: str) -> None:
        """Refuse what cannot be while the tool follows a contour."""
        if self.comp is not None:
            on, off = self.compensation_words
            raise WordError(f"{what} inside {on}; write {off} and a move before")

    def set_frames(self, **changed: Frame) -> None:
        """Change some of the frames; all of them hold for the following blocks.

        The tool stands across a tilted plane. Its transformation counts from the part frame, so the frames outside it do, too.
        """
        self.outside_compensation("the zero offset changes")
        self.frames |= changed
        whole, self.fixed_axis = NO_FRAME, None
        for name, frame in self.frames.items():
            whole = whole @ frame
            if name == "plane" and self.tilted:
                self.fixed_axis = whole.matrix[:, 2 if self.iso else arcs.PLANES[self.plane][2]].copy()
        offset = whole.shift.tolist()
        if self.tilted and self.tilt_switched:
            kinematics = self.out.kinematics.with_tool_length(self.out.modes.tool_length)
            offset[:3] = (whole.shift[:3] + kinematics.tip(np.zeros(5))[0]).tolist()
        if self.out.kinds:
            self.shifted |= {i: self.out.position[i] for i in range(5) if abs(offset[i] - self.offset[i]) > 1e-12}
        self.matrix = None if np.array_equal(whole.matrix, np.eye(3)) else whole.matrix
        self.offset = offset

    @property
    def plain(self) -> bool:
        """Whether blocks of coordinates alone may take the fast way; under G93 of ISO each block needs its F."""
        frame_is_shift = self.matrix is None and self.fixed_axis is None
        by_path = self.comp is None and not self.after_compensation and not (self.iso and self.out.modes.feed_mode == 93)
        return self.absolute and frame_is_shift and by_path

    def frame_table(self, name: str) -> np.ndarray:
        """Zero offset (5,) of a settable frame from the table [frame.G54] of the machine file; zero if there is none."""
        tables = self.machine.document.get("frame", {})
        table = tables.get(name, {}) if isinstance(tables, dict) else {}
        offset = np.zeros(5)
        for key, value in table.items():
            axis, _, unit = key.partition("_")
            axis = self.slot_of.get(axis.upper(), axis)
            if axis.upper() not in INDEX or unit != ("deg" if axis.upper() in ROTARY else "m") or not isinstance(value, int | float):
                raise InputError(
                    f"{self.machine.path or self.machine.name}: [frame.{name}]: unknown key '{key}'; use x_m, y_m, z_m, a_deg, c_deg"
                )
            offset[INDEX[axis.upper()]] = math.radians(value) if unit == "deg" else float(value)
        return offset

    # ------------------------------------------------------------------ modes

    def set_feed(self, value: float, column: int = 1) -> None:
        """The F word in the active units."""
        if not 0.0 <= value <= 1e9:
            raise WordError(f"F{value:g} is not a feed; give a number above 0", column)
        self.feed = value

    def set_spindle(self, value: float) -> None:
        """The S word [1/min]."""
        self.out.change(spindle=abs(value))
        self.note("S: the spindle is not simulated; its speed only serves G95")

    def set_feed_mode(self, number: int) -> None:
        """G93, G94 or G95; a feed in other units does not carry over."""
        if number != self.out.modes.feed_mode:
            self.out.change(feed_mode=number)
            self.feed = math.nan

    def set_unit(self, unit: float, *, feed: bool) -> None:
        """Millimetres or inches, for lengths and, if `feed`, for the feed."""
        if feed and unit != self.out.modes.feed_unit:
            self.feed *= self.out.modes.feed_unit / unit  # the speed in force stays
            self.out.change(feed_unit=unit)
        self.unit = unit

    def set_tolerances(self, path: float | None, angle: float | None) -> None:
        """Tolerance of the path [program units] and of A and C [deg]; 0 stands for the default, None for no change."""
        if path is not None:
            self.out.change(tolerance=path * self.unit if path > 0.0 else DEFAULT_TOLERANCE)
        if angle is not None:
            self.out.change(angle_tolerance=math.radians(angle) if angle > 0.0 else DEFAULT_ANGLE_TOLERANCE)

    def closing(self, radius: float) -> float:
        """The largest difference of the radii of an arc [m]; for ISO LinuxCNC's rule: 28 um or a thousandth, at most 2.8 mm."""
        least = 2.0 * math.sqrt(2.0) * (1e-5 if self.unit == 1e-3 else 1e-3 * self.unit)
        return min(max(least, 1e-3 / (1.0 - 1e-3) * radius), 100.0 * least) if self.iso else arcs.CLOSING_TOLERANCE

    def tilt(self, plane: Frame) -> None:
        """Start a tilted plane: TRAORI on, the tool perpendicular to the plane."""
        self.untilt()
        self.tilted, self.tilt_switched = True, not self.out.modes.traori
        self.frames["plane"] = plane
        self.transform(True)
        self.set_frames()

    def untilt(self) -> None:
        """Restore the plane before, and switch TRAORI off if the tilted plane had switched it on."""
        if self.tilted:
            self.tilted = False
            if self.tilt_switched:
                self.transform(False)
            self.set_frames(plane=NO_FRAME)

    def transform(self, on: bool) -> None:
        """Switch TRAORI on or off."""
        self.outside_compensation("the transformation changes")
        self.out.change_frame(traori=on)

    def kept(self, frames: Iterable[str] = (), with_feed: bool = False) -> Callable[[], None]:
        """A function that brings back the modes in force now, and these frames."""
        inner = {name: self.frames[name] for name in frames}
        values = {name: getattr(self, name) for name in MODES}
        unit, modes, feed = self.unit, self.out.modes, self.feed

        def restore() -> None:
            for name, value in values.items():
                setattr(self, name, value)
            self.set_unit(unit, feed=modes.feed_unit != self.out.modes.feed_unit)
            self.set_feed_mode(modes.feed_mode)
            self.feed = feed if with_feed else self.feed
            self.out.change(**{name: getattr(modes, name) for name in OF_MOVES})
            self.set_frames(**inner)

        return restore

    # ------------------------------------------------------------------ words of the tables

    def check_word(self, name: str, entry: Word | None, column: int) -> None:
        """Refuse a word that its table does not know or refuses, and note one without effect."""
        if entry is None:
            raise WordError(f"{name} is not known; remove it or replace it by moves (docs/program_words.md lists what is read)", column)
        if entry.kind == REFUSED:
            raise WordError(f"{name} is not supported: {entry.meaning}", column)
        if entry.kind == NOTE:
            self.note(f"{name}: {entry.meaning}")

    def note_m(self, numbers: Sequence[int], table: Mapping[int, Word], ends: Container[int]) -> bool:
        """Note the M codes of a block; whether one of them stops."""
        stops = [n for n in numbers if table.get(n) == STOPS or n == 6]
        for number in numbers:
            if number in stops:
                self.note(f"M{number}: the program continues after an exact stop")
            elif number not in ends:
                self.note(f"M{number}: {table.get(number, UNKNOWN).meaning}")
        return bool(stops)

    @staticmethod
    def one_of_each(codes: Sequence[float], groups: Mapping[float, str]) -> None:
        """A block takes one code of a modal group."""
        for group in dict.fromkeys(groups.get(n, "") for n in codes):
            if group and len(both := [n for n in codes if groups.get(n) == group]) > 1:
                raise WordError("G" + " and G".join(f"{n:g}" for n in both) + " are in one block; keep one")

    def given(self, *names: str) -> float | str | None:
        """The value of a variable from the table [variables] of the machine file, by its first name there."""
        table = self.machine.document.get("variables", {})
        value = next((table[n] for n in names if n in table), None) if isinstance(table, dict) else None
        return value if value is None or isinstance(value, str) else float(value)

    def note(self, text: str) -> None:
        """Record once that a word was understood and what it means here."""
        self.out.notes[text] = None
