"""Which block of an axis left its law first: the loop is cut, each block gets its own recorded inputs, in both traces.

    set points           the set point itself
    position controller  w* = Kv (s(t - d) - x) + a_v ds/dt            stated by the machine file, on the position cycles
                         a drive that closes the loop itself: also what it follows, made of w*, x and their values Td ago
    speed controller     i* = (Kp e + Kp/Tn int e + J a_t d2s/dt2) / Kt    stated; integral of the speed from the motor encoder: exact,
                         until i* meets its limit (there the integral stops); regressed where the speed is not measured itself
    current loop         torque        regressed on w*, i* and speed, TAPS samples about each instant
    mechanics            torque        regressed on a of all axes, sign v, v, position
    transmission         motor position - scale      regressed on torque, a, position, motor angle

A residual is taken in the golden and in the new trace by the same law. Where a block does what it did, both residuals are
alike, whatever its inputs now are; where it does not, their difference is the block's own doing. Its share is RMS of the
difference of the residuals over RMS of the difference of the outputs; a regressed law may move as far as the golden record
leaves it open. A block that changed also changes the inputs of the others, but not their laws: the first in the chain with a
large share is named.
The idea is that of `twin.diagnose.blocks`, which has measured traces and must live with noise; a twin's record has more
signals and none, so that a millionth shows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline

from twin.effects import apply_effects
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.regress.compare import Check, common
from twin.simulation.drive_setpoints import closed_on, received_from_nc, speed_set_point
from twin.simulation.lanes import commissioned_inertia
from twin.simulation.position_command import delay_weights

Law = tuple[np.ndarray, np.ndarray, np.ndarray]
"""What a block makes of its inputs: the output that a stated law gives (sample,), or the rows of a regressed one (sample, column);
the recorded output (sample,); the samples at which the law holds (sample,)."""

SHARE = 0.35
"""Share of the change of its output that a block must have made itself to be named: of blocks that were changed the current loop shows
least, 0.37 for its gain; of blocks before the changed one it shows most, 0.24 for friction and 0.41 for the measuring system."""
SEEN = 1e-4
"""A regressed law is left open in directions in which its inputs move by less than this share of the strongest."""
TAPS = 5
"""Samples of set points and speed from which the current loop's torque follows: it settles within one or two of them."""
AT_LIMIT = 0.998
"""A current set point counts as limited from this share of the peak current on."""
FOLLOWED = "drive_velocity_setpoint"
"""What a drive follows that closes the position loop itself."""
SLIDING = 1e-3
"""Friction is looked at where the axis moves faster than this share of its highest speed."""


@dataclass(frozen=True)
class Place:
    """Where a case left its golden result: axis, time, block ('': unknown), and what share of the change of its output each block made."""

    axis: str
    since_s: float | None
    block: str
    shares: Mapping[str, float] = field(default_factory=dict)


def place_of(machine: Machine, golden: Trace, now: Trace, checks: Sequence[Check]) -> Place | None:
    """The first place: the axis that is most beyond its tolerance, its first block, the time from which it shows."""
    failed = [c for c in checks if not c.ok]
    if not failed:
        return None
    by_axis: dict[str, float] = {}
    for check in failed:
        if check.axis:
            by_axis[check.axis] = max(by_axis.get(check.axis, 0.0), min(check.excess, 1e12))
    if not by_axis:
        return Place("", None, failed[0].block)
    axis = max(by_axis, key=lambda name: by_axis[name])
    times = [c.since_s for c in failed if c.axis == axis and c.since_s is not None]
    since = min(times) if times else None
    moved = [c for c in failed if c.quantity.startswith(f"{axis}.setpoint")]
    if moved:
        return Place(axis, since, "set points")
    shares = dict(block_shares(machine, machine.axis(axis), *common(golden, now)[:2])) if axis in now.axes else {}
    named = next((block for block, share in shares.items() if share > SHARE), "")
    if not named and len(shares) > 1:
        named = max(shares, key=lambda block: shares[block])
    return Place(axis, since, named, shares)


