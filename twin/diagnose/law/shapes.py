"""A measured curve as a formula: each shape for the variable is fitted to the residual and cross-validated on runs left out.

A shape is y = height f(x; c). The height is linear; the parameters c are searched (variable projection: grid, then simplex). A sine has a
sine and a cosine column. The shape with the best prediction wins; if the measured curve predicts clearly better, the law stays a table.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import itertools
import math
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import huber

from twin.diagnose.law.measure import HUBER, Loss, MeasuredCurve, cross_validated_loss, loss_without_law
from twin.diagnose.law.relations import Relation, contribution_to_residual, variable_of
from twin.diagnose.law.residual import Samples
from twin.effects.law import NAME
from twin.effects.law_shapes import SHAPES, Shape, row_of, values_of
from twin.machine.axis import Axis

TABLE_BETTER = 0.04
"""Fraction of the loss that a curve must predict beyond the best formula to stay a table."""

PER_NUMBER = 0.004
"""Fraction of the loss that each further parameter of a formula must explain."""

TABLE_POINTS = 15
"""Number of points of a table."""

SUITS: dict[str, tuple[str, ...]] = {
    "speed": ("line", "power", "exponential", "gaussian", "step"),
    "velocity": ("power", "saturation"),
    "position": ("line", "gaussian", "step", "gas spring", "sine"),
    "turn": ("sine",),
    "time": ("line", "approach"),
    "direction": ("line",),
    "slack": ("line",),
    "windup": ("power", "stage", "saturation"),
    "acceleration": ("line", "power"),
    "acceleration_size": ("line", "power"),
    "current": ("bending", "saturation", "power"),
    "following_error": ("dead band", "saturation", "line"),
    "speed_setpoint": ("clip above", "clip below", "clip", "line"),
}
"""Shapes that are tried for each variable."""

LONGEST_WAVE = 3.0
"""Longest period of a sine, as a multiple of the measured range."""

FIRST_STEP = 0.15
"""Relative first step of the refinement of a parameter."""

FINEST_STEP = 0.007
"""The refinement ends at this fraction of its first step."""

SIGNED = ("at", "limit")
"""Parameters that are not searched on a logarithmic scale."""

HARMONICS = (1, 2, 3, 4, 5, 6, 8, 10, 12)
"""Harmonics of the motor turn that are tried."""


@dataclass(frozen=True)
class Described:
    """A law as a formula, or as a table if `shape` is None, with its parameters in SI and its prediction."""

    relation: Relation
    shape: str | None
    numbers: Mapping[str, float]
    predicts: float
    curve: MeasuredCurve
    column: np.ndarray = field(repr=False)  # (sample,) contribution to the residual
    points: tuple[tuple[float, float], ...] = ()
    spring: float | None = None  # stiffness of the spring that a law over the windup complements [N/m, Nm/rad], if measured with it

    def table(self, axis: str) -> dict[str, Any]:
        """The law as an `[[effect]]` table of a machine file."""
        c = self.relation
        head: dict[str, Any] = {"name": NAME, "axis": axis, "block": c.block, "output": c.output, "variables": [c.variable]}
        if c.source:
            head["from_axis"] = c.source
        if self.shape is None:
            head |= {"points": [list(p) for p in self.points], "between": "cubic"}
            if c.wraps:
                head["period"] = c.wraps
        else:
            head["formula"] = SHAPES[self.shape].text(c.variable)
        length = {"length": c.length} if c.length and "length" not in self.numbers else {}
        return {**head, **self.numbers, **length}


def described(samples: Samples, curve: MeasuredCurve, axis: Axis) -> Described:
    """The curve as the formula with the best prediction, or as a table."""
    columns, scale, base = loss_without_law(samples)
    names = ("sine",) if curve.relation.period else SUITS.get(curve.relation.variable, ())
    found = [f for name in names if (f := _fit_shape(samples, curve, axis, SHAPES[name], columns, base, scale))]
    best = max(found, key=lambda d: d.predicts - PER_NUMBER * len(d.numbers), default=None)
    if best is None or best.predicts < curve.predicts - TABLE_BETTER:
        return _as_table(samples, curve, axis)
    return best


def _as_table(samples: Samples, curve: MeasuredCurve, axis: Axis) -> Described:
    """The curve as a table of a few points; its level belongs to the nominal machine and is removed."""
    places = np.unique(np.linspace(0, len(curve.x) - 1, TABLE_POINTS).round().astype(int))
    x = variable_of(samples, curve.relation)
    period = curve.relation.wraps
    y = np.interp(np.mod(x, period) if period else x, curve.x, curve.y)
    level = curve.y[-1] if curve.relation.variable == "speed" else float(np.mean(y))
    column = contribution_to_residual(samples, curve.relation, axis, (y - level)[:, None])[:, 0]
    points = tuple((float(curve.x[i]), float(curve.y[i] - level)) for i in places)
    return Described(curve.relation, None, {"scale": 1.0}, curve.predicts, curve, column, points)


class _ShapeFit:
    """One shape of one relation on the samples: its linear columns as a function of its nonlinear parameters."""

    def __init__(self, samples: Samples, curve: MeasuredCurve, axis: Axis, shape: Shape) -> None:
        self.samples, self.relation, self.axis, self.shape = samples, curve.relation, axis, shape
        self.x = variable_of(samples, curve.relation)
        self.starts, self.given = _search_space(shape, self.x, curve.relation)
        self.free = tuple(self.starts)

    @property
    def is_characteristic(self) -> bool:
        """Whether the shape has no height."""
        return not any(n.quantity == "output" for n in self.shape.numbers)

    def columns(self, values: Sequence[float]) -> np.ndarray:
        """Columns (sample, n) of unit height; sine and cosine for a sine."""
        numbers = {**self.given, **dict(zip(self.free, values))}
        x = self.x
        if self.relation.length:
            x = variable_of(self.samples, replace(self.relation, length=numbers["length"]))
        if self.shape.name == "sine":
            angle = 2.0 * math.pi * x / numbers["period"]
            own = np.column_stack([np.sin(angle), np.cos(angle)])
        else:
            own = values_of(self.shape, x, row_of(self.shape, {**numbers, self.height: 1.0}, self.gain))[:, None]
        return contribution_to_residual(self.samples, self.relation, self.axis, own)

    def steps(self, values: Sequence[float]) -> list[float]:
        """Relative first steps of the refinement; for the period of a sine, a quarter of a period at the end of the measured range."""
        span = max(float(np.ptp(self.x)), 1e-300)
        return [min(FIRST_STEP, 0.25 * v / span) if name == "period" else FIRST_STEP for name, v in zip(self.free, values)]

    @property
    def height(self) -> str:
        return next((n.name for n in self.shape.numbers if n.quantity == "output"), "")

    @property
    def gain(self) -> float:
        """Nominal gain of a characteristic."""
        if self.relation.output == "torque":
            return self.axis.motor.torque_constant_nm_per_a
        return self.axis.loops.position_gain_per_s if self.relation.variable == "following_error" else 1.0


def _search_space(shape: Shape, x: np.ndarray, relation: Relation) -> tuple[dict[str, Iterable[float]], dict[str, float]]:
    """Start values of the searched parameters, and fixed parameters."""
    low, high = (float(v) for v in np.quantile(x, [0.002, 0.998]))
    span = max(high - low, 1e-12)
    reach = max(abs(low), abs(high), 1e-12)
    widths = span * np.geomspace(0.004, 1.0, 10)
    inside = np.linspace(low + 0.05 * span, high - 0.05 * span, 12)
    if relation.length:
        return {"length": (relation.length,)}, {"reach": 1.0}
    if shape.name == "line":
        return {}, {"reach": reach}
    if shape.name == "power":
        return {"n": (0.5, 2.0, 3.0)}, {"reach": reach}
    if shape.name in ("exponential", "approach", "saturation"):
        return {"scale": widths}, {}
    if shape.name == "gaussian":
        return ({"width": widths}, {"at": 0.0}) if relation.variable == "speed" else ({"width": widths[3:], "at": inside}, {})
    if shape.name == "stage":
        return {"width": reach * np.geomspace(0.05, 0.95, 16)}, {}
    if shape.name == "step":
        return {"at": inside}, {}
    if shape.name == "sine":
        if relation.variable == "turn":
            return {"period": [2.0 * math.pi / k for k in HARMONICS]}, {}
        return {"period": (relation.period,) if relation.period else span / np.linspace(0.6, 4.0, 12)}, {}
    if shape.name == "gas spring":
        return {"length": span * np.array([0.3, 1.0, 3.0]), "at": (low,)}, {"n": 1.3}
    if shape.name == "bending":
        return {"knee": reach * np.geomspace(0.6, 6.0, 8)}, {}
    if shape.name == "dead band":
        # quantiles: without feedforward, a following error is a thousand times the band
        return {"band": np.quantile(np.abs(x), np.linspace(0.05, 0.95, 16))}, {}
    return {"limit": (low if shape.name == "clip below" else high) * np.array([0.8, 0.9, 0.95, 0.98])}, {}


def _fit_shape(
    samples: Samples, curve: MeasuredCurve, axis: Axis, shape: Shape, fixed: np.ndarray, base: Loss, scale: float
) -> Described | None:
    problem = _ShapeFit(samples, curve, axis, shape)
    weights = base.weights
    orthogonal, _ = np.linalg.qr(fixed * np.sqrt(weights)[:, None])

    def without(columns: np.ndarray) -> np.ndarray:
        scaled = columns * np.sqrt(weights)[:, None]
        return scaled - orthogonal @ (orthogonal.T @ scaled)

    target = without(samples.y[:, None])[:, 0]

    def loss(values: Sequence[float]) -> float:
        columns = without(problem.columns(values))
        if not np.all(np.isfinite(columns)):
            return math.inf
        if problem.is_characteristic:
            left = target - columns[:, 0]
        else:
            norm = np.sqrt(np.sum(columns**2, axis=0))
            if np.any(norm < 1e-12):
                return math.inf
            left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
        return float(huber(HUBER, left / scale).sum())

    values = min(itertools.product(*problem.starts.values()), key=loss)
    if problem.free and problem.relation.variable != "turn":  # a sine over the turn is a harmonic of it
        values = _refine(loss, values, [name not in SIGNED for name in problem.free], problem.steps(values))
    numbers = dict(zip(problem.free, values))
    driven = float(np.ptp(problem.x))
    if not math.isfinite(loss(values)) or max(numbers.get("width", 0.0), numbers.get("scale", 0.0)) > driven:
        return None  # a Gaussian wider than the measured range is a parabola
    if numbers.get("period", 0.0) > LONGEST_WAVE * driven:
        return None  # a sine much longer than the measured range is a line
    columns = problem.columns(values)
    if problem.is_characteristic:
        moved = replace(samples, y=samples.y - columns[:, 0])
        judged = cross_validated_loss(moved, fixed, scale)
        heights, column = np.ones(1), columns[:, 0]
    else:
        judged = cross_validated_loss(samples, np.column_stack([fixed, columns]), scale)
        heights = judged.coefficients[fixed.shape[1] :]
        column = columns @ heights
    numbers = {**problem.given, **{n: float(v) for n, v in zip(problem.free, values)}}
    if shape.name == "sine":
        numbers["amplitude"] = float(np.hypot(*heights))
        numbers["phase_rad"] = float(np.arctan2(heights[1], heights[0]))
    elif problem.height:
        numbers[problem.height] = float(heights[0])
    order = [n.name for n in shape.numbers]
    numbers = {n: numbers[n] for n in sorted(numbers, key=lambda n: order.index(n) if n in order else len(order))}
    return Described(curve.relation, shape.name, numbers, 1.0 - judged.total / max(base.total, 1e-300), curve, column)


def _refine(
    loss: Callable[[Sequence[float]], float], values: Sequence[float], logarithmic: Sequence[bool], steps: Sequence[float]
) -> tuple[float, ...]:
    """Parameters near `values` with minimum loss, by a simplex with relative first `steps`."""
    scale = [abs(v) if log else max(abs(v), 1e-9) for v, log in zip(values, logarithmic)]

    def numbers(u: np.ndarray) -> tuple[float, ...]:
        return tuple(
            s * math.exp(min(max(a * step, -3.0), 3.0)) if log else v + 0.3 * s * a * step
            for v, s, log, a, step in zip(values, scale, logarithmic, u, steps)
        )

    n = len(values)
    found = minimize(
        lambda u: loss(numbers(u)),
        np.zeros(n),
        method="Nelder-Mead",
        options={"initial_simplex": np.vstack([np.zeros(n), np.eye(n)]), "maxfev": 70 * n, "xatol": FINEST_STEP},
    )
    return numbers(found.x)
