"""Identify the position controller from its signals: gain, feedforward weight and delays.

At the start t of every position cycle the NC computes from the recorded set point s and position x

    v* = Kv (s(t - d_pos) - x(t)) + a_v f,    f = (s(t - d_ff) - s(t - d_ff - Tp)) / Tp,  or the recorded feedforward

v* is recorded without noise and x as the control used it, so the law holds up to rounding and unmodelled terms.

For known delays the law is linear in Kv and a_v. The delays are therefore searched on a grid of quarter cycles, with cubic and with linear
interpolation of the set points between the NC's samples (linear: a delay of 1.5 cycles is the mean of two neighbouring cycles, as in a
SINUMERIK). The best grid points are refined by a damped Gauss-Newton search, so the result does not depend on the machine file's values.

An encoder with a different zero adds a constant to v*, so each run has a free constant. If two laws have similar residuals, as on a few smooth waves, the intervals cover both.
Further parts are recognised where they predict the motion better: a position x(t + l) that the control used l later or earlier than it is recorded,
a lag T behind which v* is recorded (block `speed_record_lag` or `speed_set_point_lag`), a lag T of the set points before the law (`set_point_lag`),
the parts of a PID (`pid`), pulses after reversals (`friction_pulse`), and several cycles of the controller from one sample to the next. If even the best of these laws leaves more than noise, the intervals cover all of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import functools
import math

import numpy as np

from twin.control.block import keyed
from twin.control.command_law import LARGEST_LEFT, ROUNDED
from twin.control.friction_pulse import FRICTION_PULSE
from twin.control.position_controller import PARAMETERS
from twin.control.set_point_filters import SET_POINT_LAG
from twin.control.speed_set_point_filters import RECORD_LAG, lag_of
from twin.estimate.regression import Fit
from twin.identify.axis_run import AxisRun
from twin.identify.position_law import OF_ROUNDING, RIVAL_RATIO, ROUNDING, SHARP, SLOPE, PositionLaw, loop_position
from twin.identify.position_law_variants import (
    Variant,
    cycles_a_sample,
    with_feedback_of_another_time,
    with_record_lag,
    with_set_point_lag,
    without_delays,
)
from twin.identify.recorded_pid import recorded_pid
from twin.identify.recorded_pulse import RecordedPulse, recorded_pulse
from twin.identify.speed_control import SpeedControl
from twin.machine.axis import Axis
from twin.machine.keys import INTERPOLATIONS
from twin.recordings.profile_speed import held_samples
from twin.recordings.roughness import step_of

NAMES = tuple(p.name for p in PARAMETERS)
"""Gain, weight of the speed feedforward, delays of set point and feedforward."""

GAIN_SIGNIFICANCE = 3.0
"""A gain is significant if it exceeds this many standard deviations."""

CLEARLY_LESS = 0.8
"""Another law replaces the machine file's interpolation if its residual is smaller than this share."""

NOT_RECORDED = "no speed set point is recorded"

FLOOR = dict(zip(NAMES, (3e-5, 6e-7, 1.2e-8, 4e-9)))
"""Standard deviations due to rounded columns and the set-point splines; these errors are systematic, not random."""


@dataclass(frozen=True)
class PositionControl:
    """Values of NAMES with their fit, and the residual RMS of v* [axis units a second].

    `interpolation`: 'cubic' or 'linear' between the NC's set points; `from_recorded_feedforward`: f is a recorded signal; `more`: what the
    controller has beside NAMES, in words.
    """

    values: dict[str, float]
    deviations: dict[str, float]
    quantile: float
    condition: float
    residual_rms: float
    interpolation: str = "cubic"
    from_recorded_feedforward: bool = False
    more: str = ""
    blocks: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """'block.key' -> number of a block and its half interval, in the unit of the file."""
    only_rounding: bool = False
    """Whether what the law leaves is all rounding of the record."""
    cycles: int = 1
    """How many times it computes from one sample to the next."""


