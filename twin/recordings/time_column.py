"""Time of a recording: a column and its unit, an interval that the file states or the speeds show, or none.

The unit is, in this order, that of the user, that of the file, that of a count since 1970, or assumed: the first of s, ms, us and ns
by which the steps are below half a second, because no control records slower. An assumed unit and a missing time are said in `TimeSource.text`.

v = k dx/dt: if the time is in another unit, or only counts rows, k shows it. Of the pairs of time and speed units that explain k the usual one is taken.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import re

import numpy as np

from twin.errors import InputError, nearest
from twin.recordings.names import english, meaning_of
from twin.recordings.relations import even_step
from twin.recordings.signals import BLOCK, IMPOSSIBLE_VALUE, Clock, Recording, Signal, TimeSource, known_unit, split_heading
from twin.recordings.timing import LONGER, LONGEST_S, MANY_GAPS, SHORTEST_S, Restarts
from twin.recordings.units_found import FASTEST_S, SLOWEST_S, interval_of_rows, surprise_of
from twin.units import RECORDED_UNITS, dimension_recorded

_NAMES = (
    "time", "t", "zeit", "timestamp", "stamp", "temps", "tempo", "x-achse", "x axis", "x_value", "datetime", "date time", "date/time", "datum/zeit", "uhrzeit",
    "zeitstempel", "horodatage", "zeitpunkt", "elapsed time", "elapsed", "relative time", "abs time", "clock", "seconds", "sekunden", "millis",
)  # fmt: skip
_UNIT_OF_NAME = {"seconds": "s", "sekunden": "s", "millis": "ms"}
_ENDING = re.compile(r"[ _](?:in )?(s|sec|ms|us|µs|ns|min)$", re.IGNORECASE)
_TODAY = (9.4e8, 2.9e9)
"""Seconds from 1970 to 1999 and to 2061."""
_DATES = (
    (1.0, 0.0, "s since 1970"), (1e-3, 0.0, "ms since 1970"), (1e-6, 0.0, "us since 1970"), (1e-9, 0.0, "ns since 1970"),
    (86400.0, 2209161600.0, "days since 1900"), (0.0864, 2209161600.0, "millionths of a day since 1900"), (1.0, 2082844800.0, "s since 1904"),
    (1e-7, 11644473600.0, "100 ns since 1601"), (1e-7, 62135596800.0, "100 ns since the year 1"),
)  # fmt: skip
"""Counts since a date: seconds of a count, seconds from the date to 1970, what it is. Workbooks count days from 1900, LabVIEW from 1904, Windows from
1601, .NET from the year 1."""
_LONGEST_STEP_S = 2.0
"""Steps of a date are shorter: 40000 may also be seconds since a control was switched on, and 4.2e9 the milliseconds of a robot's clock."""
UNNAMED = "column {}"
"""Name of a column that has none."""
COUNTERS = ("", UNNAMED.format(1), "unnamed: 0", "index", "idx", "n", "nr", "no", "row", "zeile", "#", "sample", "samples", "point", "punkt", "count",
            "cycle", "zyklus")  # fmt: skip
"""Names of a column that numbers the rows."""
NO_TIME = "no time: neither a column nor a line of the file gives it; give the interval of the samples with --interval-ms"


