"""Whether what a law leaves of a signal is noise of the signals that enter it."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import lsq_linear
from scipy.special import chdtri

LAGS, BY_CHANCE = 8, 1e-3
"""Rows over which a residual is tested for white noise of the signals, and the share of true laws that a test may refuse."""

COLOURED = 0.02
"""Standard deviation of the correlations of rounding: it is not quite white."""


def is_noise(residual: np.ndarray, answers: Sequence[np.ndarray], noise: Sequence[float], rounding: float) -> bool:
    """Whether what a law leaves (row,) is white noise of its signals: `answers` are what a change of each of them in one row adds to this and the following ones.

    The autocovariances over LAGS rows are those of white noise of these signals, at most their `noise` (RMS), but for chance and COLOURED; their covariance is that
    of Bartlett for such a process. `rounding`: share of its square that rounding makes. A law that lacks a part leaves something that lasts.
    """
    count, lags = len(residual), range(LAGS + 1)
    seen = np.array([float(residual[lag:] @ residual[: count - lag]) for lag in lags]) / count
    if seen[0] <= 0.0:
        return True
    each = np.array([[float(a[lag:] @ a[: len(a) - lag]) if lag < len(a) else 0.0 for a in answers] for lag in lags])
    most = np.minimum(np.square(noise) * each[0], seen[0]) / seen[0]
    kept, each, seen = most > 0.0, each / np.maximum(each[0], 1e-300), seen / seen[0]
    each, root = each[:, kept], np.eye(len(seen))
    for _ in range(2):  # the second time with the covariance of the first
        fit = lsq_linear(np.linalg.solve(root, each), np.linalg.solve(root, seen), (0.0, most[kept]))
        whole = each @ fit.x
        both = np.concatenate([np.zeros(2 * LAGS), whole[:0:-1], whole, np.zeros(2 * LAGS)])
        at = 3 * LAGS + np.arange(-LAGS, LAGS + 1)
        spread = np.array([[float(both[at] @ both[at + i - j] + both[at + i] @ both[at - j]) for j in lags] for i in lags]) / count
        root = np.linalg.cholesky(
            spread + (COLOURED * min(rounding, 1.0)) ** 2 * np.eye(len(spread)) + 1e-9 * spread[0, 0] * np.eye(len(spread))
        )
    left = np.linalg.solve(root, seen - each @ fit.x)
    return bool(left @ left < chdtri(LAGS, BY_CHANCE))
