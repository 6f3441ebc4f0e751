"""Identify the position controller from its signals: gain, feedforward weight and delays.

At the start t of every position cycle the NC computes from the recorded set point s and position x

    v* = Kv (s(t - d_pos) - x(t)) + a_v f,    f = (s(t - d_ff) - s(t - d_ff - Tp)) / Tp,  or the recorded feedforward

v* is recorded without noise and x as the control used it, so the law holds up to rounding and unmodelled terms.

For known delays the law is linear in Kv and a_v. The delays are therefore searched on a grid of quarter cycles, with cubic and with linear
interpolation of the set points between the NC's samples (linear: a delay of 1.5 cycles is the mean of two neighbouring cycles, as in a
SINUMERIK). The best grid points are refined by a damped Gauss-Newton search, so the result does not depend on the machine file's values.
A set point that is late by a cycle is the same law as a weight that is smaller by Kv Tp. Of laws that fit alike, that with a weight of 1 is taken.

An encoder with a different zero adds a constant to v*, so each run has a free constant.

Hypotheses of what the controller has beside this law, in the order in which they are tried until one leaves only rounding:

    friction_pulse   pulses after reversals, beside this law and each of the following but the PID; a recorded feedforward holds them
    pid              the parts of a PID, without delays
    another time     the position x(t + l) that the control used is recorded l later or earlier
    record lag       v* is recorded behind a lag T: block `speed_record_lag`, or `speed_set_point_lag` where the file lists it
    set_point_lag    the set points pass a lag T before the law; where the file lists it, it is known

A hypothesis replaces another one if it predicts left-out pieces of the motion better (`estimate.held_out_gain`) by more than the rounding of the
record makes, and if its time is not within its own interval of zero. The intervals cover all laws that leave less than RIVAL_RATIO of the best one.
Two cases are decided beforehand, unless `any_time` or a listed lag asks for both times: `check_recording` finds late channels itself, so the position
has no other time; and beside a measured speed loop a record lag may stand in for anything, so it must leave only rounding.
Last, several cycles of the controller from one sample to the next are counted.

Does the controller have the blocks that the machine file lists? A block that changes the set points is dropped, and the law fitted again: without one
that the control lacks it leaves less than any rival may. A part of the output, such as a pulse or an integral, is missing if a law without it leaves
only rounding and the part would be larger.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math

import numpy as np

from twin.control.block import Listed, keyed
from twin.control.command_columns import ROUNDED
from twin.control.command_law import LARGEST_LEFT
from twin.control.set_point_filters import SET_POINT_LAG
from twin.control.speed_set_point_filters import lag_of
from twin.estimate.held_out_gain import is_better
from twin.identify.axis_run import AxisRun, behind_blocks
from twin.identify.position_law import NAMES, ROUNDING, SLOPE, PositionLaw, level, loop_position
from twin.identify.position_law_search import (
    OF_COLUMNS_S,
    OF_ROUNDING,
    RIVAL_RATIO,
    Found,
    at_full_feedforward,
    found_law,
    in_whole_cycles,
    polished,
    rms,
    search,
)
from twin.identify.position_law_variants import at_another_time, behind_record_lag, behind_set_point_lag, cycles_a_sample
from twin.identify.recorded_pid import recorded_pid
from twin.identify.recorded_pulse import beside_pulses
from twin.identify.speed_control import SpeedControl
from twin.machine.keys import INTERPOLATIONS
from twin.machine.machine import Axis, Machine
from twin.recordings.profile_speed import held_samples
from twin.simulation.drive_setpoints import with_blocks
from twin.simulation.loop_terms import SETPOINT, SPEED
from twin.units import AXIS_UNITS, in_words

GAIN_SIGNIFICANCE = 3.0
"""A gain is significant if it exceeds this many standard deviations."""

CLEARLY_LESS = 0.8
"""Another law replaces the machine file's interpolation if its residual is smaller than this share."""