def find_time(
    names: Sequence[str],
    units: Sequence[str],
    heads: Sequence[np.ndarray],
    clock: Clock,
    where: str,
    interval_s: float | None,
) -> TimeSource:
    """The time among columns with these names, units and first values. `interval_s`: interval that the file states.

    Raises:
        InputError: the user names a column that does not exist, or a unit that is none of time.
    """
    heads = [head[~np.isnan(head)] for head in heads]

    def found(at: int) -> TimeSource:
        """The time column with its unit."""
        name, head = split_heading(names[at])[0], heads[at]
        ending = _ENDING.search(name)
        of_name = known_unit(ending[1]) if ending else _UNIT_OF_NAME.get(name.lower(), "")
        stated = known_unit(clock.unit) if clock.unit else units[at] or of_name
        if (rest := _rest(names, heads, at)) is not None:
            text = f"'{name}' and '{names[rest[0]]}' are the time"
            return TimeSource(name, text=text, at=at, count_s=1.0, rest=rest)
        if (clock.unit and (not stated or dimension_recorded(stated) != "time")) or (stated and dimension_recorded(stated) != "time"):
            raise InputError(f"{where}: time column '{name}': [{clock.unit or stated}] is not a unit of time; use s, ms, us, ns or min")
        if not (clock.unit or units[at]) and (date := _since(head)):
            return TimeSource(name, text=f"'{name}' counts {date[2]}", at=at, count_s=date[0], since_s=date[1])
        if stated or len(head) < 2:
            return TimeSource(name, stated or "s", at=at)
        step = _step(head)
        if interval_s is not None and step > 0.0:
            for unit in ("s", "ms", "us", "ns"):
                if abs(step * RECORDED_UNITS[unit][1] / interval_s - 1.0) < 0.05:
                    return TimeSource(name, unit, at=at)
        unit = _assumed(step)
        seconds = step * RECORDED_UNITS[unit][1]
        what = f"nothing states the unit of '{name}'" + (", which may only number the rows" if numbers_rows(head) else "")
        text = f"{what}: its steps of {step:.4g} are taken as {unit} ({seconds * 1e3:.4g} ms a row); if that is wrong, give --interval-ms"
        return TimeSource(name, unit, assumed=True, text=text, at=at)

    if clock.interval_s is not None:
        text = next((said for i in time_candidates(names, units) if (said := _uneven(names[i], heads[i], clock.interval_s))), "")
        return TimeSource(text=text, interval=clock.interval_s)
    if clock.column is not None:
        plain = [split_heading(n)[0] for n in names]
        at = next((i for i, name in enumerate(names) if clock.column in (name, plain[i])), None)
        if at is None:
            raise InputError(f"{where}: no time column '{clock.column}'; {nearest(clock.column, names)}")
        return found(at)
    # of several candidates the one that distinguishes most rows and does not just number them, then the likelier name
    candidates = [i for i in time_candidates(names, units) if _runs(heads[i])]
    if not candidates and interval_s is None and names and names[0] == UNNAMED.format(1) and _ticks(heads[0]):
        candidates = [0]
    candidates = candidates or [i for i, head in enumerate(heads) if not units[i] and _runs(head) and _since(head)]
    if candidates:
        distinct = {i: len(np.unique(heads[i])) for i in candidates}
        finest = [i for i in candidates if distinct[i] >= 0.9 * max(distinct.values())]
        return found(min(finest, key=lambda i: (numbers_rows(heads[i]), even_step(heads[i]) is None)))
    if interval_s is not None:
        return TimeSource(text=f"every {interval_s * 1e3:.6g} ms, as the file states", interval=interval_s)
    return TimeSource(known=False, text=NO_TIME)


def _uneven(name: str, head: np.ndarray, interval_s: float) -> str:
    """What a column of times says against an interval that the user gives; "" if it is even."""
    steps = np.diff(head) if len(head) > 2 else np.zeros(1)
    if not np.mean(steps > LONGER * np.median(steps)) > MANY_GAPS:
        return ""
    return f"the rows are taken as {interval_s * 1e3:.6g} ms apart, as given; '{name}' steps by {steps.min():.4g} to {steps.max():.4g}"


def _rest(names: Sequence[str], heads: Sequence[np.ndarray], at: int) -> tuple[int, float] | None:
    """Index of the column with the parts of the seconds in column `at`, 'stamp.nanosec' beside 'stamp.sec', and seconds per number; None if there is none."""
    match = re.fullmatch(r"(.*?)(?:sec|secs|seconds|tv_sec)", names[at], re.IGNORECASE)
    part = rf"{re.escape(match[1])}(?:tv_)?({_PART})(?:sec|secs|seconds|s)" if match else "(?!)"
    return part_of_second(names, heads, re.compile(part, re.IGNORECASE))


_PART = "n|nano|u|micro|m|milli"
PART = re.compile(rf"(?:.*[ _.])?({_PART})(?:sec|secs|seconds?|s|tm)", re.IGNORECASE)
"""Name of a column with the part of a second beside a time of day in whole seconds."""


def part_of_second(names: Sequence[str], heads: Sequence[np.ndarray], part: re.Pattern[str]) -> tuple[int, float] | None:
    """Index of the column whose name is such a part of a second and whose numbers stay below one, and seconds per number; None if there is none."""
    for i, name in enumerate(names):
        found, head = part.fullmatch(name), heads[i]
        size = {"n": 1e-9, "u": 1e-6, "m": 1e-3}[found[1].lower().replace("micro", "u")[0]] if found else 0.0
        if found and len(head) and head.min() >= 0.0 and head.max() * size < 1.0 and np.ptp(head) > 0.0:
            return i, size
    return None


