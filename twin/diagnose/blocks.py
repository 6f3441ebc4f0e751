"""Residual of each block of an axis by itself, with its measured inputs. It shows which block is at fault.

    position controller   set point and position in, speed set point out (channel `controller`)
    speed controller      speed set point and speed in, current out: the compiled PI law run over the record
    mechanics             current in, motion out: force balance Kt i / r - M a - Fc sign v - D v - bias, below 40 Hz
    transmission          motor position against scale (channel `motor_minus_scale`), includes `measurement`

The score of a block is the mean square of its residual divided by that of the nominal twin with noise. It is about 1 if the block
works as the machine file says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import functools

import numpy as np
from scipy.ndimage import uniform_filter1d

from twin.compiled_functions import compiled
from twin.control.current_controller import current_controller, winding
from twin.control.speed_controller import speed_controller
from twin.control.speed_set_point_filters import RECORD_LAG
from twin.diagnose.force_balance import MOTION, force_beyond_model
from twin.diagnose.observe import Group
from twin.diagnose.settings import T
from twin.diagnose.simulations import Variant, simulate_group
from twin.diagnose.view import RunView
from twin.machine.machine import Axis
from twin.recordings.trace import Trace
from twin.simulation.cascade import drives_at_rest, drives_of
from twin.simulation.drive_setpoints import received_from_nc, speed_set_point
from twin.simulation.plant_spec import commissioned_inertia
from twin.simulation.position_command import command_of

CHANNEL_SHOWS = {"controller": "position controller", "motor_minus_scale": "transmission"}
"""Block whose law a channel compares. The other channels show the mechanics in closed loop."""
REGIMES = ("reversal", "acceleration", "constant speed", "rest")


@dataclass(frozen=True)
class BlockResidual:
    """Residual of one block of one axis in one run, its noise level, and the sample numbers `index` in the trace."""

    run: int
    axis: str
    block: str
    residual: np.ndarray
    sigma: float
    index: np.ndarray

    @property
    def normed(self) -> np.ndarray:
        return self.residual / self.sigma

    @property
    def excess(self) -> float:
        """Sum of squares above noise."""
        return max(float(np.sum(self.normed**2)) - len(self.residual), 0.0)


def block_residuals(group: Group, machine_of: Variant) -> list[BlockResidual]:
    """Residuals of all blocks of a group in all runs, as far as the recorded signals allow; `machine_of` re-tunes the mechanics."""
    found = []
    for channel in group.channels:
        if channel.name in CHANNEL_SHOWS:
            index = np.flatnonzero(group.views[channel.run].rows_of(channel.axis, channel.name))
            # noise, and a healthy twin's model error
            level = float(np.hypot(np.median(channel.sigma), np.sqrt(np.mean(np.square(channel.model)))))
            found.append(BlockResidual(channel.run, channel.axis, CHANNEL_SHOWS[channel.name], channel.residual, level, index))
    for parts in group.mapper(functools.partial(_laws_of_run, group, machine_of), range(len(group.views))):
        found += parts
    return found


def _laws_of_run(group: Group, machine_of: Variant, r: int) -> list[BlockResidual]:
    """Residuals of speed controller and mechanics for all axes of a group that move in a run."""
    view, found = group.views[r], []
    moving = [a for a in group.axes if view.trace.moves(a)]
    if not moving:
        return []
    view = replace(view, machine=machine_of(view.machine))
    noisy = simulate_group(view, moving, noise_seed=77 + r).trace
    for name in moving:
        axis = view.machine.axis(name)
        if not view.trace.has(name, axis.effort) or not any(view.trace.has(name, s) for s in MOTION):
            continue
        for block, law in (("speed controller", current_beyond_law), ("mechanics", force_beyond_model)):
            parts = [(values[where], where) for trace in (view.trace, noisy) for values, where in [law(view, axis, trace) or NOTHING]]
            (measured, where), (expected, _) = parts
            if len(measured) > T.enough_samples:
                found.append(BlockResidual(r, name, block, measured, max(float(np.std(expected)), 1e-12), np.flatnonzero(where)))
    return found


NOTHING = np.zeros(0), np.zeros(0, bool)
"""Values and places of a law whose signals are not recorded."""


def current_beyond_law(view: RunView, axis: Axis, trace: Trace) -> tuple[np.ndarray, np.ndarray] | None:
    """`current_error` (sample,), and where the axis moves; None if the record does not show the speed controller."""
    return (current_error(view, axis, trace), view.reference(axis.name)[2]) if shows_speed_controller(view, axis) else None


def shows_speed_controller(view: RunView, axis: Axis) -> bool:
    """Are the inputs and the output of the speed controller recorded at each position cycle?"""
    recorded = all(view.trace.has(axis.name, s) for s in ("velocity", "velocity_setpoint", axis.effort))
    return view.on_each_cycle and recorded and all(listed.block != RECORD_LAG for listed in axis.blocks)


def current_error(view: RunView, axis: Axis, trace: Trace) -> np.ndarray:
    """Recorded current minus the current that the controller would command for the recorded speeds (sample,) [A], without slow drift: the
    integrator accumulates the speed error between the samples.
    """
    error = trace.get(axis.name, axis.effort) - commanded_current(view, axis, trace)
    return error - moving_mean(error, round(T.settled_s / view.trace.period))


def commanded_current(view: RunView, axis: Axis, trace: Trace, limited: bool = True) -> np.ndarray:
    """The current (sample,) that the controller would command for the recorded speeds [A]; `limited` applies the limits of drive and motor."""
    machine = view.machine.with_axes([axis.name])
    a = view.machine.axis_names.index(axis.name)
    ticks = max(1, round(trace.period / machine.base_tick))
    count = len(trace.time)
    setpoints = view.setpoints.part((a,))
    every = view.samples_per_cycle
    command = command_of(machine, commissioned_inertia(machine), setpoints, 0, -(-count // every))
    drives = drives_of(machine)
    if not limited:
        drives.peak_current = drives.bus_limit = np.inf
    current = trace.get(axis.name, axis.effort)
    state = drives_at_rest(drives, np.array([float(np.median(current[:20])) * drives.torque_constant[0]]))
    predicted = np.empty(count)
    _run_speed_loop(
        drives,
        state,
        speed_set_point(trace, axis, machine.speed_cycle) / axis.ratio,
        received_from_nc(np.repeat(command.torque_feedforward[:, 0], every)[:count], trace, axis, machine.speed_cycle),
        trace.get(axis.name, "velocity") / axis.ratio,
        (ticks, round(machine.speed_cycle / machine.base_tick), round(machine.current_cycle / machine.base_tick)),
        predicted,
    )
    return predicted


@compiled
def _run_speed_loop(drives, state, setpoint, feedforward, speed, ticks_of, out):  # type: ignore[no-untyped-def]
    """Speed and current controller of one axis over recorded inputs; the speed is interpolated between samples.

    `setpoint`, `feedforward` (sample, speed cycle), or (sample, 1) if constant over a sample. `ticks_of`: ticks per sample, per speed cycle,
    per current cycle. `out` (sample,) receives the current.
    """
    ticks, speed_ticks, current_ticks = ticks_of
    for k in range(len(speed)):
        out[k] = state.current[0]
        following = speed[min(k + 1, len(speed) - 1)]
        for n in range(ticks):
            w = speed[k] + (following - speed[k]) * n / ticks
            tick = k * ticks + n
            if tick % speed_ticks == 0:
                cycle = min(n // speed_ticks, setpoint.shape[1] - 1)
                state.speed_setpoint[0] = setpoint[k, cycle]
                state.torque_feedforward[0] = feedforward[k, cycle]
                speed_controller(0, drives, state, w)
            if tick % current_ticks == 0:
                current_controller(0, drives, state, state.current_setpoint[0], state.current[0])
            if n == 0 and not drives.current_loop[0]:
                out[k] = state.current[0]  # a command is recorded at its own tick
            winding(0, drives, state, w)


def regime_masks(view: RunView, name: str) -> dict[str, np.ndarray]:
    """Masks (sample,) of reversal, acceleration, constant speed and rest of an axis, from its set point."""
    period = view.trace.period
    s = view.trace.get(name, "setpoint")
    window = max(5, round(0.01 / period) | 1)
    v = moving_mean(np.gradient(s, period), window)
    a = moving_mean(np.gradient(v, period), window)
    axis = view.machine.axis(name)
    moving = view.reference(name)[2]
    turned = np.zeros(len(s), bool)
    signs = np.sign(v) * moving
    nonzero = np.flatnonzero(signs)
    turns = nonzero[1:][np.diff(signs[nonzero]) != 0]
    starts = np.flatnonzero(np.diff(moving.astype(int)) == 1)
    for i in [*turns, *starts]:
        turned[max(i - round(0.01 / period), 0) : i + round(T.break_away_s / period)] = True
    accelerating = np.abs(a) > T.accelerating * axis.max_acceleration
    return {
        "reversal": turned,
        "acceleration": ~turned & moving & accelerating,
        "constant speed": ~turned & moving & ~accelerating,
        "rest": ~turned & ~moving,
    }


def scaling(view: RunView, name: str, index: np.ndarray, others: Sequence[str]) -> dict[str, np.ndarray]:
    """Regressors for a residual, by name, at the samples `index`."""
    a = view.machine.axis_names.index(name)
    axis = view.machine.axis(name)
    q, v, acceleration = (m[index, a] for m in (view.motion.position, view.motion.speed, view.motion.acceleration))
    t = view.trace.time[index]
    angle = q / axis.ratio
    regressors = {
        "1": np.ones(len(index)),
        "sign v": np.sign(v),
        "v": v,
        "|v|": np.abs(v),
        "v^2": v * np.abs(v),
        "a": acceleration,
        "position": q - q.mean(),
        "time": t - t.mean(),
    }
    if axis.drive != "direct":
        regressors |= {"motor turn (sin)": np.sin(angle), "motor turn (cos)": np.cos(angle)}
    if view.trace.has(name, axis.effort):
        regressors["current"] = view.trace.get(name, axis.effort)[index]
    for other in others:
        if other != name and view.moves(other):
            regressors[f"a of {other}"] = view.motion.acceleration[index, view.machine.axis_names.index(other)]
    return regressors


def moving_mean(values: np.ndarray, window: int) -> np.ndarray:
    """Centred moving mean over `window` samples (sample, ...)."""
    return np.asarray(uniform_filter1d(values, window | 1, axis=0, mode="nearest"))
