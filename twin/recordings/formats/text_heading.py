"""Lines above the numbers: names, units, interval of the samples.

Names stand in the last line that has a cell for each column, units below them, or in brackets. Exports of scopes begin each line with its meaning instead
(`Name`, `Unit`, `SampleTime[ms]`) and repeat it above each time column.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
import re
from typing import Any, NamedTuple

from twin.errors import InputError, nearest
from twin.recordings.formats.text_cells import cells_of, is_number, is_stamp
from twin.recordings.signals import known_unit, scaled_unit, split_heading
from twin.units import RECORDED_UNITS

KEYS = ("delimiter", "decimal", "encoding", "columns")
_NAME_KEYS = (
    "name", "names", "channel name", "channel", "channels", "signal", "signals", "signal name", "variable", "kanal", "kanalname",
    "bezeichnung", "nom",
)  # fmt: skip
_UNIT_KEYS = ("unit", "units", "einheit", "einheiten", "unité", "unite", "unités")
_TYPE = re.compile(r"l?real|u?[dsl]?int|u?int(?:8|16|32|64)|(?:real|float)(?:32|64)|float|double|bool|bit|d?word|byte", re.IGNORECASE)
UNUSED = (
    "not selected", "not used", "unused", "not assigned", "nicht belegt", "nicht verwendet", "unbenutzt", "non utilisé", "none", "-",
    "n/c", "nc", "n/a", "off",
)  # fmt: skip
"""Names of channels that nothing was assigned to."""
_INTERVAL = re.compile(
    r"sampl|abtast|interval|p[ée]riod|cycle|zyklus|takt|[ée]chantillon|pas de temps|\bd[ _]?t\b|delta[ _]?t|increment|\bts\b|cadence|time ?base|zeitbasis|base de temps|采样|周期|サンプリング",
    re.IGNORECASE,
)
_STATEMENT = re.compile(rf"(?:{_INTERVAL.pattern})[\w ]*[\[(\w\])]*\s*[:=]\s*\d", re.IGNORECASE)
"""A line that is nothing but an interval: 'Sample time: 2 ms'."""
_AMOUNT = re.compile(r"\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?")
_NUMBERED = re.compile(r"\W*(?:ch|channel|col|column|kanal|spalte|signal|trace|curve|variable)[ _.#]*0*(\d{1,3})\b", re.IGNORECASE)
_LEGEND = re.compile(rf"(?:{_NUMBERED.pattern}|\W*(\d{{1,3}})|\W*(?:channel|kanal)[ _]([A-Z])\b)\s*[=:,;\t]\s*(\S.*)", re.IGNORECASE)
"""A line that says what a column is: 'CH1=X:SPEED', '3: position [mm]', 'Channel B: current [A]'."""
_UNIT = r"(nsec|usec|msec|sec|ns|us|µs|μs|ms|khz|mhz|hz|s)"
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6}
_COMMENT = re.compile(r"^\s*(?:#+|%+|//|;;|\*)\s*")


class Named(NamedTuple):
    """Name of a column ("" if none), unit in the twin's spelling, factor from the numbers to it (0.1 of '0.1 r/min'), unit as written, offset behind the factor."""

    name: str = ""
    unit: str = ""
    factor: float = 1.0
    written: str = ""
    offset: float = 0.0


@dataclass(frozen=True)
class Heading:
    """The columns, and the interval [s] that the lines state. `keyed`: columns that lines' keys stand above."""

    columns: tuple[Named, ...]
    interval_s: float | None
    intervals: Mapping[int, float]
    """Intervals of time columns of their own."""
    keyed: frozenset[int]
    lines: frozenset[str]
    """The lines of names and units: pieces of one file may repeat them."""


