"""Filters of the set points before position controller and feedforward: a lag, and a moving average (jerk filter, SINUMERIK MD32402, MD32410).

    set_point_lag       y(k) = y(k-1) + (1 - exp(-Tp / T)) (s(k) - y(k-1))
    set_point_average   y(k) = Tp / T sum over the last T of s(k - j)

Both are linear and act on every set point alike, so position, speed and torque feedforward are filtered by the same weights.
"""

import math

import numpy as np

from twin.control.block import Block, Cycles, Values, listed_number, register
from twin.control.number import Key, OnControl, alike

LONGEST_S = 0.2
LEFT_OUT = 1e-12
"""Weight of the oldest set points that a lag leaves out."""

_TIME = Key(0.0, LONGEST_S, above=True)
_JERK_TIME = {"sinumerik": OnControl("MD32410 AX_JERK_TIME", *alike("s"))}


def lag_kernel(values: Values, cycles: Cycles) -> np.ndarray:
    """Weights of a first-order lag, newest first."""
    kept = math.exp(-cycles.position_cycle / values["time_constant"]) if values["time_constant"] > 0.0 else 0.0
    count = max(math.ceil(math.log(LEFT_OUT) / math.log(kept)), 1) if kept > LEFT_OUT else 1
    weights = (1.0 - kept) * kept ** np.arange(count)
    return weights / weights.sum()


def average_kernel(values: Values, cycles: Cycles) -> np.ndarray:
    """Weights of a moving average, newest first; the oldest one takes the part of a cycle that remains."""
    length = values["length"] / cycles.position_cycle
    whole = math.floor(length + 1e-9)
    weights = np.append(np.ones(whole), [length - whole] if length - whole > 1e-9 else [])
    return weights / weights.sum()


SET_POINT_LAG = register(
    Block(
        "set_point_lag",
        (listed_number("time_constant", "time_constant_s", "time_constant_s", _TIME, _JERK_TIME),),
        kernel=lag_kernel,
        strengths=(("time_constant",),),
    )
)

SET_POINT_AVERAGE = register(
    Block(
        "set_point_average",
        (listed_number("length", "length_s", "length_s", _TIME, _JERK_TIME),),
        kernel=average_kernel,
    )
)
