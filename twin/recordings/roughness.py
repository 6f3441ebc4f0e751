"""Robust standard deviations, which ignore outliers."""

from __future__ import annotations

import numpy as np

NORMAL_OVER_MEDIAN = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

SECOND_DIFFERENCE = 6.0
"""Variance of second differences of white noise over its own: 1 + 4 + 1."""


def robust_deviation(values: np.ndarray) -> float:
    """Standard deviation about zero, from the median of the magnitudes; robust against outliers."""
    return NORMAL_OVER_MEDIAN * float(np.median(np.abs(values)))


def roughness(values: np.ndarray) -> float:
    """Robust standard deviation of second differences: sqrt(SECOND_DIFFERENCE) times that of white noise. Slow changes have no influence."""
    return robust_deviation(np.diff(values, 2))
