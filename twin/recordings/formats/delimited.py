"""Text of any layout as signals: encoding, delimiter, decimal mark, heading and layout are detected, or given in the map.

The file is read in blocks, and wanted columns go to disk as float64. An empty cell means no sample (a signal with a longer interval,
or lost samples). The text NaN is an error.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
import re

import numpy as np

from twin.errors import InputError
from twin.limits import refuse_bytes
from twin.recordings.formats.text_cells import BLANK, NUMBER, STAMP, WORD, cells_of, is_number, stamp_of
from twin.recordings.formats.text_heading import UNUSED, Heading, Named, read_heading
from twin.recordings.formats.text_layout import Rows, find_rows, long_table, names_in_pairs, table_of_axes
from twin.recordings.formats.text_sample import Sample, read_sample
from twin.recordings.formats.text_stream import Clocks, Layout, stream
from twin.recordings.signals import IMPOSSIBLE_VALUE, ReadOptions, Recording, Signal, TimeSource, known_unit, of_given_file
from twin.recordings.time_column import PART, UNNAMED, find_time, interval_of, is_counter, numbers_rows, part_of_second, time_candidates

_SEPARATORS = {",": "comma", ";": "semicolon", "\t": "tab", " ": "space", "|": "bar"}


def read(path: Path, options: ReadOptions) -> Recording:
    """Read the wanted columns (all without a map). In a long table each name is a signal with times of its own."""
    if lines := _turned_over(read_sample(path, options.dialect.get("encoding"))):
        text = "\n".join("\t".join(row) for row in zip(*lines)) + "\n"
        return read_made(path, options, lambda file: file.write_text(text, encoding="utf-8", newline=""))
    layout = find_layout(path, options)
    names, wanted, rows, long = layout.names, options.wanted, layout.rows, layout.long
    if not long and wanted is not None and (words := [names[i] for i in rows.columns(WORD) if names[i] in wanted]):
        raise InputError(f"{path}: column '{words[0]}' contains words; leave it out of the map")
    chosen = [i for i in layout.kept if long or wanted is None or names[i] in wanted]
    unread = (
        {} if long else {names[i]: Signal(names[i], np.empty(0), np.empty(0)) for i in layout.kept}
    )  # for the nearest match in messages only
    if not chosen:
        return Recording(path, "CSV", unread)
    clocks = Clocks({i: layout.times[i] for i in chosen}, layout.stamps)
    columns = stream(layout, chosen, clocks, options.scratch / path.name, strict=wanted is not None)
    if long:
        one = len(long.values) == 1
        labels = map(" ".join, zip(*map(rows.texts, long.names)))
        stated = dict(zip(labels, map(known_unit, rows.texts(long.unit)))) if one and long.unit is not None else {}
        unread, signals = {}, {}
        for (label, i), own in columns.items():
            name = label if one else f"{label} {names[i]}"
            if wanted is not None and name not in wanted:
                unread[name] = Signal(name, np.empty(0), np.empty(0))
            elif len(own[0]) > 1:
                signals[name] = Signal(name, *own, stated.get(label, "") if one else layout.heads[i].unit)
        count = len({label for label, _ in columns})
        more = [f"one value a row: {count} names" if one else f"one axis a row: {count} axes"]
    else:
        signals, more = {}, []
        for i, (values, time) in columns.items():
            name, unit = names[i], layout.heads[i].unit
            if len(values) > 1:  # the unit as written where it is none of the twin's
                signals[name] = Signal(name, values, time, unit, stated_unit="" if unit else layout.heads[i].written)
            else:
                more.append(f"column '{name}' holds {len(values) or 'no'} number{'s' * (not len(values))}")
    mark = "comma" if rows.decimal == "," else "point"
    note = f"CSV: {_SEPARATORS[rows.delimiter]}, decimal {mark}, numbers from line {rows.first + 1}, {layout.sample.encoding}"
    source = next((s for i in chosen if (s := layout.times[i]).text), layout.times[chosen[0]])
    notes = [note, *layout.notes, *more, *([source.text] if source.text else [])]
    if layout.left_out:
        notes.append(f"lines left out: {len(layout.left_out)}, the first '{layout.left_out[0][:40]}'")
    if clocks.restarts:
        notes.append(f"the time starts again at {clocks.restarts} row{'s' * (clocks.restarts > 1)}: each part is a run of its own")
    started = datetime.fromtimestamp(clocks.origin_ns * 1e-9, UTC) if clocks.dated and clocks.origin_ns is not None else None
    return Recording(path, "CSV", {**unread, **signals}, started, tuple(notes), restarts=clocks.restarts, source=source)


def read_made(path: Path, options: ReadOptions, write: Callable[[Path], object]) -> Recording:
    """The recording in `path` as the text that `write` makes of it."""
    file = options.scratch / "made" / f"{path.name}.txt"
    file.parent.mkdir(parents=True, exist_ok=True)
    write(file)
    return of_given_file(path, file, lambda: read(file, options))


def _turned_over(sample: Sample) -> list[list[str]]:
    """The cells of a text with a signal in each line, its name first; [] if the signals stand in columns."""
    with sample.path.open(encoding=sample.encoding) as text:
        first = text.readline()
        delimiter = max(_SEPARATORS, key=first.count)
        cells = cells_of(first.strip(), delimiter)
        if len(cells) < LONG_LINE or is_number(cells[0]) or not all(map(is_number, cells[1:])):
            return []
        size = BYTES_PER_CELL * len(cells) * sample.path.stat().st_size / len(first)
        refuse_bytes(size, str(sample.path), "export it with a signal in each column")
        lines = [cells, *(cells_of(line.strip(), delimiter) for line in text if line.strip())]
    return lines if len(lines) < len(cells) and all(len(line) == len(cells) for line in lines) else []


LONG_LINE, BYTES_PER_CELL = 100, 100.0
"""Cells of a line that is a signal, and memory for each."""


def find_layout(path: Path, options: ReadOptions) -> Layout:
    """Layout of a file. Values in the map's [csv] take precedence."""
    given = options.dialect
    sample = read_sample(path, given.get("encoding"))
    rows = find_rows(sample, given)
    width = len(rows.kinds)
    heading = read_heading(sample.lines[: rows.first], rows.delimiter, [kind != BLANK for kind in rows.kinds], given, path)
    heads = list(heading.columns)
    pairs = names_in_pairs(rows, any(head.name for head in heads))
    stamps = () if pairs and any(rows.kinds[i] == STAMP for i in pairs) else _stamps(rows)
    if pairs:
        heads = [Named(pairs.get(i, "")) for i in range(width)]
    elif heads[-1].name == "" and rows.kinds[-1] != BLANK and len(stamps) == 2:
        heads.insert(stamps[1], heads.pop())  # a date and a clock time under one name
    elif heads[-1].name == "" and rows.kinds[-1] != BLANK and any(head.name for head in heads) and numbers_rows(rows.values(0)):
        heads.insert(0, heads.pop())  # row numbers without a name, as R writes them
    names, units = [head.name for head in heads], [head.unit for head in heads]
    names = [name or (UNNAMED.format(i + 1) if rows.kinds[i] != BLANK else "") for i, name in enumerate(names)]

    def time_of(among: Sequence[int], stamps: Sequence[int] = ()) -> TimeSource:
        """The time of the columns `among`."""
        clock = options.clock
        if stamps and clock.interval_s is None and clock.column in (None, *(names[i] for i in stamps)):
            shown = rows.texts(stamps[-1])  # a clock of whole seconds may have its milliseconds in another column
            rest = part_of_second(names, [rows.values(i) for i in range(width)], PART) if len(set(shown)) < len(shown) else None
            return TimeSource(names[stamps[-1]], "ns", at=stamps[-1], rest=rest)
        # a column of words or dates cannot be a time in numbers
        index = [i for i in rows.columns(NUMBER) if i in among or clock.column is not None]
        if len(among) == 1 and clock.interval_s is None:
            clock = replace(clock, column=names[among[0]])
        alone = {names[i]: float(own[0]) for i in among if len(own := (v := rows.values(i))[np.isfinite(v)]) == 1}
        beside = next((interval for name, value in alone.items() if (interval := interval_of(name, value))), heading.interval_s)
        stated = heading.intervals.get(among[0], beside) if among else beside
        found = find_time([names[i] for i in index], [units[i] for i in index], [rows.values(i) for i in index], clock, str(path), stated)
        rest = found.rest and (index[found.rest[0]], found.rest[1])
        return found if found.at is None else replace(found, at=index[found.at], rest=rest)

    long = None if pairs else long_table(rows, names, stamps) or table_of_axes(rows, names, stamps)
    if long:
        found = time_of(long.times, [i for i in stamps if i in long.times])
        return Layout(sample, rows, heading, tuple(names), tuple(heads), long.values, dict.fromkeys(long.values, found), stamps, long, ())
    groups = _groups(rows, names, units, heading) if options.clock.interval_s is None and options.clock.column is None else []
    kept, notes = _kept(rows, names, pairs, stamps)
    if len(groups) > 1:
        kept = [i for i in kept if i not in groups]
        each = {at: time_of((at,)) for at in groups}
        times = {i: each[max((at for at in groups if at <= i), default=groups[0])] for i in kept}
        notes.append(f"{len(groups)} groups of signals, each with a time column of its own")
    else:
        found = time_of(kept, stamps)
        huge = [i for i in kept if i != found.at and np.all(np.abs(rows.values(i)) >= IMPOSSIBLE_VALUE)]
        notes += [f"'{names[i]}' holds numbers above {IMPOSSIBLE_VALUE:g}, such as ns since 1970: not read" for i in huge]
        kept = [i for i in kept if i not in (found.at, found.rest and found.rest[0], *huge)]
        times = dict.fromkeys(kept, found)
    scaled = [names[i] for i in kept if heading.keyed and (heads[i].factor, heads[i].offset) != (1.0, 0.0)]
    notes += [f"scaled as the lines above the numbers say: {', '.join(scaled)}"] if scaled else []
    names, dropped = _named_once(rows, names, kept)
    kept = [i for i in kept if i not in dropped]
    notes += [f"unused, not read: {', '.join(dict.fromkeys(names[i] for i in sorted(dropped)))}"] if dropped else []
    return Layout(sample, rows, heading, tuple(names), tuple(heads), tuple(kept), times, stamps, None, tuple(notes))


