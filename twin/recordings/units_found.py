"""Units that the numbers show: steps of an encoder, the factor between a speed and the slope of a position, whole numbers.

v = k dx/dt:  k = 1, 60, 0.06, 57.3, 9.55, ... names the pair of units; any other k is a motor whose turn moves the axis by a usual travel.
Without a time the same k gives the period: dx/dt = dx/row / T.
"""

from dataclasses import dataclass
import math

import numpy as np

from twin.recordings.relations import whole
from twin.recordings.roughness import decimal_place
from twin.units import RECORDED_UNITS

_SPEEDS = {
    "mm": {"mm/s": 0.0, "mm/min": 0.5, "m/min": 0.7, "m/s": 1.5, "um/s": 4.0},
    "m": {"m/s": 0.0, "m/min": 0.7, "mm/s": 1.5, "mm/min": 2.0},
    "um": {"um/s": 0.0, "mm/s": 0.7, "mm/min": 1.0, "m/min": 1.5},
    "deg": {"deg/s": 0.0, "rad/s": 1.0, "deg/min": 1.5, "rev/min": 0.7},
    "rad": {"rad/s": 0.0, "deg/s": 1.0, "rev/min": 0.7, "rev/s": 1.5},
}
"""Units of a speed beside a position in a unit, with their surprise: the negative logarithm of how usual they are. rev: turns of the axis."""
TOLERANCE = {"velocity": 0.05, "velocity_feedforward": 0.4, "velocity_setpoint": 1.0}
"""A speed may differ from the slope by this share: a feedforward has a weight, and a set point leads (1.17 to 1.5 with a position loop in the drive)."""
_ROUND = [m * 10.0**e for e in range(-5, 0) for m in (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)]
"""Usual intervals of recordings [s]."""
COUNTS_OF_A_TURN = sorted({float(2**k) for k in range(8, 25)} | {m * 10.0**e for e in range(2, 8) for m in (1.0, 2.0, 2.5, 4.0, 5.0, 8.0)})
SLOWEST_S, FASTEST_S = 0.5, 2e-5
"""Usual intervals of recordings [s]."""
MET = 0.01
"""A ratio of two units, a usual interval, a usual travel or number of counts of a turn is met to this share: speeds are rounded."""
SLOPE_HOLDS = 3e-5
"""The slope of a position gives the travel of a turn to this share; one lead of three digits in 50 is met by chance."""
ON_GRID = 0.06
"""Values lie on a grid below this RMS distance from it, in steps; values anywhere have 0.29."""


@dataclass(frozen=True)
class Scale:
    """Unit of a position, or of a speed, with the factor from numbers to it; `reason` of numbers; `sure`: no assumption."""

    unit: str
    factor: float = 1.0
    reason: str = ""
    sure: bool = False


def slope_factor(position: str, speed: str) -> float:
    """Number in unit `speed` of a motion of 1 unit `position` per second. rev are turns of the axis itself."""
    return RECORDED_UNITS[position][1] / RECORDED_UNITS[speed][1]


def position_scale(values: np.ndarray, factors: list[float], rotary: bool, joint: bool, all_whole: bool = False) -> Scale:
    """Unit of positions (sample,) without one. `factors`: of the speeds against its slope. `joint`: the names speak of a robot. `all_whole`: all
    columns of the axis are whole numbers; positions of three digits alone are no counts."""
    for base, unit in ((2.0 * math.pi, "rad"), (360.0, "deg")):
        if (turn := steps_of_a_turn(values, base)) is not None:
            return Scale(unit, 1.0, f"its steps are 1/{turn:.0f} of a turn in {unit}", True)
    for unit, speed in (("rad", "rev/min"), ("rad", "deg/s"), ("deg", "rad/s"), ("deg", "rev/min"), ("mm", "mm/min"), ("mm", "m/min")):
        if any(abs(abs(f) / slope_factor(unit, speed) - 1.0) < MET for f in factors):
            return Scale(unit, 1.0, f"the recorded speed is its slope if they are {unit} and {speed}")
    if all_whole and counts(values):
        # counts that begin at zero are no absolute encoder's
        bits = math.ceil(math.log2(float(values.max()) + 1.0)) if values.min() > 0.0 else 0
        if 10 <= bits <= 24 and values.min() < 2.0 ** (bits - 1) <= values.max():
            return Scale("deg", 360.0 / 2.0**bits, f"whole numbers on both sides of 2^{bits - 1}: counts, taken as {2**bits} a turn")
        unit = "deg" if rotary else "um"
        return Scale(unit, 1.0, f"whole numbers: counts? one is taken as 1 {unit}")
    if joint and float(np.abs(values).max()) < 4.5 * math.pi and np.ptp(values) > 0.0:
        return Scale("rad", 1.0, "the file gives no unit: taken as rad, because the joint stays within two turns")
    return Scale("deg" if rotary else "mm", 1.0, f"the file gives no unit: taken as {'deg' if rotary else 'mm'}")


