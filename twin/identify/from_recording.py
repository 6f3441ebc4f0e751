"""A machine from a recording alone: the closed-loop fit of `twin identify`, started at lumped parameters and tried gains.

Where no signal shows gain and integral time of the speed controller, they are searched until the simulated axis follows like the recorded one, together
with the numbers of the position controller, if these are assumed: a gain, a delay and a feedforward with the same lag differ in how the axis accelerates. The
comment of each number states its origin. An axis keeps its first values where the fit does not predict the held-out motion better, and where the recording
does not show them.
"""

from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path
import re
import tempfile

import numpy as np

from twin.control import position_controller, speed_controller
from twin.control.structures import INTEGRAL
from twin.errors import InputError, SimulationError, TwinError
from twin.estimate.problem import Values
from twin.files import write_whole
from twin.identify.drive_residuals import DriveResiduals, follows_recorded_path
from twin.identify.first_values import first_values, with_tried
from twin.identify.held_out import unstable_loops
from twin.identify.identify import identify
from twin.identify.position_law_search import RIVAL_RATIO
from twin.identify.write import write_identified
from twin.machine.axis_lumps import AxisControl, AxisLumps
from twin.machine.commented import TRIED
from twin.machine.lumped_file import write_lumped_machine
from twin.machine.machine import Axis, Machine, load_machine
from twin.recordings.campaign import MeasuredRun, read_campaign
from twin.simulation.gap import predict
from twin.units import AXIS_UNITS

LONGEST_TRIED_S = 8.0
"""Speed controllers are tried on at most this much recorded time [s]."""


@dataclass(frozen=True)
class Reproduction:
    """How the machine reproduces an axis, SI: RMS gap of the position, RMS following error, RMS gap of the command and its range.

    `unstable`: a loop is, although the recorded motion ends before this shows.
    """

    gap: float
    following: float
    effort_gap: float = math.nan
    effort_range: float = math.nan
    unstable: bool = False

    @property
    def merit(self) -> float:
        """Measure that the trials minimise."""
        position = self.gap / max(self.following, 1e-12)
        return position + (0.3 * self.effort_gap / self.effort_range if self.effort_range > 0.0 else 0.0)


@dataclass(frozen=True)
class NewMachine:
    """A machine that was written: the identified axes, and how well they reproduce the recording."""

    lumps: tuple[AxisLumps, ...]
    followed: Mapping[str, Reproduction]

    @property
    def merit(self) -> float:
        """Measure that decides between machines, of all axes."""
        return sum(one.merit for one in self.followed.values())


def machine_from_recording(folder: Path, out: Path, say: Callable[[str], None] = lambda _text: None, identified: bool = True) -> NewMachine:
    """Write the machine file and its model; without `identified` the first values.

    Raises InputError if no axis moves, or if no stable machine reproduces one.
    """
    if out.suffix.lower() != ".toml":
        raise InputError(f"--out {out}: a machine file ends in .toml; rename it")
    for path in (out, out.with_suffix(".xml")):
        if path.exists():
            raise InputError(f"{path}: exists already; give another name or remove it")
    runs = read_campaign(folder).runs
    moving = [n for n in dict.fromkeys(axis for run in runs for axis in run.trace.axes) if any(run.trace.moves(n) for run in runs)]
    if not moving:
        raise InputError(f"{folder}: no axis moves in its runs; record a move")
    say("laws of the controls")
    first = {one.name: one for one in first_values(runs, moving)}
    tried = _tried_runs(runs, moving)
    if not all(tried.values()):
        raise InputError(f"{folder.name}: no run has {LEAST_SAMPLES} samples; record a longer move")
    say("trying controllers")
    lumps, followed = list[AxisLumps](), dict[str, Reproduction]()
    with tempfile.TemporaryDirectory(prefix="twin_lumps_") as scratch:
        for names, own in tried.items():
            best, there = _tuned([first[name] for name in names], own, Path(scratch) / "machine.toml")
            lumps, followed = [*lumps, *best], {**followed, **there}
    made = NewMachine(tuple(lumps), followed)
    if bad := [name for name, one in made.followed.items() if not math.isfinite(one.gap)]:
        raise InputError(
            f"{folder.name}: no stable machine reproduces axis {', '.join(bad)}; leave it out of the map, or write its file by hand"
        )
    write_lumped_machine(out, made.lumps, folder.name)
    return _identified(made, folder, out, tried, say) if identified else made


def _identified(
    made: NewMachine, folder: Path, out: Path, tried: Mapping[tuple[str, ...], Sequence[MeasuredRun]], say: Callable[[str], None]
) -> NewMachine:
    """The machine after identification, if it reproduces the recording better; else the file stays as it is."""
    first, text = load_machine(out), out.read_text(encoding="utf-8")
    try:
        result = identify(read_campaign(folder, first), first, progress=say, hold_out=False)
        if result.refused:
            return made
        write_identified(result, out)
        machine, lumps = load_machine(out), {one.name: one for one in made.lumps}
        found = replace(
            made,
            followed={n: one for axes, own in tried.items() for n, one in _reproductions(machine, own, [lumps[n] for n in axes]).items()},
        )
    except TwinError:  # the first machine is what this recording gives
        found = None
    # the merit of a machine that diverges is no number
    if found is None or not found.merit <= made.merit:
        write_whole(out, text)
        return made
    return found


