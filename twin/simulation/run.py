"""Runs of the twin: set points and a machine in, a trace of the same form as a measured one out.

    set points -> command of the position cycles -> cascade + plant (one compiled loop) -> trace

`simulate` is the whole of it; start reading here. `simulate_each` runs many machines, those that fit beside each other in one loop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import itertools
from typing import Any, NamedTuple, TypeVar

import numpy as np

from twin.effects import Change
from twin.errors import SimulationError, TwinError
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation import cascade, loop, loop_record
from twin.simulation.drive_load import drive_load
from twin.simulation.lanes import DIVERGED_SPEED, Advanced, Lane, PlantFace, advance, lane_of
from twin.simulation.mujoco_plant import MujocoPlant
from twin.simulation.result import Run
from twin.simulation.setpoints import Setpoints, check_travel, setpoints_of

Answer = TypeVar("Answer")

MOST_LANES = 8
"""Machines side by side: more gain nothing, for their states no longer lie in the processor's first cache."""

SPLINE_SAMPLES = 20_000
"""Most set points that are interpolated at once for the record."""

SWINGS_AT_REST = 8
"""Swings from one current limit to the other after the last set point from which an axis counts as unstable."""

SETPOINT_ROUNDING = 1e-12
"""A set point that changes by less from sample to sample stands still [m, rad]."""

ALIKE = 0.5
"""Length of a run as a share of that of the longest beside it, at least: a lane beside others takes about half the time of one alone, also
while it stands idle behind its end."""


