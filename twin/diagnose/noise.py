"""How noisy a channel is: from realisations of the twin's noise, and from how rough the record itself is."""

from __future__ import annotations

import numpy as np

from twin.recordings.roughness import SECOND_DIFFERENCE, roughness
from twin.simulation.gap import REALISATIONS


def sigma_of(deviations: np.ndarray, jitter: np.ndarray, residual: np.ndarray, noisier: float | None) -> np.ndarray:
    """Standard deviation of noise (sample,): scatter of the realisations, smoothed, not below what the record itself shows.

    The motion that noise in the loop makes, variance `jitter`, is too small by 1 / K in deviations from a mean of K and comes
    in again with that mean. A sensor noisier than the machine file says shows in sample-to-sample differences, which slow
    faults leave alone: up to `noisier` times what is expected they count as noise. Where the machine file knows no noise of the sensor
    (`noisier` None) all of them do.
    """
    square = np.mean(deviations**2, axis=0) + 2.0 / REALISATIONS * jitter
    window = min(51, len(square) | 1)
    smooth = np.convolve(np.pad(square, window // 2, mode="edge"), np.ones(window) / window, mode="valid")[: len(square)]
    level = float(np.mean(square))
    if len(residual) < 3:  # no second difference
        return np.sqrt(np.maximum(smooth, 0.5 * level))
    measured = roughness(residual) ** 2
    expected = float(np.mean(np.diff(deviations, 2, axis=1) ** 2))
    if noisier is None:
        smooth = np.maximum(smooth, measured / SECOND_DIFFERENCE)
    elif expected > 0.0 and 1.0 < measured / expected < noisier**2:
        smooth = smooth * measured / expected
    return np.sqrt(np.maximum(smooth, 0.5 * level))


def correlation_of(normed: np.ndarray, longest: int) -> float:
    """Integrated correlation (>= 1) of noise: how many samples carry the information of one."""
    n = normed.shape[1]
    lags = min(longest, n // 4)
    if lags < 2:
        return 1.0
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.mean(np.abs(np.fft.rfft(normed - normed.mean(axis=1, keepdims=True), size, axis=1)) ** 2, axis=0)
    correlation = np.fft.irfft(spectrum)[: lags + 1]
    if correlation[0] <= 0:
        return 1.0
    taper = 1.0 - np.arange(1, lags + 1) / (lags + 1)
    return float(max(1.0, 1.0 + 2.0 * np.sum(taper * correlation[1:] / correlation[0])))
