"""Which effects a group of axes has: screen all, fit the best, add one while it earns its place, try each removal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
import math

import numpy as np
import scipy.linalg

from twin.diagnose.candidates import Start, combine, is_scaled, is_spring, size_parameter, softened, starts_of
from twin.diagnose.fit import Fit, answer, fit_effects, no_effect, tuning_beside
from twin.diagnose.observe import Channel, Group
from twin.diagnose.tolerance import NORMAL
from twin.diagnose.tuning import PRIOR_WEIGHT, Tuning, beside, on_imperfect_machine, tuning_of, with_imperfections
from twin.effects import Setting
from twin.effects.change import load_inertia
from twin.errors import TwinError
from twin.machine import Machine

FOLDS = 3
"""Parts into which the runs are divided; each is predicted by a fit of the others."""

MOST_EFFECTS = 3
"""Effects that one group of axes can be found to have."""

EVIDENCE = 14.0
"""Log likelihood on runs left out, over re-tuning alone, that an effect must bring to be there."""

MOST_FITTED = 8
RIVALS_WITHIN, BENT_WITHIN = 0.25, 0.08
"""Screened candidates that are fitted in closed loop: those that reach this share of the best one's gain (less for effects
that are not in proportion to their size, which a start may underrate), at most so many."""

EVIDENCE_IN_SAMPLE = 60.0
"""The same where no run could be left out."""

ALONE = 0.99
"""Share of what is known of a parameter that one fold holds and from which the others cannot predict it."""

LEAST_SHARE = 0.3
"""Share that an effect must close of what the ones before left above noise: where much is left that no effect closes, small gains
are of a model that is not right, and stand for nothing."""

NEAR_NOISE = 0.02
"""Excess over noise up to which a residual counts as noise, and evidence alone decides."""

IMPERFECT = 2e-3
"""Share of what noise makes that faults of the twin, and imperfections without a law here, may imitate."""

STANDS_OUT = 1.3
"""Mean square over noise from which a single channel counts as not explained."""

DESCENTS = 200
"""Sweeps of the bounded least squares over a dozen parameters: more change nothing."""

QUIET = 1.2
"""Mean square over noise up to which a quick look leaves a channel alone."""

PRICE = 2.0
"""Log likelihood that each further free parameter costs."""

SOFTENED = (0.05, 2.0)
"""How much less or more than its start a spring may give in screening."""

SMALLEST, LARGEST = 0.12, 4.0
"""Sizes, as multiples of the usual range's lower and upper end, beyond which an effect is not believed."""


BEYOND_TOLERANCE = {"torque_constant": 2.0, "inertia": 2.0, "coulomb_friction": 3.0, "viscous_friction": 4.0}
"""Multiples of the tolerance from which a deviation is an effect: friction is what slip, lubrication and load change first."""

IMITATED = 5.0
"""Multiple of the tolerance up to which inertia is not believed on an axis whose drive train gives a little."""


@dataclass
class Candidate:
    """One effect on one axis, fitted together with what was accepted before; `evidence` is on runs left out."""

    fit: Fit
    evidence: float
    plausible: bool

    @property
    def setting(self) -> Setting:
        return self.fit.settings[-1]

    @property
    def key(self) -> tuple[str, str, str | None]:
        return self.setting.effect.name, self.setting.axis, self.setting.from_axis


@dataclass
class Found:
    """Result for one group: the final fit, every candidate of the first round, and what is left."""

    group: Group  # about the machine with its normal imperfections
    rigid: Group  # about the machine as its file says
    tuning: Tuning
    fit: Fit
    retuned: Fit
    inflation: float
    rounds: list[list[Candidate]] = field(default_factory=list)
    screened: list[tuple[tuple[str, str, str | None], float, Setting]] = field(default_factory=list)
    answers: dict[str, tuple[np.ndarray, np.ndarray]] = field(
        default_factory=dict, repr=False
    )  # simulated answers of starts, for later rounds

    def tuned_about(self, tuning: Tuning) -> None:
        """Take another tuning; what was simulated before is remembered with it."""
        self.tuning = tuning
        self.answers = {key: tuning.remembered(column) for key, (column, _) in self.answers.items()}


