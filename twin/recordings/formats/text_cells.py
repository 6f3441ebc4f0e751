"""Cells of a line of text, and what a cell is: a number, a date or clock time, a word, or blank."""

import csv
from datetime import UTC, datetime
import re
from typing import NamedTuple

NUMBER, STAMP, WORD, BLANK = "number", "stamp", "word", ""
THOUSANDS = {mark: f"{other}'\u2019\u00a0\u202f " for mark, other in ((".", ","), (",", "."))}
"""Decimal mark -> what may separate thousands."""
GROUPED = {
    mark: rf"[+-]?\d{{1,3}}(?:(?:[{between}]\d{{3}})+[{mark}]\d+|(?:[{between}]\d{{3}}){{2,}}|(?:['\u2019]\d{{3}})+)"
    for mark, between in THOUSANDS.items()
}
"""Numbers with separated thousands. 1.234 alone is none: it may have a decimal point."""
_NUMBERS = {
    mark: re.compile(rf"[+-]?(?:\d+(?:[{mark}]\d*)?|[{mark}]\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf)|{grouped}", re.IGNORECASE)
    for mark, grouped in GROUPED.items()
}
_STAMP = re.compile(
    r"(?:(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})|(?P<a>\d{1,2})(?P<mark>[-/.])(?P<b>\d{1,2})[-/.](?P<c>\d{4}|\d{2}))?"
    r"(?:(?:\d+ days)?[T_, ]+|(?=\d{1,2}:)|$)"
    r"(?:(?:(?P<h>\d{1,2}):)?(?P<min>\d{1,2}):(?P<s>\d{1,2})(?:[.,:](?P<f>\d{1,9}))?\s*(?P<half>[AaPp][Mm])?)?"
    r"\s*(?P<zone>Z|[+-]\d{2}:?\d{2})?"
)
DAY_NS = 86_400_000_000_000
MISSING = ("-", "--", "---", "n/a", "N/A", "#N/A", "null", "NULL", "None")
"""Words of a cell without a sample, besides the empty cell."""


def cells_of(line: str, delimiter: str) -> list[str]:
    """The cells of a line; several spaces count as one delimiter."""
    if '"' not in line:
        return line.split() if delimiter == " " else [cell.strip() for cell in line.split(delimiter)]
    cells = next(csv.reader([line.strip() if delimiter == " " else line], delimiter=delimiter, skipinitialspace=True), [])
    return [c for c in cells if c] if delimiter == " " else [c.strip() for c in cells]


def kind_of(cell: str, decimal: str) -> str:
    """What a cell is with this decimal mark."""
    if cell == "" or cell in MISSING:
        return BLANK
    if _NUMBERS[decimal].fullmatch(cell):
        return NUMBER
    return STAMP if is_stamp(cell) else WORD


def number_text(cell: str, decimal: str) -> str:
    """A number with a decimal point and without separators of thousands."""
    return re.sub(f"[{THOUSANDS[decimal]}]", "", cell).replace(decimal, ".")


def is_number(cell: str) -> bool:
    """True for a number with a point or a comma."""
    return any(pattern.fullmatch(cell) for pattern in _NUMBERS.values())


def is_stamp(cell: str) -> bool:
    """True for a date, a clock time, or both."""
    return len(cell) > 5 and cell.lstrip("[")[:1].isdigit() and stamp_of(cell) is not None


class Stamp(NamedTuple):
    """Nanoseconds of a date, since 1970, or of a clock time, since midnight; whether it has a date, and a time of day."""

    ns: int
    dated: bool
    timed: bool


def stamp_of(text: str) -> Stamp | None:
    """The date or clock time in a text, which may stand in brackets; None if it is neither.

    14.05.2024 is the 14th of May; 05/14/2024 too, where the numbers allow it. A zone is taken off.
    """
    match = _STAMP.fullmatch(text.strip(" []"))
    # 12:30 without more may be hours or minutes
    if match is None or not (match["y"] or match["a"] or (match["s"] and (match["h"] or match["f"]))):
        return None
    dated = bool(match["y"] or match["a"])
    try:
        ns = int(datetime(*_day(match), tzinfo=UTC).timestamp()) * 1_000_000_000 if dated else 0
    except ValueError:
        return None
    if match["s"]:
        hour = int(match["h"] or 0)
        if match["half"]:
            hour = hour % 12 + (12 if match["half"].lower() == "pm" else 0)
        if hour > 23 or int(match["min"]) > 59 or int(match["s"]) > 60:
            return None
        ns += ((hour * 60 + int(match["min"])) * 60 + int(match["s"])) * 1_000_000_000 + int((match["f"] or "0").ljust(9, "0"))
    if (zone := match["zone"]) and zone != "Z":
        minutes = int(zone[1:3]) * 60 + int(zone[-2:])
        ns -= (1 if zone[0] == "+" else -1) * minutes * 60_000_000_000
    return Stamp(ns, dated, bool(match["s"]))


def _day(match: re.Match[str]) -> tuple[int, int, int]:
    """Year, month and day of a date."""
    if match["y"]:
        return int(match["y"]), int(match["m"]), int(match["d"])
    first, second, year = int(match["a"]), int(match["b"]), int(match["c"])
    day, month = (second, first) if match["mark"] == "/" and first <= 12 else (first, second)
    return year + (2000 if year < 100 else 0), month, day
