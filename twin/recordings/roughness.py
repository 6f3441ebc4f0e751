"""Noise of a record: robust standard deviations, which ignore outliers, and the step of a record with few digits."""

import math

import numpy as np

NORMAL_OVER_MEDIAN = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

SECOND_DIFFERENCE = 6.0
"""Variance of second differences of white noise over its own: 1 + 4 + 1."""

SAME_LEVEL = 1e-12
"""Largest relative difference of two values that are one level, rounded differently."""

LEAST_LEVELS = 3
"""Fewest differences between neighbouring levels that show a grid."""

OFF_GRID = 0.02
"""Largest deviation of a level from the grid, in steps."""

NEAR_STEPS = (1.5, 20.0, 1e3)
"""Gaps of fewer steps determine the step one after the other: that of a printed number is exact to some digits only, a single one least."""

FINEST, BY_CHANCE = 1e-9, 20
"""Smallest step relative to the largest value; a finer one is that of the numbers themselves. So few gaps may have a common divisor by chance."""

LEAST_UNEVEN, NEAR = 0.1, 25
"""Smallest share of fourth differences that are a step or more, among those within NEAR samples of one that is. Rests and moves at constant speed,
acceleration or jerk may have values on a grid without any rounding; their fourth differences are zero but where one follows another."""


FOURTH_DIFFERENCE = (1.0, -4.0, 6.0, -4.0, 1.0)
"""Weights of a fourth difference. It suppresses motion of a tenth of the sampling rate 50 times as strongly as white noise."""

WINDOW = 100
"""The level of white noise is measured in stretches of so many samples."""

QUIET = 0.25
"""Share of quiet stretches. Their loudest one gives the level, since a motion, an event or a fault is loud only elsewhere."""

WHITE = -0.6
"""Largest correlation of neighbouring fourth differences of white noise: -0.8 if the samples are independent, positive for a motion."""


def robust_deviation(values: np.ndarray) -> float:
    """Standard deviation about zero, from the median of the magnitudes; robust against outliers."""
    return NORMAL_OVER_MEDIAN * float(np.median(np.abs(values)))


def roughness(values: np.ndarray) -> float:
    """Robust standard deviation of second differences: sqrt(SECOND_DIFFERENCE) times that of white noise. Slow changes have no influence."""
    return robust_deviation(np.diff(values, 2))


def step_of(values: np.ndarray) -> float:
    """Step of the grid of all values (sample,), as in a record with few digits; 0 if there is none."""
    levels = np.unique(values)
    gaps = np.diff(levels)
    gaps = gaps[gaps > SAME_LEVEL * np.abs(levels).max(initial=0.0)]
    if len(gaps) < LEAST_LEVELS:
        return 0.0
    step, off = _refined(gaps, float(gaps.min()))
    while off.size:  # among values of many digits no two may be one step apart: the common divisor of the gaps
        if len(gaps) <= BY_CHANCE or off.min() < FINEST * np.abs(levels).max():
            return 0.0
        step, off = _refined(gaps, float(off.min()))
    step = float(gaps.sum() / np.round(gaps / step).sum())
    counts = gaps / step
    uneven = np.abs(np.diff(values, 4)) > 0.5 * step
    near = np.convolve(uneven, np.ones(2 * NEAR + 1), "same")[: len(uneven)] > 0.5
    if np.abs(counts - np.round(counts)).max() >= OFF_GRID or not near.any() or np.mean(uneven[near]) < LEAST_UNEVEN:
        return 0.0
    return step


def _refined(gaps: np.ndarray, step: float) -> tuple[float, np.ndarray]:
    """The step, which the shorter gaps make more exact for the longer ones, and the remainders of gaps that are no multiple of it.

    The gap of one step alone is no more exact than the values.
    """
    for most in NEAR_STEPS:
        few = gaps[gaps < most * step]
        rest = np.abs(few - np.round(few / step) * step)
        if (off := rest[rest >= OFF_GRID * step]).size:
            return step, off
        step = float(few.sum() / np.round(few / step).sum()) if few.size else step
    return step, np.zeros(0)


def resolution_of(values: np.ndarray) -> float:
    """What values (sample,) cannot show less than: the step of their grid, or that of floating-point numbers of their size."""
    return max(step_of(values), float(np.spacing(np.abs(values).max(initial=0.0))))


def decimal_place(values: np.ndarray, coarsest: int = 0, off: float = 1e-3) -> float:
    """Decimal place of all values: 1e-3 if they have three decimals, up to 10 ** -`coarsest`; 0 if it is below 1e-9. `off`: tolerance, in places."""
    for exponent in range(coarsest, 10):
        scaled = values * 10.0**exponent
        if np.all(np.abs(scaled - np.rint(scaled)) < off):
            return 10.0**-exponent
    return 0.0


def quiet_noise(values: np.ndarray) -> tuple[float, bool]:
    """(variance of the white noise of a record (sample,) in its quiet stretches, whether it is white). Shorter records show none: (0, False).

    Neither does a record of calculated values, whose numbers differ from a motion by the last digit of a floating-point number.
    If it is not white, the fine changes of the record are a motion, and the variance is an upper bound.
    """
    d = np.convolve(values, FOURTH_DIFFERENCE, mode="valid") / math.sqrt(sum(w * w for w in FOURTH_DIFFERENCE))
    if len(d) < 2 * WINDOW:
        return 0.0, False
    stretches = d[: len(d) // WINDOW * WINDOW].reshape(-1, WINDOW)
    squares = np.mean(stretches**2, axis=1)
    level = float(np.quantile(squares, QUIET, method="higher"))
    if level <= float(np.spacing(np.abs(values).max())) ** 2:
        return 0.0, False
    quiet = stretches[squares <= level]
    return level, float(np.mean(quiet[:, 1:] * quiet[:, :-1])) < WHITE * float(np.mean(quiet**2))
