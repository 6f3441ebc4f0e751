"""Evaluates one variant: simulates its runs and computes the responses, independently of other variants."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
import functools
from pathlib import Path
import tempfile
import threading

import numpy as np

import twin
from twin.errors import InputError, TwinError
from twin.geometry.tool_path import ToolPath
from twin.machine.machine import Machine
from twin.machine.model_file import files_of, state_of_model
from twin.program.read import is_program
from twin.recordings.trace import read_trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints, check_travel, setpoints_of
from twin.study.design import machine_of
from twin.study.responses import axis_responses, contour_responses, drive_responses, joined, mark_depth
from twin.study.spec import Study, StudyRun
from twin.surface.machining import check_rays
from twin.surface.part import Part, read_part

FAULT = "fault in the twin"
"""Start of the reason of a variant that an unforeseen error ended."""


@dataclass(frozen=True)
class RunMotion:
    """Motion of one run: set points, or a program file if its interpolation depends on the variant.

    `part` is the part to cut, `programmed` the reference path of its mark.
    """

    name: str
    feedforward: str | None
    setpoints: Setpoints | None = None
    program: tuple[tuple[str, bytes], ...] = ()  # name in the folder and content of the program, then of its subprograms
    folder: str = ""  # of the program, for messages
    programmed: ToolPath | None = None
    part: Part | None = None


@dataclass(frozen=True)
class Work:
    """Data shared by all variants of a study; `files` (name, content) are for workers on other computers."""

    study: Study
    sources: tuple[RunMotion, ...]
    files: tuple[tuple[str, bytes], ...] = ()
    version: str = twin.__version__

    def packed(self) -> Work:
        """The same with the content of all needed files."""
        files = {f"machine/{name}": path for name, path in _model_files(self.study.machine).items()}
        files |= _part_files(source.part for source in self.sources)
        return replace(self, files=tuple((name, path.read_bytes()) for name, path in files.items()))

    def here(self) -> Work:
        """The same with its files unpacked in a folder of this process."""
        if not self.files:
            return self
        with _KEEPING:
            folder = Path(_kept(self.files).name)
        machine = self.study.machine
        study = replace(self.study, machine=replace(machine, model_path=folder / "machine" / machine.model_path.name))
        places = {path: folder / name for name, path in _part_files(source.part for source in self.sources).items()}
        sources = tuple(replace(source, part=source.part and source.part.with_files(places)) for source in self.sources)
        return replace(self, study=study, sources=sources, files=())


def files_of_study(study: Study) -> list[Path]:
    """All files that the results depend on, except machine file and study file, whose numbers are compared instead."""
    from twin.program import read_program

    parts = [Path(run.part) for run in study.runs if run.part]
    meshes = _part_files(read_part(part) for part in parts)
    subprograms = [file for run in study.runs if is_program(Path(run.input)) for file in read_program(run.input, study.machine).files]
    inputs = [*(Path(run.input) for run in study.runs), *subprograms]
    return [*_model_files(study.machine).values(), *inputs, *parts, *meshes.values()]


def _model_files(machine: Machine) -> dict[str, Path]:
    """The MJCF of a machine and all files that it refers to, by relative name."""
    model = machine.model_path
    return {str(name): model.parent / name for name in (Path(model.name), *files_of(model))}


def _part_files(parts: Iterable[Part | None]) -> dict[str, Path]:
    """The meshes of the parts of all runs, by their names on a worker."""
    return {f"part/{run}/{i}/{path.name}": path for run, part in enumerate(parts) for i, path in enumerate(part.files if part else ())}


_KEEPING = threading.Lock()
"""Held by the thread of a worker that unpacks the files."""


def _folder_with(files: tuple[tuple[str, bytes], ...]) -> tempfile.TemporaryDirectory[str]:
    """A temporary folder with these files."""
    folder = tempfile.TemporaryDirectory(prefix="twin-study-")
    for name, content in files:
        path = Path(folder.name) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return folder


_kept = functools.lru_cache(maxsize=8)(_folder_with)
"""The folder of this process, shared by all variants of a study."""


@dataclass(frozen=True)
class Answer:
    """Responses by name, and the reason why the variant could not be run (None: it could)."""

    responses: dict[str, float] = field(default_factory=dict)
    reason: str | None = None


def work_of(study: Study) -> Work:
    """Read the runs and parts of a study; a program is interpolated here if the result is the same for all variants."""
    parts = [read_part(run.part) if run.part else None for run in study.runs]
    for part in filter(None, parts):
        check_rays(part)
    return Work(study, tuple(_source(study, run, part) for run, part in zip(study.runs, parts, strict=True)))


def evaluate(work: Work, row: tuple[float, ...]) -> Answer:
    """Evaluate one variant. An impossible or unstable variant gets a reason and does not end the study."""
    if work.version != twin.__version__:
        raise InputError(f"this worker has twin {twin.__version__}, the study was started with {work.version}; install the same there")
    try:
        work = work.here()
        return Answer(responses_of(machine_of(work.study, np.array(row)), work))
    except TwinError as error:
        return Answer(reason=" ".join(str(error).split()))
    except (ArithmeticError, ValueError, LookupError, RuntimeError) as error:
        # an unforeseen error must not end a study of thousands of variants
        return Answer(reason=f"{FAULT}, please report: {type(error).__name__}: {' '.join(str(error).split())}")


def responses_of(machine: Machine, work: Work) -> dict[str, float]:
    """Responses of a machine by name, over all runs and per run. Raises TwinError if it cannot run them."""
    by_run: dict[str, dict[str, float]] = {}
    for source in work.sources:
        found = by_run.setdefault(source.name, {})
        setpoints, programmed = motion_of(source, machine)
        check_travel(setpoints, machine, f"run {source.name}")
        run = simulate(machine.with_feedforward(source.feedforward), setpoints, count_load=True)
        found["cycle_time_s"] = setpoints.duration
        axis_responses(machine, run, setpoints, found.__setitem__)
        contour_responses(machine, run.trace, found.__setitem__)
        if source.part:
            found["mark_depth_um"] = mark_depth(machine, run.trace, source.part, programmed)
    if len(by_run) == 1:
        (responses,) = by_run.values()
    else:
        names = dict.fromkeys(name for found in by_run.values() for name in found)
        responses = {}
        for name in names:
            having = [found for found in by_run.values() if name in found]
            responses[name] = joined(name, [found[name] for found in having], [found["cycle_time_s"] for found in having])
        responses |= {f"{run}.{name}": value for run, found in by_run.items() for name, value in found.items()}
    drive_responses(machine, responses.__setitem__)
    return responses


def _source(study: Study, run: StudyRun, part: Part | None) -> RunMotion:
    machine, path = study.machine, Path(run.input)
    if not is_program(path):
        trace = read_trace(path, axes=machine.kinds, need=("setpoint",))
        return RunMotion(run.name, run.feedforward, setpoints_of(trace, machine), part=part)
    from twin.program import read_program

    program, folder = read_program(path, machine), path.parent
    files = tuple((file.relative_to(folder).as_posix(), file.read_bytes()) for file in (path, *program.files))
    source = RunMotion(run.name, run.feedforward or program.feedforward, program=files, folder=str(folder), part=part)
    # the interpolator depends on limits, travels, cycles, frames, tools and, for exact stops, on the position gain
    tables, words = ("geometry", "frame", "tool", "control"), (".max_", ".travel_", ".position_gain_")
    varied = [path for paths in (*(f.paths for f in study.factors), *(t.paths for t in study.tied)) for path in paths]
    if any(path.split(".")[0] in tables or any(word in path for word in words) for path in varied):
        return source
    setpoints, programmed = motion_of(source, machine)
    return replace(source, setpoints=setpoints, programmed=programmed)


def motion_of(source: RunMotion, machine: Machine) -> tuple[Setpoints, ToolPath | None]:
    """Set points of a run on a machine, and the programmed path if there is a part to cut."""
    if source.setpoints is not None:
        return source.setpoints, source.programmed
    # one thread plans while the others wait: planning is not compiled, and most variants share a plan
    key = (source.program, source.part is not None, _planning_key(machine))
    with _PLANNING:
        if key not in _PLANS:
            while len(_PLANS) >= MOST_PLANS:
                del _PLANS[next(iter(_PLANS))]
            _PLANS[key] = _planned(source, machine)
        return _PLANS[key]


_PLANNING = threading.Lock()
_PLANS: dict[object, tuple[Setpoints, ToolPath | None]] = {}
MOST_PLANS = 16
"""Interpolated programs that a worker keeps; the oldest is dropped."""


def _planning_key(machine: Machine) -> tuple[object, ...]:
    """The part of a machine that the interpolation of a program depends on: all but drives, masses, effects and noise, plus the lowest position gain."""
    tables = {k: v for k, v in machine.document.items() if k not in ("axis", "body", "effect", "measurement")}
    axes = tuple((a.name, a.kind, a.travel, a.max_velocity, a.max_acceleration, a.max_jerk) for a in machine.axes)
    settling = min(a.loops.position_gain_per_s for a in machine.axes)
    return repr(tables), axes, settling, str(machine.model_path), state_of_model(machine.model_path)


def _planned(source: RunMotion, machine: Machine) -> tuple[Setpoints, ToolPath | None]:
    """Interpolate a program on a machine, and compute its programmed path if there is a part to cut."""
    from twin.program import interpolate, read_program
    from twin.surface.levels import programmed_path

    with _folder_with(source.program) as folder:
        try:
            program = read_program(Path(folder) / source.program[0][0], machine)
        except InputError as error:
            raise InputError(str(error).replace(folder, source.folder)) from None
    return setpoints_of(interpolate(program, machine), machine), programmed_path(program) if source.part else None
