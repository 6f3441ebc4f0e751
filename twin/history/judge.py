"""The judgement of a history: which axis changed, when, by what cause and how much, and when it reaches a limit.

The rule runs through the recordings by day. At each it averages the evidence for a change (`twin.history.change`) over all causes of the machine; where
one group of axes brings it above `ALARM`, it raises an alarm. The alarm names the cause that explains the change of all directions of its group best.
The recordings from the onset on then become the new reference of that group.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin.history.change import LONGEST, Forecast, Level, evidence, forecast, level
from twin.history.columns import Direction, amplitude
from twin.history.series import LOAD, SCATTER, Series, constants_of, programs_of, series_of, thermometers
from twin.history.store import Row

FALSE_ALARM_WEEKS, ALARM = 1000.0, 3000.0
"""Mean number of recordings between false alarms of one machine as stated, and the evidence that an alarm needs: it holds that rate three times over,
because the scatter of real recordings is not quite normal and independent.
"""

LEAST = 0.1
"""Change in usual sizes below which nothing is reported: half of what an alarm should find."""

LEAST_SCATTER = 0.01
"""Smallest scatter between recordings in usual sizes: load and friction act on the rest too, in ways that are not linear."""

RIVAL = 0.8
"""Share of the best cause's chi^2 from which another cause is named beside it."""

RECENT = 8
"""Recordings from which a growth is carried forward."""

Cause = tuple[str, str, str]


@dataclass(frozen=True)
class Change:
    """A change: cause, the row of its onset and of its alarm, size in usual sizes, other causes that explain nearly as much."""

    cause: Cause
    direction: Direction
    onset: int
    alarm: int
    size: Level
    rivals: tuple[Cause, ...] = ()
    forecast: Forecast | None = None
    first: int = 0  # first row of the reference before it


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

    def nuisance(self, group: int, warms: bool) -> np.ndarray:
        """What is removed from the directions of a group (row, column), that temperature acts on or not."""
        return np.column_stack([self.constants, self.temperature[group]]) if warms else self.constants


def causes_of(series: Sequence[Series]) -> dict[Cause, tuple[int, list[int]]]:
    """Causes that the recordings show: index of the series, and the directions of each. What an axis carries is no fault of the machine."""
    found: dict[Cause, tuple[int, list[int]]] = {}
    for g, one in enumerate(series):
        for k, direction in enumerate(one.directions):
            if one.seen[k] and SCATTER.get(direction.setting.effect.name) != LOAD:
                found.setdefault(direction.cause, (g, []))[1].append(k)
    return found


def judged(rows: Sequence[Row], directions: dict[tuple[str, ...], list[Direction]]) -> Judgement:
    """The judgement of all recordings by day."""
    series = [s for axes, own in directions.items() if (s := series_of(rows, axes, own)) is not None]
    constants = constants_of(programs_of(rows)) if rows else np.zeros((0, 0))
    history = Judgement(rows, series, constants, [thermometers(series, one, len(rows)) for one in series])
    causes = causes_of(series)
    changes: list[Change] = []
    total, start = np.zeros(len(rows)), [0] * len(series)
    for now in range(len(rows)):
        by_cause, onsets = _evidence(history, causes, [max(first, now + 1 - LONGEST) for first in start], now + 1)
        total[now] = sum(by_cause.values()) / max(len(causes), 1)
        for group in range(len(series)):
            own = {cause: e / len(causes) for cause, e in by_cause.items() if causes[cause][0] == group}
            if sum(own.values()) > ALARM:
                loudest = max(own, key=lambda cause: own[cause])
                change = _change(history, causes, group, start[group], onsets[loudest], now)
                if change is not None:
                    start[group] = change.onset
                    changes.append(change)
    return replace(history, changes=_joined(history, causes, changes), evidence=total)


def _evidence(
    history: Judgement, causes: dict[Cause, Any], starts: Sequence[int], stop: int
) -> tuple[dict[Cause, float], dict[Cause, int]]:
    """Evidence and onset of each cause at the row before `stop`; `starts` are the first rows of the reference of each group."""
    by_cause, onsets = {}, {}
    for g, (one, start) in enumerate(zip(history.series, starts)):
        inside = (one.at >= start) & (one.at < stop)
        if one.at[inside].size < 3 or one.at[inside][-1] != stop - 1:
            continue
        at = one.at[inside]
        total, onset = np.zeros(len(one.directions)), np.zeros(len(one.directions), int)
        for warms in (False, True):
            own = one.warms == warms
            found = evidence(one.sizes[inside][:, own], history.nuisance(g, warms)[at], LEAST / 5.0)
            total[own], onset[own] = found.total, at[found.onset]
        for cause, (group, own_directions) in causes.items():
            if group == g:
                by_cause[cause] = float(total[own_directions].mean())
                onsets[cause] = int(onset[own_directions[int(np.argmax(total[own_directions]))]])
    return by_cause, onsets


