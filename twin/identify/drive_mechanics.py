"""Mechanics of a drive in closed loop beyond inertia and friction: pre-sliding and a structural mode.

Each is fitted together with all other values of the axis and the lag of a reference model; the mode starts from several frequencies. It is
accepted if its interval is narrow, it predicts held-out moves clearly better on average, and none clearly worse. Otherwise the axis is unchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np

from twin.estimate.evidence import LEAST_IMPROVEMENT, mean_log_rms, predicts_better
from twin.estimate.search import Solution, search
from twin.identify.drive_residuals import MODE, RANGES, SLIP, DriveResiduals, follows_recorded_path, with_constant_forces
from twin.identify.moves import folds_of
from twin.machine.machine import Machine
from twin.machine.parameters import parameter
from twin.recordings.campaign import MeasuredRun
from twin.simulation.two_encoders import BOTH

FREQUENCIES_HZ = (8.0, 12.0, 18.0, 27.0, 41.0, 62.0)
"""Initial frequencies of a structural mode. Arms of large robots are below 10 Hz, beds on their mounts and columns between 10 and 80 Hz."""

MODE_START = (0.3, 0.05)
"""Initial mass share and damping ratio of a structural mode."""

BREAK_AWAY = {"linear": 10e-6, "rotary": 5e-5}
"""Initial travel to break-away [m, rad]: Coulomb friction over pre-sliding stiffness."""

REFERENCE_START_S = 0.2e-3
"""Initial lag of a reference model."""

NARROW = {SLIP: 4.0, "mode_frequency_hz": 1.25, "mode_mass_share": 4.0}
"""Largest ratio of an end of the 95 % interval to the value."""

SCREENING_STEPS, POLISHING_STEPS = 5, 25
"""Steps of the search from each initial frequency, and from the best of them."""


@dataclass(frozen=True)
class _Recording:
    """Data of all searches: runs, training rows, known values, progress."""

    runs: Sequence[MeasuredRun]
    rows: Mapping[str, Sequence[np.ndarray]]
    known: Collection[tuple[str, str]]
    say: Callable[[int], None] | None

    def work(self, machine: Machine, axes: Collection[str], rows: Mapping[str, Sequence[np.ndarray]] | None = None) -> DriveResiduals:
        """The residuals of some axes of a machine."""
        return DriveResiduals(machine, self.runs, rows or self.rows, self.known, [n for n in machine.axis_names if n not in axes])


def with_mechanics(
    machine: Machine,
    runs: Sequence[MeasuredRun],
    rows: Mapping[str, Sequence[np.ndarray]],
    known: Collection[tuple[str, str]],
    best: Mapping[str, Solution],
    say: Callable[[int], None] | None = None,
) -> dict[str, Solution]:
    """`best` with richer mechanics on the axes where they are accepted.

    An axis needs at least two moves, and a compared position or a set point that is its recorded path: otherwise errors of an assumed
    control would pass for mechanics.
    """
    recording = _Recording(runs, rows, known, say)
    best = dict(best)
    folds = {n: folds_of(machine.axis(n), runs, rows[n]) for n in best}
    asked = [
        n
        for n, s in best.items()
        if folds[n]
        and "inertia" in s.problem.fields[n]
        and _is_open(machine, n)
        and (_has_position(s, n) or follows_recorded_path(machine.axis(n), runs))
    ]
    left_out = _scores_left_out(recording, folds, {n: best[n] for n in asked})
    for slip, frequencies in ((True, ()), (False, FREQUENCIES_HZ), (True, FREQUENCIES_HZ)):
        found = _fitted(recording, machine, {n: best[n] for n in asked}, slip, frequencies)
        promising = {n: s for n, s in found.items() if s.score(n) < best[n].score(n) - LEAST_IMPROVEMENT and _is_narrow(s, n)}
        scores = _scores_left_out(recording, folds, promising)
        for n, s in promising.items():
            if predicts_better(scores[n], left_out[n]):
                best[n], left_out[n] = s, scores[n]
    return best


def _has_position(end: Solution, name: str) -> bool:
    return any(s in end.residuals[name] for s in BOTH)


def _is_open(machine: Machine, name: str) -> bool:
    """True if the machine file has neither pre-sliding nor a structural mode on this axis."""
    axis = machine.axis(name)
    listed = any(e.get("name") == "presliding" and e.get("axis") == name for e in machine.effects)
    return not (listed or axis.presliding_stiffness or axis.mode_mass_share)


def _fitted(
    recording: _Recording, machine: Machine, best: Mapping[str, Solution], slip: bool, frequencies: Sequence[float]
) -> dict[str, Solution]:
    """Fit of a richer model to all axes: a few steps from each start, then to the end from the best start of each axis."""
    first: list[Solution] = []
    for richer in _starts(machine_found(machine, best), best, slip, frequencies):
        one = search(recording.work(richer, best), steps=SCREENING_STEPS, say=recording.say)
        if one is not None:
            first.append(one)
    if not first:
        return {}
    nearest = {n: min(first, key=lambda end: end.score(n)) for n in best}
    start = {f.name: nearest[f.parts[0]].values[f.name] for f in first[0].problem.free}
    end = search(first[0].problem, start, POLISHING_STEPS, recording.say)
    return dict.fromkeys(best, end) if end is not None else {}


def _starts(machine: Machine, best: Mapping[str, Solution], slip: bool, frequencies: Sequence[float]) -> Iterator[Machine]:
    """The machine with the searched mechanics added to the axes of `best`, once for each frequency."""
    values: dict[str, object] = {}
    for name, end in best.items():
        axis = machine.axis(name)
        values |= {f"axis.{name}.{parameter(f).key(axis.drive)}": 0.0 for f in (SLIP, *MODE)}
        if slip:
            values[f"axis.{name}.{parameter(SLIP).key(axis.drive)}"] = axis.coulomb_friction / BREAK_AWAY[axis.kind]
        if "speed_integral_time_s" in end.problem.fields[name] and axis.loops.speed_reference_time_s == 0.0:
            values[f"axis.{name}.loops.speed_reference_time_s"] = REFERENCE_START_S
    for frequency in frequencies or (0.0,):
        mode = zip(MODE, (frequency, *MODE_START)) if frequency else ()
        yield machine.with_values({**values, **{f"axis.{n}.{f}": v for f, v in mode for n in best}})


def _is_narrow(end: Solution, name: str) -> bool:
    """Whether the intervals of pre-sliding and mode are within NARROW and no value is at a bound of its range.

    The mass share may be at its upper bound if the rotor is fitted, too: then the whole load swings, as in a drive of two masses.
    """
    fit = end.problem.result(name, end)
    ranges = dict(RANGES)
    if end.problem.fits_rotor(name):
        ranges["mode_mass_share"] = (ranges["mode_mass_share"][0], math.inf)
    if any(not low * 1.01 < fit.values[f] < high / 1.01 for f, (low, high) in ranges.items() if f in fit.values):
        return False
    return all(math.exp(min(1.96 * fit.deviations[f] / fit.values[f], 40.0)) < NARROW[f] for f in NARROW if f in fit.values)


def _scores_left_out(
    recording: _Recording, folds: Mapping[str, list[list[np.ndarray]]], best: Mapping[str, Solution]
) -> dict[str, list[float]]:
    """Mean log RMS (fold,) of each axis on the moves of each fold, after a fit to the other moves that starts from the fit to all moves."""
    scores: dict[str, list[float]] = {n: [] for n in best}
    for end in {id(s): s for s in best.values()}.values():
        own = [n for n, s in best.items() if s is end]
        for k in range(max(len(folds[n]) for n in own)):
            axes = [n for n in own if k < len(folds[n])]
            kept = {n: [r & ~f for r, f in zip(recording.rows[n], folds[n][k])] for n in axes}
            fitted = search(recording.work(end.problem.machine, axes, kept), end.values, say=recording.say)
            aside = recording.work(end.problem.machine, axes, {n: folds[n][k] for n in axes})
            there = aside.residuals([fitted.values])[0] if fitted is not None else None
            for n in axes:
                effort = end.problem.machine.axis(n).effort
                scores[n].append(math.inf if there is None else mean_log_rms(_without_steady_command(there[n], effort)))
    return scores


def _without_steady_command(residual: Mapping[str, np.ndarray], effort: str) -> list[np.ndarray]:
    """The residuals with the mean command removed: moves in one direction do not separate friction from a steady load."""
    return [v - v.mean() if s == effort and len(v) else v for s, v in residual.items()]


def machine_found(machine: Machine, best: Mapping[str, Solution]) -> Machine:
    """The machine with the final values of each axis."""
    values: dict[str, object] = {}
    forces: dict[str, float] = {}
    for name, end in best.items():
        own, force = end.problem.values(end.values, [name])
        values.update(own)
        forces.update(force)
    return with_constant_forces(machine.with_values(values), forces)
