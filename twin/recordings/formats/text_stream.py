"""Columns of a text file to disk, block by block, with their times. What the CSV reader of pyarrow reports is said in our own words."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import io
import itertools
from pathlib import Path
import re
import shutil
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.recordings.formats import text_cells
from twin.recordings.formats.text_cells import BLANK, DAY_NS, MISSING, WORD, cells_of, is_number, kind_of, stamp_of
from twin.recordings.formats.text_heading import Heading, Named
from twin.recordings.formats.text_layout import Long, Rows
from twin.recordings.formats.text_sample import Sample
from twin.recordings.signals import BLOCK, IMPOSSIBLE_VALUE, Column, Stored, TimeSource
from twin.recordings.table_file import uneven_row
from twin.recordings.timing import Restarts

BLOCK_CHARACTERS = 1 << 22


@dataclass(frozen=True)
class Layout:
    """How to read a text file: its columns, and the column whose time each of them has. `names`: each occurs once."""

    sample: Sample
    rows: Rows
    heading: Heading
    names: tuple[str, ...]
    heads: tuple[Named, ...]
    kept: tuple[int, ...]
    """Columns that are signals."""
    times: Mapping[int, TimeSource]
    """Time of each of them; a dictionary of one object where all share it."""
    stamps: tuple[int, ...]
    """Columns that together are a date and clock time."""
    long: Long | None
    notes: tuple[str, ...]
    left_out: list[str] = field(default_factory=list)
    """Lines with numbers between the pieces and behind the last row, once the file is read."""

    @property
    def ragged(self) -> bool:
        """True if groups of signals have times of their own: a row may lack its last cells."""
        return len({id(found) for found in self.times.values()}) > 1


class Clocks:
    """Times [s] of the rows of consecutive blocks, for each time column: `stamps` are columns of dates, `found` the time of each chosen column.

    Dates count from the first of the file, `origin_ns`. `restarts`: rows where a time starts again.
    """

    def __init__(self, found: Mapping[int, TimeSource], stamps: tuple[int, ...]) -> None:
        self.found, self.stamps = found, stamps
        self.origin_ns: int | None = None
        self.dated = False
        self._epoch: dict[int, float] = {}
        self._restarts: dict[object, Restarts] = {}
        self._rows, self._midnights, self._last_ns = 0, 0, -1

    @property
    def restarts(self) -> int:
        return max((one.count for one in self._restarts.values()), default=0)

    def columns(self) -> set[int]:
        """Columns of times."""
        found = [one for one in self.found.values() if one.at is not None]
        return {at for one in found for at in (*(self.stamps if one.at in self.stamps else (one.at,)), *(one.rest or ())[:1])}  # type: ignore[misc]

    def times(self, batch: Any, found: TimeSource) -> np.ndarray:
        """Times of a batch as recorded, NaN where the cell is blank. Each batch is asked for once per time column."""
        if found.at is None:
            time = (self._rows + np.arange(batch.num_rows)) * found.factor
            self._rows += batch.num_rows
            return time
        rest = batch.column(f"c{found.rest[0]}").to_numpy(zero_copy_only=False) * found.rest[1] if found.rest else 0.0
        if found.at in self.stamps:
            return self._stamped(batch) + rest
        values = batch.column(f"c{found.at}").to_numpy(zero_copy_only=False)
        if found.count_s:
            there = values[np.isfinite(values)]
            first = self._epoch.setdefault(found.at, float(there[0]) if len(there) else 0.0)
            if self.origin_ns is None:
                self.origin_ns, self.dated = round((first * found.factor - found.since_s) * 1e9), True
            values = values - first
        return np.asarray(values * found.factor + rest, float)

    def running(self, key: object, time: np.ndarray) -> np.ndarray:
        """The times of one clock with its restarts behind each other."""
        return self._restarts.setdefault(key, Restarts())(time)

    def _stamped(self, batch: Any) -> np.ndarray:
        texts = [batch.column(f"c{i}").to_pylist() for i in self.stamps]
        out = np.full(batch.num_rows, np.nan)
        for row, parts in enumerate(zip(*texts)):
            each = [stamp for part in parts if part and (stamp := stamp_of(part))]
            if len(each) < len(parts):
                continue
            ns = sum(one.ns for one in each)
            if self.origin_ns is None:
                self.origin_ns, self.dated = ns, each[0].dated
            if not self.dated:
                # a clock without a date begins again at midnight
                ns += self._midnights * DAY_NS
                if self._last_ns - ns > DAY_NS // 2:
                    self._midnights, ns = self._midnights + 1, ns + DAY_NS
            self._last_ns = ns
            out[row] = (ns - self.origin_ns) * 1e-9
        return out


def stream(layout: Layout, chosen: Sequence[int], clocks: Clocks, folder: Path, strict: bool) -> dict[Any, tuple[Column, Column]]:
    """Read the file and write the chosen columns. Returns (values, times) by index, or by label and index of a long table. `strict`: NaN is an error; else it stays."""
    import pyarrow as pa

    path, rows = layout.sample.path, 0
    shutil.rmtree(folder, ignore_errors=True)  # of an earlier reading
    folder.mkdir(parents=True)
    found: dict[tuple[str, int], str] = {}  # of a long table: label and column -> its file
    blank: set[int] = set()  # columns with empty cells
    try:
        for batch in _batches(layout, chosen, clocks):
            line = layout.rows.first + rows
            if layout.long:
                _add_long(layout, layout.long, clocks, batch, folder, found, line, strict)
            else:
                blank |= _add_table(layout, chosen, clocks, batch, folder, line, strict)
            rows += batch.num_rows
    except pa.ArrowException as error:
        raise _why(layout, error) from None
    except UnicodeError:
        raise InputError(f"{path}: not {layout.sample.encoding} text; give the encoding in [csv] of the map") from None
    if rows < 2:
        raise InputError(f"{path}: only {rows} row{'s' * (rows != 1)} of numbers; a trace needs at least two")
    if layout.long:
        return {key: (Stored(folder / f"{file}_values"), Stored(folder / f"{file}_time")) for key, file in found.items()}
    times = {at: Stored(folder / f"clock{at}") for at in {clocks.found[i].at for i in chosen}}
    out = {i: (Stored(folder / f"column{i}"), times[clocks.found[i].at]) for i in chosen}
    return out | {i: _without_blanks(folder, i, *out[i]) for i in blank}


def _add_table(layout: Layout, chosen: Sequence[int], clocks: Clocks, batch: Any, folder: Path, line: int, strict: bool) -> set[int]:
    """One block of a table: each clock once, then its columns, NaN where a cell is blank. Returns the columns with blanks."""
    blank = set()
    for at in dict.fromkeys(clocks.found[i].at for i in chosen):
        own = [i for i in chosen if clocks.found[i].at == at]
        recorded = clocks.times(batch, clocks.found[own[0]])
        timed = np.isfinite(recorded)
        if not timed.all() and not layout.ragged:
            where = f"{layout.sample.path}: column '{layout.names[at or 0]}': line {line + int(np.argmin(timed)) + 1}"
            raise InputError(f"{where} has no time; repair it")
        Stored(folder / f"clock{at}").add(clocks.running(at, recorded[timed]))
        for i in own:
            column = batch.column(f"c{i}")
            values = _checked(column, recorded, layout, i, line, strict)[timed]
            Stored(folder / f"column{i}").add(values)
            if column.null_count:
                blank.add(i)
    return blank


def _without_blanks(folder: Path, i: int, values: Column, time: Column) -> tuple[Column, Column]:
    """A column without its blank cells, and the times of the others."""
    kept = Stored(folder / f"column{i}_values"), Stored(folder / f"column{i}_time")
    for start in range(0, len(values), BLOCK):
        own = np.asarray(values[start : start + BLOCK])
        there = ~np.isnan(own)
        kept[0].add(own[there])
        kept[1].add(np.asarray(time[start : start + BLOCK])[there])
    return kept


def _add_long(
    layout: Layout, long: Long, clocks: Clocks, batch: Any, folder: Path, found: dict[tuple[str, int], str], line: int, strict: bool
) -> None:
    """One block of a long table: the rows of each name."""
    recorded = clocks.times(batch, clocks.found[long.values[0]])
    parts = [batch.column(f"c{i}").to_pylist() for i in long.names]
    texts = np.array([" ".join(filter(None, own)) for own in zip(*parts)], dtype=object)
    checked = {i: _checked(batch.column(f"c{i}"), recorded, layout, i, line, strict) for i in long.values}
    for label, (i, values) in itertools.product(dict.fromkeys(texts), checked.items()):
        own = (texts == label) & np.isfinite(recorded) & np.isfinite(values)
        if label and own.any():
            file = found.setdefault((label, i), f"name{len(found)}")
            Stored(folder / f"{file}_values").add(values[own])
            Stored(folder / f"{file}_time").add(clocks.running(file, recorded[own]))


def _checked(column: Any, time: np.ndarray, layout: Layout, at: int, line: int, strict: bool) -> np.ndarray:
    """Values, NaN where a cell is empty, which is no sample. NaN or infinity in a cell is an error if the column is wanted."""
    head = layout.heads[at]
    values = np.asarray(column.to_numpy(zero_copy_only=False)) * head.factor + head.offset
    fault = ~(np.abs(values) < IMPOSSIBLE_VALUE) & np.asarray(column.is_valid().to_numpy(zero_copy_only=False), bool)
    if strict and fault.any():
        row = int(np.argmax(fault))
        held = "NaN" if np.isnan(values[row]) else f"{values[row]:g}"
        where = f"{layout.sample.path}: column '{layout.names[at]}': line {line + row + 1} ({time[row]:.6g} s)"
        raise InputError(f"{where} holds {held}; repair it, or cut with from_s and to_s in the map")
    return values


def _batches(layout: Layout, chosen: Sequence[int], clocks: Clocks) -> Iterator[Any]:
    """The rows in batches with columns c0, c1, ..."""
    import pyarrow as pa
    import pyarrow.csv as pc

    kinds = {f"c{i}": pa.string() if i in clocks.stamps else pa.float64() for i in {*chosen, *clocks.columns()}}
    if layout.long:
        kinds |= {f"c{i}": pa.string() for i in layout.long.names}
    every = [f"c{i}" for i in range(len(layout.names))]  # all columns, so that an incomplete row is noticed
    reading = pc.ReadOptions(column_names=every, block_size=BLOCK_CHARACTERS, use_threads=False)
    wanted = pc.ConvertOptions(column_types=kinds, include_columns=list(kinds), decimal_point=layout.rows.decimal, strings_can_be_null=True)
    wanted.null_values = [" " * n for n in range(5)] + [before + word for word in MISSING for before in ("", " ")]
    yield from pc.open_csv(_Text(layout), reading, pc.ParseOptions(delimiter=layout.rows.delimiter), wanted)


def _why(layout: Layout, error: Exception) -> InputError:
    """An error of the library as one line with its place in the file."""
    path, text = layout.sample.path, str(error)
    if found := uneven_row(error):
        line = layout.rows.first + found[0]
        return InputError(f"{path}: line {line} {found[1]}; the file is cut off or damaged there, remove the line")
    if match := re.search(r"column #(\d+)(?:.*?Row #(\d+))?.*?invalid value '(.*?)'", text, re.DOTALL):
        name = layout.names[int(match[1])] if int(match[1]) < len(layout.names) else f"column {int(match[1]) + 1}"
        where = f"line {layout.rows.first + int(match[2])} of " if match[2] else ""
        held = f"'{match[3][:40]}', which is not a number"
        return InputError(f"{path}: {where}column '{name}' holds {held}; repair it or leave the column out of the map")
    return InputError(f"{path}: the rows from line {layout.rows.first + 1} on are no even table of numbers; export the recording again")


_REMARK = re.compile(r"^(?:#|\s*[^\W\d][^\d\n]*$)", re.MULTILINE)
"""A line between the rows that is none: 'overrun', or a comment."""


class _Text(io.RawIOBase):
    """The rows as UTF-8 for the CSV reader: runs of spaces as one, missing last cells added, thousands together, lines between pieces and behind the last left out."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.file = open(layout.sample.path, encoding=layout.sample.encoding)  # noqa: SIM115
        for _ in range(layout.rows.first):
            self.file.readline()
        self.rest, self.part, self.begin = b"", "", True
        between, grouped = text_cells.THOUSANDS[layout.rows.decimal], text_cells.GROUPED[layout.rows.decimal]
        quoted = layout.rows.delimiter in between  # it is the delimiter elsewhere
        self.grouped = re.compile(f'(?<="){grouped}(?=")' if quoted else rf"(?<![\w.,':/]){grouped}(?![\w.,':/])")
        # what a text with separated thousands holds; dates hold spaces, too
        self.between, self.sign = f"[{between}]", '"' if quoted else between.replace(" ", "" if layout.stamps else " ")

    def readable(self) -> bool:
        return True

    def close(self) -> None:
        self.file.close()
        super().close()

    def readinto(self, buffer: Any) -> int:
        while not self.rest:
            block = self.file.read(BLOCK_CHARACTERS)
            if self.begin:
                block, self.begin = block.removeprefix("\ufeff"), False
            if not block and not self.part:
                return 0
            last = len(block) < BLOCK_CHARACTERS
            whole, _, self.part = (self.part + block, "", "") if last else (self.part + block).rpartition("\n")
            self.rest = self._clean(whole.rstrip("\n"), last).encode() if whole.strip("\n") else b""
        count = min(len(buffer), len(self.rest))
        buffer[:count], self.rest = self.rest[:count], self.rest[count:]
        return count

    def _clean(self, text: str, last: bool) -> str:
        delimiter, heading, ragged = self.layout.rows.delimiter, self.layout.heading.lines, self.layout.ragged
        if any(mark in text for mark in self.sign):
            text = self.grouped.sub(lambda number: re.sub(self.between, "", number[0]), text)
        text = self.layout.sample.rewritten(text)
        repeated = any(line in text for line in heading)
        remarks = _REMARK.search(text) is not None
        if not (delimiter == " " or ragged or repeated or last or remarks):
            return text + "\n"
        lines = text.split("\n")
        between = [i for i, line in enumerate(lines) if (remarks and _REMARK.match(line)) or (repeated and line.strip() in heading)]
        for start, step in [(len(lines) - 1, -1)] * last + [(i, step) for i in between for step in (1, -1)]:
            while 0 <= start < len(lines) and not self._is_row(lines[start]):
                if any(map(is_number, cells_of(lines[start], delimiter))):
                    self.layout.left_out.append(lines[start].strip())
                lines[start], start = "", start + step
        if delimiter == " ":
            lines = [" ".join(line.split()) for line in lines]
        elif ragged:
            most = len(self.layout.names) - 1
            lines = [line + delimiter * max(most - line.count(delimiter), 0) if line.strip() else line for line in lines]
        return "\n".join(lines) + "\n"

    def _is_row(self, line: str) -> bool:
        """False for a line without content, a word alone, and a line that begins with a word where the rows have a number."""
        cells = cells_of(line, self.layout.rows.delimiter)
        kinds = [kind_of(cell, self.layout.rows.decimal) for cell in cells]
        at = next((i for i, kind in enumerate(kinds) if kind != BLANK), None)
        if at is None or at >= len(self.layout.rows.kinds):
            return at is not None
        return kinds[at] != WORD or (len(cells) > 1 and self.layout.rows.kinds[at] == WORD)
