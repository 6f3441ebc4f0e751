"""Held-out evidence between two laws for the same signals: pieces of the record are fitted in turn and predicted by the rest.

    gain of a piece = log RMS of the simpler law - log RMS of the richer one,   in Gaussian log density per sample

The pieces of a recorded signal are alternately fitted and predicted. A few whole stretches are left out one after the other.
"""

from collections.abc import Iterable, Sequence
import math

import numpy as np

from twin.estimate.regression import solved

PIECES = 16
"""Pieces of the rows of each run."""

SURE = 3.0
"""A law replaces a simpler one if its held-out log density is larger by more than this many standard errors over the pieces."""

LEAST_IMPROVEMENT = 0.02
"""A richer model of a whole system is taken if it lowers the mean log RMS by more than this, and on no left-out stretch raises it by more."""

LEAST_RMS = 1e-10
"""Lower bound of an RMS, in units of the signal's range."""


def pieces_of(rows: int, run: int = 0) -> np.ndarray:
    """(row,) Number of the piece of each row of a run; an even number of pieces, so that halves alternate across runs."""
    return run * PIECES + np.arange(rows) * PIECES // max(rows, 1)


def held_out(columns: np.ndarray, y: np.ndarray, pieces: np.ndarray, use: np.ndarray | None = None) -> np.ndarray:
    """(piece,) Mean square of what a linear law leaves on each piece, fitted on the pieces of the other half; rows outside `use` do not count."""
    half, use = pieces % 2, np.ones(len(y), bool) if use is None else use
    left = np.empty(len(y))
    for out in (0, 1):
        rows = (half != out) & use
        left[half == out] = y[half == out] - columns[half == out] @ solved(columns[rows], y[rows])
    squares = np.bincount(pieces, np.where(use, left**2, 0.0))
    counts = np.bincount(pieces, use)
    return squares[counts > 0] / counts[counts > 0]


def is_better(richer: np.ndarray, simpler: np.ndarray, rounding: float) -> bool:
    """Whether the richer law predicts its held-out pieces better, from the mean squares of both (piece,); RMS below `rounding` are equal."""
    gain = 0.5 * np.log(np.maximum(simpler, rounding**2) / np.maximum(richer, rounding**2))
    return bool(gain.mean() > SURE * gain.std(ddof=1) / np.sqrt(len(gain))) if len(gain) > 1 else False


def rms_of(values: np.ndarray) -> float:
    """RMS of a residual, at least LEAST_RMS."""
    return max(float(np.sqrt(np.mean(values**2))), LEAST_RMS) if len(values) else LEAST_RMS


def mean_log_rms(signals: Iterable[np.ndarray]) -> float:
    """Mean log RMS of several residuals, weighted by their numbers of rows: the negative log density per row, up to a constant."""
    sizes = [(len(v), math.log(rms_of(v))) for v in signals]
    return sum(n * value for n, value in sizes) / max(sum(n for n, _ in sizes), 1)


def predicts_better(richer: Sequence[float], simpler: Sequence[float]) -> bool:
    """Whether left-out stretches are predicted clearly better on average, and none clearly worse, from the mean log RMS of both."""
    gains = np.array(simpler) - np.array(richer)
    return bool(np.isfinite(richer).all() and gains.mean() > LEAST_IMPROVEMENT and gains.min() > -LEAST_IMPROVEMENT)
