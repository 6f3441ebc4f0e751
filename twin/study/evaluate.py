"""One variant: simulate its runs and answer. Nothing here knows of other variants, threads or clusters.

following error      set point minus position at the same time
control deviation    the same with the set point as the position controller gets it, delayed: what the drive leaves
contour error        distance of the followed from the commanded tool path
settling time        from the last change of the set point until the error stays inside SETTLED
copper loss          R i_rms^2 of the one-phase equivalent of the motor
limits used          largest speed and current over their limits
first mode           sqrt(stiffness / load) / 2 pi of the axis' transmission; none where it is rigid
mark depth           deepest place of the followed cut below the programmed one (a trace: below the commanded one)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
import functools
import math
from pathlib import Path
import tempfile
import threading

import numpy as np

import twin
from twin.effects import load_inertia, settings_of
from twin.errors import InputError, TwinError
from twin.geometry.kinematics import kinematics_of
from twin.geometry.tool_path import ToolPath, contour_error, path_of_axes, search_window, tool_path_of
from twin.machine.machine import Machine
from twin.machine.model_file import files_of
from twin.program.read import PROGRAM_ENDINGS
from twin.recordings.trace import Trace, read_trace
from twin.simulation.run import Run, simulate
from twin.simulation.setpoints import Setpoints, check_travel, setpoints_of
from twin.study.design import machine_of
from twin.study.spec import Study, StudyRun
from twin.surface.part import Part, read_part
from twin.units import AXIS_UNITS

SETTLED = {"linear": 1e-6, "rotary": math.radians(1.0 / 3600.0)}
"""Error inside which an axis counts as settled [m, rad]."""

Add = Callable[[str, float], None]


@dataclass(frozen=True)
class Source:
    """What one run moves along: set points, or a program's file where its interpolation differs from variant to variant.

    `commanded` is the tool path of the set points at the record's times, the same for all variants; `programmed` what a mark is
    measured against.
    """

    name: str
    feedforward: str | None
    setpoints: Setpoints | None = None
    program: tuple[bytes, str] = (b"", "")  # content and ending of the file
    commanded: ToolPath | None = None
    programmed: ToolPath | None = None


@dataclass(frozen=True)
class Work:
    """What all variants of a study share; `files` (name, content) are those that a worker lacks which has none of this machine's."""

    study: Study
    sources: tuple[Source, ...]
    part: Part | None = None
    files: tuple[tuple[str, bytes], ...] = ()
    version: str = twin.__version__

    def packed(self) -> Work:
        """The same without need of this machine's files."""
        files = {f"machine/{name}": path for name, path in _model_files(self.study.machine).items()} | _part_files(self.part)
        return replace(self, files=tuple((name, path.read_bytes()) for name, path in files.items()))

    def here(self) -> Work:
        """The same with its files in a place that this process can read."""
        if not self.files:
            return self
        with _KEEPING:
            folder = Path(_kept(self.files).name)
        machine = self.study.machine
        study = replace(self.study, machine=replace(machine, model_path=folder / "machine" / machine.model_path.name))
        places = {path: folder / name for name, path in _part_files(self.part).items()}
        return replace(self, study=study, part=self.part and self.part.with_files(places), files=())


def files_of_study(study: Study) -> list[Path]:
    """All files that the results depend on but the machine file and the study file, whose numbers count and not their text."""
    part = [study.part, *_part_files(read_part(study.part)).values()] if study.part else []
    return [*_model_files(study.machine).values(), *(run.input for run in study.runs), *part]


def _model_files(machine: Machine) -> dict[str, Path]:
    """The MJCF of a machine and all files that it names, by their names beside it."""
    model = machine.model_path
    return {str(name): model.parent / name for name in (Path(model.name), *files_of(model))}


def _part_files(part: Part | None) -> dict[str, Path]:
    """The meshes of a part by the names under which a worker keeps them."""
    return {f"part/{i}/{path.name}": path for i, path in enumerate(part.files if part else ())}


_KEEPING = threading.Lock()
"""One thread of a worker makes the folder, the others wait for it."""


@functools.lru_cache(maxsize=8)
def _kept(files: tuple[tuple[str, bytes], ...]) -> tempfile.TemporaryDirectory[str]:
    """A folder of this process with these files, the same for all variants of a study."""
    folder = tempfile.TemporaryDirectory(prefix="twin-study-")
    for name, content in files:
        path = Path(folder.name) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return folder


@dataclass(frozen=True)
class Answer:
    """Responses by name; why the variant could not be run, or which limit it broke (None: it is fine)."""

    responses: dict[str, float] = field(default_factory=dict)
    reason: str | None = None


