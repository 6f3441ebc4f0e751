"""The linear spring that a law of the drive train complements: its stiffness beside the law, a normal elasticity, and a spring in two stages.

The transmitted force is the motor force minus the inertia force of the rotor; over motor minus scale it gives the spring characteristic.
"""

from collections.abc import Sequence
from dataclasses import replace
import math

import numpy as np
from scipy.optimize import minimize_scalar

from twin.diagnose.fit import simulated_responses
from twin.diagnose.imperfections import SHARES
from twin.diagnose.law.closed_loop import AxisFit, ClosedLoop, Settings, is_between_encoders
from twin.diagnose.law.measure import RANGE, WINDUP_SLOPE, MeasuredCurve, cross_validated_loss, nuisances_in, scale_of
from twin.diagnose.law.residual import SPRING, Samples, residuals_of
from twin.diagnose.law.shapes import Described
from twin.diagnose.settings import T
from twin.diagnose.tolerance import Nuisance, drive_train_of, spring_of, with_added
from twin.effects import Setting, settings_of
from twin.effects.law import laws_in
from twin.errors import TwinError
from twin.machine.machine import Machine

STAGE_FORCES = (0.03, 0.9, 24)
"""A stiff stage begins between these fractions of the largest force; the third number is how many beginnings are tried."""


def with_fitted_spring(settings: Settings, machine: Machine, axis: str, law: Described, samples: Samples) -> Settings:
    """The settings with the spring stiffness that was fitted together with a law over the windup, and with the start value of its damping; unchanged for any other law."""
    spring = spring_of(settings, axis)
    if law.relation.variable != "windup" or spring is None:
        return settings
    stiffness = law.spring or _stiffness(samples, spring, np.column_stack([nuisances_in(samples), law.column]))
    return _with_stiffness(settings, machine, spring, stiffness)


def with_recorded_spring(loop: ClosedLoop, settings: Settings) -> Settings:
    """The settings with the stiffness of the axis' spring that the record shows: the slope of the transmitted force over the windup; unchanged if
    the record shows none, or if the machine with these settings cannot be simulated."""
    group, spring = loop.group, spring_of(settings, loop.axis)
    if spring is None:
        return settings
    try:
        blocks = residuals_of(group.views, lambda machine: with_added(machine, settings), loop.axis, group.mapper)
    except TwinError:
        return settings
    samples = next((s for s in blocks if s.block == SPRING), None)
    if samples is None:
        return settings
    return _with_stiffness(settings, group.machine, spring, _stiffness(samples, spring, nuisances_in(samples)))


def _stiffness(samples: Samples, spring: Setting, columns: np.ndarray) -> float:
    """Stiffness of a spring [N/m, Nm/rad] from a fit of these columns (sample, n) to what its force leaves of the transmitted force."""
    loss = cross_validated_loss(samples, columns, scale_of(samples.y, samples.sigma))
    return float(loss.coefficients[WINDUP_SLOPE]) + spring.parameters["stiffness"]


def _with_stiffness(settings: Settings, machine: Machine, spring: Setting, stiffness: float) -> Settings:
    """The settings with another stiffness of a spring and the start value of its damping; unchanged if it is not positive."""
    if not stiffness > 0.0:
        return settings
    values = {**spring.parameters, "stiffness": stiffness}
    values |= {p.name: p.fitted(machine, machine.axis(spring.axis), values) for p in spring.effect.parameters if p.fitted}
    return tuple(replace(s, parameters=values) if s is spring else s for s in settings)


def in_place_of_a_play(loop: ClosedLoop, effects: Settings) -> list[Setting]:
    """The softest normal spring of an axis, if one of its effects contains a spring; beside it, any characteristic of the drive train shows
    over the windup.
    """
    elastic = normal_springs(loop, [1.0]) if drive_train_of(effects, loop.axis) else []
    return [s for s in elastic if s.key not in {e.key for e in effects}]


