"""Identify the speed controller from speed set point, motor angle and current: gain, integral time, torque feedforward.

    Kt_c i* = Kp e + Kp/Tn E + a_t T_ff,    e = w* - w,  E = integral of e
    i* - i  = T_i di/dt + Tni/Kpi s (L di/dt + R i + Ke w) / (1 + Tni s)

All are means over a position cycle, which follow exactly from the angles at its ends (mean w = difference of angles over Tp). The last
term is the lag of the current loop's integrator behind a growing voltage; T_i covers the remaining delays. The speed loop's integrator
also sums the speed noise of ticks that are not recorded. This gives a slow random walk, which a high-pass removes from both sides. The
loop feeds the unrecorded noise back into e and i, so e correlates with the residual. The regression therefore uses the same signals of a
noise-free simulation as instruments; they follow the set points, not the noise.

With feedforward on, the error e is a hundredth of the current, so small unmodelled terms bias the gain. The same regression on that
simulation, whose gains are known, gives the bias, which is then corrected; the interval covers how well it is known. Where it is large the law
is another one, as with a reference model or a filtered speed, and no number of it is determined.

A recording that holds its set point w*, its speed w and its command u at its own cycle T needs no model of what is between (`speed_law`):

    u(k) - u(k-1) = Kp (e(k) - e(k-1)) + Kp T/Tn e(k-1) + M (a(k) - a(k-1)),    a: second slope of the set points

The differences hold the noise of the encoder, which the controller answers at once. A record of other cycles, or of a current behind its loop, answers it
earlier or later, and leaves most of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
import scipy

from twin.control.command_columns import BLOCK
from twin.control.command_run import CommandRun
from twin.control.speed_controller import PARAMETERS, law_weights
from twin.control.structures import INTEGRAL
from twin.estimate.regression import regress
from twin.identify.axis_run import AxisRun, control_inertia
from twin.identify.between_samples import FastLoop, fast_loop_of
from twin.identify.drive_balance import MeanCurrent, mean_of, simulated_torque_weight
from twin.machine.axis_lumps import ACCELERATION, SPEED_GAIN

NAMES = tuple(p.name for p in PARAMETERS if p.bounds.required)
"""Gain, integral time, weight of the torque feedforward."""
PASS_HZ = (1.0, 25.0)
REMEMBERED_S = 0.4
"""Rows within this time of a current limit are not used: the high-pass spreads the error of the clipped current so far."""

LAW_DEVIATION = 0.002
"""Relative standard deviation of gain and integral time due to the remaining error of the law (docs/identify_theory.md)."""


@dataclass(frozen=True)
class SpeedControl:
    """Values of NAMES and their 95 % half intervals; inf: not determined."""

    values: dict[str, float]
    half: dict[str, float]
    condition: float


def fit_speed_control(mean: MeanCurrent, runs: Sequence[AxisRun], simulated: Sequence[AxisRun | None], delay: float) -> SpeedControl | None:
    """Fit the speed controller of the axis of a mean current; None without speed set point or current.

    `simulated`: the same runs without noise, simulated with the file's values (empty: no instruments); `delay` of the feedforward [s].
    """
    axis, loop, inertia = mean.axis, mean.fit.loop, control_inertia(mean.axis)
    kt = axis.commissioned_torque_constant or axis.motor.torque_constant_nm_per_a
    moved = [(r, z) for r, z in zip(runs, simulated or [None] * len(runs)) if r.speed_setpoint is not None and np.ptp(r.angle) > 1.0]
    # without the command that a test rig injected
    kept = [(r, i - r.injected / kt, z) for r, z in moved if (i := mean.of(r)) is not None]
    if not kept or not axis.actuator.winding:  # the closed-loop fit finds the controller of an ideal actuator
        return None
    parts = []
    for k, (run, current, twin) in enumerate(kept):
        columns, values = regressors(loop, run, current, delay)
        free = columns
        if twin is not None and twin.current is not None:
            free, _ = regressors(loop, twin, twin.current, delay)
            free = np.vstack([free, np.zeros((max(len(values) - len(free), 0), 4))])[: len(values)]
        use = ~(np.convolve(run.limited, np.ones(2 * round(REMEMBERED_S / run.cycle) + 1), "same") > 0)
        parts.append((columns[use], values[use], run.clusters(k)[use], free[use]))
    fit = regress(*map(np.concatenate, zip(*parts)))
    factors, spreads = law_factors(fast_loop_of(mean.machine, axis, inertia), [z for _, _, z in kept])
    kp, ki, a_t = fit.values[:3] * factors
    if kp <= 0.0 or ki <= 0.0:
        return None
    d = fit.deviations
    tn = kp / ki
    spread = tn * np.sqrt((d[0] / kp) ** 2 + (d[1] / ki) ** 2 - 2.0 * fit.covariance[0, 1] / (kp * ki)) if fit.seen[1] else np.inf
    of_law = LAW_DEVIATION * kp, LAW_DEVIATION * tn, mean.inertia_deviation / inertia
    of_factors = kp * spreads[0], tn * np.hypot(*spreads[:2]), abs(a_t) * spreads[2]
    deviations = np.sqrt(np.square([d[0], spread, d[2] if fit.seen[2] else np.inf]) + np.square(of_law) + np.square(of_factors))
    found, half = (dict(zip(NAMES, map(float, of))) for of in ((kp, tn, a_t), fit.quantile * deviations))
    return SpeedControl(found, half, fit.condition)


def law_factors(known: FastLoop, twins: Sequence[AxisRun | None]) -> tuple[np.ndarray, np.ndarray]:
    """Ratio of true to estimated (3,) Kp, Kp/Tn and a_t, from a noise-free simulation with the machine file's gains, and its relative deviation (3,)."""
    loops = known.axis.loops
    seen_by = [(twin, mean_of(known, twin, simulated_torque_weight(known.axis, twin))) for twin in twins if twin is not None]
    laws = [regressors(known, twin, i, loops.feedforward_delay_s) for twin, i in seen_by if i is not None]
    factors, spreads = np.ones(3), np.zeros(3)
    if not laws:
        return factors, spreads
    columns, y = (np.concatenate(parts) for parts in zip(*laws))
    fit = regress(columns, y, np.arange(len(y)) // 250)
    true = np.array(law_weights(loops))
    seen, found = fit.seen[:3] & (true != 0.0), fit.values[:3]
    near = seen & (np.abs(found - true) < LAW_HOLDS * true)
    factors[near], spreads[near] = true[near] / found[near], fit.deviations[:3][near] / found[near]
    spreads[seen & ~near] = np.inf
    return factors, spreads


LAW_HOLDS = 0.15
"""If the regression misses a known gain by more than this, the cause is not a small unmodelled term, and the law does not hold."""


def regressors(loop: FastLoop, run: AxisRun, current: np.ndarray, delay: float) -> tuple[np.ndarray, np.ndarray]:
    """Filtered columns e, E, T_ff at weight 1, kt di/dt (cycle, 4) and kt i (cycle,)."""
    axis, tp, kt = loop.axis, run.cycle, loop.axis.commissioned_torque_constant
    assert run.speed_setpoint is not None
    turned = np.diff(run.angle)
    # the control sums speeds sampled at the beginning of its ticks, so the sum is half a tick early while the axis accelerates
    early = 0.5 * loop.tick
    error = run.speed_setpoint - turned / tp + early * np.gradient(turned / tp, tp)
    # integral of w* - w from the start of the run, mean over a cycle: exact for the staircase, from the angles at the cycle's ends
    before = np.concatenate([[0.0], np.cumsum(run.speed_setpoint * tp)[:-1]])
    mean_angle = 0.5 * (run.angle[1:] + run.angle[:-1]) - np.gradient(turned / tp, tp) * tp**2 / 12.0 - run.angle[0]
    integral = before + 0.5 * tp * run.speed_setpoint - mean_angle + early * run.speed
    # lag of the current loop's integrator behind the voltage: s / (1 + Tni s), trapezoidal rule
    change = np.gradient(current, tp)
    motor, tni = axis.motor, axis.loops.current_integral_time_s
    voltage = motor.inductance_h * np.gradient(change, tp) + motor.resistance_ohm * change + motor.back_emf_v_s_per_rad * run.acceleration
    share = tp / (2.0 * tni + tp)
    behind = tni / axis.loops.current_gain_v_per_a * scipy.signal.lfilter([share, share], [1.0, 2.0 * share - 1.0], voltage)
    sos = scipy.signal.butter(2, PASS_HZ, btype="bandpass", fs=1.0 / tp, output="sos")
    values = np.array([error, integral, run.torque_feedforward(axis, delay), -kt * change, kt * (current + behind)])
    *columns, y = scipy.signal.sosfiltfilt(sos, values - values[:, :1])
    return np.column_stack(columns), y


LEFT = 0.05
"""The command follows the law if no more than this share of its differences is left (RMS)."""
AT_LIMIT = 0.98
"""Beyond this share of its largest value a command may be limited."""
LEAST_ROWS = 500


class SpeedLaw(NamedTuple):
    """Gain and feedforward of the acceleration as in `AxisControl`, integral time [s], and the half widths of their 95 % intervals."""

    speed_gain: float
    speed_integral_time_s: float
    acceleration: float
    half: dict[str, float]


def speed_law(runs: Sequence[tuple[CommandRun, np.ndarray]]) -> SpeedLaw | None:
    """The law of a speed controller that gives the recorded command.

    From runs with a speed, and w* (sample,) of each; None if the command does not follow the law.
    """
    parts = []
    largest = max((float(np.abs(run.command).max()) for run, _ in runs), default=0.0)
    for number, (run, asked) in enumerate(runs):
        u, cycle, setpoint = run.command, run.period, run.setpoint
        error, at = asked - run.speed, np.arange(3, len(u))
        change = np.diff(error, prepend=error[0])
        fed = np.diff(setpoint, 3, prepend=[setpoint[0]] * 3) / cycle**2
        use = np.maximum(np.abs(u[at]), np.abs(u[at - 1])) < AT_LIMIT * largest
        at = at[use]
        columns = np.column_stack([change[at], cycle * error[at - 1], fed[at]])
        parts.append((columns, u[at] - u[at - 1], 1000000 * number + at // BLOCK))
    if sum(len(y) for _, y, _ in parts) < LEAST_ROWS:
        return None
    rows, values, pieces = map(np.concatenate, zip(*parts))
    fit = regress(rows, values, pieces)
    gain, rate, acceleration = fit.values.tolist()
    of_gain, of_rate, of_acceleration = (fit.quantile * fit.deviations).tolist()
    left = float(np.mean(fit.residual**2)) / max(float(np.mean(values**2)), 1e-300)
    if not (gain > of_gain and left < LEFT**2):
        return None
    cycle, time = runs[0][0].period, gain / rate if rate > of_rate else math.inf
    # another integrator holds the error of its own cycle
    half = {SPEED_GAIN: of_gain + max(rate, 0.0) * cycle, INTEGRAL: time * (of_gain / gain + of_rate / max(rate, of_rate)) + cycle}
    return SpeedLaw(gain, time, acceleration if acceleration > of_acceleration else 0.0, half | {ACCELERATION: of_acceleration})
