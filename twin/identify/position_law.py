"""The law of a position controller on recorded runs: see `position_control`."""

from collections.abc import Callable, Sequence
import functools
import math

import numpy as np

from twin.control.position_controller import PARAMETERS, feedforward_at, position_law
from twin.control.speed_set_point_filters import lagged
from twin.identify.axis_run import AxisRun
from twin.machine.axis import Axis
from twin.recordings.roughness import step_of

NAMES = tuple(p.name for p in PARAMETERS)
"""Gain, weight of the speed feedforward, delays of set point and feedforward."""

MOST_DELAY_CYCLES = 12
"""Largest delay in position cycles."""

ROUNDING = 1e-9
"""A column that varies by less than this share of its size is constant: the free constant of its run takes it."""

SLOPE, SHARP = "slope", 1e-2
"""A control may feed forward the speed that its interpolator has, not the last step of its set points; such a step lasts this share of a cycle."""

LEAST_LAG_CYCLES = 0.05
"""A shorter lag is none."""

ALL_ROWS = slice(None)


def loop_position(run: AxisRun, axis: Axis) -> np.ndarray | None:
    """Position feedback (cycle,) in axis units: the scale, or the motor encoder if the machine file uses it."""
    if axis.encoder == "motor" and run.motor_at_axis is not None:
        return run.motor_at_axis
    return run.position


def numbers_of_file(axis: Axis) -> np.ndarray:
    """(4,) The values of NAMES in the machine file; a weight of 0 becomes 1."""
    gain, weight, *delays = (axis.number(name) for name in NAMES)
    return np.array([gain, weight or 1.0, *delays])