def search(
    group: Group,
    machine: Machine,
    folds: Sequence[Sequence[int]],
    mapper: Callable,  # type: ignore[type-arg]
    progress: Callable[[str], None],
    quick: bool = False,
) -> Found:
    """Forward selection with refit of all accepted effects, then removals."""
    rigid = group
    tuning = with_imperfections(tuning_of(group, machine, mapper), group, machine, group.residual, mapper)
    group, tuning = on_imperfect_machine(group, tuning, group.residual)
    retuned = no_effect(group, tuning)
    found = Found(group, rigid, tuning, retuned, retuned, _inflation(group, retuned))
    while len(found.fit.settings) < MOST_EFFECTS and not (quick and is_quiet(found)):
        candidates = _round(found, machine, folds, mapper, progress, quick)
        found.rounds.append(candidates)
        best = next((c for c in candidates if c.plausible), None)
        if best is None or best.evidence < evidence_needed(found, folds) or not _closes_enough(found, best.fit):
            break
        first = not found.fit.settings
        _accept(found, best.fit, machine, mapper)
        if first and found.retuned.loss - found.fit.loss < evidence_needed(found, folds):
            found.fit = found.retuned  # what is normal, seen better, explains it as well
            found.tuned_about(found.retuned.about)
            break
    _try_removals(found, machine, folds)
    return found


def _accept(found: Found, fit: Fit, machine: Machine, mapper: Callable) -> None:  # type: ignore[type-arg]
    """Take an effect; what is normal besides it is seen better now, and fitted with it."""
    left = found.rigid.residual - fit.response
    tuning = with_imperfections(found.tuning, found.rigid, machine, left, mapper)
    group, tuning = on_imperfect_machine(found.rigid, tuning, left)
    again = fit_effects(group, machine, tuning, fit.settings, 2) if group is not found.group else None
    if again is not None:
        fit, found.group, found.retuned = again, group, no_effect(group, tuning)
        found.tuned_about(tuning)
    if fit.loss > (1.0 + NEAR_NOISE) * expected_loss(found.group):
        tuning = tuning_beside(found.group, fit, mapper)
        again = fit_effects(found.group, machine, tuning, fit.settings, 2)
        if again is not None and again.loss < fit.loss:
            fit = again
            found.tuned_about(tuning)
    found.fit = fit
    found.inflation = _inflation(found.group, fit)


def evidence_needed(found: Found, folds: Sequence[Sequence[int]]) -> float:
    """Evidence that an effect must bring: the more was measured, the more of it a small fault of the model can imitate."""
    least = EVIDENCE if len(folds) > 1 else EVIDENCE_IN_SAMPLE
    return least + IMPERFECT * expected_loss(found.group)


def _closes_enough(found: Found, fit: Fit) -> bool:
    left = unexplained(found)
    return left < NEAR_NOISE * expected_loss(found.group) or found.fit.loss - fit.loss > LEAST_SHARE * left


def unexplained(found: Found) -> float:
    """Half the squares above noise that a fit leaves, in all or in single channels that stand out: what it does not know."""
    standing_out = 0.0
    for c, u in settled_channels(found):
        if len(u) and float(np.mean(u**2)) > STANDS_OUT:
            standing_out += 0.5 * float(np.sum(u**2) - len(u)) / c.correlation
    return max(excess_of(found.group, found.fit), standing_out)


def settled_channels(found: Found) -> Iterator[tuple[Channel, np.ndarray]]:
    """Every channel with what the fit leaves of it over noise, where nothing shows any more how the axis was stuck (sample,)."""
    group = found.group
    left = found.fit.left(group) / group.weights
    for c in group.channels:
        yield c, (left[c.rows] / c.sigma)[c.settled(group.views[c.run])]


def excess_of(group: Group, fit: Fit) -> float:
    """Half the squares above noise that a fit leaves; where an axis was stuck they count as little as for evidence."""
    left = fit.left(group)
    noise = sum(float(group.credit[c.rows].sum()) / c.correlation for c in group.channels)
    return 0.5 * (float(group.credit @ left**2) - noise)


def expected_loss(group: Group) -> float:
    """Half the squares that noise alone makes."""
    return 0.5 * sum(len(c.residual) / c.correlation for c in group.channels)


def is_quiet(found: Found) -> bool:
    """Does re-tuning alone leave nothing but noise in every channel?"""
    group = found.group
    left = found.fit.left(group) / group.weights
    channels = [replace(c, residual=left[c.rows]) for c in group.channels]
    return all(c.is_clean if c.name == "controller" else float(np.mean((c.residual / c.sigma) ** 2)) < QUIET for c in channels)


