"""Drilling cycles, hole patterns, CYCLE800 and CYCLE832 of the SINUMERIK."""

from collections.abc import Callable
from dataclasses import replace
import math

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.cycles import RAPID, Drilling, levels, pecks
from twin.program.expressions import WordError, needed
from twin.program.frames import Frame, rotation, shifted
from twin.program.sinumerik_blocks import Block, Sinumerik
from twin.program.sinumerik_values import Written, split_arguments
from twin.program.state import ACTS

PITCHES = {
    1: 0.25, 1.2: 0.25, 1.6: 0.35, 2: 0.4, 2.5: 0.45, 3: 0.5, 4: 0.7, 5: 0.8, 6: 1.0, 8: 1.25, 10: 1.5, 12: 1.75, 14: 2.0, 16: 2.0, 18: 2.5, 20: 2.5,
    22: 2.5, 24: 3.0, 27: 3.0, 30: 3.5, 33: 3.5, 36: 4.0, 39: 4.0, 42: 4.5, 45: 4.5, 48: 5.0,
}  # fmt: skip
"""Pitch of a metric thread by its size [mm], ISO 261."""
MOST_HOLES = 10_000
POSITIONS = 9
"""Places of CYCLE802."""


LAYOUTS: dict[str, dict[str, int]] = {
    **{name: {"dwell": 5, "gmode": 6, "amode": 8} for name in ("CYCLE81", "CYCLE82")}, "CYCLE83": {"dwell": 8, "last": 15, "outside": 9, "gmode": 17, "amode": 19, "axis": 12},
    "CYCLE84": {"dwell": 5, "size": 7, "pitch": 8, "speed": 10, "speed_out": 11, "axis": 12, "pitch_unit": 13, "pecks": 15, "gmode": 21},
    "CYCLE840": {"dwell": 5, "size": 9, "pitch": 10, "axis": 11, "pitch_unit": 12, "gmode": 17},
    "CYCLE85": {"dwell": 5, "feed": 6, "feed_out": 7, "gmode": 8, "amode": 10}, "CYCLE86": {"dwell": 5, "u": 7, "v": 8, "lift": 9, "gmode": 11, "amode": 13},
    "CYCLE87": {}, "CYCLE88": {"dwell": 5}, "CYCLE89": {"dwell": 5},
}  # fmt: skip
"""Positions of the arguments of a drilling cycle, counted from 0.

`gmode` 1: the depth is that of the shank, not of the tip. `amode`: its second digit 2 gives the dwell in turns. `axis`: the tool
axis, 1 or 2 for the first or second geometry axis. `pitch_unit`: 2 threads an inch, 3 inches, 4 modules. `u`, `v`, `lift`: step off the wall.
"""


class Arguments(list):
    """The values of a cycle call; None for a missing one."""

    def has(self, k: int) -> bool:
        """Whether argument k, counted from 0, is given."""
        return k < len(self) and self[k] is not None

    def number(self, k: int | None, default: float | None = 0.0) -> float:
        """Argument k; without a default it must be given."""
        if k is None or not self.has(k):
            if default is None:
                raise WordError(f"argument {(k or 0) + 1} of the cycle is missing; add it")
            return default
        if isinstance(self[k], str):
            raise WordError(f"argument {k + 1} of the cycle is a number")
        return float(self[k])

    def count(self, k: int, default: float | None = None) -> int:
        """A number of holes."""
        value = self.number(k, default)
        if not 0 <= value <= MOST_HOLES:
            raise WordError(f"{value:g} holes are too many; at most {MOST_HOLES}")
        return int(value)


def arguments_of(m: Sinumerik, word: Written) -> Arguments:
    """The arguments of a cycle call."""
    out = Arguments()
    for text, at in split_arguments(word.text or ""):
        name = text.startswith("_") and m.values.store_of(text) is None  # a name of the cycle such as _FINISH
        out.append(None if not text else text if name else m.value_of(text, word.text_column + at))
        if isinstance(out[-1], Frame):
            raise WordError(f"argument {len(out)} of the cycle is a frame; give a number", word.text_column + at)
    return out


