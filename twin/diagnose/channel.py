"""One signal of one axis in one run: residual, noise and model error."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import functools

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from twin.diagnose.settings import T
from twin.diagnose.view import RunView, rests


@dataclass(frozen=True)
class Scatter:
    """Noise of a channel in several realisations: `deviations` (realisation, sample) from the expectation, and the variance `jitter` (sample,)
    of the motion that noise in the loop causes.
    """

    deviations: np.ndarray
    jitter: np.ndarray


def exceeds(u: np.ndarray, square: float) -> bool:
    """Is the mean square of residuals over their noise (sample,) larger by more than chance?"""
    return float(np.mean(u**2)) > square + T.outlier * np.sqrt(2.0 / len(u))


@dataclass(frozen=True)
class Channel:
    """Residual of one channel of one axis in one run: measured minus the expectation of the nominal twin (sample,).

    `sigma` (sample,) is the standard deviation of the noise, `correlation` the number of samples that carry the information of one independent
    sample. `doubt` (sample,) is the model error of the effects found, `model` (sample,) the model error of a healthy machine; both are correlated
    over many samples. `credit` (sample,) is the weight of a sample as evidence. `sigma` was estimated from `scatter`.
    """

    run: int
    axis: str
    name: str
    residual: np.ndarray
    sigma: np.ndarray
    correlation: float
    rows: slice = field(default_factory=lambda: slice(0, 0))  # rows in the stacked vector of the group
    doubt: np.ndarray | float = 0.0
    model: np.ndarray | float = 0.0
    credit: np.ndarray | float = 1.0
    scatter: Scatter | None = field(default=None, repr=False)

    @functools.cached_property
    def is_clean(self) -> bool:
        """True if mean square and moving averages are those of noise."""
        u = self.residual / np.hypot(self.sigma, self.model)
        n = len(u)
        if self.name == "controller":  # rounding, not noise: bounded, and constant over many samples at constant speed
            return float(np.mean(u**2)) < T.by_chance
        if exceeds(u, T.clean_square):
            return False
        for width in (25, 400):
            if n > 4 * width:
                means = u[: n // width * width].reshape(-1, width).mean(axis=1) * np.sqrt(width / self.correlation)
                if exceeds(means, T.by_chance) or float(np.abs(means).max()) > T.outlier:
                    return False
        return True

    def settled(self, view: RunView, shortest_rest_s: float = 0.0) -> np.ndarray:
        """Mask (sample,) of the samples that do not depend on how the axis stuck before; rests shorter than `shortest_rest_s` do not count."""
        free = ~rests(view, self.axis, T.settled_s, shortest_rest_s)
        if self.name == "controller":
            return np.ones(len(self.residual), bool)
        return free[view.rows_of(self.axis, self.name)]

    @property
    def spread(self) -> np.ndarray:
        """Root sum of squares of noise, model error and doubt (sample,)."""
        return np.hypot(np.hypot(self.sigma, self.model), self.doubt)

    @property
    def expected(self) -> np.ndarray:
        """Expected square of a weighted sample from noise and doubt (sample,). The model error of a healthy machine is not part of it: it lowers the
        weight, but a healthy machine need not show it.
        """
        return (np.square(self.sigma) + np.square(self.doubt)) * self._weight(np.square(self.doubt)) ** 2

    @property
    def weight(self) -> np.ndarray:
        """Weight of each sample (sample,)."""
        return self._weight(np.square(self.model) + np.square(self.doubt))

    def _weight(self, faults: np.ndarray | float) -> np.ndarray:
        """sqrt(credit / (sigma^2 correlation + faults n / shapes)), (sample,): n samples of one model error count as `shapes` independent ones."""
        many = max(len(self.sigma) / T.shapes, 1.0)
        return np.sqrt(self.credit / (self.sigma**2 * self.correlation + faults * many))

    def with_model_error(self, change: np.ndarray, residual: np.ndarray, period: float) -> Channel:
        """The channel with the model error of effects whose response is `change` (sample,); `period` of the record [s].

        The error is a share of the response. Where the mean square of `residual` (sample,) around a sample exceeds noise, the excess is added.
        """
        doubt = T.doubt * maximum_filter1d(np.abs(change), 2 * round(T.lag_s / period) + 1)
        around = uniform_filter1d(np.square(residual), 2 * round(0.5 * T.event_s / period) + 1)
        return replace(self, doubt=np.sqrt(doubt**2 + np.maximum(around - T.by_chance * (self.sigma**2 + doubt**2), 0.0)))
