"""Plan a measuring campaign for a machine and predict the interval of each parameter.

Every axis makes the same moves inside its travel and limits, one axis after the other: constant speeds in both directions from creeping to
rapid (friction), and accelerated moves with and without feedforward (inertia, weights, gains). A rotary pair adds slow turns of each
of its axes at several angles of the other (first moments). The last run moves all axes at once; `identify` holds it out as a check.

The predicted interval is that of a regression on the planned moves, simulated with the noise of the machine file. After n rounds it is
    half(n)^2 = law^2 + scatter^2 / n
The scatter decreases with the number of rounds, the error of the laws does not. Regressions on one round and on two separate them. A real
drive adds cogging and pre-sliding; docs/identify.md shows how much wider the intervals are on a plant that has them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import functools
import math
from pathlib import Path

import numpy as np

from twin.control import position_controller, speed_controller
from twin.errors import InputError
from twin.files import write_json, write_whole
from twin.geometry.scurve import jerk_limited_move, sample_times, time_of_move
from twin.identify.axis_run import Runs, axis_run
from twin.identify.drive_balance import FRICTIONS
from twin.identify.parameters import parameters_of
from twin.identify.regressions import regress_blocks
from twin.identify.result import Parameter
from twin.identify.rotary_pair import FIRST_MOMENTS, pair_of
from twin.identify.torque_constants import split_products
from twin.limits import MOST_SETPOINTS, refuse_above
from twin.machine.machine import Axis, Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import write_trace
from twin.simulation.decoupled_plant import DecoupledPlant
from twin.simulation.nominal_motion import nominal_motion
from twin.simulation.plant_spec import with_commissioned_inertia
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints, check_travel, trace_of
from twin.units import AXIS_UNITS

SHARE = 0.9
"""Share of the permitted speed, acceleration and travel that the moves use."""

LADDER = (0.03, 0.08, 0.2, 0.45, 0.9)
"""Constant speeds as shares of the permitted speed."""

SPEED_TIME_S = 0.4
"""Time at each constant speed, where the travel allows it."""

DWELL_S = 0.15


@dataclass(frozen=True)
class PlannedRun:
    """One run: set points, feedforward mode, number of repeats, and its moves (axis -> (target, speed)) for the part program."""

    name: str
    feedforward: str
    setpoints: Setpoints
    repeats: int
    blocks: tuple[tuple[dict[str, float], float], ...]  # targets in axis units, feed in axis units a second

    @property
    def duration(self) -> float:
        return self.setpoints.duration


@dataclass(frozen=True)
class Predicted:
    """A parameter's predicted relative half interval (95 %) after all rounds, and the part of it that more rounds do not reduce (`law`)."""

    axis: str
    name: str
    value: float
    unit: str
    half: float
    law: float


@dataclass(frozen=True)
class Plan:
    """Planned runs and the predicted interval of each parameter."""

    runs: tuple[PlannedRun, ...]
    predicted: tuple[Predicted, ...]