def read_heading(lines: Sequence[str], delimiter: str, filled: Sequence[bool], given: Mapping[str, Any], path: Path) -> Heading:
    """The heading from the lines above the numbers; `filled` columns have values. Names in `given` (--columns) take precedence."""
    for key in given:
        if key not in KEYS:
            raise InputError(f"{path}: [csv] {key}: unknown key; {nearest(key, KEYS)}")
    width = len(filled)
    table = [_cells(line, delimiter, width) for line in lines]
    for cells in table:
        if filled[-1] and len(cells) == width - 1 > 1 and _plain(cells[0]).lower() in _UNIT_KEYS:
            cells[:1] = ["", ""]  # 'Unit' stands above two columns: number of the row and time
    full = [i for i, cells in enumerate(table) if len(cells) in (width - 1, width) and any(cells)]
    if lines and delimiter != " " and len(table[-1]) == width + 1 and _wordy(table[-1]):
        full.append(len(lines) - 1)  # one name more than columns: a comment that no row has
        table[-1] = table[-1][:width]
    names_at, units_at, keyed = _lines_of(table, full)
    names = _padded(table[names_at] if names_at is not None else [], width)
    below = _padded(table[units_at] if units_at is not None else [], width)
    above_names = [i for i in reversed(full) if names_at is not None and not keyed and i < names_at]
    # 'Sampling interval;1;ms' is of no column
    over_names = [i for i in above_names if _wordy(table[i]) and _interval(lines[i : i + 1]) is None]
    for above in (_padded(table[i], width) for i in over_names):
        if _units(above) and not any(below):
            below = above
            continue
        # a unit in the line of the names belongs to the name above it: 'Time' over 'ms'
        for i in range(width):
            if above[i] and (names[i] == "" or (known_unit(names[i]) and len(names[i]) > 1 and not known_unit(above[i]))):
                names[i], below[i] = above[i], below[i] or names[i]
        names = _joined(above, names)
        if len(set(names)) == width:
            break
    last = max((i for i, line in enumerate(lines) if line.strip() and not _LEGEND.match(line)), default=None)
    if last not in (names_at, units_at) or len({name for name in names if name and not _NUMBERED.match(name)}) < width - 1:
        names = _legend(lines, width) or names  # else the line above the numbers names them itself
    if given.get("columns"):
        names = _given_names(given["columns"], filled, names, path)
    split = [_split(name) for name in names]
    over = [(match[1].strip(), match[2]) if (match := _OVER.fullmatch(name)) and known_unit(match[2]) else None for name in names]
    if sum(map(bool, over)) >= max(2.0, 0.5 * sum(map(bool, names))):  # 'Zeit/s', as DIN writes quantities, no part of a path
        split = [one or own for one, own in zip(over, split)]
    plain = [name for name, _ in split]  # without its unit, where that leaves it unique
    written = [_plain(b) or unit for b, (_, unit) in zip(below, split)]
    keys_above = [i for i in range(width) if keyed and names[i].lower() in _NAME_KEYS]
    timed = [table[i] for i in full if keyed and _INTERVAL.search(table[i][0])]
    intervals = {i: _interval([f"{row[i]} {row[i + 1]}"]) for row in timed for i in keys_above if i + 1 < len(row)}
    scales = _scales([table[i] for i in full], width) if keyed else [(1.0, 0.0)] * width
    columns = []
    for own, name, text, (scale, offset) in zip(plain, names, written, scales):
        (unit, factor), once = scaled_unit(text), plain.count(own) == 1
        columns.append(Named(own if once else name, unit, factor * scale, text if once or unit else "", factor * offset))
    found = {i: interval for i, interval in intervals.items() if interval}
    return Heading(tuple(columns), _interval(lines), found, frozenset(keys_above), frozenset(lines[i].strip() for i in full))


def _scales(table: Sequence[Sequence[str]], width: int) -> list[tuple[float, float]]:
    """Factor and offset of each column from lines such as 'ScaleFactor 0,1' and 'Unit Offset 5': TwinCAT's scope writes the numbers without them."""
    rows = {cells[0].lower().replace(" ", ""): _padded(cells, width) for cells in table}
    out = [(1.0, 0.0)] * width
    if "scalefactor" not in rows:
        return out

    def number(key: str, i: int, other: float) -> float:
        """The number in a cell; `other` if it holds none."""
        cell = rows[key][i].strip() if key in rows else ""
        return float(cell.replace(",", ".")) if re.fullmatch(r"[+-]?" + _AMOUNT.pattern, cell) else other

    for level in ("", "unit"):
        factors = [number(f"{level}scalefactor", i, 1.0) for i in range(width)]
        out = [(s * f, o * f + number(f"{level}offset", i, 0.0)) for i, ((s, o), f) in enumerate(zip(out, factors))]
    return out


