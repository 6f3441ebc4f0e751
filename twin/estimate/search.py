"""The search for the most likely values: damped Gauss-Newton (Levenberg-Marquardt) on all blocks of a problem at once.

    min  sum over the signals of a block of  N log RMS(residual)

This is maximum likelihood with an unknown noise level for each signal. Each block has its own damping and stops on its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.estimate.evidence import mean_log_rms, rms_of
from twin.estimate.linearised import Linearised, linearised
from twin.estimate.problem import Block, Problem, Residuals, Values, blocks_of

STEPS = 12
CONVERGED = 1e-4
"""A block is at its end when a step improves its mean log RMS by less than this."""

FIRST_DAMPING, SOFTER, HARDER, TRIALS = 1e-3, 0.2, 8.0, 4
"""Damping at the start, its factor after a step that improved a block and after one that did not, and trials of one step."""

LONGEST_STEP = 1.0
"""Largest change of a number in one step, in the units of the search."""


@dataclass(frozen=True)
class Solution:
    """End of a search: values, residuals, score of each block, and the problem linearised there."""

    problem: Any
    values: Values
    residuals: Residuals
    blocks: tuple[Block, ...]
    scores: tuple[float, ...]
    linear: tuple[Linearised | None, ...]

    def score(self, part: str) -> float:
        """Mean log RMS of the block that holds a part."""
        return self.scores[self._index(part)]

    def deviations(self, part: str) -> dict[Any, float]:
        """Name -> standard deviation of the free numbers of this block, in the units of the search; infinite without an effect."""
        k = self._index(part)
        linear = self.linear[k]
        size = len(self.blocks[k].free)
        variances = np.full(size, np.inf) if linear is None else np.maximum(np.diag(linear.solved()[1]), 0.0)
        return {f.name: float(d) for f, d in zip(self.blocks[k].free, np.sqrt(variances))}

    def _index(self, part: str) -> int:
        return next(i for i, b in enumerate(self.blocks) if part in b.parts)


def search(problem: Problem, start: Values | None = None, steps: int = STEPS, say: Callable[[int], None] | None = None) -> Solution | None:
    """Search from `start`, by default the start of each number; None if there are no residuals there. `say` is called after each step."""
    blocks = blocks_of(problem.free)
    x = dict(start) if start is not None else {f.name: f.start for f in problem.free}
    base = problem.residuals([x])[0]
    if base is None:
        return None
    score = [_score(base, b) for b in blocks]
    damping = [FIRST_DAMPING] * len(blocks)
    still = set(range(len(blocks)))
    linear = linearised(problem, blocks, x, base, level_of(base))
    for step in range(steps):
        for _ in range(TRIALS):
            trial = dict(x)
            for i in still:
                trial.update(_moved(blocks[i], x, linear[i], damping[i]))
            there = problem.residuals([trial])[0]
            found = {i: _score(there, blocks[i]) for i in still} if there is not None else {}
            better = {i for i, value in found.items() if value < score[i]}
            for i in still:
                damping[i] *= SOFTER if i in better else HARDER
            if there is not None and better:
                kept = {p: there[p] for i in better for p in blocks[i].parts if p in there}
                base = {**base, **kept}
                x.update({f.name: trial[f.name] for i in better for f in blocks[i].free})
                still -= {i for i in better if score[i] - found[i] < CONVERGED}
                score = [found[i] if i in better else s for i, s in enumerate(score)]
                break
        else:
            break
        if say:
            say(step + 1)
        linear = linearised(problem, blocks, x, base, level_of(base))
        if not still:
            break
    return Solution(problem, x, base, tuple(blocks), tuple(score), tuple(linear))


def level_of(base: Residuals) -> Callable[[str, str], float]:
    """The RMS of each signal."""
    levels = {(p, s): rms_of(v) for p, own in base.items() for s, v in own.items()}
    return lambda part, signal: levels[part, signal]


def _moved(block: Block, x: Values, linear: Linearised | None, damping: float) -> Mapping[Any, float]:
    if linear is None:
        return {}
    at, low, high = np.array([(x[f.name], f.low, f.high) for f in block.free]).T
    step = linear.step(damping, np.maximum(low - at, -LONGEST_STEP), np.minimum(high - at, LONGEST_STEP))
    return {f.name: float(v) for f, v in zip(block.free, np.clip(at + step, low, high))}


def _score(residuals: Residuals, block: Block) -> float:
    return mean_log_rms([v for p in block.parts if p in residuals for v in residuals[p].values()])
