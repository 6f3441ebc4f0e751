"""Mean current of a position cycle, reconstructed from one or two samples per cycle.

The speed set point is a staircase with steps of one position cycle Tp (16 ticks). Each step excites the current, which then
decays. The result is a saw-tooth at 1/Tp, and a trace of one or two samples a cycle shows it at fixed phases only. While the axis
accelerates, the mean of those samples lies below the mean current, here by 9 % of the inertia's share. The mean current moves the mass.

The saw-tooth is linear in the recorded set-point steps, so the missing part is a convolution with them:

    mean_n(i) - mean of samples in cycle n = sum_m g_m dw*_{n-m} + sum_m f_m dT_ff,{n-m}

g and f follow from the cascade, the winding and a drive train of two masses (motor, load, spring). Their parameters, such as
inductance and damping, are fitted to the saw-tooth itself: the differences between samples within a cycle.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
import math

import numpy as np
from scipy.optimize import least_squares

from twin.control.current_controller import winding_model
from twin.control.linear import closed, padded, sampled, with_controller
from twin.control.speed_controller import with_reference_model
from twin.errors import InputError
from twin.machine.machine import Axis, Machine

SETTLED_CYCLES = 48
"""Length of the convolution. The speed loop's integral has decayed by then (96 ms, about ten integral times)."""

RIGID_RAD_PER_S = 2.0 * math.pi * 1500.0
"""A drive train with a higher mode than this is rigid for a control with a bandwidth of some hundred hertz."""

DAMPING_RATIO = 0.05
"""Initial damping ratio of the drive train's mode; ball screws have 0.02 to 0.1."""


