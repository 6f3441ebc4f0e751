"""Collect the moves of a reader and turn them into a checked `Program`.

Readers append one row per move: programmed coordinates in SI, tool axis or angles, active modes. `finish` computes A and C for all tool
axes (nearest solution, shortest way), the feed in m/s or rad/s, and the stops. It reports moves that the machine cannot make with file,
line and block.
"""

from dataclasses import dataclass, fields, replace
import math
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.geometry.kinematics import Kinematics, kinematics_of
from twin.machine.machine import Machine
from twin.program import moves as mv
from twin.program.orientation import OK, choose_angles, unreachable_text
from twin.program.part_placement import OutsideTravel, axes_of
from twin.units import AXIS_UNITS

DEFAULT_TOLERANCE = 10e-6
"""Default tolerance of corner rounding for G64 and G642 [m]; chosen, the paper gives no value."""
DEFAULT_ANGLE_TOLERANCE = math.radians(0.05)
"""The same for A and C [rad]."""
RAPID_TOLERANCE_FACTOR = 3.0
"""Factor on the tolerance between two rapid moves (STOLF on the control)."""
FARTHEST = 1e9
"""Coordinates of programs stay below this [m, rad], so that their squares are numbers."""
SETTLING = {"G601": 3.0, "G602": 1.0, "G603": 0.0}
"""Dwell at an exact stop until the window is reached, in time constants 1 / Kv of the slowest axis; G603 does not wait."""


@dataclass(frozen=True)
class Modes:
    """Active modes of a move; consecutive moves share one record until a word changes it."""

    traori: bool = False
    workpiece_orientation: bool = True  # ORIWKS: great circle; ORIMKS: A and C linear
    rounding: int = 64  # 60: exact stop; 641: within ADIS and ADISPOS, where they are above 0; else within the tolerances
    stop_window: str = "G601"
    tolerance: float = DEFAULT_TOLERANCE
    angle_tolerance: float = DEFAULT_ANGLE_TOLERANCE
    adis: float = 0.0
    adispos: float = 0.0  # between rapid moves
    feed_mode: int = 94
    feed_unit: float = 1e-3  # m
    feed_of_all: bool = False  # F counts the ways of X Y Z A C together, a degree as a unit of length; else that of X Y Z
    spindle: float = 0.0
    brisk: bool = False
    feedforward: bool = True
    tool_length: float = 0.0  # of TRAORI
    spindle_tool_length: float = 0.0  # of the tool in the spindle, whose tip moves where TRAORI is off


class MovesNothing(InputError):
    """A program that is understood and moves no axis, such as one that only computes; `notes` are those of the program."""

    def __init__(self, message: str, notes: tuple[str, ...]) -> None:
        super().__init__(message)
        self.notes = notes