def _change(history: Judgement, causes: dict[Cause, Any], group: int, start: int, onset: int, now: int) -> Change | None:
    """The change of a group from the rows before `onset` to those up to `now`, by the cause that explains it best; None if it is too small."""
    one = history.series[group]
    inside = (one.at >= start) & (one.at <= now)
    at = one.at[inside]
    since = int(np.searchsorted(at, onset))
    if since < 2:
        return None
    levels = [level(y, history.nuisance(group, bool(warms))[at], since) for y, warms in zip(one.sizes[inside].T, one.warms)]
    scatter = np.array([max(found.scatter, LEAST_SCATTER) for found in levels])
    owners = [cause for cause, (g, _) in causes.items() if g == group for _ in _waves(one, causes[cause][1])]
    blocks = [block for cause, (g, own) in causes.items() if g == group for block in _waves(one, own)]
    explained = one.explained_by(blocks, np.array([found.size for found in levels]), scatter)
    best: dict[Cause, tuple[float, int, float]] = {}
    for cause, block, (gain, theta) in zip(owners, blocks, explained):
        if gain > best.get(cause, (0.0, 0, 0.0))[0]:
            best[cause] = gain, block[0], amplitude(theta)
    if not best:
        return None
    order = sorted(best, key=lambda cause: -best[cause][0])
    gain, k, moved = best[order[0]]
    if abs(moved) < LEAST:
        return None
    size = replace(levels[k], size=moved)
    rivals = tuple(cause for cause in order[1:4] if best[cause][0] > RIVAL * gain)
    return Change(order[0], one.directions[k], onset, now, size, rivals, first=start)


def _waves(one: Series, directions: Sequence[int]) -> list[list[int]]:
    """The directions of one cause, sine and cosine of each wave together."""
    waves = dict.fromkeys(one.directions[k].wave for k in directions)
    return [[k for k in directions if one.directions[k].wave == wave] for wave in waves]


def _joined(history: Judgement, causes: dict[Cause, Any], changes: Sequence[Change]) -> list[Change]:
    """The changes, those that go on in one, with size, cause and forecast by all recordings up to the next change of their group."""
    out: list[Change] = []
    for change in changes:
        group = causes[change.cause][0]
        earlier = next((c for c in reversed(out) if causes[c.cause][0] == group), None)
        again = earlier and _resized(history, causes, earlier, change.alarm)
        if earlier is not None and again is not None and change.cause in (earlier.cause, again.cause):
            out[out.index(earlier)] = again
        else:
            out.append(change)
    last = {causes[c.cause][0]: c for c in out}
    whole = len(history.rows) - 1
    return [_forecast(history, causes, _resized(history, causes, c, whole)) if last[causes[c.cause][0]] is c else c for c in out]


def _resized(history: Judgement, causes: dict[Cause, Any], change: Change, now: int) -> Change:
    """The change judged again with all recordings up to the row `now`."""
    again = _change(history, causes, causes[change.cause][0], change.first, change.onset, now)
    return change if again is None else replace(again, alarm=change.alarm)


def _forecast(history: Judgement, causes: dict[Cause, Any], change: Change, limit: float = 1.0) -> Change:
    """The change with the day at which its size reaches `limit` [usual sizes], from the recordings since its onset."""
    group, _ = causes[change.cause]
    one = history.series[group]
    k = list(one.directions).index(change.direction)
    y, days = sizes_over_time(history, group, k, change.onset)
    after = np.flatnonzero(one.at >= change.onset)[-RECENT:]
    return replace(change, forecast=forecast(days[after], y[after], limit, float(days[-1])))


def sizes_over_time(history: Judgement, group: int, k: int, until: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of a direction in usual sizes, free of nuisances, zero on average before the row `until`, and the days of the recordings."""
    one = history.series[group]
    nuisance = history.nuisance(group, bool(one.warms[k]))[one.at]
    before = one.at < (until if until is not None else len(history.rows))
    y = one.sizes[:, k]
    coefficients = np.linalg.lstsq(nuisance[before], y[before], rcond=1e-9)[0]
    days = np.array([(history.rows[i].day - history.rows[0].day).total_seconds() / 86400.0 for i in one.at])
    return y - nuisance @ coefficients, days
