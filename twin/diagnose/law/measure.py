"""Measured laws: the residual of a block as a smooth curve over one variable, cross-validated on runs left out.

The curve of a relation (`twin.diagnose.law.relations`) is a penalised cubic B-spline, fitted together with nuisance regressors for errors
of the machine file (constant, sign v, v, a). Each run is left out in turn and predicted from the others. Relations are ranked by the
fraction of the loss that they predict beyond the nuisance regressors. The Huber loss limits the influence of outliers such as break-aways.
"""

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np
from scipy.interpolate import BSpline
from scipy.special import huber

from twin.diagnose.law.relations import (
    Relation,
    contribution_to_residual,
    load_position,
    metre_of,
    relations_of,
    variable_of,
    zeroed_at_run_start,
)
from twin.diagnose.law.residual import MECHANICS, SPRING, Samples
from twin.machine.machine import Axis
from twin.recordings.roughness import robust_deviation

PIECES = 9
"""Spline segments over the measured range."""

TURN_PIECES = 24
"""Spline segments over one motor turn."""

PENALTIES = (1e-3, 1e-1, 1e1)
"""Tried weights of the second-difference penalty, relative to the normal matrix."""

QUANTILES = 65
"""Number of quantiles of a variable that define the spacing of its splines."""

RANGE = 2e-3
"""Fraction of the samples at each end of a variable outside the range of its curve."""

HUBER = 1.345
"""Huber threshold in standard deviations; the loss is linear above."""

SWEEPS = 4
"""Iterations of re-weighting; more change only the third digit."""

SMALL = 1e-9
"""Ridge relative to the normal matrix."""

CORRELATED = 5.0
"""Number of correlated samples, after smoothing, that count as one."""

FINEST_WAVE_M = 1e-5
"""Shortest period over the position [m]; scaled for a rotary axis."""

MOST_BINS = 200_000
"""Largest number of bins of the position."""

OVERSAMPLED = 4
"""Oversampling of the spectrum by zero padding."""

LEAST_WAVES = 3
"""Smallest number of periods in the range; longer periods are part of a curve over the position."""

WINDUP_SLOPE = 1
"""Column of the nuisance regressors of a spring that belongs to its stiffness."""


def nuisances_in(samples: Samples) -> np.ndarray:
    """Nuisance regressors (sample, n) for errors of the machine file: constant force, friction, inertia; encoder scale and drift; none
    but an offset for a control law."""
    ones = np.ones(len(samples))
    if samples.block == MECHANICS:
        v = samples.motion["velocity"]
        return np.column_stack([ones, np.sign(v), v, samples.motion["acceleration"]])
    if samples.block == "transmission":
        return zeroed_at_run_start(samples, np.column_stack([samples.motion["position"], samples.motion["time"]]))
    if samples.block == SPRING:
        return np.column_stack([ones, samples.motion["windup"], samples.motion["acceleration"]])
    return ones[:, None]


@dataclass(frozen=True)
class Basis:
    """Cubic B-splines over the measured range of a variable; `root` spaces them by the square root, `period` makes them periodic.

    `quantiles` (point,) of the variable space them by the density of samples: following errors of a few runs without feedforward are a
    thousand times those of the others.
    """

    knots: np.ndarray
    root: bool
    period: float = 0.0
    quantiles: np.ndarray | None = None

    def columns(self, x: np.ndarray) -> np.ndarray:
        """(sample, spline)."""
        u = self.place(x)
        full = BSpline.design_matrix(np.clip(u, self.knots[3], self.knots[-4] - 1e-12 * np.ptp(self.knots)), self.knots, 3).toarray()
        if not self.period:
            return full
        full[:, :3] += full[:, -3:]
        return full[:, :-3]

    def place(self, x: np.ndarray) -> np.ndarray:
        """The variable on the scale of the splines."""
        if self.period:
            return np.mod(x, self.period)
        if self.quantiles is not None:
            return np.interp(x, self.quantiles, np.linspace(0.0, 1.0, len(self.quantiles)))
        return np.sign(x) * np.sqrt(np.abs(x)) if self.root else x

    def penalty(self, count: int) -> np.ndarray:
        """Penalty matrix of second differences (count, count)."""
        d = np.diff(np.vstack([np.eye(count), np.eye(count)[:2]]) if self.period else np.eye(count), 2, axis=0)
        penalty: np.ndarray = d.T @ d
        return penalty


