"""Normal imperfections of a group of axes: an elastic drive train, and slip before break-away. They are identified and added to its machine."""

from collections.abc import Callable, Collection, Container, Sequence
from dataclasses import replace
import functools
import math

import numpy as np

from twin.diagnose.channel import Scatter
from twin.diagnose.drive_train import with_drive_train
from twin.diagnose.noise import with_noise
from twin.diagnose.observe import Group, Variation
from twin.diagnose.settings import T
from twin.diagnose.simulations import Variant
from twin.diagnose.tolerance import NORMAL, UNIFORM, Nuisance, can_be_imperfect, tuned
from twin.diagnose.tuning import Trial, Tuning, trial_of
from twin.errors import TwinError
from twin.simulation.run import all_or_raise

SHARES = (0.05, 0.2, 0.8)
"""Trial sizes of a normal imperfection, as shares of the largest normal one; the response is not linear."""


def channels_above_noise(group: Group, residual: np.ndarray) -> set[tuple[str, str]]:
    """(axis, channel) where `residual` (row,), not weighted, exceeds noise. All channels of a ballbar: on a circle, reversals are few samples."""
    return {(c.axis, c.name) for c in group.channels if group.by_radius or not replace(c, residual=residual[c.rows]).is_clean}


def shows_slip(dirty: Collection[tuple[str, str]], axis: str) -> bool:
    """Does slip of an axis change one of these channels?"""
    return any((axis, name) in dirty for name in ("position", "velocity", "current"))


def with_imperfections(tuning: Tuning, group: Group, residual: np.ndarray) -> Tuning:
    """The tuning with the normal imperfections that `residual` (row,) contains, each linear about its size.

    An imperfection is tried only if a channel exceeds noise: elasticity in motor minus scale (in position or current if one of the two
    encoders was not recorded), slip in position, speed or current.
    """
    if not tuning.nuisances:
        return tuning
    parameters = [i for i, n in enumerate(tuning.nuisances) if not n.is_imperfection]
    plain = tuning.with_nuisances([tuning.nuisances[i] for i in parameters], tuning.jacobian.chosen(parameters))
    remaining = (residual - plain.jacobian.times(plain.solve(residual))) / group.weights
    above_noise = channels_above_noise(group, remaining)
    where = {a: ("motor_minus_scale",) if group.has(a, "motor_minus_scale") else ("position", "current") for a in group.axes}
    elastic = [a for a, channels in where.items() if any((a, channel) in above_noise for channel in channels)]
    shown = {"elasticity": elastic, "slip": [a for a in group.axes if shows_slip(above_noise, a)]}
    tried = [Nuisance(a, quantity) for quantity, axes in shown.items() for a in axes if can_be_imperfect(group.machine, a, quantity)]
    current = plain
    for nuisance in tried:
        trials = functools.partial(_at_shares, current, group, nuisance, residual)
        best = max(trials(SHARES), key=lambda trial: trial.gain, default=None)
        # a ballbar does not separate an elastic drive train from friction, so its elasticity may be larger
        largest = T.widest if nuisance.quantity == "elasticity" and group.by_radius else 1.0
        if best is None or not 0.0 < best.size < largest or best.gain < T.evidence:
            continue
        if nuisance.quantity == "elasticity":
            current = with_drive_train(current, group, nuisance.owner, best, residual, largest)
        else:
            current = _with_slip(current, nuisance, best, trials)
    return current


def _with_slip(tuning: Tuning, slip: Nuisance, best: Trial, trials: Callable[[Sequence[float]], list[Trial]]) -> Tuning:
    """The tuning with slip, linear about its size; unchanged if the size is not normal or has too little evidence."""
    for _ in range(2):
        better = next(iter(trials([best.size])), best)
        if better is best or better.gain < best.gain:
            break
        best = better
        if not 0.0 < best.size < 1.0 or best.gain < T.evidence:
            return tuning
    return tuning.with_column(slip, best.column)


