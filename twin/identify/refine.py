"""The second route: refine parameters by Gauss-Newton on the closed-loop gap; every evaluation simulates the training runs in MuJoCo.

    min sum over axis, signal, cycle of (F(measured - simulated) / d)^2,     d: sensor noise after F, or the start's residual if larger

Signals are position, motor angle and mean current where the axis slides; F is the low-pass of the regressions. Above its band the mode of
the drive train and the saw-tooth between samples depend on parameters that are not refined here. At reversals, friction does.

Each axis is a part of the problem (`estimate.problem`): X, Y, Z and the pair A, C do not affect each other, so a step takes a dozen
simulations for any number of axes. They have no noise, because noise in the loop would affect the differences and bias the estimates. The
intervals come from clusters of CLUSTER_S, as in the regression. The search starts at the regression's machine, and the regression's
standard deviations are its prior.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
import math
import os

import numpy as np

from twin.errors import SimulationError
from twin.estimate.linearised import linearised
from twin.estimate.problem import Free, Residuals, Values, blocks_of
from twin.identify.axis_run import AxisRun, axis_run, low_pass_window
from twin.identify.between_samples import fast_loop_of
from twin.identify.direct import Runs
from twin.identify.drive_balance import ROW_STRIDE, MeanCurrent, mean_of, simulated_torque_weight
from twin.identify.products import is_vertical
from twin.machine.machine import Axis, Machine
from twin.machine.toleranced import TOLERANCED, field_value, inertia_of, path_of
from twin.recordings.campaign import MeasuredRun
from twin.simulation.gap import is_moving
from twin.simulation.plant_spec import home_inertia_at_motor
from twin.simulation.run import simulate
from twin.simulation.setpoints import recorded_setpoints

CLUSTER_S = 0.5
STEPS = 2
"""Number of Gauss-Newton steps; the start from the regression is close enough for linearisation."""

LARGEST_CHANGE, LARGEST_DELAY_CHANGE_S = 0.1, 2e-4
"""Largest change of a parameter in one step: relative, delays in seconds."""

SIGNALS = ("position", "motor angle", "current")
FLOOR = {"linear": (2e-8, 2e-8, 2e-3), "rotary": (1.2e-7, 1.2e-7, 2e-3)}
"""Model errors of SIGNALS [m or rad, A] (standard deviations), added to the sensors' noise."""

# field of the axis, its motor or loops, and the step of the difference quotient: relative, delays in seconds
FIELDS = {
    "rotor_inertia_kg_m2": 0.02,
    "coulomb_friction_nm": 0.01,
    "viscous_friction_nm_s_per_rad": 0.03,
    "position_gain_per_s": 0.005,
    "velocity_feedforward": 0.002,
    "position_delay_s": 2e-5,
    "torque_feedforward": 0.01,
}
# Gain and integral time of the speed loop keep the regression's values: in closed loop the fit would take a drive train's spring for them.
# Control values that the regression read from the control's own signals are not refined.


@dataclass(frozen=True)
class Refined:
    """The refined machine, standard deviations by 'axis.quantity', and the misfit (RMS in units of d) before and after."""

    machine: Machine
    deviations: dict[str, float]
    misfit: tuple[float, float]


