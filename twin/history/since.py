"""What is different from a baseline: the twin is brought to the baseline first, then the changes of the machine are searched.

The reference is the corrected machine of the baseline, and `twin.history.contrast` says how likely causes make the change. Causes enter one by one, the one
that makes the change most likely first; each time the present is simulated anew with the changes found (Gauss-Newton with fixed slopes), so that no remainder
of a large change looks like a small change.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twin.diagnose.judgement import EVEN
from twin.diagnose.settings import T
from twin.diagnose.simulations import Mapper
from twin.estimate.regression import NORMAL_95
from twin.history.columns import Direction, amplitude, changed
from twin.history.contrast import Contrast, contrast_of
from twin.history.judge import Cause
from twin.history.projection import Reference
from twin.history.series import RIVAL
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign
from twin.simulation.campaign_gap import AS_EXPECTED

LEAST = 0.05
"""Smaller changes are not reported [usual sizes]."""

LITTLE = 2.0
"""A cause with less evidence is not looked at [nat]."""

LOUD = 2.0 * AS_EXPECTED
"""Level of a difference that is more than noise and what repetitions differ by. What the twin errs then has few directions, and evidence counts for less."""

CONTENDER, CONTENDERS = 0.2, 4
"""A cause is simulated if its slope gives at least this share of the evidence of the first; and how many are."""

MOST, STEPS = 6, 5
"""Largest number of changes of a group of axes; fits of their sizes, with a simulation between each two."""

STEEPEST = 4.0
"""Largest factor between the slope of a large change and that about the reference."""


@dataclass(frozen=True)
class Difference:
    """A change of one cause: its directions with their sizes [usual sizes], the standard error of the size, evidence and rivals."""

    cause: Cause
    changes: tuple[tuple[Direction, float], ...]
    error: float
    evidence: float  # [nat]
    probability: float
    rivals: tuple[Cause, ...]
    runs: tuple[str, ...]  # where it shows, clearest first
    shows: tuple[str, str] | None  # axis and signal in which the first of these runs shows it clearest

    @property
    def direction(self) -> Direction:
        return self.changes[0][0]

    @property
    def size(self) -> float:
        """Its size: the amplitude of a wave."""
        return amplitude([t for _, t in self.changes])


@dataclass(frozen=True)
class Differences:
    """Changes of one group of axes; levels over the noise of repetitions and the share of the squared change above noise that is left, on runs left out of
    the fit; candidates with evidence and size.
    """

    axes: tuple[str, ...]
    found: tuple[Difference, ...]
    before: float
    after: float
    left: float
    held_out: tuple[str, ...]
    candidates: dict[Cause, tuple[float, float, Direction]]  # evidence [nat], size, direction
    not_seen: tuple[Cause, ...]
    notes: tuple[str, ...]

    @property
    def is_unexplained(self) -> bool:
        """Does more remain than noise and what repetitions differ by, and a considerable part of the change? The twin errs by a share of a large one."""
        return self.after > LOUD and self.left > T.remaining


def differences(
    present: Campaign, baselines: Sequence[Campaign], reference: Machine, mapper: Mapper, progress: Callable[[str], None]
) -> tuple[list[Differences], Machine]:
    """The changes of each group of axes, and the machine of today: the reference with them."""
    out, machine = [], reference
    about = Reference(reference, mapper, lambda: baselines[0].runs)
    for axes in about.groups_of(present.runs):
        progress(f"{'+'.join(axes)}: comparing with the baseline")
        contrast = contrast_of(present, baselines, about, axes)
        about.forget()
        if contrast is None:
            continue
        progress(f"{'+'.join(axes)}: looking for what changed")
        out.append(_searched(contrast, axes))
        machine = changed(machine, [c for d in out[-1].found for c in d.changes])
    return out, machine


def _searched(contrast: Contrast, axes: tuple[str, ...]) -> Differences:
    """The causes that enter one by one, with the present simulated anew after each."""
    d, blocks, first = contrast.directions, contrast.blocks, contrast.change
    theta, explained = np.zeros(len(d)), np.zeros_like(contrast.changes)  # sizes, and the b of these changes in each run
    enough = T.evidence + np.log(len(blocks) or 1)
    alone = sorted(contrast.gains(first, []), key=lambda one: one[0])
    candidates = {d[b[0]].cause: (e, amplitude(contrast.sizes(first, b)), d[b[0]]) for e, b in alone}  # the clearest wave of each
    entered: list[list[int]] = []
    while len(entered) < MOST:
        left, taken = first - explained.sum(axis=0), [k for b in entered for k in b]
        contenders, pays = _contenders(contrast, left, theta, taken, enough)
        tried = [(b, *_resimulated(contrast, theta, explained, [*taken, *b])) for b in contenders]
        gained = [contrast.explained(first - e.sum(axis=0), [*taken, *b]).likelihood for b, _, e in tried]
        if not tried or (not pays and max(gained) < contrast.explained(left, taken).likelihood + enough):
            break
        block, moved, simulated = tried[int(np.argmax(gained))]
        if abs(amplitude(moved[block])) < LEAST:
            break
        theta, explained = moved, simulated
        entered.append(block)
    parts: list[np.ndarray] = []
    surest: list[float] = []
    left = first - explained.sum(axis=0)
    while entered:  # what others explain by now goes again
        parts = [_own(contrast, theta, explained, b) for b in entered]
        surest = [
            0.0 if abs(amplitude(theta[b])) < LEAST else _evidence(contrast, left, part, entered, b) for b, part in zip(entered, parts)
        ]
        k = int(np.argmin(surest))
        if surest[k] >= T.evidence * (T.temperature if contrast.level(left) > LOUD else 1.0):
            break
        theta, explained = theta.copy(), explained - parts[k]
        theta[entered.pop(k)] = 0.0
        theta, explained = _resimulated(contrast, theta, explained, [k for b in entered for k in b])
        left = first - explained.sum(axis=0)
    errors = _errors(contrast, entered, left)
    found = []
    for block, own, evidence in zip(entered, parts, surest):
        others = contrast.gains(left + own.sum(axis=0), [k for b in entered if b is not block for k in b])
        rivals = [(d[b[0]].cause, gain) for gain, b in others if gain > RIVAL * evidence and d[b[0]].cause != d[block[0]].cause]
        odds = sum(np.exp(max(gain - evidence, -50.0)) for _, gain in rivals)
        shows = [theta[block] @ g.sum(axis=0)[np.ix_(block, block)] @ theta[block] for g in contrast.grams]
        found.append(
            Difference(
                d[block[0]].cause,
                tuple((d[k], float(theta[k])) for k in block),
                float(np.hypot(errors[block[0]], max(T.model_error, _unlike(contrast, left, own)) * amplitude(theta[block]))),
                evidence,
                _probability(contrast, left, own, odds),
                tuple(dict.fromkeys(c for c, _ in rivals[:3])),
                tuple(contrast.runs[i][0] for i in np.argsort(shows)[::-1][:3]),
                contrast.clearest(int(np.argmax(shows)), block, theta),
            )
        )
    unseen = tuple(sorted({one.cause for one in d} - {d[b[0]].cause for b in blocks}))
    return Differences(
        axes,
        tuple(found),
        *_held_out(contrast, theta, explained),
        tuple(name for name, _ in contrast.runs),
        candidates,
        unseen,
        tuple(contrast.notes),
    )


def _contenders(contrast: Contrast, left: np.ndarray, theta: np.ndarray, taken: list[int], enough: float) -> tuple[list[list[int]], bool]:
    """The causes, each by its clearest wave, that may explain most of what is left once they are simulated, and whether they pay for themselves by their slopes.

    The first pays alone or together with others: one of several causes leaves the others, which look like an error of the twin. If none does, they are
    simulated nevertheless where much is left, since no slope holds for a large change.
    """
    free, total = list(taken), 0.0
    found: list[list[int]] = []
    for count in range(1, MOST + 1):
        gains = [one for one in contrast.gains(left, free) if contrast.is_possible(theta, left, free, one[1])]
        if not gains or gains[0][0] < LITTLE:
            break
        if not found:
            causes: dict[Cause, list[int]] = {}
            for gain, block in gains:
                one = contrast.directions[block[0]]
                if gain > CONTENDER * gains[0][0] or (one.setting.effect.size.bends and gain > LITTLE):
                    causes.setdefault(one.cause, block)
            found = list(causes.values())[:CONTENDERS]
        total, free = total + gains[0][0], [*free, *gains[0][1]]
        if total >= count * enough:
            return found, True
    return (found if contrast.level(left) > LOUD else []), False


def _own(contrast: Contrast, theta: np.ndarray, explained: np.ndarray, block: list[int]) -> np.ndarray:
    """b of a block beside the others in each run (run, channel, direction): by its slope; simulated, if its response is not in proportion to its size."""
    if contrast.directions[block[0]].setting.effect.size.bends:
        others = theta.copy()
        others[block] = 0.0
        if (simulated := contrast.simulated(others)) is not None:
            return explained - simulated
    return np.array([g[:, :, block] @ theta[block] for g in contrast.grams])


def _evidence(contrast: Contrast, left: np.ndarray, own: np.ndarray, entered: Sequence[list[int]], block: list[int]) -> float:
    """Evidence of a block [nat], whose b is `own` in each run, beside all others that entered; `left`: what all of them leave."""
    others = [k for b in entered if b is not block for k in b]
    return contrast.explained(left, [*others, *block]).likelihood - contrast.explained(left + own.sum(axis=0), others).likelihood


def _unlike(contrast: Contrast, left: np.ndarray, own: np.ndarray) -> float:
    """What is left beyond noise as a share of what a cause, whose b is `own` in each run, moves, in the channels that show it: its response may be so wrong."""
    shown = contrast.squares(own.sum(axis=0))
    beyond = np.maximum(contrast.squares(left) - contrast.noise * contrast.ranks, 0.0)[shown > T.doubt * shown.sum()]
    return float(np.sqrt(beyond.sum() / max(float(shown.sum()), 1e-300))) / NORMAL_95


def _probability(contrast: Contrast, left: np.ndarray, own: np.ndarray, odds: float) -> float:
    """Probability of a cause, whose b is `own` in each run, against rivals of these odds; at most EVEN if no cause explains more than it moves."""
    drowned = contrast.level(left) > max(LOUD, contrast.level(own.sum(axis=0)))
    return float(min(EVEN if drowned else T.confidence, 1.0 / (1.0 + odds)))


def _errors(contrast: Contrast, blocks: Sequence[list[int]], left: np.ndarray) -> dict[int, float]:
    """Standard error of the size of each block, by its first direction, with all of them free; `left`: what they leave of the change."""
    free = [k for b in blocks for k in b]
    covariance = np.linalg.pinv(contrast.explained(left, free).information)
    return {b[0]: float(np.sqrt(covariance[free.index(b[0]), free.index(b[0])])) for b in blocks}


def _resimulated(contrast: Contrast, theta: np.ndarray, explained: np.ndarray, free: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of the free directions, and the b of all changes in each run (run, channel, direction), as the present is simulated anew with the changes.

    Their slopes are kept where they explain the change clearly better than any simulation: the twin errs in channels that a small change hardly moves.
    Elsewhere the simulation decides, because the response to a large change is not in proportion to its size.
    """
    tried: list[tuple[float, np.ndarray, np.ndarray]] = []
    slope = 1.0
    for _ in range(STEPS):
        fit = contrast.explained(contrast.change - explained.sum(axis=0), free)
        step = np.zeros(len(theta))
        step[free] = fit.sizes / slope
        if tried:
            tried.append((fit.likelihood, theta, explained))
            if np.abs(step).max() < 0.01 * np.abs(theta).max():
                break
        else:
            tried.append((fit.likelihood, theta + step, explained + np.array([g @ step for g in contrast.grams])))
        theta = theta + step
        simulated = contrast.simulated(theta)
        if simulated is None:
            break
        moved, explained = simulated.sum(axis=0) - explained.sum(axis=0), simulated
        weight = 1.0 / fit.errors
        expected = step @ np.tensordot(weight, contrast.by_channel, 1) @ step
        slope = float(np.clip(step @ (weight @ moved) / max(expected, 1e-300), 1.0 / STEEPEST, STEEPEST))
    by_slopes, *simulations = tried
    best = max(simulations, key=lambda one: one[0], default=by_slopes)
    return (by_slopes if by_slopes[0] > best[0] + T.evidence else best)[1:]


def _held_out(contrast: Contrast, theta: np.ndarray, explained: np.ndarray) -> tuple[float, float, float]:
    """Level of the difference in each run before, and after with the sizes fitted to the other runs, RMS over runs; share of its square above noise that is left."""
    free, levels, squares = np.flatnonzero(theta).tolist(), [], []
    for i, change in enumerate(contrast.changes):
        own, left, step = contrast.of_runs([i]), change - explained[i], np.zeros(len(theta))
        if free and len(contrast.grams) > 1:
            rest = contrast.of_runs([k for k in range(len(contrast.grams)) if k != i])
            step[free] = rest.sizes(rest.change - np.delete(explained, i, axis=0).sum(axis=0), free)
        left = left - own.by_channel @ step
        levels.append((own.level(change), own.level(left)))
        floor = own.noise * own.ranks.sum()
        squares.append([max(float(own.squares(one).sum() - floor), 0.0) for one in (change, left)])
    before, after = np.sqrt(np.mean(np.square(levels), axis=0))
    was, now = np.sum(squares, axis=0)
    return float(before), float(after), float(now / max(was, 1e-300))