class Collector:
    """Rows of a program while it is read; `position` holds x y z A C as far as known (A, C NaN after a tool axis)."""

    def __init__(self, path: Path, machine: Machine) -> None:
        self.path = path
        self.machine = machine
        self.kinematics = kinematics_of(machine, sites_needed=False)
        home = np.clip(0.0, self.kinematics.travel[:, 0], self.kinematics.travel[:, 1])
        self.home, self.position = home, [float(v) for v in home]
        self.modes = Modes(tool_length=self.kinematics.tool_length, spindle_tool_length=self.kinematics.tool_length)
        self.all_modes = [self.modes]
        self.kinds: list[int] = []
        self.targets: list[tuple[float, ...]] = []  # x y z A C, NaN: as before
        self.tool_axes: list[tuple[float, float, float] | None] = []
        self.feeds: list[float] = []
        self.mode_of: list[int] = []
        self.blocks: list[int] = []
        self.lines: list[int] = []
        self.stops: set[int] = set()  # rows that end in an exact stop: G9, M0 and the like
        self.arcs: dict[int, tuple[np.ndarray, np.ndarray, float]] = {}
        self.pauses: dict[int, float] = {}
        self.notes: dict[str, None] = {}
        self.files: list[Path] = []  # subprograms in other files
        self.missing: tuple[int, int, str] | None = None  # an axis that this machine lacks: where it first moved
        self.feedforward: str | None = None
        self.mixed_feed = ""  # note where F meets X Y Z and A C in one block
        self.angles: list[np.ndarray] = []  # settled (row, 2)
        self.settled = 0
        self.last_angles = np.array(self.position[3:])

    @property
    def own_axes(self) -> str:
        """The axes of the machine for messages."""
        return " ".join(letter for letter, name in zip(self.kinematics.letters, self.kinematics.names) if name)

    def fail(self, line: int, block: int, text: str) -> InputError:
        """An error at a place of the program."""
        return InputError(f"{mv.place_of(self.path, line, block)}: {text}")

    def change(self, **modes: Any) -> None:
        """Change modes of the following moves."""
        if (new := replace(self.modes, **modes)) != self.modes:
            self.modes = new
            self.all_modes.append(new)

    def add(
        self, kind: int, target: tuple[float, ...], tool_axis: tuple[float, float, float] | None, feed: float, line: int, block: int
    ) -> None:
        """One move; `feed` as in the F word (infinite in rapid moves)."""
        self.kinds.append(kind)
        self.targets.append(target)
        self.tool_axes.append(tool_axis)
        self.feeds.append(feed)
        self.mode_of.append(len(self.all_modes) - 1)
        self.lines.append(line)
        self.blocks.append(block)

    def settle(self) -> np.ndarray:
        """Find the angles of all rows so far; returns the last A and C."""
        begin, end = self.settled, len(self.kinds)
        if end > begin:
            fixed = np.array([t[3:5] for t in self.targets[begin:end]])
            axis = np.array([(math.nan,) * 3 if v is None else v for v in self.tool_axes[begin:end]])
            lengths = np.linalg.norm(axis, axis=1)
            if np.any(lengths == 0.0):
                row = begin + int(np.flatnonzero(lengths == 0.0)[0])
                raise self.fail(self.lines[row], self.blocks[row], "the tool axis has no length; give A3= B3= C3= a direction")
            chosen = choose_angles(self.kinematics, axis, self.last_angles, fixed)
            bad = np.flatnonzero(chosen.status != OK)
            if bad.size:
                k = int(bad[0])
                unit = axis[k] / lengths[k]
                text = unreachable_text(self.kinematics, unit, int(chosen.status[k]))
                raise self.fail(self.lines[begin + k], self.blocks[begin + k], text)
            cut = np.flatnonzero(chosen.rewound & (np.array(self.kinds[begin:end]) != mv.RAPID))
            if cut.size:
                k, turning = begin + int(cut[0]), self.kinematics.label[4]
                text = f"{turning} meets its stop and would rewind inside the cut; retract before, or turn the part"
                raise self.fail(self.lines[k], self.blocks[k], text)
            self.angles.append(chosen.angles)
            self.last_angles = chosen.angles[-1]
            self.settled = end
        return self.last_angles

    def change_frame(self, **modes: Any) -> None:
        """Switch TRAORI or the tool: the axes stay, the point gets its new coordinates."""
        if replace(self.modes, **modes) == self.modes:
            return
        point = np.array([[*self.position[:3], *self.settle()]])
        if self.modes.traori:
            point = mv.axes_at(self.kinematics, point, np.array([self.modes.tool_length]))
        self.change(**modes)
        if self.modes.traori:
            point = mv.tips_at(self.kinematics, point, np.array([self.modes.tool_length]))
        self.position = point[0].tolist()

    def finish(self) -> mv.Program:
        """The checked program."""
        if not self.kinds:
            raise MovesNothing(f"{self.path}: the program moves no axis; give at least one move, e.g. G1 X10 F1000", tuple(self.notes))
        if self.missing is not None:
            line, block, name = self.missing
            raise self.fail(line, block, f"axis {name} moves, and this machine has {self.own_axes}; use a machine file with that axis")
        self.settle()
        n, kind, target, modes = len(self.kinds), np.array(self.kinds, np.int8), np.array(self.targets), self.all_modes
        target[:, 3:] = np.vstack(self.angles)
        if (far := np.flatnonzero(~(np.abs(target) < FARTHEST).all(axis=1))).size:
            raise self.fail(self.lines[far[0]], self.blocks[far[0]], "a coordinate is too large; correct it")
        mode_of = np.array(self.mode_of)
        columns = {f.name: np.array([getattr(m, f.name) for m in modes])[mode_of] for f in fields(Modes)}
        traori, brisk, length, adis = (columns[name] for name in ("traori", "brisk", "spindle_tool_length", "adis"))
        by_distance = columns["rounding"] == 641

        centre, normal, angle = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
        for row, (c, axis, turn) in self.arcs.items():
            centre[row], normal[row], angle[row] = c, axis, turn
        settling = np.array([SETTLING[m.stop_window] for m in modes])[mode_of] / min(a.loops.position_gain_per_s for a in self.machine.axes)
        stop = columns["rounding"] == 60
        stop[list(self.stops)] = True
        pause = np.where(stop, settling, 0.0)
        for row, time in self.pauses.items():
            pause[row] = time
        # no blending at a change of transformation, tool or acceleration mode, at a dwell, and at the end
        length = np.where(traori, columns["tool_length"], length)
        change = (traori[1:] != traori[:-1]) | (brisk[1:] != brisk[:-1]) | (length[1:] != length[:-1])
        change |= (kind[1:] == mv.DWELL) | (kind[:-1] == mv.DWELL)
        stop[:-1] |= change
        stop[-1] = True
        both_rapid = np.concatenate([(kind[1:] == mv.RAPID) & (kind[:-1] == mv.RAPID), [False]])
        factor = np.where(both_rapid, RAPID_TOLERANCE_FACTOR, 1.0)
        distance = np.where(kind == mv.RAPID, columns["adispos"], adis)
        distance = np.where(by_distance & (distance > 0.0), distance, np.inf)
        tolerance = np.where(by_distance & (adis > 0.0), adis, columns["tolerance"]) * factor
        modes_of_path = tolerance, columns["angle_tolerance"] * factor, distance, brisk, columns["feedforward"], length
        motion = kind, target, traori, columns["workpiece_orientation"], np.array(self.feeds), np.zeros(n, bool), stop, pause
        moves = mv.Moves(*motion, *modes_of_path, centre, normal, angle, np.array(self.blocks), np.array(self.lines))
        program = self._with_start(moves)
        self._feeds(program, *(columns[name][-len(program) :] for name in ("feed_mode", "feed_unit", "spindle", "feed_of_all")))
        program = replace(program, notes=tuple(self.notes))
        # block ends against the travel; the motion between them is checked on the set points
        axes = np.vstack([program.start, axes_of(program)])
        if hit := self.kinematics.outside_travel(axes):
            row, k = hit
            place = int(program.moves.line[row - 1]), int(program.moves.block[row - 1])
            line, block = place if row else (self.lines[0], self.blocks[0])
            raise OutsideTravel(str(self.fail(line, block, travel_text(k, float(axes[row, k]), self.kinematics))), program)
        return program

    def _with_start(self, moves: mv.Moves) -> mv.Program:
        """A first rapid move is the start itself; otherwise the axes start at home."""
        start = self.home
        if moves.kind[0] == mv.RAPID:
            start = moves.target[0].copy()
            if moves.traori[0]:
                start = mv.axes_at(self.kinematics, start[None], moves.tool_length[:1])[0]
            moves = moves.take(np.arange(1, len(moves)))
        program = mv.Program(self.path, start, moves, self.kinematics, self.feedforward, tuple(self.notes), tuple(self.files))
        if not len(moves) or not np.any((np.abs(program.starts() - moves.target) > 1e-12).any(axis=1) | (moves.kind == mv.ARC)):
            text = f"{self.path}: the program moves no axis from its start; a first rapid move defines the start, so add a move after it"
            raise MovesNothing(text, program.notes)
        return program

    def _feeds(self, program: mv.Program, mode: np.ndarray, unit: np.ndarray, spindle: np.ndarray, of_all: np.ndarray) -> None:
        """Convert F words to m/s of the tip, or rad/s if only A and C move, and stop at reversals (in place).

        Where F counts all axes, F = sqrt(tip^2 + turn^2) / time with a degree as a unit of length, so the tip has the share tip / sqrt(..).
        """
        moves = program.moves
        starts = program.starts()
        way = moves.target - starts
        tip = moves.curves(np.arange(len(moves)), starts)[-1]
        turn, whole = np.linalg.norm(way[:, 3:], axis=1), np.linalg.norm(way, axis=1)
        # exact reversals are exact stops, because no curve can round them within a tolerance
        straight = ((moves.kind == mv.LINE) | (moves.kind == mv.RAPID)) & (whole > 0.0)
        unit_way = way / np.where(straight, whole, 1.0)[:, None]
        moves.stop[:-1] |= straight[1:] & straight[:-1] & (np.abs(unit_way[1:] + unit_way[:-1]).max(axis=1) < 1e-9)
        moves.rotary[:] = (tip < 1e-12) & (turn > 0.0)
        length = np.where(moves.rotary, turn, tip)
        per_minute = np.where(moves.rotary, math.radians(1.0), unit)
        value = moves.feed * np.where(mode == 95, spindle, 1.0) * per_minute / 60.0
        mixed = (tip >= 1e-12) & (turn > 0.0) & ~moves.traori & (mode != 93) & (moves.kind != mv.RAPID) & np.isfinite(moves.feed)
        if mixed.any() and self.mixed_feed:
            self.notes[self.mixed_feed] = None
        shared = mixed & of_all
        value[shared] *= tip[shared] / np.hypot(tip, turn / math.radians(1.0) * unit)[shared]
        inverse_time = (mode == 93) & np.isfinite(moves.feed)
        value[inverse_time] = length[inverse_time] * moves.feed[inverse_time] / 60.0
        moves.feed[:] = np.where(moves.kind == mv.RAPID, np.inf, value)
        bad = np.flatnonzero((length > 0.0) & ~(moves.feed > 0.0) & (moves.kind != mv.DWELL))
        if bad.size:
            row = int(bad[0])
            text = "the feed is 0; give F a number above 0" + (" and S a speed, since G95 is in force" if mode[row] == 95 else "")
            raise self.fail(int(moves.line[row]), int(moves.block[row]), text)


def travel_text(axis: int, value: float, kinematics: Kinematics) -> str:
    """The message for an axis (0 to 4) outside its travel."""
    name = kinematics.label[axis]
    unit, factor = AXIS_UNITS["rotary" if axis > 2 else "linear"].position
    low, high = kinematics.travel[axis] * factor
    text = f"axis {name} would go to {value * factor:.6g} {unit}, "
    if not kinematics.names[axis]:
        return f"{text}and this machine has no axis {name}; use a machine file with that axis"
    hint = "move the program, set a frame (G54) or place the part elsewhere"
    return f"{text}outside its travel {low:.6g} .. {high:.6g} {unit}; {hint}"
