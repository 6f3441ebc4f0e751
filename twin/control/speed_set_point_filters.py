"""Lag of the speed set point w* between position and speed controller (SINAMICS p1414 ff, r1170 behind it), or of its record alone.

    every Ts:   y += (1 - exp(-Ts / T)) (w* - y)

    speed_set_point_lag   the speed controller gets y
    speed_record_lag      the speed controller gets w*

The recorded speed set point is y in both.
"""

from collections.abc import Iterable
import math
from typing import Any

import numpy as np
import scipy  # its parts load when they are used: the command line needs none

from twin.control.block import Block, Cycles, Listed, Values, listed_number, register
from twin.control.number import Key
from twin.simulation.loop_terms import DRIVE, X_RECORDED_SPEED_SETPOINT, X_SPEED_SETPOINT, arrays, term

LONGEST_S = 0.2
LEAST_S = 1e-9
"""A time constant that is none."""

SHARE, INSIDE = range(2)


@term
def lagged_set_point(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """The record of w* becomes y, and w* itself where the lag is inside the loop; state: y."""
    p, s, x = arrays(parameters, state, signals)
    s[0] += p[SHARE] * (x[axis, X_SPEED_SETPOINT] - s[0])
    x[axis, X_RECORDED_SPEED_SETPOINT] = s[0]
    if p[INSIDE] > 0.0:
        x[axis, X_SPEED_SETPOINT] = s[0]


def lagged(values: np.ndarray, period: float, time: float, speed_cycle: float) -> np.ndarray:
    """y (sample, ...) of values that are held for a `period` each, recorded with the first speed cycle of each."""
    kept, first = math.exp(-period / time), -math.expm1(-min(speed_cycle, period) / time)
    return np.asarray(values[0] + scipy.signal.lfilter([first, 1.0 - kept - first], [1.0, -kept], values - values[0], axis=0))


def lag_of(blocks: Iterable[Listed]) -> Listed | None:
    """The block of an axis behind which its speed set point is recorded."""
    return next((one for one in blocks if one.block in (INSIDE_LAG, RECORD_LAG)), None)


def _linear(values: Values, cycles: Cycles, gain: float) -> tuple[np.ndarray, np.ndarray]:
    """gain (F - 1), with F from w* to the mean of y over a position cycle."""
    steps = round(cycles.position_cycle / cycles.speed_cycle)
    kept = np.exp(-np.arange(1, steps + 1) * cycles.speed_cycle / max(values["time_constant"], LEAST_S))
    return gain * float(kept.mean()) * np.array([-1.0, 1.0]), np.array([1.0, -kept[-1]])


_TIME = (listed_number("time_constant", "time_constant_s", "time_constant_s", Key(0.0, LONGEST_S, above=True)),)


def _lag(name: str, inside: bool) -> Block:
    def constants(values: Values, cycles: Cycles, _gain: float) -> list[float]:
        return [-math.expm1(-cycles.speed_cycle / max(values["time_constant"], LEAST_S)), float(inside)]

    # a lag of the record is none of the control
    in_loop: dict[str, Any] = {"linear": _linear, "strengths": (("time_constant",),)} if inside else {}
    return register(Block(name, _TIME, DRIVE, lagged_set_point, constants, **in_loop))


INSIDE_LAG, RECORD_LAG = _lag("speed_set_point_lag", True), _lag("speed_record_lag", False)