def _stamps(rows: Rows) -> tuple[int, ...]:
    """The columns of the date and clock time: one with both, or one of each."""
    columns = rows.columns(STAMP)
    first = {i: next(stamp for text in rows.texts(i) if (stamp := stamp_of(text))) for i in columns}
    both = [i for i in columns if first[i].timed]
    both = [i for i in both if len(set(rows.texts(i))) > 1] or both  # the bounds of a query never change
    if not both:
        return ()
    day = [i for i in columns if not first[i].timed]
    return (both[0],) if first[both[0]].dated or not day else (day[0], both[0])


def _kept(rows: Rows, names: Sequence[str], pairs: Mapping[int, str] | None, stamps: Sequence[int]) -> tuple[list[int], list[str]]:
    """Columns of numbers that are signals, and notes on the others."""
    notes = []
    kept = [i for i in rows.columns(NUMBER) if (pairs is None or i in pairs) and names[i] not in ("", "-")]
    words = [names[i] for i in rows.columns(WORD) if names[i] != "-"]
    if words and not pairs:
        notes.append(f"columns of words, ignored: {', '.join(words)}")
    # a time without a name may count milliseconds, but is printed with decimals then
    counters = [i for i in kept if is_counter(names[i], rows.values(i)) and not any(rows.decimal in text for text in rows.texts(i))]
    notes += [f"'{names[i]}' numbers the rows, not read" for i in counters]
    return [i for i in kept if i not in counters], notes