ALIKE = 1e-3
"""Laws fit alike if their residuals differ by at most this share. On two machines of the second plant equal ones differed by up to 3e-4, others by 4e-3."""

FILTER_ERROR = 1e-2
"""Share by which the higher terms of a filter of the record may change the numbers of a law behind a lag that leaves more than rounding."""

NOT_RECORDED = "no speed set point is recorded"

FLOOR = dict(zip(NAMES, (3e-5, 6e-7, OF_COLUMNS_S, 4e-9)))
"""Standard deviations due to rounded columns and the set-point splines; these errors are systematic, not random."""


@dataclass(frozen=True)
class PositionControl:
    """Values of NAMES with their 95 % half intervals (inf: not determined), and the residual RMS of v* [axis units a second].

    `interpolation`: 'cubic' or 'linear' between the NC's set points; `from_recorded_feedforward`: f is a recorded signal; `more`: what the
    controller has beside NAMES, in words.
    """

    values: dict[str, float]
    half: dict[str, float]
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
    plain = plain_law(axis, runs, interpolation, only, any_time)
    return plain if isinstance(plain, str) else richest_law(plain, any_time)


def rms_left(found: PositionControl | str) -> float:
    """RMS that the law of a position controller leaves; infinite without one."""
    return math.inf if isinstance(found, str) else found.residual_rms


def plain_law(axis: Axis, runs: Sequence[AxisRun], interpolation: str, only: bool = False, any_time: bool = False) -> Found | str:
    """The law of NAMES alone, or why there is none."""
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
    best = PositionLaw(axis, runs, ways[0])
    x, least, rivals = search(best)
    ends = {best: x}
    for other in (PositionLaw(axis, runs, way) for way in ways[1:]):
        if other.way == SLOPE and (other.recorded or not any(other.on)):
            continue
        there = search(other)
        ends[other] = there[0]
        if there[1] < CLEARLY_LESS * least:
            best, (x, least, rivals) = other, there
        elif other.way == SLOPE and any_time and there[1] < max(RIVAL_RATIO * least, ROUNDED * float(np.std(best.given))):
            rivals = [*rivals, there[0]]
    if not np.all(np.isfinite(x)):
        return "too few cycles without a limit or an outlier"
    fit, x = polished(best, x)
    if not np.all(np.isfinite(x)) or not np.isfinite(fit.deviations[0]):
        return "the axis moves at one speed only, so delay and position gain cannot be separated; record accelerations"
    left = rms(fit)
    if not any(best.on):  # no run shows the feedforward
        x[1], x[3] = axis.loops.velocity_feedforward, axis.loops.feedforward_delay_s
    if best.of_rounding(x) > 0.0:  # a delay between two cycles would only smooth it
        whole, of_whole = in_whole_cycles(best)
        if best.recorded or not any(best.on):
            whole = np.array([whole[0], x[1], whole[2], x[3]])
        if of_whole < OF_ROUNDING * best.of_rounding(whole):
            x, rivals, left = whole, [*rivals, x], of_whole
    if any(best.on) and not best.recorded:  # of laws that fit alike, the usual one
        full, of_full = at_full_feedforward(best, x)
        if of_full < max((1.0 + ALIKE) * left, ROUNDING * float(np.std(best.given))):
            x, rivals, left = full, [*rivals, x], max(of_full, left)
    return replace(found_law(best, fit, x, rivals, left), ends=ends)


