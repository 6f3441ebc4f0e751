"""Scores an identification against the true machine: errors and intervals by group of parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.estimate.regression import Range
from twin.identify.result import Identification
from twin.identify.rotary_pair import FIRST_MOMENTS, MOMENTS, pair_of
from twin.machine.machine import Machine

GROUPS = {
    "inertia": ("inertia",),
    "Coulomb": ("coulomb_friction",),
    "viscous": ("viscous_friction",),
    "table moments": FIRST_MOMENTS,
    "gravity torque": ("gravity_torque",),
    "delays": ("position_delay_s", "feedforward_delay_s"),
    "velocity feedforward": ("velocity_feedforward",),
    "torque feedforward": ("torque_feedforward",),
    "position gain": ("position_gain_per_s",),
    "speed gain": ("speed_gain_nm_s_per_rad",),
    "integral time": ("speed_integral_time_s",),
}
LIMITS = {
    "inertia": 0.005,
    "Coulomb": 0.01,
    "viscous": 0.03,
    "table moments": 0.01,
    "delays": 20e-6,
    "velocity feedforward": 0.002,
    "torque feedforward": 0.002,
}
"""Median errors allowed: relative, delays in seconds."""


@dataclass(frozen=True)
class Judged:
    """One parameter against the truth: group, relative error (delays: seconds), half interval, and whether it contains the truth."""

    axis: str
    name: str
    group: str
    error: float
    half: float
    holds: bool


def judge(result: Identification, truth: Machine, products: Sequence[str] = ()) -> list[Judged]:
    """Compare with the true machine: products with the torque constant for the axes in `products`, values for the others."""
    # the rotary axes alone: a drawn machine need not be one that can be built (its Y may weigh less than the X that it carries)
    pair = pair_of(truth.with_axes([axis.name for axis in truth.axes if axis.kind == "rotary"]))
    of_pair = {} if pair is None else dict(zip((*pair.axes, *MOMENTS), pair.numbers.tolist()))
    out = []
    for p in result.parameters:
        group = next((g for g, names in GROUPS.items() if p.name in names), None)
        if group is None:
            continue
        axis = truth.axis(p.axis)
        true = {
            "inertia": of_pair[p.axis] * axis.ratio**2
            if p.axis in of_pair
            else axis.rotor_inertia_kg_m2 + (axis.moving_mass_kg or 0.0) * axis.ratio**2,
            "coulomb_friction": axis.coulomb_friction_nm,
            "viscous_friction": axis.viscous_friction_nm_s_per_rad,
            "gravity_torque": (axis.moving_mass_kg or 0.0) * truth.gravity * axis.ratio,
        }.get(p.name)
        if p.name in MOMENTS:
            true = of_pair[p.name]
        if true is None:
            true = getattr(axis.loops, p.name)
        found: Range = p.value
        if p.product and p.axis in products:
            found = p.estimate
            true *= result.before.axis(p.axis).motor.torque_constant_nm_per_a / axis.motor.torque_constant_nm_per_a
        scale = 1.0 if group == "delays" else abs(true)
        error, half = float(found.value - true) / scale, found.half / scale
        out.append(Judged(p.axis, p.name, group, float(error), float(half), bool(found.low <= true <= found.high)))
    return out


def summary(judged: Sequence[Judged]) -> list[list[str]]:
    """Table rows: group, count, median error, limit, 95th percentile, share of intervals that contain the truth."""
    rows = []
    for group in GROUPS:
        items = [j for j in judged if j.group == group]
        if not items:
            continue
        errors = np.abs([j.error for j in items])
        unit, factor = ("us", 1e6) if group == "delays" else ("%", 100.0)
        limit = LIMITS.get(group)
        held = float(np.mean([j.holds for j in items]))
        cells = [
            f"{np.median(errors) * factor:.3g} {unit}",
            f"{limit * factor:g} {unit}" if limit else "-",
            f"{np.percentile(errors, 95) * factor:.3g} {unit}",
        ]
        bad = limit is not None and np.median(errors) > limit
        rows.append([group, str(len(items)), *cells, f"{100 * held:.1f} %", "MISSED" if bad else ""])
    held = float(np.mean([j.holds for j in judged])) if judged else 0.0
    rows.append(["all", str(len(judged)), "", "", "", f"{100 * held:.1f} %", "" if 0.90 <= held <= 0.99 else "MISSED"])
    return rows


HEADING = ["group", "count", "median error", "limit", "95th percentile", "coverage of intervals", ""]