def _round(found: Found, machine: Machine, folds, mapper, progress, quick) -> list[Candidate]:  # type: ignore[no-untyped-def]
    group, tuning = found.group, found.tuning
    accepted = found.fit.settings
    residual = group.residual - found.fit.response
    left = residual - tuning.jacobian @ tuning.solve(residual)
    taken = {(s.effect.name, s.axis, s.from_axis) for s in accepted}
    starts = [s for s in starts_of(group, machine, left) if s.key not in taken and not _is_ruled_out(group, s)]
    progress(f"{'+'.join(group.axes)}: screening {len(starts)} settings")
    target = tuning.remembered(residual)
    gains = list(mapper(lambda s: _screen(found, s, target), starts))
    best: dict[tuple[str, str, str | None], tuple[float, Setting]] = {}
    for start, screened in zip(starts, gains):
        if screened is not None and screened[0] > best.get(start.key, (0.0,))[0]:
            best[start.key] = screened
    order = sorted(best.items(), key=lambda item: -item[1][0])
    if not found.rounds:
        found.screened = [(key, gain, setting) for key, (gain, setting) in order]
    if not order or order[0][1][0] < EVIDENCE * 0.5:
        order = order[:1]
    most = 3 if quick else MOST_FITTED
    top = order[0][1][0] if order else 0.0
    near = [item for i, item in enumerate(order) if i < 2 or item[1][0] > (RIVALS_WITHIN if _is_linear(item[1][1]) else BENT_WITHIN) * top]
    chosen = near[:most]
    progress(f"{'+'.join(group.axes)}: fitting {', '.join(f'{k[0]} {k[1]}' for k, _ in chosen[:3])} ...")
    fits = list(mapper(lambda item: fit_effects(group, machine, tuning, [*accepted, item[1][1]], 2 if quick else 4), chosen))
    base, healthy = held_out_loss(found, found.fit, folds), loss_within(found, found.fit, machine.parameter_tolerance)
    candidates = []
    for fit in fits:
        if fit is None:
            continue
        # on runs left out, and not more than the drop on all runs pays for its parameters, whatever machine within the tolerance it is
        drop = min(found.fit.loss - fit.loss, healthy - loss_within(found, fit, machine.parameter_tolerance))
        gain = min(base - held_out_loss(found, fit, folds), drop - PRICE * (len(fit.free) - len(found.fit.free)))
        evidence = gain / min(found.inflation, _inflation(group, fit))
        last = fit.settings[-1]
        candidates.append(Candidate(fit, evidence, is_plausible(last, machine) and not _is_imitated(found, last, machine)))
    return sorted(candidates, key=lambda c: -(c.evidence - (0.0 if c.plausible else 1e9)))


def _is_ruled_out(group: Group, start: Start) -> bool:
    """An effect that must show in a cut channel which is clean on its axis: the block's own law holds, whatever else is wrong."""
    channel = SHOWS_IN.get(start.effect.block)
    mine = [c for c in group.channels if c.axis == start.axis and c.name == channel]
    return bool(mine) and all(c.is_clean for c in mine)


SHOWS_IN = {"position controller": "controller", "transmission": "windup", "measurement": "windup"}
"""The cut channel in which every effect of a block shows."""


def _is_linear(setting: Setting) -> bool:
    size = size_parameter(setting.effect)
    return is_scaled(size) and setting.effect.name != "backlash"


def _screen(found: Found, start: Start, target: tuple[np.ndarray, np.ndarray]) -> tuple[float, Setting] | None:
    """Gain of a start (half the drop of the squares) with its size scaled linearly, and the setting it stands for."""
    tuning = found.tuning
    try:
        columns = [_remembered_answer(found, s) for s in start.settings]
    except TwinError:
        return None
    setting = start.settings[0]
    size = size_parameter(start.effect)
    inner = np.array([[tuning.product(a, b) for b in columns] for a in columns])
    with_target = np.array([tuning.product(c, target) for c in columns])
    if not np.all(np.isfinite(inner)) or not np.all(np.diag(inner) > 1e-9):
        return None
    if is_spring(start.effect):
        share = float(np.clip(with_target[0] / inner[0, 0], *SOFTENED))
        return share * float(with_target[0] - 0.5 * share * inner[0, 0]), softened(start, found.group.views[0].machine, share)
    if not is_scaled(size):
        return float(with_target[0] - 0.5 * inner[0, 0]), setting
    sizes = np.linalg.solve(inner + 1e-12 * np.eye(len(inner)), with_target)
    if len(sizes) == 1:
        neutral = size.neutral or 0.0
        deviation = setting.parameters[size.name] - neutral
        low, high = (size.low - neutral) / deviation, (size.high - neutral) / deviation
        sizes = np.clip(sizes, max(min(low, high), -4.0), min(max(low, high), 4.0))
        if size.low >= neutral and size.name != "factor":
            sizes = np.maximum(sizes, 0.02)
    scaled = combine(start, sizes.tolist())
    return float(sizes @ with_target - 0.5 * sizes @ inner @ sizes), scaled


