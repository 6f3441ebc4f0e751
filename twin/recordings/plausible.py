"""Plausibility of units and signs: the signals of one axis compared with each other, then with the limits of axes.

position ~ a setpoint, velocity ~ a d(position)/dt, with a = 1 expected. If a is 1000, 60 or 57.3, the message names the probable wrong unit.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import math

import numpy as np
from scipy.ndimage import median_filter

from twin.machine.machine import Machine
from twin.recordings.relations import UNLIKE, multiple, slope
from twin.recordings.trace import OTHER_UNITS, POSITIONS, SPEEDS

TOLERANCE = 0.08
"""Relative tolerance of a ratio that counts as 1, or as another known factor."""
SHARP = 0.1
"""Unexplained share of the variance below which any ratio other than 1 is reported."""

_SWAPPED = {
    "both": ((60.0, "", "per minute", "per second"), (60e3, "in ", "mm/min", "m/s")),
    "linear": ((0.06, "in ", "m/min", "mm/s"), (25.4, "in ", "mm", "inch")),
    "rotary": ((180.0 / math.pi, "in ", "degrees", "radians"), (1.0 / 6.0, "in ", "rev/min", "deg/s")),
}
"""Recorded in the first unit, taken as the second, by the ratio of recorded to expected values; the other way round by its inverse."""


def _mistakes(kind: str) -> dict[float, str]:
    """Probable mistakes on an axis of this kind by the ratio of recorded to expected values; 1: none."""
    out = {
        1.0: "",
        1000.0: "a unit 1000 times too large (mm taken as m, or a time in ms as s?)",
        1e-3: "a unit 1000 times too small (m taken as mm, or a time in s as ms?)",
        **(dict.fromkeys((2.0 * math.pi, 0.5 / math.pi), "radians and turns mixed?") if kind == "rotary" else {}),
    }
    for ratio, word, one, other in (*_SWAPPED["both"], *_SWAPPED[kind]):
        out |= {ratio: f"recorded {word}{one}, taken as {other}?", 1.0 / ratio: f"recorded {word}{other}, taken as {one}?"}
    return out


_FASTEST = {"linear": 20.0, "rotary": 2.0 * math.pi * 200.0}  # m/s, rad/s: a motor without a gear
_LONGEST = {"linear": 50.0, "rotary": 1e5}  # m, rad
_SHORTEST = {"linear": 5e-6, "rotary": 1e-5}
MOST_CURRENT = 2000.0
UNNAMED = "check unit, scale and the travel of a motor turn"


@dataclass(frozen=True)
class Doubt:
    """An implausible signal, and one line with the reason and the remedy."""

    axis: str
    signal: str
    text: str

    @property
    def known(self) -> bool:
        """True for a known mistake (wrong unit or sign), False for an unexplained ratio."""
        return UNNAMED not in self.text


def doubts_of(
    signals: Mapping[tuple[str, str], np.ndarray], period: float, kinds: Mapping[str, str], machine: Machine | None
) -> list[Doubt]:
    """Contradictions between the signals (sample,) [SI] of each axis, and values beyond the limits of an axis."""
    out: list[Doubt] = []
    for axis in dict.fromkeys(a for a, _ in signals):
        own = {s: v for (a, s), v in signals.items() if a == axis}
        remarks = contradictions(axis, own, period, kinds[axis])
        # ranges are checked only without contradictions, so that one mistake is reported once
        out += remarks or _ranges(axis, own, period, kinds[axis], machine)
    return out


def lone_samples(values: np.ndarray) -> np.ndarray:
    """Indices of the samples of a position (sample,) that leave its motion and return at once, by LONE times what it moves in two samples anywhere."""
    usual = median_filter(values, 5, mode="nearest")
    return np.flatnonzero(np.abs(values - usual) > LONE * np.abs(usual[2:] - usual[:-2]).max(initial=0.0))


LONE = 3.0
"""The noise of an axis at rest stays below."""


def contradictions(axis: str, own: Mapping[str, np.ndarray], period: float, kind: str) -> list[Doubt]:
    """Contradictions between the units, scales and signs of the signals of one axis."""
    out: list[Doubt] = []
    moved = [s for s in ("setpoint", "position", "motor_position") if s in own and np.ptp(own[s]) > 0.0]
    if not moved:
        return out
    reference = moved[0]
    for signal in (s for s in (*POSITIONS, *SPEEDS) if s in own and s != reference):
        if signal in SPEEDS:
            base = "setpoint" if signal != "velocity" and "setpoint" in own else moved[-1]
            found, compared = slope(own[signal], own[base], period), "is {} times the slope of"
        else:
            # differences over 0.1 s cancel offsets and following error
            step = max(1, min(round(0.1 / period), len(own[signal]) // 4))
            base, compared = reference, "moves {} times as far as"
            found = multiple(own[signal][step:] - own[signal][:-step], own[base][step:] - own[base][:-step])
        if found.left < UNLIKE and (text := _mistake(found.factor, found.left, kind, loose=signal != "velocity")):
            out.append(Doubt(axis, signal, f"{axis}.{signal} {compared.format(_plain(found.factor))} {axis}.{base}: {text}"))
    return out


def _mistake(ratio: float, left: float, kind: str, loose: bool) -> str:
    """Text for a ratio, "" for 1. `loose`: a position may follow its set point with a smaller amplitude."""
    size = abs(ratio)
    sign = "it runs the other way: sign = -1?" if ratio < 0.0 else ""
    known = _mistakes(kind)
    nearest = min(known, key=lambda factor: abs(math.log(size / factor)))
    text = ""
    if abs(size / nearest - 1.0) <= TOLERANCE:
        text = f"{known[nearest]} correct unit or scale" if known[nearest] else ""
    elif (loose and not 0.1 < size < 10.0) or (not loose and left < SHARP and not 0.8 < size < 1.25):
        text = UNNAMED
    return "; ".join(part for part in (text, sign) if part)


def _ranges(axis: str, own: Mapping[str, np.ndarray], period: float, kind: str, machine: Machine | None) -> Iterator[Doubt]:
    """Values that no machine axis reaches, or that exceed the limits of this machine."""
    known = machine.axis(axis) if machine else None
    unit, speed_unit = ("m", "m/s") if kind == "linear" else ("rad", "rad/s")
    room = float(known.travel[1] - known.travel[0]) if known else math.inf

    def doubt(signal: str, text: str) -> Doubt:
        return Doubt(axis, signal, f"{axis}.{signal} {text}")

    for signal in (s for s in POSITIONS if s in own):
        travel = float(np.ptp(own[signal]))
        step = max(1, round(0.02 / period))
        speed = float(np.abs(own[signal][step:] - own[signal][:-step]).max() / (step * period)) if len(own[signal]) > step else 0.0
        if signal == "setpoint" and travel > 3.0 * room:
            yield doubt(signal, f"travels {travel:.4g} {unit}, but the machine's axis {room:.4g}: wrong unit? correct unit or scale")
        elif travel > _LONGEST[kind]:
            yield doubt(signal, f"travels {travel:.4g} {unit}: no machine axis does; correct unit or scale")
        elif speed > _FASTEST[kind] or (known is not None and speed > 10.0 * known.max_velocity):
            limit = f", the machine file allows {known.max_velocity:.3g}" if known else ""
            yield doubt(signal, f"moves at {speed:.4g} {speed_unit}{limit}: wrong unit, or wrong unit of time? correct the map")
        elif 0.0 < travel < _SHORTEST[kind] and signal == "setpoint":
            yield doubt(signal, f"moves only {travel:.3g} {unit}: wrong unit? correct unit or scale")
    effort, most = (known.effort, 3.0 * known.motor.peak_current_a) if known else ("current", MOST_CURRENT)
    if effort in own and (peak := float(np.abs(own[effort]).max())) > most:
        limit = f", the machine file's peak is {known.motor.peak_current_a:.3g}" if known else ""
        yield doubt(effort, f"reaches {peak:.4g} {OTHER_UNITS[effort]}{limit}: wrong unit (mA?) or scale; correct the map")


def _plain(ratio: float) -> str:
    """Two significant digits: 1000, 0.06, -2.5."""
    return f"{float(f'{ratio:.2g}'):g}"
