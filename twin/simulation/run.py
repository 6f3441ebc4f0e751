"""Simulate a machine: set points in, a trace of the same form as a measured one out.

    set points -> command of the position cycles -> cascade + plant (one compiled loop) -> trace

Start reading at `simulate`. `simulate_each` simulates many machines and batches those that can share one loop.
"""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
import itertools
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from twin.effects import Change
from twin.errors import InputError, SimulationError, TwinError
from twin.machine.machine import Machine
from twin.recordings.trace import TRACE_ENDINGS, Trace, read_trace
from twin.simulation import loop, loop_record
from twin.simulation.axis_table import AxisTable
from twin.simulation.drive_load import drive_load
from twin.simulation.mujoco_plant import MujocoPlant
from twin.simulation.prepared import DIVERGED_SPEED, LoopResults, PlantInterface, PreparedRun, prepared_run, run_together
from twin.simulation.result import Run
from twin.simulation.setpoints import Setpoints, check_travel, setpoints_of
from twin.system import cores

Outcome = TypeVar("Outcome")

MOST_AXES = 20
"""Largest number of axes in one loop. With more, their state no longer fits in the first-level cache and nothing is gained, but memory is lost."""

LEAST_AXES = 2
"""Smallest number of axes in one loop while other processors are free: alone, an axis takes half as long again as beside another one."""

SPLINE_SAMPLES = 20_000
"""Largest number of set points in one spline evaluation for the record."""

UNSTABLE_SWINGS = 8
"""An axis that swings so often between its current limits after the last set point is unstable."""

SETPOINT_ROUNDING = 1e-12
"""Smallest change from sample to sample that counts as motion of the set point [m, rad]."""