def on_imperfect_machine(group: Group, tuning: Tuning, residual: np.ndarray) -> tuple[Group, Tuning]:
    """Group and tuning linearised about the machine with the normal imperfections that `residual` (row,) contains; effects act on that machine.

    A force on an elastic drive train also winds it up, which the sum of the two responses does not contain. Two stiff springs may ring together
    in the simulation as on no real machine, or be unstable. Then one imperfection, one kind or all are removed, whichever gives the smallest loss;
    an elasticity and its damping are one kind.
    """
    tuning = replace(tuning, base=np.zeros(len(tuning.nuisances)))
    theta, explained = tuning.solve(residual)[: len(tuning.nuisances)], group.residual - residual
    kinds = [(n.owner, NORMAL.get(n.quantity, "")) for n in tuning.nuisances]

    def moved(left_out: Container[tuple[str, str]]) -> tuple[float, Group, Tuning]:
        kept = np.array([kind not in left_out for kind in kinds], bool)
        nuisances = [n for n, k in zip(tuning.nuisances, kept) if k]
        part = tuning if kept.all() else tuning.with_nuisances(nuisances, tuning.jacobian.chosen(np.flatnonzero(kept).tolist()))
        try:
            there, about = moved_to(group, part, theta[kept])
        except TwinError:
            return math.inf, group, part
        return about.loss(there.residual - explained), there, about

    best = moved(())
    if best[0] > (1.0 + T.near_noise) * tuning.loss(residual):
        normal = sorted({kind for kind in kinds if kind[1]})
        some = [[kind] for kind in normal] + [[k for k in normal if k[1] == name] for name in sorted({k[1] for k in normal})] + [normal]
        best = min([best, *(moved(left_out) for left_out in some)], key=lambda m: m[0])
    return best[1:]


def moved_to(rigid: Group, tuning: Tuning, theta: np.ndarray) -> tuple[Group, Tuning]:
    """Group and tuning about the machine whose normal imperfections are increased by `theta` (nuisance,); `rigid` is the group without any."""
    normal = tuning.are_imperfections
    if not normal.any():
        return rigid, tuning
    base = np.where(normal, tuning.base + theta * tuning.spread, 0.0)
    return rebased(rigid, tuned(tuning.nuisances, base)), replace(tuning, base=base)


def _at_shares(tuning: Tuning, group: Group, nuisance: Nuisance, residual: np.ndarray, shares: Sequence[float]) -> list[Trial]:
    """A nuisance simulated at these shares of the largest normal size; sizes that cannot be simulated are omitted."""
    variations = [
        Variation(
            functools.partial(nuisance.apply, factor=1.0 + share * group.machine.parameter_tolerance),
            axes=(nuisance.owner,),
            shaken=nuisance.quantity == "slip",
        )
        for share in shares
    ]
    keys = [(nuisance, share) if share in SHARES else None for share in shares]  # each round of the search needs SHARES again
    answers = group.responses(variations, keys)
    return [trial_of(tuning, a * (UNIFORM / share), residual) for share, a in zip(shares, answers) if isinstance(a, np.ndarray)]


def rebased(group: Group, machine_of: Variant) -> Group:
    """The group about another machine: the same channels, residuals of that machine's nominal motion."""
    both = all_or_raise(group.responses([Variation(machine_of, shaken=shaken) for shaken in (False, True)]))
    quiet, noisy = (response / group.weights for response in both)
    nominal, shaken = [dict(of_run) for of_run in group.nominal], [dict(of_run) for of_run in group.shaken]
    channels = []
    for c in group.channels:
        key = c.axis, c.name
        nominal[c.run][key] = nominal[c.run][key] + quiet[c.rows]
        shift = quiet if c.name == "motor_minus_scale" else noisy  # the others differ between realisations of noise
        if c.name != "controller":  # its inputs are recorded
            shaken[c.run][key] = shaken[c.run][key] + noisy[c.rows]
            c = replace(c, residual=c.residual - shift[c.rows])
        channels.append(c)
    views = [replace(view, machine=machine_of(view.machine)) for view in group.views]
    return replace(group, views=views, channels=channels, nominal=nominal, shaken=shaken, answers={})


def with_noise_about(rigid: Group, group: Group, residual: np.ndarray) -> tuple[Group, Group]:
    """Both groups with the noise of each channel re-estimated for the machine of `group`, which has elastic drive trains. `residual` (row,) is
    what the tuning of `group` leaves, weighted.

    An elastic drive train rings with the noise in the loop; a rigid one does not. It also rings at each change of the set point. With a rigid
    twin this motion looks like a noisy sensor. The noise of the position is kept: it is slow, and the place to which the axis creeps is random
    on any machine.
    """
    seen = []
    for c in group.channels:
        if c.scatter is not None:
            key = (c.axis, c.name)
            rings = (group.shaken[c.run][key] - group.nominal[c.run][key]) - (rigid.shaken[c.run][key] - rigid.nominal[c.run][key])
            # between the encoders, a rigid drive train has sensor noise only
            jitter = c.scatter.jitter if c.name != "motor_minus_scale" else np.zeros(len(rings))
            scatter = c.scatter if c.name == "position" else Scatter(c.scatter.deviations + rings, jitter)
            c = with_noise(c, scatter, residual[c.rows] / c.weight, group.views[c.run])
        seen.append(c)
    plain = [replace(c, residual=r.residual) for c, r in zip(seen, rigid.channels)]
    return replace(rigid, channels=plain), replace(group, channels=seen)
