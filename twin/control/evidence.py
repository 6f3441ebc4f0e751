"""Held-out evidence between two laws for one recorded signal: the pieces of the motion are alternately fitted and predicted."""

from __future__ import annotations

import numpy as np

from twin.recordings.least_squares import solved

PIECES = 16
"""Pieces of the rows of each run."""

SURE = 3.0
"""A law replaces a simpler one if its held-out log density is larger by more than this many standard errors over the pieces."""


def pieces_of(rows: int, run: int = 0) -> np.ndarray:
    """(row,) Number of the piece of each row of a run; an even number of pieces, so that halves alternate across runs."""
    return run * PIECES + np.arange(rows) * PIECES // max(rows, 1)


def held_out(columns: np.ndarray, y: np.ndarray, pieces: np.ndarray, use: np.ndarray) -> np.ndarray:
    """(piece,) Mean square of what a linear law leaves on each piece, fitted on the pieces of the other half; rows outside `use` do not count."""
    half = pieces % 2
    left = np.empty(len(y))
    for out in (0, 1):
        rows = (half != out) & use
        left[half == out] = y[half == out] - columns[half == out] @ solved(columns[rows], y[rows])
    squares = np.bincount(pieces, np.where(use, left**2, 0.0))
    counts = np.bincount(pieces, use)
    return squares[counts > 0] / counts[counts > 0]


def is_better(richer: np.ndarray, simpler: np.ndarray, rounding: float = 1e-150) -> bool:
    """Whether the richer law predicts its held-out pieces better, from the mean squares of both (piece,); RMS below `rounding` are equal."""
    gain = 0.5 * np.log(np.maximum(simpler, rounding**2) / np.maximum(richer, rounding**2))
    return bool(gain.mean() > SURE * gain.std(ddof=1) / np.sqrt(len(gain))) if len(gain) > 1 else False
