"""CSV of any dialect: delimiter, decimal comma, lines before the heading, units row and encoding are detected, or given in the map.

The file is read in blocks, and wanted columns go to disk as float64. An empty cell means no sample (a signal with a longer interval,
or lost samples). The text NaN is an error.
"""

from __future__ import annotations

from collections.abc import Mapping
import csv
from dataclasses import dataclass
import io
from pathlib import Path
import shutil
from typing import IO, Any

import numpy as np

from twin.errors import InputError, nearest
from twin.recordings.restarts import Restarts
from twin.recordings.signals import (
    IMPOSSIBLE_VALUE,
    ReadOptions,
    Recording,
    Signal,
    Stored,
    find_time_column,
    known_unit,
    split_heading,
    time_factor,
)

SAMPLE_BYTES = 1 << 16
BLOCK_BYTES = 1 << 22
# the pair that turns most lines into rows of numbers is used; the order decides ties
_PAIRS = ((";", ","), ("\t", ","), (";", "."), ("\t", "."), (",", "."), ("|", "."), ("|", ","), (" ", "."), (" ", ","))
KEYS = ("delimiter", "decimal", "header_line", "units_row", "encoding")


@dataclass(frozen=True)
class Dialect:
    """How to read the text. `first`: number of lines before the first row of numbers."""

    encoding: str
    delimiter: str
    decimal: str
    first: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    timestamps: bool
    texts: tuple[int, ...] = ()
    """Columns of words, which are ignored."""


@dataclass
class _Spool:
    """A column on its way to disk; it has its own times after the first empty cell."""

    path: Path
    file: IO[bytes]
    times: IO[bytes] | None = None
    rows: int = 0


def read(path: Path, options: ReadOptions) -> Recording:
    """Read the wanted columns (all without a map)."""
    dialect = find_dialect(path, options.dialect)
    where = str(path)
    at = find_time_column(dialect.names, dialect.units, options.clock, where)
    plain = [split_heading(n)[0] for n in dialect.names]
    plain = [p if plain.count(p) == 1 else n for p, n in zip(plain, dialect.names)]
    if options.wanted and (
        words := [dialect.names[i] for i in dialect.texts if dialect.names[i] in options.wanted or plain[i] in options.wanted]
    ):
        raise InputError(f"{path}: column '{words[0]}' contains words; leave it out of the map")
    kept = [i for i in range(len(dialect.names)) if i != at and i not in dialect.texts]
    chosen = [
        i
        for i, name in enumerate(dialect.names)
        if i in kept and (options.wanted is None or name in options.wanted or plain[i] in options.wanted)
    ]
    if not chosen:
        return Recording(path, "CSV", {plain[i]: Signal(plain[i], np.empty(0), None) for i in kept})
    factor = 1.0
    if at is not None and not dialect.timestamps:
        factor = time_factor(dialect.names[at], dialect.units[at], options.clock, where)
    spools, time, restarts = _stream(path, dialect, at, chosen, factor, options)
    signals = {
        plain[i]: Signal(plain[i], Stored(spool.path), Stored(Path(spool.times.name)) if spool.times else time, dialect.units[i])
        for i, spool in spools.items()
        if spool.rows
    }
    # unwanted names, for the nearest match in messages only
    others = {plain[i]: Signal(plain[i], np.empty(0), None) for i in kept if i not in spools}
    separator = {",": "comma", ";": "semicolon", "\t": "tab", " ": "space", "|": "bar"}[dialect.delimiter]
    note = f"CSV: {separator}, decimal {'comma' if dialect.decimal == ',' else 'point'}, numbers from line {dialect.first + 1}, {dialect.encoding}"
    empty = [plain[i] for i, spool in spools.items() if not spool.rows]
    notes = [note, *(f"column '{name}' is empty" for name in empty)]
    if dialect.texts:
        notes.append(f"columns of words, ignored: {', '.join(plain[i] for i in dialect.texts)}")
    if restarts:
        notes.append(f"the time starts again at {restarts} row{'s' * (restarts > 1)}: each part is a run of its own")
    return Recording(path, "CSV", {**others, **signals}, None, tuple(notes), restarts=restarts)