def _legend(lines: Sequence[str], width: int) -> list[str]:
    """Names of the columns from such lines; [] unless they number all columns, or all but the first."""
    found = [match for line in lines if (match := _LEGEND.match(line))]
    numbers = [int(match[1] or match[2] or ord(match[3].upper()) - ord("A")) for match in found]
    if len(found) < 2 or len(found) not in (width - 1, width) or numbers != list(range(numbers[0], numbers[0] + len(found))):
        return []
    return [*[""] * (width - len(found)), *(match[4].strip() for match in found)]


def _cells(line: str, delimiter: str, width: int) -> list[str]:
    """Cells of a line above the numbers; names beside numbers in columns of spaces may hold spaces themselves."""
    line = _COMMENT.sub("", line)
    # in columns of spaces a unit in brackets belongs to the name before it
    cells = [cell.replace("\x01", " ") for cell in cells_of(re.sub(r"\s+(?=[\[(])", "\x01", line) if delimiter == " " else line, delimiter)]
    cells = ["" if re.fullmatch(r"[:+]?-{2,}[:+]?", cell) else cell for cell in cells]  # a line below the names
    while len(cells) > width and cells[-1] == "":
        cells.pop()
    if len(cells) not in (width - 1, width):
        others = [re.split(r"\s{2,}|\t+", line.strip()), *(cells_of(line, other) for other in ";,\t|" if other != delimiter)]
        cells = next((own for own in others if len(own) == width > 1), cells)
    return cells


def _lines_of(table: Sequence[Sequence[str]], full: Sequence[int]) -> tuple[int | None, int | None, bool]:
    """Lines of names and of units, and whether the lines begin with their meaning."""
    keys = {i: _plain(re.sub(r"[\[(].*", "", table[i][0])).lower() for i in full}
    named = [i for i in full if keys[i] in _NAME_KEYS and _wordy(table[i][1:])]
    measured = [i for i in full if keys[i] in _UNIT_KEYS]
    if named and (measured or any(_INTERVAL.search(keys[i]) for i in full)):
        return named[0], measured[0] if measured else None, True
    worded = [i for i in full if _wordy(table[i]) and not _STATEMENT.match(" ".join(table[i]))]
    rows = [i for i in worded if not all(_TYPE.fullmatch(c) for c in table[i] if c)]
    if len(rows) > 1 and (_units(table[rows[-1]]) or rows[-1] in measured):
        return rows[-2], rows[-1], False
    return (rows[-1] if rows else None), None, False


def _units(cells: Sequence[str]) -> bool:
    """True for a line of units."""
    there = [c for c in cells if _plain(c)]
    return bool(there) and 2 * sum(bool(known_unit(_without_quantity(c))) for c in there) >= len(there)


def _wordy(cells: Sequence[str]) -> bool:
    """True if some cells are neither numbers nor dates, and these are no fewer than a third."""
    there = [c for c in cells if c]
    return 3 * sum(not is_number(c) and not is_stamp(c) for c in there) >= max(len(there), 1)


def _joined(above: Sequence[str], names: Sequence[str]) -> list[str]:
    """Names in two lines, 'X' over 'set point', where the lower ones alone occur twice. A name above holds until the next one."""
    twice = {n for n in names if n and names.count(n) > 1 and n.lower() not in UNUSED}  # type: ignore[attr-defined]
    if not twice or not any(above):
        return list(names)
    held, over = "", []
    for cell in above:
        held = cell or held
        over.append(held)
    joined = [f"{o} {n}".strip() if n in twice else n for o, n in zip(over, names)]
    return joined if len({j for j, n in zip(joined, names) if n in twice}) == sum(n in twice for n in names) else list(names)


def _given_names(columns: Any, filled: Sequence[bool], names: Sequence[str], path: Path) -> list[str]:
    """Names of all columns, or of all that have values."""
    if not isinstance(columns, list | tuple) or not all(isinstance(c, str) for c in columns):
        raise InputError(f'{path}: [csv] columns = {columns!r}; give the names of all columns, like ["time [ms]", "position"]')
    if len(columns) not in (len(filled), sum(filled)):
        there = f" ({', '.join(names[:8])}{', ...' if len(names) > 8 else ''})" if any(names) else ""
        given = f"{len(columns)} names in --columns, but the file has {sum(filled)} columns{there}"
        raise InputError(f"{path}: {given}; name each, '-' where unused")
    left = iter(columns)
    return [next(left).strip() if there or len(columns) == len(filled) else "" for there in filled]