def work_of(study: Study) -> Work:
    """Read the runs and the part of a study; programs are interpolated once where no factor changes how."""
    part = read_part(study.part) if study.part else None
    return Work(study, tuple(_source(study, run, part) for run in study.runs), part)


def evaluate(work: Work, row: tuple[float, ...]) -> Answer:
    """Answer one variant. One that diverges or is impossible is a result, not the end of the study."""
    if work.version != twin.__version__:
        raise InputError(f"this worker has twin {twin.__version__}, the study was started with {work.version}; install the same there")
    try:
        work = work.here()
        return _answer(machine_of(work.study, np.array(row)), work)
    except TwinError as error:
        return Answer(reason=" ".join(str(error).split()))
    except (ArithmeticError, ValueError, LookupError, RuntimeError) as error:
        # a variant that nobody thought of must not end a study of thousands; its row says that this is a fault of the twin
        return Answer(reason=f"fault in the twin, please report: {type(error).__name__}: {' '.join(str(error).split())}")


def _answer(machine: Machine, work: Work) -> Answer:
    by_run: dict[str, dict[str, float]] = {}
    broken: list[str] = []
    for source in work.sources:
        found = by_run.setdefault(source.name, {})
        setpoints, programmed = motion_of(source, machine, work.part)
        check_travel(setpoints, machine, f"run {source.name}")
        run = simulate(machine.with_feedforward(source.feedforward), setpoints)
        found["cycle_time_s"] = setpoints.duration
        _axis_responses(machine, run, setpoints, found.__setitem__)
        _contour(machine, run.trace, source.commanded, found.__setitem__)
        if work.part:
            found["mark_depth_um"] = _mark_depth(machine, run.trace, work.part, programmed)
        for axis in machine.axes:
            for what, times in ((axis.effort, run.current_limited_s), ("voltage", run.voltage_limited_s)):
                if (seconds := times[axis.name]) > 0.0:
                    broken.append(f"run {source.name}: axis {axis.name} is at its {what} limit for {seconds * 1e3:.1f} ms")
    if len(by_run) == 1:
        (responses,) = by_run.values()
    else:
        names = dict.fromkeys(name for found in by_run.values() for name in found)
        responses = {name: _joined(name, [found[name] for found in by_run.values() if name in found]) for name in names}
        responses |= {f"{run}.{name}": value for run, found in by_run.items() for name, value in found.items()}
    for setting in settings_of(machine):
        if setting.effect.name == "transmission_compliance":
            axis = machine.axis(setting.axis)
            responses[f"first_mode_{axis.name}_hz"] = math.sqrt(setting.parameters["stiffness"] / load_inertia(machine, axis)) / (
                2 * math.pi
            )
    return Answer(responses, "; ".join(broken) or None)


def _joined(name: str, values: list[float]) -> float:
    """One number for all runs: sums of times, root mean square of RMS values, mean of losses, else the largest."""
    if name == "cycle_time_s":
        return float(np.sum(values))
    if "_rms" in name:
        return float(np.sqrt(np.mean(np.square(values))))
    if name.startswith("copper"):
        return float(np.mean(values))
    return float(np.max(values))


def _axis_responses(machine: Machine, run: Run, setpoints: Setpoints, add: Add) -> None:
    time = run.trace.time
    delayed = {d: setpoints.at(time - d) for d in {axis.loops.position_delay_s for axis in machine.axes}}
    for a, axis in enumerate(machine.axes):
        setpoint, position, effort = (run.trace.get(axis.name, s) for s in ("setpoint", "position", axis.effort))
        if np.ptp(setpoint) < 1e-9:
            continue  # an axis that stands
        unit, factor = AXIS_UNITS[axis.kind].error
        error = setpoint - position
        for name, e in (("following_error", error), ("control_deviation", delayed[axis.loops.position_delay_s][:, a] - position)):
            add(f"{name}_max_{axis.name}_{unit}", float(np.abs(e).max()) * factor)
            add(f"{name}_rms_{axis.name}_{unit}", math.sqrt(e @ e / len(e)) * factor)
        largest, square = float(np.abs(effort).max()), float(effort @ effort) / len(effort)
        per = axis.effort_unit.lower()
        add(f"{axis.effort}_max_{axis.name}_{per}", largest)
        add(f"{axis.effort}_rms_{axis.name}_{per}", math.sqrt(square))
        add(f"{axis.effort}_limit_used_{axis.name}", largest / axis.motor.peak_current_a)
        add(f"speed_limit_used_{axis.name}", float(np.abs(run.trace.get(axis.name, "velocity")).max()) / axis.max_velocity)
        if axis.has_current_loop:
            add(f"copper_loss_{axis.name}_w", axis.motor.resistance_ohm * square)
        # settled: the last sample outside lies before the end of the record
        last = int(np.flatnonzero(np.abs(np.diff(setpoint)) > 1e-12)[-1]) + 1
        outside = np.flatnonzero(np.abs(error[last:]) > SETTLED[axis.kind])
        if not len(outside):
            add(f"settling_time_{axis.name}_ms", 0.0)
        elif outside[-1] < len(error) - last - 1:
            add(f"settling_time_{axis.name}_ms", (int(outside[-1]) + 1) * run.trace.period * 1e3)