def free_parameters(
    machine: Machine,
    runs: Sequence[MeasuredRun],
    prior: Mapping[tuple[str, str], float] | None = None,
    known: Collection[tuple[str, str]] = (),
) -> list[Free]:
    """The refined parameters by (axis, field): fields of an axis, its moving mass, or the mass of a body.

    Their values are changes from the machine, relative (delays in seconds). Control values in `known` (axis, field) stay as they are.
    """
    on = {w for r in runs for w in (r.feedforward or "velocity+torque").split("+")}  # unknown: simulated with the weights of the file
    moving = [
        a for a in machine.axes if a.actuator.electrical and any(a.name in r.trace.axes and is_moving(r.trace, a).any() for r in runs)
    ]
    out: list[tuple[str, str, float, tuple[str, ...]]] = []
    for field, step in FIELDS.items():
        if (field == "velocity_feedforward" and "velocity" not in on) or (field == "torque_feedforward" and "torque" not in on):
            continue
        out += [(a.name, _field_in_use(a, field), step, (a.name,)) for a in moving if _is_free(machine, a, field, known)]
    names = [a.name for a in moving]
    out += [
        (a.name, "moving_mass_kg", 0.01, (a.name,))
        for a in moving
        if a.rotor_inertia_kg_m2 > 0.0 and a.moving_mass_kg is not None and is_vertical(machine, a.name)
    ]
    if {"A", "C"} <= set(names) and {b.name for b in machine.bodies} >= {"cradle", "table", "workpiece"}:
        out += [("A", "body.cradle", 0.01, ("A",)), ("A", "body.table", 0.01, ("A", "C")), ("A", "body.workpiece", 0.01, ("A", "C"))]
    return [Free((a, f), 0.0, step, parts, deviation=(prior or {}).get((a, f), math.inf)) for a, f, step, parts in out]


def _field_in_use(axis: Axis, field: str) -> str:
    """The field that the axis uses instead of this one: without a rotor, the moving mass is the inertia."""
    return TOLERANCED[inertia_of(axis)] if field == TOLERANCED["rotor_inertia"] else field


def _is_free(machine: Machine, axis: Axis, field: str, known: Collection[tuple[str, str]]) -> bool:
    return _in_file(machine, axis, field) and not (hasattr(axis.loops, field) and (axis.name, field) in known)


def _in_file(machine: Machine, axis: Axis, field: str) -> bool:
    """Does the machine file contain this field? Optional delays may be missing."""
    return not hasattr(axis.loops, field) or field in machine.document["axis"][axis.name]["loops"]


def perturbed(machine: Machine, parameter: tuple[str, str], amount: float) -> Machine:
    """The machine with one parameter (axis, field) changed by `amount` (relative; delays in seconds)."""
    name, field = parameter
    if field.startswith("body."):
        return machine.with_body(field[5:], 1.0 + amount)
    axis = machine.axis(name)
    value = float(next(getattr(part, field) for part in (axis, axis.motor, axis.loops) if hasattr(part, field)))
    changed = max(value + amount, 0.0) if field.endswith("delay_s") else value * (1.0 + amount)
    # a change of the vertical axis' mass changes the weight only: the rotor compensates the inertia, which is a parameter of its own
    change = {field: changed}
    if field == "moving_mass_kg" and axis.rotor_inertia_kg_m2 > 0.0:
        change["rotor_inertia_kg_m2"] = axis.rotor_inertia_kg_m2 - (changed - value) * axis.ratio**2
    return machine.with_axis(name, **change)


def refined_machine(
    machine: Machine,
    runs: Sequence[MeasuredRun],
    measured: Runs,
    mean_current: Mapping[str, MeanCurrent],
    prior: dict[tuple[str, str], float],
    say: Callable[[str], None] | None = None,
) -> Refined:
    """Refine `machine` on the training runs.

    `measured`: the runs on the position cycles; `mean_current`: from the regression. `prior`: the regression's standard deviation by
    (axis, field), relative (delays in seconds); parameters without one have no prior. Raises SimulationError if the start diverges.
    """
    problem = _Refinement(machine, runs, measured, mean_current, free_parameters(machine, runs, prior, prior.keys()))
    blocks = blocks_of(problem.free)
    x: dict[Hashable, float] = {f.name: f.start for f in problem.free}
    base = problem.at(x)
    # a signal that exceeds its noise at the start counts by its residual there: otherwise unmodelled effects, such as the spring between
    # motor and scale, would distort the parameters
    levels = {(part, s): max(float(np.sqrt(np.mean(v**2))), 1.0) for part, own in base.items() for s, v in own.items()}
    misfits, deviations = [_misfit(base, levels)], {}
    for step in range(STEPS):
        for block, linear in zip(blocks, linearised(problem, blocks, x, base, lambda part, signal: levels[part, signal])):
            if linear is None:
                continue
            known = np.array([f.deviation for f in block.free])
            change, spread = linear.averaged(np.array([x[f.name] for f in block.free]), known)
            deviations.update(_spread_of(problem.machine_at(x), [f.name for f in block.free], spread))  # type: ignore[misc]
            for f, amount in zip(block.free, change):
                most = LARGEST_DELAY_CHANGE_S if f.name[1].endswith("delay_s") else LARGEST_CHANGE  # type: ignore[index]
                x[f.name] += float(np.clip(amount, -most, most))
        if say:
            say(f"refinement step {step + 1}: misfit {misfits[-1]:.3f}")
        base = problem.at(x)
        misfits.append(_misfit(base, levels))
    return Refined(_without_negative_friction(problem.machine_at(x)), deviations, (misfits[0], misfits[-1]))