def block_shares(machine: Machine, axis: Axis, golden: Trace, now: Trace) -> Iterator[tuple[str, float]]:
    """(block, share) of one axis in the order of the chain; both traces on the same samples."""
    actual = apply_effects(machine).machine
    inertia = float(commissioned_inertia(machine)[machine.axis_names.index(axis.name)])
    axis, cycle = actual.axis(axis.name), actual.position_cycle
    on_cycles = abs(golden.period / cycle - round(golden.period / cycle)) < 1e-6
    each_cycle = abs(golden.period - cycle) < 1e-9
    measured_speed = axis.loops.speed_mean_cycles == 0 and axis.loops.speed_filter_time_s == 0.0
    blocks: list[tuple[str, Callable[[Trace], Law]]] = []
    if on_cycles:
        blocks.append(("position controller", lambda trace: _position_controller(actual, axis, trace)))
    if each_cycle:  # on samples further apart the faster loops cannot be separated
        if measured_speed:
            blocks.append(("speed controller", lambda trace: _speed_controller(actual, axis, inertia, trace)))
        else:
            blocks.append(("speed controller", lambda trace: _speed_controller_of_samples(actual, axis, trace)))
        if axis.effort == "current":
            blocks.append(("current loop", lambda trace: _current_loop(actual, axis, trace)))
        blocks += [("mechanics", lambda trace: _mechanics(axis, trace)), ("transmission", lambda trace: _transmission(axis, trace))]
    for block, law in blocks:
        (inputs, output, use), (new_inputs, new_output, new_use) = law(golden), law(now)
        both = use & new_use
        output, new_output = output[both], new_output[both]
        if inputs.ndim == 1:
            own = new_output - output - (new_inputs - inputs)[both]
        elif np.count_nonzero(both) < 3 * inputs.shape[1]:
            continue
        else:
            own = _own_change(_scaled(inputs[both], inputs[both]), output, _scaled(new_inputs[both], inputs[both]), new_output)
        yield block, _share(own, new_output - output)


def _own_change(rows: np.ndarray, output: np.ndarray, new_rows: np.ndarray, new_output: np.ndarray) -> np.ndarray:
    """Residual of the nearest law to the golden one that would explain the change of the output, and what it costs on the golden record.

    The golden record leaves some coefficients open (inputs that move alike), and these are free; others are held by it.
    """
    law, *_ = np.linalg.lstsq(rows, output, rcond=SEEN)
    change = new_output - output - (new_rows - rows) @ law
    wanted = np.concatenate([change, np.zeros(len(rows))])
    both = np.vstack([new_rows - rows, rows])
    other, *_ = np.linalg.lstsq(both, wanted, rcond=SEEN)
    left = wanted - both @ other
    return np.hypot(left[: len(rows)], left[len(rows) :])


def _share(own: np.ndarray, output: np.ndarray) -> float:
    """RMS of what a block changed itself over RMS of the change of its output; 0 where nothing changed."""
    changed = float(np.sqrt(np.mean(output**2))) if output.size else 0.0
    return float(np.sqrt(np.mean(own**2))) / changed if changed > 1e-12 else 0.0


