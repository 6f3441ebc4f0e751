"""Start values of the linear spring that a law of the drive train complements: stiffness at small and at large deflection.

The transmitted force is the motor force minus the inertia force of the rotor; over motor minus scale it gives the spring characteristic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.diagnose.law.closed_loop import State
from twin.diagnose.law.measure import RANGE, WINDUP_SLOPE, cross_validated_loss, nuisances_in, scale_of
from twin.diagnose.law.residual import LEAST_SAMPLES, Samples, deflection_of, transmitted_force
from twin.diagnose.law.shapes import Described
from twin.diagnose.view import RunView
from twin.effects import Setting, check_setting
from twin.errors import InputError
from twin.machine.machine import Machine

SMALL_DEFLECTION, LARGE_DEFLECTION = 0.3, 0.6
"""Fractions of the largest deflection that bound small and large deflection."""

SPRING_EFFECT = "transmission_compliance"
"""Effect of the linear spring that a law over the windup complements."""


def with_rigid_drive_train(state: State, axis: str) -> State:
    """The state with a rigid drive train on an axis."""
    return replace(state, settings=tuple(s for s in state.settings if s.axis != axis or s.effect.block != "transmission"))


def with_fitted_spring(state: State, axis: str, law: Described, samples: Samples) -> State:
    """The state with the spring stiffness that was fitted together with a law over the windup; unchanged for any other law."""
    if law.candidate.variable != "windup":
        return state
    columns = np.column_stack([nuisances_in(samples), law.column])
    loss = cross_validated_loss(samples, columns, scale_of(samples.y, samples.sigma))
    more = float(loss.coefficients[WINDUP_SLOPE])
    changed = []
    for s in state.settings:
        stiffness = s.parameters.get("stiffness", 0.0) + more
        if (s.effect.name, s.axis) == (SPRING_EFFECT, axis) and stiffness > 0.0:
            s = replace(s, parameters={**s.parameters, "stiffness": stiffness})
        changed.append(s)
    return replace(state, settings=tuple(changed))


def springs_of(views: Sequence[RunView], axis: str, machine: Machine) -> list[Setting]:
    """Springs with the stiffness of a drive train at small and at large deflection."""
    deflection, force = [], []
    for view in views:
        own = view.machine.axis(axis)
        d, f = (of(view, own, view.trace) if view.moves(axis) else None for of in (deflection_of, transmitted_force))
        if d is not None and f is not None:
            deflection.append(d)
            force.append(f)
    if not deflection:
        return []
    d, f = np.concatenate(deflection), np.concatenate(force)
    reach = float(np.quantile(np.abs(d), 1.0 - RANGE))
    found = []
    for rows in (np.abs(d) < SMALL_DEFLECTION * reach, np.abs(d) > LARGE_DEFLECTION * reach):
        if rows.sum() > LEAST_SAMPLES:
            columns = np.column_stack([d[rows], np.sign(d[rows]), np.ones(rows.sum())])
            stiffness = float(np.linalg.lstsq(columns, f[rows], rcond=None)[0][0])
            try:
                found.append(check_setting({"name": SPRING_EFFECT, "axis": axis, "stiffness": stiffness}, machine, "a measured spring"))
            except InputError:  # no valid stiffness
                continue
    return found
