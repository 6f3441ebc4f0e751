"""Normal imperfections of a group of axes: a drive train that gives, a contact that gives before it slides. Found, and put into its machine."""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import replace
import functools
import math

import numpy as np

from twin.diagnose.drive_train import with_drive_train
from twin.diagnose.observe import Group, Mapper, rebased
from twin.diagnose.settings import Thresholds
from twin.diagnose.tolerance import NORMAL, UNIFORM, Nuisance, tuned
from twin.diagnose.tuning import Trial, Tuning, trial_of, tuning_from
from twin.errors import TwinError
from twin.machine.machine import Machine

SHARES = (0.05, 0.2, 0.8)
"""Sizes at which a normal imperfection is tried, as shares of the largest that is normal: its answer is not in proportion."""

KINDS = {"slip": "slip", "elasticity": "drive train", "damping": "drive train"}
"""What normal imperfections belong to: those of one kind on an axis are left out together."""


def with_imperfections(tuning: Tuning, group: Group, machine: Machine, residual: np.ndarray, mapper: Mapper) -> Tuning:
    """The tuning with those normal imperfections that `residual` (row,) shows, each linear about its size there.

    Only where a channel asks for it: elasticity where motor and scale part (or, where only one of them was recorded, where that or the
    current shows more than noise), slip where the position does not follow.
    """
    if not tuning.nuisances:
        return tuning
    t = group.thresholds
    parameters = [i for i, n in enumerate(tuning.nuisances) if n.quantity not in NORMAL]
    plain = tuning_from([tuning.nuisances[i] for i in parameters], tuning.jacobian[:, parameters], tuning.spread, tuning.prior_weight)
    left = (residual - plain.jacobian @ plain.solve(residual)) / group.weights
    dirty = {(c.axis, c.name) for c in group.channels if not replace(c, residual=left[c.rows]).is_clean}
    cut = {c.axis for c in group.channels if c.name == "motor_minus_scale"}
    giving = [a for a in group.axes if dirty & ({(a, "motor_minus_scale")} if a in cut else {(a, "position"), (a, "current")})]
    wanted = [Nuisance(a, "elasticity", t) for a in giving] + [Nuisance(a, "slip", t) for a in group.axes if (a, "position") in dirty]
    current = plain
    for nuisance in wanted:
        trial = functools.partial(_at_share, current, group, machine, nuisance, residual, mapper)
        best = max((tried for share in SHARES if (tried := trial(share)) is not None), key=lambda tried: tried.gain, default=None)
        if best is None or not 0.0 < best.size < 1.0 or best.gain < t.imperfection_earned:
            continue
        if nuisance.quantity == "elasticity":
            current = with_drive_train(current, group, machine, nuisance.owner, best, residual, mapper)
        else:
            current = _with_slip(current, nuisance, best, trial, t)
    return current


def _with_slip(tuning: Tuning, slip: Nuisance, best: Trial, trial: Callable[[float], Trial | None], t: Thresholds) -> Tuning:
    """The tuning with slip as it answers at its own size."""
    for _ in range(2):
        better = trial(best.size)
        if better is None or better.gain < best.gain:
            break
        near = abs(better.size / best.size - 1.0) < t.slip_unchanged
        best = better
        if near:
            break
        if not 0.0 < best.size < 1.0 or best.gain < t.imperfection_earned:
            return tuning
    return tuning.with_column(slip, best.column)


def on_imperfect_machine(group: Group, tuning: Tuning, residual: np.ndarray, mapper: Mapper) -> tuple[Group, Tuning]:
    """Group and tuning about the machine with the normal imperfections that `residual` (row,) shows: an effect acts on that one.

    A force on a drive train that gives also winds it up; nothing of that is in a sum of both. Two stiff springs may ring together in the
    twin as no machine does, or not be simulated at all: then one of them is left out, one kind or all, whichever leaves least.
    """
    tuning = replace(tuning, base=np.zeros(len(tuning.nuisances)))
    theta, explained = tuning.solve(residual), group.residual - residual
    kinds = [(n.owner, KINDS.get(n.quantity, "")) for n in tuning.nuisances]

    def moved(left_out: Container[tuple[str, str]]) -> tuple[float, Group, Tuning]:
        kept = np.array([kind not in left_out for kind in kinds], bool)
        nuisances = [n for n, k in zip(tuning.nuisances, kept) if k]
        part = tuning if kept.all() else tuning_from(nuisances, tuning.jacobian[:, kept], tuning.spread, tuning.prior_weight)
        try:
            there, about = moved_to(group, part, theta[kept], mapper)
        except TwinError:
            return math.inf, group, part
        return about.loss(there.residual - explained), there, about

    best = moved(())
    if best[0] > (1.0 + group.thresholds.imperfect_worse) * tuning.loss(residual):
        normal = sorted({kind for kind in kinds if kind[1]})
        some = [[kind] for kind in normal] + [[k for k in normal if k[1] == name] for name in sorted({k[1] for k in normal})] + [normal]
        best = min([best, *(moved(left_out) for left_out in some)], key=lambda m: m[0])
    return best[1:]


def moved_to(rigid: Group, tuning: Tuning, theta: np.ndarray, mapper: Mapper) -> tuple[Group, Tuning]:
    """Group and tuning about the machine whose normal imperfections are a tuning (nuisance,) further, from the one without any."""
    normal = np.array([n.quantity in NORMAL for n in tuning.nuisances], bool)
    if not normal.any():
        return rigid, tuning
    base = np.where(normal, tuning.base + theta * tuning.spread, 0.0)
    return rebased(rigid, tuned(tuning.nuisances, base), mapper), replace(tuning, base=base)


def _at_share(
    tuning: Tuning, group: Group, machine: Machine, nuisance: Nuisance, residual: np.ndarray, mapper: Mapper, share: float
) -> Trial | None:
    """A nuisance simulated at this share of what is normal; None where it cannot be simulated."""
    try:
        answer = group.response(
            lambda m: nuisance.apply(m, 1.0 + share * machine.parameter_tolerance),
            axes=(nuisance.owner,),
            shaken=nuisance.quantity == "slip",
            mapper=mapper,
        )
    except TwinError:
        return None
    return trial_of(tuning, answer * (UNIFORM / share), residual)
