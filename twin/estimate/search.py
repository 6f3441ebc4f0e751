"""The search for the most likely values: damped Gauss-Newton (Levenberg-Marquardt) on all parts of a problem at once.

    min  sum over the signals of a part of  N log RMS(residual)

This is maximum likelihood with an unknown noise level for each signal. Each part has its own damping and stops on its own.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import functools
from typing import Any

import numpy as np

from twin.estimate.held_out_gain import mean_log_rms
from twin.estimate.problem import Free, Linearised, Problem, Residuals, Values, by_part, linearised

STEPS = 12
CONVERGED = 1e-4
"""A part is at its end when a step improves its mean log RMS by less than this."""

FIRST_DAMPING, SOFTER, HARDER, TRIALS = 1e-3, 0.2, 8.0, 4
"""Initial damping of a part, its factors after a successful and after a failed step, and trials of a step."""

LONGEST_STEP = 1.0
"""Largest change of a number in one step, in the units of the search."""


@dataclass(frozen=True)
class Solution:
    """A point of a search: values, residuals, mean log RMS of each part."""

    problem: Any
    values: Values
    residuals: Residuals
    scores: Mapping[str, float]

    @functools.cached_property
    def linear(self) -> Mapping[str, Linearised]:
        """The problem linearised here."""
        return linearised(self.problem, self.values, self.residuals)

    def half_widths(self, part: str) -> dict[Any, float]:
        """Name -> half width of the 95 % interval of the free numbers of a part, in the units of the search; infinite without an effect."""
        free = by_part(self.problem.free)[part]
        half = self.linear[part].half_widths() if part in self.linear else np.full(len(free), np.inf)
        return {f.name: float(h) for f, h in zip(free, half)}


def search(problem: Problem, start: Values | None = None, steps: int = STEPS, say: Callable[[int], None] | None = None) -> Solution | None:
    """Search from `start`, by default the start of each number; None if there are no residuals there. `say` is called after each step."""
    free = by_part(problem.free)
    x = dict(start) if start is not None else {f.name: f.start for f in problem.free}
    base = problem.residuals([x])[0]
    if base is None:
        return None
    here = Solution(problem, x, base, {p: _score(base, p) for p in free})
    damping = dict.fromkeys(free, FIRST_DAMPING)
    still = set(free)
    for step in range(steps):
        for _ in range(TRIALS):
            trial = dict(here.values)
            for p in still:
                trial.update(_moved(free[p], here.values, here.linear.get(p), damping[p]))
            there = problem.residuals([trial])[0]
            found = {p: _score(there, p) for p in still} if there is not None else {}
            better = {p for p, value in found.items() if value < here.scores[p]}
            for p in still:
                damping[p] *= SOFTER if p in better else HARDER
            if there is not None and better:
                still -= {p for p in better if here.scores[p] - found[p] < CONVERGED}
                moved = {f.name: trial[f.name] for p in better for f in free[p]}
                base = {**here.residuals, **{p: there[p] for p in better if p in there}}
                here = Solution(problem, {**here.values, **moved}, base, {**here.scores, **{p: found[p] for p in better}})
                break
        else:
            break
        if say:
            say(step + 1)
        if not still:
            break
    return here


def _moved(free: Sequence[Free], x: Values, linear: Linearised | None, damping: float) -> Mapping[Any, float]:
    if linear is None:
        return {}
    at, low, high = np.array([(x[f.name], f.low, f.high) for f in free]).T
    step = linear.step(damping, np.maximum(low - at, -LONGEST_STEP), np.minimum(high - at, LONGEST_STEP))
    return {f.name: float(v) for f, v in zip(free, np.clip(at + step, low, high))}


def _score(residuals: Residuals, part: str) -> float:
    return mean_log_rms(residuals.get(part, {}).values())
