"""A change in a series of sizes: one test with a stated rate of false alarms, the onset, the size, and the date when a limit is reached.

The size y(t) of a direction in recording t is compared with two laws,

    none     y = C c + e                     C (recording, n): a constant of each program, and what the other axes show of temperature and season
    change   y = C c + d x(t - onset) + e    x a step, or a ramp

with e normal and independent, of unknown variance, and d ~ N(0, g^2 var e). The ratio L(onset, t) of their marginal likelihoods, all unknowns
integrated with their invariant prior, has the closed form

    L = (1 + g^2 q)^-1/2 (1 - g^2 s^2 / ((1 + g^2 q) R))^-(n/2)     q = x'Px, s = x'Py, R = y'Py, n = recordings - columns of C, P removes C

and the expectation 1 without a change, whatever the variance and the constants. R(t), the sum of L over all onsets, averaged over shapes, sizes g and
causes, therefore grows by one in each recording on average if nothing changes (Shiryaev and Roberts): the mean time between false alarms of the rule
R > A is at least A recordings. Averaged over all causes it is one rule for the machine: more causes cost delay, not false alarms.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy import stats

SIZES = (1.5, 4.0, 12.0)
"""Sizes of a change that the test is made for, in standard deviations of the scatter between recordings."""

RAMP = 8.0
"""A growing change reaches such a size within so many recordings."""

LONGEST = 120
"""Recordings that the test looks back."""


def without(nuisance: np.ndarray) -> np.ndarray:
    """Orthonormal columns that span the nuisances (recording, column)."""
    left, size, _ = np.linalg.svd(nuisance, full_matrices=False)
    return np.asarray(left[:, size > 1e-9 * max(size.max(initial=0.0), 1e-300)])


def evidence(y: np.ndarray, nuisance: np.ndarray, least: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Evidence for a change in each column of y (recording, direction) at the last recording, next to `nuisance` (recording, column).

    Returns the sum over onsets of the likelihood ratio of each direction, and the most likely onset, the first changed recording (direction,). A standard deviation of `least` is added to the scatter: changes that are small beside it are no news.
    """
    count = len(y)
    basis = without(nuisance)
    free = count - basis.shape[1]
    if free < 2:
        return np.zeros(y.shape[1]), np.zeros(y.shape[1], int)
    rest = y - basis @ (basis.T @ y)
    square = np.maximum((rest**2).sum(axis=0) + free * least**2, 1e-300)
    total = np.zeros((count, y.shape[1]))
    since = np.arange(count)[:, None] - np.arange(count)[None, :]
    for x in (since >= 0, np.maximum(since + 1, 0) / RAMP):  # steps and ramps from each onset (recording, onset)
        x = x - basis @ (basis.T @ x)
        q = (x**2).sum(axis=0)[:, None]
        share = (x.T @ rest) ** 2 / square
        for g in SIZES:
            spread = 1.0 + g**2 * q
            left = np.maximum(1.0 - g**2 * share / spread, 1e-12)
            total += np.exp(np.minimum(-0.5 * np.log(spread) - 0.5 * free * np.log(left), 600.0))
    total /= len(SIZES) * 2
    return total.sum(axis=0), total.argmax(axis=0)


@dataclass(frozen=True)
class Level:
    """Mean difference of a series after an onset, its standard error, degrees of freedom, and the scatter of single recordings."""

    size: float
    error: float
    free: int
    scatter: float

    def times(self, factor: float) -> Self:
        """The same in other units."""
        return replace(self, size=factor * self.size, error=abs(factor) * self.error, scatter=abs(factor) * self.scatter)

    def half(self, confidence: float = 0.95) -> float:
        """Half the interval."""
        return float(stats.t.ppf(0.5 + 0.5 * confidence, max(self.free, 1)) * self.error)


def level(y: np.ndarray, nuisance: np.ndarray, onset: int) -> Level:
    """Size of a change of y (recording,) at the last recording, next to what the nuisances (recording, column) predict.

    The change grows for g recordings from its onset on, then stays: y = C c + d min((t - onset + 1) / g, 1) + e. Its size is the mean of d over all g that are
    possible, each by its likelihood. The scatter is that before the onset, where nothing grows; with too few recordings there it is that of both parts.
    """
    count = len(y)
    since = np.maximum(np.arange(count) - onset + 1, 0)[:, None]
    x = np.minimum(since / np.arange(1, count - onset + 1), 1.0)  # (recording, g)
    basis = without(nuisance)
    x, rest = x - basis @ (basis.T @ x), y - basis @ (basis.T @ y)
    q = np.maximum((x**2).sum(axis=0), 1e-12)
    sizes = x.T @ rest / q
    left = np.maximum(rest @ rest - q * sizes**2, 1e-300)
    free = max(count - basis.shape[1] - 1, 1)
    weight = (left / left.min()) ** (-0.5 * free)
    weight /= weight.sum()
    square = float(weight @ left) / free
    before = without(nuisance[:onset])
    if (free_before := onset - before.shape[1]) >= 3:
        own = y[:onset] - before @ (before.T @ y[:onset])
        square, free = float(own @ own) / free_before, free_before
    size = float(weight @ sizes)
    return Level(size, float(np.sqrt(weight @ (square / q + (sizes - size) ** 2))), free, float(np.sqrt(square)))


@dataclass(frozen=True)
class Forecast:
    """Day when a growing size reaches a limit, with the earliest and the latest day of its 95 % interval (inf: never)."""

    day: float
    earliest: float
    latest: float


def forecast(day: np.ndarray, size: np.ndarray, limit: float, now: float) -> Forecast | None:
    """When a straight line through the sizes since the onset reaches +-`limit`; None without a certain growth towards it."""
    if len(day) < 4:
        return None
    (slope, at), covariance = np.polyfit(day - now, size, 1, cov=True)
    wide = float(stats.t.ppf(0.975, len(day) - 2))
    goal = np.copysign(limit, at)
    if abs(slope) < wide * np.sqrt(covariance[0, 0]) or (slope > 0.0) != (goal > 0.0):
        return None
    ahead = np.concatenate([[0.0], np.geomspace(1.0, 3650.0, 400)])
    line = at + slope * ahead
    half = wide * np.sqrt(covariance[1, 1] + 2.0 * ahead * covariance[0, 1] + ahead**2 * covariance[0, 0])
    toward = np.sign(goal)

    def reached(values: np.ndarray) -> float:
        over = np.flatnonzero(toward * values >= limit)
        return float(now + ahead[over[0]]) if over.size else float("inf")

    return Forecast(reached(line), reached(line + toward * half), reached(line - toward * half))
