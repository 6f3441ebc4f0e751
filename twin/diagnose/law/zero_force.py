"""Motor minus scale of an unloaded drive train. The encoders have no common zero, so it is estimated."""

import itertools

import numpy as np

RARELY = 0.02
"""Fraction of the samples at each end of the force range that is not paired with opposite forces."""

PAIRS = 8
"""The deflections under positive and negative force are compared at so many force levels."""

LEAST_OF_A_PAIR = 5
"""Smallest number of samples on each side of a valid pair."""


def zero_force_offset(deflection: np.ndarray, force: np.ndarray) -> float:
    """Motor minus scale at zero force from samples (sample,): the mean of its values under opposite forces.

    If a weight keeps the sign of the force, an odd cubic over the force is extrapolated to zero; this is a rough estimate.
    """
    x = force / max(float(np.abs(force).max()), 1e-300)
    reach = min(float(np.quantile(x, 1.0 - RARELY)), -float(np.quantile(x, RARELY)))
    middles = []
    if reach > 0.0:
        edges = np.linspace(0.0, reach, PAIRS + 1)
        for low, high in itertools.pairwise(edges):
            sides = [deflection[(low <= side * x) & (side * x < high)] for side in (1.0, -1.0)]
            if min(map(len, sides)) > LEAST_OF_A_PAIR:
                middles.append(0.5 * sum(float(np.median(side)) for side in sides))
    if middles:
        return float(np.median(middles))
    return float(np.linalg.lstsq(np.column_stack([np.ones(len(x)), x, x**3]), deflection, rcond=None)[0][0])