def basis_of(x: np.ndarray, variable: str, period: float = 0.0) -> Basis | None:
    """Splines over the range of x (sample,) or over its period; None for a constant x."""
    if variable == "turn" or period:
        pieces = TURN_PIECES if variable == "turn" else PIECES
        period = period or 2.0 * math.pi
        return Basis(np.arange(-3, pieces + 4) * period / pieces, False, period)
    if variable == "following_error" and np.ptp(x) > 0.0:
        values = np.quantile(x, np.linspace(RANGE, 1.0 - RANGE, QUANTILES))
        values += 1e-9 * np.ptp(values) * np.arange(QUANTILES)  # distinct values if the axis mostly rests
        return Basis(np.arange(-3, PIECES + 4) / PIECES, False, quantiles=values)
    root = variable in ("speed", "velocity", "current")
    u = np.sign(x) * np.sqrt(np.abs(x)) if root else x
    low, high = np.quantile(u, [RANGE, 1.0 - RANGE])
    if not high - low > 1e-9 * max(abs(high), abs(low), 1e-12):
        return None
    step = (high - low) / PIECES
    return Basis(low + step * np.arange(-3, PIECES + 4), root)


@dataclass(frozen=True)
class MeasuredCurve:
    """A measured law: relation, points with band (standard deviation), and prediction of runs left out.

    `predicts` is the share of the cross-validated loss that the curve removes; `runs_better` is the share of the runs, weighted by their loss,
    that it improves.
    """

    relation: Relation
    predicts: float
    runs_better: float
    x: np.ndarray
    y: np.ndarray
    band: np.ndarray

    @property
    def free(self) -> np.ndarray:
        """Part of the curve that belongs to the nominal machine (point, n): a level, and over a speed a slope, its viscous friction."""
        return nominal_shapes(self.x, self.relation.variable)


def nominal_shapes(x: np.ndarray, variable: str) -> np.ndarray:
    """Curves over a variable (point, n) due to toleranced parameters."""
    level = np.ones((len(x), 1))
    return np.column_stack([level, x / max(float(np.abs(x).max()), 1e-300)]) if variable in ("speed", "velocity", "windup") else level


@dataclass(frozen=True)
class Loss:
    """Cross-validated loss of a linear fit, with the outlier weights of the fit to all parts."""

    total: float
    of_part: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    weights: np.ndarray


def scale_of(values: np.ndarray, least: float) -> float:
    """Robust standard deviation, at least `least`."""
    return max(robust_deviation(values - np.median(values)), least)


def cross_validated_loss(
    samples: Samples, columns: np.ndarray, scale: float, penalty: np.ndarray | None = None, weights: np.ndarray | None = None
) -> Loss:
    """Cross-validated loss of a fit of these columns (sample, n) with a penalty (n, n) on their coefficients.

    `weights` (sample,) are the initial outlier weights, refined by one iteration; without them they are found from scratch.
    """
    parts = np.unique(samples.part)
    norm = np.sqrt(np.mean(columns**2, axis=0)) + 1e-300
    x = columns / norm
    ridge = SMALL * len(x) * np.eye(x.shape[1]) + (0.0 if penalty is None else penalty)
    sweeps = SWEEPS if weights is None else 1
    weights = np.ones(len(x)) if weights is None else weights
    solution = np.zeros(x.shape[1])
    for _ in range(sweeps):
        normal = x.T @ (weights[:, None] * x) + ridge
        solution = np.linalg.solve(normal, x.T @ (weights * samples.y))
        left = np.abs(samples.y - x @ solution) / scale
        weights = np.where(left <= HUBER, 1.0, HUBER / np.maximum(left, 1e-12))
    of_part = np.zeros(len(parts))
    whole, target = x.T @ (weights[:, None] * x) + ridge, x.T @ (weights * samples.y)
    for i, part in enumerate(parts):
        rows = samples.part == part
        own = x[rows]
        without = np.linalg.solve(
            whole - own.T @ (weights[rows, None] * own) + 1e-12 * np.eye(len(ridge)), target - own.T @ (weights[rows] * samples.y[rows])
        )
        of_part[i] = float(huber(HUBER, (samples.y[rows] - own @ without) / scale).sum())
    left_all = samples.y - x @ solution
    variance = float(np.sum(weights * left_all**2)) / max(len(x) - x.shape[1], 1) * CORRELATED
    covariance = np.linalg.inv(whole) * variance
    return Loss(float(of_part.sum()), of_part, solution / norm, covariance / np.outer(norm, norm), weights)


