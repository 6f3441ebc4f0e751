"""Noise of a channel, estimated from realisations of the twin's noise and from the roughness of the record."""

import numpy as np
from scipy.ndimage import uniform_filter1d

from twin.recordings.roughness import SECOND_DIFFERENCE, roughness
from twin.simulation.gap import REALISATIONS


def sigma_of(deviations: np.ndarray, jitter: np.ndarray, residual: np.ndarray, noisier: float | None) -> np.ndarray:
    """Standard deviation of the noise (sample,): smoothed scatter of the realisations, at least that of the record.

    K realisations underestimate the variance `jitter` of the motion that noise causes by 1 / K, and their mean adds another 1 / K. If the record
    is rougher than expected, the sensor is noisier than the machine file says: up to `noisier` times the expected roughness counts as noise. Slow
    faults do not change sample-to-sample differences. With `noisier` None (no sensor noise in the machine file) all roughness counts as noise.
    """
    square = np.mean(deviations**2, axis=0) + 2.0 / REALISATIONS * jitter
    smooth = uniform_filter1d(square, min(51, len(square) | 1), mode="nearest")
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
    """Integrated autocorrelation of the noise (>= 1): number of samples that carry the information of one independent sample."""
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
