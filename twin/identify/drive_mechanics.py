"""What a drive in closed loop shows of its mechanics beyond inertia and friction: pre-sliding and a structural mode.

Each is fitted jointly with all other values of the axis, with the lag of a reference model too, the mode from several frequencies. It is
taken if its interval is narrow and it predicts moves that are left out clearly better, and none clearly worse; otherwise the axis stays as it was.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np

from twin.errors import SimulationError
from twin.identify.drive_residuals import MODE, RANGES, SLIP, DriveResiduals
from twin.identify.drive_search import Search, machine_found, score_of, searched
from twin.identify.moves import folds_of
from twin.machine.machine import Machine
from twin.machine.parameters import parameter
from twin.recordings.campaign import MeasuredRun

CLEARLY = 0.02
"""A richer model is taken if it lowers the mean log RMS of the moves left out by more."""

FREQUENCIES_HZ = (12.0, 18.0, 27.0, 41.0, 62.0)
"""Frequencies from which a structural mode is searched: beds on their mounts and columns lie between 10 and 80 Hz."""

MODE_START = (0.3, 0.05)
"""Mass share and damping ratio from which a structural mode is searched."""

BREAK_AWAY = {"linear": 10e-6, "rotary": 5e-5}
"""Way to break-away [m, rad] from which pre-sliding is searched: Coulomb friction over stiffness."""

REFERENCE_START_S = 0.2e-3
"""Lag from which the search for a reference model starts."""

NARROW = {SLIP: 4.0, "mode_frequency_hz": 1.25, "mode_mass_share": 4.0}
"""Largest factor from a value to the end of its 95 % interval."""

SCREENING_STEPS, POLISHING_STEPS = 5, 25
"""Steps of the search from each start, and from the best of them to the end."""


@dataclass(frozen=True)
class _Recording:
    """What all searches share."""

    runs: Sequence[MeasuredRun]
    rows: Mapping[str, Sequence[np.ndarray]]
    known: Collection[tuple[str, str]]
    say: Callable[[str], None] | None

    def work(self, machine: Machine, axes: Collection[str], rows: Mapping[str, Sequence[np.ndarray]] | None = None) -> DriveResiduals:
        """The residuals of some axes of a machine."""
        return DriveResiduals(machine, self.runs, rows or self.rows, self.known, [n for n in machine.axis_names if n not in axes])


def with_mechanics(
    machine: Machine,
    runs: Sequence[MeasuredRun],
    rows: Mapping[str, Sequence[np.ndarray]],
    known: Collection[tuple[str, str]],
    best: Mapping[str, Search],
    say: Callable[[str], None] | None = None,
) -> dict[str, Search]:
    """`best` with the searches of richer mechanics on the axes that show them: position compared, and two moves or more."""
    recording = _Recording(runs, rows, known, say)
    best = dict(best)
    folds = {n: folds_of(machine.axis(n), runs, rows[n]) for n in best}
    asked = [n for n, s in best.items() if folds[n] and _is_open(machine, n) and {"position", "motor_position"} & set(s.base[n])]
    left_out = _scores_left_out(recording, folds, {n: best[n] for n in asked})
    for slip, frequencies in ((True, ()), (False, FREQUENCIES_HZ), (True, FREQUENCIES_HZ)):
        found = _fitted(recording, machine, {n: best[n] for n in asked}, slip, frequencies)
        promising = {n: s for n, s in found.items() if s.score[n] < best[n].score[n] - CLEARLY and _is_narrow(s, n)}
        scores = _scores_left_out(recording, folds, promising)
        for n, s in promising.items():
            if _predicts_better(scores[n], left_out[n]):
                best[n], left_out[n] = s, scores[n]
    return best


def _is_open(machine: Machine, name: str) -> bool:
    """True if the machine file says nothing of pre-sliding or a structural mode of this axis."""
    axis = machine.axis(name)
    listed = any(e.get("name") == "presliding" and e.get("axis") == name for e in machine.effects)
    return not (listed or axis.presliding_stiffness or axis.mode_mass_share)


def _fitted(
    recording: _Recording, machine: Machine, best: Mapping[str, Search], slip: bool, frequencies: Sequence[float]
) -> dict[str, Search]:
    """The richer model of all axes: a few steps from each start, then from each axis' best start to the end."""
    first: list[Search] = []
    for richer in _starts(machine_found(machine, best), best, slip, frequencies):
        try:
            one = searched(recording.work(richer, best), recording.say, steps=SCREENING_STEPS)
        except SimulationError:
            continue
        if one is not None:
            first.append(one)
    if not first:
        return {}
    start = {n: first[int(np.argmin([s.score[n] for s in first]))].x[n] for n in best}
    end = searched(first[0].work, recording.say, start, POLISHING_STEPS)
    return dict.fromkeys(best, end) if end is not None else {}


