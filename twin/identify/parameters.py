"""The table of identified parameters, each with intervals from the regression, from the fit in closed loop and from the held-out motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math

import numpy as np

from twin.identify import tilting_pair
from twin.identify.direct import Direct
from twin.identify.drive_fit import DriveFits
from twin.identify.drive_residuals import MODE, RANGES, SLIP, TIMES
from twin.identify.findings import Finding
from twin.identify.products import Split, is_vertical
from twin.identify.result import Parameter, Range
from twin.machine.machine import Axis, Machine
from twin.machine.parameters import SPREAD, parameter
from twin.machine.toleranced import TOLERANCED, path_of
from twin.simulation.plant_spec import home_inertia_at_motor

LOOP_BOUNDS = {"position_delay_s": (0.0, 0.1), "feedforward_delay_s": (0.0, 0.1)}

FRICTIONS = ("coulomb_friction", "viscous_friction")
FIRST_MOMENTS = ("moment_y", "moment_z", "table_x", "table_y")


def parameters_of(machine: Machine, direct: Direct, other: Direct, splits: dict[str, Split]) -> list[Parameter]:
    """All parameters in the order of the axes: control, mechanics at the motor, moments of the table at the axes.

    `direct` is the regression on the training rows, `other` that on the held-out rows (empty: none).
    """
    out: list[Parameter] = []
    inertias = home_inertia_at_motor(machine)
    for k, axis in enumerate(machine.axes):
        out += _control(axis, direct, other)
        out += _mechanics(machine, axis, float(inertias[k]), direct, other, splits)
    return out


def units_of(axis: Axis) -> tuple[str, str, str]:
    """Units of inertia, Coulomb friction and viscous friction of an axis: at the motor, or at the axis of a direct drive."""
    inertia, coulomb, viscous = (parameter(SPREAD[name]).unit(axis.drive) for name in ("rotor_inertia", *FRICTIONS))
    return inertia, coulomb, viscous


def _around(value: float, half: float) -> Range:
    return Range(value, value - half, value + half)


def _control(axis: Axis, direct: Direct, other: Direct) -> list[Parameter]:
    """Position and speed controller of one axis."""
    out = []
    for blocks, others in ((direct.position, other.position), (direct.speed, other.speed)):
        block, check = blocks.get(axis.name), others.get(axis.name)
        for name, value in block.values.items() if block is not None else ():
            assert block is not None
            half = block.deviations[name] * block.quantile
            if not math.isfinite(half):
                continue
            low, high = LOOP_BOUNDS.get(name, (-math.inf, math.inf))
            aside = None
            if check is not None and math.isfinite(check.deviations[name]):
                aside = _around(check.values[name], check.deviations[name] * check.quantile)
            out.append(
                Parameter(
                    axis.name, name, parameter(name).unit(axis.drive), getattr(axis.loops, name), _around(value, half),
                    _around(float(np.clip(value, low, high)), half), False, block.condition, not low <= value <= high,
                    f"axis.{axis.name}.loops.{name}", aside,
                )
            )  # fmt: skip
    loop, check_loop = direct.drive_loop.get(axis.name), other.drive_loop.get(axis.name)
    if loop is not None and loop.closed_in_drive:
        aside = (
            _around(check_loop.delay_s, 1.96 * check_loop.delay_deviation)
            if check_loop is not None and check_loop.closed_in_drive
            else None
        )
        around = _around(loop.delay_s, 1.96 * loop.delay_deviation)
        path = f"axis.{axis.name}.loops.dsc_delay_s"
        out.append(Parameter(axis.name, "dsc_delay_s", "s", axis.loops.dsc_delay_s, around, around, False, 1.0, False, path, aside))
    return out


def _mechanics(machine: Machine, axis: Axis, inertia: float, direct: Direct, other: Direct, splits: dict[str, Split]) -> list[Parameter]:
    """Inertia, friction and gravity of one axis; the moments of a tilting table are listed with A. `inertia` is the machine file's."""
    key = next((k for k in direct.balance if axis.name in k.split()), None)
    if key is None:
        return []
    balance, check = direct.balance[key], other.balance.get(key)
    kt_log, kt_sd = splits[key].factors.get(path_of(axis, "torque_constant"), (0.0, 0.0)) if key in splits else (0.0, 0.0)
    out = []
    for inner, name, unit, factor, before in _rows_of(machine, axis, inertia, paired=key == "A C"):
        i = balance.names.index(inner)
        if not balance.fit.seen[i] or not math.isfinite(balance.fit.deviations[i]):
            continue
        value, half = (float(x * factor) for x in (balance.fit.values[i], balance.fit.deviations[i] * balance.fit.quantile))
        aside = None
        if check is not None and check.fit.seen[i] and math.isfinite(check.fit.deviations[i]):
            aside = _around(*(float(x * factor) for x in (check.fit.values[i], check.fit.deviations[i] * check.fit.quantile)))
        # the value is the product at the most probable torque constant; the uncertainty of that constant is added
        split = value * math.exp(kt_log)
        path = path_of(axis, name) if name in FRICTIONS else ""
        out.append(
            Parameter(
                axis.name, name, unit, before, _around(value, half), _around(split, math.hypot(half, 1.96 * kt_sd * abs(split))),
                True, balance.fit.condition, bool(path) and split <= 0.0, machine.in_file(path, 0.0)[0] if path else "", aside,
            )
        )  # fmt: skip
    return out