def _split(name: str) -> tuple[str, str]:
    """Name and unit: 'Pos X [mm]', 'Pos X (mm)', 'Pos X in mm', 'Pos X / mm', 'Pos X, mm', 'n 1/min'."""
    plain, unit = split_heading(name)
    if unit:
        return plain, unit
    if (match := _WITHIN.search(name)) and (unit := known_unit(match[1] or match[2])):
        return f"{name[: match.start()].strip()} {name[match.end() :].strip()}", unit
    if match := _OTHER.fullmatch(name):
        other = (match[2] or match[3]).strip()
        return (name if other == "%" else match[1].strip()), other
    # a letter alone behind a name is an axis, not an ampere
    for behind in (r"(.*\w)\s*(?:\s+in\s+|\s+/\s+|,\s*|\s*/\s*\()([^\s()\]]+)\)?", r"(.*\w)\s+(\S*/\S+|mm|deg|rpm|Nm|ms|[uµμ]m|°)"):
        if (match := re.fullmatch(behind, name)) and (unit := known_unit(match[2])):
            return match[1], unit
    return name, ""


_OVER = re.compile(r"([^\[(]*[^/\s\[(])\s*/\s*([^/\s\[\]()]+)")
_WITHIN = re.compile(r"\s*(?:\[(?!\d+\])([^\[\]]+)\]|\(([^()]{2,}|[AVN](?=\)\W*[XYZABCUVW]\d?$))\))(?=\s*\S)")
"""A bracket within a name: 'Position [mm] (18)', 'Current (A) - X'; a letter alone may be the axis, where no other follows."""
_COUNTS = r"(?:counts?|cnts?|inc|incr|pulses?|pls|steps|ticks)(?: ?\d+ ?bit)?(?:/ ?s(?:ec)?)?"
_OTHER = re.compile(
    rf"(.*\S)\s*(?:\[\s*(?![XYZBCUW]\d?\s*\])((?:[^\[\],]|\d,(?=\d))*[^\[\],\d\s])\s*\]|\(\s*(%|{_COUNTS}|\d+(?:[.,]\d+)?\s*[^\s\d()][^()]*)\))",
    re.IGNORECASE,
)
"""A name with a unit of nobody: in square brackets anything but an index or an axis, in round ones counts or a number with a unit."""


def _without_quantity(cell: str) -> str:
    """'V (Voltage)' as 'V'."""
    return re.sub(r"(?<=\S)\s*\(.*\)$", "", cell)


def _plain(cell: str) -> str:
    """A unit without brackets and without words for none."""
    text = _without_quantity(cell).strip().strip("[]()").strip()
    return "" if text.lower() in ("none", "-", "--", "n/a", "no unit") else text


def _interval(lines: Sequence[str]) -> float | None:
    """The interval [s] from a line such as 'Sampling period is 100000 nSec', 'Sampling time interval(ms),0.667' or 'Abtastrate: 1 kHz'."""
    for line in (line.replace('"', "") for line in lines):
        key = _INTERVAL.search(line)
        amount = _AMOUNT.search(line, key.end()) if key else None
        if key and amount:
            behind = re.match(rf"[\s;,]*{_UNIT}(?![A-Za-z])", line[amount.end() :], re.IGNORECASE)
            before = re.search(rf"[\[(/_]\s*{_UNIT}\b[\s\])]*", line[key.start() : amount.start()], re.IGNORECASE)
            unit = (behind or before or [""] * 2)[1].lower()
            number = float(amount[0].replace(",", "."))
            if number > 0.0 and unit:
                return 1.0 / (number * _HERTZ[unit]) if unit in _HERTZ else number * RECORDED_UNITS[known_unit(unit)][1]
    return None


def _padded(cells: Sequence[str], width: int) -> list[str]:
    return [*cells, *[""] * (width - len(cells))]
