"""Finds the first block of an axis whose behaviour changed. The loop is cut: each block gets its own recorded inputs, in both traces.

    set points           the set point itself
    position controller  w* = Kv (s(t - d) - x) + a_v ds/dt            law from the machine file, at the position cycles;
                         for a position loop in the drive also the drive's set point, from w*, x and their values Td ago
    speed controller     i* = (Kp e + Kp/Tn int e + J a_t d2s/dt2) / Kt    law from the machine file, with the integral of the speed from the
                         motor encoder, until i* reaches its limit (the integral stops there); regressed if the speed is not measured
    current loop         torque        regressed on w*, i* and speed, TAPS samples around each instant
    mechanics            torque        regressed on a of all axes, sign v, v, position
    transmission         motor position - scale      regressed on torque, a, position, motor angle

The residual of each law is computed in the golden and in the new trace. If the block is unchanged, both residuals agree for any
inputs; otherwise their difference comes from the block itself. The block's share is the RMS difference of the residuals over the RMS
difference of the outputs. Coefficients of a regressed law that the golden trace does not determine may change. A changed block also
changes the inputs of the others, but not their laws; the first block of the chain with a large share is named.
`twin.diagnose.blocks` does the same with noisy measured traces; the twin's own traces have more signals and no noise, so that changes of
a millionth are visible.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import functools

import numpy as np
from scipy.interpolate import CubicSpline

from twin.control.position_controller import feedforward_at, position_law, torque_feedforward_at
from twin.control.speed_controller import law_weights, sees_motor_speed
from twin.effects import apply_effects
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.regress.compare import Check, common
from twin.simulation.drive_setpoints import changes_position_law, closed_on, received_from_nc, speed_set_point, with_blocks
from twin.simulation.plant_spec import commissioned_inertia
from twin.simulation.position_command import received

Law = tuple[np.ndarray, np.ndarray, np.ndarray]
"""The output of a law from the machine file (sample,) or the rows of a regressed law (sample, column); the recorded output (sample,);
the samples where the law holds (sample,)."""

SHARE = 0.35
"""Least share of the change of its output that a named block must have caused. The smallest share of a changed block is 0.37 (gain of the
current loop); the largest shares of the current loop before a changed block are 0.24 (friction) and 0.41 (measuring system)."""
SEEN = 1e-4
"""Below this relative singular value the inputs do not determine a regressed law."""
TAPS = 5
"""Samples of set points and speed that determine the current loop's torque; it settles within one or two."""
AT_LIMIT = 0.998
"""Above this share of the peak current a current set point counts as limited."""
FOLLOWED = "drive_velocity_setpoint"
"""Speed set point inside a drive that closes the position loop itself."""
SLIDING = 1e-3
"""The friction law is compared above this share of the highest speed."""


@dataclass(frozen=True)
class Place:
    """Place of a deviation: axis, time, block ('': unknown), and the share of each block in the change of its output."""

    axis: str
    since_s: float | None
    block: str
    shares: Mapping[str, float] = field(default_factory=dict)


def place_of(machine: Machine | None, golden: Trace | None, now: Trace | None, checks: Sequence[Check]) -> Place:
    """Axis with the largest difference over tolerance, its first changed block, and the time of the first excess.

    Without traces, axis and block of the number with the largest difference.
    """
    failed = [c for c in checks if not c.ok]
    if machine is None or golden is None or now is None:
        worst = max(failed, key=lambda c: c.excess)
        return Place(worst.axis, None, worst.block)
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
    """(block, share) of one axis in the order of the chain; both traces have the same samples."""
    actual = apply_effects(machine).machine
    inertia = float(commissioned_inertia(machine)[machine.axis_names.index(axis.name)])
    axis, cycle = actual.axis(axis.name), actual.position_cycle
    on_cycles = abs(golden.period / cycle - round(golden.period / cycle)) < 1e-6
    each_cycle = abs(golden.period - cycle) < 1e-9
    blocks: list[tuple[str, Callable[[Trace], Law]]] = []
    if on_cycles and (each_cycle or not changes_position_law(axis)):
        blocks.append(("position controller", lambda trace: _position_controller(actual, axis, trace)))
    if each_cycle:  # coarser samples do not separate the faster loops
        if sees_motor_speed(axis.loops):
            blocks.append(("speed controller", lambda trace: _speed_controller(actual, axis, inertia, trace)))
        else:
            blocks.append(("speed controller", lambda trace: _speed_controller_of_samples(actual, axis, trace)))
        if axis.command != axis.effort:
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
    """Residual of the law that best explains the change of the output, combined with its residual on the golden trace.

    Coefficients that the golden trace does not determine (proportional inputs) are free; it constrains the others.
    """
    law, *_ = np.linalg.lstsq(rows, output, rcond=SEEN)
    change = new_output - output - (new_rows - rows) @ law
    wanted = np.concatenate([change, np.zeros(len(rows))])
    both = np.vstack([new_rows - rows, rows])
    other, *_ = np.linalg.lstsq(both, wanted, rcond=SEEN)
    left = wanted - both @ other
    return np.hypot(left[: len(rows)], left[len(rows) :])


def _share(own: np.ndarray, output: np.ndarray) -> float:
    """RMS of a block's own change over the RMS change of its output; 0 if nothing changed."""
    changed = float(np.sqrt(np.mean(output**2))) if output.size else 0.0
    return float(np.sqrt(np.mean(own**2))) / changed if changed > 1e-12 else 0.0