def plan_campaign(
    machine: Machine, precision: float = 0.01, longest_s: float = 900.0, progress: Callable[[str], None] | None = None
) -> Plan:
    """Plan runs for every axis of the machine, with as many repeats as `precision` needs and `longest_s` [s] allows."""
    if machine.sample_period > DWELL_S:
        raise InputError(
            f"[measurement]: sample_period_us = {machine.sample_period * 1e6:g}: a plan has dwells of {DWELL_S:g} s; use at most {DWELL_S * 1e6:g}"
        )
    runs = [constant_speeds(machine, machine.axes), *_acceleration_runs(machine), *_table_runs(machine), *_check_runs(machine)]
    for run in runs:
        check_travel(run.setpoints, machine, f"planned run {run.name}")
    total = sum(r.duration for r in runs)
    if total > longest_s:
        raise InputError(f"one round of the plan takes {total:.0f} s, but only {longest_s:.0f} s are allowed; raise --minutes")
    parts = _predict(machine, runs[:-1], progress)
    # rounds for the least precise parameter, of those that can reach the precision by repeating
    needed = [scatter**2 / (precision**2 - law**2) for _, law, scatter in parts if law < 0.95 * precision]
    repeats = int(np.clip(math.ceil(max(needed, default=1.0)), 1, max(1, int(longest_s // total))))
    final = [Predicted(p.axis, p.name, p.before, p.unit, math.hypot(law, scatter / math.sqrt(repeats)), law) for p, law, scatter in parts]
    return Plan(tuple(replace(r, repeats=repeats) for r in runs), tuple(final))


def _reach(axis: Axis) -> tuple[float, float]:
    """Middle and half width of the range of the moves: the travel, at most 0.45 m or 140 degrees each way."""
    low, high = axis.travel
    widest = 0.45 if axis.kind == "linear" else math.radians(140.0)
    if not math.isfinite(low) or not math.isfinite(high):
        return 0.0, widest
    return 0.5 * (low + high), min(SHARE * 0.5 * (high - low), widest)


Move = tuple[dict[str, float], float, float]
"""A straight move to targets by axis [axis units], with shares of the permitted speed and acceleration."""


def _path(machine: Machine, moves: Sequence[Move], name: str, feedforward: str) -> PlannedRun:
    """A run of consecutive moves from the middle of the travels, with dwells between them."""
    period, begin, at = machine.sample_period, DWELL_S, {axis.name: _reach(axis)[0] for axis in machine.axes}
    start, ways, blocks = np.array(list(at.values())), [], []
    for targets, speed_share, acceleration_share in moves:
        way = np.array([targets.get(axis, here) - here for axis, here in at.items()])
        if not way.any():
            continue
        # in shares of the way, as fast as the slowest axis goes
        permitted = [(speed_share * a.max_velocity, acceleration_share * a.max_acceleration, SHARE * a.max_jerk) for a in machine.axes]
        speed, acceleration, jerk = (min(limits[i] / abs(d) for limits, d in zip(permitted, way) if d) for i in range(3))
        ways.append((begin, way, (speed, acceleration, jerk)))
        # the feed of the control is the path speed of the linear axes, or the speed of the first axis if there are none
        lead = [d for a, d in zip(machine.axes, way) if a.kind == "linear" and d] or [d for d in way if d][:1]
        blocks.append((targets, float(np.linalg.norm(lead) * speed)))
        begin += time_of_move(1.0, speed, acceleration, jerk) + DWELL_S
        at |= targets
    refuse_above(begin / period, MOST_SETPOINTS, "set points", "[measurement]: sample_period_us", "lengthen it")
    times = sample_times(begin, period)
    position = np.tile(start, (len(times), 1))
    for since, way, limits in ways:
        position += way * jerk_limited_move(1.0, *limits, times - since)[:, None]
    return PlannedRun(name, feedforward, Setpoints(position, period), 1, tuple(blocks))


def constant_speeds(machine: Machine, axes: Sequence[Axis], name: str = "plan_constant_speeds") -> PlannedRun:
    """A run with constant speeds in both directions from creeping to rapid, one axis after the other."""
    moves: list[Move] = []
    for axis in axes:
        middle, half = _reach(axis)
        for share in LADDER:
            v = SHARE * share * axis.max_velocity
            ramp = v * (v / (SHARE * axis.max_acceleration) + SHARE * axis.max_acceleration / (SHARE * axis.max_jerk))
            stretch = min(half, 0.5 * (v * SPEED_TIME_S + ramp))
            moves += [({axis.name: middle + way}, SHARE * share, SHARE) for way in (stretch, -stretch)]
        moves.append(({axis.name: middle}, SHARE * 0.45, SHARE))
    return _path(machine, moves, name, "velocity")


def _acceleration_runs(machine: Machine) -> list[PlannedRun]:
    """Accelerated moves of two lengths, with and without feedforward."""
    moves: list[Move] = []
    for axis in machine.axes:
        middle, half = _reach(axis)
        short = min(half, (0.06 if axis.kind == "linear" else math.radians(25.0)))
        long = 0.5 * (short + half) if short < half else short
        moves += [({axis.name: middle + reach}, SHARE, SHARE) for reach in (short, -short, short, -short, long, 0.0)]
    return [_path(machine, moves, f"plan_accelerations_{f.replace('+', '_')}", f) for f in ("off", "velocity+torque")]


def _table_runs(machine: Machine) -> list[PlannedRun]:
    """Slow turns of each axis of a rotary pair over its range at several angles of the other."""
    if (pair := pair_of(machine)) is None:
        return []
    a, c = pair.axes
    (low_a, middle_a, high_a), (low_c, middle_c, high_c) = (
        (m - half, m, m + half) for m, half in map(_reach, map(machine.axis, pair.axes))
    )
    turns = [turn for at in (low_c, middle_c, high_c) for turn in ((c, at), (a, low_a), (a, high_a))]
    tilts = [(a, low_a), (c, low_c), (c, high_c), (a, middle_a), (c, low_c), (c, high_c)]
    slow = {a: 0.35, c: 0.5}
    return [_path(machine, [({n: target}, slow[n], SHARE) for n, target in (*turns, *tilts)], "plan_table", "velocity+torque")]


def _check_runs(machine: Machine) -> list[PlannedRun]:
    """A run with all axes at once on straight lines, held out as a check."""
    reaches = {axis.name: _reach(axis) for axis in machine.axes}
    ends = [{name: middle + share * half for name, (middle, half) in reaches.items()} for share in (0.2, -0.1, 0.3, 0.0)]
    return [_path(machine, [(end, 0.6 * SHARE, 0.6 * SHARE) for end in ends], "plan_check", "velocity+torque")]


PREDICTED = (
    *("inertia", *FRICTIONS, "gravity_torque", *FIRST_MOMENTS),
    *(p.name for p in (*position_controller.PARAMETERS, *speed_controller.PARAMETERS) if p.search or p.seen_in),
)


def _predict(machine: Machine, runs: Sequence[PlannedRun], progress: Callable[[str], None] | None) -> list[tuple[Parameter, float, float]]:
    """Parameter, relative half interval of the law, and that of the scatter of one round, from one and two simulated rounds."""
    machine = with_commissioned_inertia(machine)
    seen: Runs = {axis.name: [] for axis in machine.axes}
    quiet: Runs = {axis.name: [] for axis in machine.axes}  # noise-free: the instruments
    halves: list[dict[tuple[str, str], Parameter]] = []
    for rounds in (1, 2):
        for i, run in enumerate(runs):
            there = machine.with_feedforward(run.feedforward)
            plant = functools.partial(DecoupledPlant, motion=nominal_motion(there, run.setpoints))
            for runs_seen, noise_seed in ((seen, 100 * rounds + i), (quiet, None)):
                trace = simulate(there, run.setpoints, noise_seed=noise_seed, plant_of=plant).trace
                measured = MeasuredRun(f"{run.name}_{rounds}", trace, run.feedforward, 0.0)
                for axis in machine.axes:
                    runs_seen[axis.name].append(axis_run(machine, axis, measured))
            if progress:
                progress(f"simulating {run.name}")
        direct = regress_blocks(machine, seen, quiet)
        table = parameters_of(machine, direct, split_products(machine, direct))
        halves.append({(p.axis, p.name): p for p in table})
    out = []
    for key, p in halves[0].items():
        if p.name in PREDICTED and p.before and key in halves[1]:
            one, two = (h[key].estimate.half / abs(p.before) for h in halves)
            scatter = 2.0 * max(one**2 - two**2, 0.0)
            out.append((p, math.sqrt(max(one**2 - scatter, 0.0)), math.sqrt(min(scatter, one**2))))
    return out


def write_plan(plan: Plan, machine: Machine, out: Path) -> list[Path]:
    """Write part programs (Siemens), set points (Parquet), recordings/campaign.toml for the later recordings, and plan.json."""
    files = []
    for run in plan.runs:
        files += write_planned(run, machine, out)
    # `twin identify` reads this folder once the recordings are in it
    lines = [f'machine = "{machine.path.stem if machine.path else machine.name}"']
    lines += [f'\n[[run]]\nfile = "{run.name}.parquet"\nfeedforward = "{run.feedforward}"' for run in plan.runs]
    write_whole(out / "recordings" / "campaign.toml", "\n".join(lines) + "\n")
    files.append(out / "recordings" / "campaign.toml")
    document = {
        "machine": machine.name,
        "runs": [{"name": r.name, "feedforward": r.feedforward, "duration_s": r.duration, "repeats": r.repeats} for r in plan.runs],
        "predicted": [
            {"axis": p.axis, "name": p.name, "value": p.value, "unit": p.unit, "half_interval": p.half, "of_the_law": p.law}
            for p in plan.predicted
        ],
    }
    write_json(document, out / "plan.json", "plan")
    return [*files, out / "plan.json"]


def write_planned(run: PlannedRun, machine: Machine, out: Path) -> list[Path]:
    """Write the set points (Parquet) and the part program (Siemens) of a run; returns both files."""
    files = [out / f"{run.name}.parquet", out / f"{run.name}.mpf"]
    write_trace(trace_of(run.setpoints, machine), files[0])
    write_whole(files[1], siemens_program(run, machine))
    return files


def siemens_program(run: PlannedRun, machine: Machine) -> str:
    """The moves as a part program for a Sinumerik: exact stops, feed in mm/min (linear axes) or deg/min, dwells between moves."""
    words = {"off": "FFWOF", "velocity": "FFWON", "velocity+torque": "FFWON"}
    lines = [
        f"; {run.name}: feedforward '{run.feedforward}' - set the axes' feedforward mode (MD32620) to it before the run",
        "G90 G71 G94 G60 G500 D0",
        "SOFT",
        words[run.feedforward],
    ]
    start = "G0 " + " ".join(map(_word, machine.axes, run.setpoints.position[0]))
    lines += [start, "R1=0", "AGAIN:", f"G4 F{DWELL_S:g}"]
    for targets, speed in run.blocks:
        first = machine.axis(next(iter(targets)))
        words_of = " ".join(_word(machine.axis(name), target) for name, target in targets.items())
        lines += [f"G1 {words_of} F{speed * AXIS_UNITS[first.kind].position[1] * 60.0:.1f}", f"G4 F{DWELL_S:g}"]
    lines += [start, "R1=R1+1", f"IF R1<{run.repeats} GOTOB AGAIN", "M30"]
    # comments and labels have no number
    numbers = ["" if line.startswith(";") or line.endswith(":") else f"N{10 * (i + 1)} " for i, line in enumerate(lines)]
    return "".join(f"{number}{line}\n" for number, line in zip(numbers, lines))


def _word(axis: Axis, value: float) -> str:
    """Position word of an axis: 'X=12.5000' or 'A=-35.0000' in mm or degrees."""
    number = f"{value * AXIS_UNITS[axis.kind].position[1]:.4f}"
    return f"{axis.name}={number}"