def _starts(machine: Machine, best: Mapping[str, Search], slip: bool, frequencies: Sequence[float]) -> Iterator[Machine]:
    """The machine with what is searched added to the axes of `best`, once for each frequency."""
    values: dict[str, object] = {}
    for name, search in best.items():
        axis = machine.axis(name)
        values |= {f"axis.{name}.{parameter(f).key(axis.drive)}": 0.0 for f in (SLIP, *MODE)}
        if slip:
            values[f"axis.{name}.{parameter(SLIP).key(axis.drive)}"] = axis.coulomb_friction / BREAK_AWAY[axis.kind]
        if "speed_integral_time_s" in search.work.fields[name] and axis.loops.speed_reference_time_s == 0.0:
            values[f"axis.{name}.loops.speed_reference_time_s"] = REFERENCE_START_S
    for frequency in frequencies or (0.0,):
        mode = zip(MODE, (frequency, *MODE_START)) if frequency else ()
        yield machine.with_values({**values, **{f"axis.{n}.{f}": v for f, v in mode for n in best}})


def _is_narrow(search: Search, name: str) -> bool:
    """Are the values beyond inertia, friction and gains known within NARROW, and none at a bound of its search?"""
    fit = search.work.result(name, search.x[name], search.base[name], search.jacobian[name])
    if any(not low * 1.01 < fit.values[f] < high / 1.01 for f, (low, high) in RANGES.items() if f in fit.values):
        return False
    return all(math.exp(min(1.96 * fit.deviations[f] / fit.values[f], 40.0)) < NARROW[f] for f in NARROW if f in fit.values)


def _scores_left_out(
    recording: _Recording, folds: Mapping[str, list[list[np.ndarray]]], best: Mapping[str, Search]
) -> dict[str, list[float]]:
    """Mean log RMS (fold,) of each axis on the moves of each fold, left out of a fit that starts where the search of all moves ended."""
    scores: dict[str, list[float]] = {n: [] for n in best}
    for search in {id(s): s for s in best.values()}.values():
        own = [n for n, s in best.items() if s is search]
        for k in range(max(len(folds[n]) for n in own)):
            axes = [n for n in own if k < len(folds[n])]
            kept = {n: [r & ~f for r, f in zip(recording.rows[n], folds[n][k])] for n in axes}
            machine = search.work.machine
            fitted = searched(recording.work(machine, axes, kept), recording.say, {n: search.x[n] for n in axes})
            aside = recording.work(machine, axes, {n: folds[n][k] for n in axes})
            there = aside.residuals(fitted.x) if fitted is not None else None
            for n in axes:
                scores[n].append(math.inf if there is None else score_of(_without_steady_command(there[n], machine.axis(n).effort)))
    return scores


def _without_steady_command(residual: Mapping[str, np.ndarray], effort: str) -> dict[str, np.ndarray]:
    """The residuals with the mean command removed: moves in one direction do not separate friction from a steady load."""
    return {s: v - v.mean() if s == effort and len(v) else v for s, v in residual.items()}


def _predicts_better(after: Sequence[float], before: Sequence[float]) -> bool:
    """True if the moves left out are predicted clearly better on average, and in no fold clearly worse."""
    gains = np.array(before) - np.array(after)
    return bool(np.isfinite(after).all() and gains.mean() > CLEARLY and gains.min() > -CLEARLY)
