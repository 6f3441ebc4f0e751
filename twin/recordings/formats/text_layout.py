"""Layout of a text file of numbers: delimiter, decimal mark, first row, and how the cells belong together.

table    a row is a moment, a column a signal; also with a time column of its own for each group of signals
pairs    each value stands behind its name: `pos 1.5 speed 0.2`
long     each row is one value: time, name, value
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import itertools
import re
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.recordings.formats.text_cells import BLANK, NUMBER, WORD, cells_of, kind_of, number_text
from twin.recordings.formats.text_sample import MOST_LINES, Sample
from twin.recordings.signals import known_unit
from twin.recordings.time_column import numbers_rows

_PAIRS = ((";", ","), ("\t", ","), (";", "."), ("\t", "."), (",", "."), ("|", "."), ("|", ","), (" ", "."), (" ", ","), (",", ","))
"""Delimiter and decimal mark are found together: only the right pair makes numbers of most cells. The order decides ties."""
_LONG_NAMES = (
    "name", "signal", "channel", "tag", "tagname", "variable", "pv", "parameter", "item", "point", "kanal", "messgroesse", "metric",
    "symbol", "varname", "_field", "field", "nodeid", "browsename", "dataitemid", "sensor",
)  # fmt: skip
_LONG_AXES = (
    "axis", "axes", "achse", "axe", "joint", "drive", "antrieb", "motor", "servo", "axis_id", "axis_name", "joint_name", "joint_id",
)  # fmt: skip
_NAME_OF_AXIS = re.compile(r"[XYZABCUVW]|\D*\d{1,2}", re.IGNORECASE)
_LONG_VALUES = ("value", "_value", "varvalue", "wert", "valeur", "val")


@dataclass(frozen=True)
class Rows:
    """Rows of data in the sample. `first`: lines before them. `kinds`: of each column. `cells` (row, column): those that have all columns."""

    delimiter: str
    decimal: str
    first: int
    kinds: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]
    score: int

    def columns(self, kind: str) -> list[int]:
        """Indices of the columns of a kind."""
        return [i for i, own in enumerate(self.kinds) if own == kind]

    def values(self, column: int) -> np.ndarray:
        """Numbers of a column, NaN where a cell is none."""
        texts = (row[column] for row in self.cells)
        return np.array([float(number_text(t, self.decimal)) if kind_of(t, self.decimal) == NUMBER else np.nan for t in texts])

    def texts(self, column: int) -> list[str]:
        """Cells of a column."""
        return [row[column] for row in self.cells]


def find_rows(sample: Sample, given: Mapping[str, Any]) -> Rows:
    """The rows of numbers. Columns of words are accepted only if no pair of delimiter and decimal mark does without.

    Raises:
        InputError: there are none.
    """
    pairs = [p for p in _PAIRS if given.get("delimiter", p[0]) == p[0] and given.get("decimal", p[1]) == p[1]]
    found = [rows for pair in pairs for rows in _rows(sample.lines[:MOST_LINES], *pair)]
    for words in (False, True):
        if fitting := [rows for rows in found if words or WORD not in rows.kinds]:
            return max(fitting, key=lambda rows: rows.score)
    remedy = "is it a recording as text? give delimiter and decimal in [csv] of a map if it is one"
    raise InputError(f"{sample.path}: no rows of numbers found; {remedy}")


def _rows(lines: Sequence[str], delimiter: str, decimal: str) -> Iterator[Rows]:
    """Rows of each width that many lines have."""
    table = [cells_of(line, delimiter) for line in lines]
    kinds = [[kind_of(cell, decimal) for cell in row] for row in table]
    widths = Counter(len(row) for row in table if any(row))
    for width in sorted(widths, key=lambda w: w * widths[w], reverse=True)[:3] + [w for w in widths if w == max(widths)]:
        if width < 2:
            continue
        full = [i for i, row in enumerate(kinds) if len(row) == width and any(row)]
        # the last rows are no heading; a channel that has ended is blank there
        columns = tuple(_majority([kinds[i][c] for i in full[-50:]]) or _majority([kinds[i][c] for i in full]) for c in range(width))
        fits = [bool(any(row)) and len(row) <= width and all(k in (BLANK, c) or c == WORD for k, c in zip(row, columns)) for row in kinds]
        there = [i for i, row in enumerate(kinds) if any(row)]  # lines with content
        # a row of data is followed by another one; a heading whose cells happen to fit is not
        followed = zip(there, [*there[1:], there[-1]])
        first = next((i for i, after in followed if len(kinds[i]) == width and fits[i] and fits[after]), len(kinds))
        # a heading 0, 1, 2, ... or 1, 2, 3, ...
        if first + 1 in there and any(table[first] == [str(i + start) for i in range(width)] for start in (0, 1)):
            first += 1
        rows = [i for i in there if i >= first and fits[i]]
        numbers = columns.count(NUMBER)
        if not numbers or len(rows) < 0.5 * sum(i >= first for i in there):
            continue
        cells = tuple(tuple(table[i]) for i in rows if len(table[i]) == width)
        # cells of decimal numbers decide between the marks; whole numbers have none
        mark = decimal if decimal == "." or any("," in cell for row in cells for cell in row) else "."
        score = sum(min(len(table[i]), numbers) for i in rows)
        yield Rows(delimiter, mark, first, columns, cells, score)


def _majority(kinds: Sequence[str]) -> str:
    """The kind of a column; blank cells do not count."""
    counted = Counter(there := [kind for kind in kinds if kind != BLANK])
    return max(counted, key=lambda kind: (counted[kind], kind == there[-1])) if counted else BLANK


def names_in_pairs(rows: Rows, headed: bool) -> dict[int, str] | None:
    """Column -> name where each value stands behind its name, else None. A time may come first."""
    used = [i for i, kind in enumerate(rows.kinds) if kind != BLANK]
    for start in (0, 1, 2):
        words, values = used[start::2], used[start + 1 :: 2]
        if (
            len(words) == len(values) > (1 if headed else 0)
            and all(rows.kinds[i] == WORD and len(set(rows.texts(i))) == 1 for i in words)
            and all(rows.kinds[i] == NUMBER for i in values)
            and all(rows.kinds[i] != WORD for i in used[:start])
        ):
            return {value: rows.cells[0][word] for word, value in zip(words, values)}
    return None


@dataclass(frozen=True)
class Long:
    """Columns of a table with one value a row, or with the values of one axis. `names`: one, or several that only together distinguish the signals.
    `times`: one, or a date and a clock time. `unit`: None if there is no column of units."""

    names: tuple[int, ...]
    values: tuple[int, ...]
    times: tuple[int, ...]
    unit: int | None


def long_table(rows: Rows, names: Sequence[str], stamps: Sequence[int]) -> Long | None:
    """The columns of a long table, or None. `stamps`: the columns of its dates.

    Names alternate with others at the same times, or the name of their column tells: a table may be sorted by them. The phases of a program,
    which a table may also have as words, follow one another. Further numbers number the rows, or never change (a quality, the table of a query).
    """
    words = [i for i in rows.columns(WORD) if 1 < len(set(rows.texts(i))) <= max(len(rows.cells) // 3, 2)]
    words = words or [i for i in rows.columns(WORD) if names[i].lower() in _LONG_NAMES and len(set(rows.texts(i))) == 1]
    heads = {i: head for i in rows.columns(NUMBER) if len(np.unique(head := rows.values(i))) > 1}
    if not words or not heads or len(heads) > 3:
        return None
    named = sorted((i for i in words if names[i].lower() in _LONG_NAMES), key=lambda i: _LONG_NAMES.index(names[i].lower()))
    name = named[0] if named else max(words, key=lambda i: len(set(rows.texts(i))))
    own = np.array(rows.texts(name)) == rows.texts(name)[0]
    rising = [i for i, head in heads.items() if own.sum() > 1 and np.all(np.diff(head[own]) > 0.0)]
    values = [i for i in heads if names[i].lower() in _LONG_VALUES] or [i for i in heads if i not in rising] or rising[1:]
    times = [i for i in rising if i not in values and not (stamps and numbers_rows(heads[i]))]
    others = [head for i, head in heads.items() if i not in (*values, *times[:1])]
    if len(values) != 1 or not (stamps or times) or not all(numbers_rows(head) or not np.ptp(head[own]) for head in others):
        return None
    at = [" ".join(row[i] for i in stamps or times[:1]) for row in rows.cells]
    if stamps and times and len(set(rows.texts(times[0]))) > len(set(at)):  # dates in whole seconds beside a finer time
        stamps, at = (), rows.texts(times[0])
    texts, taken = rows.texts(name), [name]
    for more in [i for i in words if i != name and len(set(zip(at, texts))) < len(texts)]:
        if len(set(zip(at, texts, rows.texts(more)))) == len(texts):
            taken, texts = [more, name], [f"{a} {b}" for a, b in zip(rows.texts(more), texts)]
    beside = [i for i in rows.columns(WORD) if i not in taken and len(set(rows.texts(i))) == 1]  # they may change later
    taken += [i for i in beside if names[i].lower() in _LONG_NAMES]
    taken[:0] = [i for i in beside if names[i].lower() in _LONG_AXES]
    unit = next((i for i in rows.columns(WORD) if i not in taken and all(map(known_unit, rows.texts(i)))), None)
    shared = len(set(at)) < len(at)
    interleaved = sum(a != b for a, b in itertools.pairwise(texts)) > 2 * len(set(texts))
    return Long(tuple(taken), (values[0],), tuple(stamps) or (times[0],), unit) if named or shared or interleaved else None


def table_of_axes(rows: Rows, names: Sequence[str], stamps: Sequence[int]) -> Long | None:
    """The columns of a table whose rows are those of one axis after the other, each at every time; None if it is none. A table that is sorted by
    its axes shows the name of the first one here."""
    axis = next((i for i in range(len(rows.kinds)) if names[i].lower() in _LONG_AXES), None)
    if axis is None or (count := len(set(rows.texts(axis)))) > MOST_AXES:
        return None
    if count == 1 and not (rows.kinds[axis] == WORD and _NAME_OF_AXIS.fullmatch(rows.texts(axis)[0])):
        return None
    own = np.array(rows.texts(axis)) == rows.texts(axis)[0]
    numbers = [i for i in rows.columns(NUMBER) if i != axis]
    rising = [i for i in numbers if own.sum() > 1 and np.all(np.diff(rows.values(i)[own]) > 0.0)]
    times = tuple(stamps) or tuple(i for i in rising if len(set(rows.texts(i))) * count <= len(rows.cells) + count)[:1]
    values = tuple(i for i in numbers if i not in times)
    at = list(zip(*(rows.texts(i) for i in times)))
    one_each = len(set(zip(at, rows.texts(axis)))) == len(at) and (count == 1 or len(set(at)) < len(at))
    return Long((axis,), values, times, None) if times and values and one_each else None


MOST_AXES = 64
"""Axes of a machine or of a cell of robots; more different words are no axes."""