def normal_springs(loop: ClosedLoop, shares: Sequence[float]) -> list[Setting]:
    """Springs of the axis with these shares of the largest normal elasticity; none without a tolerance."""
    machine, elasticity = loop.group.machine, Nuisance(loop.axis, "elasticity")
    applied = [
        elasticity.apply(machine, 1.0 + share * machine.parameter_tolerance) for share in shares if machine.parameter_tolerance > 0.0
    ]
    return [spring for of in applied if (spring := spring_of(settings_of(of), loop.axis))]


def with_normal_elasticity(loop: ClosedLoop, fitted: AxisFit) -> AxisFit:
    """The fit with the elasticity that the drive train of any axis has, if a law between the encoders of this axis leaves some of it visible.

    The law search may start from a rigid drive train: until the law was known, nothing separated the two.
    """
    axis, settings = loop.axis, fitted.settings
    between = any(s.axis == axis and is_between_encoders(s) for s in laws_in(settings))
    if not between or drive_train_of(settings, axis):
        return fitted
    started = [(*settings, spring) for spring in normal_springs(loop, SHARES)]
    # the law took the part of the elasticity that it can imitate, and gives it back in the fit
    tuning = fitted.fit.about.with_free(fitted.fit.columns)
    responses = simulated_responses(loop.group, started)
    losses = [math.inf if isinstance(r, TwinError) else tuning.loss(loop.group.residual - r) for r in responses]
    new = loop.refits(fitted, [started[int(np.argmin(losses))]])[0] if started else None
    return new if new is not None and new.cost + T.evidence < fitted.cost else fitted


def stage_over_force(samples: Samples, curve: MeasuredCurve) -> Described | None:
    """A drive train in two stages, measured as deflection over transmitted force; None if one stage explains it as well.

    A stiff stage is steep over the deflection, so that the noise of the encoders hides its stiffness there. Over the force F it is flat:
    d = F / k + a clip(F / F1, -1, 1) with the stiffness k of the stiff stage, which carries from F1 on. `curve` is the law over the windup.
    """
    force, d = samples.motion["transmitted_force"], samples.motion["windup"]
    reach = float(np.quantile(np.abs(force), 1.0 - RANGE))
    if not reach > 0.0:
        return None
    one = _deflection_fit(samples, force[:, None])

    def at(first: float) -> tuple[float, np.ndarray]:
        return _deflection_fit(samples, np.column_stack([force, np.clip(force / first, -1.0, 1.0)]))

    first = min(reach * np.geomspace(*STAGE_FORCES), key=lambda f: at(f)[0])
    first = float(minimize_scalar(lambda f: at(f)[0], bounds=(0.8 * first, 1.25 * first), method="bounded").x)
    loss, (compliance, lost) = at(first)
    predicts = 1.0 - loss / max(one[0], 1e-300)
    if not (compliance > 0.0 and lost > 0.0 and predicts > 0.0):
        return None
    stiffness, width = 1.0 / compliance, lost + first * compliance
    height = first - stiffness * width  # the soft stage carries F1 at the width
    column = height * np.clip(d / width, -1.0, 1.0)
    return Described(curve.relation, "stage", {"height": height, "width": width}, predicts, curve, column, spring=stiffness)


def _deflection_fit(samples: Samples, columns: np.ndarray) -> tuple[float, np.ndarray]:
    """Squared residual of the deflection after a fit of these columns (sample, n) and a zero in each run, and their coefficients."""
    runs = (samples.run[:, None] == np.unique(samples.run)).astype(float)
    norm = np.abs(columns).max(axis=0)
    everything = np.column_stack([columns / norm, runs])
    coefficients, *_ = np.linalg.lstsq(everything, samples.motion["windup"], rcond=None)
    residual = samples.motion["windup"] - everything @ coefficients
    return float(residual @ residual), coefficients[: columns.shape[1]] / norm
