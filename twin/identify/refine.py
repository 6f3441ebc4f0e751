"""The second route: refine parameters by Gauss-Newton on the closed-loop gap; every evaluation simulates the training runs in MuJoCo.

    min sum over axis, signal, cycle of (F(measured - simulated) / d)^2,     d: sensor noise after F, or the start's residual if larger

Signals are position, motor angle and mean current where the axis slides; F is the low-pass of the regressions. Above its band the mode of
the drive train and the saw-tooth between samples depend on parameters that are not refined here. At reversals, friction does.

X, Y, Z and the pair A, C do not affect each other, so one simulation perturbs one parameter of every axis: a dozen simulations a step for
any number of axes. The simulations have no noise, because noise in the loop would affect the differences and bias the estimates. The
intervals come from clusters of CLUSTER_S, as in the regression. The search starts at the regression's machine, and the regression's
standard deviations are its prior. Both use the same data, so their information matrices are averaged, not added.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
import math
import os

import numpy as np

from twin.errors import SimulationError
from twin.identify.axis_run import AxisRun, axis_run, low_pass_window
from twin.identify.between_samples import fast_loop_of
from twin.identify.direct import Runs
from twin.identify.drive_balance import ROW_STRIDE, MeanCurrent, mean_of, simulated_torque_weight
from twin.identify.products import is_vertical
from twin.machine.machine import Axis, Machine
from twin.machine.toleranced import TOLERANCED, field_value, inertia_of, path_of
from twin.recordings.campaign import MeasuredRun
from twin.recordings.least_squares import RELATED
from twin.simulation.gap import is_moving
from twin.simulation.plant_spec import home_inertia_at_motor
from twin.simulation.run import simulate
from twin.simulation.setpoints import recorded_setpoints

CLUSTER_S = 0.5
STEPS = 2
"""Number of Gauss-Newton steps; the start from the regression is close enough for linearisation."""

FLOOR = {"linear": (2e-8, 2e-8, 2e-3), "rotary": (1.2e-7, 1.2e-7, 2e-3)}
"""Model errors of scale, motor position [m or rad] and current [A] (standard deviations), added to the sensors' noise."""

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
class FreeParameter:
    """One refined parameter: a field of an axis, its moving mass, or the mass of a body; `affects` names the axes whose signals change."""

    axis: str
    field: str
    step: float
    affects: tuple[str, ...]


@dataclass(frozen=True)
class Refined:
    """The refined machine, standard deviations by 'axis.quantity', and the misfit (RMS in units of d) before and after."""

    machine: Machine
    deviations: dict[str, float]
    misfit: tuple[float, float]


def free_parameters(machine: Machine, runs: Sequence[MeasuredRun], known: Collection[tuple[str, str]] = ()) -> list[list[FreeParameter]]:
    """Batches of parameters that one simulation may perturb together: no two in a batch affect the same axis.

    Control values in `known` (axis, field) stay as they are.
    """
    on = {w for r in runs for w in (r.feedforward or "velocity+torque").split("+")}  # unknown: simulated with the weights of the file
    moving = [
        a for a in machine.axes if a.actuator.electrical and any(a.name in r.trace.axes and is_moving(r.trace, a).any() for r in runs)
    ]
    batches = []
    for field, step in FIELDS.items():
        if (field == "velocity_feedforward" and "velocity" not in on) or (field == "torque_feedforward" and "torque" not in on):
            continue
        parameters = [FreeParameter(a.name, _field_in_use(a, field), step, (a.name,)) for a in moving if _is_free(machine, a, field, known)]
        batches += [parameters] if parameters else []
    names = [a.name for a in moving]
    weights = [
        FreeParameter(a.name, "moving_mass_kg", 0.01, (a.name,))
        for a in moving
        if a.rotor_inertia_kg_m2 > 0.0 and a.moving_mass_kg is not None and is_vertical(machine, a.name)
    ]
    pair = {"A", "C"} <= set(names) and {b.name for b in machine.bodies} >= {"cradle", "table", "workpiece"}
    first = weights + ([FreeParameter("A", "body.cradle", 0.01, ("A",))] if pair else [])
    if first:
        batches.append(first)
    if pair:
        batches += [[FreeParameter("A", f"body.{b}", 0.01, ("A", "C"))] for b in ("table", "workpiece")]
    return batches


def _field_in_use(axis: Axis, field: str) -> str:
    """The field that the axis uses instead of this one: without a rotor, the moving mass is the inertia."""
    return TOLERANCED[inertia_of(axis)] if field == TOLERANCED["rotor_inertia"] else field


