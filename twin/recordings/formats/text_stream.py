"""Columns of a text file to disk, block by block, with their times. What the CSV reader of pyarrow reports is said in our own words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
import io
from pathlib import Path
import re
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.recordings.formats.text_cells import DAY_NS, WORD, Sample, cells_of, has_date, kind_of, stamp_ns
from twin.recordings.formats.text_layout import Long, Rows
from twin.recordings.restarts import Restarts
from twin.recordings.signals import IMPOSSIBLE_VALUE, Stored
from twin.recordings.time_column import Found

BLOCK_CHARACTERS = 1 << 22


@dataclass(frozen=True)
class Plan:
    """What to read: chosen columns of the layout. `heading`: its lines, which pieces of one file repeat. `ragged`: rows may lack their last cells."""

    sample: Sample
    rows: Rows
    names: tuple[str, ...]
    chosen: tuple[int, ...]
    heading: frozenset[str]
    ragged: bool
    long: Long | None


class Clocks:
    """Times [s] of the rows of consecutive blocks, for each time column: `stamps` are columns of dates, `found` the time of each chosen column.

    Dates count from the first of the file, `origin_ns`. `restarts`: rows where a time starts again.
    """

    def __init__(self, found: Mapping[int, Found], stamps: tuple[int, ...]) -> None:
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
        return {at for one in self.found.values() if one.at is not None for at in ((*self.stamps,) if one.at in self.stamps else (one.at,))}

    def times(self, batch: Any, found: Found) -> np.ndarray:
        """Times of a batch as recorded, NaN where the cell is blank. Each batch is asked for once per time column."""
        if found.at is None:
            time = (self._rows + np.arange(batch.num_rows)) * found.factor
            self._rows += batch.num_rows
            return time
        if found.at in self.stamps:
            return self._stamped(batch)
        values = batch.column(f"c{found.at}").to_numpy(zero_copy_only=False)
        if found.source.text.endswith("since 1970"):
            there = values[np.isfinite(values)]
            first = self._epoch.setdefault(found.at, float(there[0]) if len(there) else 0.0)
            if self.origin_ns is None:
                self.origin_ns, self.dated = round(first * found.factor * 1e9), True
            values = values - first
        return np.asarray(values * found.factor, float)

    def running(self, key: object, time: np.ndarray) -> np.ndarray:
        """The times of one clock with its restarts behind each other."""
        return self._restarts.setdefault(key, Restarts())(time)

    def _stamped(self, batch: Any) -> np.ndarray:
        texts = [batch.column(f"c{i}").to_pylist() for i in self.stamps]
        out = np.full(batch.num_rows, np.nan)
        for row, parts in enumerate(zip(*texts)):
            each = [stamp_ns(part) if part else None for part in parts]
            if None in each:
                continue
            ns = sum(one for one in each if one is not None)
            if self.origin_ns is None:
                self.origin_ns, self.dated = ns, has_date(parts[0])
            if not self.dated:
                # a clock without a date begins again at midnight
                ns += self._midnights * DAY_NS
                if self._last_ns - ns > DAY_NS // 2:
                    self._midnights, ns = self._midnights + 1, ns + DAY_NS
            self._last_ns = ns
            out[row] = (ns - self.origin_ns) * 1e-9
        return out


@dataclass
class Column:
    """A column on its way to disk. It shares the time of its clock until its first blank cell; then it has its own."""

    folder: Path
    name: str
    clock: Path | None
    rows: int = 0
    own: bool = False
    files: dict[str, Any] = field(default_factory=dict)

    def append(self, values: np.ndarray, time: np.ndarray, there: np.ndarray | None) -> None:
        """Add a block; `there`: rows with a value, None for all."""
        if (there is not None or self.clock is None) and not self.own:
            self.own = True
            before = self._time_before()
            before.tofile(self._file("time"))
        if there is not None:
            values, time = values[there], time[there]
        values.astype(float).tofile(self._file("values"))
        if self.own:
            time.astype(float).tofile(self._file("time"))
        self.rows += len(values)

    def _time_before(self) -> np.ndarray:
        return np.fromfile(self.clock, float, self.rows) if self.clock is not None and self.rows else np.empty(0)

    def _file(self, kind: str) -> Any:
        if kind not in self.files:
            self.files[kind] = open(self.folder / f"{self.name}_{kind}", "wb")  # noqa: SIM115
        return self.files[kind]

    def close(self) -> None:
        for file in self.files.values():
            file.close()

    @property
    def values(self) -> Any:
        return Stored(self.folder / f"{self.name}_values") if self.rows else np.empty(0)

    @property
    def time(self) -> Any:
        return Stored(self.folder / f"{self.name}_time") if self.own or self.clock is None else Stored(self.clock)


def stream(plan: Plan, clocks: Clocks, folder: Path) -> dict[Any, Column]:
    """Read the file and write the chosen columns, by index or by the names of a long table."""
    import pyarrow as pa

    folder.mkdir(parents=True, exist_ok=True)
    path, rows = plan.sample.path, 0
    bad: list[tuple[int | None, int, int, str]] = []
    columns: dict[Any, Column] = {}
    clock_files: dict[int | None, Any] = {}
    try:
        for batch in _batches(plan, clocks, bad):
            line = plan.rows.first + rows
            if plan.long:
                _append_long(plan, clocks, batch, columns, folder, line)
            else:
                _append_table(plan, clocks, batch, columns, clock_files, folder, line)
            rows += batch.num_rows
    except pa.ArrowException as error:
        raise _why(plan, error, bad) from None
    except UnicodeError:
        raise InputError(f"{path}: not {plan.sample.encoding} text; give the encoding in [csv] of the map") from None
    finally:
        for file in [*clock_files.values(), *columns.values()]:
            file.close()
    if rows < 2:
        raise InputError(f"{path}: only {rows} row{'s' * (rows != 1)} of numbers; a trace needs at least two")
    return columns


def _append_table(
    plan: Plan, clocks: Clocks, batch: Any, columns: dict[Any, Column], clock_files: dict[int | None, Any], folder: Path, line: int
) -> None:
    """One block of a table: each clock once, then its columns."""
    for at in dict.fromkeys(clocks.found[i].at for i in plan.chosen):
        own = [i for i in plan.chosen if clocks.found[i].at == at]
        recorded = clocks.times(batch, clocks.found[own[0]])
        timed = np.isfinite(recorded)
        if not timed.all() and not plan.ragged:
            raise InputError(
                f"{plan.sample.path}: column '{plan.names[at or 0]}': line {line + int(np.argmin(timed)) + 1} has no time; repair it"
            )
        time = clocks.running(at, recorded[timed])
        if at not in clock_files:
            clock_files[at] = open(folder / f"clock{at}", "wb")  # noqa: SIM115
        for i in own:
            column = columns.setdefault(i, Column(folder, f"column{i}", Path(clock_files[at].name)))
            values, there = _checked(batch.column(f"c{i}"), recorded, plan, i, line)
            values, there = values[timed], there[timed] if there is not None else None
            clock_files[at].flush()
            column.append(values, time, None if there is None or there.all() else there)
        time.astype(float).tofile(clock_files[at])


def _append_long(plan: Plan, clocks: Clocks, batch: Any, columns: dict[Any, Column], folder: Path, line: int) -> None:
    """One block of a long table: the rows of each name."""
    assert plan.long is not None
    at = plan.long.value
    recorded = clocks.times(batch, clocks.found[at])
    values, there = _checked(batch.column(f"c{at}"), recorded, plan, at, line)
    texts = np.array([text or "" for text in batch.column(f"c{plan.long.name}").to_pylist()], dtype=object)
    for name in dict.fromkeys(texts):
        own = (texts == name) & np.isfinite(recorded) & (there if there is not None else True)
        if name and own.any():
            column = columns.setdefault(name, Column(folder, f"name{len(columns)}", None))
            column.append(values[own], clocks.running(name, recorded[own]), None)


def _checked(column: Any, time: np.ndarray, plan: Plan, at: int, line: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Values and the rows that hold one (None: all). NaN or infinity is an error, an empty cell is no sample."""
    values = column.to_numpy(zero_copy_only=False)
    there = np.asarray(column.is_valid().to_numpy(zero_copy_only=False), bool) if column.null_count else None
    fault = ~(np.abs(values) < IMPOSSIBLE_VALUE) & (there if there is not None else True)
    if fault.any():
        row = int(np.argmax(fault))
        held = "NaN" if np.isnan(values[row]) else f"{values[row]:g}"
        raise InputError(
            f"{plan.sample.path}: column '{plan.names[at]}': line {line + row + 1} ({time[row]:.6g} s) holds {held}; "
            "repair it, or cut with from_s and to_s in the map"
        )
    return values, there


