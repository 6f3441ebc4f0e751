"""Balance of torques at the motor of a linear axis: inertia, Coulomb and viscous friction, gravity.

    Kt i + T_out = J (dw/dt + T d2w/dt2) + Fc sign(w) + Fv w + G      where the axis slides

i is the mean current of a position cycle (`between_samples`). T is the time skew between current and motion, some ten microseconds that
would otherwise look like viscous friction. T_out is a recorded outside load as torque at the motor. The torque constant is the machine
file's, so J, Fc, Fv and G are known as products with it only; `torque_constants` splits them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import NamedTuple

import numpy as np

from twin.control.structures import is_fed_as_recorded
from twin.estimate.regression import Fit, regress
from twin.identify.axis_run import AxisRun, moved_inertia
from twin.identify.between_samples import (
    RIGID_RAD_PER_S,
    FastFit,
    FastLoop,
    Sawtooth,
    fast_loop_of,
    fit_fast_loop,
    missing_mean,
    sawtooth_of,
)
from twin.identify.recorded_axis import one_speed
from twin.machine.machine import Axis, Machine

FRICTIONS = ("coulomb_friction", "viscous_friction")
NAMES = ("inertia", *FRICTIONS, "gravity", "skew")
ROW_STRIDE = 4
"""One row every this many cycles. The filter passes 20 Hz, so rows 8 ms apart (2 ms cycle) keep all information."""

ITERATIONS = 4

LEAST_OF_INERTIA = 0.2
"""A smaller share of the control's inertia is not that of an axis."""

LAW_DEVIATION = 0.004
"""Relative standard deviation of the missing mean due to errors of the saw-tooth model: two masses, fixed damping (docs/identify_theory.md)."""


class Rows(NamedTuple):
    """Rows of a regression: columns (row, k), y (row,) [Nm], cluster, speed [rad/s], acceleration [rad/s2], position (row,)."""

    columns: np.ndarray
    y: np.ndarray
    clusters: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    position: np.ndarray
    known_load: np.ndarray  # the part of y that is a known outside load


def stacked(parts: Sequence[Rows]) -> Rows:
    """Rows of several runs concatenated; clusters of different runs stay separate."""
    apart = [p._replace(clusters=p.clusters + 100_000 * k) for k, p in enumerate(parts)]
    return Rows(*map(np.concatenate, zip(*apart)))


def linear_rows(axis: Axis, run: AxisRun, mean_current: np.ndarray, heavy: bool = True) -> Rows:
    """Rows of one run where the axis slides, both sides filtered. A single rotary axis gets gravity columns by its angle if `heavy`."""
    f = run.filtered
    turning = [f(np.cos(run.axis_position)), f(np.sin(run.axis_position))] if axis.kind == "rotary" and heavy else []
    columns = np.column_stack([f(run.acceleration), f(run.sliding_sign), f(run.speed), np.ones(len(run.speed)), f(run.jerk), *turning])
    return sliding_rows(run, columns, f(mean_current * axis.motor.torque_constant_nm_per_a + run.known_load))


def sliding_rows(run: AxisRun, columns: np.ndarray, y: np.ndarray) -> Rows:
    index = np.arange(0, len(y), ROW_STRIDE)
    index = index[run.sliding[index]]
    motion = (run.filtered(run.speed), run.filtered(run.acceleration), run.axis_position, run.filtered(run.known_load))
    return Rows(*(values[index] for values in (columns, y, run.strokes, *motion)))


@dataclass(frozen=True)
class Balance:
    """Torque balance of an axis, or of a rotary pair at its axes: names of the values, fit, and the rows of each motor."""

    names: tuple[str, ...]
    fit: Fit
    rows: dict[str, Rows]

    @property
    def paired(self) -> bool:
        """True for a rotary pair."""
        return len(self.rows) > 1

    def place(self, axis: Axis, name: str) -> tuple[int, float]:
        """Index in the fit of the inertia or a friction of one motor, and the factor from the value there to that at the motor."""
        if not self.paired:
            return self.names.index(name), 1.0
        return self.names.index(f"{name}_{axis.name}"), axis.ratio if name == "coulomb_friction" else axis.ratio**2


RIGID = math.inf, 0.0


