"""Jitter of a scale: its sampling instants scatter by tau, so that its readings scatter by speed times tau.

Second differences of the displacement between the encoders contain the scatter of single samples and hardly any smooth law. In bins
of the speed v, their variance is s^2 + tau^2 v^2. A jitter is accepted if this predicts runs left out better than a constant scatter, if the
scatter grows in proportion to the speed, if it is normally distributed, and if neighbouring samples are independent. A fine wave of the scale,
for example, scatters equally at all speeds, and a wave of several samples links neighbours.
"""

import math

import numpy as np
from scipy.optimize import least_squares

from twin.diagnose.law.measure import MeasuredCurve
from twin.diagnose.law.relations import Relation
from twin.diagnose.law.residual import Samples
from twin.diagnose.law.shapes import Described
from twin.recordings.roughness import robust_deviation

BINS = 16
"""Number of speed bins with equal numbers of samples."""

LEAST_IN_BIN = 30
"""Smallest number of samples in a bin."""

LEAST_EVIDENCE = 50.0
"""Smallest increase of the log likelihood of runs left out."""

MOST_LIKELY = 4.5
"""Largest scatter of a sample in standard deviations; a larger deviation is an event such as a reversal."""

EXPONENT = (0.8, 1.2)
"""Range of the exponent of the speed in the scatter of a jitter."""

KURTOSIS = (2.4, 3.8)
"""Range of the kurtosis of the scatter of a jitter; 3 for a normal distribution, 1.5 for a sine."""

NEIGHBOURS = (-0.8, -0.53)
"""Range of the correlation of neighbouring second differences of a jitter; -2/3 if the samples are independent."""


def jitter_of(samples: Samples) -> Described | None:
    """The jitter of the displacement between the encoders, or None. Needs at least two runs."""
    d, speed, part = _scatter(samples)
    if len(np.unique(part)) < 2 or len(d) < BINS * LEAST_IN_BIN:
        return None
    edges = np.quantile(speed, np.linspace(0.0, 1.0, BINS + 1))
    of = np.clip(np.searchsorted(edges, speed, "right") - 1, 0, BINS - 1)
    scatter = np.array([robust_deviation(d[of == i]) if (of == i).any() else 0.0 for i in range(BINS)])
    # a coarse encoder does not scatter at low speed: most of its readings lie on a line or are equal
    full = (np.bincount(of, minlength=BINS) >= LEAST_IN_BIN) & (scatter > 0.0)
    if full.sum() < BINS // 2:
        return None
    x = np.array([math.sqrt(float(np.mean(speed[of == i] ** 2))) for i in np.flatnonzero(full)])
    y = scatter[full]
    if not EXPONENT[0] < _fitted(x, y)[2] < EXPONENT[1]:
        return None
    rest, tau, _ = _fitted(x, y, 1.0)
    evidence, runs_better = 0.0, 0.0
    for run in np.unique(part):
        rows, others = part == run, part != run
        constant = np.full(rows.sum(), robust_deviation(d[others]))
        bins = [(x[i], robust_deviation(d[others & (of == k)])) for i, k in enumerate(np.flatnonzero(full)) if (others & (of == k)).any()]
        bins = [(v, deviation) for v, deviation in bins if deviation > 0.0]
        if len(bins) < BINS // 2 or not constant.any():
            return None
        speeds, deviations = np.array(bins).T
        own_rest, own_tau, _ = _fitted(speeds, deviations, 1.0)
        gain = _likelihood(d[rows], np.hypot(own_rest, own_tau * speed[rows])) - _likelihood(d[rows], constant)
        evidence += gain
        runs_better += rows.mean() * (gain > 0.0)
    normal = d / np.hypot(rest, tau * speed)
    likely = np.abs(normal) < MOST_LIKELY
    square = float(np.mean(normal[likely] ** 2))
    kurtosis = float(np.mean(normal[likely] ** 4)) / square**2
    pairs = (part[1:] == part[:-1]) & likely[1:] & likely[:-1]
    correlation = float(np.mean((normal[1:] * normal[:-1])[pairs])) / square
    if evidence < LEAST_EVIDENCE or not KURTOSIS[0] < kurtosis < KURTOSIS[1] or not NEIGHBOURS[0] < correlation < NEIGHBOURS[1]:
        return None
    relation = Relation("measurement", "displacement", "speed")
    power = tau**2 * float(np.mean(speed**2))
    band = y / np.sqrt(2.0 * np.bincount(of, minlength=BINS)[full])
    curve = MeasuredCurve(relation, power / (rest**2 + power), runs_better, x, y, band)
    return Described(relation, "jitter", {"deviation_s": tau}, curve.predicts, curve, np.zeros(len(samples)))


def _scatter(samples: Samples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scatter (sample,) of single samples, their speed and their run: second differences, scaled to the variance of white noise."""
    inner = np.flatnonzero(samples.run[2:] == samples.run[:-2]) + 1
    d = (samples.y[inner - 1] - 2.0 * samples.y[inner] + samples.y[inner + 1]) / math.sqrt(6.0)
    return d, np.abs(samples.motion["velocity"][inner]), samples.run[inner]


def _fitted(x: np.ndarray, y: np.ndarray, exponent: float | None = None) -> tuple[float, float, float]:
    """Scatter at rest, deviation in time tau and exponent n of y^2 = rest^2 + (tau top (x / top)^n)^2.

    y (bin,) are the standard deviations at the speeds x (bin,), whose largest is `top`; n is fixed if `exponent` is given.
    """
    top = float(x.max())
    u = x / top

    def of(p: np.ndarray) -> np.ndarray:
        n = exponent if exponent is not None else p[2]
        return np.hypot(math.exp(p[0]), math.exp(p[1]) * u**n)

    start = np.log([max(float(y.min()), 1e-3 * float(y.max())), float(y.max())])
    free = start if exponent is not None else np.append(start, 1.0)
    p = least_squares(lambda p: np.log(of(p) / y), free).x
    return math.exp(p[0]), math.exp(p[1]) / top, float(exponent if exponent is not None else p[2])


def _likelihood(values: np.ndarray, deviation: np.ndarray) -> float:
    """Log likelihood of normally distributed values (sample,); events beyond MOST_LIKELY count as much as that."""
    return float(-np.sum(0.5 * np.minimum((values / deviation) ** 2, MOST_LIKELY**2) + np.log(deviation)))