def find_dialect(path: Path, given: Mapping[str, Any] | None = None) -> Dialect:
    """Encoding, delimiter, decimal sign, heading and units of a file. Values in `given` (the map's [csv]) take precedence."""
    given = given or {}
    for key in given:
        if key not in KEYS:
            raise InputError(f"{path}: [csv] {key}: unknown key; {nearest(key, KEYS)}")
    with open(path, "rb") as file:
        head = file.read(SAMPLE_BYTES)
    encoding = str(given.get("encoding") or _encoding(head, path))
    try:
        text = head.decode(encoding, errors="ignore")
    except LookupError:
        raise InputError(f"{path}: [csv] encoding '{encoding}' is unknown; use utf-8, latin-1 or utf-16") from None
    lines = text.lstrip("\ufeff").splitlines()
    if len(head) == SAMPLE_BYTES:
        lines = lines[:-1]  # incomplete
    pairs = [p for p in _PAIRS if given.get("delimiter", p[0]) == p[0] and given.get("decimal", p[1]) == p[1]]
    best, first, width, stamps = None, 0, 0, False
    most = 0
    for pair in pairs:
        rows, start, cells, with_stamp = _rows_of_numbers(lines, *pair)
        # of pairs that read equally many rows, more columns win: a decimal comma read as a delimiter gives unequal rows
        if rows and (rows, cells) > (most, width):
            best, most, first, width, stamps = pair, rows, start, cells, with_stamp
    texts: tuple[int, ...] = ()
    if best is None:
        # tables that mix columns of words and of numbers
        for pair in pairs:
            rows, start, cells, words = _rows_with_words(lines, *pair)
            if rows and (rows, cells - len(words)) > (most, width - len(texts)):
                best, most, first, width, texts = pair, rows, start, cells, words
    if best is None:
        raise InputError(f"{path}: no rows of numbers found; is it a CSV file? give delimiter and decimal in [csv] of the map")
    delimiter, decimal = best
    names, units = _heading(lines[:first], width, delimiter, given, path)
    return Dialect(encoding, delimiter, decimal, first, names, units, stamps, texts)


def _encoding(head: bytes, path: Path) -> str:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\x00" in head:
        raise InputError(f"{path}: not a text file (it holds zero bytes); give it the ending of its true format")
    try:
        head[: len(head) - 4].decode("utf-8")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


def _number(cell: str, decimal: str) -> bool:
    cell = cell.strip()
    if cell == "":
        return True
    if decimal == "," and "." in cell:
        return False
    try:
        float(cell.replace(",", ".") if decimal == "," else cell)
    except ValueError:
        return False
    return "_" not in cell


def _stamp(cell: str) -> bool:
    from datetime import datetime

    try:
        datetime.fromisoformat(cell.strip())
    except ValueError:
        return False
    return len(cell) > 10


def _cells(line: str, delimiter: str) -> list[str]:
    cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=delimiter == " "), [])
    return [c for c in cells if c] if delimiter == " " else cells


def _rows_of_numbers(lines: list[str], delimiter: str, decimal: str) -> tuple[int, int, int, bool]:
    """(rows of numbers at the end of the sample, first of them, number of cells, True if the first cell is a date); rows have one width."""
    count, width, start, stamps = 0, 0, len(lines), False
    for i in range(len(lines) - 1, -1, -1):
        cells = _cells(lines[i], delimiter)
        if not cells and i == len(lines) - 1:
            start = i
            continue
        with_stamp = bool(cells) and _stamp(cells[0])
        numbers = len(cells) >= 2 and all(_number(c, decimal) for c in cells[with_stamp:]) and any(c.strip() for c in cells)
        if not numbers or (width and len(cells) != width):
            if count > 0:
                break
            continue  # ignore an incomplete last line; reading it will report it
        count, width, start, stamps = count + 1, len(cells), i, with_stamp
    return count, start, width, stamps


def _rows_with_words(lines: list[str], delimiter: str, decimal: str) -> tuple[int, int, int, tuple[int, ...]]:
    """(rows at the end of the sample, first of them, number of cells, columns of words); a word column has words in every row."""
    rows = [_cells(line, delimiter) for line in lines]
    while rows and not rows[-1]:
        rows.pop()
    if not rows or len(rows[-1]) < 3:
        return 0, 0, 0, ()
    width = len(rows[-1])
    words = tuple(i for i, cell in enumerate(rows[-1]) if not _number(cell, decimal))
    start = len(rows)
    while start and len(rows[start - 1]) == width and tuple(i for i, c in enumerate(rows[start - 1]) if not _number(c, decimal)) == words:
        start -= 1
    count = len(rows) - start
    return (count, start, width, words) if words and width - len(words) >= 2 and count > 1 else (0, 0, 0, ())