def drive_train(axis: Axis, runs: Sequence[AxisRun], partners: Sequence[AxisRun | None]) -> tuple[float, float]:
    """Mode = sqrt(stiffness / load) [rad/s] and inertia of the load at the motor [kg m2] of the spring between motor and load; RIGID without one.

    From d = motor minus scale, in two regressions below the band where the axis slides:

        d = a / mode^2 + deflection by friction and gravity        -> mode
        d = (Kt i / r - Jm a) / k                                  -> stiffness k

    k follows from friction and gravity, so it does not depend on the part of i that the samples miss. load = k / mode^2.
    `partners`: the same runs of the other axis of a rotary pair; its position and acceleration also deflect the spring.
    """
    by_motion, by_torque = [], []
    for run, other in zip(runs, partners or [None] * len(runs)):
        if run.deflection is None or run.current is None:
            return RIGID
        f = run.filtered
        n = len(run.speed)
        pressed = [np.sign(run.speed), run.speed * axis.ratio, np.ones(n)]
        if axis.kind == "rotary":
            turning = [np.cos(run.axis_position), np.sin(run.axis_position)]
            pressed += turning
            if partners:
                its = (other.axis_position, other.acceleration) if other is not None else ()
                there, its_acceleration = [np.interp(run.middle, other.middle, x) for x in its] or [np.zeros(n)] * 2  # type: ignore[union-attr]
                pressed += [t * u for t in turning for u in (np.cos(there), np.sin(there))]
                pressed.append(its_acceleration)
        pressed.append(run.known_load)
        acceleration = f(run.acceleration * axis.ratio)
        torque = f(run.current * axis.motor.torque_constant_nm_per_a / axis.ratio)
        by_motion.append(sliding_rows(run, np.column_stack([acceleration, *(f(x) for x in pressed)]), f(run.deflection)))
        by_torque.append(sliding_rows(run, np.column_stack([torque, acceleration, np.ones(n)]), f(run.deflection)))
    motion, torques = stacked(by_motion), stacked(by_torque)
    if len(motion.y) < 50:
        return RIGID
    slow, soft = (regress(r.columns, r.y, r.clusters) for r in (motion, torques))
    a, k = slow.values[0], soft.values[0]
    if not (slow.seen[0] and soft.seen[0]) or a < max(4.0 * slow.deviations[0], RIGID_RAD_PER_S**-2) or k < 4.0 * soft.deviations[0]:
        return RIGID
    return float(a**-0.5), float(a / k * axis.ratio**2)


@dataclass
class MeanCurrent:
    """Mean currents of the runs of one axis; the model of its fast loop is updated when a better inertia is known."""

    machine: Machine
    axis: Axis
    reference: FastLoop
    sawtooth: Sawtooth | None
    samples_per_cycle: int
    fit: FastFit
    torque_weight: float

    @classmethod
    def start(
        cls,
        machine: Machine,
        axis: Axis,
        runs: Sequence[AxisRun],
        inertia: float,
        partners: Sequence[AxisRun | None] = (),
        torque_weight: float = 1.0,
    ) -> MeanCurrent:
        """Start with the machine file's gains and winding, and the drive train from motor and scale (`partners`: see drive_train).

        `torque_weight` multiplies the torque feedforward of the runs that use it.
        """
        mode, load = drive_train(axis, runs, partners)
        loop = replace(fast_loop_of(machine, axis, inertia), mode=mode, load=load)
        usable = [r for r in runs if r.speed_setpoint is not None and r.current_ripple is not None and r.speed_ripple is not None]
        noise = machine.noise(axis)
        sawtooth = None
        if any(r.sliding.any() for r in usable):
            sawtooth = sawtooth_of(
                ((np.array(_steps(axis, r, torque_weight)), np.array([r.current_ripple, r.speed_ripple]), r.sliding) for r in usable),
                (max(noise.current, 1e-3), max(noise.speed / axis.ratio, 1e-4)),
            )
        return cls(machine, axis, loop, sawtooth, usable[0].samples_per_cycle if usable else 1, FastFit(loop), torque_weight)

    def update(self, inertia: float) -> None:
        """Fit the fast loop again with a new inertia at the motor [kg m2], if it is a possible one."""
        if not (math.isfinite(inertia) and inertia > LEAST_OF_INERTIA * self.reference.inertia):
            return
        loop = replace(self.fit.loop, inertia=inertia)
        self.fit = FastFit(loop) if self.sawtooth is None else fit_fast_loop(loop, self.samples_per_cycle, self.sawtooth, self.reference)

    def of(self, run: AxisRun) -> np.ndarray | None:
        """Mean current (cycle,) of a run [A]; None without current."""
        return mean_of(self.fit.loop, run, self.torque_weight)

    @property
    def inertia_deviation(self) -> float:
        """Standard deviation of the inertia due to the fast loop [kg m2]: Kt Tp times that of the missing mean per step."""
        missing = float(missing_mean(self.fit.loop, self.samples_per_cycle)[0].sum())
        # of another loop nothing is known between the samples
        of_law = LAW_DEVIATION if is_fed_as_recorded(self.axis.loops, self.axis.blocks) else 1.0
        doubt = np.hypot(self.fit.mean_deviation, of_law * missing)
        return self.axis.motor.torque_constant_nm_per_a * self.machine.position_cycle * float(doubt)