def modal_cycle(m: Sinumerik, b: Block) -> Written | None:
    """The cycle behind MCALL, which is repeated and not carried out at once."""
    cycles = (w for w in b.names if w.name.startswith("CYCLE8") and m.known[w.name].kind == ACTS)
    return next(cycles, None) if b.has("MCALL") else None


def carry_out(m: Sinumerik, b: Block, word: Written) -> None:
    """One cycle call, made at once or repeated by MCALL."""
    m.corners.release()
    if word is not modal_cycle(m, b):
        if (other := OTHERS.get(word.name)) is not None:
            other(m, arguments_of(m, word), word)
        else:
            drilling(m, word)()


def drilling(m: Sinumerik, word: Written) -> Callable[[], None]:
    """A drilling cycle as a function that makes its moves at the current position."""
    name, a, s, spindle = word.name, arguments_of(m, word), m.state, m.out.modes.spindle
    layout = needed(LAYOUTS.get(name), f"{name} is not read here", word.column)
    rtp, rfp, relative = a.number(0, None), a.number(1), abs(a.number(4))

    def of(part: str) -> float:
        return a.number(layout.get(part))

    def time(part: str) -> float:
        value = of(part)
        if value >= 0.0 and not (value > 0.0 and int(of("amode")) // 10 % 10 == 2):
            return value
        if not spindle:
            raise WordError(f"{name}: a dwell in turns needs a spindle speed; give S before", word.column)
        return abs(value) * 60.0 / spindle

    down = -1.0 if rtp >= rfp else 1.0
    depth, safe = a.number(3, math.nan), rfp - down * abs(a.number(2))
    if relative:  # the control takes DPR where both are given
        if abs(depth - (rfp + down * relative)) > 1e-9:
            s.note(f"{name}: DP and DPR differ, DPR is used")
        depth = rfp + down * relative
    elif math.isnan(depth):
        raise WordError(f"{name} needs the depth DP or DPR; add it", word.column)
    if (depth - safe) * down <= 0.0:
        raise WordError(f"{name}: the depth {depth:g} does not lie below the reference plane {rfp:g}; correct one", word.column)
    if int(of("gmode")) == 1:
        s.note(f"{name}: its depth is that of the shank (_GMODE 1); here the tip goes to it, since the angle of the tip is not known")
    if (axis := int(of("axis"))) in (1, 2) and axis != arcs.PLANES[s.plane][2] + 1:
        raise WordError(f"{name} along geometry axis {axis} is not supported; select its plane with G17, G18 or G19", word.column)
    if int(of("pecks")):
        s.note(f"{name}: one stroke to its depth; intermediate strokes (_VARI) are omitted")
    if name in ("CYCLE87", "CYCLE88"):
        s.note(f"{name}: the halt at the bottom is omitted")
    feed, share = of("feed") or None, 1.0
    if "pitch" in layout:
        lead = _lead(m, abs(of("pitch")), int(of("pitch_unit"))) or PITCHES.get(abs(of("size")), 0.0)
        speed = of("speed") or spindle
        feed, share = lead * speed or None, (of("speed_out") or speed) / speed if speed else 1.0
        if name == "CYCLE84" and feed is None:
            raise WordError("CYCLE84 needs the pitch (MPIT or PIT) and a speed (SST or S); add them", word.column)
    elif of("feed_out") and (feed or s.feed):
        share = of("feed_out") / (feed or s.feed)
    out, aside = share if name in ("CYCLE84", "CYCLE840", "CYCLE85", "CYCLE89") else RAPID, (of("u"), of("v"))
    dwells = time("dwell"), time("last"), time("outside")
    cycle = Drilling(safe, depth, rtp, (), *dwells, out=out, aside=aside, lift=abs(of("lift")))
    if name == "CYCLE83":
        cycle = _deep(m, a, cycle, rfp, down)

    def hole() -> None:
        with m.control.own_feed(feed and feed * (s.unit / m.out.modes.feed_unit)):
            m.control.drill(cycle)

    return hole


def _lead(m: Sinumerik, pitch: float, unit: int) -> float:
    """Pitch of a thread in program units; `unit` as _PITA counts: 2 threads an inch, 3 inches, 4 modules, otherwise program units."""
    if not pitch or unit in (0, 1):
        return pitch
    return {2: 25.4e-3 / pitch, 3: 25.4e-3 * pitch, 4: math.pi * 1e-3 * pitch}.get(unit, pitch * m.state.unit) / m.state.unit


def _deep(m: Sinumerik, a: Arguments, cycle: Drilling, rfp: float, down: float) -> Drilling:
    """CYCLE83 with its infeeds: the first depth, then steps that shrink by DAM."""
    first, shrink, depth = a.number(5, rfp), a.number(7), cycle.depth
    if first == rfp:
        first = rfp + down * abs(a.number(6))
    if (first - rfp) * down <= 0.0:
        first = depth

    def following(size: float, left: float) -> float:
        if shrink > 0.0:
            size = size - shrink if size - shrink > shrink else min(size, shrink)
        elif shrink < 0.0:
            size *= min(abs(shrink), 1.0)
        size = max(size, abs(a.number(13)))
        return 0.5 * left if size < left < 2.0 * size and shrink > 0.0 else size  # the control halves the last two steps

    share, removal, deep_mm = a.number(10, 1.0), a.number(11) == 1.0, abs(depth - rfp) * m.state.unit * 1e3
    # where feed begins again above the last depth, the control's own rule [mm]
    before = (0.6 if deep_mm <= 30.0 else min(deep_mm / 50.0, 7.0)) if removal else 1.0
    back = abs(a.number(16 if removal else 14)) or before * 1e-3 / m.state.unit
    way = pecks(levels(rfp, depth, abs(first - rfp), following), back, not removal)
    return replace(cycle, pecks=way, first_scale=share if 0.0 < share <= 1.0 else 1.0)


def holes(m: Sinumerik, a: Arguments, word: Written) -> None:
    """The cycle of MCALL at each place of a pattern."""
    name = word.name
    cycle = needed(m.modal, f"{name} needs a modal cycle; add MCALL CYCLE81(..) before it", word.column)
    if any(isinstance(v, str) and "1" in v for v in a):
        raise WordError(f"{name} with omitted places (_HIDE) is not supported; write the places", word.column)
    px, py, third, fourth, fifth = (a.number(k) if name != "CYCLE802" else 0.0 for k in range(5))
    c, s = math.cos(math.radians(third)), math.sin(math.radians(third))
    places: list[tuple[float, float]] = []
    if name == "HOLES1":  # angle, first, step
        places = [(px + (fourth + k * fifth) * c, py + (fourth + k * fifth) * s) for k in range(a.count(5))]
    elif name == "HOLES2":  # radius, angle, step
        number = a.count(5)
        turns = [math.radians(fourth + k * (fifth or 360.0 / max(number, 1))) for k in range(number)]
        places = [(px + third * math.cos(t), py + third * math.sin(t)) for t in turns]
    elif name == "CYCLE801":  # angle, steps
        nx, ny = a.count(5, 1.0), a.count(6, 1.0)
        if nx * ny > MOST_HOLES:
            raise WordError(f"{name} has more than {MOST_HOLES} places", word.column)
        if any(a.number(k) for k in (7, 8, 9)):
            raise WordError("CYCLE801 sheared or as a frame is not supported; write the places", word.column)
        places = [(px + i * fourth * c - j * fifth * s, py + i * fourth * s + j * fifth * c) for j in range(ny) for i in range(nx)]
    else:
        if any("2" in f"{a.number(k):.0f}" for k in (0, 1)):
            raise WordError(f"{name} with incremental places is not supported; write them as absolute ones", word.column)
        numbers = [a.number(k, math.nan) for k in range(2, min(len(a), 2 + 2 * POSITIONS))]
        places = [(u, v) for u, v in zip(numbers[0::2], numbers[1::2]) if not math.isnan(u) and not math.isnan(v)]
    for place in places:
        point = m.state.here()
        point[list(arcs.PLANES[m.state.plane][:2])] = np.array(place) * m.state.unit
        m.control.go(mv.RAPID, point)
        depth = len(m.flow.frames)
        cycle()
        if len(m.flow.frames) != depth:
            raise WordError(f"{name} with a subprogram by MCALL is not supported; write the places", word.column)


def swivel(m: Sinumerik, a: Arguments, word: Written) -> None:
    """CYCLE800(_FR,_TC,_ST,_MODE,_X0,_Y0,_Z0,_A,_B,_C,_X1,_Y1,_Z1,..): a plane by its rotations; without arguments it ends."""
    numbers, mode, state = [a.number(k) for k in range(4, 13)], int(a.number(3, 57.0)), int(a.number(2))
    if not any(numbers):
        m.state.untilt()
        return
    angles, kind, matrix = numbers[3:6], mode >> 6, np.eye(3)
    if kind == 3:
        if any(angles):
            raise WordError("CYCLE800 by the angles of the rotary axes (mode 192) is not supported; program A and C", word.column)
    elif kind == 0:
        order = [(mode >> shift & 3) - 1 for shift in (0, 2, 4)]
        if -1 in order and any(angles):  # an axis may turn twice (Z X Z); the turns follow each other all the same
            raise WordError(f"CYCLE800 with mode {mode} is not known; use 57 (X Y Z)", word.column)
        for axis, angle in zip(order, angles):
            matrix = matrix @ rotation(axis, angle)
    else:
        raise WordError("CYCLE800 by solid or projected angles is not supported; use turns about the axes (mode 57)", word.column)
    before, behind = (np.append(np.array(v) * m.state.unit, [0.0, 0.0]) for v in (numbers[0:3], numbers[6:9]))
    plane = Frame(matrix, before) @ shifted(behind)
    m.state.tilt(m.state.frames["plane"] @ plane if state % 10 == 1 and m.state.tilted else plane)


def smooth(m: Sinumerik, a: Arguments, word: Written) -> None:
    """CYCLE832(tolerance, machining, orientation tolerance): G642 with this tolerance, SOFT and FFWON; 0 or no argument switches it off.

    The last digit 0 of `machining` switches off, too; its second digit 1 or a name _ORI_.. says that the third value is the tolerance
    of the orientation [deg], which otherwise is a number of the version (Programming Manual 12/2019, CYCLE832).
    """
    tolerance = a[0] if a.has(0) else 0.0
    if isinstance(tolerance, str) or tolerance < 0.0:
        raise WordError("CYCLE832 needs a tolerance in mm first, e.g. CYCLE832(0.01,3)", word.column)
    machining = a[1] if a.has(1) else None
    name, number = (machining, 1) if isinstance(machining, str) else ("", int(machining or 1))
    if name == "_OFF" or machining == 0.0 or number % 10 == 0:
        tolerance = 0.0
    oriented = name.startswith("_ORI") or number // 10 % 10 == 1
    if not oriented and a.has(2) and a[2] != 1.0:
        m.state.note("CYCLE832: its third value is a tolerance only after _ORI_.. or a second value with 1 in its tens; ignored")
    m.state.set_tolerances(tolerance, a[2] if oriented and a.has(2) and isinstance(a[2], float) else 0.0)
    if tolerance and m.out.feedforward is None:
        m.out.feedforward = "velocity+torque"
    m.out.change(**{"rounding": 642, "brisk": False, "feedforward": True} if tolerance else {"rounding": 64})


OTHERS = {"CYCLE832": smooth, "CYCLE800": swivel, **dict.fromkeys(("HOLES1", "HOLES2", "CYCLE801", "CYCLE802"), holes)}
"""Cycles that are not of drilling."""