def _misfit(residuals: Residuals, levels: Mapping[tuple[str, str], float]) -> float:
    rows = [v / levels[part, s] for part, own in residuals.items() for s, v in own.items()]
    return float(np.sqrt(np.mean(np.concatenate(rows) ** 2))) if rows else 0.0


@dataclass(frozen=True)
class _Seen:
    """One axis in one run: rows (row,), signals (3, cycle) with the scale in axis units, which of them are recorded, clusters (row,)."""

    rows: np.ndarray
    signals: np.ndarray
    present: tuple[bool, ...]
    clusters: np.ndarray


class _Refinement:
    """The problem: residuals of the training runs in units of noise, by axis and signal."""

    def __init__(
        self, machine: Machine, runs: Sequence[MeasuredRun], measured: Runs, currents: Mapping[str, MeanCurrent], free: Sequence[Free]
    ) -> None:
        self.machine, self.runs, self.free = machine, runs, free
        self.seen: dict[tuple[str, int], _Seen] = {}
        for name, several in measured.items():
            mean = currents.get(name)
            for k, run in enumerate(several):
                rows = np.flatnonzero(run.sliding)[::ROW_STRIDE] if run is not None else np.zeros(0, int)
                if run is not None and len(rows) > 10:
                    piece = np.arange(len(rows)) // max(1, round(CLUSTER_S / (ROW_STRIDE * run.cycle)))
                    self.seen[name, k] = _Seen(rows, *_filtered(run, mean.of(run) if mean is not None else None), 100_000 * k + piece)

    def machine_at(self, x: Values) -> Machine:
        """The machine with these changes."""
        machine = self.machine
        for f in self.free:
            machine = perturbed(machine, f.name, x[f.name]) if x[f.name] != 0.0 else machine  # type: ignore[arg-type]
        return machine

    def at(self, x: Values) -> Residuals:
        """Residuals at one point. Raises SimulationError if the simulation diverges."""
        found = self.residuals([x])[0]
        if found is None:
            raise SimulationError(
                "refinement: the simulation of the identified machine diverges on the recorded set points; use --no-refine and read the report"
            )
        return found

    def residuals(self, many: Sequence[Values]) -> list[Residuals | None]:
        machines = [self.machine_at(x) for x in many]
        inertias = [home_inertia_at_motor(m) for m in machines]
        with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
            tasks = [(m, i, k) for m, i in zip(machines, inertias) for k in range(len(self.runs))]
            done = list(pool.map(lambda task: self._of_run(*task), tasks))
        out: list[Residuals | None] = []
        for i in range(len(machines)):
            parts = done[i * len(self.runs) : (i + 1) * len(self.runs)]
            joined: dict[str, dict[str, list[np.ndarray]]] = {}
            for (name, signal), values in (item for part in parts if part is not None for item in part.items()):
                joined.setdefault(name, {}).setdefault(signal, []).append(values)
            whole = {name: {s: np.concatenate(v) for s, v in own.items()} for name, own in joined.items()}
            out.append(None if any(p is None for p in parts) else whole)
        return out

    def clusters(self, part: str) -> dict[str, np.ndarray]:
        own = [seen for (name, _), seen in self.seen.items() if name == part]
        signals = [s for i, s in enumerate(SIGNALS) if any(seen.present[i] for seen in own)]
        return {s: np.concatenate([seen.clusters for seen in own if seen.present[SIGNALS.index(s)]]) for s in signals}

    def _of_run(self, machine: Machine, inertias: np.ndarray, k: int) -> dict[tuple[str, str], np.ndarray] | None:
        """Residuals (row,) by axis and signal of one run; None if it diverges."""
        run = self.runs[k]
        try:
            setpoints = recorded_setpoints(run.trace, machine)
            trace = simulate(
                machine.with_feedforward(run.feedforward), setpoints, sample_period=run.trace.period, started_at=run.started_at
            ).trace
        except SimulationError:
            return None
        out = {}
        for axis, inertia in zip(machine.axes, inertias):
            seen = self.seen.get((axis.name, k))
            twin = axis_run(machine, axis, replace(run, trace=trace)) if seen is not None else None
            if seen is None or twin is None:
                continue
            signals, _ = _filtered(twin, mean_of(fast_loop_of(machine, axis, float(inertia)), twin, simulated_torque_weight(axis, twin)))
            noise = self.machine.noise(self.machine.axis(axis.name))
            quiet = float(np.sqrt(np.sum(low_pass_window(twin.cycle) ** 2)))  # factor of the filter on white noise
            d = np.hypot(quiet * np.array([noise.position, noise.position, noise.current]), FLOOR[axis.kind])
            scale = np.array([1.0, axis.ratio, 1.0]) / d
            for i in np.flatnonzero(seen.present):
                out[axis.name, SIGNALS[i]] = (seen.signals[i] - signals[i])[seen.rows] * scale[i]
        return out


