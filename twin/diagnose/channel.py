"""One signal of one axis in one run: what is left of it beside the twin, in noise and in doubt."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import functools

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from twin.diagnose.settings import DEFAULT, Thresholds
from twin.diagnose.view import RunView, rests


@dataclass(frozen=True)
class Scatter:
    """What noise makes of a channel in some realisations: their `deviations` (realisation, sample) from the expectation, sensors and loop,
    and the variance `jitter` (sample,) of what noise in the loop alone makes."""

    deviations: np.ndarray
    jitter: np.ndarray


@dataclass(frozen=True)
class Channel:
    """Residual of one channel of one axis in one run: measured minus the nominal twin's expectation (sample,).

    `sigma` (sample,) is what noise alone makes of it, `correlation` how many samples count as one. `doubt` (sample,) is how far the twin
    may be wrong about the effects that it has found, `model` (sample,) how far it may be wrong about a healthy machine; both are faults
    that are the same in many samples. `scatter` is what sigma was taken from.
    """

    run: int
    axis: str
    name: str
    residual: np.ndarray
    sigma: np.ndarray
    correlation: float
    rows: slice = field(default_factory=lambda: slice(0, 0))  # place in the stacked vector of the group
    doubt: np.ndarray | float = 0.0
    model: np.ndarray | float = 0.0
    scatter: Scatter | None = field(default=None, repr=False)
    thresholds: Thresholds = field(default=DEFAULT, repr=False)

    @functools.cached_property
    def is_clean(self) -> bool:
        """Nothing but noise: neither in power, nor in slow means, nor in single peaks."""
        u = self.residual / np.hypot(self.sigma, self.model)
        n, t = len(u), self.thresholds
        if self.name == "controller":  # rounding, not noise: bounded, and alike over many samples at constant speed
            means = u[: n // 25 * 25].reshape(-1, 25).mean(axis=1) if n >= 25 else u
            return bool(float(np.mean(u**2)) < t.clean_law_square and np.abs(means).max() < t.clean_law_mean)
        if float(np.mean(u**2)) > t.clean_square + t.clean_spread * np.sqrt(2.0 / n):
            return False
        for width in (25, 400):
            if n > 4 * width:
                means = u[: n // width * width].reshape(-1, width).mean(axis=1) * np.sqrt(width / self.correlation)
                if (
                    float(np.mean(means**2)) > t.clean_mean_square + t.clean_spread * np.sqrt(2.0 / len(means))
                    or float(np.abs(means).max()) > t.clean_mean
                ):
                    return False
        return True

    def settled(self, view: RunView) -> np.ndarray:
        """True for the samples that no longer show how the axis was stuck before (sample,)."""
        free = ~rests(view, self.axis, self.thresholds.settled_s)
        if self.name == "controller":
            return np.ones(len(self.residual), bool)
        return free[view.rows_of(self.axis, self.name)]

    @property
    def noise_weight(self) -> np.ndarray:
        """What a sample weighs where no effect is doubted (sample,)."""
        return self._weight(np.square(self.model))

    @property
    def spread(self) -> np.ndarray:
        """Noise, model error and doubt together (sample,)."""
        return np.hypot(np.hypot(self.sigma, self.model), self.doubt)

    @property
    def expected(self) -> np.ndarray:
        """Square that noise and doubt make of a weighted sample (sample,). Model error lowers what a sample weighs, not what is expected of
        it: thresholds are shares of this, and a healthy machine need not use up its model error."""
        return (np.square(self.sigma) + np.square(self.doubt)) * self._weight(np.square(self.doubt)) ** 2

    @property
    def weight(self) -> np.ndarray:
        """What a sample weighs (sample,)."""
        return self._weight(np.square(self.model) + np.square(self.doubt))

    def _weight(self, faults: np.ndarray | float) -> np.ndarray:
        """1 / sqrt(sigma^2 correlation + faults n / shapes), (sample,): n samples of the same fault count as so many shapes."""
        many = max(len(self.sigma) / self.thresholds.shapes, 1.0)
        return 1.0 / np.sqrt(self.sigma**2 * self.correlation + faults * many)

    def doubted(self, change: np.ndarray, residual: np.ndarray, period: float) -> Channel:
        """The channel where effects that change it by `change` (sample,) are trusted to a share of that; `period` of the record [s].

        `left` (sample,) is what they do not explain: as far as it stands out of noise around a sample, the twin is wrong there.
        """
        t = self.thresholds
        doubt = t.doubt * maximum_filter1d(np.abs(change), 2 * round(t.lag_s / period) + 1)
        around = uniform_filter1d(np.square(residual), 2 * round(0.5 * t.event_s / period) + 1)
        return replace(self, doubt=np.sqrt(doubt**2 + np.maximum(around - t.by_chance * (self.sigma**2 + doubt**2), 0.0)))
