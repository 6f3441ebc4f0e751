"""The speed controller of a recording that holds its set point w*, its speed w and its command u at its own cycle T.

    u(k) - u(k-1) = Kp (e(k) - e(k-1)) + Kp T/Tn e(k-1) + M (a(k) - a(k-1)),    e = w* - w,   a: second slope of the set points

The differences hold the noise of the encoder, which the controller answers at once. A record of other cycles, or of a current behind its loop, answers it
earlier or later, and leaves most of it.
"""

from collections.abc import Sequence
import math

import numpy as np

from twin.control.command_law import BLOCK, CommandRun
from twin.control.structures import INTEGRAL
from twin.estimate.regression import regress
from twin.machine.axis_lumps import ACCELERATION, SPEED_GAIN

LEFT = 0.05
"""The command follows the law if no more than this share of its differences is left (RMS)."""
AT_LIMIT = 0.98
"""Beyond this share of its largest value a command may be limited."""
LEAST_ROWS = 500


def speed_law(runs: Sequence[tuple[CommandRun, np.ndarray]]) -> tuple[dict[str, float], dict[str, float]] | None:
    """Gain, integral time and feedforward of the acceleration as in `AxisControl`, and the half widths of their 95 % intervals.

    From runs with a speed, and w* (sample,) of each; None if the command does not follow the law.
    """
    rows, y, pieces = [], [], []
    largest = max((float(np.abs(run.command).max()) for run, _ in runs), default=0.0)
    for number, (run, asked) in enumerate(runs):
        u, cycle, setpoint = run.command, run.period, run.setpoint
        error, at = asked - run.speed, np.arange(3, len(u))
        change = np.diff(error, prepend=error[0])
        fed = np.diff(setpoint, 3, prepend=[setpoint[0]] * 3) / cycle**2
        use = np.maximum(np.abs(u[at]), np.abs(u[at - 1])) < AT_LIMIT * largest
        at = at[use]
        rows.append(np.column_stack([change[at], cycle * error[at - 1], fed[at]]))
        y.append(u[at] - u[at - 1])
        pieces.append(1000000 * number + at // BLOCK)
    if sum(map(len, y)) < LEAST_ROWS:
        return None
    values = np.concatenate(y)
    fit = regress(np.vstack(rows), values, np.concatenate(pieces))
    gain, rate, acceleration = fit.values.tolist()
    of_gain, of_rate, of_acceleration = (fit.quantile * fit.deviations).tolist()
    left = float(np.mean(fit.residual**2)) / max(float(np.mean(values**2)), 1e-300)
    if not (gain > of_gain and left < LEFT**2):
        return None
    cycle, time = runs[0][0].period, gain / rate if rate > of_rate else math.inf
    # another integrator holds the error of its own cycle
    half = {SPEED_GAIN: of_gain + max(rate, 0.0) * cycle, INTEGRAL: time * (of_gain / gain + of_rate / max(rate, of_rate)) + cycle}
    numbers = {"speed_gain": gain, "integral_time": time, "acceleration": acceleration if acceleration > of_acceleration else 0.0}
    return numbers, half | {ACCELERATION: of_acceleration}