def fit_position_control(
    axis: Axis, runs: Sequence[AxisRun], interpolation: str = "cubic", only: bool = False, any_time: bool = False
) -> PositionControl | str:
    """The law with the smallest residual of the recorded speed set point, or the reason why none was found.

    A speed that the control computes for other uses, such as that of its profile, leaves more than LARGEST_LEFT of itself.
    `interpolation`: 'cubic' or 'linear', that of the machine file. The other is used only if its residual is clearly smaller; with `only` it is
    not tried. `any_time`: the position may be recorded before or after its use; `identify.recording` finds late channels itself.
    """
    if not any(r.speed_setpoint is not None for r in runs):
        return NOT_RECORDED
    if not any(loop_position(r, axis) is not None for r in runs):
        return "the position feedback of the control is not recorded"
    runs = [r for r in runs if r.speed_setpoint is not None and loop_position(r, axis) is not None and np.ptp(r.angle) * axis.ratio > 1e-5]
    if not runs:
        return "the axis does not move where its speed set point is recorded"
    if held_samples([r.speed_setpoint for r in runs if r.speed_setpoint is not None]) != 1:
        return "the recorded speed set point stands for longer than a cycle: the position controller computes in another one; correct position_cycle_us"
    plain = _plain(axis, runs, interpolation, only, any_time)
    if isinstance(plain, str):
        return plain
    found, starts = plain
    best, law, x = found, found.law, found.x
    exact = max(ROUNDING * _size(law), OF_ROUNDING * max(_of_rounding(r, x) for r in runs))
    if against := found.against:
        pid = _pid_in_place_of(found, found, only_exact=True)  # far from every other law, only one that leaves nothing is believed
        return pid.result() if pid is not None and not pid.against else against
    # a recorded feedforward holds the pulses
    rough, least = found.left > exact, max(exact, found.left)
    pulse = None if law.recorded or found.leaves_only_rounding else recorded_pulse(law, [x, law.in_whole_cycles[0]], least)
    smooth = rough and not (pulse and pulse.left < least)  # beside pulses that leave less no lag is searched
    lag = with_set_point_lag(law, x) if smooth and not any(b.block is SET_POINT_LAG for b in axis.blocks) else None  # a listed one is known
    if smooth and (any_time or lag_of(axis.blocks)):
        best = _recorded_behind_a_lag(_at_another_time(best, starts), starts)
    elif smooth and not found.leaves_only_rounding:  # beside a measured speed loop a lag that leaves more may stand in for anything
        behind = _recorded_behind_a_lag(best, starts)
        best = behind if behind.leaves_only_rounding else best
    if rough and not best.blocks:
        best = _pid_in_place_of(found, best) or best
    if lag is not None:
        best = _or_behind_a_lag(best, lag)
    if pulse and not best.blocks and (not best.more or pulse.left < best.left):
        best = _with_pulse(found, pulse, least)
    return replace(best.result(), cycles=cycles_a_sample(law, x) if any_time and best.delayed else 1)


@dataclass(frozen=True)
class _Found:
    """A law with its fit, its numbers (4,), how far those of laws that fit as well are from them (4,), and what it leaves [axis units a second]."""

    law: PositionLaw
    fit: Fit
    x: np.ndarray
    apart: np.ndarray
    left: float
    more: str = ""
    delayed: bool = True
    blocks: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def against(self) -> str:
        """Why this is the law of no position controller; empty if nothing speaks against it."""
        if self.left > LARGEST_LEFT * float(np.sqrt(np.mean(_given(self.law) ** 2))):
            return "the recorded speed set point follows no position controller: the best gain, feedforward and delays leave too much of it"
        if self.x[0] <= GAIN_SIGNIFICANCE * self.fit.deviations[0]:
            return f"no position gain: {self.x[0]:.4g} 1/s within {self.fit.deviations[0]:.2g}; check the units of speed set point and position"
        return ""

    @functools.cached_property
    def leaves_only_rounding(self) -> bool:
        """Whether nothing that it leaves is larger than the rounding of the recorded speed set point, so that no short event is in it."""
        step = max(step_of(r.speed_setpoint) for r in self.law.runs if r.speed_setpoint is not None) * self.law.axis.ratio
        return float(np.abs(self.fit.residual).max()) <= OF_ROUNDING * max(0.5 * step, ROUNDING * _size(self.law))

    def result(self) -> PositionControl:
        """The numbers with their deviations: of the regression, of rounding, and of the laws that fit as well."""
        values = dict(zip(NAMES, self.x.tolist()))
        spread = self.fit.deviations if self.delayed else [*self.fit.deviations[:2], 0.0, 0.0]
        deviations = {n: float(math.hypot(d, FLOOR[n], a)) for n, d, a in zip(NAMES, spread, self.apart)}
        weight, half = values["velocity_feedforward"], self.fit.quantile * deviations["velocity_feedforward"]
        if abs(weight) < half or half > WIDEST_INTERVAL:  # what may be none has no delay
            deviations["feedforward_delay_s"] = math.inf
        elif weight < LEAST_WEIGHT:
            deviations |= dict.fromkeys(NAMES[1:], math.inf)
        way, recorded = "linear" if self.law.way == "linear" else "cubic", self.law.recorded
        return PositionControl(
            values,
            deviations,
            self.fit.quantile,
            self.fit.condition,
            self.left,
            way,
            recorded,
            self.more,
            self.blocks,
            self.leaves_only_rounding,
        )


