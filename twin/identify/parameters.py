"""The table of identified parameters, each with intervals from the regression and from the fit in closed loop."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
import math

import numpy as np

from twin.control.structures import IN_FLOW, has_recorded_law
from twin.estimate.regression import NORMAL_95, Range
from twin.identify.axis_run import moved_inertia
from twin.identify.between_samples import is_hidden, sampled_inertia
from twin.identify.check_recording import Finding
from twin.identify.drive_balance import FRICTIONS, Balance
from twin.identify.drive_residuals import MODE, Fitted, search_of
from twin.identify.recorded_axis import effort_balance, strokes_of
from twin.identify.regressions import Regressions
from twin.identify.result import Parameter, words_of
from twin.identify.rotary_pair import FIRST_MOMENTS, MOMENTS, pair_of
from twin.identify.speed_control import NAMES as SPEED_NAMES
from twin.identify.torque_constants import Split, is_vertical
from twin.machine.axis import path_of
from twin.machine.keys import SMALLEST
from twin.machine.machine import Axis, Machine
from twin.machine.parameters import SPREAD, key_of, parameter
from twin.recordings.campaign import MeasuredRun
from twin.simulation.plant_spec import home_inertia_at_motor
from twin.units import in_words, plain

FIELDS = {name: SPREAD[name] for name in FRICTIONS} | {
    "inertia": SPREAD["rotor_inertia"],
    **dict.fromkeys(("constant_torque", "gravity_torque"), "constant_torque_nm"),
}
"""Identified number -> field of the axis with its unit, where the names differ."""


def parameters_of(machine: Machine, direct: Regressions, splits: dict[str, Split]) -> list[Parameter]:
    """All parameters of a regression in the order of the axes: control, mechanics at the motor, moments of the table at the axes."""
    return [p for axis in machine.axes for p in (*_control(machine, axis, direct), *_mechanics(machine, axis, direct, splits))]


def within_bounds(name: str, value: float) -> float:
    """The value of an identified number of a control that a machine file can hold."""
    bounds = parameter(name).bounds
    return float(np.clip(value if abs(value) >= SMALLEST else 0.0, bounds.low, bounds.high))


def _about(machine: Machine, axis: Axis, name: str) -> tuple[str, float, str]:
    """Unit of a parameter, its value in the machine file, and its path there; '' if the file does not have it as one number."""
    if name in MOMENTS and (pair := pair_of(machine)):
        unit = "kg m" if name in FIRST_MOMENTS else "kg m2"
        return unit, float(pair.numbers[pair.names.index(name)]), ""
    field = FIELDS.get(name, name)
    unit = axis.unit(parameter(field).unit(axis.drive))
    if name == "inertia":
        return unit, float(home_inertia_at_motor(machine)[machine.axis_names.index(axis.name)]), ""
    if name == "gravity_torque":
        return unit, (axis.moving_mass_kg or 0.0) * machine.gravity * axis.ratio, ""
    return unit, axis.number(field), machine.in_file(f"axis.{axis.name}.{key_of(field, axis.kind)}", 0.0)[0]


def _control(machine: Machine, axis: Axis, direct: Regressions) -> Iterator[Parameter]:
    """Position and speed controller of one axis."""
    for table in (direct.position, direct.speed, direct.drive_loop):
        block = table.get(axis.name)
        if block is None:
            continue
        for name, value in block.values.items():
            if not math.isfinite(block.half[name]):
                continue
            estimate = Range.around(value, block.half[name])
            bounded = Range.around(within_bounds(name, value), estimate.half)
            unit, before, path = _about(machine, axis, name)
            condition = getattr(block, "condition", 1.0)
            yield Parameter(axis.name, name, unit, before, estimate, bounded, False, condition, bounded.value != value, path)


def _mechanics(machine: Machine, axis: Axis, direct: Regressions, splits: dict[str, Split]) -> Iterator[Parameter]:
    """Inertia, friction and gravity of one axis; the moments of a rotary pair are listed with its outer axis."""
    if (balance := direct.balance_of(axis.name)) is None:
        return
    fit = balance.fit
    kt_log, kt_sd = splits[" ".join(balance.rows)].factors.get(path_of(axis, "torque_constant"), (0.0, 0.0))
    for name, i, factor in _places(machine, axis, balance):
        if not fit.seen[i] or not math.isfinite(fit.deviations[i]):
            continue
        found = Range.around(float(fit.values[i] * factor), float(fit.deviations[i] * fit.quantile * factor))
        # the value is the product at the most probable torque constant; the uncertainty of that constant is added
        split = found.value * math.exp(kt_log)
        value = Range.around(split, math.hypot(found.half, NORMAL_95 * kt_sd * abs(split)))
        unit, before, path = _about(machine, axis, name)
        at_bound = name in FRICTIONS and split <= 0.0
        yield Parameter(axis.name, name, unit, before, found, value, True, fit.condition, at_bound, path)


def _places(machine: Machine, axis: Axis, balance: Balance) -> list[tuple[str, int, float]]:
    """Name of each number of an axis, its index in the fit, and the factor from the value there."""
    out = [(name, *balance.place(axis, name)) for name in ("inertia", *FRICTIONS)]
    if not balance.paired:
        return [*out, ("gravity_torque" if is_vertical(machine, axis.name) else "constant_torque", *balance.place(axis, "gravity"))]
    return [*out, *((n, balance.names.index(n), 1.0) for n in MOMENTS)] if axis.name == next(iter(balance.rows)) else out


def with_drives(parameters: Sequence[Parameter], before: Machine, fits: Mapping[str, Fitted]) -> list[Parameter]:
    """The parameters with the values of the closed-loop fit, including those that the regression could not identify.

    Values that the fit could not identify are skipped.
    """
    out = {(p.axis, p.name): p for p in parameters}
    names = {SPREAD[name]: name for name in FRICTIONS} | {"constant_force": "constant_torque"}
    for axis_name, fit in fits.items():
        axis = before.axis(axis_name)
        for field, (value, half) in fit.items():
            if not math.isfinite(half):
                continue
            name = names.get(field, field)
            unit, start, path = _about(before, axis, name)
            factor = axis.ratio if field == "constant_force" else 1.0
            around = Range.around(value, half).times(factor)
            if not search_of(field).unit:  # the interval is that of the logarithm
                wide = math.exp(min(half / abs(value), 5.0))
                around = Range(value, value / wide, min(value * wide, search_of(field).high))
            if field == "inertia":  # that of the model's bodies is not in the machine file, so the fit does not change it
                carried = start - axis.rotor_inertia_kg_m2 - moved_inertia(axis)
                around = around.plus(carried)
            is_product = not hasattr(axis.loops, field) and field not in MODE
            new = Parameter(axis_name, name, unit, start, around, around, is_product, math.nan, False, path)
            out[axis_name, name] = replace(out.get((axis_name, name), new), refined=around)
    return list(out.values())


def covering_recording(parameters: Sequence[Parameter], machine: Machine, runs: Sequence[MeasuredRun]) -> list[Parameter]:
    """The parameters; behind an ideal actuator intervals of the mechanics cover those of the recording alone.

    Such a machine has no model of the drive: neither the time between a sample of an effort and its force nor what the control does between samples
    is known. `effort_balance` bounds both.
    """
    stated = {a.name: _of_recording(machine, a, runs) for a in machine.axes if not a.actuator.winding}

    out = []
    for p in parameters:
        if (other := stated.get(p.axis, {}).get(p.name)) is not None:
            refined = p.refined and p.refined.covering(other)
            p = replace(p, estimate=p.estimate.covering(other), value=p.value.covering(other), refined=refined)
        out.append(p)
    return out


def _of_recording(machine: Machine, axis: Axis, runs: Sequence[MeasuredRun]) -> dict[str, Range]:
    """Intervals at the motor of the mechanics that the recording of an axis gives without a model of its control."""
    own = [r for r in runs if r.trace.has(axis.name, axis.effort) and r.trace.measured_position(axis.name) and r.trace.moves(axis.name)]
    rows = strokes_of(own, axis.name) if own else None
    found = effort_balance(own, axis.name, axis.effort, rows, axis.kind) if rows is not None else None
    if found is None or found[0].against:
        return {}
    f, force = found[0], axis.motor.torque_constant_nm_per_a
    low, high = sampled_inertia(machine.sample_period) if is_hidden(machine, axis) else (1.0, 1.0)
    # what the recording does not split lies between none and all of its sum
    whole = Range(f.at_speed.value, 0.0, f.at_speed.high)
    values = {
        "coulomb_friction": (f.coulomb or whole).times(force),
        "viscous_friction": f.viscous.times(force * axis.ratio) if f.viscous else whole.times(force * axis.ratio / f.speed),
    }
    if f.inertia.known:  # the recording of a robot, whose weight moves with its other joints, says nothing of an inertia
        mass = Range(f.inertia.value, low * f.inertia.low, high * f.inertia.high)
        values["inertia"] = mass.times(force * axis.ratio)
    if f.constant is not None and f.gravity is None:
        name = "gravity_torque" if is_vertical(machine, axis.name) else "constant_torque"
        values[name] = f.constant.times(force)
    return values


def reconciled(parameters: Sequence[Parameter], hidden: Collection[str] = ()) -> tuple[list[Parameter], list[Finding]]:
    """The parameters, and a finding for each axis whose two routes to one number exclude each other.

    The regression needs no control, the fit in closed loop no noise-free regressors: both hold if the machine file has all that acts on the axis, and
    differ if it has not (Hausman's test of a specification). Then the value is that of the regression, which a wrong law of the control does not move, the
    interval covers both, and what the fit alone gives is not identified. On `hidden` axes, whose samples of the effort miss what the control does between
    them, the regression of the inertia does not hold, and tests nothing.
    """
    apart: dict[str, list[str]] = {}
    for p in parameters:
        holds = p.name != "inertia" or p.axis not in hidden
        if holds and p.refined is not None and (p.refined.low > p.value.high or p.refined.high < p.value.low):
            apart.setdefault(p.axis, []).append(in_words(p.name))
    out = []
    for p in parameters:
        if p.axis not in apart or p.refined is None:
            out.append(p)
        elif p.refined is not p.value:
            out.append(replace(p, refined=p.value.covering(p.refined)))
    text = "regression and fit in closed loop exclude each other in {}: the machine file lacks something that acts on the axis, or the law of its controller; the intervals cover both"
    return out, [Finding(text.format(", ".join(names)), axis) for axis, names in apart.items()]


WIDE_INTERVAL = 0.1
"""A parameter with a wider half interval than this fraction of its value gets a finding."""

REMEDIES = {p.name: p.seen_in for p in IN_FLOW if p.seen_in} | {
    "inertia": "accelerated moves",
    "coulomb_friction": "constant speeds in both directions",
    "viscous_friction": "constant speeds from creeping to rapid",
    "gravity_torque": "moves of the vertical axis in both directions",
    **dict.fromkeys(("moment_y", "moment_z"), "slow turns of A over its range"),
    **dict.fromkeys(("table_x", "table_y"), "turns of C at several tilts"),
}
"""The run that identifies a parameter."""

PREREQUISITES = {p.name: p.after for p in IN_FLOW if p.after}
"""If these parameters were identified but the first was not, the runs do not excite it although the signals are recorded."""


def implausible_currents(machine: Machine, direct: Regressions) -> dict[str, Finding]:
    """Axes whose inertia or Coulomb friction is significantly negative: their recorded current does not drive this motion."""
    out: dict[str, Finding] = {}
    for balance in direct.balance.values():
        fit = balance.fit
        for axis in balance.rows:
            for name in ("inertia", "coulomb_friction"):
                i, _ = balance.place(machine.axis(axis), name)
                if fit.seen[i] and fit.values[i] + fit.quantile * fit.deviations[i] < 0.0:
                    text = f"the {machine.axis(axis).effort} gives a negative {in_words(name)}, so it contradicts the motion and is not used; check the sign of the column"
                    text += ", and whether it is a force: what a valve is commanded is a speed"
                    out[axis] = Finding(text, axis)
    return out


def unidentified(machine: Machine, parameters: Sequence[Parameter]) -> list[Finding]:
    """Findings about parameters that the campaign does not identify well, with the run that would."""
    out = []
    for axis in machine.axes:
        found = {p.name: p for p in parameters if p.axis == axis.name}
        for name, cure in REMEDIES.items():
            p = found.get(name)
            cure = "4 samples in a cycle of the control" if name == "inertia" and is_hidden(machine, axis) else cure
            if p is not None:
                best = p.refined or p.estimate
                scale = abs(p.before) or abs(best.value)
                if best.half > WIDE_INTERVAL * scale > 0.0:
                    within = (
                        f"{100 * best.half / scale:.0f} %"
                        if best.half < scale
                        else f"{plain(best.low, 2, least=0.0)} to {plain(best.high, 2, least=0.0)} {p.unit}"
                    )
                    label = f"{words_of(name, axis.name)} only within {within}; add {cure} ('twin plan')"
                    out.append(Finding(label, axis.name))
            elif (name in PREREQUISITES and set(PREREQUISITES[name]) <= found.keys()) or (
                name in ("inertia", *FRICTIONS) and found.keys() & set(FRICTIONS)
            ):
                text = f"no run identifies {words_of(name, axis.name)}; add {cure} ('twin plan')"
                if name in SPEED_NAMES and not has_recorded_law(axis.loops, axis.blocks):
                    text = f"{words_of(name, axis.name)}: its regression does not hold for this speed controller; the file's value is kept"
                out.append(Finding(text, axis.name))
    return out