def _is_free(machine: Machine, axis: Axis, field: str, known: Collection[tuple[str, str]]) -> bool:
    return _in_file(machine, axis, field) and not (hasattr(axis.loops, field) and (axis.name, field) in known)


def _in_file(machine: Machine, axis: Axis, field: str) -> bool:
    """Does the machine file contain this field? Optional delays may be missing."""
    return not hasattr(axis.loops, field) or field in machine.document["axis"][axis.name]["loops"]


def perturbed(machine: Machine, parameter: FreeParameter, amount: float) -> Machine:
    """The machine with one parameter perturbed by `amount` (relative; delays in seconds)."""
    if parameter.field.startswith("body."):
        name = parameter.field[5:]
        return machine.with_body(name, 1.0 + amount)
    axis = machine.axis(parameter.axis)
    value = float(next(getattr(part, parameter.field) for part in (axis, axis.motor, axis.loops) if hasattr(part, parameter.field)))
    changed = max(value + amount, 0.0) if parameter.field.endswith("delay_s") else value * (1.0 + amount)
    # a change of the vertical axis' mass changes the weight only: the rotor compensates the inertia, which is a parameter of its own
    change = {parameter.field: changed}
    if parameter.field == "moving_mass_kg" and axis.rotor_inertia_kg_m2 > 0.0:
        change["rotor_inertia_kg_m2"] = axis.rotor_inertia_kg_m2 - (changed - value) * axis.ratio**2
    return machine.with_axis(parameter.axis, **change)


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
    batches = free_parameters(machine, runs, prior.keys())
    names = machine.axis_names
    groups = [[n] for n in names if n not in ("A", "C")] + [[n for n in names if n in ("A", "C")]]
    groups = [g for g in groups if g and any(k.affects[0] in g for batch in batches for k in batch)]
    now, misfits, deviations = machine, [], {}
    seen = {n: [_measured_axis(r, mean_current.get(n)) if r is not None else None for r in measured[n]] for n in names if n in measured}
    so_far: dict[FreeParameter, float] = {}
    weights: dict[str, np.ndarray] = {}
    for step in range(STEPS + 1):
        last = step == STEPS
        variants = [now] if last else [now, *(_perturb_all(now, batch) for batch in batches)]
        residuals = _residuals(variants, runs, seen)
        if residuals[0] is None:
            raise SimulationError(
                "refinement: the simulation of the identified machine diverges on the recorded set points; use --no-refine and read the report"
            )
        if step == 0:
            weights = {n: _weights(pieces) for n, pieces in residuals[0].items()}
        residuals = [{n: [(weights[n] * p).ravel() for p in q] for n, q in r.items()} if r is not None else None for r in residuals]
        base = residuals[0]
        assert base is not None
        misfits.append(float(np.sqrt(np.mean(np.concatenate([v for axis in base.values() for v in axis]) ** 2))))
        if last:
            break
        updates: list[tuple[FreeParameter, float]] = []
        for group in groups:
            parameters = [
                (i, k) for i, batch in enumerate(batches) for k in batch if set(k.affects) & set(group) and residuals[i + 1] is not None
            ]
            rows = np.concatenate([v for n in group if n in base for v in base[n]])
            columns = np.zeros((len(rows), len(parameters)))
            for j, (i, k) in enumerate(parameters):
                other = residuals[i + 1]
                assert other is not None
                parts = [
                    (o - b) / k.step if n in k.affects else np.zeros_like(b) for n in group if n in base for o, b in zip(other[n], base[n])
                ]
                columns[:, j] = np.concatenate(parts)
            clusters = np.concatenate(
                [np.full(len(v), 1000 * names.index(n) + c) for n in group if n in base for c, v in enumerate(base[n])]
            )
            changed_so_far = np.array([so_far.get(k, 0.0) for _, k in parameters])
            doubt = np.array([prior.get((k.axis, k.field), math.inf) for _, k in parameters])
            change, spread = _gauss_newton(columns, rows, clusters, changed_so_far, doubt)
            updates += [(k, float(change[j])) for j, (_, k) in enumerate(parameters)]
            deviations.update(_spread_of(now, [k for _, k in parameters], spread))
        for parameter, amount in updates:
            limit = 2e-4 if parameter.field.endswith("delay_s") else 0.1
            kept = float(np.clip(amount, -limit, limit))
            now = perturbed(now, parameter, kept)
            so_far[parameter] = so_far.get(parameter, 0.0) + kept
        if say:
            say(f"refinement step {step + 1}: misfit {misfits[-1]:.3f}")
    return Refined(_without_negative_friction(now), deviations, (misfits[0], misfits[-1]))