def simulate(
    machine: Machine,
    setpoints: Setpoints | Trace,
    *,
    sample_period: float | None = None,
    started_at: float = 0.0,
    noise_seed: int | None = None,
    plant_of: Callable[[Change], PlantFace] | None = None,
    count_load: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Simulate the machine with its effects on these set points, (sample, axis) in the machine's axis order, SI.

    A trace with set points is taken as it is recorded; an axis without set points stands still.
    `sample_period` [s] of the record (default: the machine file's), rounded to whole ticks; `started_at` [s] since the
    start of the campaign, for what drifts; `noise_seed` adds the measuring noise of the machine file to what the control sees
    (None: ideal). `plant_of` makes the mechanics (default: MuJoCo). `count_load` adds up at every tick what the drives give (`Run.load`). `progress` is called with the done fraction. Raises
    SimulationError (with the trace up to there) where an axis diverges, InputError where it cannot be held at its start.
    """
    if isinstance(setpoints, Trace):
        setpoints = setpoints_of(setpoints, machine)
        check_travel(setpoints, machine, "simulate")
    lane = lane_of(
        machine,
        setpoints,
        plant_of or MujocoPlant,
        sample_period=sample_period,
        started_at=started_at,
        noise_seed=noise_seed,
        count_load=count_load,
    )
    return _run_of(lane, advance([lane], progress))


class SimulationJob(NamedTuple):
    """What `simulate_each` is asked: arguments of `simulate`."""

    machine: Machine
    setpoints: Setpoints
    plant_of: Callable[[Change], PlantFace]
    sample_period: float | None = None
    started_at: float = 0.0
    noise_seed: int | None = None


def simulate_each(
    jobs: Sequence[SimulationJob], mapper: Callable[..., Any] = map, of: Callable[[int, Run], Any] = lambda i, run: run
) -> list[Any]:
    """What `of` takes from the run of each job (its number and run are given), in their order, or the TwinError that `simulate` would raise.

    Jobs that fit beside each other run in one loop; the numbers of a run do not depend on those beside it. `mapper` maps over threads.
    """
    outcomes: list[Any] = [None] * len(jobs)
    lanes: dict[int, Lane] = {}
    for i, prepared in enumerate(map(_prepared, jobs)):
        if isinstance(prepared, Lane):
            lanes[i] = prepared
        else:
            outcomes[i] = prepared

    def batch_of(numbers: Sequence[int]) -> list[Any]:
        runs = _advanced([lanes[i] for i in numbers])
        return [run if isinstance(run, TwinError) else of(i, run) for i, run in zip(numbers, runs)]

    batches = _batches(lanes)
    for batch, found in zip(batches, mapper(batch_of, batches)):
        for i, outcome in zip(batch, found):
            outcomes[i] = outcome
    return outcomes


def all_or_raise(outcomes: Iterable[Answer | TwinError]) -> list[Answer]:
    """The outcomes of `simulate_each`; the first error among them is raised."""
    found: list[Answer] = []
    for outcome in outcomes:
        if isinstance(outcome, TwinError):
            raise outcome
        found.append(outcome)
    return found


def _prepared(job: SimulationJob) -> Lane | TwinError:
    machine, setpoints, plant_of, sample_period, started_at, noise_seed = job
    try:
        return lane_of(machine, setpoints, plant_of, sample_period=sample_period, started_at=started_at, noise_seed=noise_seed)
    except TwinError as error:
        return error


def _batches(lanes: dict[int, Lane]) -> list[list[int]]:
    """Lanes by number in batches that run side by side, the longest first."""
    batches: list[list[int]] = []
    open_batch: dict[object, list[int]] = {}
    for i in sorted(lanes, key=lambda i: -lanes[i].ticks):
        key = lanes[i].fits_beside
        batch = open_batch.get(key) if key is not None else None
        if batch is None or len(batch) == MOST_LANES or lanes[i].ticks < ALIKE * lanes[batch[0]].ticks:
            batch = open_batch[key] = []
            batches.append(batch)
        batch.append(i)
    return batches


def _advanced(lanes: Sequence[Lane]) -> list[Run | TwinError]:
    """The runs of lanes side by side. Where one diverges it goes on alone, and so do the others."""
    advanced = advance(lanes)
    if advanced.failed < 0:
        out: list[Run | TwinError] = []
        for i, lane in enumerate(lanes):
            try:
                out.append(_run_of(lane, advanced.of(lanes, i)))
            except TwinError as error:
                out.append(error)
        return out
    if len(lanes) == 1:
        return [_divergence(lanes[0], advanced)]
    rows = np.repeat(np.arange(len(lanes)), [lane.axes for lane in lanes])
    culprit = int(rows[advanced.failed % len(rows)])
    others = _advanced([lane for i, lane in enumerate(lanes) if i != culprit])
    return [*others[:culprit], *_advanced([lanes[culprit]]), *others[culprit:]]


def _run_of(lane: Lane, advanced: Advanced) -> Run:
    """What a lane's run gives back; raises SimulationError where an axis diverged, or does not come to rest."""
    if advanced.failed >= 0:
        raise _divergence(lane, advanced)
    machine, limited = lane.machine, advanced.limited
    names = machine.axis_names
    trace, without_noise = _traces(lane, advanced.record, lane.rows)
    _check_standing(trace, machine, lane.drives)
    return Run(
        trace,
        without_noise,
        dict(zip(names, (limited[:, loop.CURRENT_LIMIT] * machine.speed_cycle).tolist())),
        dict(zip(names, (limited[:, loop.VOLTAGE_LIMIT] * machine.current_cycle).tolist())),
        machine,
        {axis.name: drive_load(axis, advanced.counted, a) for a, axis in enumerate(machine.axes)} if lane.count_load else {},
    )


def _divergence(lane: Lane, advanced: Advanced) -> SimulationError:
    """The error of an axis that left all bounds, with the trace up to there."""
    tick, axis = divmod(advanced.failed, lane.axes)
    rows = tick // lane.schedule.record_ticks
    return SimulationError(
        f"simulation diverges: axis {lane.machine.axes[axis].name} at {tick * lane.schedule.tick:.4f} s is faster than {DIVERGED_SPEED:g} times its limit; "
        "lower its gains or the size of its effects",
        _traces(lane, advanced.record, rows)[0] if rows >= 2 else None,
    )


def _check_standing(trace: Trace, machine: Machine, drives: cascade.Drives) -> None:
    """An axis that goes from one current limit to the other and back after its last set point does not stand: its loops are unstable."""
    for a, (name, effort) in enumerate((axis.name, axis.effort) for axis in machine.axes):
        moving = np.flatnonzero(np.abs(np.diff(trace.get(name, "setpoint"))) > SETPOINT_ROUNDING)
        after = trace.get(name, "current_setpoint" if effort == "current" else effort)[moving[-1] + 1 if moving.size else 0 :]
        turns = np.diff(np.sign(after[np.abs(after) >= drives.peak_current[a]]))
        if np.count_nonzero(turns) >= SWINGS_AT_REST:
            raise SimulationError(
                f"axis {name} swings between its {effort} limits although its set point stands still: its loops are unstable; "
                "lower its gains or the size of its effects",
                trace,
            )


def _traces(lane: Lane, record: loop_record.Record, rows: int) -> tuple[Trace, Trace]:
    """The first rows of the record as the control's samples show it, and without noise."""
    machine, setpoints, period = lane.machine, lane.setpoints, lane.period
    time = np.arange(rows) * period
    # in parts, so that the splines of a long program need no more memory than a short one's
    parts = -(-max(rows, len(setpoints.position)) // SPLINE_SAMPLES)
    ends = np.linspace(0, rows, parts + 1).astype(int).tolist()
    positions = np.concatenate([setpoints.at_cycles(i, j - i, period, [0.0])[0] for i, j in itertools.pairwise(ends) if j > i])
    signals = {}
    for a, axis in enumerate(machine.axes):
        signals[axis.name, "setpoint"] = positions[:, a]
        for channel in loop_record.RECORDED:
            if channel == "drive_velocity_setpoint" and not axis.loops.dsc_delay_s:
                continue  # the NC's own
            if axis.effort != "current" and channel in ("current", "current_setpoint"):
                continue  # an axis without current: its command, a voltage or the torque
            signals[axis.name, channel] = getattr(record, channel)[:rows, a]
        if axis.effort == "voltage":
            signals[axis.name, axis.effort] = record.current[:rows, a]
    seen = dict(signals)
    for a, axis in enumerate(machine.axes):
        for channel in loop_record.MEASURED:
            key = (axis.name, axis.effort if channel == "current" else channel)
            if key != (axis.name, "torque"):  # a command is no measurement
                seen[key] = getattr(record, loop_record.SEEN + channel)[:rows, a]
    return Trace(time, seen, machine.kinds, machine.forces), Trace(time, signals, machine.kinds, machine.forces)