def simulate(
    machine: Machine,
    setpoints: Setpoints | Trace | str | Path,
    *,
    sample_period: float | None = None,
    started_at: float = 0.0,
    noise_seed: int | None = None,
    plant_of: Callable[[Change], PlantInterface] | None = None,
    count_load: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Simulate a machine with its effects.

    `setpoints` is a `Setpoints` (sample, axis) in the machine's axis order and SI units, or a trace or its file. In a trace, axes without
    set points stand still. `sample_period` [s] of the record defaults to that of the machine file and is rounded to whole ticks. `started_at` [s] is
    the start of the run in its campaign; drift depends on it. `noise_seed` adds the measuring noise of the machine file to the signals
    that the control sees; None simulates ideal sensors. `plant_of` builds the mechanics, by default in MuJoCo. `count_load` fills
    `Run.load`. `progress` receives the fraction done.

    Raises SimulationError, with the trace so far, if an axis diverges, and InputError if an axis cannot be held at its start.
    """
    if isinstance(setpoints, (str, Path)):
        if Path(setpoints).suffix.lower() not in TRACE_ENDINGS:
            raise InputError(f"simulate: {setpoints}: a part program becomes set points with twin.interpolate(file, machine); give those")
        setpoints = read_trace(setpoints, axes=machine.kinds, need=("setpoint",))
    if isinstance(setpoints, Trace):
        setpoints = setpoints_of(setpoints, machine)
        check_travel(setpoints, machine, "simulate")
    if not isinstance(setpoints, Setpoints):
        raise InputError(
            f"simulate: set points are a Setpoints or a trace, not {type(setpoints).__name__}; see twin.read_trace, twin.interpolate"
        )
    one = prepared_run(
        machine,
        setpoints,
        plant_of or MujocoPlant,
        sample_period=sample_period,
        started_at=started_at,
        noise_seed=noise_seed,
        count_load=count_load,
    )
    return _run_of(one, run_together([one], progress))


class SimulationJob(NamedTuple):
    """Arguments of `simulate` for one machine."""

    machine: Machine
    setpoints: Setpoints
    plant_of: Callable[[Change], PlantInterface]
    sample_period: float | None = None
    started_at: float = 0.0
    noise_seed: int | None = None


def simulate_each(
    jobs: Sequence[SimulationJob], mapper: Callable[..., Any] = map, of: Callable[[int, Run], Any] = lambda i, run: run
) -> list[Any]:
    """Simulate all jobs; returns `of(number, run)` for each job in order, or the TwinError that `simulate` would raise.

    Jobs that can share a loop run in batches. Each run has exactly the numbers that `simulate` gives. `mapper` is `map` or the map of a
    thread pool.
    """
    outcomes: list[Any] = [None] * len(jobs)
    prepared: dict[int, PreparedRun] = {}
    for i, job in enumerate(jobs):
        try:
            prepared[i] = prepared_run(**job._asdict())
        except TwinError as error:
            outcomes[i] = error

    def simulate_batch(numbers: Sequence[int]) -> list[Any]:
        runs = _runs_of([prepared[i] for i in numbers])
        return [run if isinstance(run, TwinError) else of(i, run) for i, run in zip(numbers, runs)]

    batches = _batches(prepared)
    for batch, results in zip(batches, mapper(simulate_batch, batches)):
        for i, result in zip(batch, results):
            outcomes[i] = result
    return outcomes


def simulate_on_all_cores(jobs: Sequence[SimulationJob], of: Callable[[int, Run], Any] = lambda i, run: run) -> list[Any]:
    """`simulate_each` with a thread for each core."""
    with ThreadPoolExecutor(cores()) as pool:
        return simulate_each(jobs, pool.map, of)


def all_or_raise(outcomes: Iterable[Outcome | TwinError]) -> list[Outcome]:
    """The outcomes of `simulate_each`. Raises the first error among them."""
    runs: list[Outcome] = []
    for outcome in outcomes:
        if isinstance(outcome, TwinError):
            raise outcome
        runs.append(outcome)
    return runs


@dataclass
class _Batch:
    """Numbers of the prepared runs that share a loop, their axes, and their ticks over all axes."""

    runs: list[int] = field(default_factory=list)
    axes: int = 0
    ticks: int = 0


def _batches(prepared: dict[int, PreparedRun]) -> list[list[int]]:
    """Group prepared runs, by number, into batches that share a loop, of nearly equal numbers of ticks; long runs first."""
    alike: dict[object, list[int]] = {}
    for i in sorted(prepared, key=lambda i: -prepared[i].ticks):
        key = prepared[i].batch_key
        alike.setdefault((i,) if key is None else key, []).append(i)
    batches: list[_Batch] = []
    for runs in alike.values():
        axes = sum(prepared[i].axes for i in runs)
        some = [_Batch() for _ in range(max(1, -(-axes // MOST_AXES), min(cores(), axes // LEAST_AXES)))]
        for i in runs:
            own = prepared[i].axes
            with_room = [batch for batch in some if batch.axes + own <= MOST_AXES]
            if not with_room:
                with_room = [_Batch()]
                some += with_room
            batch = min(with_room, key=lambda batch: batch.ticks)
            batch.runs.append(i)
            batch.axes += own
            batch.ticks += own * prepared[i].ticks
        batches += some
    return [batch.runs for batch in batches if batch.runs]


def _runs_of(prepared: Sequence[PreparedRun]) -> list[Run | TwinError]:
    """Run a batch. If one run diverges, run it alone and the remaining prepared runs again without it."""
    results = run_together(prepared)
    if results.diverged_at < 0:
        runs: list[Run | TwinError] = []
        for i, one in enumerate(prepared):
            try:
                runs.append(_run_of(one, results.of(prepared, i)))
            except TwinError as error:
                runs.append(error)
        return runs
    if len(prepared) == 1:
        return [_divergence(prepared[0], results)]
    run_of_axis = np.repeat(np.arange(len(prepared)), [one.axes for one in prepared])
    culprit = int(run_of_axis[results.diverged_at % len(run_of_axis)])
    others = _runs_of([one for i, one in enumerate(prepared) if i != culprit])
    return [*others[:culprit], *_runs_of([prepared[culprit]]), *others[culprit:]]


def _run_of(one: PreparedRun, results: LoopResults) -> Run:
    """The result of one run. Raises SimulationError if an axis diverged or oscillates after its last set point."""
    if results.diverged_at >= 0:
        raise _divergence(one, results)
    machine, limited = one.machine, results.limited
    names = machine.axis_names
    trace, without_noise = _traces(one, results.record, one.rows)
    _check_standstill(trace, machine, one.drives)
    return Run(
        trace,
        without_noise,
        dict(zip(names, (limited[:, loop.CURRENT_LIMIT] * machine.speed_cycle).tolist())),
        dict(zip(names, (limited[:, loop.VOLTAGE_LIMIT] * machine.current_cycle).tolist())),
        machine,
        {axis.name: drive_load(axis, results.load_sums, a) for a, axis in enumerate(machine.axes)} if one.count_load else {},
    )


def _divergence(one: PreparedRun, results: LoopResults) -> SimulationError:
    """The error of an axis that diverged, with the trace so far."""
    tick, axis = divmod(results.diverged_at, one.axes)
    rows = tick // one.schedule.record_ticks
    return SimulationError(
        f"simulation diverges: axis {one.machine.axes[axis].name} at {tick * one.schedule.tick:.4f} s is faster than {DIVERGED_SPEED:g} times its limit; "
        "lower its gains or the size of its effects",
        _traces(one, results.record, rows)[0] if rows >= 2 else None,
    )


def _check_standstill(trace: Trace, machine: Machine, drives: AxisTable) -> None:
    """Raise SimulationError if an axis swings between its current limits after its last set point: its loops are unstable."""
    for a, axis in enumerate(machine.axes):
        moving = np.flatnonzero(np.abs(np.diff(trace.get(axis.name, "setpoint"))) > SETPOINT_ROUNDING)
        after = trace.get(axis.name, axis.command)[moving[-1] + 1 if moving.size else 0 :]
        swings = np.diff(np.sign(after[np.abs(after) >= drives.peak_current[a]]))
        if np.count_nonzero(swings) >= UNSTABLE_SWINGS:
            raise SimulationError(
                f"axis {axis.name} swings between its {axis.effort} limits although its set point stands still: its loops are unstable; "
                "lower its gains or the size of its effects",
                trace,
            )


def _traces(one: PreparedRun, record: np.ndarray, rows: int) -> tuple[Trace, Trace]:
    """The first `rows` rows of the record as two traces: as the control sees its signals, and without measuring noise; the same for ideal sensors."""
    machine = one.machine
    signals = {}
    positions = _recorded_setpoints(one, rows)
    for a, axis in enumerate(machine.axes):
        signals[axis.name, "setpoint"] = positions[:, a]
        for i, channel in enumerate(loop_record.RECORDED):
            if channel == "drive_velocity_setpoint" and not axis.loops.dsc_delay_s:
                continue  # it equals the speed set point of the NC
            if axis.command == axis.effort and channel in ("current", "current_setpoint"):
                continue  # the axis has no current, only a command: a voltage or a torque
            signals[axis.name, channel] = record[:rows, a, i]
        if (axis.name, axis.effort) not in signals:
            signals[axis.name, axis.effort] = record[:rows, a, loop_record.CURRENT]
    time = np.arange(rows) * one.period
    without_noise = Trace(time, signals, machine.kinds, machine.forces)
    if one.noise_seed is None:
        return without_noise, without_noise
    seen = dict(signals)
    for a, axis in enumerate(machine.axes):
        for i, channel in enumerate(loop_record.MEASURED, start=len(loop_record.RECORDED)):
            key = (axis.name, axis.recorded_as(channel))
            if key != (axis.name, "torque"):  # a commanded torque is not measured
                seen[key] = record[:rows, a, i]
    return Trace(time, seen, machine.kinds, machine.forces), without_noise


def _recorded_setpoints(one: PreparedRun, rows: int) -> np.ndarray:
    """Set points (row, axis) at the times of the record, evaluated in parts so that a long program needs no more memory than a short one."""
    setpoints, period = one.setpoints, one.period
    parts = -(-max(rows, len(setpoints.position)) // SPLINE_SAMPLES)
    ends = np.linspace(0, rows, parts + 1).astype(int).tolist()
    return np.concatenate([setpoints.at_cycles(i, j - i, period, [0.0])[0] for i, j in itertools.pairwise(ends) if j > i])