def _filtered(run: AxisRun, current: np.ndarray | None) -> tuple[np.ndarray, tuple[bool, ...]]:
    signals = (run.position, run.angle[:-1], current)
    # relative to the start of the run: a constant would disturb the filter at the ends of the run
    filled = [run.filtered(s - s[0]) + s[0] if s is not None else np.zeros(len(run.speed)) for s in signals]
    return np.array(filled), tuple(s is not None for s in signals)


def _spread_of(machine: Machine, parameters: Sequence[tuple[str, str]], spread: np.ndarray) -> dict[str, float]:
    """Standard deviations in the names and units of the parameters."""
    out: dict[str, float] = {}
    for (name, field), d in zip(parameters, map(float, spread)):
        axis = machine.axis(name)
        mass = axis.moving_mass_kg or 0.0
        if field == "rotor_inertia_kg_m2":
            out[f"{name}.inertia"] = d * axis.rotor_inertia_kg_m2
        elif field in ("coulomb_friction_nm", "viscous_friction_nm_s_per_rad"):
            out[f"{name}.{field.rsplit('_nm', 1)[0]}"] = d * getattr(axis, field)
        elif field == "moving_mass_kg" and axis.rotor_inertia_kg_m2 == 0.0:
            out[f"{name}.inertia"] = d * mass * axis.ratio**2
        elif field == "moving_mass_kg":
            out[f"{name}.gravity_torque"] = d * mass * machine.gravity * axis.ratio
        elif field.startswith("body."):
            body = next(b for b in machine.bodies if b.name == field[5:])
            x, y, z = body.centre_of_mass_m
            moments = {"moment_y": y, "moment_z": z} if body.name == "cradle" else {"table_x": x, "table_y": y, "moment_z": z}
            for moment, arm in moments.items():
                out[f"A.{moment}"] = math.hypot(out.get(f"A.{moment}", 0.0), d * body.mass_kg * arm)
        else:
            out[f"{name}.loops.{field}"] = d * (1.0 if field.endswith("delay_s") else getattr(axis.loops, field))
    return out


def _without_negative_friction(now: Machine) -> Machine:
    """The refined machine with negative friction set to zero, and checked: the search may produce values that no machine file may have."""
    values: dict[str, object] = {}
    for axis in now.axes:
        for name in ("coulomb_friction", "viscous_friction"):
            if field_value(axis, name) < 0.0:
                values[path_of(axis, name)] = 0.0
    return now.with_values(values)
