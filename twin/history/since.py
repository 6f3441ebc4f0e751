"""What is different from a baseline: the twin is brought to the baseline first, then the changes of the machine are searched.

The reference M0 is the corrected machine of the baseline. b and G of each run (`twin.history.projection`) are taken about M0. A run with a counterpart in
the baseline, of the same program, moves by

    b(now) - mean b(baseline) = G theta + noise

whatever the twin lacks. A run of no such program is compared with the offset that all runs of the baseline have in common; differences between these
runs are noise. Causes enter one by one, the one that explains most first; each time the present is simulated anew with the changes found (Gauss-Newton with
fixed slopes), so that no remainder of a large change looks like a small change.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
import functools
from typing import NamedTuple, Self

import numpy as np

from twin.diagnose.judgement import unexplained_share
from twin.diagnose.settings import T
from twin.diagnose.simulations import Mapper
from twin.history.columns import Direction, amplitude, changed, waves_of
from twin.history.judge import Cause
from twin.history.projection import Linearised, Noise, Reference
from twin.history.series import RIVAL, filters, same_program, seen, sizes
from twin.history.watch import program_of
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.simulation.campaign_gap import AS_EXPECTED

REPEATS, KNOWN = 0.01, 3.0
"""Scatter between repetitions [usual sizes] that is assumed before any is known, and the number of repetitions that it counts for."""

OFFSET = 5.0
"""Standard deviation of what the twin may lack in the baseline [usual sizes]."""

LEAST = 0.05
"""Smaller changes are not reported [usual sizes]."""

MOST, STEPS = 6, 4
"""Largest number of changes of a group of axes; simulations of the changes until their sizes are settled."""


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

    @property
    def direction(self) -> Direction:
        return self.changes[0][0]

    @property
    def size(self) -> float:
        """Its size: the amplitude of a wave."""
        return amplitude([t for _, t in self.changes])


@dataclass(frozen=True)
class Differences:
    """Changes of one group of axes; levels over the noise of repetitions, on runs left out of the fit; candidates with evidence and size."""

    axes: tuple[str, ...]
    found: tuple[Difference, ...]
    before: float
    after: float
    held_out: tuple[str, ...]
    candidates: dict[Cause, tuple[float, float, Direction]]  # evidence [nat], size, direction
    not_seen: tuple[Cause, ...]
    notes: tuple[str, ...]

    @property
    def is_loud(self) -> bool:
        """Does more remain than noise and what repetitions differ by?"""
        return self.after > 2.0 * AS_EXPECTED

    @property
    def is_unexplained(self) -> bool:
        """Does a considerable part of a change remain? The twin errs by a share of a large one."""
        return self.is_loud and unexplained_share(self.before, self.after) > T.remaining


@dataclass(frozen=True)
class Contrast:
    """The difference of a group from the baseline, run by run: the twin about each run, G, and the change of b.

    The noise of a change of b has the covariance V = `noise` (G + G S G), S the squares of the scatter between repetitions; `noise` is 1 + 1 / repetitions.
    """

    directions: Sequence[Direction]
    runs: Sequence[tuple[str, Linearised]]
    grams: Sequence[np.ndarray]
    changes: Sequence[np.ndarray]
    scatter: np.ndarray
    noise: float
    notes: Sequence[str]

    @functools.cached_property
    def gram(self) -> np.ndarray:
        """G of all runs."""
        return np.asarray(np.sum(self.grams, axis=0))

    @functools.cached_property
    def change(self) -> np.ndarray:
        """Change of b over all runs."""
        return np.asarray(np.sum(self.changes, axis=0))

    @functools.cached_property
    def filters(self) -> np.ndarray:
        return filters(self.gram, self.scatter)

    @functools.cached_property
    def information(self) -> np.ndarray:
        return np.asarray(self.gram @ self.filters)

    @functools.cached_property
    def blocks(self) -> list[list[int]]:
        """Directions that can be seen, sine and cosine of a wave together."""
        return waves_of(self.directions, np.flatnonzero(seen(self.gram, self.scatter)).tolist())

    def sizes(self, change: np.ndarray, free: list[int]) -> np.ndarray:
        """Sizes of some directions together that explain a change of b best (free,)."""
        return np.asarray(np.linalg.lstsq(self.information[np.ix_(free, free)], (self.filters.T @ change)[free], rcond=1e-9)[0])

    def evidence(self, change: np.ndarray, free: list[int]) -> float:
        """Log likelihood [nat] that some directions explain together of a change of b."""
        return 0.5 * float(self.sizes(change, free) @ (self.filters.T @ change)[free]) / self.noise if free else 0.0

    def gains(self, change: np.ndarray, taken: list[int]) -> list[tuple[float, list[int]]]:
        """Evidence [nat] that each other block adds beside the directions that are taken, largest first."""
        before = self.evidence(change, taken)
        others = ((self.evidence(change, [*taken, *b]) - before, b) for b in self.blocks if b[0] not in taken)
        return sorted(others, key=lambda one: -one[0])

    def is_possible(self, theta: np.ndarray, change: np.ndarray, taken: list[int], block: list[int]) -> bool:
        """Whether a machine can have the sizes of a block (theta before) that explain most of a change of b beside those that are taken."""
        sizes = self.sizes(change, [*taken, *block])[len(taken) :]
        return all(theta[k] + size >= self.directions[k].least for k, size in zip(block, sizes))

    def level(self, change: np.ndarray) -> float:
        """RMS of a change of b over its noise, in all directions: sqrt(b' V^-1 b / rank)."""
        values, vectors = np.linalg.eigh(0.5 * (self.gram + self.gram.T))
        kept = values > 1e-9 * max(values.max(initial=0.0), 1e-300)
        theta = vectors[:, kept] @ (vectors[:, kept].T @ change / values[kept])  # V^-1 = G^+ A G^+
        return float(np.sqrt(max(theta @ self.information @ theta, 0.0) / max(kept.sum(), 1) / self.noise))

    def doubt(self) -> Noise:
        """Model error of the twin in each channel for this change; empty if it is below the noise everywhere."""
        out: dict[str, float] = {}
        for (_, run), gram, change in zip(self.runs, self.grams, self.changes):
            errors = run.doubt(np.linalg.lstsq(gram, change, rcond=1e-9)[0])
            out |= {key: max(error, out.get(key, 0.0)) for key, error in errors.items() if error > run.noise[key]}
        return out

    def simulated(self, theta: np.ndarray) -> np.ndarray | None:
        """b of the changes theta in each run (run, direction), simulated, by the slopes about the reference; None if they cannot be simulated."""
        changes = [(self.directions[k], float(theta[k])) for k in np.flatnonzero(theta).tolist()]
        out = [run.right_of(changes) for _, run in self.runs]
        return None if any(right is None for right in out) else np.array(out)

    def of_runs(self, runs: list[int]) -> Self:
        """The contrast of some runs."""
        return replace(self, grams=[self.grams[i] for i in runs], changes=[self.changes[i] for i in runs])


class _Shown(NamedTuple):
    """What a run showed: feedforward and program, noise of its channels, G and b."""

    feedforward: str | None
    program: tuple[float, ...]
    noise: Noise
    gram: np.ndarray
    right: np.ndarray

    def repeats(self, other: "_Shown") -> bool:
        return self.feedforward == other.feedforward and same_program(self.program, other.program)


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
        several = [_searched(contrast, axes)]
        if several[0].is_loud and (doubt := contrast.doubt()):
            coarse = contrast_of(present, baselines, Reference(reference, mapper, lambda: baselines[0].runs, doubt), axes)
            several += [_searched(coarse, axes)] if coarse is not None else []
        out.append(min(several, key=lambda d: unexplained_share(d.before, d.after)))
        machine = changed(machine, [c for d in out[-1].found for c in d.changes])
    return out, machine


def contrast_of(present: Campaign, baselines: Sequence[Campaign], about: Reference, axes: tuple[str, ...]) -> Contrast | None:
    """The runs that have a counterpart against it, or all runs against what the baseline has in common; None if the baseline does not move the axes."""
    directions = about.directions(axes)
    default = np.full(len(directions), REPEATS)
    then: list[_Shown] = []
    for baseline in baselines:
        then += [shown for *_, shown in _shown(about, baseline.runs, axes, then)]
    if not then:
        return None
    now = list(_shown(about, present.runs, axes, then))
    twins = [[p for p in then if p.repeats(shown)] for *_, shown in now]
    notes, name = [], ", ".join(axes)
    if any(twins):
        used = [i for i, found in enumerate(twins) if found]
        if alone := [run for i, (run, *_) in enumerate(now) if i not in used]:
            notes.append(f"axes {name}: {', '.join(alone)} not compared: the baseline has no run of this program")
        changes = [now[i][2].right - np.mean([p.right for p in twins[i]], axis=0) for i in used]
        repeats = min(len(twins[i]) for i in used)
        gram = np.sum([now[i][2].gram for i in used], axis=0)
        repeated = [sizes(gram, np.sum([twins[i][r].right - twins[i][0].right for i in used], axis=0), default) for r in range(repeats)]
        noise = 1.0 + 1.0 / repeats
    else:
        used, total = list(range(len(now))), np.sum([p.gram for p in then], axis=0)
        offset = np.linalg.solve(total + np.eye(len(total)) / OFFSET**2, np.sum([p.right for p in then], axis=0))
        changes = [p.right - p.gram @ offset for *_, p in now]
        repeated = [sizes(p.gram, p.right - p.gram @ offset, default) for p in then]
        noise = 1.0
        notes.append(
            f"axes {name}: other programs than in the baseline; a change shows only beyond what differs between the runs of the baseline"
        )
    spread = np.sum((np.array(repeated) - np.mean(repeated, axis=0)) ** 2, axis=0)
    scatter = np.sqrt((KNOWN * REPEATS**2 + spread) / (KNOWN + len(repeated) - 1))
    return Contrast(directions, [now[i][:2] for i in used], [now[i][2].gram for i in used], changes, scatter, noise, notes)


def _shown(
    about: Reference, runs: Sequence[MeasuredRun], axes: tuple[str, ...], then: Sequence[_Shown]
) -> Iterator[tuple[str, Linearised, _Shown]]:
    """Each run that shows these axes, with the noise of the first run of its program."""
    programs = [program_of([run]) for run in runs]
    noise = [next((p.noise for p in then if same_program(p.program, program)), {}) for program in programs]
    for run, own in about.linearised(runs, axes, noise):
        yield run.name, own, _Shown(run.feedforward, program_of([run]), own.noise, own.gram, own.right(run.trace))


def _searched(contrast: Contrast, axes: tuple[str, ...]) -> Differences:
    """The causes that enter one by one, with the present simulated anew after each."""
    d, blocks, first = contrast.directions, contrast.blocks, contrast.change
    theta, explained = np.zeros(len(d)), np.zeros((len(contrast.grams), len(d)))  # sizes, and the b of these changes in each run
    alone = sorted(((contrast.evidence(first, b), b) for b in blocks), key=lambda one: one[0])
    candidates = {d[b[0]].cause: (e, amplitude(contrast.sizes(first, b)), d[b[0]]) for e, b in alone}  # the clearest wave of each
    enough = T.evidence + np.log(len(blocks) or 1)
    entered: list[tuple[list[int], float, list[tuple[Cause, float]]]] = []  # block, evidence, rivals with theirs
    while len(entered) < MOST:
        taken, left = [k for b, _, _ in entered for k in b], first - explained.sum(axis=0)
        clear = ((gain, b) for gain, b in contrast.gains(left, taken) if gain > RIVAL * enough)
        gains = [(gain, b) for gain, b in clear if contrast.is_possible(theta, left, taken, b)]
        if not gains or gains[0][0] < enough:
            break
        gain, block = gains[0]
        moved, simulated = _resimulated(contrast, theta, explained, [*taken, *block])
        inflation = _inflation(contrast, first - simulated.sum(axis=0), [*taken, *block], enough)
        if gain / inflation < enough or abs(amplitude(moved[block])) < LEAST:
            break
        cause, theta, explained = d[block[0]].cause, moved, simulated
        rivals = [(d[b[0]].cause, g / inflation) for g, b in gains[1:] if g > RIVAL * gain and d[b[0]].cause != cause]
        entered.append((block, gain / inflation, rivals))
        entered = [one for one in entered if abs(amplitude(theta[one[0]])) >= LEAST]
    errors = _errors(contrast, [b for b, _, _ in entered], first - explained.sum(axis=0))
    while entered:  # what another one explains by now goes again
        surest = [amplitude(theta[b]) / errors[b[0]] for b, _, _ in entered]
        if 0.5 * min(map(abs, surest)) ** 2 >= T.evidence:
            break
        weakest = entered.pop(int(np.argmin(np.abs(surest))))[0]
        explained -= np.array([g[:, weakest] @ theta[weakest] for g in contrast.grams])
        theta[weakest] = 0.0
        theta, explained = _resimulated(contrast, theta, explained, [k for b, _, _ in entered for k in b])
        errors = _errors(contrast, [b for b, _, _ in entered], first - explained.sum(axis=0))
    found = []
    for block, evidence, rivals in entered:
        odds = sum(np.exp(max(e - evidence, -50.0)) for _, e in rivals)
        shows = [theta[block] @ g[np.ix_(block, block)] @ theta[block] for g in contrast.grams]
        found.append(
            Difference(
                d[block[0]].cause,
                tuple((d[k], float(theta[k])) for k in block),
                float(np.hypot(errors[block[0]], T.model_error * amplitude(theta[block]))),
                evidence,
                float(min(T.confidence, 1.0 / (1.0 + odds))),
                tuple(dict.fromkeys(c for c, _ in rivals[:3])),
                tuple(contrast.runs[i][0] for i in np.argsort(shows)[::-1][:3]),
            )
        )
    levels = _held_out(contrast, theta, explained)
    unseen = tuple(sorted({one.cause for one in d} - {d[b[0]].cause for b in blocks}))
    return Differences(axes, tuple(found), *levels, tuple(name for name, _ in contrast.runs), candidates, unseen, tuple(contrast.notes))


def _errors(contrast: Contrast, blocks: Sequence[list[int]], left: np.ndarray) -> dict[int, float]:
    """Standard error of the size of each block, by its first direction, with all of them free; `left`: what they leave of the change."""
    free = [k for b in blocks for k in b]
    covariance = np.linalg.pinv(contrast.information[np.ix_(free, free)]) * contrast.noise * max(1.0, contrast.level(left) ** 2)
    return {b[0]: float(np.sqrt(covariance[free.index(b[0]), free.index(b[0])])) for b in blocks}


def _inflation(contrast: Contrast, left: np.ndarray, free: list[int], enough: float) -> float:
    """Mean square over noise, at least 1, of what simulated causes leave of a change; or of what a next one, clear enough, leaves of that by its slope."""
    gain, block = next(iter(contrast.gains(left, free)), (0.0, []))
    both = [*free, *block]
    alone, beside = (max(1.0, contrast.level(one) ** 2) for one in (left, left - contrast.gram[:, both] @ contrast.sizes(left, both)))
    return beside if gain / beside > enough else alone


def _resimulated(contrast: Contrast, theta: np.ndarray, explained: np.ndarray, free: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of the free directions after simulating the present with the changes, and the b of these changes in each run."""
    theta, slope = theta.copy(), 1.0
    for _ in range(STEPS):
        step = np.zeros(len(theta))
        step[free] = contrast.sizes(contrast.change - explained.sum(axis=0), free) / slope
        theta += step
        simulated = contrast.simulated(theta)
        if simulated is None:
            return theta, explained + np.array([g @ step for g in contrast.grams])
        moved, explained = simulated.sum(axis=0) - explained.sum(axis=0), simulated
        slope = float(
            np.clip((step @ contrast.filters.T @ moved) / max(step @ contrast.information @ step, 1e-300), 1.0 / STEEPEST, STEEPEST)
        )
        if np.abs(step).max() < 0.01 * np.abs(theta).max():
            break
    return theta, explained


def _held_out(contrast: Contrast, theta: np.ndarray, explained: np.ndarray) -> tuple[float, float]:
    """Level of the difference in each run before, and after with the sizes fitted to the other runs; RMS over runs."""
    free, levels = np.flatnonzero(theta).tolist(), []
    for i, change in enumerate(contrast.changes):
        own, left, step = contrast.of_runs([i]), change - explained[i], np.zeros(len(theta))
        if free and len(contrast.grams) > 1:
            rest = contrast.of_runs([k for k in range(len(contrast.grams)) if k != i])
            step[free] = rest.sizes(rest.change - np.delete(explained, i, axis=0).sum(axis=0), free)
        levels.append((own.level(change), own.level(left - own.gram @ step)))
    before, after = np.sqrt(np.mean(np.square(levels), axis=0))
    return float(before), float(after)
