"""The other way round: a measuring campaign for a machine, and how well each parameter will be known from it.

Every axis gets the same three kinds of moves, inside its travel and limits, one axis after the other or all together where they do not
disturb each other: constant speeds there and back from creeping to rapid (friction), accelerated moves (inertia, torque feedforward), and,
for a tilting table, slow turns of A over its range while C stands in several places (first moments). The predicted interval is that of the
regression on the planned moves themselves: the same rows as `identify` would build, the noise of the machine file. Runs are repeated until
the wanted precision is reached or the time is used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import json
import math
from pathlib import Path

import numpy as np

from twin.campaign import MeasuredRun
from twin.errors import InputError
from twin.identify import tilting_pair
from twin.identify.axis_run import axis_run
from twin.identify.direct import Direct, direct_route
from twin.identify.parameters import parameters_of
from twin.identify.products import split_products
from twin.machine import Axis, Machine
from twin.run import simulate
from twin.setpoints import Setpoints, check_travel
from twin.trace import Trace, write_trace
from twin.units import AXIS_UNITS

SHARE = 0.9
"""Share of speed, acceleration and travel that the moves use."""

LADDER = (0.03, 0.08, 0.2, 0.45, 0.9)
"""Constant speeds as shares of the highest speed."""

SPEED_TIME_S = 0.4
"""Time at each constant speed, where the travel allows it."""

DWELL_S = 0.15


@dataclass(frozen=True)
class PlannedRun:
    """One run: set points, feedforward to switch on, how often to repeat it, and its moves (axis -> (target, speed)) for the part program."""

    name: str
    feedforward: str
    setpoints: Setpoints
    repeats: int
    blocks: tuple[tuple[dict[str, float], float], ...]  # targets in axis units, path feed in axis units a second (of the first axis)

    @property
    def duration(self) -> float:
        return self.setpoints.duration


@dataclass(frozen=True)
class Predicted:
    """A parameter's predicted relative half interval (95 %) from the planned campaign."""

    axis: str
    name: str
    value: float
    unit: str
    half: float


@dataclass(frozen=True)
class Plan:
    """Runs and what they will tell."""

    runs: tuple[PlannedRun, ...]
    predicted: tuple[Predicted, ...]