def _heading(lines: list[str], width: int, delimiter: str, given: Mapping[str, Any], path: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units from the lines before the numbers; numbered names without a heading."""
    split = [_cells(line.lstrip("#").strip() if line.startswith("#") else line, delimiter) for line in lines]
    full = [i for i, cells in enumerate(split) if len(cells) in (width, width - 1)]
    units_at: int | None = None
    names_at = full[-1] if full else None
    if "header_line" in given:
        if isinstance(line := given["header_line"], bool) or not isinstance(line, int):
            raise InputError(f"{path}: [csv] header_line = {line!r}; give the number of a line")
        names_at = line - 1
        if not 0 <= names_at < len(lines):
            raise InputError(f"{path}: [csv] header_line = {names_at + 1}, but numbers begin in line {len(lines) + 1}; correct it")
        units_at = names_at + 1 if given.get("units_row") and names_at + 1 < len(lines) else None
    elif len(full) > 1 and given.get("units_row", _looks_like_units(split[full[-1]])):
        units_at, names_at = full[-1], full[-2]
    if names_at is not None and "header_line" not in given and names_at > 0:
        # a heading is above the numbers; a line of numbers with one bad cell is not a heading
        bad = [c for c in split[names_at] if not _number(c, ".") and not _number(c, ",")]
        if bad and 2 * len(bad) <= len(split[names_at]) and any(len(cells) == width for cells in split[:names_at]):
            raise InputError(f"{path}: line {names_at + 1}: {bad[0].strip()[:40]!r} is not a number; correct or remove it")
    if (
        names_at is not None
        and len([c for c in split[names_at] if c.strip()]) > 1
        and all(_number(c, ".") or _number(c, ",") for c in split[names_at])
    ):
        raise InputError(
            f"{path}: line {names_at + 2} is not a row of numbers like the one above it: '{lines[-1][:60].strip()}'; repair or remove it"
        )
    names = [c.strip() for c in split[names_at]] if names_at is not None else []
    names += [""] * (width - len(names))
    names = [name or f"column {i + 1}" for i, name in enumerate(names)]
    twice = next((n for n in names if names.count(n) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: column '{twice}' occurs twice; rename one in the file")
    below = [known_unit(c) for c in split[units_at]] if units_at is not None else []
    below += [""] * (width - len(below))
    return tuple(names), tuple(b or split_heading(n)[1] for b, n in zip(below, names))


def _looks_like_units(cells: list[str]) -> bool:
    known = [bool(known_unit(c)) for c in cells if c.strip()]
    return len(known) > 0 and sum(known) >= max(1, len(known) // 2)


def _stream(
    path: Path, dialect: Dialect, at: int | None, chosen: list[int], factor: float, options: ReadOptions
) -> tuple[dict[int, _Spool], Stored, int]:
    """Read the file in blocks and write wanted columns and time to disk. Also counts the rows where the time starts again."""
    import pyarrow as pa

    folder = options.scratch / path.name
    folder.mkdir(parents=True, exist_ok=True)
    bad: list[tuple[int | None, int, int, str]] = []
    time_path = folder / "time"
    spools = {i: _Spool(folder / f"column{i}", open(folder / f"column{i}", "wb")) for i in chosen}  # noqa: SIM115
    rows, restart, origin = 0, Restarts(), None
    try:
        with open(time_path, "wb") as time_file:
            for batch in _reader(path, dialect, at, chosen, bad):
                if at is None:
                    time = (rows + np.arange(batch.num_rows)) * float(options.clock.interval_s or 0.0)
                elif dialect.timestamps:
                    stamps = batch.column(f"c{at}").cast(pa.int64()).to_numpy(zero_copy_only=False)
                    origin = int(stamps[0]) if origin is None else origin
                    time = (stamps - origin) * 1e-9
                else:
                    time = batch.column(f"c{at}").to_numpy(zero_copy_only=False) * factor
                if not np.all(np.isfinite(time)):
                    row = dialect.first + rows + int(np.argmin(np.isfinite(time))) + 1
                    raise InputError(f"{path}: column '{dialect.names[at or 0]}': line {row} has no time; repair it")
                time = restart(np.asarray(time, float))
                for i, spool in spools.items():
                    _append(spool, batch.column(f"c{i}"), time, time_file, f"{path}: column '{dialect.names[i]}'", dialect.first + rows)
                time.astype(float).tofile(time_file)
                rows += batch.num_rows
    except pa.ArrowException as error:
        raise _why(path, dialect, error, bad) from None
    except UnicodeError as error:
        raise InputError(f"{path}: not {dialect.encoding} text ({error}); give the encoding in [csv] of the map") from None
    finally:
        for spool in spools.values():
            spool.file.close()
            if spool.times:
                spool.times.close()
    if rows < 2:
        raise InputError(f"{path}: only {rows} row{'s' * (rows != 1)} of numbers; a trace needs at least two")
    return spools, Stored(time_path), restart.count


def _reader(path: Path, dialect: Dialect, at: int | None, chosen: list[int], bad: list[tuple[int | None, int, int, str]]) -> Any:
    """A reader of the file in batches with columns c0, c1, ...; rows of another width are added to `bad`."""
    import pyarrow as pa
    import pyarrow.csv as pc

    kinds = {f"c{i}": pa.float64() for i in chosen}
    if at is not None:
        kinds[f"c{at}"] = pa.timestamp("ns") if dialect.timestamps else pa.float64()

    def invalid(row: Any) -> str:
        bad.append((row.number, row.actual_columns, row.expected_columns, row.text))
        return "error"

    spaces = dialect.delimiter == " "  # several spaces count as one delimiter
    return pc.open_csv(
        _Squeezed(path, dialect.encoding) if spaces else path,
        read_options=pc.ReadOptions(
            column_names=[f"c{i}" for i in range(len(dialect.names))],  # all columns, so that an incomplete row is noticed
            skip_rows=dialect.first,
            block_size=BLOCK_BYTES,
            encoding="utf-8" if spaces else dialect.encoding,
            use_threads=False,
        ),
        parse_options=pc.ParseOptions(delimiter=dialect.delimiter, invalid_row_handler=invalid),
        convert_options=pc.ConvertOptions(
            column_types=kinds, include_columns=list(kinds), decimal_point=dialect.decimal, null_values=[""], strings_can_be_null=True
        ),
    )


def _append(spool: _Spool, column: Any, time: np.ndarray, time_file: IO[bytes], where: str, line: int) -> None:
    """Write one block of a column to disk. NaN or infinity is an error, an empty cell is no sample."""
    values = column.to_numpy(zero_copy_only=False)
    valid = np.asarray(column.is_valid().to_numpy(zero_copy_only=False), bool) if column.null_count else None
    fault = ~(np.abs(values) < IMPOSSIBLE_VALUE) & (valid if valid is not None else True)
    if fault.any():
        row = int(np.argmax(fault))
        held = "NaN" if np.isnan(values[row]) else f"{values[row]:g}"
        raise InputError(
            f"{where}: line {line + row + 1} ({time[row]:.6g} s) holds {held}; repair it, or cut with from_s and to_s in the map"
        )
    if valid is not None and spool.times is None:
        # up to here the column shares the common times; from here on it needs its own
        time_file.flush()
        own = spool.path.with_suffix(".time")
        shutil.copyfile(time_file.name, own)
        spool.times = open(own, "ab")  # noqa: SIM115
    if valid is not None:
        values, time = values[valid], time[valid]
    values.tofile(spool.file)
    if spool.times:
        time.astype(float).tofile(spool.times)
    spool.rows += len(values)


def _why(path: Path, dialect: Dialect, error: Exception, bad: list[tuple[int | None, int, int, str]]) -> InputError:
    """The error as one line with its place in the file."""
    text = str(error).splitlines()[0]
    if bad:
        _, have, expected, row = bad[0]
        return InputError(
            f"{path}: a row has {have} of {expected} cells: '{row[:60].strip()}'; the file is cut off or damaged there, remove the row"
        )
    if "conversion error" in text:
        number = text.partition("#")[2].split(":")[0].strip()
        name = dialect.names[int(number)] if number.isdigit() and int(number) < len(dialect.names) else number
        value = text.partition("invalid value '")[2].split("'")[0] or text
        return InputError(
            f"{path}: column '{name}' holds '{value[:40]}', which is not a number; repair it or leave the column out of the map"
        )
    return InputError(f"{path}: not a readable CSV file ({text})")


class _Squeezed(io.RawIOBase):
    """The text with runs of spaces replaced by one space, for columns aligned by spaces."""

    def __init__(self, path: Path, encoding: str) -> None:
        self.file = open(path, encoding=encoding)  # noqa: SIM115
        self.rest = b""

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        while len(self.rest) < len(buffer):
            lines = self.file.readlines(1 << 16)
            if not lines:
                break
            self.rest += "".join(" ".join(line.split()) + "\n" for line in lines).encode()
        part, self.rest = self.rest[: len(buffer)], self.rest[len(buffer) :]
        buffer[: len(part)] = part
        return len(part)