def _scaled(rows: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Rows by the RMS of the reference's columns; a column that stands still there carries no information."""
    size = np.sqrt(np.mean(reference**2, axis=0))
    return np.where(size > 1e-12, rows / np.maximum(size, 1e-12), 0.0)


def _delayed(machine: Machine, axis: Axis, trace: Trace, delay: float) -> np.ndarray:
    """Set point that long before each sample (sample,), between the control's cycles as this control reads it."""
    curve = CubicSpline(trace.time, trace.get(axis.name, "setpoint"))
    parts = delay_weights(delay, machine.position_cycle, machine.setpoint_interpolation == "linear")
    delayed = [weight * curve(np.clip(trace.time - d, trace.time[0], trace.time[-1])) for d, weight in parts]
    return np.sum(delayed, axis=0)


def _position_controller(machine: Machine, axis: Axis, trace: Trace) -> Law:
    """Speed set point [axis units/s] of the position controller on the kept position cycles, and below it what a drive makes of it."""
    loops, cycle = axis.loops, machine.position_cycle
    wanted, output = (
        loops.position_gain_per_s * _delayed(machine, axis, trace, loops.position_delay_s),
        trace.get(axis.name, "velocity_setpoint"),
    )
    wanted = wanted - loops.position_gain_per_s * trace.get(axis.name, closed_on(trace, axis))
    ahead = _delayed(machine, axis, trace, loops.feedforward_delay_s) - _delayed(machine, axis, trace, loops.feedforward_delay_s + cycle)
    wanted = wanted + loops.velocity_feedforward * ahead / cycle
    if trace.has(axis.name, FOLLOWED) and trace.period < cycle * (1.0 + 1e-6):
        wanted = np.concatenate([wanted, speed_set_point(trace, axis, machine.speed_cycle)[:, 0]])
        output = np.concatenate([output, trace.get(axis.name, FOLLOWED)])
    return wanted, output, np.ones(len(output), bool)


def _followed(machine: Machine, axis: Axis, trace: Trace) -> np.ndarray:
    """Speed set point that the drive follows (sample, speed cycle): as recorded at each sample, by the drive's law between them."""
    made = speed_set_point(trace, axis, machine.speed_cycle)
    return made + (trace.get(axis.name, FOLLOWED)[:, None] - made[:, :1]) if trace.has(axis.name, FOLLOWED) else made


def _command(axis: Axis, trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """What the speed controller commands [A, V, Nm], and the samples before it meets its limit.

    With an integral it is taken relative to the first sample: what the integral holds there, such as a weight, is not an output of this law.
    """
    command = trace.get(axis.name, "current_setpoint" if axis.effort == "current" else axis.effort)
    limited = np.maximum.accumulate(np.abs(command) >= AT_LIMIT * axis.motor.peak_current_a)
    return command - (command[0] if axis.has_speed_integral else 0.0), ~limited


def _speed_integral(machine: Machine, axis: Axis, trace: Trace) -> np.ndarray:
    """Integral of the speed's error [motor rad]: a sum of w* less the way of the motor."""
    wanted, way = _followed(machine, axis, trace).mean(axis=1), trace.get(axis.name, "motor_position")
    return (np.concatenate([[0.0], np.cumsum(wanted[:-1]) * machine.position_cycle]) - (way - way[0])) / axis.ratio


def _speed_controller(machine: Machine, axis: Axis, inertia: float, trace: Trace) -> Law:
    """Command [A, V, Nm] of a speed controller that measures the speed."""
    loops, r, cycle = axis.loops, axis.ratio, machine.position_cycle
    error = (_followed(machine, axis, trace)[:, 0] - trace.get(axis.name, "velocity")) / r
    d = loops.feedforward_delay_s
    now, before, first = (_delayed(machine, axis, trace, d + back * cycle) for back in (0.0, 1.0, 2.0))
    forward = loops.torque_feedforward * inertia * (now - 2.0 * before + first) / cycle**2 / r
    integral = _speed_integral(machine, axis, trace) / loops.speed_integral_time_s
    torque = loops.speed_gain_nm_s_per_rad * (error + integral) + received_from_nc(forward, trace, axis, machine.speed_cycle)[:, 0]
    current = torque / axis.commissioned_torque_constant
    command, free = _command(axis, trace)
    return current - (current[0] if axis.has_speed_integral else 0.0), command, free


def _speed_controller_of_samples(machine: Machine, axis: Axis, trace: Trace) -> Law:
    """The same where the speed is differentiated or filtered: its samples about each instant, feedforward and integral."""
    rows = [*_about(_followed(machine, axis, trace)[:, 0]), *_samples(axis, trace, "velocity"), np.ones(len(trace.time))]
    rows += [trace.get(axis.name, "torque_feedforward"), _speed_integral(machine, axis, trace)]
    return np.column_stack(rows), *_command(axis, trace)


def _samples(axis: Axis, trace: Trace, signal: str) -> list[np.ndarray]:
    """TAPS columns: a signal from two samples before to two after each instant."""
    return _about(trace.get(axis.name, signal))


def _about(values: np.ndarray) -> list[np.ndarray]:
    padded = np.pad(values, TAPS // 2, mode="edge")
    return list(np.lib.stride_tricks.sliding_window_view(padded, TAPS).T)


def _rates(axis: Axis, trace: Trace, signal: str) -> np.ndarray:
    return np.gradient(trace.get(axis.name, signal), trace.period)


def _current_loop(machine: Machine, axis: Axis, trace: Trace) -> Law:
    columns = [np.ones(len(trace.time)), *_about(_followed(machine, axis, trace)[:, 0])]
    for signal in ("current_setpoint", "velocity"):  # i* between the samples follows from w* and w
        columns += _samples(axis, trace, signal)
    return np.column_stack(columns), trace.get(axis.name, "torque"), np.ones(len(trace.time), bool)


def _mechanics(axis: Axis, trace: Trace) -> Law:
    v, x = trace.get(axis.name, "velocity"), trace.get(axis.name, "position")
    rows = [np.sign(v), v, np.ones(len(v)), x, np.sin(x), np.cos(x)]
    for name in trace.axes:
        rows.append(np.gradient(trace.get(name, "velocity"), trace.period))
    sliding = np.abs(v) > SLIDING * axis.max_velocity
    return np.column_stack(rows), trace.get(axis.name, "torque"), sliding


def _transmission(axis: Axis, trace: Trace) -> Law:
    x = trace.get(axis.name, "position")
    angle = x / axis.ratio
    rows = [trace.get(axis.name, "torque"), _rates(axis, trace, "velocity"), trace.get(axis.name, "velocity")]
    rows += [x, np.sin(angle), np.cos(angle), np.ones(len(x))]
    return np.column_stack(rows), trace.get(axis.name, "motor_position") - x, np.ones(len(x), bool)
