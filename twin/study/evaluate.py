"""One variant: simulate its runs and answer. Nothing here knows of other variants, threads or clusters.

following error    set point minus position at the same time
contour error      distance of the followed from the commanded tool path
settling time      from the last change of the set point until the error stays inside SETTLED
copper loss        R i_rms^2 of the one-phase equivalent of the motor
first mode         sqrt(stiffness / load) / 2 pi of the axis' transmission; none where it is rigid
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import functools
import hashlib
import math
from pathlib import Path
import tempfile
from typing import Any

import numpy as np

from twin.effects import settings_of
from twin.effects.change import load_inertia
from twin.errors import TwinError
from twin.machine import Machine, machine_from_document
from twin.run import Run, simulate
from twin.setpoints import Setpoints, check_travel, setpoints_of
from twin.summary import summary_of
from twin.trace import Trace

SETTLED = {"linear": 1e-6, "rotary": math.radians(1.0 / 3600.0)}
"""Error inside which an axis counts as settled [m, rad]."""


@dataclass(frozen=True)
class PackedMachine:
    """A machine as data, for a worker that does not share this machine's files."""

    document: Mapping[str, Any]
    model_name: str
    model: str

    def unpack(self) -> Machine:
        """The machine; its MJCF is kept in a folder of this process."""
        folder = _folder(hashlib.sha256(self.model.encode()).hexdigest())
        path = Path(folder.name) / self.model_name
        if not path.is_file():
            path.write_text(self.model, encoding="utf-8")
        return machine_from_document(self.document, path, None, "study")


@functools.cache
def _folder(_digest: str) -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="twin-study-")


@dataclass(frozen=True)
class Task:
    """What one variant runs: its machine, and per run set points (or the program's text, where its limits vary) and feedforward."""

    machine: Machine | PackedMachine
    runs: tuple[tuple[str, Setpoints | str, str, str | None], ...]  # name, set points or program, ending of the program, feedforward
    part: str | None = None

    def packed(self) -> Task:
        """The task without paths of this machine."""
        machine = self.machine
        if isinstance(machine, PackedMachine):
            return self
        model = machine.model_path.read_text(encoding="utf-8")
        return replace(self, machine=PackedMachine(dict(machine.document), machine.model_path.name, model))


def evaluate(task: Task) -> dict[str, Any]:
    """Responses by name, or {"reason": why not}: a variant that diverges or is impossible is a result, not the end of the study."""
    try:
        return _responses(task)
    except TwinError as error:
        return {"reason": " ".join(str(error).split())}


def _responses(task: Task) -> dict[str, Any]:
    machine = task.machine.unpack() if isinstance(task.machine, PackedMachine) else task.machine
    results: dict[str, list[float]] = {}

    def add(name: str, value: float) -> None:
        results.setdefault(name, []).append(float(value))

    for name, source, ending, feedforward in task.runs:
        setpoints = source if isinstance(source, Setpoints) else _interpolated(source, ending, machine)
        check_travel(setpoints, machine, f"run {name}")
        run = simulate(machine.with_feedforward(feedforward), setpoints)
        add("cycle_time_s", setpoints.duration)
        _axis_responses(machine, run, add)
        _contour(machine, run.trace, add)
        if task.part:
            add("mark_depth_um", _mark_depth(machine, run.trace, task.part))
    for setting in settings_of(machine):
        if setting.effect.name == "transmission_compliance":
            axis = machine.axis(setting.axis)
            add(f"first_mode_{axis.name}_hz", math.sqrt(setting.parameters["stiffness"] / load_inertia(machine, axis)) / (2.0 * math.pi))
    return {name: _joined(name, values) for name, values in results.items()}


def _joined(name: str, values: list[float]) -> float:
    """One number for all runs: sums of times, root mean square of RMS values and losses, else the largest."""
    if name == "cycle_time_s":
        return float(np.sum(values))
    if "_rms" in name:
        return float(np.sqrt(np.mean(np.square(values))))
    if name.startswith("copper"):
        return float(np.mean(values))
    return float(np.max(values))


def _axis_responses(machine: Machine, run: Run, add: Any) -> None:
    summary = summary_of(machine, run)["axes"]
    for axis in machine.axes:
        a = summary[axis.name]
        setpoint = run.trace.get(axis.name, "setpoint")
        if np.ptp(setpoint) < 1e-9:
            continue
        unit = "um" if axis.kind == "linear" else "arcsec"
        add(f"following_error_max_{axis.name}_{unit}", a["following_error_max"])
        add(f"following_error_rms_{axis.name}_{unit}", a["following_error_rms"])
        effort, unit = axis.effort, axis.effort_unit.lower()
        largest, rms, limit = (a[f"{effort}_{what}_{unit}"] for what in ("max", "rms", "limit"))
        add(f"{effort}_max_{axis.name}_{unit}", largest)
        add(f"{effort}_rms_{axis.name}_{unit}", rms)
        add(f"{effort}_limit_used_{axis.name}", largest / limit)
        add(f"speed_limit_used_{axis.name}", a["speed_limit_used"])
        if axis.has_current_loop:
            add(f"copper_loss_{axis.name}_w", axis.motor.resistance_ohm * rms**2)
        error = np.abs(setpoint - run.trace.get(axis.name, "position"))
        last = int(np.flatnonzero(np.abs(np.diff(setpoint)) > 1e-12)[-1]) + 1
        outside = np.flatnonzero(error[last:] > SETTLED[axis.kind])
        if not len(outside):
            add(f"settling_time_{axis.name}_ms", 0.0)
        elif outside[-1] < len(error) - last - 1:
            add(f"settling_time_{axis.name}_ms", (outside[-1] + 1) * run.trace.period * 1e3)


def _contour(machine: Machine, trace: Trace, add: Any) -> None:
    from twin.kinematics import kinematics_of
    from twin.toolpath import contour_error, search_window, tool_path_of

    try:
        kinematics = kinematics_of(machine)
        followed, commanded = (tool_path_of(trace, s, machine, kinematics=kinematics) for s in ("position", "setpoint"))
    except TwinError:
        return  # a machine without a tool in a part frame has no contour
    found = contour_error(followed, commanded, search_window(machine))
    add("contour_error_max_um", found.error.max() * 1e6)
    add("contour_error_rms_um", np.sqrt(np.mean(found.error**2)) * 1e6)
    add("orientation_error_max_arcsec", math.degrees(found.orientation.max()) * 3600.0)


def _mark_depth(machine: Machine, trace: Trace, part_file: str) -> float:
    """Deepest mark of the followed against the commanded cut, over all surfaces of the part."""
    from twin.surface.levels import COMMANDED, FOLLOWED, levels_of_trace
    from twin.surface.machining import machine_part
    from twin.surface.part import read_part

    part = read_part(Path(part_file))
    cuts = machine_part(part, levels_of_trace(trace, machine, part.tool, (COMMANDED, FOLLOWED), "study"), threads=1)
    depth = 0.0
    for surface in part.surfaces:
        asked, made = (cuts.of(surface.name, level).finest.deviation for level in (COMMANDED, FOLLOWED))
        depth = max(depth, float(np.nanmax(np.abs(made - asked))))
    return depth * 1e6


def _interpolated(text: str, ending: str, machine: Machine) -> Setpoints:
    from twin.program import interpolate, read_program

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"program{ending}"
        path.write_text(text, encoding="utf-8")
        return setpoints_of(interpolate(read_program(path, machine), machine), machine)