def _since(head: np.ndarray) -> tuple[float, float, str] | None:
    """The one of _DATES from which a column counts; None if it does not begin today."""
    found = next((d for d in _DATES if len(head) and _TODAY[0] < head[0] * d[0] - d[1] < _TODAY[1]), None)
    return found if found is not None and 0.0 < _step(head) * found[0] < _LONGEST_STEP_S else None


def _step(head: np.ndarray) -> float:
    """Median step of a time that may stand in several rows; 0 if it never runs."""
    steps = np.diff(head)
    return float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0


def _assumed(step: float) -> str:
    """Unit of a time without one, from its steps."""
    return next((unit for unit in ("s", "ms", "us") if step * RECORDED_UNITS[unit][1] < SLOWEST_S), "ns")


def time_candidates(names: Sequence[str], units: Sequence[str]) -> list[int]:
    """Indices of the columns with names of a time, most likely first: 'time', 'rec.time', 'time_cont'."""
    ranked = []
    for i, name in enumerate(names):
        if units[i] == "" or dimension_recorded(units[i]) == "time":
            plain = _ENDING.sub("", english(split_heading(name)[0].lower())).strip(" _#%")
            last = re.split(r"[./]", plain)[-1]
            prefixed = last.endswith(("_time", "_timestamp", "_zeit"))
            kinds = (plain in _NAMES, last in _NAMES, last.startswith(("time_", "zeit_", "timestamp")), units[i] != "", prefixed)
            if any(kinds):
                ranked.append((kinds.index(True), i))
    return [i for _, i in sorted(ranked)]


def interval_of(name: str, value: float) -> float | None:
    """The interval of the samples [s] that a single number states: 'Ts', 'sample_interval_ms', or a rate, 'fs'; None if it is no such number."""
    match = _INTERVAL.search(name)
    if match is None or not value > 0.0:
        return None
    unit = (match[3] or "").lower()
    interval = 1.0 / (value * (1e3 if unit == "khz" else 1.0)) if match[1] else value * (RECORDED_UNITS[unit][1] if unit else 1.0)
    return interval if SHORTEST_S <= interval <= LONGEST_S else None


_INTERVAL = re.compile(
    r"(?:^|[._/ ])(?:(fs|f_?sample|sampl(?:e|ing)_?(?:rate|freq(?:uency)?))|(ts|dt|t_?sample|delta_?t|wf_increment|cycle_?time|sampl(?:e|ing)_?(?:time|period|interval)))"
    r"[ _]?[\[(]?(k?hz|s|ms|us|ns)?[\])]?$",
    re.IGNORECASE,
)


def share_time(
    columns: Mapping[str, tuple[np.ndarray, str]],
    clock: Clock,
    where: str,
    interval_s: float | None = None,
    intervals: Mapping[str, float] | None = None,
) -> tuple[dict[str, Signal], TimeSource, int]:
    """Signals from columns (values, unit) on one time, its source, and how often it starts again. A column of another length gets no time, unless
    `intervals` [s] has its own.

    A unit in the heading, as in 'X.position [mm]', is taken off where the rest is unique.
    """
    split = {name: split_heading(name) for name in columns}
    plain = [bare for bare, _ in split.values()]
    called = {name: bare if plain.count(bare) == 1 else name for name, (bare, _) in split.items()}
    columns = {called[name]: (columns[name][0], columns[name][1] or unit) for name, (_, unit) in split.items()}
    own = (intervals or {}) if clock.interval_s is None else {}
    own_time = {called[n]: np.arange(len(columns[called[n]][0])) * step for n, step in own.items()}
    names = list(columns)
    units = [unit for _, unit in columns.values()]
    found = find_time(names, units, [np.asarray(values[:4096], float) for values, _ in columns.values()], clock, where, interval_s)
    if found.at is None:
        rows = max((len(values) for values, _ in columns.values()), default=0)
        time = np.arange(rows) * found.factor
    else:
        values = np.asarray(columns[names[found.at]][0], float)
        time = (values - (values[0] if found.count_s else 0.0)) * found.factor
        time = time + (columns[names[found.rest[0]]][0] * found.rest[1] if found.rest else 0.0)
    restarts = Restarts()
    time = restarts(time)
    signals = {
        name: Signal(name, np.asarray(values, float), own_time.get(name, time if len(values) == len(time) else np.empty(0)), unit)
        for i, (name, (values, unit)) in enumerate(columns.items())
        if i not in (found.at, found.rest and found.rest[0]) and not is_counter(name, np.asarray(values[:4096], float))
    }
    return signals, found, restarts.count