LEAST_SAMPLES = 40
"""Fewest samples of a run that is used."""


def _tried_runs(runs: Sequence[MeasuredRun], axes: Sequence[str]) -> dict[tuple[str, ...], list[MeasuredRun]]:
    """Axes that the same runs record, and the stretches of these runs on which their controls are tried. A drive's tool records one axis at a time."""
    together: dict[tuple[str, ...], list[str]] = {}
    for name in axes:
        together.setdefault(tuple(run.name for run in runs if run.trace.has(name, "setpoint")), []).append(name)
    return {tuple(own): runs_with_most_travel([run for run in runs if run.name in names], own) for names, own in together.items()}


def runs_with_most_travel(runs: Sequence[MeasuredRun], axes: Sequence[str]) -> list[MeasuredRun]:
    """The runs with the most travel per second, LONGEST_TRIED_S in all; the last one is shortened."""

    def travel(run: MeasuredRun) -> float:
        return sum(float(np.abs(np.diff(run.trace.get(a, "setpoint"))).sum()) for a in axes) / (run.trace.time[-1] - run.trace.time[0])

    out, total = [], 0.0
    for run in sorted((run for run in runs if len(run.trace.time) >= LEAST_SAMPLES), key=travel, reverse=True):
        count = min(len(run.trace.time), int((LONGEST_TRIED_S - total) / run.trace.period))
        if count < LEAST_SAMPLES:
            break
        out.append(replace(run, trace=run.trace.samples(slice(count)).select(axes)))
        total += count * run.trace.period
    return out


def _reproductions(machine: Machine, runs: Sequence[MeasuredRun], lumps: Sequence[AxisLumps]) -> dict[str, Reproduction]:
    """Gap of each axis in the decoupled plant; infinite if the simulation diverges."""
    rows: dict[str, list[np.ndarray]] = {one.name: [] for one in lumps}
    for run in runs:
        try:
            simulated = predict(machine, run, realisations=1, engine=False).trace
        except SimulationError as lost_one:
            lost = re.search(r"axis (\S+)", str(lost_one))
            named = {lost[1]} if lost else set(rows)
            return {one.name: Reproduction(math.inf if one.name in named else math.nan, 1.0) for one in lumps}
        skip = len(run.trace.time) // SETTLING_PART
        for one in lumps:
            measured = run.trace.get(one.name, one.where)
            off = simulated.get(one.name, one.where) - measured
            error = run.trace.get(one.name, "setpoint") - measured
            effort = one.mechanics.effort if one.mechanics else ""
            command = run.trace.get(one.name, effort) if effort else np.zeros_like(off)
            force_off = simulated.get(one.name, effort) - command if effort else np.zeros_like(off)
            rows[one.name].append(np.column_stack([off - off.mean(), error - error.mean(), force_off, command])[skip:])
    out, unstable = {}, unstable_loops(machine)
    for name, parts in rows.items():
        off, error, force_off, command = np.concatenate(parts).T
        gap, following, effort_gap = (float(np.sqrt(np.mean(v**2))) for v in (off, error, force_off))
        out[name] = Reproduction(gap, following, effort_gap, float(np.ptp(command)), name in unstable)
    return out


def _tuned(lumps: Sequence[AxisLumps], runs: Sequence[MeasuredRun], file: Path) -> tuple[list[AxisLumps], dict[str, Reproduction]]:
    """Each axis with the likeliest of its possible controls, all axes at once: their gaps are independent. `file` is that of the machines tried."""
    kept = {one.name: replace(one, others=()) for one in lumps}

    def machine_of(axes: Sequence[AxisLumps]) -> Machine:
        write_lumped_machine(file, axes, "a recording")
        return load_machine(file)

    def attempt(axes: Sequence[AxisLumps]) -> dict[str, Reproduction]:
        """How axes with these laws reproduce the runs."""
        return _reproductions(machine_of(axes), runs, axes)

    def diverging(of: Mapping[str, Reproduction]) -> set[str]:
        return {n for n, one in of.items() if math.isinf(one.gap) or (one.unstable and not kept[n].law.direct)}

    best = attempt(list(kept.values()))
    for _ in range(4):  # a speed controller may be too stiff for its cycles
        if not (lost := diverging(best)):
            break
        kept |= {n: replace(kept[n], law=replace(kept[n].law, lag=1.8 * kept[n].law.lag)) for n in lost}
        best = attempt(list(kept.values()))
    others = [
        [replace(one, law=one.others[k]) for one in lumps if len(one.others) > k] for k in range(max(len(one.others) for one in lumps))
    ]
    for axes in ([one for one in kept.values() if not one.law.direct], *others):
        if not axes:
            continue
        selected = [replace(run, trace=run.trace.select([one.name for one in axes])) for run in runs]
        given = {n: with_tried(kept[n], law) for n, law in tried_controls(machine_of(axes), selected, axes).items()}
        while given and (lost := given.keys() & diverging(there := attempt(list({**kept, **given}.values())))):
            given = {n: one for n, one in given.items() if n not in lost}
        for name, one in given.items():
            now = kept[name].law
            clearly = RIVAL_RATIO if now.direct or (one.law.partly_fed and not now.partly_fed) else 1.0
            if math.isfinite(there[name].gap) and not clearly * there[name].merit >= best[name].merit:
                kept[name], best[name] = one, there[name]
    return list(kept.values()), best