def _contour(machine: Machine, trace: Trace, commanded: ToolPath | None, add: Add) -> None:
    try:
        kinematics = kinematics_of(machine)
        followed = tool_path_of(trace, "position", machine, kinematics=kinematics)
        if commanded is None or not np.array_equal(commanded.time, followed.time):
            commanded = tool_path_of(trace, "setpoint", machine, kinematics=kinematics)
    except TwinError:
        return  # a machine without a tool in a part frame has no contour
    found = contour_error(followed, commanded, search_window(machine))
    add("contour_error_max_um", float(found.error.max()) * 1e6)
    add("contour_error_rms_um", math.sqrt(found.error @ found.error / len(found.error)) * 1e6)
    add("orientation_error_max_arcsec", math.degrees(found.orientation.max()) * 3600.0)


def _mark_depth(machine: Machine, trace: Trace, part: Part, programmed: ToolPath | None) -> float:
    """Deepest mark over all surfaces of the part [um]."""
    from twin.surface.levels import COMMANDED, FOLLOWED, PROGRAMMED, Level, levels_of_trace
    from twin.surface.machining import machine_part
    from twin.surface.metrology import mark

    levels = levels_of_trace(trace, machine, part.tool, (FOLLOWED,) if programmed else (COMMANDED, FOLLOWED), "study")
    if programmed:
        levels.insert(0, Level(PROGRAMMED, "", programmed, {}))
    cuts = machine_part(part, levels, threads=1)
    pairs = [[cuts.of(surface.name, level.level).finest for level in levels] for surface in part.surfaces]
    return max(mark(made, asked).depth for asked, made in pairs) * 1e6


def _source(study: Study, run: StudyRun, part: Part | None) -> Source:
    machine = study.machine
    if run.input.suffix.lower() not in PROGRAM_ENDINGS:
        trace = read_trace(run.input, axes=machine.kinds, need=("setpoint",))
        setpoints = setpoints_of(trace, machine)
        return Source(run.name, run.feedforward, setpoints, commanded=_commanded(setpoints, machine))
    from twin.program import read_program

    feedforward = run.feedforward or read_program(run.input, machine).feedforward
    source = Source(run.name, feedforward, program=(run.input.read_bytes(), run.input.suffix))
    # what the interpolator reads of a machine: limits, travels, cycles, frames and tools
    if any(".max_" in p or ".travel_" in p or p.split(".")[0] in ("control", "geometry", "frame", "tool") for p in study.varied):
        return source
    setpoints, programmed = motion_of(source, machine, part)
    return replace(source, setpoints=setpoints, commanded=_commanded(setpoints, machine), programmed=programmed)


def _commanded(setpoints: Setpoints, machine: Machine) -> ToolPath | None:
    """Tool path of the set points at the times of the record."""
    if machine.axis_names != ("X", "Y", "Z", "A", "C"):
        return None  # each variant looks for itself
    period = max(1, round(machine.sample_period / machine.base_tick)) * machine.base_tick
    time = np.arange(math.floor(setpoints.duration / period + 1e-9) + 1) * period
    try:
        return path_of_axes(kinematics_of(machine), setpoints.at(time), time)
    except TwinError:
        return None


def motion_of(source: Source, machine: Machine, part: Part | None) -> tuple[Setpoints, ToolPath | None]:
    """Set points of a run on a machine, and the programmed path where there is a part to cut."""
    if source.setpoints is not None:
        return source.setpoints, source.programmed
    from twin.program import interpolate, read_program
    from twin.surface.levels import programmed_path

    content, ending = source.program
    with tempfile.TemporaryDirectory(prefix="twin-study-") as folder:
        path = Path(folder) / f"{source.name}{ending}"
        path.write_bytes(content)
        program = read_program(path, machine)
    return setpoints_of(interpolate(program, machine), machine), programmed_path(program) if part else None