def numbers_rows(head: np.ndarray) -> bool:
    """True for a column 0, 1, 2, ... that only numbers the rows; it may begin anew in each part."""
    fine = head[np.isfinite(head)]
    return len(fine) > 2 and bool(np.mean(np.diff(fine) == 1.0) > 0.95)


def is_counter(name: str, head: np.ndarray) -> bool:
    """True for a column that numbers the rows and is named like that, or not at all."""
    return name.lower() in COUNTERS and numbers_rows(head)


def _ticks(head: np.ndarray) -> bool:
    """True for numbers that rise from row to row like those of a clock: most of their steps are alike."""
    steps = np.diff(head)
    return len(steps) > 9 and bool(np.all(steps > 0.0) and np.mean(np.abs(steps / np.median(steps) - 1.0) < ALIKE) > 0.9)


ALIKE = 0.2
"""Steps of a clock that jitters differ from their median by less than this share."""


def _runs(time: np.ndarray) -> bool:
    """True if the times are finite and mostly go forwards: they may stand still where rounded, and go back where a part begins."""
    # counts of ns since 1970 are larger than any measurement
    if len(time) < 2 or not np.all(np.isfinite(time)) or not np.all(np.abs(time) < 1e4 * IMPOSSIBLE_VALUE):
        return False
    steps = np.diff(time)
    return bool(np.count_nonzero(steps > 0.0) > 0 and np.count_nonzero(steps < 0.0) <= 0.1 * len(steps))


OTHER_UNIT = 0.5
"""Surprise of a unit of time that the file's numbers do not suggest."""


UNKNOWN = TimeSource(known=False, text=NO_TIME.partition(";")[0], question="how far apart are the samples? give it with --interval-ms")


def time_of(recordings: Sequence[Recording]) -> TimeSource:
    """What the map must say about the time; without a text if the files state it."""
    for recording in recordings:
        if recording.source.known and not recording.source.assumed:
            continue
        if (source := recording.source).known:
            return replace(source, question=source.text if source.unit != "s" else "")
        for signal in recording.signals.values():
            other = signal.stated_unit or (signal.unit and dimension_recorded(signal.unit) != "time") or meaning_of(signal.name) is not None
            if not other and (step := even_step(signal.head)) is not None and not numbers_rows(signal.head):
                unit = _assumed(step)
                text = f"'{signal.name}' increases by {step:.4g} a row: taken as the time in {unit}"
                return TimeSource(signal.name, unit, text=text, question=text)
        return UNKNOWN
    return TimeSource()


def with_time(recordings: Sequence[Recording], time: TimeSource) -> list[Recording]:
    """The recordings with the times that were found, where the file does not state them: those of the first block, which the proposal reads."""
    out = []
    for recording in recordings:
        source, signals = recording.source, dict(recording.signals)
        if time.known and (not source.known or (source.assumed and time.column == source.column)):
            # by the unit of the column that the reader took, by another column, or by the interval of the rows
            factor = time.factor / (source.factor if source.known else 1.0)
            column = None if source.known or not time.column else signals.pop(time.column, None)
            if source.known or not time.column or column is not None:
                for n, s in signals.items():
                    own = s.time if column is None else column.values
                    fits = len(own) == len(s.values)
                    signals[n] = replace(s, time=np.asarray(own[0:BLOCK], float) * factor if fits else np.empty(0))
        out.append(replace(recording, signals=signals))
    return out


def by_speed(time: TimeSource, position: str, factor: float, interval: float) -> TimeSource:
    """The time by a speed that is `factor` times the slope of a position in the unit `position`. `interval` [s] of the samples as read so far."""
    if not time.known:
        found = interval_of_rows(position, factor)
        if found is None:
            return time
        text = f"no time in the file: {found[0] * 1e3:g} ms a row, if positions are in {position} and the speed in {found[1]}"
        return TimeSource(text=text, interval=found[0], question=f"{text}; if not, give --interval-ms")
    if not time.column:
        return time
    ranked = []
    for unit in ("s", "ms", "us"):
        ratio = RECORDED_UNITS[unit][1] / RECORDED_UNITS[time.unit][1]
        unusual = 4.0 * (not FASTEST_S <= interval * ratio <= SLOWEST_S)
        ranked.append((surprise_of(position, factor * ratio) + unusual + OTHER_UNIT * (unit != time.unit), unit, interval * ratio))
    (best, unit, seconds), (second, *_) = sorted(ranked)[:2]
    text = f"'{time.column}' is taken in {unit} ({seconds * 1e3:.4g} ms a row), as the recorded speed shows"
    return replace(time, unit=unit, text=text, question="" if second - best >= 1.0 else f"{text}; if not, give --interval-ms")