def _remembered_answer(found: Found, setting: Setting) -> tuple[np.ndarray, np.ndarray]:
    key = repr(setting.table())
    if key not in found.answers:
        found.answers[key] = found.tuning.remembered(answer(found.group, [setting]).astype(np.float32))
    return found.answers[key]


def retuned_within(found: Found, tolerance: float) -> Fit:
    """Re-tuning alone with every parameter inside +-tolerance."""
    return replace(found.retuned, tuning=bounded(found.retuned.about, found.group.residual, found.retuned.tuning, tolerance))


def bounded(tuning: Tuning, residual: np.ndarray, start: np.ndarray, tolerance: float, weight: float = PRIOR_WEIGHT) -> np.ndarray:
    """Tuning (nuisance,) that fits a residual best inside +-tolerance: bounded least squares by coordinate descent."""
    if not tuning.nuisances:
        return start
    bound = tolerance / tuning.spread
    slope = tuning.jacobian.T @ residual
    normal = tuning.normal + (weight - PRIOR_WEIGHT) * np.eye(len(start))
    theta = np.clip(start, -bound, bound)
    for _ in range(DESCENTS):
        for i in range(len(theta)):
            step = (slope[i] - normal[i] @ theta) / normal[i, i]
            theta[i] = min(max(theta[i] + step, -bound), bound)
    return theta


def loss_within(found: Found, fit: Fit, tolerance: float) -> float:
    """Half the squares that a fit leaves when the nuisances cost nothing inside the tolerance and cannot leave it."""
    residual = found.group.residual - fit.response
    theta = bounded(fit.about, residual, fit.tuning, tolerance, weight=1.0)
    left = residual - fit.about.jacobian @ theta
    return 0.5 * float(found.group.credit @ left**2)


def held_out_loss(found: Found, fit: Fit, folds: Sequence[Sequence[int]]) -> float:
    """Half the squares on runs left out, each fold predicted by the fit without it.

    With X = [columns, jacobian], N = X'X + prior, r the residual at the optimum: leaving out rows f moves the optimum by
    -(N - X_f'X_f)^-1 X_f' r_f, so that the residual left out is r_f + X_f (N - X_f'X_f)^-1 X_f' r_f.
    """
    group = found.group
    x, normal, r = _linear(group, fit)
    loss = 0.0
    for fold in folds:
        rows = _rows_of(group, fold)
        if not rows.size:
            continue
        xf, rf = x[rows], r[rows]
        information = xf.T @ xf
        if len(folds) > 1:
            if _knows_alone(information, normal, fit):
                loss += EVIDENCE_IN_SAMPLE - EVIDENCE
            else:
                rf = rf + xf @ np.linalg.lstsq(normal - information, xf.T @ rf, rcond=None)[0]
        loss += 0.5 * float(group.credit[rows] @ np.minimum(rf**2, _OUTLIER * np.maximum(1.0, rf**2) ** 0.5))
    return loss