def measure(samples: Samples, relation: Relation, axis: Axis, base: Loss, fixed: np.ndarray, scale: float) -> MeasuredCurve | None:
    """The curve of a relation in addition to `fixed` columns (sample, n), with its prediction beyond them; None for a constant variable."""
    x = variable_of(samples, relation)
    basis = basis_of(x, relation.variable, relation.period)
    if basis is None:
        return None
    columns = contribution_to_residual(samples, relation, axis, basis.columns(x))
    used = np.any(np.abs(columns) > 1e-12, axis=0)
    if not used.any():
        return None
    all_columns = np.column_stack([fixed, columns[:, used]])
    count, own = all_columns.shape[1], int(used.sum())
    roughness = np.zeros((count, count))
    roughness[count - own :, count - own :] = basis.penalty(columns.shape[1])[np.ix_(used, used)]
    stiff = len(samples) / own * roughness
    best = cross_validated_loss(samples, all_columns, scale, PENALTIES[0] * stiff)
    for weight in PENALTIES[1:]:
        best = min(best, cross_validated_loss(samples, all_columns, scale, weight * stiff, best.weights), key=lambda loss: loss.total)
    low, high = np.quantile(x, [RANGE, 1.0 - RANGE])
    at = np.linspace(0.0, basis.period, 49) if basis.period else _curve_points(low, high, basis)
    shown = basis.columns(at)[:, used]
    coefficients, covariance = best.coefficients[count - own :], best.covariance[count - own :, count - own :]
    y = shown @ coefficients
    # the band covers the shape only, without the part that belongs to the nominal machine
    own_curves = nominal_shapes(at, relation.variable)
    centred = shown - own_curves @ np.linalg.lstsq(own_curves, shown, rcond=None)[0]
    band = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", centred, covariance, centred), 0.0))
    better = base.of_part - best.of_part
    return MeasuredCurve(
        relation,
        1.0 - best.total / max(base.total, 1e-300),
        float(np.sum(base.of_part * (better > 0.0)) / max(base.of_part.sum(), 1e-300)),
        at,
        y,
        band,
    )


def _curve_points(low: float, high: float, basis: Basis) -> np.ndarray:
    """Points of a curve, spaced like its splines."""
    if basis.quantiles is not None:
        return np.interp(np.linspace(0.0, 1.0, 41), np.linspace(0.0, 1.0, len(basis.quantiles)), basis.quantiles)
    if not basis.root:
        return np.linspace(low, high, 41)
    first, last = (math.copysign(math.sqrt(abs(v)), v) for v in (low, high))
    u = np.linspace(first, last, 41)
    return np.sign(u) * u**2


def loss_without_law(samples: Samples) -> tuple[np.ndarray, float, Loss]:
    """Nuisance columns (sample, n), scale of their residual, and the cross-validated loss of a fit of them alone."""
    columns = nuisances_in(samples)
    first = cross_validated_loss(samples, columns, scale_of(samples.y, samples.sigma))
    scale = scale_of(samples.y - columns @ first.coefficients, samples.sigma)
    return columns, scale, cross_validated_loss(samples, columns, scale)


def measured_laws(samples: Samples, axis: Axis) -> list[MeasuredCurve]:
    """Curves of all relations of a block that improve the prediction, best first."""
    columns, scale, base = loss_without_law(samples)
    left = samples.y - columns @ base.coefficients
    relations = [*relations_of(samples, axis), *sines_of(samples, left, axis)]
    curves = [measure(samples, relation, axis, base, columns, scale) for relation in relations]
    return sorted((c for c in curves if c is not None and c.predicts > 0.0), key=lambda c: -c.predicts)


def sines_of(samples: Samples, left: np.ndarray, axis: Axis) -> Iterator[Relation]:
    """Sines over the position: for each output the period of the largest line in the spectrum of the residual `left` (sample,).

    The residual is summed in narrow bins of the position, so that one Fourier transform covers all periods.
    """
    position = load_position(samples)
    span = float(np.ptp(position))
    if not span > 0.0:
        return
    finest = FINEST_WAVE_M * metre_of(axis)
    bins = int(min(max(2.0 * span / finest, 64), MOST_BINS))
    at = np.minimum(((position - position.min()) / span * bins).astype(int), bins - 1)
    outputs = ("force", "friction") if samples.block == MECHANICS else ("displacement",) if samples.block == "transmission" else ()
    limit = 4.0 * scale_of(left, samples.sigma)
    for output in outputs:
        block = MECHANICS if samples.block == MECHANICS else "measurement"
        y = np.clip(left, -limit, limit) * (-np.sign(samples.motion["velocity"]) if output == "friction" else 1.0)
        spectrum = np.abs(np.fft.rfft(np.bincount(at, y, bins), OVERSAMPLED * bins))
        first = OVERSAMPLED * LEAST_WAVES
        if len(spectrum) > first:
            period = OVERSAMPLED * span / (first + int(np.argmax(spectrum[first:])))
            if not _is_harmonic_of_turn(period, span, axis):
                yield Relation(block, output, "position", period=period)


def _is_harmonic_of_turn(period: float, span: float, axis: Axis) -> bool:
    """Whether a period over the position is a harmonic of the motor turn, within the resolution of the measured range."""
    each_turn = 2.0 * math.pi * axis.ratio / period
    turns = span / (2.0 * math.pi * axis.ratio)
    return axis.drive != "direct" and 1 <= round(each_turn) <= TURN_PIECES // 2 and abs(each_turn - round(each_turn)) * turns < 1.0


def excess(samples: Samples, columns: np.ndarray | None = None) -> float:
    """Power of the residual after a fit of the columns over that of noise; 1 for noise only."""
    columns = nuisances_in(samples) if columns is None else columns
    loss = cross_validated_loss(samples, columns, scale_of(samples.y, samples.sigma))
    left = samples.y - columns @ loss.coefficients
    return float(np.mean(left**2)) / samples.sigma**2
