"""The change of a recording since a baseline, channel by channel, and how likely causes make it.

Each run is projected about the machine of the baseline (`twin.history.projection`). A run with a counterpart in the baseline, of the same program, moves by

    b(now) - mean b(baseline) = G (theta + u) + e

whatever the twin lacks: theta the causes, u what repetitions differ by, e noise and what the twin errs in a change. A run of no such program is compared with the
offset that all runs of the baseline have in common; differences between these runs are noise.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
import functools
from typing import NamedTuple, Self

import numpy as np

from twin.diagnose.settings import T
from twin.history.columns import Direction, waves_of
from twin.history.projection import Linearised, Noise, Reference
from twin.history.series import information, same_program, seen, sizes
from twin.history.watch import program_of
from twin.recordings.campaign import Campaign, MeasuredRun

REPEATS, KNOWN = 0.01, 3.0
"""Scatter between repetitions [usual sizes] that is assumed before any is known, and the number of repetitions that it counts for; by as many samples the
noise of a channel is known."""

OFFSET = 5.0
"""Standard deviation of what the twin may lack in the baseline [usual sizes]."""

CLOSER = 10
"""Causes that explain most with the errors of the twin as they are; what these explain is then counted with errors of their own."""

STEPS_OF_ERROR, SETTLED = 40, 0.05
"""Largest number of steps towards the twin's own error, and the gain of the likelihood that ends them [nat]."""


class Explained(NamedTuple):
    """A change of b beside some directions: log likelihood [nat], their sizes and information, and the twin's own error in each channel [variances of noise]."""

    likelihood: float
    sizes: np.ndarray
    information: np.ndarray
    errors: np.ndarray