def richest_law(plain: Found, any_time: bool) -> PositionControl | str:
    """The law with what the record shows beside the plain one, or why it is the law of no position controller."""
    blocks = plain.law.axis.blocks
    if against := _against(plain):
        pid = recorded_pid(plain)  # far from every other law, only one that leaves nothing is believed
        return _result(pid) if pid and pid.left <= pid.rounding and not _against(pid) else against
    late = any_time or lag_of(blocks) is not None
    listed = any(b.block is SET_POINT_LAG for b in blocks)
    best = _with_pulses(plain)
    tried = [best]
    possible = (recorded_pid, *([at_another_time] if late else []), behind_record_lag, *([] if listed else [behind_set_point_lag]))
    for hypothesis in possible:
        if best.left <= best.rounding:
            break
        if (one := hypothesis(plain)) is not None:
            tried.append(one := _with_pulses(one))
            if (late or hypothesis is not behind_record_lag or one.leaves_only_rounding) and _is_better(one, best):
                best = one
    as_well = [one.x[:4] for one in tried if one is not best and one.left < RIVAL_RATIO * best.left]
    if best.lag and best.lag is not SET_POINT_LAG and best.left > best.rounding:
        as_well.append((1.0 + FILTER_ERROR) * best.x[:4])
    best = replace(best, others=[*best.others, *(np.append(x, best.x[4:]) for x in as_well)])
    cycles = cycles_a_sample(plain.law, plain.x) if any_time and best.delayed else 1
    return replace(_result(best), cycles=cycles)


def _is_better(one: Found, other: Found) -> bool:
    """Whether a law predicts the held-out pieces of the motion better than another, beyond rounding, and its time is determined."""
    determined = len(one.x) == len(NAMES) or one.half_of_time < abs(one.x[4])
    return determined and is_better(one.left_out, other.left_out, other.rounding)


def _with_pulses(found: Found) -> Found:
    """A law beside the pulses that follow its reversals, if the record shows some; a recorded feedforward holds them."""
    if found.law.recorded or not found.delayed or found.leaves_only_rounding:
        return found
    return beside_pulses(found) or found


def _against(found: Found) -> str:
    """Why this is the law of no position controller; empty if nothing speaks against it."""
    if found.left > LARGEST_LEFT * float(np.sqrt(np.mean(found.law.given**2))):
        return "the recorded speed set point follows no position controller: the best gain, feedforward and delays leave too much of it"
    gain, deviation = found.x[0], found.fit.deviations[0]
    if gain <= GAIN_SIGNIFICANCE * deviation:
        return f"no position gain: {gain:.4g} 1/s within {deviation:.2g}; check the units of speed set point and position"
    return ""


def _result(found: Found) -> PositionControl:
    """The numbers with their intervals: of the regression, of rounding, and of the laws that fit as well."""
    values, blocks = dict(zip(NAMES, found.x.tolist())), dict(found.blocks)
    if found.lag:
        blocks |= keyed(found.lag, {"time_constant": (float(found.x[4]), found.half_of_time)}, found.law.axis.kind)
    spread = found.fit.deviations if found.delayed else [*found.fit.deviations[:2], 0.0, 0.0]
    half = {n: found.fit.quantile * math.hypot(d, FLOOR[n], a) for n, d, a in zip(NAMES, spread, found.apart)}
    weight, of_weight = values["velocity_feedforward"], half["velocity_feedforward"]
    if abs(weight) < of_weight or of_weight > WIDEST_INTERVAL:  # what may be none has no delay
        half["feedforward_delay_s"] = math.inf
    elif weight < LEAST_WEIGHT:
        half |= dict.fromkeys(NAMES[1:], math.inf)
    return PositionControl(
        values,
        half,
        found.fit.condition,
        found.left,
        "linear" if found.law.way == "linear" else "cubic",
        found.law.recorded,
        found.words.format(1e3 * abs(found.x[-1])),
        blocks,
        found.leaves_only_rounding,
    )


WIDEST_INTERVAL, WIDEST_DELAY_INTERVAL_S = 0.3, 1e-3
"""A number of a controller with a wider interval is not determined: relative, absolute of a weight of feedforward, of delays in seconds."""


LEAST_WEIGHT = 0.2
"""Least weight of a feedforward that a control has. A smaller one, or one below zero, stands for what the law lacks, such as a filter of the set points."""


