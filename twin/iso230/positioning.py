"""Positioning of one axis by ISO 230-2: accuracy A, repeatability R, systematic deviation E, its mean range M, reversal value B.

With the deviation x_ij = measured - target of cycle j at position i, its mean x_i and standard deviation s_i (n - 1) of each
direction, and coverage factor k = 2:

    B_i = x_i> - x_i<                  B = max |B_i|
    R_i> = 4 s_i>                      R_i = max(2 s_i> + 2 s_i< + |B_i|, R_i>, R_i<)          R = max R_i
    E> = max x_i> - min x_i>           E = max(x_i>, x_i<) - min(x_i>, x_i<)
    M = max x_i - min x_i, x_i the mean of both directions
    A> = max(x_i> + 2 s_i>) - min(x_i> - 2 s_i>)                A the same over both directions

> is the forward, < the backward direction. Lengths in m, angles in rad.
"""

from dataclasses import dataclass

import numpy as np

from twin.errors import InputError

COVERAGE = 2.0
"""Coverage factor k of the standard."""
WAYS = ("forward", "backward")


@dataclass(frozen=True)
class Readings:
    """Deviations of one axis: `target` (position,), `forward` and `backward` (position, cycle) measured - target, [m] or [rad]."""

    target: np.ndarray
    forward: np.ndarray
    backward: np.ndarray


@dataclass(frozen=True)
class Positioning:
    """Numbers of the standard for one axis, and means and standard deviations (direction, position), forward first."""

    target: np.ndarray
    mean: np.ndarray
    spread: np.ndarray
    numbers: dict[str, float]


def positioning(readings: Readings) -> Positioning:
    """Evaluate readings by the standard. Raises InputError for too few positions or cycles."""
    if len(readings.target) < 2:
        raise InputError(f"ISO 230-2: {len(readings.target)} target position; measure at least 2, the standard requires 5")
    if min(readings.forward.shape[1], readings.backward.shape[1]) < 2:  # one has no standard deviation
        raise InputError("ISO 230-2: one cycle in a direction; measure at least 2, the standard requires 5")
    mean, spread = np.array([(x.mean(axis=1), x.std(axis=1, ddof=1)) for x in (readings.forward, readings.backward)]).swapaxes(0, 1)
    reversal = mean[0] - mean[1]
    repeat = 2.0 * COVERAGE * spread
    both = np.maximum(COVERAGE * spread.sum(axis=0) + np.abs(reversal), repeat.max(axis=0))
    lower, upper = mean - COVERAGE * spread, mean + COVERAGE * spread
    numbers = {
        "A": upper.max() - lower.min(),
        "A_forward": upper[0].max() - lower[0].min(),
        "A_backward": upper[1].max() - lower[1].min(),
        "R": both.max(),
        "R_forward": repeat[0].max(),
        "R_backward": repeat[1].max(),
        "E": np.ptp(mean),
        "E_forward": np.ptp(mean[0]),
        "E_backward": np.ptp(mean[1]),
        "M": np.ptp(mean.mean(axis=0)),
        "B": np.abs(reversal).max(),
        "B_mean": reversal.mean(),
    }
    return Positioning(readings.target, mean, spread, {name: float(value) for name, value in numbers.items()})
