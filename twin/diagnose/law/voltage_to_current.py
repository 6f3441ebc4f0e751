"""What a current loop lets through of a voltage that nobody commanded: laws of the winding are looked for in the current."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import cont2discrete, lfilter

from twin.diagnose.blocks import moving_mean
from twin.diagnose.view import RunView
from twin.machine.machine import Axis


@dataclass(frozen=True)
class VoltageToCurrent:
    """What a current loop lets through of a voltage that it was not asked for, sampled as the record is.

    i / u = s / (L s^2 + (R + Kp) s + Kp / Tn): the integrator takes away what lasts. As in the current's residual, what is slower than
    `window` samples is taken out.
    """

    numerator: np.ndarray
    denominator: np.ndarray
    window: int

    def current(self, voltage: np.ndarray, first: np.ndarray) -> np.ndarray:
        """Current [A] of voltages [V] (sample, n); `first` (sample,) is the index at which the run of each sample begins."""
        out = np.empty_like(voltage)
        begins = np.unique(first)
        for begin, end in zip(begins, [*begins[1:], len(first)]):
            run = lfilter(self.numerator, self.denominator, voltage[begin:end] - voltage[begin], axis=0)
            out[begin:end] = np.column_stack([column - moving_mean(column, self.window) for column in run.T])
        return out


def voltage_to_current(view: RunView, axis: Axis) -> VoltageToCurrent:
    """What the current loop of an axis lets through, at the samples of a run; between them a voltage is a straight line, for the loop is faster than the record."""
    motor, loops, period = axis.motor, axis.loops, view.trace.period
    gain, integral = loops.current_gain_v_per_a, loops.current_gain_v_per_a / loops.current_integral_time_s
    numerator, denominator, _ = cont2discrete(
        ([1.0, 0.0], [motor.inductance_h, motor.resistance_ohm + gain, integral]), period, method="foh"
    )
    return VoltageToCurrent(np.ravel(numerator), denominator, round(view.thresholds.drift_s / period))
