"""One machine on its set points, ready to run, and several of them side by side in one compiled loop.

A processor waits for most of what an axis computes: each number needs the one before it. Machines beside each other do not need each
other's numbers, so that eight of them take a third to two thirds of the time that they take one after another. To the loop they are one machine with
the axes of all; each keeps its own command, noise, terms and record, and its numbers are those that it has alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from twin.effects import Change, apply_effects
from twin.errors import InputError
from twin.limits import refuse_above
from twin.machine.machine import Machine
from twin.simulation import cascade, loop, loop_record
from twin.simulation.decoupled_plant import DecoupledPlant, SideBySide
from twin.simulation.drive_load import NOTHING_COUNTED, DriveSums, drive_sums
from twin.simulation.loop_terms import SIGNAL_COUNT, term_table
from twin.simulation.plant_spec import home_inertia_at_motor
from twin.simulation.setpoints import Command, Setpoints, command_of

MOST_RECORDED = 15_000_000
"""Samples of all axes of a record: 50 minutes of five axes at 1 kHz, 2 GB."""
MOST_TICKS = 1_000_000_000
"""35 hours of a machine with a tick of 125 us; hours of simulation."""
STRETCH_TICKS = 16_000
"""Ticks advanced in one call of the loop. It bounds the memory that a run needs beside its trace, and the time between two progress reports."""

DIVERGED_SPEED = 3.0
"""Multiple of its highest speed beyond which an axis has diverged."""


class PlantFace(Protocol):
    """What a run asks of the mechanics: an engine for the loop, and a start at rest."""

    engine: loop.Engine

    def place_at_rest(self, start: np.ndarray, constant_force: np.ndarray, change: Change) -> np.ndarray:
        """Put load and rotor on the start (axis,); returns the force at each axis that holds it there."""


@dataclass(frozen=True)
class Lane:
    """One machine at rest on its first set point.

    `actual` is the machine with its effects, `inertia` (axis,) [kg m2 at the motor] the one that its torque feedforward is commissioned with,
    `held_torque` (axis,) [Nm at the motor] what its integrators carry, `noise_seed` that of its measuring noise (None: ideal).
    """

    machine: Machine
    setpoints: Setpoints
    actual: Change
    plant: PlantFace
    drives: cascade.Drives
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
        """Ticks from the first sample to the last one."""
        return (self.rows - 1) * self.schedule.record_ticks + 1

    @property
    def draws(self) -> object:
        """Lanes with the same draw the same numbers for their noise."""
        return self.noise_seed, self.axes

    @property
    def fits_beside(self) -> object:
        """Lanes with the same can be put side by side; None: the engine advances this one alone."""
        if not isinstance(self.plant, DecoupledPlant):
            return None
        s = self.schedule
        cycles = (s.tick, s.position_ticks, s.speed_ticks, s.current_ticks, s.record_ticks)
        return cycles, self.plant.times, self.noise_seed is None, self.count_load, self.setpoints.outside is None


def lane_of(
    machine: Machine,
    setpoints: Setpoints,
    plant_of: Callable[[Change], PlantFace],
    *,
    sample_period: float | None = None,
    started_at: float = 0.0,
    noise_seed: int | None = None,
    count_load: bool = False,
) -> Lane:
    """The machine with its effects at rest; the arguments are those of `simulate`. Raises InputError where it cannot be held or recorded."""
    # what the control was commissioned with stays; what the machine really is comes from file and effects
    inertia = commissioned_inertia(machine)
    actual = apply_effects(machine, started_at)
    actual.lead_ticks = round(setpoints.lead / machine.base_tick)
    schedule = _schedule(machine, sample_period)
    _check_length(machine, setpoints, schedule)
    plant = plant_of(actual)
    drives = cascade.drives_of(actual.machine)
    held = _place_at_rest(actual, plant, drives, setpoints)
    lane = Lane(machine, setpoints, actual, plant, drives, schedule, inertia, held, noise_seed, count_load)
    if lane.rows < 2:
        raise InputError(f"a run of {setpoints.duration:.4g} s has one sample every {lane.period:.4g} s: record it more often")
    return lane


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
        end=np.zeros(len(machine.axes), np.int64),  # set where the lanes are joined
    )


def _place_at_rest(actual: Change, plant: PlantFace, drives: cascade.Drives, setpoints: Setpoints) -> np.ndarray:
    """Put the axes on the first set point, drive trains wound up as recorded; the torque (axis,) [Nm at the motor] that holds gravity and constant forces."""
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
    held_torque = np.asarray(held_force * drives.ratio)
    _check_held(actual.machine, held_torque / drives.torque_constant, drives)
    return held_torque


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


def _check_held(machine: Machine, current: np.ndarray, drives: cascade.Drives) -> None:
    """Refuse an axis that its current limit cannot hold at rest, with `current` (axis,): it would fall from the first tick on."""
    for a in np.flatnonzero(np.abs(current) > drives.peak_current):
        raise InputError(
            f"axis {machine.axes[a].name} cannot be held at its start: that takes {abs(current[a]):.3g} {machine.axes[a].effort_unit}, "
            f"its {machine.axes[a].effort} limit is {drives.peak_current[a]:.3g} {machine.axes[a].effort_unit}; "
            "raise the limit or lower what it carries"
        )


def commissioned_inertia(machine: Machine) -> np.ndarray:
    """J_ff (axis,) [kg m2 at the motor]: the machine file's, or the model's in the home pose where the file has none."""
    known = [axis.commissioned_inertia for axis in machine.axes]
    if all(value is not None for value in known):
        return np.array(known, float)
    return np.where([value is None for value in known], home_inertia_at_motor(machine), np.array(known, float))


@dataclass(frozen=True)
class Advanced:
    """Lanes that have run: their record (row, axis of all), cycles at the limits (axis, 2), what their drives gave; `failed` is -1, or tick
    * axes + axis where one diverged."""

    record: loop_record.Record
    limited: np.ndarray
    counted: DriveSums
    failed: int

    def of(self, lanes: Sequence[Lane], i: int) -> Advanced:
        """That of lane `i` alone."""
        first = sum(lane.axes for lane in lanes[:i])
        axes = slice(first, first + lanes[i].axes)
        record = loop_record.Record(*(values[: lanes[i].rows, axes] for values in self.record))
        counted = self.counted._replace(
            sums=self.counted.sums[axes], torque=self.counted.torque[axes], classes_per_speed=self.counted.classes_per_speed[axes]
        )
        return Advanced(record, self.limited[axes], counted, -1)


def advance(lanes: Sequence[Lane], progress: Callable[[float], None] | None = None) -> Advanced:
    """Run lanes that fit beside each other to the end of the longest; those that end earlier stand from there on."""
    simulation, _memory = _joined(lanes)
    schedule, axes = simulation.schedule, len(simulation.signals)
    longest = max(lanes, key=lambda lane: lane.ticks)
    record = loop_record.empty_record(longest.rows, axes)
    limited = np.zeros((axes, 2), np.int64)
    of_all = tuple(axis for lane in lanes for axis in lane.machine.axes)
    counted = drive_sums(of_all) if lanes[0].count_load else NOTHING_COUNTED
    generators = {lane.draws: np.random.default_rng(lane.noise_seed) for lane in lanes}
    for first, ticks in _stretches(schedule, longest.ticks, lanes[0].actual.lead_ticks):
        lead = first < 0  # before the first sample nothing is recorded or counted
        failed = loop.advance(
            simulation,
            _command(lanes, first // schedule.position_ticks, -(-ticks // schedule.position_ticks)),
            _sensing(lanes, generators, ticks),
            first,
            ticks,
            loop_record.empty_record(-first // schedule.record_ticks + 1, axes) if lead else record.rows(first // schedule.record_ticks),
            np.zeros_like(limited) if lead else limited,
            NOTHING_COUNTED if lead else counted,
        )
        if failed >= 0:
            return Advanced(record, limited, counted, failed)
        if progress:
            progress((first + ticks) / longest.ticks)
    return Advanced(record, limited, counted, -1)


def _joined(lanes: Sequence[Lane]) -> tuple[loop.Simulation, object]:
    """All lanes as one machine, and the owner of the memory behind the addresses of its engine: it must live as long as the loop runs."""
    plants = [lane.plant for lane in lanes]
    drives = cascade.Drives(*(np.concatenate(values) for values in zip(*(lane.drives for lane in lanes))))
    schedule = lanes[0].schedule._replace(
        speed_bound=np.concatenate([lane.schedule.speed_bound for lane in lanes]),
        end=np.repeat([lane.ticks for lane in lanes], [lane.axes for lane in lanes]),
    )
    first = np.cumsum([0, *(lane.axes for lane in lanes)]).tolist()
    terms = [replace(term, first=at) for lane, at in zip(lanes, first) for term in lane.actual.terms]
    memory = plants[0] if len(plants) == 1 else SideBySide([plant for plant in plants if isinstance(plant, DecoupledPlant)])
    state = cascade.drives_at_rest(drives, np.concatenate([lane.held_torque for lane in lanes]))
    signals = np.zeros((first[-1], SIGNAL_COUNT))
    return loop.Simulation(memory.engine, schedule, drives, state, term_table(terms, first[-1]), signals), memory


def _command(lanes: Sequence[Lane], first_cycle: int, count: int) -> Command:
    """The command of all lanes over `count` position cycles; a lane that has ended keeps its last set point."""
    commands = [command_of(lane.actual.machine, lane.inertia, lane.setpoints, first_cycle, count) for lane in lanes]
    if len(lanes) == 1:
        return commands[0]
    return Command(
        np.concatenate([_held_on(lane, c.setpoint, count) for lane, c in zip(lanes, commands)], axis=1),
        np.concatenate([_to_length(c.velocity_feedforward, count) for c in commands], axis=1),
        np.concatenate([_to_length(c.torque_feedforward, count) for c in commands], axis=1),
        commands[0].outside
        if lanes[0].setpoints.outside is None
        else np.concatenate([_to_length(c.outside, count) for c in commands], axis=1),
    )


def _held_on(lane: Lane, setpoint: np.ndarray, count: int) -> np.ndarray:
    """Set points (cycle, axis) with the last one of the lane in the cycles behind its end."""
    missing = count - len(setpoint)
    return setpoint if missing <= 0 else np.concatenate([setpoint, np.tile(lane.setpoints.position[-1], (missing, 1))])


def _to_length(values: np.ndarray, count: int) -> np.ndarray:
    """Values (cycle, ...) with nothing in the cycles behind their end."""
    missing = count - len(values)
    return values if missing <= 0 else np.concatenate([values, np.zeros((missing, *values.shape[1:]))])


def _sensing(lanes: Sequence[Lane], generators: dict[object, np.random.Generator], ticks: int) -> loop.Sensing:
    """Noise of all lanes over a stretch: lanes with one seed have the same, each in the size of its machine."""
    noises = [[lane.machine.noise(axis) for axis in lane.machine.axes] for lane in lanes]
    if lanes[0].noise_seed is None:
        noise = np.zeros((0, 0, 0))
    else:
        drawn = {key: generators[key].standard_normal((ticks, axes, 3)) for key, axes in {lane.draws: lane.axes for lane in lanes}.items()}
        noise = np.empty((ticks, sum(lane.axes for lane in lanes), 3))
        at = 0
        for lane, of_lane in zip(lanes, noises):
            seen = [n.motor if axis.encoder == "motor" else n.position for n, axis in zip(of_lane, lane.machine.axes)]
            sizes = np.array([[q, n.speed, n.current] for q, n in zip(seen, of_lane)])
            np.multiply(drawn[lane.draws], sizes, out=noise[:, at : at + lane.axes])
            at += lane.axes
    flat = [n for of_lane in noises for n in of_lane]
    return loop.Sensing(
        noise=noise,
        position_resolution=np.array([n.position_resolution for n in flat]),
        motor_resolution=np.array([n.motor_resolution for n in flat]),
    )


def _stretches(schedule: loop.Schedule, total: int, lead_ticks: int) -> Iterator[tuple[int, int]]:
    """First tick and number of ticks of each call of the loop: the lead-in, then whole cycles of control and record."""
    if lead_ticks:
        yield -lead_ticks, lead_ticks
    cycle = int(np.lcm(schedule.position_ticks, schedule.record_ticks))
    stretch = cycle * max(1, STRETCH_TICKS // cycle)
    for first in range(0, max(total - 1, 1), stretch):
        # the last sample is no stretch of its own
        yield first, total - first if total - first <= stretch + 1 else stretch
