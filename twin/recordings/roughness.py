"""How rough values are, whatever a few of them do: robust standard deviations."""

from __future__ import annotations

import numpy as np

NORMAL_OVER_MEDIAN = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

SECOND_DIFFERENCE = 6.0
"""Variance of second differences of white noise over its own: 1 + 4 + 1."""


def robust_deviation(values: np.ndarray) -> float:
    """Standard deviation about zero, by the median of the sizes: outliers leave it alone."""
    return NORMAL_OVER_MEDIAN * float(np.median(np.abs(values)))


def roughness(values: np.ndarray) -> float:
    """Robust standard deviation of second differences: that of white noise times the root of SECOND_DIFFERENCE. Slow faults leave it alone."""
    return robust_deviation(np.diff(values, 2))