def _groups(rows: Rows, names: Sequence[str], units: Sequence[str], heading: Heading) -> list[int]:
    """Time columns where each group of signals has its own, else none: their names repeat, and each stands before signals."""
    steps = {i: np.diff((head := rows.values(i))[np.isfinite(head)]) for i in rows.columns(NUMBER)}
    rising = [i for i, own in steps.items() if len(own) and own.min() >= 0.0 and own.max() > 0.0]
    if heading.keyed:
        return [i for i in sorted(heading.keyed) if i in rising]
    plain = [re.sub(r"(\.\d+|\s*\(\d+\)|[ _]\d+)$", "", name.lower()) for name in names]
    at = [i for i in time_candidates(plain, units) if i in rising]
    same = [i for i in at if plain[i] == plain[at[0]]] if at else []
    return sorted(same) if all(b - a > 1 for a, b in zip(sorted(same), sorted(same)[1:])) else []


def _named_once(rows: Rows, names: Sequence[str], kept: Sequence[int]) -> tuple[list[str], set[int]]:
    """Names that occur once, and columns that are dropped: channels without a signal, and copies of another column."""
    out, dropped = list(names), {i for i in kept if names[i].lower() in UNUSED}
    for i in kept:
        same = [j for j in kept if names[j] == names[i] and j not in dropped]
        if i in dropped or len(same) < 2:
            continue
        copies = [j for j in same if j > i and rows.texts(j) == rows.texts(i)]
        dropped |= set(copies)
        if len(same) - len(copies) > 1:
            out[i] = f"{names[i]} (column {i + 1})"
    return out, dropped
