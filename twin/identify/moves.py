"""The moves of an axis in its recordings, and their folds for cross-validation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.machine.machine import Axis
from twin.recordings.campaign import MeasuredRun
from twin.simulation.gap import is_moving

FOLDS = 4
"""Largest number of folds."""


def folds_of(axis: Axis, runs: Sequence[MeasuredRun], rows: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
    """Masks (fold, run) of (sample,): the `rows` of an axis by its moves in FOLDS parts or fewer; empty with a single move.

    A move has one direction. The rest after a move belongs to it, and so does the rest before the first one.
    """
    numbers, count = [], 0
    for run, used in zip(runs, rows):
        signs = np.sign(np.gradient(run.trace.get(axis.name, "setpoint"), run.trace.period)) * (is_moving(run.trace, axis) & used)
        moving = np.flatnonzero(signs)
        new = np.zeros(len(signs), bool)
        if len(moving):
            paused = np.diff(moving) > 1
            new[moving[1:]] = paused | (np.diff(signs[moving]) != 0)
        numbers.append(count + np.cumsum(new))
        count += int(new.sum()) + bool(len(moving))
    if count < 2:
        return []
    folds = min(count, FOLDS)
    return [[used & (number * folds // count == k) for number, used in zip(numbers, rows)] for k in range(folds)]
