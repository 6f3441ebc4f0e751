"""Prepared runs: machines that are ready to run, several of them in one compiled loop.

The arithmetic of one axis is a chain of dependent operations, so the processor mostly waits for latency. Prepared runs are independent of each
other and their chains overlap: eight prepared runs in one loop take a third to two thirds of the time of eight separate loops. The loop sees one
machine with the axes of all prepared runs. Each run keeps its own command, noise, terms and record and computes exactly the numbers that it
computes alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

import numpy as np

from twin.effects import Change, apply_effects
from twin.errors import InputError
from twin.limits import refuse_above
from twin.machine.machine import Machine, Noise
from twin.simulation import cascade, loop, loop_record
from twin.simulation.axis_table import AxisTable, axis_table, one_below_another
from twin.simulation.decoupled_plant import DecoupledPlant, joined
from twin.simulation.drive_load import NO_SUMS, DriveSums, empty_sums
from twin.simulation.loop_terms import SIGNAL_COUNT, of_first_rows, term_table
from twin.simulation.plant_spec import commissioned_inertia
from twin.simulation.position_command import Command, command_of
from twin.simulation.random_numbers import NormalNumbers
from twin.simulation.setpoints import Setpoints

MAX_RECORDED = 15_000_000
"""Largest record, in samples of all axes: 50 minutes of five axes at 1 kHz, 2 GB."""
MAX_TICKS = 1_000_000_000
"""Longest run in ticks: 35 hours at a tick of 125 us, which take hours to simulate."""
STRETCH_TICKS = 16_000
"""Ticks in one call of the loop. Bounds the memory of a run beside its trace, and the time between two progress reports."""

SILENT = Noise(*(0.0 for _ in fields(Noise)))
"""The noise of ideal sensors."""

DIVERGED_SPEED = 3.0
"""An axis that is faster than this multiple of its maximum speed has diverged."""


class PlantInterface(Protocol):
    """Mechanics of a run."""

    engine: loop.Engine

    def place_at_rest(self, start: np.ndarray, constant_force: np.ndarray, change: Change) -> np.ndarray:
        """Place load and rotor at `start` (axis,); returns the holding force at each axis."""


@dataclass(frozen=True)
class PreparedRun:
    """One machine at rest on its first set point.

    `actual` is the machine with its effects, `inertia` (axis,) [kg m2 at the motor] the commissioned inertia of the torque feedforward,
    `held_torque` (axis,) [Nm at the motor] the torque that the integrators carry at rest, `noise_seed` the seed of the measuring noise
    (None: no noise).
    """

    machine: Machine
    setpoints: Setpoints
    actual: Change
    plant: PlantInterface
    drives: AxisTable
    schedule: loop.Schedule
    inertia: np.ndarray
    held_torque: np.ndarray
    noise_seed: int | None
    count_load: bool

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.machine.axes)

    @property
    def period(self) -> float:
        """Sample period of the record [s]."""
        return self.schedule.record_ticks * self.schedule.tick

    @property
    def rows(self) -> int:
        """Samples of the record."""
        return int(np.floor(self.setpoints.duration / self.period + 1e-9)) + 1

    @property
    def ticks(self) -> int:
        """Ticks from the first sample to the last."""
        return (self.rows - 1) * self.schedule.record_ticks + 1

    @property
    def noise_key(self) -> object:
        """Prepared runs with equal keys draw the same random numbers."""
        return self.noise_seed, self.axes

    @property
    def batch_key(self) -> object:
        """Prepared runs with equal keys can share a loop; None: this run runs alone, because MuJoCo steps one machine at a time."""
        if not isinstance(self.plant, DecoupledPlant):
            return None
        s = self.schedule
        cycles = (s.tick, s.position_ticks, s.speed_ticks, s.current_ticks, s.record_ticks)
        return cycles, self.plant.times, self.count_load, self.setpoints.external_force is None


def prepared_run(
    machine: Machine,
    setpoints: Setpoints,
    plant_of: Callable[[Change], PlantInterface],
    *,
    sample_period: float | None = None,
    started_at: float = 0.0,
    noise_seed: int | None = None,
    count_load: bool = False,
) -> PreparedRun:
    """The machine with its effects, at rest; arguments as for `simulate`. Raises InputError if it cannot be held or recorded."""
    # effects change the machine, not the values that the control was commissioned with
    inertia = commissioned_inertia(machine)
    actual = _with_blocks(apply_effects(machine, started_at))
    actual.lead_ticks = round(setpoints.lead / machine.base_tick)
    schedule = _schedule(machine, sample_period)
    _check_length(machine, setpoints, schedule)
    plant = plant_of(actual)
    drives = cascade.drives_of(actual.machine)
    held = _place_at_rest(actual, plant, drives, setpoints)
    one = PreparedRun(machine, setpoints, actual, plant, drives, schedule, inertia, held, noise_seed, count_load)
    if one.rows < 2:
        raise InputError(
            f"a run of {setpoints.duration:.4g} s has less than two samples at a period of {one.period:.4g} s; record it more often"
        )
    return one


def _check_length(machine: Machine, setpoints: Setpoints, schedule: loop.Schedule) -> None:
    """Raise InputError if the record would exceed 2 GB or the simulation would take days."""
    ticks = (setpoints.duration + setpoints.lead) / schedule.tick
    run = f"a run of {setpoints.duration:.3g} s"
    remedy = "split the run, or record with a longer period"
    refuse_above(ticks / schedule.record_ticks * len(machine.axes), MAX_RECORDED, "samples to record", run, remedy)
    refuse_above(ticks, MAX_TICKS, "ticks to simulate", run, "split the run")


def _schedule(machine: Machine, sample_period: float | None) -> loop.Schedule:
    """Controller cycles and record period in ticks."""
    h = machine.base_tick
    return loop.Schedule(
        tick=h,
        position_ticks=round(machine.position_cycle / h),
        speed_ticks=round(machine.speed_cycle / h),
        current_ticks=round(machine.current_cycle / h),
        record_ticks=max(1, round((sample_period or machine.sample_period) / h)),
        speed_bound=DIVERGED_SPEED * np.array([axis.max_velocity for axis in machine.axes]),
        end=np.zeros(len(machine.axes), np.int64),  # set by _joined
    )


def _with_blocks(actual: Change) -> Change:
    """The change with the compiled laws of the blocks that the machine file lists; at each stage they precede the effects."""
    for axis in actual.machine.axes:
        for order, listed in enumerate(axis.blocks, start=-len(axis.blocks)):
            if listed.block.law is not None:
                constants = listed.block.constants(listed.values, actual.machine, axis.loops.position_gain_per_s)
                actual.add_term(listed.block.law, listed.block.stage, axis, constants, order=order)
    return actual


def _place_at_rest(actual: Change, plant: PlantInterface, drives: AxisTable, setpoints: Setpoints) -> np.ndarray:
    """Place the axes at the first set point with the recorded deflection of their drive trains.

    Returns the torque (axis,) [Nm at the motor] that holds gravity and constant forces.
    """
    start = setpoints.start - np.where(drives.on_motor_encoder, 0.0, actual.scale_offset)
    constant = actual.constant_force_at(start) + setpoints.external_force_at_start
    held_force = plant.place_at_rest(start, constant, actual)
    engine, places = plant.engine, plant.engine.places
    windup = np.where(drives.on_motor_encoder, engine.qpos[places.rotor_position] - engine.qpos[places.load_position], 0.0)
    # the load, behind the encoder that closes the loop
    behind = windup + [axis.loops.sag(force, axis.ratio) for axis, force in zip(actual.machine.axes, held_force)]
    if behind.any():
        held_force = plant.place_at_rest(start - behind, constant, actual)
    if setpoints.deflection is not None:
        moved = np.where(drives.on_motor_encoder, places.load_position, places.rotor_position)
        elastic = places.rotor_position != places.load_position  # a rigid drive train does not deflect
        engine.qpos[moved[elastic]] += np.where(drives.on_motor_encoder, -setpoints.deflection, setpoints.deflection)[elastic]
    held_torque = np.asarray(held_force * drives.ratio)
    _check_held(actual.machine, held_torque / drives.torque_constant, drives)
    return held_torque


def _check_held(machine: Machine, current: np.ndarray, drives: AxisTable) -> None:
    """Raise InputError if the holding `current` (axis,) exceeds the current limit: the axis would drop at the first tick."""
    for a in np.flatnonzero(np.abs(current) > drives.peak_current):
        raise InputError(
            f"axis {machine.axes[a].name} cannot be held at its start: it needs {abs(current[a]):.3g} {machine.axes[a].effort_unit}, "
            f"but its {machine.axes[a].effort} limit is {drives.peak_current[a]:.3g} {machine.axes[a].effort_unit}; "
            "raise the limit or reduce the load"
        )


@dataclass(frozen=True)
class LoopResults:
    """Results of prepared runs that have run in one loop; axes of all prepared runs in order.

    `record` is (row, axis, channel), `limited` (axis, 2) the cycles at the current and voltage limit, `load_sums` the drive loads.
    `diverged_at` is -1, or tick * axes + axis of the first divergence.
    """

    record: np.ndarray
    limited: np.ndarray
    load_sums: DriveSums
    diverged_at: int

    def of(self, prepared: Sequence[PreparedRun], i: int) -> LoopResults:
        """Results of run number `i`."""
        first = sum(one.axes for one in prepared[:i])
        axes = slice(first, first + prepared[i].axes)
        record = self.record[: prepared[i].rows, axes]
        load_sums = DriveSums(*(values[axes] for values in self.load_sums))
        return LoopResults(record, self.limited[axes], load_sums, -1)


def run_together(prepared: Sequence[PreparedRun], progress: Callable[[float], None] | None = None) -> LoopResults:
    """Run prepared runs of one `batch_key`, the longest first. A run that has ended leaves the loop."""
    simulation, memory = _joined(prepared)
    schedule, axes = simulation.schedule, len(simulation.signals)
    longest, running = prepared[0], list(prepared)
    record = loop_record.empty_record(longest.rows, axes)
    limited = np.zeros((axes, 2), np.int64)
    all_axes = tuple(axis for one in prepared for axis in one.machine.axes)
    load_sums = empty_sums(all_axes) if prepared[0].count_load else NO_SUMS
    sensing, random_numbers = _sensing(prepared), _random_numbers(prepared)
    for first, ticks in _stretches(schedule, longest.ticks, prepared[0].actual.lead_ticks):
        lead_in = first < 0  # nothing is recorded or counted before the first sample
        if running[-1].ticks <= first:
            running = [one for one in running if one.ticks > first]
            simulation, sensing = _of_first_axes(simulation, sensing, sum(one.axes for one in running))
            memory.keep([one.plant for one in running])
        diverged_at = loop.advance(
            simulation,
            _command(running, first // schedule.position_ticks, -(-ticks // schedule.position_ticks)),
            _with_noise(sensing, random_numbers, ticks),
            first,
            ticks,
            loop_record.empty_record(-first // schedule.record_ticks + 1, axes) if lead_in else record[first // schedule.record_ticks :],
            np.zeros_like(limited) if lead_in else limited,
            NO_SUMS if lead_in else load_sums,
        )
        if diverged_at >= 0:
            tick, axis = divmod(diverged_at, len(simulation.signals))
            return LoopResults(record, limited, load_sums, tick * axes + axis)
        if progress:
            progress((first + ticks) / longest.ticks)
    return LoopResults(record, limited, load_sums, -1)


def _of_first_axes(simulation: loop.Simulation, sensing: loop.Sensing, axes: int) -> tuple[loop.Simulation, loop.Sensing]:
    """Simulation and sensors of the first axes of the loop, which share the state of all."""
    engine, schedule, drives, state, sent, terms, signals = simulation
    return (
        loop.Simulation(
            engine._replace(places=engine.places[:axes]),
            schedule._replace(speed_bound=schedule.speed_bound[:axes], end=schedule.end[:axes]),
            drives[:axes],
            state[:axes],
            sent[:axes],
            of_first_rows(terms, axes),
            signals[:axes],
        ),
        sensing._replace(sensors=sensing.sensors[:axes]),
    )


def _joined(prepared: Sequence[PreparedRun]) -> tuple[loop.Simulation, Any]:
    """All prepared runs as one machine, and the owner of the memory that its engine addresses. Keep the owner alive while the loop runs."""
    plants = [one.plant for one in prepared]
    drives = one_below_another([one.drives for one in prepared])
    schedule = prepared[0].schedule._replace(
        speed_bound=np.concatenate([one.schedule.speed_bound for one in prepared]),
        end=np.repeat([one.ticks for one in prepared], [one.axes for one in prepared]),
    )
    first = np.cumsum([0, *(one.axes for one in prepared)]).tolist()
    terms = [replace(term, first=at) for one, at in zip(prepared, first) for term in one.actual.terms]
    memory = plants[0] if len(plants) == 1 else joined([plant for plant in plants if isinstance(plant, DecoupledPlant)])
    state = cascade.drives_at_rest(drives, np.concatenate([one.held_torque for one in prepared]))
    signals = np.zeros((first[-1], SIGNAL_COUNT))
    return loop.Simulation(
        memory.engine, schedule, drives, state, cascade.nothing_sent(drives), term_table(terms, first[-1]), signals
    ), memory


def _command(prepared: Sequence[PreparedRun], first_cycle: int, count: int) -> Command:
    """The command of all prepared runs over `count` position cycles. A run keeps its last set point after its end."""
    commands = [command_of(one.actual.machine, one.inertia, one.setpoints, first_cycle, count) for one in prepared]
    if len(prepared) == 1:
        return commands[0]
    return Command(
        np.concatenate([_padded(c.setpoint, count, one.setpoints.position[-1]) for one, c in zip(prepared, commands)], axis=1),
        np.concatenate([_padded(c.fed_step, count) for c in commands], axis=1),
        np.concatenate([_padded(c.velocity_feedforward, count) for c in commands], axis=1),
        np.concatenate([_padded(c.torque_feedforward, count) for c in commands], axis=1),
        commands[0].external_force
        if prepared[0].setpoints.external_force is None
        else np.concatenate([_padded(c.external_force, count) for c in commands], axis=1),
    )


def _padded(values: np.ndarray, count: int, last: np.ndarray | float = 0.0) -> np.ndarray:
    """Values (cycle, axis, ...) extended to `count` cycles with `last`."""
    missing = count - len(values)
    return values if missing <= 0 else np.concatenate([values, np.broadcast_to(last, (missing, *values.shape[1:]))])


def _random_numbers(prepared: Sequence[PreparedRun]) -> list[tuple[NormalNumbers, NormalNumbers]]:
    """Random numbers of each noise key, none without noise: for the sensors that the control reads, and for the encoder that no loop reads,
    independent of each other."""
    keys = {one.noise_key: (one.axes, one.noise_seed) for one in prepared if one.noise_seed is not None}
    return [(NormalNumbers(seed, (axes, 3)), NormalNumbers((seed, 1), (axes,))) for axes, seed in keys.values()]


def _sensing(prepared: Sequence[PreparedRun]) -> loop.Sensing:
    """Sensors of all prepared runs, without noise. Those with equal seeds share random numbers; each has the deviations of its own sensors, none for
    ideal ones beside them."""
    noise = [(axis.encoder, SILENT if one.noise_seed is None else one.machine.noise(axis)) for one in prepared for axis in one.machine.axes]
    axes_of = {one.noise_key: one.axes for one in prepared if one.noise_seed is not None}
    first = dict(zip(axes_of, np.cumsum([0, *axes_of.values()]).tolist()))
    encoders = [(n.motor, n.position) if encoder == "motor" else (n.position, n.motor) for encoder, n in noise]
    columns = loop.Sensors(
        row=np.concatenate(
            [first[one.noise_key] + np.arange(one.axes) if one.noise_key in first else np.zeros(one.axes, int) for one in prepared]
        ),
        closing=np.array([closing for closing, _ in encoders]),
        speed=np.array([n.speed for _, n in noise]),
        current=np.array([n.current for _, n in noise]),
        other=np.array([other for _, other in encoders]),
        position_resolution=np.array([n.position_resolution for _, n in noise]),
        motor_resolution=np.array([n.motor_resolution for _, n in noise]),
    )
    return loop.Sensing(drawn=np.zeros((0, 0, 3)), beside=np.zeros((0, 0)), sensors=axis_table(columns))


def _with_noise(sensing: loop.Sensing, random_numbers: Sequence[tuple[NormalNumbers, NormalNumbers]], ticks: int) -> loop.Sensing:
    """The sensors with their noise over the next stretch."""
    if not random_numbers:
        return sensing
    sensing = sensing._replace(drawn=_side_by_side([own.draw(ticks) for own, _ in random_numbers]))
    if not sensing.sensors.other.any():
        return sensing
    return sensing._replace(beside=_side_by_side([other.draw(ticks) for _, other in random_numbers]))


def _side_by_side(numbers: Sequence[np.ndarray]) -> np.ndarray:
    """Numbers (tick, axis, ...) of several noise keys in one array."""
    return numbers[0] if len(numbers) == 1 else np.concatenate(numbers, axis=1)


def _stretches(schedule: loop.Schedule, total: int, lead_ticks: int) -> Iterator[tuple[int, int]]:
    """First tick and tick count of each call of the loop: the lead-in, then multiples of the position cycle and the record period."""
    if lead_ticks:
        yield -lead_ticks, lead_ticks
    cycle = int(np.lcm(schedule.position_ticks, schedule.record_ticks))
    stretch = cycle * max(1, STRETCH_TICKS // cycle)
    for first in range(0, max(total - 1, 1), stretch):
        # a single remaining tick joins the last stretch
        yield first, total - first if total - first <= stretch + 1 else stretch