def is_determined(found: PositionControl | SpeedControl, name: str) -> bool:
    """Whether the signals determine a number of a controller by itself. Others are one of many that fit, each with its own of another number."""
    if name == "feedforward_delay_s" and getattr(found, "from_recorded_feedforward", False):
        return True
    return is_narrow(name, found.values[name], found.half[name])


def is_narrow(name: str, value: float, half: float) -> bool:
    """Whether the half interval of a number of a controller determines it."""
    return half < (
        WIDEST_DELAY_INTERVAL_S if name.endswith("delay_s") else WIDEST_INTERVAL * (1.0 if name.endswith("feedforward") else abs(value))
    )


def false_set_point_block(machine: Machine, axis: Axis, runs: Sequence[AxisRun], found: PositionControl | str) -> str:
    """Which listed block of the set points contradicts the record, with what the law leaves with and without it; '' if none does."""
    if isinstance(found, PositionControl) and found.only_rounding:
        return ""
    unit, factor = AXIS_UNITS[axis.kind].speed
    for one in axis.blocks:
        if one.block.stage != SETPOINT and one.block.kernel is None:
            continue
        without = replace(axis, blocks=tuple(b for b in axis.blocks if b is not one))
        other = fit_position_control(
            without, [behind_blocks(machine, without, run) for run in runs], machine.setpoint_interpolation, only=True
        )
        if isinstance(other, str) or RIVAL_RATIO * other.residual_rms > rms_left(found):
            continue
        left = f"{found.residual_rms * factor:.2g} {unit}" if isinstance(found, PositionControl) else "too much"
        return (
            f"the file lists {in_words(one.block.name)}, but without it the law leaves {other.residual_rms * factor:.2g} {unit} RMS instead of {left}; "
            f"correct [axis.{axis.name}.block.{one.block.name}], or let 'twin diagnose' size it"
        )
    return ""


def missing_parts(machine: Machine, axis: Axis, runs: Sequence[AxisRun], found: PositionControl) -> list[str]:
    """Parts of the output that the file lists and the recorded controller does not have, in words; none if its law leaves more than rounding."""
    if not found.only_rounding:
        return []
    law = PositionLaw(axis, runs, found.interpolation)
    return [
        f"the file lists {in_words(one.block.name)} ({', '.join(map(in_words, numbers))}); the recorded speed set point has none"
        for one, numbers in _parts(axis)
        if not any(f"{one.block.name}.{n.key(axis.kind)}" in found.blocks for n in one.block.numbers if n.name in numbers)
        and _size_of(one, numbers, machine, law, found) > RIVAL_RATIO * found.residual_rms
    ]


def _parts(axis: Axis) -> Iterator[tuple[Listed, tuple[str, ...]]]:
    """The listed blocks at the output, with the numbers of each of their strengths that the file gives."""
    for one in axis.blocks:
        for numbers in one.block.strengths if one.block.stage == SPEED else ():
            if given := tuple(name for name in numbers if one.values.get(name)):
                yield one, given


def _size_of(one: Listed, numbers: Sequence[str], machine: Machine, law: PositionLaw, found: PositionControl) -> float:
    """RMS of what some numbers of a listed block would add to the recorded speed set point [axis units a second]."""
    x, name = np.array(list(found.values.values())), law.axis.name
    lacking = machine.with_axis(name, **{f"block.{one.block.name}.{number}": 0.0 for number in numbers}).axis(name)
    parts = []
    for k, (run, rows) in enumerate(zip(law.runs, law.usable_rows())):
        setpoint, fed = (law.read(run, run.start - late) for late in x[2:])
        with_it, without = (
            with_blocks(axis, x[0], machine, setpoint, fed, law.error(run, x[2]), law.output(k, x), (SPEED,))
            for axis in (law.axis, lacking)
        )
        parts.append(level((with_it - without)[rows]))
    return float(np.std(np.concatenate(parts)))