def _perturb_all(machine: Machine, batch: Sequence[FreeParameter]) -> Machine:
    for parameter in batch:
        machine = perturbed(machine, parameter, parameter.step)
    return machine


@dataclass(frozen=True)
class MeasuredAxis:
    """Measured signals of one axis in one run: rows (cycle,), and filtered scale, motor position [axis units] and current [A] (k, cycle)."""

    rows: np.ndarray
    signals: np.ndarray
    present: tuple[bool, bool, bool]


def _measured_axis(run: AxisRun, current: MeanCurrent | None) -> MeasuredAxis:
    return MeasuredAxis(np.flatnonzero(run.sliding)[::ROW_STRIDE], *_filtered(run, current.of(run) if current is not None else None))


def _filtered(run: AxisRun, current: np.ndarray | None) -> tuple[np.ndarray, tuple[bool, bool, bool]]:
    signals = (run.position, run.angle[:-1], current)
    # relative to the start of the run: a constant would disturb the filter at the ends of the run
    filled = [run.filtered(s - s[0]) + s[0] if s is not None else np.zeros(len(run.speed)) for s in signals]
    return np.array(filled), tuple(s is not None for s in signals)  # type: ignore[return-value]


def _residuals(
    machines: Sequence[Machine], runs: Sequence[MeasuredRun], seen: Mapping[str, Sequence[MeasuredAxis | None]]
) -> list[dict[str, list[np.ndarray]] | None]:
    """For each machine: axis -> weighted residuals in pieces of CLUSTER_S, all signals of a piece together; None if it diverges."""
    inertias = [home_inertia_at_motor(m) for m in machines]
    tasks = [(m, i, k) for m, i in zip(machines, inertias) for k in range(len(runs))]

    def one(task: tuple[Machine, np.ndarray, int]) -> dict[str, list[np.ndarray]] | None:
        machine, inertia, k = task
        run = runs[k]
        try:
            trace = simulate(
                machine.with_feedforward(run.feedforward), recorded_setpoints(run.trace, machine), sample_period=run.trace.period,
                started_at=run.started_at,
            ).trace  # fmt: skip
        except SimulationError:
            return None
        twin = replace(run, trace=trace)
        out = {}
        for axis, j in zip(machine.axes, inertia):
            there = seen[axis.name][k] if axis.name in seen else None
            if there is not None and len(there.rows) > 10:
                out[axis.name] = _pieces(machines[0], machine, axis, twin, float(j), there)
        return out

    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
        done = list(pool.map(one, tasks))
    out: list[dict[str, list[np.ndarray]] | None] = []
    for i in range(len(machines)):
        parts = done[i * len(runs) : (i + 1) * len(runs)]
        if any(p is None for p in parts):
            out.append(None)
            continue
        joined: dict[str, list[np.ndarray]] = {}
        for part in parts:
            for axis_name, pieces in (part or {}).items():
                joined.setdefault(axis_name, []).extend(pieces)
        out.append(joined)
    return out


def _pieces(reference: Machine, machine: Machine, axis: Axis, twin: MeasuredRun, inertia: float, there: MeasuredAxis) -> list[np.ndarray]:
    """Weighted residuals of one axis in one run; weights from the reference machine, so that all variants share them."""
    run = axis_run(machine, axis, twin)
    assert run is not None
    signals, _ = _filtered(run, mean_of(fast_loop_of(machine, axis, inertia), run, simulated_torque_weight(axis, run)))
    rows = there.rows[there.rows < signals.shape[1]]
    noise = reference.noise(reference.axis(axis.name))
    quiet = float(np.sqrt(np.sum(low_pass_window(run.cycle) ** 2)))  # factor of the filter on white noise
    scale = np.array([1.0, axis.ratio, 1.0])
    d = np.hypot(quiet * np.array([noise.position, noise.position, noise.current]), FLOOR[axis.kind])
    use = np.flatnonzero(there.present)
    left = ((there.signals - signals) * scale[:, None] / d[:, None])[use][:, rows]
    piece = max(1, round(CLUSTER_S / (ROW_STRIDE * run.cycle)))
    return [left[:, i : i + piece] for i in range(0, len(rows), piece)]


