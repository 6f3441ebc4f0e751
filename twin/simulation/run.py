"""One run of the twin: set points and a machine in, a trace of the same form as a measured one out.

    set points -> command of the position cycles -> cascade + plant (one compiled loop) -> trace

`simulate` is the whole of it; start reading here.
"""

from __future__ import annotations

from collections.abc import Callable
import itertools
from typing import Protocol

import numpy as np

from twin.effects import Change, apply_effects
from twin.errors import InputError, SimulationError
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation import cascade, loop
from twin.simulation.loop_terms import SIGNAL_COUNT, X_LOAD_SPEED, term_table
from twin.simulation.mujoco_plant import FullPlant
from twin.simulation.plant_spec import home_inertia_at_motor
from twin.simulation.result import Run
from twin.simulation.setpoints import Setpoints, check_travel, command_of, setpoints_of

STRETCH_TICKS = 16_000
"""Ticks that are advanced in one call: bounds the memory of a run beyond its trace, and the time between two reports."""

SPLINE_SAMPLES = 20_000
"""Set points that are interpolated in one go for the record."""

DIVERGED_SPEED = 3.0
"""An axis faster than this multiple of its highest speed has left every bound that its control would allow."""

SWINGS_AT_REST = 8
"""So many turns from one current limit to the other after the last set point are no settling."""

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
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Simulate the machine with its effects on these set points, (sample, axis) in the machine's axis order, SI.

    A trace with set points is taken as it is recorded; an axis without set points stands still.
    `sample_period` [s] of the record (default: the machine file's), rounded to whole ticks; `started_at` [s] since the
    start of the campaign, for what drifts; `noise_seed` adds the measuring noise of the machine file to what the control sees
    (None: ideal). `plant_of` makes the mechanics (default: MuJoCo). `progress` is called with the done fraction. Raises
    SimulationError (with the trace up to there) where an axis diverges, InputError where it cannot be held at its start.
    """
    if isinstance(setpoints, Trace):
        setpoints = setpoints_of(setpoints, machine)
        check_travel(setpoints, machine, "simulate")
    # what the control was commissioned with stays; what the machine really is comes from file and effects
    inertia = commissioned_inertia(machine)
    actual = apply_effects(machine, started_at)
    actual.lead_ticks = round(setpoints.lead / machine.base_tick)
    plant = (plant_of or FullPlant)(actual)
    drives = cascade.drives_of(actual.machine)
    terms = term_table(actual.terms)

    # at rest on the first set point, integrators carrying gravity and constant forces
    start = setpoints.start - actual.scale_offset
    held_force = plant.place_at_rest(start, actual.constant_force, actual)
    sag = _sag(actual.machine, held_force)
    if sag.any():
        held_force = plant.place_at_rest(start - sag, actual.constant_force, actual)
    state = cascade.drives_at_rest(drives, held_force * drives.ratio)
    _check_held(machine, state, drives)
    signals = np.zeros((len(machine.axes), SIGNAL_COUNT))
    signals[:, X_LOAD_SPEED] = 0.0

    h = machine.base_tick
    record_ticks = max(1, round((sample_period or machine.sample_period) / h))
    position_ticks = round(machine.position_cycle / h)
    schedule = loop.Schedule(
        tick=h,
        position_ticks=position_ticks,
        speed_ticks=round(machine.speed_cycle / h),
        current_ticks=round(machine.current_cycle / h),
        record_ticks=record_ticks,
        speed_bound=DIVERGED_SPEED * np.array([axis.max_velocity for axis in machine.axes]),
    )
    rng = None if noise_seed is None else np.random.default_rng(noise_seed)

    rows = int(np.floor(setpoints.duration / (record_ticks * h) + 1e-9)) + 1
    if rows < 2:
        raise InputError(f"a run of {setpoints.duration:.4g} s has one sample every {record_ticks * h:.4g} s: record it more often")
    record = np.empty((rows, len(machine.axes), len(loop.RECORDED) + len(loop.MEASURED)))
    limited = np.zeros((len(machine.axes), 2), np.int64)
    total = (rows - 1) * record_ticks + 1
    stretch = int(np.lcm(position_ticks, record_ticks)) * max(1, STRETCH_TICKS // int(np.lcm(position_ticks, record_ticks)))
    for first in (*([-actual.lead_ticks] if actual.lead_ticks else []), *range(0, max(total - 1, 1), stretch)):
        # the last sample is no stretch of its own
        ticks = -first if first < 0 else total - first if total - first <= stretch + 1 else stretch
        command = command_of(actual.machine, inertia, setpoints, first // position_ticks, -(-ticks // position_ticks))
        failed = loop.advance(
            plant.engine,
            schedule,
            drives,
            state,
            terms,
            signals,
            command,
            _sensing(machine, rng, ticks),
            first,
            ticks,
            record[first // record_ticks :] if first >= 0 else np.empty((-first // record_ticks + 1, *record.shape[1:])),
            limited if first >= 0 else np.zeros_like(limited),
        )
        if failed >= 0:
            tick, axis = divmod(failed, len(machine.axes))
            kept = _traces(machine, setpoints, record[: tick // record_ticks], record_ticks * h)[0] if tick >= 2 * record_ticks else None
            raise SimulationError(
                f"simulation diverges: axis {machine.axes[axis].name} at {tick * h:.4f} s is faster than {DIVERGED_SPEED:g} times its limit; "
                "lower its gains or the size of its effects",
                kept,
            )
        if progress:
            progress((first + ticks) / total)
    names = machine.axis_names
    trace, without_noise = _traces(machine, setpoints, record, record_ticks * h)
    _check_standing(trace, machine, drives)
    return Run(
        trace,
        without_noise,
        dict(zip(names, (limited[:, loop.CURRENT_LIMIT] * machine.speed_cycle).tolist())),
        dict(zip(names, (limited[:, loop.VOLTAGE_LIMIT] * machine.current_cycle).tolist())),
        machine,
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


def _traces(machine: Machine, setpoints: Setpoints, record: np.ndarray, period: float) -> tuple[Trace, Trace]:
    """The record as the control's samples show it, and without noise."""
    time = np.arange(len(record)) * period
    # in parts, so that the splines of a long program need no more memory than a short one's
    parts = -(-max(len(time), len(setpoints.position)) // SPLINE_SAMPLES)
    ends = np.linspace(0, len(time), parts + 1).astype(int).tolist()
    positions = np.concatenate([setpoints.at_cycles(i, j - i, period, [0.0])[0] for i, j in itertools.pairwise(ends) if j > i])
    signals = {}
    for a, axis in enumerate(machine.axes):
        signals[axis.name, "setpoint"] = positions[:, a]
        for c, channel in enumerate(loop.RECORDED):
            if channel == "drive_velocity_setpoint" and not axis.loops.dsc_delay_s:
                continue  # the NC's own
            if axis.effort != "current" and channel in ("current", "current_setpoint"):
                continue  # an axis without current: its command, a voltage or the torque
            signals[axis.name, channel] = record[:, a, c]
        if axis.effort == "voltage":
            signals[axis.name, axis.effort] = record[:, a, loop.RECORDED.index("current")]
    seen = dict(signals)
    for a, axis in enumerate(machine.axes):
        for c, channel in enumerate(loop.MEASURED, len(loop.RECORDED)):
            key = (axis.name, axis.effort if channel == "current" else channel)
            if key != (axis.name, "torque"):  # a command is no measurement
                seen[key] = record[:, a, c]
    return Trace(time, seen, machine.kinds), Trace(time, signals, machine.kinds)
