"""Noise of a record: robust standard deviations, which ignore outliers, and the step of a record with few digits."""

from __future__ import annotations

import numpy as np

NORMAL_OVER_MEDIAN = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

SECOND_DIFFERENCE = 6.0
"""Variance of second differences of white noise over its own: 1 + 4 + 1."""

SAME_LEVEL = 1e-12
"""Relative difference up to which two values are one level, rounded differently."""

LEAST_LEVELS = 3
"""Fewest differences between neighbouring levels that show a grid."""

OFF_GRID = 0.02
"""Largest deviation of a level from the grid, in steps."""

LEAST_UNEVEN = 0.1
"""Smallest share of second differences that are a step or more. A ramp at constant speed has evenly spaced values, too, but even differences."""


def robust_deviation(values: np.ndarray) -> float:
    """Standard deviation about zero, from the median of the magnitudes; robust against outliers."""
    return NORMAL_OVER_MEDIAN * float(np.median(np.abs(values)))


def roughness(values: np.ndarray) -> float:
    """Robust standard deviation of second differences: sqrt(SECOND_DIFFERENCE) times that of white noise. Slow changes have no influence."""
    return robust_deviation(np.diff(values, 2))


def step_of(values: np.ndarray) -> float:
    """Step of the grid on which all values (sample,) lie, as in a record with few digits; 0 if there is none."""
    levels = np.unique(values)
    gaps = np.diff(levels)
    gaps = gaps[gaps > SAME_LEVEL * np.abs(levels).max(initial=0.0)]
    if len(gaps) < LEAST_LEVELS:
        return 0.0
    step = float(gaps.min())
    counts = gaps / step
    if np.abs(counts - np.round(counts)).max() >= OFF_GRID or np.mean(np.abs(np.diff(values, 2)) > 0.5 * step) < LEAST_UNEVEN:
        return 0.0
    return step