def _scaled(rows: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Rows divided by the RMS of the reference's columns; columns that are zero there become zero."""
    size = np.sqrt(np.mean(reference**2, axis=0))
    return np.where(size > 1e-12, rows / np.maximum(size, 1e-12), 0.0)


def _delayed(machine: Machine, axis: Axis, trace: Trace, delay: float) -> np.ndarray:
    """Set point at each sample (sample,) that the control uses after a delay [s]."""
    curve = CubicSpline(trace.time, trace.get(axis.name, "setpoint"))
    return received(machine, axis, lambda ago: curve(np.clip(trace.time - ago, trace.time[0], trace.time[-1])), delay)


def _position_controller(machine: Machine, axis: Axis, trace: Trace) -> Law:
    """Speed set point [axis units/s] of the position controller at the stored position cycles, followed by that inside the drive, if any."""
    loops, cycle, output = axis.loops, machine.position_cycle, trace.get(axis.name, "velocity_setpoint")

    @functools.cache
    def setpoint(delay: float) -> np.ndarray:
        return _delayed(machine, axis, trace, delay)

    delayed, gain = setpoint(loops.position_delay_s), loops.position_gain_per_s
    error = delayed - trace.get(axis.name, closed_on(trace, axis))
    fed = feedforward_at(setpoint, loops.feedforward_delay_s, cycle)
    wanted = position_law(gain, loops.velocity_feedforward, error, fed)
    wanted = with_blocks(axis, gain, machine, delayed, setpoint(loops.feedforward_delay_s), error, wanted)
    if trace.has(axis.name, FOLLOWED) and trace.period < cycle * (1.0 + 1e-6):
        wanted = np.concatenate([wanted, speed_set_point(trace, axis, machine.speed_cycle)[:, 0]])
        output = np.concatenate([output, trace.get(axis.name, FOLLOWED)])
    return wanted, output, np.ones(len(output), bool)


def _followed(machine: Machine, axis: Axis, trace: Trace) -> np.ndarray:
    """Speed set point inside the drive (sample, speed cycle): recorded at each sample, from the drive's law between samples."""
    made = speed_set_point(trace, axis, machine.speed_cycle)
    return made + (trace.get(axis.name, FOLLOWED)[:, None] - made[:, :1]) if trace.has(axis.name, FOLLOWED) else made


def _command(axis: Axis, trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """Command of the speed controller [A, V, Nm] beyond its start, and the samples before it reaches its limit."""
    command = trace.get(axis.name, axis.command)
    limited = np.maximum.accumulate(np.abs(command) >= AT_LIMIT * axis.motor.peak_current_a)
    return axis.loops.beyond_start(command), ~limited


def _speed_integral(machine: Machine, axis: Axis, trace: Trace) -> np.ndarray:
    """Integral of the speed error [motor rad]: sum of w* minus the travel of the motor."""
    wanted, way = _followed(machine, axis, trace).mean(axis=1), trace.get(axis.name, "motor_position")
    return (np.concatenate([[0.0], np.cumsum(wanted[:-1]) * machine.position_cycle]) - (way - way[0])) / axis.ratio


def _speed_controller(machine: Machine, axis: Axis, inertia: float, trace: Trace) -> Law:
    """Law of a speed controller that measures the speed [A, V, Nm]."""
    loops, r, cycle = axis.loops, axis.ratio, machine.position_cycle
    error = (_followed(machine, axis, trace)[:, 0] - trace.get(axis.name, "velocity")) / r
    gain, rate, weight = law_weights(loops)
    forward = weight * torque_feedforward_at(
        functools.partial(_delayed, machine, axis, trace), loops.feedforward_delay_s, cycle, inertia, r
    )
    fed = received_from_nc(forward, trace, axis, machine.speed_cycle)[:, 0]
    torque = gain * error + rate * _speed_integral(machine, axis, trace) + fed
    current = torque / axis.commissioned_torque_constant
    command, free = _command(axis, trace)
    return axis.loops.beyond_start(current), command, free


def _speed_controller_of_samples(machine: Machine, axis: Axis, trace: Trace) -> Law:
    """Regressed law for a differentiated or filtered speed: samples around each instant, feedforward and integral."""
    rows = [*_about(_followed(machine, axis, trace)[:, 0]), *_about(trace.get(axis.name, "velocity")), np.ones(len(trace.time))]
    rows += [trace.get(axis.name, "torque_feedforward"), _speed_integral(machine, axis, trace)]
    return np.column_stack(rows), *_command(axis, trace)


def _about(values: np.ndarray) -> list[np.ndarray]:
    """TAPS columns: a signal from two samples before to two samples after each instant."""
    padded = np.pad(values, TAPS // 2, mode="edge")
    return list(np.lib.stride_tricks.sliding_window_view(padded, TAPS).T)


def _current_loop(machine: Machine, axis: Axis, trace: Trace) -> Law:
    columns = [np.ones(len(trace.time)), *_about(_followed(machine, axis, trace)[:, 0])]
    for signal in ("current_setpoint", "velocity"):  # i* between samples depends on w* and w
        columns += _about(trace.get(axis.name, signal))
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
    rows = [trace.get(axis.name, "torque"), np.gradient(trace.get(axis.name, "velocity"), trace.period), trace.get(axis.name, "velocity")]
    rows += [x, np.sin(angle), np.cos(angle), np.ones(len(x))]
    return np.column_stack(rows), trace.get(axis.name, "motor_position") - x, np.ones(len(x), bool)
