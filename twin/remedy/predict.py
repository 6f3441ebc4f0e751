"""The motions that judge a remedy, and the predicted error of a machine with changes on them: alone and together, with an interval from the diagnosis.

    before, after    RMS contour error of the true tool path [m]
    interval         the same with the sizes of the effects drawn from their intervals; changes stay as tuned

Trials run on the decoupled plant; numbers that are reported run in MuJoCo.

The error on the part is the distance of the true tool path from the path of the set points, level 2. A common delay of all axes does not mark a
part; the contour error leaves it out. Positions are those of the loads, also where no encoder measures them. A machine without a tool and a part
frame is judged by the path of its linear axes, one with a single axis by its error without the control's delay.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import TypeVar

import numpy as np

from twin.diagnose.tool_point import LOAD
from twin.effects import Setting, settings_of, with_effects
from twin.errors import InputError, TwinError
from twin.geometry.tool_path import contour_of, search_window
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.remedy.change import Change
from twin.simulation.decoupled_plant import DecoupledPlant, Motion
from twin.simulation.errors_of_run import axis_errors, contour_error_of, error_without_delay
from twin.simulation.mujoco_plant import MujocoPlant
from twin.simulation.nominal_motion import nominal_motion
from twin.simulation.run import SimulationJob, all_or_raise, simulate_on_all_cores
from twin.simulation.setpoints import Setpoints, check_travel, setpoints_of

Found = TypeVar("Found")

DRAWS = 8
"""Machines drawn from the intervals of the diagnosis."""
CIRCLES = ((0.05, 3.0), (0.05, 1.0), (0.025, 6.0))
"""Radius [m] and feed [m/min] of the standard circles; the first one is judged if no program is given."""
TURNS = 2.25
RAMP_S = 0.3
SHARE = 0.4
"""Largest share of the travel for the radius of a circle, and of the largest speed and acceleration for its motion."""


@dataclass(frozen=True)
class ToolError:
    """Contour error (sample,) [m]; by axis the quadrant peak, the largest error after a reversal [m or rad] (0 without a reversal), and the largest share of its peak current."""

    contour: np.ndarray
    peaks: dict[str, float]
    shares: dict[str, float]

    @property
    def rms(self) -> float:
        """RMS contour error [m]."""
        return float(np.sqrt(np.mean(self.contour**2)))

    @property
    def largest(self) -> float:
        """Largest contour error [m]."""
        return float(self.contour.max())


DIVERGED = ToolError(np.array([np.inf]), {}, {})
"""The error of a machine whose simulation diverges."""


def tool_error(trace: Trace, machine: Machine) -> ToolError:
    """The error of a simulated run, whose trace holds `load_position`."""
    try:
        contour = contour_error_of(trace, machine, LOAD).error
    except TwinError:
        linear = [a.name for a in machine.axes if a.kind == "linear" and trace.has(a.name, LOAD)]
        contour = _of_axes(trace, machine, linear or [a.name for a in machine.axes if trace.has(a.name, LOAD)])
    return ToolError(
        contour,
        {a.name: axis_errors(trace, a, LOAD).reversal_peak or 0.0 for a in machine.axes if trace.has(a.name, LOAD)},
        {a.name: _share(trace, machine, a) for a in machine.axes if trace.has(a.name, "current") and a.motor.peak_current_a > 0.0},
    )


def _share(trace: Trace, machine: Machine, axis: Axis) -> float:
    """Largest current with three standard deviations of what the speed controller makes of the noise of the speed, over the peak current."""
    noise = axis.loops.speed_gain_nm_s_per_rad * machine.noise(axis).speed / axis.ratio / axis.motor.torque_constant_nm_per_a
    return (float(np.abs(trace.get(axis.name, "current")).max()) + 3.0 * noise) / axis.motor.peak_current_a


def _of_axes(trace: Trace, machine: Machine, names: list[str]) -> np.ndarray:
    if len(names) == 1:
        axis = machine.axis(names[0])
        return np.abs(error_without_delay(trace, axis, LOAD))
    followed, commanded = (np.column_stack([trace.get(n, s) for n in names]) for s in (LOAD, "setpoint"))
    return contour_of(trace.time, followed, trace.time, commanded, search_window(machine)).error


@dataclass(frozen=True)
class Motionful:
    """A motion to judge: its name, set points, and the nominal motion for trials on the decoupled plant."""

    name: str
    setpoints: Setpoints
    motion: Motion


def motionful(name: str, setpoints: Setpoints, machine: Machine) -> Motionful:
    """A motion with the nominal motion of a machine along it."""
    return Motionful(name, setpoints, nominal_motion(with_effects(machine, []), setpoints))


def given_motion(name: str, trace: Trace, machine: Machine) -> Motionful:
    """The set points of a trace."""
    setpoints = setpoints_of(trace, machine)
    check_travel(setpoints, machine, name)
    return motionful(name, setpoints, machine)


def slowed(motion: Motionful, machine: Machine, override: float) -> Motionful:
    """A motion at a share of its feed: speeds times `override`, accelerations its square, jerk its cube."""
    points = motion.setpoints
    times = np.arange(0.0, points.duration / override, points.period) * override
    return motionful(f"{motion.name} at {override:.0%} of its feed", Setpoints(points.at(times), points.period), machine)


def standard_motions(machine: Machine) -> list[Motionful]:
    """Circles of the first two axes of a kind; of a machine with one axis, the sines that it would make on them."""
    kinds = [[a for a in machine.axes if a.kind == kind] for kind in ("linear", "rotary")]
    axes = next((own[:2] for own in kinds if len(own) > 1), next((own for own in kinds if own), []))
    if not axes:
        raise InputError(f"machine {machine.name}: has no axis; describe one in the machine file")
    return [_circle(machine, axes, radius, feed / 60.0) for radius, feed in CIRCLES]


def _circle(machine: Machine, axes: list[Axis], radius: float, feed: float) -> Motionful:
    if axes[0].kind == "rotary":  # 0.05 m stand for 5 degrees
        radius, feed = radius * math.radians(100.0), feed * math.radians(100.0)
    reach = min((0.5 * (a.travel[1] - a.travel[0]) for a in axes), default=math.inf)
    radius = min(radius, SHARE * reach)
    feed = min(feed, SHARE * min(a.max_velocity for a in axes), math.sqrt(SHARE * min(a.max_acceleration for a in axes) * radius))
    period, rate = machine.sample_period, feed / radius
    time = np.arange(0.0, TURNS * 2.0 * math.pi / rate + RAMP_S, period)
    phase = rate * period * np.cumsum(0.5 - 0.5 * np.cos(np.pi * np.minimum(time / RAMP_S, 1.0)))
    waves = dict(zip((axis.name for axis in axes), (np.cos(phase) - 1.0, np.sin(phase))))
    position = np.zeros((len(time), len(machine.axes)))
    for a, axis in enumerate(machine.axes):
        low, high = axis.travel
        middle = 0.5 * (low + high) if math.isfinite(low) and math.isfinite(high) else 0.0
        if axis.name in waves:
            position[:, a] = middle + radius * waves[axis.name]
        elif not low <= 0.0 <= high:
            position[:, a] = middle
    unit, factor = ("mm", 1e3) if axes[0].kind == "linear" else ("deg", 180.0 / math.pi)
    name = f"circle {'/'.join(a.name for a in axes)}, radius {radius * factor:.3g} {unit}, {feed * factor * 60:.4g} {unit}/min"
    return motionful(name, Setpoints(position, period), machine)


def simulated(
    machines: Sequence[Machine], on: Motionful, of: Callable[[Trace, Machine], Found], engine: bool = False
) -> list[Found | TwinError]:
    """What `of` makes of the trace of each machine on a motion; the error where the simulation diverges."""
    plant = MujocoPlant if engine else (lambda change: DecoupledPlant(change, on.motion))
    jobs = [SimulationJob(machine, on.setpoints, plant) for machine in machines]
    return simulate_on_all_cores(jobs, lambda i, run: of(run.trace, machines[i]))


def errors_of(machines: Sequence[Machine], on: Motionful) -> list[ToolError]:
    """The error of each machine on a motion, on the decoupled plant; an infinite one where the simulation diverges."""
    return [DIVERGED if isinstance(found, TwinError) else found for found in simulated(machines, on, tool_error)]


def decoupled(machines: Sequence[Machine], on: Motionful) -> list[Trace]:
    """The trace of each machine on a motion, on the decoupled plant. Raises TwinError where a simulation diverges."""
    return all_or_raise(simulated(machines, on, lambda trace, _machine: trace))


def with_changes(machine: Machine, changes: Sequence[Change]) -> Machine:
    """The machine with all changes."""
    for change in changes:
        machine = change.applied(machine)
    return machine


def drawn(machine: Machine, deviations: Mapping[tuple[str, str, str | None], Mapping[str, float]]) -> list[Machine]:
    """Machines whose effects have sizes drawn from a normal distribution with these standard deviations, by effect and parameter."""
    random = np.random.default_rng(0)
    return [with_effects(machine, [_moved(s, deviations.get(s.key, {}), random) for s in settings_of(machine)]) for _ in range(DRAWS)]


def _moved(setting: Setting, deviations: Mapping[str, float], random: np.random.Generator) -> Setting:
    values = dict(setting.parameters)
    for name, deviation in deviations.items():
        p = setting.effect.parameter(name)
        values[name] = float(np.clip(values[name] + deviation * random.standard_normal(), p.low, p.high))
    return replace(setting, parameters=values)
