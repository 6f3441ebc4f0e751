"""The law of the position controller over recorded signals (sample,) [axis units]: set point and position in, speed set point out.

    r w* = Kv (s(t - d_pos) - x) + a_v f,   f = (s(t - d_ff) - s(t - d_ff - Tp)) / Tp

Its compiled update is `position_controller`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def position_law(gain: float, weight: float, error: np.ndarray, feedforward: np.ndarray) -> np.ndarray:
    """r w* [axis units/s] from the control error s(t - d_pos) - x and the feedforward f."""
    return gain * error + weight * feedforward


def feedforward_at(setpoint: Callable[[float], np.ndarray], delay: float, cycle: float) -> np.ndarray:
    """f as the control forms it: the last step of the set point over a position cycle. `setpoint` gives it a delay [s] ago."""
    return (setpoint(delay) - setpoint(delay + cycle)) / cycle
