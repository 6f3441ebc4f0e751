"""Drilling cycles, hole patterns, CYCLE800 and CYCLE832 of the SINUMERIK."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.collect import DEFAULT_ANGLE_TOLERANCE, DEFAULT_TOLERANCE
from twin.program.control import KEPT, Control
from twin.program.cycles import FEED, MOST_PECKS, CycleError, Drilling, pecks
from twin.program.expressions import WordError
from twin.program.frames import Frame, rotation, shifted
from twin.program.sinumerik_variables import SinumerikVariables
from twin.program.words import Word, split_arguments
from twin.units import rad_from_deg

PITCHES = {
    1: 0.25, 1.2: 0.25, 1.6: 0.35, 2: 0.4, 2.5: 0.45, 3: 0.5, 4: 0.7, 5: 0.8, 6: 1.0, 8: 1.25, 10: 1.5, 12: 1.75, 14: 2.0, 16: 2.0, 18: 2.5, 20: 2.5,
    22: 2.5, 24: 3.0, 27: 3.0, 30: 3.5, 33: 3.5, 36: 4.0, 39: 4.0, 42: 4.5, 45: 4.5, 48: 5.0,
}  # fmt: skip
"""Pitch of a metric thread by its size [mm], ISO 261."""
MOST_HOLES = 10_000
POSITIONS = 9
"""Places of CYCLE802."""


class Layout(NamedTuple):
    """Positions of the later arguments of a drilling cycle, counted from 0; None if it has none.

    `gmode` 1: the depth is that of the shank, not of the tip. `amode`: its second digit 2 gives the dwell in turns. `axis`: the tool
    axis, 1 or 2 for the first or second geometry axis. `pitch_unit`: 2 threads an inch, 3 inches, 4 modules.
    """

    gmode: int | None = None
    amode: int | None = None
    axis: int | None = None
    pitch_unit: int | None = None
    pecks: int | None = None


LAYOUTS = {
    "CYCLE81": Layout(gmode=6, amode=8),
    "CYCLE82": Layout(gmode=6, amode=8),
    "CYCLE83": Layout(gmode=17, amode=19, axis=12),
    "CYCLE84": Layout(gmode=21, axis=12, pitch_unit=13, pecks=15),
    "CYCLE840": Layout(gmode=17, axis=11, pitch_unit=12),
    "CYCLE85": Layout(gmode=8, amode=10),
    "CYCLE86": Layout(gmode=11, amode=13),
}
_ORDERS = {1: 0, 2: 1, 3: 2}


def _number(arguments: list, k: int, default: float | None = None) -> float:
    value = arguments[k] if k < len(arguments) else None
    if value is None:
        if default is None:
            raise CycleError(f"argument {k + 1} of the cycle is missing; add it")
        return default
    if isinstance(value, str):
        raise CycleError(f"argument {k + 1} of the cycle is a number")
    return float(value)


def _count(value: float) -> int:
    if not 0 <= value <= MOST_HOLES:
        raise CycleError(f"{value:g} holes are too many; at most {MOST_HOLES}")
    return int(value)


class SinumerikCycles:
    """The cycles; `modal` is that of MCALL."""

    def __init__(self, control: Control, values: SinumerikVariables) -> None:
        self.control, self.values, self.state, self.flow = control, values, control.state, values.flow
        self.modal: Callable[[], None] | None = None

    def values_of(self, word: Word) -> list[float | str | None]:
        """The arguments of a cycle; None for a missing one."""
        out: list[float | str | None] = []
        for text, at in split_arguments(word.text or ""):
            if not text:
                out.append(None)
            elif text.startswith("_") and self.values.store_of(text) is None:
                out.append(text)  # a name of the cycle such as _FINISH
            else:
                out.append(self.values.value_of(text, word.text_column + at))
        return out

    def carry_out(self, word: Word) -> None:
        """One cycle call, made at once or repeated by MCALL."""
        name = word.name
        arguments = self.values_of(word)
        if name == "CYCLE832":
            self.smooth(arguments, word)
        elif name == "CYCLE800":
            self.swivel(arguments, word)
        elif name in ("HOLES1", "HOLES2", "CYCLE801", "CYCLE802"):
            self.holes(name, arguments, word)
        else:
            self.drilling(name, arguments, word)()

    def drilling(self, name: str, a: list, word: Word) -> Callable[[], None]:
        """A drilling cycle as a function that makes its moves at the current position."""
        rtp, rfp, sdis = _number(a, 0), _number(a, 1, 0.0), abs(_number(a, 2, 0.0))
        given = len(a) > 3 and a[3] is not None
        relative = _number(a, 4, 0.0)
        down = -1.0 if rtp >= rfp else 1.0
        if (relative and not given) or (relative and name != "CYCLE83" and not given):
            depth = rfp + down * abs(relative)
        elif given:
            depth = _number(a, 3)
        else:
            raise WordError(f"{name} needs the depth DP or DPR; add it", word.column)
        if relative and given and abs(depth - (rfp + down * abs(relative))) > 1e-9:
            depth = rfp + down * abs(relative)  # the control takes DPR where both are given
            self.state.note(f"{name}: DP and DPR differ, DPR is used")
        safe = rfp - down * sdis
        if (depth - safe) * down <= 0.0:
            raise WordError(f"{name}: the depth {depth:g} does not lie below the reference plane {rfp:g}; correct one", word.column)
        spindle = self.state.out.modes.spindle
        feed: float | None = None
        layout = LAYOUTS.get(name, Layout())
        self._later_arguments(name, a, layout, word)
        in_turns = layout.amode is not None and int(_number(a, layout.amode, 0.0)) // 10 % 10 == 2

        def time(k: int) -> float:
            value = _number(a, k, 0.0)
            if value < 0.0 or (in_turns and value > 0.0):
                if not spindle:
                    raise WordError(f"{name}: a dwell in turns needs a spindle speed; give S before", word.column)
                return abs(value) * 60.0 / spindle
            return value

        cycle = Drilling(safe, depth, rtp)
        if name in ("CYCLE81", "CYCLE82"):
            cycle = Drilling(safe, depth, rtp, dwell=time(5))
        elif name == "CYCLE83":
            cycle = self._deep(a, rfp, safe, depth, rtp, down, time)
        elif name in ("CYCLE84", "CYCLE840"):
            size, pitch = (7, 8) if name == "CYCLE84" else (9, 10)
            lead = self._lead(abs(_number(a, pitch, 0.0)), int(_number(a, layout.pitch_unit or 0, 0.0)))
            lead = lead or PITCHES.get(abs(_number(a, size, 0.0)), 0.0)
            speed = (_number(a, 10, 0.0) if name == "CYCLE84" else 0.0) or spindle
            back = (_number(a, 11, 0.0) if name == "CYCLE84" else 0.0) or speed
            if lead and speed:
                feed = lead * speed
            elif name == "CYCLE84":
                raise WordError("CYCLE84 needs the pitch (MPIT or PIT) and a speed (SST or S); add them", word.column)
            cycle = Drilling(safe, depth, rtp, dwell=time(5), out=FEED, out_scale=back / speed if speed else 1.0)
        elif name == "CYCLE85":
            inward, outward = _number(a, 6, 0.0), _number(a, 7, 0.0)
            feed = inward or None
            base = inward or self.state.feed
            cycle = Drilling(safe, depth, rtp, dwell=time(5), out=FEED, out_scale=outward / base if outward and base else 1.0)
        elif name == "CYCLE86":
            aside = _number(a, 7, 0.0), _number(a, 8, 0.0)
            cycle = Drilling(safe, depth, rtp, dwell=time(5), aside=aside, lift=abs(_number(a, 9, 0.0)))
        elif name in ("CYCLE87", "CYCLE88"):
            self.state.note(f"{name}: the halt at the bottom is omitted")
            cycle = Drilling(safe, depth, rtp, dwell=time(5) if name == "CYCLE88" else 0.0)
        elif name == "CYCLE89":
            cycle = Drilling(safe, depth, rtp, dwell=time(5), out=FEED)

        def run() -> None:
            kept, mode = self.state.feed, self.state.out.modes.feed_mode
            if feed is not None:
                if mode != 94:
                    self.state.set_feed_mode(94)
                self.state.feed = feed * (self.state.unit / self.state.out.modes.feed_unit)
            if abs(self.state.here()[arcs.PLANES[self.state.plane][2]] - safe * self.state.unit) >= 1e-12:
                self.control.height(safe)
            self.control.drill(cycle)
            if feed is not None:
                self.state.set_feed_mode(mode)
                self.state.feed = kept

        if word.name in ("CYCLE81", "CYCLE82", "CYCLE83", "CYCLE84", "CYCLE840", "CYCLE85", "CYCLE86", "CYCLE87", "CYCLE88", "CYCLE89"):
            return run
        raise WordError(f"{name} is not read here", word.column)

    def _later_arguments(self, name: str, a: list, layout: Layout, word: Word) -> None:
        """Arguments after the classic ones that have an effect on the control: noted or refused."""
        given = {key: int(_number(a, k, 0.0)) for key, k in layout._asdict().items() if k is not None}
        if given.get("gmode", 0) == 1:
            self.state.note(
                f"{name}: its depth is that of the shank (_GMODE 1); here the tip goes to it, since the angle of the tip is not known"
            )
        across = arcs.PLANES[self.state.plane][2] + 1
        if given.get("axis", 0) in (1, 2) and given["axis"] != across:
            raise WordError(
                f"{name} along geometry axis {given['axis']} is not supported; select its plane with G17, G18 or G19", word.column
            )
        if given.get("pecks", 0):
            self.state.note(f"{name}: one stroke to its depth; intermediate strokes (_VARI) are omitted")

    def _lead(self, pitch: float, unit: int) -> float:
        """Pitch of a thread in program units; `unit` as _PITA counts: 2 threads an inch, 3 inches, 4 modules, otherwise program units."""
        if not pitch or unit in (0, 1):
            return pitch
        return {2: 25.4e-3 / pitch, 3: 25.4e-3 * pitch, 4: math.pi * 1e-3 * pitch}.get(unit, pitch * self.state.unit) / self.state.unit

    def _deep(self, a: list, rfp: float, safe: float, depth: float, rtp: float, down: float, time: Callable[[int], float]) -> Drilling:
        """CYCLE83: the first depth, then steps that shrink by DAM; `time` gives the dwell [s] of an argument."""
        first = _number(a, 5, 0.0) if len(a) > 5 and a[5] is not None else rfp + down * abs(_number(a, 6, 0.0))
        if (a[6:7] and a[6] is not None and a[5:6] and a[5] is None) or first == rfp:
            first = rfp + down * abs(_number(a, 6, 0.0))
        if (first - rfp) * down <= 0.0:
            first = depth
        size, shrink = abs(first - rfp), _number(a, 7, 0.0)
        least = abs(_number(a, 13, 0.0))
        levels, at = [], first
        while (depth - at) * down > 1e-9:
            levels.append(at)
            if len(levels) > MOST_PECKS:
                raise CycleError(f"more than {MOST_PECKS} pecks in one hole; give a larger step")
            if shrink > 0.0:
                size = size - shrink if size - shrink > shrink else min(size, shrink)
            elif shrink < 0.0:
                size *= abs(shrink) if abs(shrink) < 1.0 else 1.0
            size = max(size, least)
            if size <= 0.0:
                break
            left = abs(depth - at)
            if size < left < 2.0 * size and shrink > 0.0:
                size = 0.5 * left  # the control halves the last two steps
            at += down * size
        share = _number(a, 10, 1.0)
        removal = _number(a, 11, 0.0) == 1.0
        depth_mm = abs(depth - rfp) * self.state.unit * 1e3
        before = (
            0.6 if depth_mm <= 30.0 else min(depth_mm / 50.0, 7.0)
        )  # where feed begins again above the last depth, the control's own rule [mm]
        back = abs(_number(a, 16 if removal else 14, 0.0)) or (before if removal else 1.0) * 1e-3 / self.state.unit
        return Drilling(
            safe, depth, rtp, dwell=time(8), dwell_last=time(15), dwell_out=time(9), pecks=pecks([*levels, depth], back, not removal),
            first_scale=share if 0.0 < share <= 1.0 else 1.0,
        )  # fmt: skip

    def holes(self, name: str, a: list, word: Word) -> None:
        """The cycle of MCALL at each place of a pattern."""
        if self.modal is None:
            raise WordError(f"{name} needs a modal cycle; add MCALL CYCLE81(..) before it", word.column)
        if any(isinstance(v, str) and "1" in v for v in a):
            raise WordError(f"{name} with omitted places (_HIDE) is not supported; write the places", word.column)
        x, y, _ = arcs.PLANES[self.state.plane]
        places: list[tuple[float, float]] = []
        if name == "HOLES1":
            px, py, angle, first, step = (_number(a, k, 0.0) for k in range(5))
            c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
            places = [(px + (first + k * step) * c, py + (first + k * step) * s) for k in range(_count(_number(a, 5)))]
        elif name == "HOLES2":
            px, py, radius, angle, step = (_number(a, k, 0.0) for k in range(5))
            number = _count(_number(a, 5))
            step = step or 360.0 / max(number, 1)
            turns = [math.radians(angle + k * step) for k in range(number)]
            places = [(px + radius * math.cos(t), py + radius * math.sin(t)) for t in turns]
        elif name == "CYCLE801":
            px, py, angle, dx, dy = (_number(a, k, 0.0) for k in range(5))
            c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
            nx, ny = _count(_number(a, 5, 1.0)), _count(_number(a, 6, 1.0))
            if nx * ny > MOST_HOLES:
                raise WordError(f"{name} has more than {MOST_HOLES} places", word.column)
            if any(_number(a, k, 0.0) for k in (7, 8, 9)):
                raise WordError("CYCLE801 sheared or as a frame is not supported; write the places", word.column)
            places = [(px + i * dx * c - j * dy * s, py + i * dx * s + j * dy * c) for j in range(ny) for i in range(nx)]
        else:
            if any("2" in f"{_number(a, k, 0.0):.0f}" for k in (0, 1)):
                raise WordError(f"{name} with incremental places is not supported; write them as absolute ones", word.column)
            numbers = [_number(a, k, math.nan) for k in range(2, min(len(a), 2 + 2 * POSITIONS))]
            places = [(u, v) for u, v in zip(numbers[0::2], numbers[1::2]) if not math.isnan(u) and not math.isnan(v)]
        for u, v in places:
            point = self.state.here()
            point[x], point[y] = u * self.state.unit, v * self.state.unit
            self.control.go(mv.RAPID, point, KEPT)
            depth = len(self.flow.frames)
            self.modal()
            if len(self.flow.frames) != depth:
                raise WordError(f"{name} with a subprogram by MCALL is not supported; write the places", word.column)

    def swivel(self, a: list, word: Word) -> None:
        """CYCLE800(_FR,_TC,_ST,_MODE,_X0,_Y0,_Z0,_A,_B,_C,_X1,_Y1,_Z1,..): a plane by its rotations; without arguments it ends."""
        numbers = [_number(a, k, 0.0) for k in range(4, min(13, len(a)))]
        numbers += [0.0] * (9 - len(numbers))
        mode = int(_number(a, 3, 57.0))
        state = int(_number(a, 2, 0.0))
        if not any(numbers):
            self.state.untilt()
            return
        angles = numbers[3:6]
        kind = mode >> 6
        if kind == 3:
            if any(angles):
                raise WordError("CYCLE800 by the angles of the rotary axes (mode 192) is not supported; program A and C", word.column)
            matrix = np.eye(3)
        elif kind == 0:
            order = [_ORDERS.get(mode >> shift & 3, -1) for shift in (0, 2, 4)]
            if -1 in order and any(angles):  # an axis may turn twice (Z X Z); the turns follow each other all the same
                raise WordError(f"CYCLE800 with mode {mode} is not known; use 57 (X Y Z)", word.column)
            matrix = np.eye(3)
            for axis, angle in zip(order, angles):
                matrix = matrix @ rotation(axis, angle)
        else:
            raise WordError("CYCLE800 by solid or projected angles is not supported; use turns about the axes (mode 57)", word.column)
        before, behind = (np.append(np.array(v) * self.state.unit, [0.0, 0.0]) for v in (numbers[0:3], numbers[6:9]))
        plane = Frame(matrix, before) @ shifted(behind)
        if state % 10 == 1 and self.state.tilted:
            plane = self.state.frames["plane"] @ plane
        self.state.tilt(plane)

    def smooth(self, a: list, word: Word) -> None:
        """CYCLE832(tolerance, machining, orientation tolerance): G642 with this tolerance, SOFT and FFWON; 0 or no argument switches it off.

        The last digit 0 of `machining` switches off, too; its second digit 1 or a name _ORI_.. says that the third value is the tolerance
        of the orientation [deg], which otherwise is a number of the version (Programming Manual 12/2019, CYCLE832).
        """
        tolerance = a[0] if a and a[0] is not None else 0.0
        if isinstance(tolerance, str) or tolerance < 0.0:
            raise WordError("CYCLE832 needs a tolerance in mm first, e.g. CYCLE832(0.01,3)", word.column)
        machining = a[1] if len(a) > 1 else None
        name, number = (machining, 1) if isinstance(machining, str) else ("", int(machining or 1))
        if name == "_OFF" or machining == 0.0 or number % 10 == 0:
            tolerance = 0.0
        self.state.tolerance = tolerance * self.state.unit or DEFAULT_TOLERANCE
        oriented = name.startswith("_ORI") or number // 10 % 10 == 1
        if not oriented and len(a) > 2 and a[2] not in (None, 1.0):
            self.state.note("CYCLE832: its third value is a tolerance only after _ORI_.. or a second value with 1 in its tens; ignored")
        angle = a[2] if oriented and len(a) > 2 and isinstance(a[2], float) else 0.0
        self.state.angle_tolerance = rad_from_deg(angle) if angle > 0.0 else DEFAULT_ANGLE_TOLERANCE
        self.state.rounding = 642 if tolerance else 64
        if tolerance and self.state.out.feedforward is None:
            self.state.out.feedforward = "velocity+torque"
        self.state.round_corners(**({"brisk": False, "feedforward": True} if tolerance else {}))
