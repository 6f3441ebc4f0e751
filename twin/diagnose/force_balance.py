"""Force balance of an axis: drive force against inertia, friction and bias along the recorded motion."""

import numpy as np
import scipy
from scipy.ndimage import minimum_filter1d

from twin.diagnose.settings import T
from twin.diagnose.view import RunView
from twin.effects import apply_effects, with_effects
from twin.machine.machine import Axis
from twin.recordings.trace import Trace
from twin.simulation.decoupled_plant import loads_along

MOTION = ("velocity", "motor_position", "position")
"""Signals of the motion of an axis, in order of preference; one of them is sufficient."""


def force_beyond_model(view: RunView, axis: Axis, trace: Trace) -> tuple[np.ndarray, np.ndarray] | None:
    """Force on the load beyond the model, towards +q (sample,), and where the axis slides."""
    driven = force_and_acceleration(view, axis, trace)
    if driven is None:
        return None
    window = smoothing_window(view)
    drive, acceleration = driven
    v = scipy.signal.savgol_filter(speed_of(view, trace, axis), window, 2)
    inertia, bias = inertia_and_bias(view, axis, len(trace.time))
    friction = axis.coulomb_friction * np.sign(v) + axis.viscous_friction * v
    least = T.sliding * axis.max_velocity + 3.0 * view.machine.noise(axis).speed
    sliding = minimum_filter1d(np.abs(v), 2 * window) > least
    return inertia * acceleration + friction + bias - drive, sliding


def force_and_acceleration(view: RunView, axis: Axis, trace: Trace) -> tuple[np.ndarray, np.ndarray] | None:
    """Motor force at the axis and acceleration (sample,) with equal smoothing; None without current or for a run that is too short."""
    window = smoothing_window(view)
    if not view.trace.has(axis.name, axis.effort) or len(trace.time) < 2 * window:
        return None
    acceleration = scipy.signal.savgol_filter(speed_of(view, trace, axis), window, 2, deriv=1, delta=trace.period)
    effort = scipy.signal.savgol_filter(trace.get(axis.name, axis.effort), window, 2)
    return effort * axis.motor.torque_constant_nm_per_a / axis.ratio, acceleration


def speed_of(view: RunView, trace: Trace, axis: Axis) -> np.ndarray:
    """Speed of an axis in a trace (sample,), from the same signal in the recorded trace of a run and in a simulated one, which has all signals."""
    signal = next(s for s in MOTION if view.trace.has(axis.name, s))
    if signal == "velocity":
        return trace.get(axis.name, "velocity")
    speed: np.ndarray = np.gradient(trace.get(axis.name, signal), trace.period)
    return speed


def smoothing_window(view: RunView) -> int:
    return max(7, round(T.smooth_s / view.trace.period) | 1)


def inertia_and_bias(view: RunView, axis: Axis, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Inertia including the rotor, and bias force, of an axis along the nominal motion (sample,)."""
    group = [x.name for x in view.machine.axes if x.kind == "rotary"] if axis.kind == "rotary" else [axis.name]
    index = [view.machine.axis_names.index(name) for name in group]
    # springs have no mass: effects do not change inertia and bias
    change = apply_effects(with_effects(view.machine.with_axes(group), []))
    loads = loads_along(change, view.motion.part(tuple(index)))
    column = group.index(axis.name)
    rows = np.minimum(np.arange(count) * view.trace.period / view.machine.base_tick / loads.row_ticks, len(loads.inertia) - 1)
    grid = np.arange(len(loads.inertia))
    return (
        np.interp(rows, grid, loads.inertia[:, column]) + axis.reflected_inertia,
        np.interp(rows, grid, loads.bias[:, column]) - change.constant_force[column],
    )