def reproduction_text(one: AxisLumps, followed: Reproduction) -> str:
    """One line that states how well the machine reproduces an axis."""
    unit, factor = AXIS_UNITS[one.kind].error
    # without a recorded set point there is no following error
    share = f", {followed.gap / followed.following:.2%} of the following error" if followed.following > 1e-12 else ""
    if followed.gap >= followed.following > 1e-12:
        said = (
            "other forces than of this mass and friction act on it"
            if one.law.measured
            else "the assumed numbers of its control do not hold"
        )
        share += f": no better than the set point itself, so {said}"
    text = f"axis {one.name}: position to {followed.gap * factor:.3g} {unit} RMS{share}"
    m = one.mechanics
    return text + (
        f"; {m.effort} to {followed.effort_gap / followed.effort_range:.1%} of its range" if m and followed.effort_range > 0.0 else ""
    )


STARTS = ((1.0, 0.004), (1.0, 0.03), (4.0, 0.03), (4.0, 0.3))
"""Starts of the search: factor of the lag of the speed controller, and its integral time [s]. The optima of the integral time lie apart."""

SETTLING_PART = 20
"""One part in SETTLING_PART of each run is left out at its start: the recorded axis may still move from before."""


class TriedControl(DriveResiduals):
    """The problem of the controls of some axes, whose mechanics are known; position and command are compared."""

    def __init__(self, machine: Machine, runs: Sequence[MeasuredRun], lumps: Sequence[AxisLumps]) -> None:
        self.lumps = {one.name: one for one in lumps}
        rows = [np.arange(len(run.trace.time)) >= len(run.trace.time) // SETTLING_PART for run in runs]
        super().__init__(machine, runs, dict.fromkeys(self.lumps, rows), (), self.lumps)

    def signals(self, name: str) -> list[str]:
        one = self.lumps[name]
        return [one.where, *([one.mechanics.effort] if one.mechanics else [])]

    def _fields_of(self, axis: Axis) -> list[str]:
        if not any(run.trace.moves(axis.name) for run in self.runs):
            return []
        law = self.lumps[axis.name].law
        is_open = not law.measured and not follows_recorded_path(axis, self.runs)
        assumed = axis.loops.searched(position_controller.PARAMETERS, self.fed(axis) if law.partly_fed else ()) if is_open else []
        fed = ["torque_feedforward"] if is_open and law.acceleration else []
        return [*assumed, *fed, *axis.loops.searched(speed_controller.PARAMETERS)]

    def values(self, x: Values, axes: Collection[str]) -> tuple[dict[str, object], dict[str, float]]:
        """As those of a machine file, whose feedforward is as late as the set point, because the recording shows only one lag."""
        values, forces = super().values(x, axes)
        loops = [f"axis.{n}.loops." for n in axes if "position_delay_s" in self.fields[n]]
        return values | {f"{key}feedforward_delay_s": values[f"{key}position_delay_s"] for key in loops}, forces

    def control_at(self, name: str, values: Values) -> AxisControl:
        """The control of an axis at these values of the search."""
        law, found = self.lumps[name].law, self.found(name, values)
        return replace(
            law,
            loops={**law.loops, **{n: v for n, v in found.items() if n in law.loops or n == INTEGRAL}},
            lag=law.lag * self._value(name, "speed_gain_nm_s_per_rad") / found["speed_gain_nm_s_per_rad"],
            acceleration=law.acceleration * found.get("torque_feedforward", 1.0),
            origin=TRIED if "position_gain_per_s" in found else law.origin,
        )


def tried_controls(machine: Machine, runs: Sequence[MeasuredRun], lumps: Sequence[AxisLumps]) -> dict[str, AxisControl]:
    """The best control of each of these axes of the machine, searched from the one that it has."""
    problem = TriedControl(machine, runs, lumps)
    starts = {tuple(start.values()): start for start in _starts(problem)}  # some are equal
    ends = [end for start in starts.values() if (end := problem.searched(start)) is not None] if problem.names else []
    return {n: problem.control_at(n, min(ends, key=lambda end: end.scores[n]).values) for n in problem.names if ends}


def _starts(problem: TriedControl) -> Iterator[dict[Hashable, float]]:
    """The laws with the speed controllers of STARTS; one that a command shows nearly starts there."""
    for softer, integral_time in STARTS:
        start = {f.name: f.start for f in problem.free}
        for name in (n for n in problem.names if problem.lumps[n].law.origin != TRIED):
            start[name, "speed_gain_nm_s_per_rad"] -= math.log(softer)
            if (name, "speed_integral_time_s") in start:
                start[name, "speed_integral_time_s"] = math.log(integral_time)
        yield start