def _linear(group: Group, fit: Fit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A fit about its optimum: X = [columns, jacobian], N = X'X + prior, and the residual r."""
    x = beside(fit.columns, fit.about.jacobian)
    prior = np.diag([1e-6] * fit.columns.shape[1] + [PRIOR_WEIGHT] * len(fit.tuning))
    return x, x.T @ x + prior, fit.left(group)


def _rows_of(group: Group, fold: Sequence[int]) -> np.ndarray:
    return np.concatenate([np.arange(c.rows.start, c.rows.stop) for c in group.channels if c.run in fold] or [np.zeros(0, int)])


def _knows_alone(information: np.ndarray, normal: np.ndarray, fit: Fit) -> bool:
    """Do the other runs leave a direction of the effects' parameters untold? Then leaving these out would leave it to chance.

    Told of the parameters p beside the tuning q: S = N_pp - N_pq N_qq^-1 N_qp, of all runs against that of the others.
    """
    p = fit.columns.shape[1]
    if not p:
        return False
    of_all, of_others = (_told(n, p) for n in (normal, normal - information))
    return float(scipy.linalg.eigh(of_others, of_all, eigvals_only=True)[0]) < 1.0 - ALONE


def _told(normal: np.ndarray, p: int) -> np.ndarray:
    """Information about the first p parameters with the others free; never quite none, so that no direction divides by zero."""
    told = normal[:p, :p] - normal[:p, p:] @ np.linalg.lstsq(normal[p:, p:], normal[p:, :p], rcond=None)[0]
    return told + 1e-7 * np.diag(np.diag(normal)[:p]) + 1e-9 * np.eye(p)


_OUTLIER = 5.0
"""Squares grow linearly beyond this many standard deviations: the moment of break-away is chance."""


def leave_out(found: Found, fold: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Shift of free parameters and tuning when the runs of a fold are left out."""
    fit, group = found.fit, found.group
    x, normal, r = _linear(group, fit)
    rows = _rows_of(group, fold)
    information = x[rows].T @ x[rows]
    shift = np.zeros(len(normal))
    if not _knows_alone(information, normal, fit):
        shift = -np.linalg.lstsq(normal - information, x[rows].T @ r[rows], rcond=None)[0]
    return shift[: fit.columns.shape[1]], shift[fit.columns.shape[1] :]


def _inflation(group: Group, fit: Fit) -> float:
    """How much larger than noise alone the residual of a fit is (>= 1): what is not modelled discounts all evidence."""
    left = fit.left(group)
    return max(1.0, 0.5 * float(left @ left) / expected_loss(group))


def is_plausible(setting: Setting, machine: Machine) -> bool:
    """Is the size one that is found on machines, and more than their normal spread?"""
    axis = machine.axis(setting.axis)
    size = size_parameter(setting.effect)
    value = setting.parameters[size.name]
    low, high = size.usual_range(machine, axis)
    neutral = size.neutral or 0.0
    if size.name == "factor":
        deviation = abs(value - neutral)
        least = min(abs(v - neutral) for v in (low, high)) if not low < neutral < high else 0.5 * min(neutral - low, high - neutral)
        return deviation > max(SMALLEST * least, BEYOND_TOLERANCE.get(setting.effect.name, 0.0) * machine.parameter_tolerance)
    if not math.isfinite(neutral):  # springs and limits: the softer, the larger
        if size.name == "limit_a":
            return True
        return low / LARGEST <= value <= high / SMALLEST
    if low < neutral < high:
        return abs(value - neutral) > SMALLEST * 0.3 * min(neutral - low, high - neutral)
    if setting.effect.name == "inertia":
        return _share_of_inertia(setting, machine) > BEYOND_TOLERANCE["inertia"] * machine.parameter_tolerance
    return SMALLEST * low < abs(value) < LARGEST * high


def _is_imitated(found: Found, setting: Setting, machine: Machine) -> bool:
    """A little inertia on an axis whose drive train gives: mass on the load side and a softer spring look alike."""
    gives = any(n.owner == setting.axis and NORMAL.get(n.quantity) == "transmission_compliance" for n in found.tuning.nuisances)
    return setting.effect.name == "inertia" and gives and _share_of_inertia(setting, machine) < IMITATED * machine.parameter_tolerance


def _share_of_inertia(setting: Setting, machine: Machine) -> float:
    """Added inertia as a share of all that the axis moves."""
    axis = machine.axis(setting.axis)
    return abs(setting.parameters["added"]) / max(load_inertia(machine, axis) + axis.reflected_inertia, 1e-12)


def _try_removals(found: Found, machine: Machine, folds: Sequence[Sequence[int]]) -> None:
    """Drop an accepted effect that the later ones have made superfluous."""
    while len(found.fit.settings) > 1:
        full = held_out_loss(found, found.fit, folds)
        worst: tuple[float, Fit] | None = None
        for i in range(len(found.fit.settings)):
            rest = [s for j, s in enumerate(found.fit.settings) if j != i]
            fit = fit_effects(found.group, machine, found.tuning, rest, 2)
            if fit is None:
                continue
            cost = (held_out_loss(found, fit, folds) - full) / found.inflation
            if worst is None or cost < worst[0]:
                worst = (cost, fit)
        if worst is None or worst[0] >= EVIDENCE:
            return
        found.fit = worst[1]