@dataclass(frozen=True)
class FastLoop:
    """What shapes the current within a cycle: the control and winding of `axis`, and two masses behind them.

    `inertia` is the total inertia at the motor, `load` the part behind the spring [kg m2]; `mode` [rad/s] = sqrt(stiffness / load).
    """

    axis: Axis
    tick: float
    cycle_ticks: int
    inertia: float
    load: float = 0.0
    mode: float = math.inf
    damping: float = DAMPING_RATIO

    @property
    def winding(self) -> tuple[float, float]:
        """Inductance [H] and resistance [ohm]."""
        return self.axis.motor.inductance_h, self.axis.motor.resistance_ohm

    def with_winding(self, inductance: float, resistance: float) -> FastLoop:
        """The loop with another winding."""
        return replace(self, axis=replace(self.axis, motor=replace(self.axis.motor, inductance_h=inductance, resistance_ohm=resistance)))

    def mechanics(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """From torque to motor speed: a, b and the row of the speed. States: speed of motor and load, deflection."""
        load = min(self.load, 0.95 * self.inertia)
        if load <= 0.02 * self.inertia or self.mode > RIGID_RAD_PER_S:
            return np.zeros((1, 1)), np.array([[1.0 / self.inertia]]), np.ones(1)
        k, d, m = load * self.mode**2, 2.0 * self.damping * load * self.mode, self.inertia - load
        a = np.array([[-d / m, d / m, -k / m], [d / load, -d / load, k / load], [1.0, -1.0, 0.0]])
        return a, np.array([[1.0 / m], [0.0], [0.0]]), np.array([1.0, 0.0, 0.0])


SHORTEST_LAG_S = 1e-3
"""No speed controller behind an ideal actuator has a shorter lag."""


def is_hidden(machine: Machine, axis: Axis) -> bool:
    """Whether samples of an effort miss what the control does: an ideal actuator takes a command at each speed cycle."""
    return not axis.actuator.winding and machine.speed_cycle < 0.75 * machine.sample_period


def sampled_inertia(period: float) -> tuple[float, float]:
    """Bounds of an inertia as shares of that from samples of an effort that a speed controller with a lag T moves between them.

    Under a steady acceleration a the speed set point rises by a Ts in each cycle Ts, and the effort then falls as m a r exp(-t/T) / (1 - exp(-r)),
    r = Ts/T. A sample is its value at any t; m a is its mean.
    """
    r = period / SHORTEST_LAG_S
    return -math.expm1(-r) / r, math.expm1(r) / r


def fast_loop_of(machine: Machine, axis: Axis, inertia: float) -> FastLoop:
    """The fast loop with the values of the machine file; `inertia` [kg m2] at the motor."""
    return FastLoop(axis, machine.base_tick, round(machine.position_cycle / machine.base_tick), inertia)


DIVERGED = 1e100
"""The loop is unstable if its current [A] or speed [rad/s] after a unit step exceeds this."""


def step_responses(loop: FastLoop, cycles: int = SETTLED_CYCLES) -> list[tuple[np.ndarray, np.ndarray]]:
    """Current [A] and motor speed [rad/s], each (cycle, tick), after a unit step of the speed set point [rad/s] and of the torque
    feedforward [Nm].

    Made of the linear models of the control blocks, which have no limits; every controller samples at each tick.
    """
    loops, h, kt = loop.axis.loops, loop.tick, loop.axis.commissioned_torque_constant
    a, b, speed = loop.mechanics()
    a, b, current = winding_model(loop.axis.motor, a, b, speed)
    gain = loops.current_gain_v_per_a
    a, b = closed(with_controller("current", h, (*sampled(a, b, h), current), gain, gain * h / loops.current_integral_time_s))
    fed = b / kt
    speed = padded(np.insert(speed, 0, 0.0), len(a))
    gain = loops.speed_gain_nm_s_per_rad / kt
    integral = gain * h / loops.speed_integral_time_s
    matrix, b = closed(with_controller("speed", h, (a, b, speed[None]), gain, integral))
    if integral > 0.0 and loops.speed_reference_time_s > 0.0:
        matrix, b = with_reference_model(matrix, b, integral, -math.expm1(-h / loops.speed_reference_time_s))
    n = len(matrix)
    inputs = np.hstack([b, np.vstack([fed, np.zeros((n - len(fed), 1))])])
    rows = np.array([padded(current[0], n), padded(speed, n)])
    # first the states at the ticks of one cycle from its initial state, then cycle by cycle
    ticks = loop.cycle_ticks
    free, forced = np.empty((ticks + 1, n, n)), np.zeros((ticks + 1, n, 2))
    free[0] = np.eye(n)
    for k in range(ticks):
        free[k + 1] = matrix @ free[k]
        forced[k + 1] = matrix @ forced[k] + inputs
    starts = np.zeros((cycles, n, 2))
    with np.errstate(over="ignore", invalid="ignore"):
        for c in range(cycles - 1):
            starts[c + 1] = free[ticks] @ starts[c] + forced[ticks]
    if not np.abs(starts).max() < DIVERGED:
        raise InputError(
            f"a speed loop with a gain of {loops.speed_gain_nm_s_per_rad:.3g} Nm s/rad on {loop.inertia:.3g} kg m2 is unstable; "
            "correct the machine file"
        )
    seen = np.tensordot(rows @ free[:ticks], starts, axes=(2, 1)) + (rows @ forced[:ticks])[:, :, None]  # (tick, row, cycle, input)
    return [(seen[:, 0, :, k].T, seen[:, 1, :, k].T) for k in range(2)]


def missing_mean(loop: FastLoop, samples_per_cycle: int) -> tuple[np.ndarray, np.ndarray]:
    """(g, f): mean current of a cycle minus the mean of its samples, per unit step of speed and of torque set point."""
    if not loop.axis.actuator.winding:  # a command is constant within a cycle, so its samples are its mean
        return np.zeros(SETTLED_CYCLES), np.zeros(SETTLED_CYCLES)
    every = loop.cycle_ticks // samples_per_cycle
    kernels = []
    for current, _ in step_responses(loop):
        # for the mean over a cycle it is enough that the current is linear between ticks
        following = np.append(current[1:, 0], current[-1, 0])
        mean = (current.sum(axis=1) + 0.5 * (following - current[:, 0])) / loop.cycle_ticks
        kernels.append(mean - current[:, ::every].mean(axis=1))
    return kernels[0], kernels[1]


def ripples(loop: FastLoop, samples_per_cycle: int) -> list[list[np.ndarray]]:
    """Kernels of the ripple, the sample at mid-cycle minus the mean of those at its ends: [current, speed][speed step, torque step]."""
    every = loop.cycle_ticks // samples_per_cycle
    out: list[list[np.ndarray]] = [[], []]
    for responses in step_responses(loop):
        for quantity, response in enumerate(responses):
            r = response[:, ::every]
            out[quantity].append(r[:, samples_per_cycle // 2] - 0.5 * (r[:, 0] + np.append(r[1:, 0], r[-1, 0])))
    return out


@dataclass(frozen=True)
class Sawtooth:
    """Ripple of current and speed, condensed so that its size does not depend on the length of the recording.

    The misfit |D k - seen|^2 of lag matrix D (cycle, lag) and kernel k equals |R k - z|^2 + rest with R'R = D'D, per quantity.
    """

    root: np.ndarray
    target: np.ndarray
    rest: np.ndarray
    count: int


def sawtooth_of(runs: Iterable[tuple[np.ndarray, np.ndarray, np.ndarray]], noise: tuple[float, float]) -> Sawtooth:
    """Condense the ripple of several runs.

    Per run: steps (2, cycle) of speed and torque set point, ripple (2, cycle) of current [A] and motor speed [rad/s], and (cycle,) bool, the
    cycles of sliding; a sticking load vibrates differently. `noise`: standard deviation of one sample of current and of speed; a ripple is one
    sample minus half of two others.
    """
    gram, cross = np.zeros((2 * SETTLED_CYCLES, 2 * SETTLED_CYCLES)), np.zeros((2, 2 * SETTLED_CYCLES))
    square, count = np.zeros(2), 0
    for steps, ripple, use in runs:
        # (cycle, lag) steps of this cycle and the earlier ones
        before = np.pad(steps, ((0, 0), (SETTLED_CYCLES - 1, 0)))
        lags = np.column_stack([np.lib.stride_tricks.sliding_window_view(s, SETTLED_CYCLES)[:, ::-1] for s in before])[use]
        gram += lags.T @ lags
        cross += ripple[:, use] @ lags
        square += np.sum(ripple[:, use] ** 2, axis=1)
        count += int(use.sum())
    values, vectors = np.linalg.eigh(gram)
    keep = values > 1e-10 * values.max()
    sizes, vectors = np.sqrt(values[keep]), vectors[:, keep]
    weight = 1.0 / (np.array(noise) * math.sqrt(1.5))
    target = weight[:, None] * (cross @ vectors) / sizes
    return Sawtooth(
        weight[:, None, None] * sizes[:, None] * vectors.T, target, np.maximum(weight**2 * square - np.sum(target**2, axis=1), 0.0), count
    )


@dataclass(frozen=True)
class FastFit:
    """The fitted loop, its misfit in units of noise (nan: not fitted), and the standard deviation of sum_m g_m [A s/rad] after the fit."""

    loop: FastLoop
    misfit: float = math.nan
    mean_deviation: float = 0.0


COLOURED = 2.0
"""Factor on the standard deviations: the loop colours the noise and neighbouring ripples share a sample, so they are not independent."""

PRIOR = np.array([0.2, 0.2, 0.03, 0.01, 0.3])
"""Prior standard deviations (of the logarithm) of inductance, resistance, load, mode and damping. Load and mode were identified
before from motor minus scale, within 1 % and 0.3 %."""


def fit_fast_loop(loop: FastLoop, samples_per_cycle: int, seen: Sawtooth, reference: FastLoop) -> FastFit:
    """Fit inductance, resistance, load, mode and damping to the saw-tooth; priors lie around `reference`, the search starts at `loop`.

    For a rigid drive train (mode above RIGID_RAD_PER_S) only inductance and resistance are fitted.
    """
    elastic = reference.mode < RIGID_RAD_PER_S
    free = 5 if elastic else 2
    # what no kernel explains is noise that the loop has amplified, differently in each signal: estimate it from the residual
    scatter = [COLOURED * math.sqrt(max(rest / seen.count, 1.0)) for rest in seen.rest]

    def changed(x: np.ndarray) -> FastLoop:
        factor = np.exp(np.pad(x, (0, 5 - free)))
        inductance, resistance = reference.winding
        train = {"load": reference.load * factor[2], "mode": reference.mode * factor[3], "damping": reference.damping * factor[4]}
        return replace(reference.with_winding(inductance * factor[0], resistance * factor[1]), inertia=loop.inertia, **train)

    def residual(x: np.ndarray) -> np.ndarray:
        kernels = ripples(changed(x), samples_per_cycle)
        parts = [(root @ np.concatenate(k) - z) / s for root, z, k, s in zip(seen.root, seen.target, kernels, scatter)]
        return np.concatenate([*parts, x / PRIOR[:free]])

    def slopes(x: np.ndarray) -> np.ndarray:
        return np.column_stack([(residual(x + 1e-3 * e) - residual(x - 1e-3 * e)) / 2e-3 for e in np.eye(free)])

    bound = np.log([3.0, 3.0, 1.2, 1.1, 4.0][:free])
    at = [math.log(now / before) for now, before in zip(loop.winding, reference.winding)]
    if elastic:
        at += [math.log(getattr(loop, n) / getattr(reference, n)) for n in ("load", "mode", "damping")]
    start = np.clip(at, -0.99 * bound, 0.99 * bound)
    found = least_squares(residual, start, jac=slopes, bounds=(-bound, bound), xtol=1e-6, max_nfev=40)
    explained = sum(rest / s**2 for rest, s in zip(seen.rest, scatter))
    misfit = COLOURED * math.sqrt((2.0 * found.cost + explained) / (2.0 * seen.count))

    # standard deviation of the missing mean, to first order
    def total(x: np.ndarray) -> float:
        return float(missing_mean(changed(x), samples_per_cycle)[0].sum())

    gradient = np.array([(total(found.x + 1e-3 * e) - total(found.x - 1e-3 * e)) / 2e-3 for e in np.eye(free)])
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * max(misfit, 1.0) ** 2
    return FastFit(changed(found.x), misfit, float(np.sqrt(gradient @ covariance @ gradient)))
