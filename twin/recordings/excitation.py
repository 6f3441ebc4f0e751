"""What the motion of a recording can separate: Coulomb from viscous friction needs several speeds."""

from __future__ import annotations

import numpy as np

LEAST_SPREAD = 2.5
"""Below this ratio of the 97th to the 10th percentile of its speeds an axis has one speed. Ramps are a small share of such motion, and their
friction is not that of steady speed."""


def one_speed(speeds: np.ndarray) -> float | None:
    """The single speed at which an axis slides, from its speeds (sample,) while it moves; None if it has several."""
    size = np.abs(speeds)
    if len(size) == 0 or np.percentile(size, 97) >= LEAST_SPREAD * np.percentile(size, 10):
        return None
    return float(np.median(size))