def _plain(
    axis: Axis, runs: Sequence[AxisRun], interpolation: str, only: bool, any_time: bool
) -> tuple[_Found, dict[PositionLaw, np.ndarray]] | str:
    """The law of NAMES, and the numbers with which the search of each interpolation ended; or why there is none."""
    ways = [*sorted(INTERPOLATIONS, key=lambda way: way != interpolation), SLOPE][: 1 if only else 3]
    best = PositionLaw(axis, runs, ways[0])
    x, least, rivals = best.search()
    starts, size = {best: x}, _size(best)
    for other in (PositionLaw(axis, runs, way) for way in ways[1:]):
        if other.way == SLOPE and (other.recorded or not any(other.on)):
            continue
        there = other.search()
        starts[other] = there[0]
        if there[1] < CLEARLY_LESS * least:
            best, (x, least, rivals) = other, there
        elif other.way == SLOPE and (any_time or not axis.actuator.measured) and there[1] < max(RIVAL_RATIO * least, ROUNDED * size):
            rivals = [*rivals, there[0]]
    if not np.all(np.isfinite(x)):
        return "too few cycles without a limit or an outlier"
    fit, x = best.polished(x)
    if not np.all(np.isfinite(x)) or not np.isfinite(fit.deviations[0]):
        return "the axis moves at one speed only, so delay and position gain cannot be separated; record accelerations"
    left = _rms(fit)
    if not any(best.on):  # no run shows the feedforward
        x[1], x[3] = axis.loops.velocity_feedforward, axis.loops.feedforward_delay_s
    if max(_of_rounding(r, x) for r in runs) > 0.0:  # a delay between two cycles would only smooth it
        whole, of_whole = best.in_whole_cycles
        if best.recorded or not any(best.on):
            whole = np.array([whole[0], x[1], whole[2], x[3]])
        if of_whole < OF_ROUNDING * max(_of_rounding(r, whole) for r in runs):
            x, rivals, left = whole, [*rivals, x], of_whole
    return _Found(best, fit, x, np.abs(np.array([*rivals, x]) - x).max(axis=0), left), starts


def _pid_in_place_of(plain: _Found, other: _Found, only_exact: bool = False) -> _Found | None:
    """A PID without delays on the runs of the plain law, if it predicts better than another law; with `only_exact`, only one that leaves no more than rounding."""
    pid = recorded_pid(plain.law, other.law.residual(other.x))
    if pid is None or (only_exact and not pid.exact):
        return None
    more = f"a PID: {', '.join(f'{key} = {value:.4g}' for key, (value, _) in pid.numbers.items())}"
    fit, x = pid.fit, np.array([*pid.fit.values[:2], 0.0, 0.0])
    return _Found(pid.law, fit, x, np.array([*pid.of_rounding, 0.0, 0.0]), _rms(fit), more, delayed=False, blocks=pid.numbers)


def _at_another_time(plain: _Found, starts: dict[PositionLaw, np.ndarray]) -> _Found:
    """The law whose position is recorded before or after its use, if one predicts better."""
    laws = dict.fromkeys((plain.law, *(law for law in starts if law.way == SLOPE)))
    moved = [m for law in laws if (m := with_feedback_of_another_time(law, plain.x)) is not None]
    if not moved:
        return plain
    best = min(moved, key=lambda m: _rms(m.fit))
    x, left, exact = best.x, _rms(best.fit), ROUNDED * _size(plain.law)
    rivals = [*best.rivals, *(m.x for m in moved if _rms(m.fit) < max(RIVAL_RATIO * left, exact))]
    if left * RIVAL_RATIO >= plain.left:
        rivals.append(np.append(plain.x, 0.0))
    apart = np.abs(np.array([*rivals, x]) - x).max(axis=0)
    more = f"one whose position is recorded {abs(x[4]) * 1e3:.3g} ms {'late' if x[4] > 0.0 else 'early'}"
    least = max(_half_of_time(best.fit), SHARP * plain.law.runs[0].cycle)  # a spline of the record shows no shorter time
    return _Found(best.law, best.fit, x[:4], apart[:4], left, more if abs(x[4]) > least else "")


def _recorded_behind_a_lag(plain: _Found, starts: dict[PositionLaw, np.ndarray]) -> _Found:
    """The law whose output is recorded behind a lag, if it leaves clearly less or the file lists one; else one that leaves nearly as little widens the intervals."""
    begun = ((law, start) for law, start in starts.items() if np.all(np.isfinite(start)))
    behind = [found for law, start in begun if (found := with_record_lag(law, start)) is not None]
    if not behind:
        return plain
    best = min(behind, key=lambda one: _rms(one.fit))
    x, left, listed = best.x, _rms(best.fit), lag_of(best.law.axis.blocks)
    bare, left_by_bare = without_delays(best.law, x[4])
    if CLEARLY_LESS * left_by_bare < left:  # at a steady speed feedforward takes up a delay
        x = bare
    if not any(best.law.on):
        x[[1, 3]] = plain.x[[1, 3]]
    apart, half = np.maximum(FILTER_ERROR * np.abs(x), np.abs(best.x - x)), _half_of_time(best.fit, x[4] - best.x[4])
    if left < (1.0 if listed else CLEARLY_LESS) * plain.left:
        more = f"one whose speed set point is recorded behind a lag of {x[4] * 1e3:.3g} ms"
        lag = keyed(listed.block if listed else RECORD_LAG, {"time_constant": (float(x[4]), half)}, best.law.axis.kind)
        return _Found(best.law, best.fit, x[:4], apart[:4], left, more, blocks=lag)
    if left < RIVAL_RATIO * plain.left:
        return replace(plain, apart=np.maximum(plain.apart, np.abs(x[:4] - plain.x)))
    return plain