def _rows_of(machine: Machine, axis: Axis, inertia: float, paired: bool) -> list[tuple[str, str, str, float, float]]:
    """Name in the fit, name, unit, factor from the fit's unit to that of the table, value of the machine file."""
    r = axis.ratio
    # the values of the tilting pair are at the axes, those of a single axis at the motor
    suffix, once, twice = (f"_{axis.name}", r, r * r) if paired else ("", 1.0, 1.0)
    mass, force, damping = units_of(axis)
    out = [
        (f"inertia{suffix}", "inertia", mass, twice, inertia),
        (f"coulomb{suffix}", "coulomb_friction", force, once, axis.coulomb_friction_nm),
        (f"viscous{suffix}", "viscous_friction", damping, twice, axis.viscous_friction_nm_s_per_rad),
    ]
    if paired and axis.name == "A":
        numbers = dict(zip(tilting_pair.PAIR, tilting_pair.pair_numbers(machine)))
        out += [(n, n, "kg m" if n in FIRST_MOMENTS else "kg m2", 1.0, float(numbers[n])) for n in tilting_pair.PAIR[2:]]
    elif not paired and is_vertical(machine, axis.name):
        out.append(("gravity", "gravity_torque", force, 1.0, (axis.moving_mass_kg or 0.0) * machine.gravity * r))
    elif not paired:
        out.append(("gravity", "constant_torque", force, 1.0, axis.constant_torque_nm))
    return out


def with_drives(parameters: Sequence[Parameter], before: Machine, fits: DriveFits) -> list[Parameter]:
    """The parameters with the values of the closed-loop drive fit, including those that the regression could not identify.

    Values that the drive fit could not identify are skipped.
    """
    out = list(parameters)
    inertias = dict(zip(before.axis_names, home_inertia_at_motor(before)))
    for name, fit in fits.axes.items():
        axis = before.axis(name)
        r = axis.ratio
        turned = axis.rotor_inertia_kg_m2 + (axis.moving_mass_kg or 0.0) * r * r
        carried = (
            float(inertias[name]) - turned
        )  # inertia of the model's bodies: it is not in the machine file, so the fit does not change it
        mass, force, damping = units_of(axis)
        rows = {
            "inertia": ("inertia", mass, float(inertias[name]), 1.0, ""),
            TOLERANCED["coulomb_friction"]: (
                "coulomb_friction",
                force,
                axis.coulomb_friction_nm,
                1.0,
                path_of(axis, "coulomb_friction"),
            ),
            TOLERANCED["viscous_friction"]: (
                "viscous_friction",
                damping,
                axis.viscous_friction_nm_s_per_rad,
                1.0,
                path_of(axis, "viscous_friction"),
            ),
            "constant_force": ("constant_torque", force, axis.constant_torque_nm, r, f"axis.{name}.constant_torque_nm"),
        }
        for own in (SLIP, *MODE):
            p = parameter(own)
            rows[own] = (own, p.unit(axis.drive), float(getattr(axis, own)), 1.0, f"axis.{name}.{p.key(axis.drive)}")
        for field, value in fit.values.items():
            if field in fit.unidentified or not math.isfinite(fit.deviations[field]):
                continue
            label, unit, start, factor, path = rows.get(field) or (
                field,
                parameter(field).unit(axis.drive),
                float(getattr(axis.loops, field)),
                1.0,
                f"axis.{name}.loops.{field}",
            )
            half = 1.96 * fit.deviations[field] * factor
            around = _around(value * factor, half)
            if field not in ("constant_force", *TIMES):  # positive values: the interval is that of the logarithm
                wide = math.exp(min(half / abs(value * factor), 5.0))
                around = Range(value * factor, value * factor / wide, min(value * factor * wide, RANGES.get(field, (0.0, math.inf))[1]))
            if field == "inertia":
                around = Range(*(v + carried for v in (around.value, around.low, around.high)))
            known = next((i for i, p in enumerate(out) if (p.axis, p.name) == (name, label)), None)
            if known is None:
                is_product = field in rows and field not in MODE
                in_file = before.in_file(path, 0.0)[0] if path else ""
                out.append(Parameter(name, label, unit, start, around, around, is_product, math.nan, False, in_file, None, around))
            else:
                out[known] = replace(out[known], refined=around)
    return out


