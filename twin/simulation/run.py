"""One run of the twin: set points and a machine in, a trace of the same form as a measured one out.

    set points -> command of the position cycles -> cascade + plant (one compiled loop) -> trace

`simulate` is the whole of it; start reading here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import itertools
from typing import Protocol

import numpy as np

from twin.effects import Change, apply_effects
from twin.errors import InputError, SimulationError
from twin.limits import refuse_above
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation import cascade, loop, loop_record
from twin.simulation.drive_load import NOTHING_COUNTED, drive_load, drive_sums
from twin.simulation.loop_terms import SIGNAL_COUNT, term_table
from twin.simulation.mujoco_plant import MujocoPlant
from twin.simulation.plant_spec import home_inertia_at_motor
from twin.simulation.result import Run
from twin.simulation.setpoints import Setpoints, check_travel, command_of, setpoints_of

MOST_RECORDED = 15_000_000
"""Samples of all axes of a record: 50 minutes of five axes at 1 kHz, 2 GB."""
MOST_TICKS = 1_000_000_000
"""35 hours of a machine with a tick of 125 us; hours of simulation."""
STRETCH_TICKS = 16_000
"""Ticks advanced in one call of the loop. It bounds the memory that a run needs beside its trace, and the time between two progress reports."""

SPLINE_SAMPLES = 20_000
"""Most set points that are interpolated at once for the record."""

DIVERGED_SPEED = 3.0
"""Multiple of its highest speed beyond which an axis has diverged."""

SWINGS_AT_REST = 8
"""Swings from one current limit to the other after the last set point from which an axis counts as unstable."""

SETPOINT_ROUNDING = 1e-12
"""A set point that changes by less from sample to sample stands still [m, rad]."""


class PlantFace(Protocol):
    """What `simulate` asks of the mechanics: an engine for the loop, and a start at rest."""

    engine: loop.Engine

    def place_at_rest(self, start: np.ndarray, constant_force: np.ndarray, change: Change) -> np.ndarray:
        """Put load and rotor on the start (axis,); returns the force at each axis that holds it there."""


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
    # what the control was commissioned with stays; what the machine really is comes from file and effects
    inertia = commissioned_inertia(machine)
    actual = apply_effects(machine, started_at)
    actual.lead_ticks = round(setpoints.lead / machine.base_tick)
    schedule = _schedule(machine, sample_period)
    _check_length(machine, setpoints, schedule)
    plant = (plant_of or MujocoPlant)(actual)  # owns the memory behind the addresses of its engine: it must live as long as the loop runs
    simulation = _at_rest(machine, actual, plant, setpoints, schedule)
    rng = None if noise_seed is None else np.random.default_rng(noise_seed)

    period = schedule.record_ticks * schedule.tick
    rows = int(np.floor(setpoints.duration / period + 1e-9)) + 1
    if rows < 2:
        raise InputError(f"a run of {setpoints.duration:.4g} s has one sample every {period:.4g} s: record it more often")
    axes = len(machine.axes)
    record = loop_record.empty_record(rows, axes)
    limited = np.zeros((axes, 2), np.int64)
    counted = drive_sums(machine.axes) if count_load else NOTHING_COUNTED
    total = (rows - 1) * schedule.record_ticks + 1
    for first, ticks in _stretches(schedule, total, actual.lead_ticks):
        command = command_of(actual.machine, inertia, setpoints, first // schedule.position_ticks, -(-ticks // schedule.position_ticks))
        lead = first < 0  # before the first sample nothing is recorded or counted
        failed = loop.advance(
            simulation,
            command,
            _sensing(machine, rng, ticks),
            first,
            ticks,
            loop_record.empty_record(-first // schedule.record_ticks + 1, axes) if lead else record.rows(first // schedule.record_ticks),
            np.zeros_like(limited) if lead else limited,
            NOTHING_COUNTED if lead else counted,
        )
        if failed >= 0:
            raise _divergence(machine, setpoints, record, schedule, failed)
        if progress:
            progress((first + ticks) / total)
    names = machine.axis_names
    trace, without_noise = _traces(machine, setpoints, record, rows, period)
    _check_standing(trace, machine, simulation.drives)
    return Run(
        trace,
        without_noise,
        dict(zip(names, (limited[:, loop.CURRENT_LIMIT] * machine.speed_cycle).tolist())),
        dict(zip(names, (limited[:, loop.VOLTAGE_LIMIT] * machine.current_cycle).tolist())),
        machine,
        {axis.name: drive_load(axis, counted, a) for a, axis in enumerate(machine.axes)} if count_load else {},
    )


def _check_length(machine: Machine, setpoints: Setpoints, schedule: loop.Schedule) -> None:
    """Refuse a run whose record would take more than 2 GB, or whose ticks would take days."""
    ticks = (setpoints.duration + setpoints.lead) / schedule.tick
    said = f"a run of {setpoints.duration:.3g} s"
    remedy = "cut the run into parts, or record with a longer period"
    refuse_above(ticks / schedule.record_ticks * len(machine.axes), MOST_RECORDED, "samples to record", said, remedy)
    refuse_above(ticks, MOST_TICKS, "ticks to simulate", said, "cut the run into parts")


def _schedule(machine: Machine, sample_period: float | None) -> loop.Schedule:
    """Cycles of the controllers and of the record in ticks."""
    h = machine.base_tick
    return loop.Schedule(
        tick=h,
        position_ticks=round(machine.position_cycle / h),
        speed_ticks=round(machine.speed_cycle / h),
        current_ticks=round(machine.current_cycle / h),
        record_ticks=max(1, round((sample_period or machine.sample_period) / h)),
        speed_bound=DIVERGED_SPEED * np.array([axis.max_velocity for axis in machine.axes]),
    )


def _at_rest(machine: Machine, actual: Change, plant: PlantFace, setpoints: Setpoints, schedule: loop.Schedule) -> loop.Simulation:
    """The simulation at rest on the first set point, integrators carrying gravity and constant forces; drive trains wound up as recorded."""
    drives = cascade.drives_of(actual.machine)
    start = setpoints.start - actual.scale_offset
    constant = actual.constant_force_at(start) + setpoints.outside_at_start
    held_force = plant.place_at_rest(start, constant, actual)
    sag = _sag(actual.machine, held_force)
    if sag.any():
        held_force = plant.place_at_rest(start - sag, constant, actual)
    if setpoints.wound is not None:
        engine = plant.engine
        apart = engine.rotor_position != engine.load_position  # a rotor that does not turn by itself cannot be wound up
        engine.qpos[engine.rotor_position[apart]] += setpoints.wound[apart]
    state = cascade.drives_at_rest(drives, held_force * drives.ratio)
    _check_held(machine, state, drives)
    signals = np.zeros((len(machine.axes), SIGNAL_COUNT))
    return loop.Simulation(plant.engine, schedule, drives, state, term_table(actual.terms), signals)


def _stretches(schedule: loop.Schedule, total: int, lead_ticks: int) -> Iterator[tuple[int, int]]:
    """First tick and number of ticks of each call of the loop: the lead-in, then whole cycles of control and record."""
    if lead_ticks:
        yield -lead_ticks, lead_ticks
    cycle = int(np.lcm(schedule.position_ticks, schedule.record_ticks))
    stretch = cycle * max(1, STRETCH_TICKS // cycle)
    for first in range(0, max(total - 1, 1), stretch):
        # the last sample is no stretch of its own
        yield first, total - first if total - first <= stretch + 1 else stretch


def _divergence(
    machine: Machine, setpoints: Setpoints, record: loop_record.Record, schedule: loop.Schedule, failed: int
) -> SimulationError:
    """The error of an axis that left all bounds, with the trace up to there."""
    tick, axis = divmod(failed, len(machine.axes))
    rows, period = tick // schedule.record_ticks, schedule.record_ticks * schedule.tick
    return SimulationError(
        f"simulation diverges: axis {machine.axes[axis].name} at {tick * schedule.tick:.4f} s is faster than {DIVERGED_SPEED:g} times its limit; "
        "lower its gains or the size of its effects",
        _traces(machine, setpoints, record, rows, period)[0] if rows >= 2 else None,
    )


def _sag(machine: Machine, held_force: np.ndarray) -> np.ndarray:
    """Following error (axis,) [m, rad] with which a P speed controller holds a force at rest: F r^2 / (Kp Kv)."""
    return np.array(
        [
            0.0
            if axis.has_speed_integral
            else force * axis.ratio**2 / (axis.loops.speed_gain_nm_s_per_rad * axis.loops.position_gain_per_s)
            for axis, force in zip(machine.axes, held_force)
        ]
    )


def _check_held(machine: Machine, state: cascade.DriveState, drives: cascade.Drives) -> None:
    """An axis that its current limit cannot hold at rest would fall from the first tick on."""
    for a in np.flatnonzero(np.abs(state.current) > drives.peak_current):
        raise InputError(
            f"axis {machine.axes[a].name} cannot be held at its start: that takes {abs(state.current[a]):.3g} {machine.axes[a].effort_unit}, "
            f"its {machine.axes[a].effort} limit is {drives.peak_current[a]:.3g} {machine.axes[a].effort_unit}; "
            "raise the limit or lower what it carries"
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


def commissioned_inertia(machine: Machine) -> np.ndarray:
    """J_ff (axis,) [kg m2 at the motor]: the machine file's, or the model's in the home pose where the file has none."""
    known = [axis.commissioned_inertia for axis in machine.axes]
    if all(value is not None for value in known):
        return np.array(known, float)
    return np.where([value is None for value in known], home_inertia_at_motor(machine), np.array(known, float))


def _sensing(machine: Machine, rng: np.random.Generator | None, ticks: int) -> loop.Sensing:
    noises = [machine.noise(axis) for axis in machine.axes]
    if rng is None:
        noise = np.zeros((0, 0, 0))
    else:
        seen = [n.motor if axis.encoder == "motor" else n.position for n, axis in zip(noises, machine.axes)]
        noise = rng.standard_normal((ticks, len(noises), 3))
        noise *= np.array([[q, n.speed, n.current] for q, n in zip(seen, noises)])  # in place: a long run has tens of millions
    return loop.Sensing(
        noise=noise,
        position_resolution=np.array([n.position_resolution for n in noises]),
        motor_resolution=np.array([n.motor_resolution for n in noises]),
    )


def _traces(machine: Machine, setpoints: Setpoints, record: loop_record.Record, rows: int, period: float) -> tuple[Trace, Trace]:
    """The first rows of the record as the control's samples show it, and without noise."""
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