def _batches(plan: Plan, clocks: Clocks, bad: list[tuple[int | None, int, int, str]]) -> Iterator[Any]:
    """The rows in batches with columns c0, c1, ...; rows of another width are added to `bad`."""
    import pyarrow as pa
    import pyarrow.csv as pc

    kinds = {f"c{i}": pa.string() if i in clocks.stamps else pa.float64() for i in {*plan.chosen, *clocks.columns()}}
    if plan.long:
        kinds[f"c{plan.long.name}"] = pa.string()

    def invalid(row: Any) -> str:
        bad.append((row.number, row.actual_columns, row.expected_columns, row.text))
        return "error"

    yield from pc.open_csv(
        _Text(plan),
        read_options=pc.ReadOptions(
            column_names=[f"c{i}" for i in range(len(plan.names))],  # all columns, so that an incomplete row is noticed
            block_size=BLOCK_CHARACTERS,
            use_threads=False,
        ),
        parse_options=pc.ParseOptions(delimiter=plan.rows.delimiter, invalid_row_handler=invalid),
        convert_options=pc.ConvertOptions(
            column_types=kinds,
            include_columns=list(kinds),
            decimal_point=plan.rows.decimal,
            null_values=["", " ", "  ", "   ", "    "],
            strings_can_be_null=True,
        ),
    )


