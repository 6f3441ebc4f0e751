"""Noise of a channel, estimated from realisations of the twin's noise and from the roughness of the record."""

from dataclasses import replace
import math

import numpy as np
from scipy.ndimage import uniform_filter1d

from twin.diagnose.channel import Channel, Scatter
from twin.diagnose.settings import T
from twin.diagnose.tolerance import normal_slip
from twin.diagnose.view import RunView, rests
from twin.machine.machine import Axis
from twin.recordings.roughness import SECOND_DIFFERENCE, roughness, step_of
from twin.recordings.trace import ENCODERS
from twin.simulation.gap import LEAST_NOISE, REALISATIONS, sensor_noise


def with_noise(channel: Channel, scatter: Scatter, rough: np.ndarray, view: RunView) -> Channel:
    """The channel with noise estimated from realisations and from `rough` (sample,), the residual of its own record."""
    axis = view.machine.axis(channel.axis)
    signals = {"motor_minus_scale": ENCODERS, "current": (axis.effort,)}.get(channel.name, (channel.name,))
    noisier = T.outlier if sensor_noise(view.machine, axis, signals[0]) > 0.0 else None
    sigma = np.maximum(_sigma_of(scatter.deviations, scatter.jitter, rough, noisier), _least(view, axis, channel.name))
    steps = [step_of(view.trace.get(axis.name, s)) for s in signals if view.trace.has(axis.name, s)]  # 0 unless a record has few digits
    sigma = np.maximum(sigma, math.hypot(*steps) / math.sqrt(12.0))
    if channel.name == "position":  # the rest position is random within the normal slip
        at_rest = rests(view, channel.axis, T.break_away_s)[view.rows_of(channel.axis, channel.name)]
        sigma = np.hypot(sigma, np.where(at_rest, T.resting * normal_slip(axis), 0.0))
    return replace(channel, sigma=sigma, correlation=_correlation_of(scatter.deviations / sigma, T.noise_correlation), scatter=scatter)


def _least(view: RunView, axis: Axis, channel: str) -> float:
    """Resolution of a channel [SI]: smallest noise level."""
    machine = view.machine
    if channel == "position" and view.ballbar is not None and axis.name in view.ballbar.axes:
        return view.ballbar.noise
    if channel == "current":
        no_less = 0.0 if axis.actuator.winding and machine.noise(axis).current else sensor_noise(machine, axis, axis.effort)
        return max(no_less, LEAST_NOISE["current"])
    return LEAST_NOISE["position" if channel == "motor_minus_scale" else channel]


def _sigma_of(deviations: np.ndarray, jitter: np.ndarray, residual: np.ndarray, noisier: float | None) -> np.ndarray:
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


def _correlation_of(normed: np.ndarray, longest: int) -> float:
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