def _weights(pieces: Sequence[np.ndarray]) -> np.ndarray:
    """Weights (signal, 1) that scale the residual RMS of each signal to 1 where it exceeds the noise at the start.

    Otherwise unmodelled effects, such as the spring between motor and scale, would distort the parameters.
    """
    left = np.sqrt(np.mean(np.concatenate(pieces, axis=1) ** 2, axis=1, keepdims=True))
    return 1.0 / np.maximum(left, 1.0)


def _gauss_newton(
    columns: np.ndarray, rows: np.ndarray, clusters: np.ndarray, so_far: np.ndarray, prior: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Newton change of the parameters and their standard deviations, both combined with the regression.

    `so_far`: change from the regression's machine up to now; `prior`: the regression's standard deviations (infinite: none). The covariance of
    the data comes from clusters, and the two estimates are weighted by their covariances. Huber weights limit the influence of single
    pieces, such as an axis about to stick.
    """
    length = np.linalg.norm(columns, axis=0)
    seen = (length > 0.0) & np.isfinite(length)
    change, spread = np.zeros(columns.shape[1]), prior.copy()
    if not seen.any():
        return change, spread
    scale = max(float(np.median(np.abs(rows))) * 1.48, 1e-9)
    weight = np.minimum(1.0, 3.0 * scale / np.maximum(np.abs(rows), 1e-12))
    x = columns[:, seen] / length[seen]
    bread = np.linalg.pinv((x * weight[:, None]).T @ x + 1e-10 * np.eye(int(seen.sum())), hermitian=True)
    found = -bread @ (x * weight[:, None]).T @ rows
    left = rows + x @ found
    _, group = np.unique(clusters, return_inverse=True)
    scores = np.zeros((int(group.max()) + 1, int(seen.sum())))
    np.add.at(scores, group, x * (weight * left)[:, None])
    covariance = RELATED**2 * bread @ (scores.T @ scores) @ bread / np.outer(length[seen], length[seen])
    information = np.linalg.pinv(covariance, hermitian=True)
    known = 0.5 * np.where(np.isfinite(prior[seen]), prior[seen], np.inf) ** -2.0
    information = 0.5 * information
    joined = np.linalg.pinv(information + np.diag(known), hermitian=True)
    change[seen] = joined @ (information @ (found / length[seen]) - known * so_far[seen])
    spread[seen] = np.sqrt(np.diag(joined))
    return change, spread


def _spread_of(machine: Machine, parameters: Sequence[FreeParameter], spread: np.ndarray) -> dict[str, float]:
    """Standard deviations in the names and units of the parameters."""
    out: dict[str, float] = {}
    for parameter, d in zip(parameters, spread):
        axis = machine.axis(parameter.axis)
        if parameter.field == "rotor_inertia_kg_m2":
            out[f"{parameter.axis}.inertia"] = float(d) * axis.rotor_inertia_kg_m2
        elif parameter.field == "coulomb_friction_nm":
            out[f"{parameter.axis}.coulomb_friction"] = float(d) * axis.coulomb_friction_nm
        elif parameter.field == "viscous_friction_nm_s_per_rad":
            out[f"{parameter.axis}.viscous_friction"] = float(d) * axis.viscous_friction_nm_s_per_rad
        elif parameter.field == "moving_mass_kg" and axis.rotor_inertia_kg_m2 == 0.0:
            out[f"{parameter.axis}.inertia"] = float(d) * (axis.moving_mass_kg or 0.0) * axis.ratio**2
        elif parameter.field == "moving_mass_kg":
            out[f"{parameter.axis}.gravity_torque"] = float(d) * (axis.moving_mass_kg or 0.0) * machine.gravity * axis.ratio
        elif parameter.field.startswith("body."):
            body = next(b for b in machine.bodies if b.name == parameter.field[5:])
            x, y, z = body.centre_of_mass_m
            moments = {"moment_y": y, "moment_z": z} if body.name == "cradle" else {"table_x": x, "table_y": y, "moment_z": z}
            for name, arm in moments.items():
                key = f"A.{name}"
                out[key] = math.hypot(out.get(key, 0.0), float(d) * body.mass_kg * arm)
        else:
            scale = 1.0 if parameter.field.endswith("delay_s") else getattr(axis.loops, parameter.field)
            out[f"{parameter.axis}.loops.{parameter.field}"] = float(d) * scale
    return out


def _without_negative_friction(now: Machine) -> Machine:
    """The refined machine with negative friction set to zero, and checked: the search may produce values that no machine file may have."""
    values: dict[str, object] = {}
    for axis in now.axes:
        for name in ("coulomb_friction", "viscous_friction"):
            if field_value(axis, name) < 0.0:
                values[path_of(axis, name)] = 0.0
    return now.with_values(values)
