"""Identify the position controller from its signals: gain, feedforward weight and delays.

At the start t of every position cycle the NC computes from the recorded set point s and position x

    v* = Kv (s(t - d_pos) - x(t)) + a_v f,    f = (s(t - d_ff) - s(t - d_ff - Tp)) / Tp,  or the recorded feedforward

v* is recorded without noise and x as the control used it, so the law holds up to rounding and unmodelled terms.

For known delays the law is linear in Kv and a_v. The delays are therefore searched on a grid of quarter cycles, with cubic and with linear
interpolation of the set points between the NC's samples (linear: a delay of 1.5 cycles is the mean of two neighbouring cycles, as in a
SINUMERIK). The best grid points are refined by a damped Gauss-Newton search, so the result does not depend on the machine file's values.

An encoder with a different zero adds a constant to v*, so each run has a free constant. If two laws have similar residuals, as on a few smooth waves, the intervals cover both.
A position x(t + l) that the control used l later or earlier than it is recorded, a filter behind which v* is recorded, a lag T of the set points before the law (block `set_point_lag`), and a
PID with feedforward of speed and acceleration are recognised where they predict the motion better. If even the best of these laws leaves more than noise, the intervals cover all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from twin.control.command_law import LARGEST_LEFT, ROUNDED
from twin.control.position_controller import PARAMETERS
from twin.estimate.regression import Fit
from twin.identify.axis_run import AxisRun
from twin.identify.position_law import RIVAL_RATIO, ROUNDING, SLOPE, PositionLaw, loop_position
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
    set_point_lag: tuple[float, float] = (0.0, 0.0)
    """Time of a lag of the set points, and the half width of its interval [s]."""


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
    ways = [*sorted(INTERPOLATIONS, key=lambda way: way != interpolation), SLOPE][: 1 if only else 3]
    best = sharp = PositionLaw(axis, runs, ways[0])
    x, least, rivals = best.search()
    starts = {best: x}
    given = np.concatenate([r.speed_setpoint * axis.ratio for r in runs if r.speed_setpoint is not None])
    exact = ROUNDED * float(np.std(given))
    for other in (PositionLaw(axis, runs, way) for way in ways[1:]):
        if other.way == SLOPE and (other.recorded or not any(other.on)):
            continue
        there, sharp = other.search(), other if other.way == SLOPE else sharp
        starts[other] = there[0]
        if there[1] < CLEARLY_LESS * least:
            best, (x, least, rivals) = other, there
        elif other.way == SLOPE and (any_time or not axis.actuator.measured) and there[1] < max(RIVAL_RATIO * least, exact):
            rivals = [*rivals, there[0]]
    if not np.all(np.isfinite(x)):
        return "too few cycles without a limit or an outlier"
    fit, x = best.polished(x)
    if not np.all(np.isfinite(x)) or not np.isfinite(fit.deviations[0]):
        return "the axis moves at one speed only, so delay and position gain cannot be separated; record accelerations"
    left = _rms(fit)
    if left > LARGEST_LEFT * float(np.sqrt(np.mean(given**2))):
        return "the recorded speed set point follows no position controller: the best gain, feedforward and delays leave too much of it"
    if x[0] <= GAIN_SIGNIFICANCE * fit.deviations[0]:
        return f"no position gain: {x[0]:.4g} 1/s within {fit.deviations[0]:.2g}; check the units of speed set point and position"
    if not any(best.on):  # no run shows the feedforward
        x[1], x[3] = axis.loops.velocity_feedforward, axis.loops.feedforward_delay_s
    simple, bare = best.without_delays(), np.zeros(4)
    bare[: len(simple.values)] = simple.values
    if _rms(simple) < max(_of_rounding(r, bare) for r in runs):  # a delay between two cycles would only smooth the rounding
        x, rivals, left = bare, [*rivals, x], _rms(simple)
    more, rough = "", left > max(ROUNDING * float(np.std(given)), OF_ROUNDING * max(_of_rounding(r, x) for r in runs))
    apart = np.abs(np.array([*rivals, x]) - x).max(axis=0)
    lagging = best.with_set_point_lag(x) if rough else None
    moved = [m for law in dict.fromkeys((best, sharp)) if any_time and rough and (m := law.with_feedback_of_another_time(x)) is not None]
    if moved:
        fit, late, rivals = min(moved, key=lambda m: _rms(m[0]))
        rivals = [*rivals, *(m[1] for m in moved if _rms(m[0]) < max(RIVAL_RATIO * _rms(fit), exact))]
        rivals = [*rivals, late] if float(np.std(fit.residual)) * RIVAL_RATIO < left else [*rivals, late, np.append(x, 0.0)]
        apart = np.abs(np.array(rivals) - late).max(axis=0)
        more = f"one whose position is recorded {abs(late[4]) * 1e3:.3g} ms {'late' if late[4] > 0.0 else 'early'}"
        x, left = late, _rms(fit)
    begun = [(law, start) for law, start in starts.items() if any_time and rough and np.all(np.isfinite(start))]
    filters, filtered_record = [(law, behind) for law, start in begun if (behind := law.behind_a_filter(start)) is not None], False
    if filters:
        law, (of_filter, at, time) = min(filters, key=lambda one: _rms(one[1][0]))
        at = at if any(best.on) else np.array([at[0], x[1], at[2], x[3]])
        if filtered_record := _rms(of_filter) < CLEARLY_LESS * left:
            best, fit, x, left, apart = law, of_filter, at, _rms(of_filter), FILTER_ERROR * np.abs(at)
            more = f"one whose speed set point is recorded behind a filter of {time * 1e3:.3g} ms"
        elif _rms(of_filter) < RIVAL_RATIO * left:
            apart[:4] = np.maximum(apart[:4], np.abs(at - x[:4]))
    if (pid := None if filtered_record else best.as_pid(x)) is not None:
        fit, x, apart, left = pid, np.array([*pid.values[:2], 0.0, 0.0]), np.zeros(4), _rms(pid)
        more = f"a PID: it has an integral gain of {pid.values[2]:.4g} 1/s2 and an acceleration feedforward of {pid.values[3]:.4g} s as well; write them in a block pid"
    x, filtered = x[:4], (0.0, 0.0)
    if lagging is not None:
        of_lag, found, rivals = lagging
        around, least, lag = np.abs(np.array(rivals) - found).max(axis=0), _rms(of_lag), float(found[4])
        half = float(of_lag.quantile * math.hypot(of_lag.deviations[4], around[4], FLOOR["position_delay_s"]))
        # a law that leaves nearly as little is not excluded
        doubt = np.abs(found[:4] - x) * (max(left, least) < RIVAL_RATIO * min(left, least))
        if least < left and half < lag:
            fit, x, left, filtered, apart, pid = of_lag, found[:4], least, (lag, half), around, None
            more = f"one behind a lag of its set points of {lag * 1e3:.3g} ms"
        apart = np.maximum(apart[:4], doubt)
    values = dict(zip(NAMES, x.tolist()))
    spread = [*fit.deviations[:2], 0.0, 0.0] if pid is not None else fit.deviations
    deviations = {n: float(math.hypot(d, FLOOR[n], a)) for n, d, a in zip(NAMES, spread, apart)}
    weight, half = values["velocity_feedforward"], fit.quantile * deviations["velocity_feedforward"]
    if abs(weight) < half or half > WIDEST_INTERVAL:  # what may be none has no delay
        deviations["feedforward_delay_s"] = math.inf
    elif weight < LEAST_WEIGHT:
        deviations |= dict.fromkeys(NAMES[1:], math.inf)
    return PositionControl(
        values, deviations, fit.quantile, fit.condition, left, "linear" if best.way == "linear" else "cubic", best.recorded, more, filtered
    )


FILTER_ERROR = 1e-2
"""Share by which the higher terms of a filter of the record may change the numbers of a law."""

OF_ROUNDING = 1.5
"""A law that leaves less than this multiple of what the rounding of its set points makes lacks nothing: a lag would only smooth them."""


def _of_rounding(run: AxisRun, x: np.ndarray) -> float:
    """RMS of the speed set point [axis units a second] that a law makes of the rounding of recorded set points. The position is rounded for the control, too."""
    fed = 0.0 if run.feedforward == "off" or run.velocity_feedforward is not None else math.sqrt(2.0) * x[1] / run.cycle
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