@dataclass(frozen=True)
class Contrast:
    """The change of a group of axes since the baseline, run by run: G of each channel (channel, direction, direction) and the change of b (channel, direction).

    Channel c moves by G_c (theta + u) + e_c with u ~ N(0, S) and e_c ~ N(0, v_c G_c), all variances times `noise`, which is 1 + 1 / repetitions. v_c is 1 for noise
    alone; the twin errs by at least `T.doubt` of a change, and as much more as makes the change most likely.
    """

    directions: Sequence[Direction]
    runs: Sequence[tuple[str, Linearised]]
    grams: Sequence[np.ndarray]
    changes: Sequence[np.ndarray]
    channels: Sequence[str]
    scatter: np.ndarray
    noise: float
    notes: Sequence[str]

    @functools.cached_property
    def by_channel(self) -> np.ndarray:
        """G of all runs (channel, direction, direction)."""
        return np.asarray(np.sum(self.grams, axis=0))

    @functools.cached_property
    def gram(self) -> np.ndarray:
        """G of all runs and channels (direction, direction)."""
        return np.asarray(self.by_channel.sum(axis=0))

    @functools.cached_property
    def change(self) -> np.ndarray:
        """Change of b over all runs (channel, direction)."""
        return np.asarray(np.sum(self.changes, axis=0))

    @functools.cached_property
    def inverses(self) -> np.ndarray:
        """Pseudo-inverse of G of each channel (channel, direction, direction)."""
        return np.linalg.pinv(self.by_channel, rcond=1e-9, hermitian=True)

    @functools.cached_property
    def ranks(self) -> np.ndarray:
        """Directions that each channel tells apart (channel,)."""
        return np.rint(np.sum(self.inverses * self.by_channel, axis=(1, 2)))

    @functools.cached_property
    def least(self) -> np.ndarray:
        """The least v of each channel (channel,)."""
        return np.maximum(1.0, T.doubt**2 * self.squares(self.change) / self.noise / np.maximum(self.ranks, 1.0))

    @functools.cached_property
    def blocks(self) -> list[list[int]]:
        """Directions that can be seen, sine and cosine of a wave together."""
        return waves_of(self.directions, np.flatnonzero(seen(self.gram, self.scatter)).tolist())

    def squares(self, change: np.ndarray) -> np.ndarray:
        """Square of a change of b over noise alone in each channel (channel,)."""
        return np.asarray(np.sum((self.inverses @ change[..., None])[..., 0] * change, axis=1))

    def explained(self, change: np.ndarray, free: list[int]) -> Explained:
        """A change of b with the sizes of some directions and the v that explain it best, found by expectation maximisation from the largest v down."""
        before, count = -np.inf, self.ranks + KNOWN
        errors = np.maximum(self.least, self.squares(change) / self.noise / np.maximum(self.ranks, 1.0))
        for _ in range(STEPS_OF_ERROR):
            gram, right, kept, sign = self._weighted(change, errors)
            inner = (gram - gram @ kept @ gram)[np.ix_(free, free)] / self.noise
            sizes = np.linalg.pinv(inner, rcond=1e-9, hermitian=True) @ (right - gram @ (kept @ right))[free] / self.noise
            rest = right - gram[:, free] @ sizes
            unexplained = change - self.by_channel[:, :, free] @ sizes
            square = (float(np.sum(self.squares(unexplained) / errors)) - float(rest @ kept @ rest)) / self.noise
            likelihood = -0.5 * (float(count @ np.log(errors)) + KNOWN * float(np.sum(self.least / errors)) + sign + square)
            if likelihood < before + SETTLED:
                break
            before = likelihood
            left = self.squares(unexplained - self.by_channel @ (kept @ rest)) / self.noise + np.sum(self.by_channel * kept, axis=(1, 2))
            errors = np.maximum(self.least, (left + KNOWN * self.least) / count)
        return Explained(likelihood, sizes, inner, errors)

    def _weighted(self, change: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """With v of each channel: G and b of all channels, the covariance of u, and the log determinant of 1 + S G."""
        gram, right, variances = np.tensordot(1.0 / errors, self.by_channel, 1), (1.0 / errors) @ change, np.square(self.scatter)
        inner = np.eye(len(gram)) + variances[:, None] * gram
        return gram, right, np.linalg.solve(inner, np.diag(variances)), float(np.linalg.slogdet(inner)[1])

    def sizes(self, change: np.ndarray, free: list[int]) -> np.ndarray:
        """Sizes of some directions together that explain a change of b best (free,)."""
        return self.explained(change, free).sizes

    def gains(self, change: np.ndarray, taken: list[int]) -> list[tuple[float, list[int]]]:
        """Evidence [nat] that each other block adds beside the directions that are taken, largest first."""
        before = self.explained(change, taken)
        gram, right, kept, _ = self._weighted(change, before.errors)
        inner, score = (gram - gram @ kept @ gram) / self.noise, (right - gram @ (kept @ right)) / self.noise
        score -= inner[:, taken] @ before.sizes

        def by_these_errors(block: list[int]) -> float:
            beside = inner[np.ix_(block, taken)] @ np.linalg.pinv(inner[np.ix_(taken, taken)], rcond=1e-9, hermitian=True)
            own = inner[np.ix_(block, block)] - beside @ inner[np.ix_(taken, block)]
            return 0.5 * float(score[block] @ np.linalg.pinv(own, rcond=1e-9, hermitian=True) @ score[block])

        found = sorted(((by_these_errors(b), b) for b in self.blocks if b[0] not in taken), key=lambda one: -one[0])
        sure = [(self.explained(change, [*taken, *b]).likelihood - before.likelihood, b) for _, b in found[:CLOSER]]
        return sorted([*sure, *found[CLOSER:]], key=lambda one: -one[0])

    def is_possible(self, theta: np.ndarray, change: np.ndarray, taken: list[int], block: list[int]) -> bool:
        """Whether a machine can have the sizes of a block (theta before) that explain most of a change of b beside those that are taken."""
        sizes = self.sizes(change, [*taken, *block])[len(taken) :]
        return all(theta[k] + size >= self.directions[k].least for k, size in zip(block, sizes))

    def level(self, change: np.ndarray) -> float:
        """RMS of a change of b over noise and what repetitions differ by, in all directions that the channels tell apart together."""
        inverse = np.linalg.pinv(self.gram, rcond=1e-9, hermitian=True)
        theta = inverse @ change.sum(axis=0)
        square = theta @ information(self.gram, self.scatter) @ theta / max(float(np.sum(inverse * self.gram)), 1.0)
        return float(np.sqrt(max(square, 0.0) / self.noise))

    def simulated(self, theta: np.ndarray) -> np.ndarray | None:
        """b of the changes theta in each run (run, channel, direction), simulated; 0 in a channel that is not compared; None if they cannot be simulated."""
        changes = [(self.directions[k], float(theta[k])) for k in np.flatnonzero(theta).tolist()]
        out = []
        for (_, run), grams, change in zip(self.runs, self.grams, self.changes):
            if (right := run.rights_of(changes)) is None:
                return None
            out.append([right[key] if gram.any() else none for key, gram, none in zip(self.channels, grams, np.zeros_like(change))])
        return np.array(out)

    def clearest(self, run: int, block: list[int], theta: np.ndarray) -> tuple[str, str] | None:
        """Axis and recorded signal in which a run shows the changes theta of a block clearest; None if only the error of a control law shows them."""
        shown = theta[block] @ self.grams[run][:, block][:, :, block] @ theta[block]
        signals = [k for k, key in enumerate(self.channels) if not key.endswith(" controller")]
        if not signals:
            return None
        axis, _, channel = self.channels[max(signals, key=lambda k: float(shown[k]))].partition(" ")
        return axis, channel

    def of_runs(self, runs: list[int]) -> Self:
        """The contrast of some runs."""
        return replace(self, grams=[self.grams[i] for i in runs], changes=[self.changes[i] for i in runs])


class _Shown(NamedTuple):
    """What a run showed: feedforward and program, noise of its channels, G and b of each."""

    feedforward: str | None
    program: tuple[float, ...]
    noise: Noise
    grams: dict[str, np.ndarray]
    rights: dict[str, np.ndarray]

    def of(self, channels: Sequence[str], known: Collection[str] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """G (channel, direction, direction) and b (channel, direction) of these channels; zero for those that are not known (default: that the run lacks)."""
        gram, right = (np.zeros_like(next(iter(parts.values()))) for parts in (self.grams, self.rights))
        has = [key in (self.grams if known is None else known) for key in channels]
        return (
            np.array([self.grams[key] if own else gram for key, own in zip(channels, has)]),
            np.array([self.rights[key] if own else right for key, own in zip(channels, has)]),
        )

    def repeats(self, other: "_Shown") -> bool:
        return self.feedforward == other.feedforward and same_program(self.program, other.program)


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
    channels = sorted({key for *_, shown in now for key in shown.grams})
    notes, name = [], ", ".join(axes)
    if any(twins):
        used = [i for i, found in enumerate(twins) if found]
        if alone := [run for i, (run, *_) in enumerate(now) if i not in used]:
            notes.append(f"axes {name}: {', '.join(alone)} not compared: the baseline has no run of this program")
        pairs = [(now[i][2], twins[i]) for i in used]
        shared = [frozenset(shown.grams).intersection(*(p.grams for p in own)) for shown, own in pairs]
        grams, rights = zip(*(shown.of(channels, known) for (shown, _), known in zip(pairs, shared)))
        before = [[p.of(channels, known)[1] for p in own] for (_, own), known in zip(pairs, shared)]
        changes = [right - np.mean(own, axis=0) for right, own in zip(rights, before)]
        repeats = min(map(len, before))
        gram = np.sum(grams, axis=(0, 1))
        repeated = [sizes(gram, np.sum([own[r] - own[0] for own in before], axis=(0, 1)), default) for r in range(repeats)]
        noise = 1.0 + 1.0 / repeats
    else:
        used = list(range(len(now)))
        past, (grams, rights) = [p.of(channels) for p in then], zip(*(shown.of(channels) for *_, shown in now))
        total = np.sum([g for g, _ in past], axis=(0, 1))
        offset = np.linalg.solve(total + np.eye(len(total)) / OFFSET**2, np.sum([b for _, b in past], axis=(0, 1)))
        changes = [b - g @ offset for g, b in zip(grams, rights)]
        repeated = [sizes(g.sum(axis=0), (b - g @ offset).sum(axis=0), default) for g, b in past]
        noise = 1.0
        notes.append(
            f"axes {name}: other programs than in the baseline; a change shows only beyond what differs between the runs of the baseline"
        )
    spread = np.sum((np.array(repeated) - np.mean(repeated, axis=0)) ** 2, axis=0)
    scatter = np.sqrt((KNOWN * REPEATS**2 + spread) / (KNOWN + len(repeated) - 1))
    return Contrast(directions, [now[i][:2] for i in used], grams, changes, channels, scatter, noise, notes)


def _shown(
    about: Reference, runs: Sequence[MeasuredRun], axes: tuple[str, ...], then: Sequence[_Shown]
) -> Iterator[tuple[str, Linearised, _Shown]]:
    """Each run that shows these axes, with the noise of the first run of its program."""
    programs = [program_of([run]) for run in runs]
    noise = [next((p.noise for p in then if same_program(p.program, program)), {}) for program in programs]
    for run, own in about.linearised(runs, axes, noise):
        yield run.name, own, _Shown(run.feedforward, program_of([run]), own.noise, own.grams, own.rights(run.trace))