def simulated_torque_weight(axis: Axis, run: AxisRun) -> float:
    """Weight of the torque feedforward where `Machine.with_feedforward` switches it on."""
    return axis.loops.torque_feedforward or float(run.feedforward == "velocity+torque")


def mean_of(loop: FastLoop, run: AxisRun, torque_weight: float) -> np.ndarray | None:
    """Mean current (cycle,) of a run [A] where the fast loop is known; None without current."""
    if run.current is None:
        return None
    g, f = missing_mean(loop, run.samples_per_cycle)
    speed, torque = _steps(loop.axis, run, torque_weight)
    return run.current + np.convolve(speed, g)[: len(speed)] + np.convolve(torque, f)[: len(torque)]


def _steps(axis: Axis, run: AxisRun, torque_weight: float) -> tuple[np.ndarray, np.ndarray]:
    """Steps (cycle,) of speed set point and torque feedforward at the start of each cycle; steps of the motor's speed if no set point is recorded."""
    speed = run.speed_setpoint if run.speed_setpoint is not None else np.diff(run.angle) / run.cycle
    return np.diff(speed, prepend=0.0), np.diff(torque_weight * run.torque_feedforward(axis), prepend=0.0)


LEAST_REACTION = 0.5
"""A drive must make up for at least this share of an outside load. If it does not, the recorded command already contains the load."""


def drive_reacts_to_load(rows: Rows) -> bool:
    """Does the drive make up for the known outside load? Also True without a load or if the rows do not determine it."""
    if not np.ptp(rows.known_load) > 0.0 or len(rows.y) < 2 * rows.columns.shape[1] + 10:
        return True
    fit = regress(np.column_stack([rows.columns, rows.known_load]), rows.y, rows.clusters)
    too_much, doubt = float(fit.values[-1]), fit.quantile * float(fit.deviations[-1])
    return not (fit.seen[-1] and too_much - doubt > 0.0 and too_much > LEAST_REACTION)


def fit_linear(runs: Sequence[AxisRun], current: MeanCurrent) -> Balance | None:
    """Balance of a single axis by NAMES, and by two factors of a weight that turns with it; the inertia's variance includes the fast loop's. None without usable rows.

    If the machine file has no gravity, weights are given along the path, and the balance gets no gravity columns. Inertia and viscous friction
    that the motion does not excite keep the values of the machine file; the intervals of the others hold without these values, too. No force above the
    largest recorded force is identified.
    """
    axis, heavy = current.axis, current.machine.gravity != 0.0
    parts = [linear_rows(axis, run, i, heavy) for run in runs if (i := current.of(run)) is not None]
    if not parts or sum(len(p.y) for p in parts) < 20:
        return None
    rows = stacked(parts)
    fit = joint = regress(rows.columns, rows.y, rows.clusters)
    may = (0, 2) if one_speed(rows.speed) is not None else (0,)
    kept = [i for i in may if fit.quantile * fit.deviations[i] > UNCERTAIN * abs(fit.values[i])]
    if kept:
        known = {0: axis.rotor_inertia_kg_m2 + moved_inertia(axis), 2: axis.viscous_friction_nm_s_per_rad}
        columns = rows.columns.copy()
        columns[:, kept] = 0.0
        fit = regress(columns, rows.y - sum(rows.columns[:, i] * known[i] for i in kept), rows.clusters)
    largest = max(float(np.abs(r.current).max()) for r in runs if r.current is not None) * axis.motor.torque_constant_nm_per_a
    names = (*NAMES, "gravity_cos", "gravity_sin")[: len(fit.values)]
    beyond = np.isin(names, ("coulomb_friction", "gravity")) & (np.abs(fit.values) > largest)
    covariance = fit.covariance.copy()
    if kept:
        covariance = np.where(np.isinf(covariance), np.inf, joint.covariance + np.diag((fit.values - joint.values) ** 2))
    covariance[0, 0] += current.inertia_deviation**2
    covariance[beyond, beyond] = np.inf
    return Balance(names, replace(fit, covariance=covariance, seen=fit.seen & ~beyond), {axis.name: rows})


UNCERTAIN = 0.3
"""A value that the motion hardly excites is not identified if its interval is wider than this share of it."""
