"""The judgement of a history: which axis changed, when, by what cause and how much, and when it reaches a limit.

The rule runs through the recordings by day. At each it averages the evidence for a change (`twin.history.change`) over all causes of the machine; where
one group of axes brings it above `ALARM`, it raises an alarm. The alarm names the cause that explains the change of all directions of its group best.
The change then stands: the other directions of its group are judged next to it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin.history.change import LONGEST, Forecast, Level, evidence, forecast, level
from twin.history.columns import Direction, amplitude, waves_of
from twin.history.series import LEAST_SCATTER, RIVAL, Series, constants_of, is_load, programs_of, series_of, thermometers
from twin.history.store import Row

FALSE_ALARM_WEEKS, ALARM = 1000.0, 3000.0
"""Mean number of recordings between false alarms of one machine as stated, and the evidence that an alarm needs: it holds that rate three times over,
because the scatter of real recordings is not quite normal and independent.
"""

LEAST = 0.1
"""Smaller changes are not reported [usual sizes]: half of what an alarm should find."""

SHOWN = 100.0
"""A direction may be named if the recordings hold this much information on it [1 / usual size^2]: a fifth of its usual size at two standard deviations of noise."""

PLAUSIBLE = 2.0
"""Largest size of a cause, in its largest usual ones."""

AGREES = 0.5
"""Largest difference between the two, as a share."""

RECENT = 8
"""After so many recordings a growth is carried forward, and another change of the same axes can be separated from it."""

Cause = tuple[str, str, str]


@dataclass(frozen=True)
class Limit:
    """A size [usual sizes; inf: none], and what it is in words."""

    size: float = 1.0
    text: str = "its usual size as a fault"


USUAL = Limit()

LimitOf = Callable[[Direction, float], Limit]
"""The limit of a change of a direction, whose size now is known [usual sizes]."""

SizeOf = Callable[[Direction, Series, float], float]
"""(direction, series of its group, size by its slope) -> its size."""


@dataclass(frozen=True)
class Change:
    """A change: cause and direction, row of its onset and of its alarm, size in usual sizes, other causes that explain nearly as much."""

    group: int
    k: int
    direction: Direction
    onset: int
    alarm_row: int
    size: Level
    rivals: tuple[Cause, ...] = ()
    forecast: Forecast | None = None
    limit: Limit = USUAL

    @property
    def cause(self) -> Cause:
        return self.direction.cause

    @property
    def is_load(self) -> bool:
        """Is it what the axis carries? That is no fault of the machine; it stands without an alarm."""
        return is_load(self.cause[0])


@dataclass(frozen=True)
class Judgement:
    """All that a history says: its rows, series, changes, and the evidence at each row.

    constants     one for each program (row, program)
    temperature   what the axes outside each group show of it (row, thermometer); only what it acts on is corrected by it
    """

    rows: Sequence[Row]
    series: Sequence[Series]
    constants: np.ndarray
    temperature: Sequence[np.ndarray]
    changes: Sequence[Change] = ()
    evidence: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (row,)

    def nuisance(self, group: int, warms: bool, standing: Sequence[Change] = ()) -> np.ndarray:
        """What is removed from the directions of a group (row, column), that temperature acts on or not: a change that stands moves others a little."""
        columns = [self.constants, self.temperature[group]] if warms else [self.constants]
        one = self.series[group]
        for change in standing:
            moved = np.zeros((len(self.rows), 2))
            since = one.at >= change.onset
            moved[change.onset :, 0] = 1.0
            moved[one.at[since], 1] = one.sizes[since, change.k]
            columns.append(moved)
        return np.column_stack(columns)


def causes_of(series: Sequence[Series]) -> dict[Cause, tuple[int, list[int]]]:
    """Causes that the recordings show: index of the series, and the directions of each. What an axis carries is no fault of the machine."""
    found: dict[Cause, tuple[int, list[int]]] = {}
    for g, one in enumerate(series):
        for k, direction in enumerate(one.directions):
            if one.seen[k] and not is_load(direction.cause[0]):
                found.setdefault(direction.cause, (g, []))[1].append(k)
    return found


def judge_recording(
    rows: Sequence[Row],
    directions: dict[tuple[str, ...], list[Direction]],
    limit_of: LimitOf = lambda *_: USUAL,
    size_of: SizeOf = lambda _direction, _series, size: size,
) -> Judgement:
    """The judgement of all recordings by day; `size_of` simulates the changes, which are carried forward to their limits."""
    programs = programs_of(rows) if rows else np.zeros(0, int)
    series = [s for axes, own in directions.items() if (s := series_of(rows, axes, own, programs)) is not None]
    constants = constants_of(programs)
    history = Judgement(rows, series, constants, [thermometers(series, one, len(rows)) for one in series])
    causes = causes_of(series)
    standing: list[list[Change]] = [[] for _ in series]
    total = np.zeros(len(rows))
    for now in range(len(rows)):
        for group, stand in enumerate(standing):
            found = _evidence(history, causes, group, stand, now + 1)
            own = sum(e for e, _ in found.values()) / len(causes)
            total[now] += own
            if own <= ALARM:
                continue
            if stand and (again := _resized(history, stand[-1], stand[:-1], now)).cause != stand[-1].cause:
                # more recordings show another cause of the same change
                stand[-1] = replace(again, alarm_row=now) if stand[-1].is_load else again
                continue
            loudest = max(found, key=lambda cause: found[cause][0])
            if stand and found[loudest][1] < stand[-1].onset + RECENT:
                continue  # while a change grows, what moves with it is not separated from another one
            change = _change(history, group, stand, found[loudest][1], now)
            if change is not None and not (change.is_load and now < change.onset + RECENT):
                stand.append(change)  # some more recordings separate what an axis carries from a fault that grows
    changes = []
    for stand in standing:
        for i, change in enumerate(stand):
            last = stand[i + 1].alarm_row - 1 if i + 1 < len(stand) else len(rows) - 1
            changes.append(_until_now(history, _resized(history, change, stand[:i], last), stand[:i], limit_of, size_of))
    faults = [change for change in changes if not change.is_load]
    return replace(history, changes=sorted(faults, key=lambda c: c.alarm_row), evidence=total)


def _evidence(
    history: Judgement, causes: dict[Cause, Any], group: int, standing: Sequence[Change], stop: int
) -> dict[Cause, tuple[float, int]]:
    """Evidence and onset of each cause of a group, but those that stand, at the row before `stop`."""
    one = history.series[group]
    inside = (one.at >= stop - LONGEST) & (one.at < stop)
    at = one.at[inside]
    if at.size < 3 or at[-1] != stop - 1:
        return {}
    total, onset = np.zeros(len(one.directions)), np.zeros(len(one.directions), int)
    for warms in (False, True):
        own = one.warms == warms
        total[own], first = evidence(one.sizes[inside][:, own], history.nuisance(group, warms, standing)[at], LEAST / 5.0)
        onset[own] = at[first]
    known = {change.cause for change in standing}
    return {
        cause: (float(total[own].mean()), int(onset[own[int(np.argmax(total[own]))]]))
        for cause, (g, own) in causes.items()
        if g == group and cause not in known
    }


def _change(history: Judgement, group: int, standing: Sequence[Change], onset: int, now: int) -> Change | None:
    """The change of a group from the rows before `onset` to those up to `now`, by the cause that explains it best. None unless it is certainly more
    than `LEAST`, and the series of the cause itself shows the same size.
    """
    one = history.series[group]
    inside = one.at <= now
    at = one.at[inside]
    since = int(np.searchsorted(at, onset))
    if since < 2:
        return None
    nuisances = [history.nuisance(group, warms, standing)[at] for warms in (False, True)]
    levels = [level(y, nuisances[int(warms)], since) for y, warms in zip(one.sizes[inside].T, one.warms)]
    scatter = np.array([max(found.scatter, LEAST_SCATTER) for found in levels])
    # also causes that no alarm can come from: a torque constant is friction and inertia together, and the axis may carry something else
    shown = np.flatnonzero(np.diag(one.gram) > SHOWN)
    blocks = waves_of(one.directions, shown)
    explained = one.explained_by(blocks, np.array([found.size for found in levels]), scatter)
    best: dict[Cause, tuple[float, int, float, float]] = {}
    for block, (gain, theta) in zip(blocks, explained):
        cause = one.directions[block[0]].cause
        if not is_load(cause[0]) and abs(amplitude(theta)) > PLAUSIBLE * one.directions[block[0]].most:
            continue
        if gain > best.get(cause, (0.0, 0, 0.0, 0.0))[0] and cause not in {change.cause for change in standing}:
            best[cause] = gain, block[0], amplitude(theta), amplitude([levels[k].size for k in block])
    if not best:
        return None
    order = sorted(best, key=lambda cause: -best[cause][0])
    gain, k, moved, own = best[order[0]]
    size = replace(levels[k], size=own)
    if abs(own) - size.half() < LEAST or abs(moved - own) > AGREES * abs(own):
        return None
    rivals = tuple(cause for cause in order[1:4] if best[cause][0] > RIVAL * gain)
    return Change(group, k, one.directions[k], onset, now, size, rivals)


def _resized(history: Judgement, change: Change, standing: Sequence[Change], now: int) -> Change:
    """The change judged again with all recordings up to the row `now`."""
    again = _change(history, change.group, standing, change.onset, now)
    return change if again is None else replace(again, alarm_row=change.alarm_row)


def _until_now(history: Judgement, change: Change, standing: Sequence[Change], limit_of: LimitOf, size_of: SizeOf) -> Change:
    """The change with its size by all recordings, and the day when it reaches its limit, from its last recordings."""
    one = history.series[change.group]
    nuisance = history.nuisance(change.group, bool(one.warms[change.k]), standing)[one.at]
    alike = [k for k, d in enumerate(one.directions) if (d.cause, d.wave) == (change.cause, change.direction.wave)]
    levels = [level(one.sizes[:, k], nuisance, int(np.searchsorted(one.at, change.onset))) for k in alike]
    size = replace(levels[0], size=amplitude([found.size for found in levels]))
    y, days = sizes_over_time(history, change.group, change.k, change.onset)
    after = np.flatnonzero(one.at >= change.onset)[-RECENT:]
    factor = size_of(change.direction, one, size.size) / size.size if size.size else 1.0
    limit = limit_of(change.direction, factor * size.size)
    ahead = forecast(days[after], factor * y[after], limit.size, float(days[-1]))
    return replace(change, size=size.times(factor), limit=limit, forecast=ahead)


def sizes_over_time(history: Judgement, group: int, k: int, until: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of a direction in usual sizes, free of nuisances, zero on average before the row `until`, and the days of the recordings."""
    one = history.series[group]
    nuisance = history.nuisance(group, bool(one.warms[k]))[one.at]
    before = one.at < (until if until is not None else len(history.rows))
    y = one.sizes[:, k]
    coefficients = np.linalg.lstsq(nuisance[before], y[before], rcond=1e-9)[0]
    days = np.array([(history.rows[i].day - history.rows[0].day).total_seconds() / 86400.0 for i in one.at])
    return y - nuisance @ coefficients, days