class PositionLaw:
    """The law on all runs for one interpolation (`way`; SLOPE is cubic), with a free constant in each run.

    `lag` [s]: the output is recorded behind one, block `speed_record_lag` or `speed_set_point_lag`.
    """

    def __init__(self, axis: Axis, runs: Sequence[AxisRun], way: str, lag: float | None = None) -> None:
        self.axis, self.runs, self.way, self.lag = axis, runs, way, lag
        self.on = [0.0 if r.feedforward == "off" else 1.0 for r in runs]
        self.recorded = all(r.velocity_feedforward is not None for r in runs if r.feedforward != "off") and any(
            r.velocity_feedforward is not None and np.ptp(r.velocity_feedforward) > 0.0 for r in runs
        )

    @functools.cached_property
    def asked(self) -> list[np.ndarray]:
        """(cycle,) The recorded speed set point of each run [axis units a second]."""
        return [r.speed_setpoint * self.axis.ratio for r in self.runs if r.speed_setpoint is not None]

    @property
    def given(self) -> np.ndarray:
        """(row,) Those of all runs."""
        return np.concatenate(self.asked)

    def of_rounding(self, x: np.ndarray) -> float:
        """RMS of the speed set point [axis units a second] that the law makes of rounded set points. The position is rounded for the control, too."""
        made = []
        for run in self.runs:
            differences = 0.0 if run.feedforward == "off" or run.velocity_feedforward is not None else math.sqrt(2.0) / run.position_cycle
            made.append((x[0] + differences * x[1]) * step_of(run.setpoint_at(run.start)) / math.sqrt(12.0))
        return float(max(made))

    @functools.cached_property
    def step(self) -> float:
        """Step [axis units a second] to which the speed set points are rounded; of unrounded ones their last digits."""
        return max(*map(step_of, self.asked), 2.0 * ROUNDING * float(np.std(self.given)))

    def read(self, run: AxisRun, times: np.ndarray) -> np.ndarray:
        """Interpolated set point of a run at any times."""
        return run.setpoint_at(times) if self.way != "linear" else np.interp(times, run.start, run.setpoint_at(run.start))

    def rate(self, run: AxisRun, times: np.ndarray) -> np.ndarray:
        """Slope of the interpolated set point [axis units a second]; none before the run and after it."""
        if self.way == "linear":
            h = 1e-3 * run.cycle
            return (self.read(run, times + h) - self.read(run, times - h)) / (2.0 * h)
        return np.asarray(run.setpoint(np.clip(times, 0.0, run.end), 1) * ((times > 0.0) & (times < run.end)))

    def error(self, run: AxisRun, delay: float, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """Control error (row,) of one run for a delay of the set point."""
        position = loop_position(run, self.axis)
        assert position is not None
        then = run.start[rows] - delay
        return self.read(run, then) + np.interp(then, run.start, run.added) - position[rows]

    def fed(
        self, run: AxisRun, delay: float, rows: np.ndarray | slice = ALL_ROWS, of: Callable[[AxisRun, np.ndarray], np.ndarray] | None = None
    ) -> np.ndarray:
        """Feedforward (row,) at weight 1: recorded, or the slope of the set points (of another course with `of`) over a cycle, or at a moment."""
        if self.recorded:
            return (run.velocity_feedforward if run.velocity_feedforward is not None else np.zeros(len(run.start)))[rows]
        cycle = run.position_cycle
        step = SHARP * cycle if self.way == SLOPE else cycle  # about the same moment
        read = of or self.read
        return feedforward_at(lambda late: read(run, run.start[rows] - late), delay + 0.5 * (cycle - step), step)

    def output(self, k: int, x: np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """The law (row,) of run `k` [axis units a second]."""
        run = self.runs[k]
        return position_law(x[0], x[1] * self.on[k], self.error(run, x[2], rows), self.fed(run, x[3], rows))

    def wanted(self, k: int, x: np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """The output (row,) of run `k` as it is recorded [axis units a second]."""
        law = self.at(x)
        return law.as_recorded(k, functools.partial(law.output, k, x), rows)

    def as_recorded(self, k: int, terms: Callable[[np.ndarray | slice], np.ndarray], rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """Terms of the output (row, ...) of run `k` as they appear in the record; a lag holds those of earlier cycles."""
        if self.lag is None:
            return terms(rows)
        run = self.runs[k]
        return lagged(terms(ALL_ROWS), run.cycle, max(self.lag, LEAST_LAG_CYCLES * run.cycle), run.speed_cycle)[rows]

    def at(self, _x: np.ndarray) -> "PositionLaw":
        """The law of NAMES with what `x` has beyond them."""
        return self

    def usable(self, run: AxisRun) -> np.ndarray:
        """(cycle,) True without a limit and late enough in the run that the delayed set point is recorded."""
        early = np.arange(len(run.start)) < min(MOST_DELAY_CYCLES, len(run.start) // 4)
        return ~run.limited & ~early

    def usable_rows(self) -> list[np.ndarray]:
        """(row,) Usable cycles of each run."""
        return [np.flatnonzero(self.usable(run)) for run in self.runs]

    def asked_on(self, keep: Sequence[np.ndarray]) -> np.ndarray:
        """The recorded speed set points (row,) on some rows of each run, without the free constant of the run."""
        return np.concatenate([level(v[k]) for v, k in zip(self.asked, keep)])

    def clusters(self, keep: Sequence[np.ndarray]) -> np.ndarray:
        """Strokes (row,) on some rows of each run."""
        return np.concatenate([run.clusters(k)[rows] for k, (run, rows) in enumerate(zip(self.runs, keep))])

    def rest(self, x: np.ndarray, keep: Sequence[np.ndarray]) -> np.ndarray:
        """What the law leaves (row,) on some rows of each run, without the free constant of the run."""
        return np.concatenate([level(v[rows] - self.wanted(k, x, rows)) for k, (v, rows) in enumerate(zip(self.asked, keep))])

    def columns(self, x: np.ndarray, keep: Sequence[np.ndarray]) -> np.ndarray:
        """Derivatives of the law (row, number) on some rows of each run, without the free constant of the run."""
        return np.vstack([level(self.slopes(i, x, k)) for i, k in enumerate(keep)])

    def slopes(self, k: int, x: np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """Derivatives (row, number) of the law of run `k` as it is recorded with respect to x."""
        return self.as_recorded(k, functools.partial(self._slopes, k, x), rows)

    def _slopes(self, k: int, x: np.ndarray, rows: np.ndarray | slice) -> np.ndarray:
        """Derivatives (row, number) of the output of run `k`."""
        run, on = self.runs[k], self.on[k]
        fed, change = np.zeros((2, len(run.start[rows])))
        if on:
            fed = on * self.fed(run, x[3], rows)
            change = change if self.recorded else on * self.fed(run, x[3], rows, self.rate)
        return np.column_stack([self.error(run, x[2], rows), fed, -x[0] * self.rate(run, run.start[rows] - x[2]), -x[1] * change])


def level(values: np.ndarray) -> np.ndarray:
    """(row, ...) values of one run without their mean, which its free constant takes."""
    return values - values.mean(axis=0) if len(values) else values
