"""Where the encoders of a drive train stand when it carries no force: they have no common zero."""

from __future__ import annotations

import itertools

import numpy as np

RARELY = 0.02
"""Share of a run's samples at either end of its forces beyond which they are not paired with opposite ones."""

PAIRS = 8
"""Sizes of the force at which the windup under it and under the opposite one are compared."""

LEAST_OF_A_PAIR = 5
"""Samples on either side below which a pair says nothing."""


def without_force(wound: np.ndarray, force: np.ndarray) -> float:
    """Motor minus scale at no force, of samples (sample,): half way between where it stands under a force and under the opposite one.

    Where a weight keeps the force's sign it is that of the nearest odd cubic over the force, which lies far outside the record: rough.
    """
    x = force / max(float(np.abs(force).max()), 1e-300)
    reach = min(float(np.quantile(x, 1.0 - RARELY)), -float(np.quantile(x, RARELY)))
    middles = []
    if reach > 0.0:
        edges = np.linspace(0.0, reach, PAIRS + 1)
        for low, high in itertools.pairwise(edges):
            sides = [wound[(low <= side * x) & (side * x < high)] for side in (1.0, -1.0)]
            if min(map(len, sides)) > LEAST_OF_A_PAIR:
                middles.append(0.5 * sum(float(np.median(side)) for side in sides))
    if middles:
        return float(np.median(middles))
    return float(np.linalg.lstsq(np.column_stack([np.ones(len(x)), x, x**3]), wound, rcond=None)[0][0])