def plan_campaign(
    machine: Machine, precision: float = 0.01, longest_s: float = 900.0, progress: Callable[[str], None] | None = None
) -> Plan:
    """Plan runs for every axis of the machine; repeats grow until each parameter is within `precision` or the time is used."""
    runs = [*_friction_runs(machine), *_acceleration_runs(machine), *_table_runs(machine)]
    if not runs:
        raise InputError(f"machine {machine.name}: no axis to plan for; describe at least one axis in the machine file")
    for run in runs:
        check_travel(run.setpoints, machine, f"planned run {run.name}")
    total = sum(r.duration for r in runs)
    if total > longest_s:
        raise InputError(f"one round of the plan takes {total:.0f} s, allowed are {longest_s:.0f} s; allow more with --minutes")
    once = _predict(machine, runs, progress)
    # precision improves with the root of the repeats; the part that repeating does not improve is the law's doubt
    worst = max((p.half for p in once), default=0.0)
    repeats = int(np.clip(math.ceil((worst / precision) ** 2), 1, max(1, int(longest_s // total))))
    final = [replace(p, half=p.half / math.sqrt(repeats)) for p in once]
    return Plan(tuple(replace(r, repeats=repeats) for r in runs), tuple(final))


def move(distance: float, speed: float, acceleration: float, jerk: float, period: float) -> np.ndarray:
    """Jerk-limited rest-to-rest move from 0 (sample,): a speed pulse smoothed by two boxes of v/a and a/j, slowed where it is short."""
    length = abs(distance)
    if length == 0.0:
        return np.zeros(1)
    a = min(acceleration, math.sqrt(speed * jerk))
    while speed * (speed / a + a / jerk) > length:
        speed *= 0.95
        a = min(a, math.sqrt(speed * jerk))
    boxes = [max(1, math.ceil(t / period)) for t in (length / speed, speed / a, a / jerk)]
    pulse = np.ones(1)
    for n in boxes:
        pulse = np.convolve(pulse, np.full(n, 1.0 / n))
    return math.copysign(length, distance) * np.concatenate([[0.0], np.cumsum(pulse)])


def _reach(axis: Axis) -> tuple[float, float]:
    """Middle and half width of the stretch that moves use: travel, at most 0.45 m or 140 degrees each way."""
    low, high = axis.travel
    widest = 0.45 if axis.kind == "linear" else math.radians(140.0)
    if not math.isfinite(low) or not math.isfinite(high):
        return 0.0, widest
    return 0.5 * (low + high), min(SHARE * 0.5 * (high - low), widest)


def _path(machine: Machine, start: dict[str, float], moves: Sequence[tuple[str, float, float]], name: str, feedforward: str) -> PlannedRun:
    """Moves (axis, target, speed) one after the other with dwells."""
    period = machine.sample_period
    at = dict(start)
    rows = [np.tile(list(at.values()), (round(DWELL_S / period), 1))]
    order = list(at)
    blocks = []
    for axis_name, target, speed in moves:
        axis = machine.axis(axis_name)
        shape = move(target - at[axis_name], speed, SHARE * axis.max_acceleration, SHARE * axis.max_jerk, period)
        part = np.tile(list(at.values()), (len(shape), 1))
        part[:, order.index(axis_name)] += shape
        at[axis_name] = target
        blocks.append(({axis_name: target}, speed))
        rows += [part[1:], np.tile(list(at.values()), (round(DWELL_S / period), 1))]
    return PlannedRun(name, feedforward, Setpoints(np.vstack(rows), period), 1, tuple(blocks))


def _home(machine: Machine) -> dict[str, float]:
    return {axis.name: _reach(axis)[0] for axis in machine.axes}


def _friction_runs(machine: Machine) -> list[PlannedRun]:
    """Constant speeds there and back, every axis by itself."""
    moves = []
    for axis in machine.axes:
        middle, half = _reach(axis)
        for share in LADDER:
            v = SHARE * share * axis.max_velocity
            ramp = v * (v / (SHARE * axis.max_acceleration) + SHARE * axis.max_acceleration / (SHARE * axis.max_jerk))
            stretch = min(half, 0.5 * (v * SPEED_TIME_S + ramp))
            moves += [(axis.name, middle + stretch, v), (axis.name, middle - stretch, v)]
        moves.append((axis.name, middle, SHARE * 0.45 * axis.max_velocity))
    return [_path(machine, _home(machine), moves, "plan_constant_speeds", "velocity")]


def _acceleration_runs(machine: Machine) -> list[PlannedRun]:
    """Accelerated moves of two lengths, with feedforward and without."""
    moves = []
    for axis in machine.axes:
        middle, half = _reach(axis)
        short = min(half, (0.06 if axis.kind == "linear" else math.radians(25.0)))
        for reach in (short, -short, short, -short, 0.5 * (short + half) if short < half else short):
            moves.append((axis.name, middle + reach, SHARE * axis.max_velocity))
        moves.append((axis.name, middle, SHARE * axis.max_velocity))
    return [_path(machine, _home(machine), moves, f"plan_accelerations_{f.replace('+', '_')}", f) for f in ("off", "velocity+torque")]


def _table_runs(machine: Machine) -> list[PlannedRun]:
    """Slow turns of A over its range at several C, and of C at several A."""
    if not tilting_pair.has_pair(machine):
        return []
    a, c = machine.axis("A"), machine.axis("C")
    low, high = (SHARE * v for v in a.travel)
    slow_a, slow_c = 0.35 * a.max_velocity, 0.5 * c.max_velocity
    moves = []
    for turn in (0.0, 0.5 * math.pi, math.pi):
        moves += [("C", turn, slow_c), ("A", low, slow_a), ("A", high, slow_a)]
    for tilt in (low, 0.5 * low):
        moves += [("A", tilt, slow_a), ("C", 0.0, slow_c), ("C", math.pi, slow_c)]
    return [_path(machine, _home(machine), moves, "plan_table", "velocity+torque")]


def _predict(machine: Machine, runs: Sequence[PlannedRun], progress: Callable[[str], None] | None) -> list[Predicted]:
    """Identify the machine from its own simulated plan, noise and all, and take the intervals."""
    measured = []
    for i, run in enumerate(runs):
        trace = simulate(machine.with_feedforward(run.feedforward), run.setpoints, noise_seed=i).trace
        measured.append(MeasuredRun(run.name, trace, run.feedforward, 0.0))
        if progress:
            progress(f"simulating {run.name}")
    seen = {axis.name: [axis_run(machine, axis, r) for r in measured] for axis in machine.axes}
    direct = direct_route(machine, seen, None, progress)
    parameters = parameters_of(machine, direct, Direct(), split_products(machine, direct))
    out = []
    wanted = (
        "inertia",
        "coulomb_friction",
        "viscous_friction",
        "gravity_torque",
        "moment_y",
        "moment_z",
        "table_x",
        "table_y",
        "position_delay_s",
    )
    for p in parameters:
        if p.name in (*wanted, "velocity_feedforward", "torque_feedforward", "position_gain_per_s") and p.before:
            out.append(Predicted(p.axis, p.name, p.before, p.unit, p.estimate.half / abs(p.before)))
    return out


def write_plan(plan: Plan, machine: Machine, out: Path) -> list[Path]:
    """Part programs (Siemens), set points (Parquet), a campaign.toml to fill with recordings, and plan.json."""
    out.mkdir(parents=True, exist_ok=True)
    files = []
    for run in plan.runs:
        signals = {(a.name, "setpoint"): run.setpoints.position[:, i] for i, a in enumerate(machine.axes)}
        trace = Trace(np.arange(len(run.setpoints.position)) * run.setpoints.period, signals, machine.kinds)
        write_trace(trace, out / f"{run.name}.parquet")
        (out / f"{run.name}.mpf").write_text(siemens_program(run, machine), encoding="utf-8")
        files += [out / f"{run.name}.mpf", out / f"{run.name}.parquet"]
    document = {
        "machine": machine.name,
        "runs": [{"name": r.name, "feedforward": r.feedforward, "duration_s": r.duration, "repeats": r.repeats} for r in plan.runs],
        "predicted": [{"axis": p.axis, "name": p.name, "value": p.value, "unit": p.unit, "half_interval": p.half} for p in plan.predicted],
    }
    (out / "plan.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    return [*files, out / "plan.json"]


def siemens_program(run: PlannedRun, machine: Machine) -> str:
    """The moves as a part program for a Sinumerik: exact stops, feed of one axis in mm/min or deg/min, dwells between."""
    words = {"off": "FFWOF", "velocity": "FFWON", "velocity+torque": "FFWON"}
    lines = [
        f"; {run.name}: feedforward '{run.feedforward}' - set the axes' feedforward mode (MD32620) to it before the run",
        "G90 G71 G94 G60 G500 D0",
        "SOFT",
        words[run.feedforward],
    ]
    start = {a.name: run.setpoints.position[0, i] for i, a in enumerate(machine.axes)}
    lines.append("G0 " + " ".join(_word(machine.axis(name), value) for name, value in start.items()))
    lines += ["R1=0", "AGAIN:", f"G4 F{DWELL_S:g}"]
    for targets, speed in run.blocks:
        for name, target in targets.items():
            axis = machine.axis(name)
            feed = speed * AXIS_UNITS[axis.kind].position[1] * 60.0
            lines += [f"G1 {_word(axis, target)} F{feed:.1f}", f"G4 F{DWELL_S:g}"]
    lines += [
        "G0 " + " ".join(_word(machine.axis(name), value) for name, value in start.items()),
        "R1=R1+1",
        f"IF R1<{run.repeats} GOTOB AGAIN",
        "M30",
    ]
    return (
        "\n".join(
            f"N{10 * (i + 1)} {line}" if not line.startswith(";") and not line.endswith(":") else line for i, line in enumerate(lines)
        )
        + "\n"
    )


def _word(axis: Axis, value: float) -> str:
    """Position word of an axis: 'X12.5' or 'A=-35.' in mm or degrees."""
    number = f"{value * AXIS_UNITS[axis.kind].position[1]:.4f}"
    return f"{axis.name}={number}"