def _or_behind_a_lag(other: _Found, lag: Variant) -> _Found:
    """The law behind a lag of the set points if it leaves less and its time is determined; a law that leaves nearly as little is not excluded."""
    apart, x, left, time = np.abs(np.array(lag.rivals) - lag.x).max(axis=0), lag.x[:4], _rms(lag.fit), float(lag.x[4])
    half = _half_of_time(lag.fit, apart[4])
    doubt = np.abs(x - other.x) * (max(other.left, left) < RIVAL_RATIO * min(other.left, left))
    if left < other.left and half < time:
        more = f"one behind a lag of its set points of {time * 1e3:.3g} ms"
        block = keyed(SET_POINT_LAG, {"time_constant": (time, half)}, lag.law.axis.kind)
        return _Found(lag.law, lag.fit, x, np.maximum(apart[:4], doubt), left, more, blocks=block)
    return replace(other, apart=np.maximum(other.apart, doubt))


def _with_pulse(plain: _Found, pulse: RecordedPulse, least: float) -> _Found:
    """The law with pulses; where they leave more than `least`, they are of another shape, and no number of the block is determined."""
    numbers, kind = pulse.numbers, plain.law.axis.kind
    if pulse.left < least:
        plain = replace(plain, fit=pulse.fit, x=pulse.x, apart=np.zeros(4), left=pulse.left)
    else:
        numbers = {name: (value, math.inf) for name, (value, _) in numbers.items()}
    return replace(plain, blocks=keyed(FRICTION_PULSE, numbers, kind))


def _half_of_time(fit: Fit, apart: float = 0.0) -> float:
    """Half interval of a fifth number, a time [s], from its fit and the distance of other times that fit as well."""
    return float(fit.quantile * math.hypot(fit.deviations[4], apart, FLOOR["position_delay_s"]))


def _given(law: PositionLaw) -> np.ndarray:
    """(row,) The recorded speed set points of all runs [axis units a second]."""
    return np.concatenate([r.speed_setpoint * law.axis.ratio for r in law.runs if r.speed_setpoint is not None])


def _size(law: PositionLaw) -> float:
    """Standard deviation of the recorded speed set points [axis units a second]."""
    return float(np.std(_given(law)))


FILTER_ERROR = 1e-2
"""Share by which the higher terms of a filter of the record may change the numbers of a law."""


def _of_rounding(run: AxisRun, x: np.ndarray) -> float:
    """RMS of the speed set point [axis units a second] that a law makes of the rounding of recorded set points. The position is rounded for the control, too."""
    fed = 0.0 if run.feedforward == "off" or run.velocity_feedforward is not None else math.sqrt(2.0) * x[1] / run.position_cycle
    return float(x[0] + fed) * step_of(run.setpoint_at(run.start)) / math.sqrt(12.0)


def _rms(fit: Fit) -> float:
    """RMS of what a law leaves."""
    return float(np.sqrt(np.mean(fit.residual**2)))


WIDEST_INTERVAL, WIDEST_DELAY_INTERVAL_S = 0.3, 1e-3
"""A number of a controller with a wider interval is not determined: relative, absolute of a weight of feedforward, of delays in seconds."""


LEAST_WEIGHT = 0.2
"""Least weight of a feedforward that a control has. A smaller one, or one below zero, stands for what the law lacks, such as a filter of the set points."""


def is_determined(found: PositionControl | SpeedControl, name: str) -> bool:
    """Whether the signals determine a number of a controller by itself. Others are one of many that fit, each with its own of another number."""
    if name == "feedforward_delay_s" and getattr(found, "from_recorded_feedforward", False):
        return True
    return is_narrow(name, found.values[name], found.quantile * found.deviations[name])


def is_narrow(name: str, value: float, half: float) -> bool:
    """Whether the half interval of a number of a controller determines it."""
    return half < (
        WIDEST_DELAY_INTERVAL_S if name.endswith("delay_s") else WIDEST_INTERVAL * (1.0 if name.endswith("feedforward") else abs(value))
    )
