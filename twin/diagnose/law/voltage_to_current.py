"""Response of a current loop to a disturbance voltage. Voltage laws are sought in the residual of the current."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import cont2discrete, lfilter

from twin.diagnose.blocks import moving_mean
from twin.diagnose.settings import T
from twin.diagnose.view import RunView
from twin.machine.machine import Axis


@dataclass(frozen=True)
class VoltageToCurrent:
    """Discrete transfer function of a current loop from a disturbance voltage to the current, at the sample period of the record.

    i / u = s / (L s^2 + (R + Kp) s + Kp / Tn); the integrator rejects constant disturbances. As in the residual of the current, the moving
    mean over `window` samples is subtracted.
    """

    numerator: np.ndarray
    denominator: np.ndarray
    window: int

    def current(self, voltage: np.ndarray) -> np.ndarray:
        """Current [A] of voltages [V] (sample, n) of one run."""
        run = lfilter(self.numerator, self.denominator, voltage - voltage[0], axis=0)
        return np.column_stack([column - moving_mean(column, self.window) for column in run.T])


def voltage_to_current(view: RunView, axis: Axis) -> VoltageToCurrent:
    """Response of the current loop of an axis at the samples of a run, for a voltage that is linear between samples."""
    motor, loops, period = axis.motor, axis.loops, view.trace.period
    gain, integral = loops.current_gain_v_per_a, loops.current_gain_v_per_a / loops.current_integral_time_s
    numerator, denominator, _ = cont2discrete(
        ([1.0, 0.0], [motor.inductance_h, motor.resistance_ohm + gain, integral]), period, method="foh"
    )
    return VoltageToCurrent(np.ravel(numerator), denominator, round(T.drift_s / period))