WIDE_INTERVAL = 0.1
"""A parameter with a wider half interval than this fraction of its value gets a finding."""

REMEDIES = {
    "velocity_feedforward": "a run with velocity feedforward on",
    "speed_gain_nm_s_per_rad": "runs that stay below the current limit",
    "torque_feedforward": "accelerations with torque feedforward on",
    "inertia": "accelerated moves",
    "coulomb_friction": "constant speeds in both directions",
    "viscous_friction": "constant speeds from creeping to rapid",
    "gravity_torque": "moves of the vertical axis in both directions",
    **dict.fromkeys(("moment_y", "moment_z"), "slow turns of A over its range"),
    **dict.fromkeys(("table_x", "table_y"), "turns of C at several tilts"),
}
"""The run that identifies a parameter."""

PREREQUISITES = {
    "velocity_feedforward": ("position_gain_per_s",),
    "speed_gain_nm_s_per_rad": ("position_gain_per_s", "inertia"),
    "torque_feedforward": ("speed_gain_nm_s_per_rad",),
}
"""If these parameters were identified but the first was not, the runs do not excite it although the signals are recorded."""


def implausible_currents(direct: Direct) -> dict[str, Finding]:
    """Axes whose inertia or Coulomb friction is significantly negative: their recorded current does not drive this motion."""
    out: dict[str, Finding] = {}
    for key, balance in direct.balance.items():
        fit = balance.fit
        for axis in key.split():
            for name, quantity in (("inertia", "inertia"), ("coulomb", "Coulomb friction")):
                i = next(k for k, n in enumerate(balance.names) if n in (name, f"{name}_{axis}"))
                if fit.seen[i] and fit.values[i] + fit.quantile * fit.deviations[i] < 0.0:
                    text = f"the current gives a negative {quantity}, so it contradicts the motion and is not used; check the sign of the column"
                    out[axis] = Finding("", axis, text)
    return out


def unidentified(machine: Machine, parameters: Sequence[Parameter]) -> list[Finding]:
    """Findings about parameters that the campaign does not identify well, with the run that would."""
    out = []
    for axis in machine.axes:
        found = {p.name: p for p in parameters if p.axis == axis.name}
        for name, cure in REMEDIES.items():
            p = found.get(name)
            if p is not None:
                scale = abs(p.before) or abs(p.estimate.value)
                if p.estimate.half > WIDE_INTERVAL * scale > 0.0:
                    label = f"{name} only within {100 * p.estimate.half / scale:.0f} %; add {cure} ('twin plan')"
                    out.append(Finding("", axis.name, label))
            elif (name in PREREQUISITES and set(PREREQUISITES[name]) <= found.keys()) or (
                name in ("inertia", *FRICTIONS) and found.keys() & set(FRICTIONS)
            ):
                out.append(Finding("", axis.name, f"no run identifies {name}; add {cure} ('twin plan')"))
    return out