def speed_unit(position: str, factor: float, signal: str, kind: str) -> tuple[str, float]:
    """Unit of a speed that is `factor` times the slope of a position in `position`; and travel of a motor turn [mm, deg], 0 if none is needed."""
    near = {unit: abs(math.log(abs(factor) / slope_factor(position, unit))) for unit in _SPEEDS[position]}
    unit = min(near, key=lambda u: (near[u] > 0.02, near[u] if near[u] > 0.02 else _SPEEDS[position][u]))
    if near[unit] <= math.log(1.0 + TOLERANCE[signal]) and not (unit.startswith("rev") and signal != "velocity"):
        return unit, 360.0 if unit.startswith("rev") else 0.0  # turns of the axis itself
    in_mm_or_deg = RECORDED_UNITS[position][1] / RECORDED_UNITS["mm" if kind == "linear" else "deg"][1]
    turn = in_mm_or_deg / abs(factor)
    return ("rev/s", turn) if usual_travel(turn) and not usual_travel(60.0 * turn) else ("rev/min", 60.0 * turn)


def surprise_of(position: str, factor: float) -> float:
    """How unusual the unit is that makes a speed `factor` times the slope of a position; 3 if none explains it, as for a motor of unknown travel."""
    off = {unit: abs(abs(factor) / slope_factor(position, unit) - 1.0) for unit in _SPEEDS[position]}
    return min([*(_SPEEDS[position][unit] for unit in off if factor and off[unit] < TOLERANCE["velocity"]), 3.0])


def usual_factor(factor: float) -> bool:
    """True if a pair of usual units, or a usual travel of a motor turn, explains a speed that is `factor` times the slope of a position."""
    size = abs(factor)
    pairs = (slope_factor(p, v) for p, units in _SPEEDS.items() for v in units)
    return size > 0.0 and (any(abs(size / pair - 1.0) < TOLERANCE["velocity"] for pair in pairs) or usual_travel(60.0 / size))


def as_made(travel: float) -> float:
    """The number of three digits that a travel of a motor turn [mm, deg] meets to SLOPE_HOLDS, as leads are made; else the travel itself."""
    nearest = float(f"{travel:.3g}")
    return nearest if abs(nearest / travel - 1.0) < SLOPE_HOLDS else travel


def usual_travel(travel: float) -> bool:
    """True for a usual travel of a motor turn [mm, deg]."""
    return min(abs(travel / usual - 1.0) for usual in _TRAVELS) < MET


_TRAVELS = [m * 10.0**e for e in (-1, 0, 1) for m in (1.0, 1.25, 1.6, 2.0, 2.5, 3.0, 3.2, 4.0, 5.0, 6.0, 8.0)]
_TRAVELS += [m / 10.0 * 2.0 * math.pi for m in (1.0, 10.0)]
"""Usual travels of a motor turn: screws of 1 to 80 mm, gears of 360 / 10 degrees and so on."""


def interval_of_rows(position: str, factor_per_row: float) -> tuple[float, str] | None:
    """Interval [s] that makes a speed the slope of a position per row, and the unit of this speed; None if no usual interval explains it."""
    found = []
    for unit, surprise in _SPEEDS[position].items():
        period = slope_factor(position, unit) / abs(factor_per_row)
        off, usual = min((abs(math.log(period / usual)), usual) for usual in _ROUND)
        if off < MET:
            found.append((surprise + 50.0 * off, usual, unit))
    return min(found)[1:] if found else None


def counts(values: np.ndarray) -> bool:
    """True if all values are whole numbers, more than ten different ones."""
    return whole(values) and len(np.unique(values)) > 10


def counts_of_a_turn(values: np.ndarray, turn: float, far: bool) -> float | None:
    """The usual number of counts in a turn within MET of `turn`, if the values are counts: whole numbers, or too `far` for any length."""
    nearest = min(COUNTS_OF_A_TURN, key=lambda usual: abs(usual / turn - 1.0))
    return nearest if (far or counts(values)) and abs(nearest / turn - 1.0) < MET else None


def steps_of_a_turn(values: np.ndarray, base: float) -> float | None:
    """N if all values lie on the grid base / N and on no decimal grid."""
    levels = np.unique(values)
    gaps = np.diff(levels)
    if len(gaps) < 20:
        return None
    digit = decimal_place(levels, coarsest=-3, off=1e-4)
    smallest = float(gaps[gaps > 0.5 * digit].min(initial=np.inf))
    for turn in COUNTS_OF_A_TURN:
        step = base / turn
        decimal = abs(float(f"{step:.3g}") - step) < 1e-9 * step  # a step of at most three digits: 0.1, 0.025
        if abs(step / smallest - 1.0) < 0.05 and step > 8.0 * digit and not decimal:
            off = (levels - levels[0]) / step
            if np.sqrt(np.mean((off - np.rint(off)) ** 2)) < ON_GRID:
                return turn
    return None