def _why(plan: Plan, error: Exception, bad: list[tuple[int | None, int, int, str]]) -> InputError:
    """An error of the library as one line with its place in the file."""
    path, text = plan.sample.path, str(error)
    if bad:
        number, have, expected, row = bad[0]
        line = f"line {plan.rows.first + number}" if number is not None else "a row"
        return InputError(
            f"{path}: {line} has {have} of {expected} cells: '{row[:60].strip()}'; the file is cut off or damaged there, remove the line"
        )
    if match := re.search(r"column #(\d+).*?Row #(\d+).*?invalid value '(.*?)'", text, re.DOTALL) or re.search(
        r"column #(\d+)()[^']*invalid value '(.*?)'", text, re.DOTALL
    ):
        name = plan.names[int(match[1])] if int(match[1]) < len(plan.names) else f"column {int(match[1]) + 1}"
        line = f"line {plan.rows.first + int(match[2])} of " if match[2] else ""
        return InputError(
            f"{path}: {line}column '{name}' holds '{match[3][:40]}', which is not a number; repair it or leave the column out of the map"
        )
    return InputError(f"{path}: the rows from line {plan.rows.first + 1} on are no even table of numbers; export the recording again")


class _Text(io.RawIOBase):
    """The rows as UTF-8 for the CSV reader: runs of spaces as one, missing last cells added, repeated headings left out."""

    def __init__(self, plan: Plan) -> None:
        self.plan, self.width = plan, len(plan.names)
        self.file = open(plan.sample.path, encoding=plan.sample.encoding)  # noqa: SIM115
        for _ in range(plan.rows.first):
            self.file.readline()
        self.rest, self.part, self.begin = b"", "", True

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
            whole, _, self.part = (self.part + block).rpartition("\n") if block else (self.part, "", "")
            if len(block) < BLOCK_CHARACTERS:
                whole, self.part = self._without_end(whole, self.part)
            self.rest = self._clean(whole + "\n").encode() if whole else b""
        count = min(len(buffer), len(self.rest))
        buffer[:count], self.rest = self.rest[:count], self.rest[count:]
        return count

    def _without_end(self, text: str, part: str) -> tuple[str, str]:
        """The last block without closing words, such as 'EOF'."""
        lines = f"{text}\n{part}".rstrip().split("\n")
        if len(lines) > 1 and len(cells := cells_of(lines[-1], self.plan.rows.delimiter)) == 1 and kind_of(cells[0], ".") == WORD:
            return "\n".join(lines[:-1]), ""
        return text, part

    def _clean(self, text: str) -> str:
        delimiter, heading = self.plan.rows.delimiter, self.plan.heading
        repeated = any(line in text for line in heading)
        if not (delimiter == " " or self.plan.ragged or repeated):
            return text
        lines = text.split("\n")
        if repeated:
            lines = [line for line in lines if line.strip() not in heading]
        if delimiter == " ":
            lines = [" ".join(line.split()) for line in lines]
        elif self.plan.ragged:
            lines = [line + delimiter * max(self.width - 1 - line.count(delimiter), 0) if line.strip() else line for line in lines]
        return "\n".join(lines)
