"""The predicted error of a machine with changes: on the program, alone and together, with an interval from the diagnosis.

    before, after    RMS contour error of the true tool path [m]
    interval         the same with the sizes of the effects drawn from their intervals; changes stay as tuned

Trials run on the decoupled plant; numbers that are reported run in MuJoCo.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from twin.effects import Setting, settings_of, with_effects
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.remedy.change import Change
from twin.remedy.tool_error import DIVERGED, ToolError, tool_error
from twin.simulation.decoupled_plant import DecoupledPlant, Motion
from twin.simulation.mujoco_plant import MujocoPlant
from twin.simulation.nominal_motion import nominal_motion
from twin.simulation.run import SimulationJob, simulate_each
from twin.simulation.setpoints import Setpoints
from twin.system import cores

Found = TypeVar("Found")

DRAWS = 8
"""Machines drawn from the intervals of the diagnosis."""
NORMAL_95 = 1.96


@dataclass(frozen=True)
class Motionful:
    """A motion to judge: its name, set points, and the nominal motion for trials on the decoupled plant."""

    name: str
    setpoints: Setpoints
    motion: Motion


def motionful(name: str, setpoints: Setpoints, machine: Machine) -> Motionful:
    """A motion with the nominal motion of a machine along it."""
    return Motionful(name, setpoints, nominal_motion(with_effects(machine, []), setpoints))


def simulated(
    machines: Sequence[Machine], on: Motionful, of: Callable[[Trace, Machine], Found], engine: bool = False
) -> list[Found | TwinError]:
    """What `of` makes of the trace of each machine on a motion; the error where the simulation diverges."""
    plant = MujocoPlant if engine else (lambda change: DecoupledPlant(change, on.motion))
    jobs = [SimulationJob(machine, on.setpoints, plant) for machine in machines]
    with ThreadPoolExecutor(cores()) as pool:
        return simulate_each(jobs, pool.map, lambda i, run: of(run.trace, machines[i]))


def errors_of(machines: Sequence[Machine], on: Motionful) -> list[ToolError]:
    """The error of each machine on a motion, on the decoupled plant; an infinite one where the simulation diverges."""
    return [DIVERGED if isinstance(found, TwinError) else found for found in simulated(machines, on, tool_error)]


def decoupled(machines: Sequence[Machine], on: Motionful) -> list[Trace]:
    """The trace of each machine on a motion, on the decoupled plant. Raises TwinError where a simulation diverges."""
    traces = []
    for found in simulated(machines, on, lambda trace, _machine: trace):
        if isinstance(found, TwinError):
            raise found
        traces.append(found)
    return traces


def with_changes(machine: Machine, changes: Sequence[Change]) -> Machine:
    """The machine with all changes."""
    for change in changes:
        machine = change.applied(machine)
    return machine


def drawn(machine: Machine, deviations: Mapping[tuple[str, str, str | None], Mapping[str, float]]) -> list[Machine]:
    """Machines whose effects have sizes drawn from a normal distribution with these standard deviations, by effect and parameter."""
    random = np.random.default_rng(0)
    out = []
    for _ in range(DRAWS):
        moved = [_moved(s, deviations.get(s.key, {}), random) for s in settings_of(machine)]
        out.append(with_effects(machine, moved))
    return out


def _moved(setting: Setting, deviations: Mapping[str, float], random: np.random.Generator) -> Setting:
    values = dict(setting.parameters)
    for name, deviation in deviations.items():
        p = setting.effect.parameter(name)
        values[name] = float(np.clip(values[name] + deviation * random.standard_normal(), p.low, p.high))
    return replace(setting, parameters=values)
