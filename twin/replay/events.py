"""Events of a run: limits, reversals, sticking, and block changes of the program.

    current limit   |current| reaches the peak current (or the voltage or torque limit, if that is the command)
    speed limit     |speed| reaches the axis' highest speed
    reversal        the set point's speed changes sign, after it moved by more than REVERSAL_MOVE both ways
    sticking        the set point moves while the axis stands
    block           the block number of the program changes
    telling stretch the stretch that shows a diagnosed fault best (given by the caller)

In the list of events, a click on a time goes there.
"""

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np
import scipy

from twin.control.actuator import EFFORTS
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import PROGRAM, Trace
from twin.units import ARCSEC, AXIS_UNITS

TELLING = "telling stretch"
"""An event that a diagnosis adds."""
KINDS = (*(f"{effort} limit" for effort in EFFORTS), "speed limit", "reversal", "sticking", "block", TELLING)
MOST_EVENTS = 5000
"""Most events logged; more make the viewer slow. The summary gives the count."""
WORST = "largest contour error"
"""An event of every run with a tool path."""
AT_LIMIT = 0.998
"""Least share of a limit of a value that is at the limit."""
REVERSAL_MOVE = {"linear": 1e-6, "rotary": ARCSEC}
"""Least motion before and after a reversal; less is rounding of the set point [m, rad]."""
STANDING = {"linear": 5e-5, "rotary": math.radians(0.02)}
"""An axis slower than this stands [m/s, rad/s]; measured speeds scatter by half of it."""
SETPOINT_MOVES = 3.0
"""The set point moves if it is faster than this multiple of STANDING."""
SHORTEST = 0.002
"""Shorter limits and sticking count as noise [s]."""
SPEED_SPAN = 0.002
"""Speeds are differences over this time [s]."""


@dataclass(frozen=True)
class Event:
    """One event: kind, axis ('' for the program), start and end [s], text in the list."""

    kind: str
    axis: str
    start: float
    end: float
    text: str


def find_events(machine: Machine, trace: Trace, contour_error: np.ndarray | None = None) -> list[Event]:
    """All events of a run by time; with a contour error (sample,) [m] also its largest value."""
    events: list[Event] = []
    for axis in machine.axes:
        events += _limits(axis, trace)
        if trace.has(axis.name, "setpoint"):
            events += _reversals(axis, trace)
            if trace.has(axis.name, "position"):
                events += _sticking(axis, trace)
    events += _blocks(trace)
    if contour_error is not None:
        worst = int(np.argmax(contour_error))
        t = float(trace.time[worst])
        events.append(Event(WORST, "", t, t, f"{contour_error[worst] * 1e6:.2f} um"))
    return sorted(events, key=lambda event: (event.start, event.kind, event.axis))


def _limits(axis: Axis, trace: Trace) -> Iterator[Event]:
    speed_unit, per_si = AXIS_UNITS[axis.kind].speed
    checked = (
        (f"{axis.effort} limit", axis.effort, axis.motor.peak_current_a, axis.effort_unit, 1.0),
        ("speed limit", "velocity", axis.max_velocity, speed_unit, per_si),
    )
    for kind, signal, limit, unit, factor in checked:
        if trace.has(axis.name, signal):
            for start, end in stretches(trace.time, np.abs(trace.get(axis.name, signal)) >= AT_LIMIT * limit):
                text = f"{axis.name} at its {kind} of {limit * factor:.4g} {unit} for {(end - start) * 1e3:.3g} ms"
                yield Event(kind, axis.name, start, end, text)


def _reversals(axis: Axis, trace: Trace) -> Iterator[Event]:
    """Turning points of the set point: extremes between moves of more than REVERSAL_MOVE."""
    position = trace.get(axis.name, "setpoint")
    unit, factor = AXIS_UNITS[axis.kind].position
    for i, direction in turning_points(position, REVERSAL_MOVE[axis.kind]):
        way = "+ to -" if direction > 0 else "- to +"
        t = float(trace.time[i])
        yield Event("reversal", axis.name, t, t, f"{axis.name} reverses at {position[i] * factor:.4f} {unit}, {way}")


def turning_points(position: np.ndarray, least_move: float) -> list[tuple[int, int]]:
    """Reversals between moves of at least `least_move`: (index, direction before); for a rest the index of its last sample."""
    found: list[tuple[int, int]] = []
    for direction in (1, -1):
        _, peaks = scipy.signal.find_peaks(direction * position, prominence=least_move, plateau_size=1)
        found += [(int(i), direction) for i in peaks["right_edges"]]
    found.sort()
    # of equal extremes without such a move between them the first counts
    return [turn for i, turn in enumerate(found) if not i or turn[1] != found[i - 1][1]]


def _sticking(axis: Axis, trace: Trace) -> Iterator[Event]:
    standing = STANDING[axis.kind]
    asked, real = (np.abs(_speed(trace, axis.name, signal)) for signal in ("setpoint", "position"))
    unit, factor = AXIS_UNITS[axis.kind].position
    for start, end in stretches(trace.time, (asked > SETPOINT_MOVES * standing) & (real < standing)):
        at = np.interp(start, trace.time, trace.get(axis.name, "position")) * factor
        text = f"{axis.name} sticks at {at:.4f} {unit} for {(end - start) * 1e3:.3g} ms while its set point moves"
        yield Event("sticking", axis.name, start, end, text)


def _speed(trace: Trace, axis: str, signal: str) -> np.ndarray:
    """Central difference of a position over SPEED_SPAN (sample,)."""
    half = max(1, round(0.5 * SPEED_SPAN / trace.period))
    padded = np.pad(trace.get(axis, signal), half, mode="edge")
    return (padded[2 * half :] - padded[: -2 * half]) / (2 * half * trace.period)


def _blocks(trace: Trace) -> Iterator[Event]:
    signal = next((s for a, s in trace.signals if a == PROGRAM and s.startswith("block")), None)
    if signal is None:
        return
    number = trace.get(PROGRAM, signal)
    for i in np.flatnonzero(np.diff(number)) + 1:
        t = float(trace.time[i])
        yield Event("block", "", t, t, f"block {number[i]:g}")


def stretches(time: np.ndarray, holds: np.ndarray) -> list[tuple[float, float]]:
    """Start and end [s] of each stretch of at least SHORTEST where a condition (sample,) holds."""
    edges = np.flatnonzero(np.diff(np.r_[False, holds, False].astype(np.int8)))
    found = [(float(time[a]), float(time[b - 1])) for a, b in zip(edges[::2], edges[1::2])]
    return [(start, end) for start, end in found if end - start >= SHORTEST - 1e-9]
