"""P position controller of the NC with speed and torque feedforward.

    every position cycle:  w* = (Kv (s(t - d_pos) - x) + a_v ds/dt(t - d_ff)) / r
                           T_ff = a_t J_ff d2s/dt2(t - d_ff) / r

With a P speed controller behind it, this is a PD controller of the position with speed feedforward: T = Kp (Kv (s - x) + a_v ds/dt - v) / r.
Open loop for the margins: Kv over the closed speed loop, which position it sees. Its law over recorded signals (sample,) [axis units]:

    r w* = Kv (s(t - d_pos) - x) + a_v f,   f = (s(t - d_ff) - s(t - d_ff - Tp)) / Tp,   d2s/dt2 likewise
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.compiled_functions import compiled
from twin.control.number import A_DELAY, Key, Search, held, number, numbers_of, positive


@dataclass(frozen=True, kw_only=True)
class PositionNumbers:
    """Gain, weight of the speed feedforward (0 switches off), delays of the set point."""

    position_gain_per_s: float = number(
        positive(),
        held(
            sinumerik=("MD32200 POSCTRL_GAIN", "1000/min", 1000.0 / 60.0), heidenhain=("MP1810", "(m/min)/mm", 1.0 / 0.06),
            linuxcnc=("P", "1/s", 1.0), isg=("getriebe[0].kv", "0.01/s", 0.01),
        ),
        shown=("position gain", "1/s", 1.0), search=Search(),
    )  # fmt: skip
    velocity_feedforward: float = number(
        Key(-2.0, 2.0),
        held(sinumerik=("MD32610 VELO_FFW_WEIGHT", "1", 1.0), heidenhain=("feedForwardFactor", "1", 1.0), linuxcnc=("FF1", "1", 1.0)),
        absent=0.0, search=Search(), seen_in="a run with velocity feedforward on", after=("position_gain_per_s",),
        shown=("feedforward", "speed, torque", lambda n: f"{n.velocity_feedforward:.4g}, {n.torque_feedforward:.4g}"),
    )  # fmt: skip
    position_delay_s: float = number(
        Key(0.0, 1.0), held(sinumerik=("MD32810 EQUIV_SPEEDCTRL_TIME", "s", 1.0)),
        absent=0.0, shown=("position delay", "ms", 1e3), search=A_DELAY,
    )  # fmt: skip
    feedforward_delay_s: float = number(Key(0.0, 1.0), absent=0.0)


PARAMETERS = numbers_of(PositionNumbers)


@compiled(inline=True)
def position_controller(a, drives, state, setpoint, velocity_feedforward, torque_feedforward, position):  # type: ignore[no-untyped-def]
    """w* of axis `a` from the delayed set point, the feedforward (axis units/s; Nm) and the measured position."""
    speed = (drives.position_gain[a] * (setpoint - position) + velocity_feedforward) / drives.ratio[a]
    state.commanded_speed[a] = speed
    state.commanded_torque[a] = torque_feedforward
    if not drives.dsc[a]:
        state.speed_setpoint[a] = speed
        state.torque_feedforward[a] = torque_feedforward


def position_law(gain: float, weight: float, error: np.ndarray, feedforward: np.ndarray) -> np.ndarray:
    """r w* [axis units/s] from the control error s(t - d_pos) - x and the feedforward f."""
    return gain * error + weight * feedforward


def feedforward_at(setpoint: Callable[[float], np.ndarray], delay: float, cycle: float) -> np.ndarray:
    """f as the control forms it: the last step of the set point over a position cycle. `setpoint` gives it a delay [s] ago."""
    return (setpoint(delay) - setpoint(delay + cycle)) / cycle


def torque_feedforward_at(setpoint: Callable[[float], np.ndarray], delay: float, cycle: float, inertia: float, ratio: float) -> np.ndarray:
    """T_ff at weight 1 [Nm] for an inertia [kg m2 at the motor], by the last second difference of the set point."""
    return inertia * (setpoint(delay) - 2.0 * setpoint(delay + cycle) + setpoint(delay + 2.0 * cycle)) / cycle**2 / ratio
