"""Shapes of a law: curves y(x) of one variable with few parameters, and curves through points.

`x` in the equation of a shape is the variable. The loop, the fits and the pictures evaluate all shapes by the compiled `value_of`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
import re

import numpy as np
from scipy.interpolate import CubicSpline

from twin.compiled_functions import compiled
from twin.effects.effect import Parameter
from twin.errors import InputError
from twin.simulation.waves import sine

(
    STEP,
    LINE,
    POWER,
    EXPONENTIAL,
    APPROACH,
    GAUSSIAN,
    SINE,
    GAS_SPRING,
    SATURATION,
    BENDING,
    CLIP,
    CLIP_ABOVE,
    CLIP_BELOW,
    DEAD_BAND,
    TABLE,
    STAGE,
    JITTER,
) = range(17)
LAG, NOTCH, DEAD_TIME = 100, 101, 102
"""Filters: shapes with memory."""

NUMBERS = 8
"""Largest number of parameters of a shape in the compiled row; a table stores its points there."""

MOST_POINTS = 24


@dataclass(frozen=True)
class Shape:
    """One shape: name, equation, parameters in the order of the compiled row, and description.

    The quantity of a parameter is its own, or "output" or "variable": that of the output or the variable of the law.
    """

    name: str
    code: int
    equation: str
    numbers: tuple[Parameter, ...]
    words: str

    @property
    def is_filter(self) -> bool:
        """Whether the shape has memory."""
        return self.code >= LAG

    def text(self, variable: str) -> str:
        """The equation with the name of the variable."""
        return re.sub(r"\bx\b", variable, self.equation)


def _height(name: str = "height") -> Parameter:
    return Parameter(name, "output", neutral=0.0)


def _width(name: str, *, fixed: bool = False, default: float | None = None) -> Parameter:
    return Parameter(name, "variable", 1e-12, shape=fixed, default=default, logarithmic=True)


def _place(name: str = "at", *, default: float | None = None) -> Parameter:
    return Parameter(name, "variable", default=default)


SHAPES = {
    s.name: s
    for s in (
        Shape("step", STEP, "height * (x > at)", (_height(), _place()), "a step"),
        Shape("line", LINE, "height * x / reach", (_height(), _width("reach", fixed=True, default=1.0)), "a straight line"),
        Shape(
            "power",
            POWER,
            "height * sign(x) * |x / reach|^n",
            (_height(), _width("reach", fixed=True, default=1.0), Parameter("n", "number", 0.1, 6.0)),
            "a power",
        ),
        Shape("exponential", EXPONENTIAL, "height * e^(-x / scale)", (_height(), _width("scale")), "a decaying exponential"),
        Shape(
            "approach", APPROACH, "height * (1 - e^(-x / scale))", (_height(), _width("scale")), "an exponential that approaches a level"
        ),
        Shape("gaussian", GAUSSIAN, "height * e^(-((x - at) / width)^2)", (_height(), _width("width"), _place(default=0.0)), "a Gaussian"),
        Shape(
            "sine",
            SINE,
            "amplitude * sin(2 pi x / period + phase_rad)",
            (
                _height("amplitude"),
                Parameter("period", "variable", 1e-12, logarithmic=True, scan="travel"),
                Parameter("phase_rad", "angle", -2 * math.pi, 2 * math.pi, default=0.0, periodic=True),
            ),
            "a sine",
        ),
        Shape(
            "gas spring",
            GAS_SPRING,
            "height * |1 + (x - at) / length|^-n",
            (_height(), _width("length"), _place(default=0.0), Parameter("n", "number", 0.5, 3.0, default=1.3, shape=True)),
            "the pressure of a gas spring",
        ),
        Shape("saturation", SATURATION, "height * tanh(x / scale)", (_height(), _width("scale")), "a saturation"),
        Shape("stage", STAGE, "height * clip(x / width, -1, 1)", (_height(), _width("width")), "a line with limits"),
        Shape(
            "bending",
            BENDING,
            "gain * (x / sqrt(1 + (x / knee)^2) - x)",
            (Parameter("knee", "variable", 1e-12, neutral=math.inf, logarithmic=True),),
            "a saturating characteristic",
        ),
        Shape("clip", CLIP, "gain * (clip(x, -limit, limit) - x)", (Parameter("limit", "variable", 1e-12, neutral=math.inf),), "a limit"),
        Shape(
            "clip above",
            CLIP_ABOVE,
            "gain * (min(x, limit) - x)",
            (Parameter("limit", "variable", neutral=math.inf),),
            "a limit on one side",
        ),
        Shape(
            "clip below",
            CLIP_BELOW,
            "gain * (max(x, limit) - x)",
            (Parameter("limit", "variable", neutral=-math.inf),),
            "a limit on one side",
        ),
        Shape("dead band", DEAD_BAND, "-gain * clip(x, -band, band)", (Parameter("band", "variable", 0.0, neutral=0.0),), "a dead band"),
        Shape(
            "jitter",
            JITTER,
            "deviation_s * x * white noise",
            (Parameter("deviation_s", "time", 0.0, 1.0, neutral=0.0, shape=True),),
            "random errors in proportion",
        ),
        Shape(
            "lag",
            LAG,
            "first-order lag",
            (Parameter("time_constant_s", "time", 0.0, 1.0, neutral=0.0, logarithmic=True),),
            "a first-order lag",
        ),
        Shape(
            "notch",
            NOTCH,
            "(s^2 + w^2) / (s^2 + width w s + w^2), w = 2 pi frequency_hz",
            (
                Parameter("width", "number", 0.0, 10.0, neutral=0.0, logarithmic=True),
                Parameter("frequency_hz", "frequency", 0.1, 2000.0, logarithmic=True),
            ),
            "a notch",
        ),
        Shape(
            "dead time",
            DEAD_TIME,
            "y(t) = x(t - time_s)",
            (Parameter("time_s", "time", 0.0, 1.0, neutral=0.0, logarithmic=True),),
            "a dead time",
        ),
    )
}
"""All shapes by name. `gain` is the nominal gain from the variable to the output: torque constant of the motor, position gain, or 1."""

CURVE = Shape("table", TABLE, "points", (Parameter("scale", "number", neutral=0.0, default=1.0),), "a table")
"""A curve through points, times `scale`; constant beyond the points."""


def find_shape(formula: object, variable: str, where: str) -> Shape:
    """The shape with that name or equation. Raises InputError for an unknown one."""
    wanted = "".join(str(formula).split())
    for shape in SHAPES.values():
        if wanted in (shape.name.replace(" ", ""), "".join(shape.text(variable).split()), "".join(shape.equation.split())):
            return shape
    raise InputError(
        f"{where}: formula = {str(formula)!r} is not one of the shapes {', '.join(SHAPES)}; `twin effects law` lists their equations"
    )


def row_of(
    shape: Shape, numbers: Mapping[str, float], gain: float = 1.0, points: Sequence[Sequence[float]] = (), between: str = ""
) -> list[float]:
    """Compiled row of a shape: its parameters and the gain; of a table its scale, and count, x, y and second derivatives of its points (0 if linear)."""
    own = [numbers.get(n.name, n.default if n.default is not None else 0.0) for n in shape.numbers]
    if shape.code != TABLE:
        return [*own, *[0.0] * (NUMBERS - 1 - len(own)), gain]
    x, y = np.array(points, float).T
    bend = CubicSpline(x, y, bc_type="natural")(x, 2) if between == "cubic" and len(x) > 2 else np.zeros(len(x))
    return [*own, float(len(x)), *x, *y, *bend]


@compiled
def value_of(code, x, p):  # type: ignore[no-untyped-def]
    """y(x) of the shape with this code and compiled row; of a jitter, its standard deviation."""
    if code == TABLE:
        return p[0] * curve_value(x, p)
    if code == STEP:
        return p[0] if x > p[1] else 0.0
    if code == LINE:
        return p[0] * x / p[1]
    if code == POWER:
        return math.copysign(p[0] * abs(x / p[1]) ** p[2], p[0] * x)
    if code == EXPONENTIAL:
        return p[0] * math.exp(min(-x / p[1], 50.0))
    if code == APPROACH:
        return p[0] * (1.0 - math.exp(min(-x / p[1], 50.0)))
    if code == GAUSSIAN:
        return p[0] * math.exp(-(((x - p[2]) / p[1]) ** 2))
    if code == SINE:
        return p[0] * sine(2.0 * math.pi * x / p[1] + p[2])
    if code == GAS_SPRING:
        return p[0] * max(abs(1.0 + (x - p[2]) / p[1]), 1e-3) ** -p[3]
    if code == SATURATION:
        return p[0] * math.tanh(x / p[1])
    if code == STAGE:
        return p[0] * min(max(x / p[1], -1.0), 1.0)
    if code == JITTER:
        return p[0] * x
    gain = p[NUMBERS - 1]
    if code == BENDING:
        return gain * (x / math.sqrt(1.0 + (x / p[0]) ** 2) - x)
    if code == CLIP:
        return gain * (min(max(x, -p[0]), p[0]) - x)
    if code == CLIP_ABOVE:
        return gain * (min(x, p[0]) - x)
    if code == CLIP_BELOW:
        return gain * (max(x, p[0]) - x)
    if code == DEAD_BAND:
        return -gain * min(max(x, -p[0]), p[0])
    return 0.0


@compiled
def gaussian_of(x):  # type: ignore[no-untyped-def]
    """A standard normal number from the last digits of x, by the Box-Muller transform."""
    digits = math.frexp(abs(x))[0]
    first = digits * 67108864.0  # 2^26
    second = digits * 8191.0
    first -= math.floor(first)
    second -= math.floor(second)
    return math.sqrt(-2.0 * math.log(max(first, 1e-12))) * math.cos(2.0 * math.pi * second)


@compiled
def curve_value(x, p):  # type: ignore[no-untyped-def]
    """The curve through the points of `row_of`, stored in p[1:]."""
    n = int(p[1])
    first = 2
    if x <= p[first]:
        return p[first + n]
    if x >= p[first + n - 1]:
        return p[first + 2 * n - 1]
    low, high = 0, n - 1
    while high - low > 1:
        middle = (low + high) // 2
        if p[first + middle] <= x:
            low = middle
        else:
            high = middle
    width = p[first + high] - p[first + low]
    b = (x - p[first + low]) / width
    a = 1.0 - b
    bend = (a**3 - a) * p[first + 2 * n + low] + (b**3 - b) * p[first + 2 * n + high]
    return a * p[first + n + low] + b * p[first + n + high] + bend * width**2 / 6.0


@compiled
def _values(code, x, p, out):  # type: ignore[no-untyped-def]
    for i in range(len(x)):
        out[i] = value_of(code, x[i], p)


def values_of(shape: Shape, x: np.ndarray, row: Sequence[float]) -> np.ndarray:
    """y (sample,) of a shape with this compiled row, as in the loop."""
    out = np.zeros(len(x))
    _values(shape.code, np.ascontiguousarray(x, float), np.array(row, float), out)
    return out
