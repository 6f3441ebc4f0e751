"""The first lines of a text file: its encoding, and its lines with cells that hold a number or a name each. Other cells are rewritten:

lists   "[0.1, 0.2]"     0.1,0.2      and each name above once an element: q[0],q[1]
units   12.5 mm          12.5         and the name above with its unit: pos [mm]
names   pos=12.5         pos 12.5     pairs of a name and a number, also behind a date or clock time
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
import re
from typing import NamedTuple

from twin.errors import InputError
from twin.recordings.formats.text_cells import cells_of, is_stamp
from twin.recordings.signals import known_unit
from twin.recordings.words import TERM

SAMPLE_BYTES = 1 << 18
"""Bytes at the start of a file that show encoding and layout."""
MOST_LINES = 600
"""Lines that show the layout."""
EASTERN = ("gb18030", "cp932", "big5")
"""Encodings of Chinese and Japanese text; the right encoding shows the most terms of drives."""
_NOT_TEXT = ((b"PK\x03\x04", "an archive: unpack it"), (b"\xd0\xcf\x11\xe0", "an old workbook: save it as .xlsx"))

Rewriting = Callable[[str], str]
_NUMBER = r"[-+]?(?:\d+(?:[.,]\d+)*|\.\d+)(?:[eE][-+]?\d+)?"
_LIST = re.compile(r'"?[\[(]\s*([-+.\d][-+.\deE]*(?:[,\s]+[-+.\d][-+.\deE]*)+)\s*[\])]"?')
_VALUE = re.compile(rf'"?({_NUMBER})\s?([^\W\d_][^\s";,|]*|%|)"?')
_PAIR = re.compile(rf"([^\W\d][\w.\[\]-]*)\s*[=:]\s*({_NUMBER})[,;]?(?=\s|$)")


@dataclass(frozen=True)
class Sample:
    """The first lines of a text file."""

    path: Path
    encoding: str
    lines: tuple[str, ...]
    rewritten: Rewriting = str
    """Rows of the file as in `lines`, see `rewriting_of`."""


def read_sample(path: Path, encoding: object = None) -> Sample:
    """Encoding and first lines; an incomplete last one is left out. `encoding`: given in a map."""
    with open(path, "rb") as file:
        head = file.read(SAMPLE_BYTES)
    encoding = str(encoding) if encoding else _encoding(head, path)
    try:
        text = head.decode(encoding, errors="ignore")
    except LookupError:
        raise InputError(f"{path}: [csv] encoding '{encoding}' is unknown; use utf-8, latin-1, utf-16, gb18030 or cp932") from None
    # the line ends of Python's text files; str.splitlines knows more
    lines = text.lstrip("\ufeff").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    lines = lines[:-1] if len(head) == SAMPLE_BYTES or not lines[-1] else lines
    rewritten = rewriting_of(lines[:MOST_LINES])
    return Sample(path, encoding, tuple(map(rewritten.heading, lines)), rewritten.rows)


def _encoding(head: bytes, path: Path) -> str:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\x00" in head:
        # Western text in UTF-16 without its mark has a zero in every second byte
        for at, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
            if head[at::2].count(0) > 0.9 * len(head[at::2]) and not head[1 - at :: 2].count(0):
                return encoding
        unknown = "not a text file (it holds zero bytes), and no known format"
        known = next((what for magic, what in _NOT_TEXT if head.startswith(magic)), unknown)
        raise InputError(f"{path}: {known}; export the recording as text")
    try:
        head[: len(head) - 4].decode("utf-8")
    except UnicodeDecodeError:
        return max(("latin-1", *EASTERN), key=lambda encoding: len(TERM.findall(head.decode(encoding, errors="ignore"))))
    return "utf-8"


class Rewritten(NamedTuple):
    """How lines with numbers, and lines above them, are rewritten."""

    rows: Rewriting = str
    heading: Rewriting = str


def rewriting_of(lines: Sequence[str]) -> Rewritten:
    """How these lines of a text are rewritten; by the last of them. A semicolon that ends each row, as in a matrix of MATLAB, is taken off."""
    numbers = [line.rstrip() for line in lines if any(c.isdigit() for c in line)]
    if 2 * sum(line.find(";") == len(line) - 1 for line in numbers) > len(numbers):
        inner = _rewriting_of([_END.sub("", line) for line in lines])
        return Rewritten(lambda text: inner.rows(_END.sub("", text)), lambda text: inner.heading(_END.sub("", text)))
    return _rewriting_of(lines)


_END = re.compile(r";[ \t]*$", re.MULTILINE)


def _rewriting_of(lines: Sequence[str]) -> Rewritten:
    """The same for rows without such an end."""
    last = next((line for line in reversed(lines) if any(c.isdigit() for c in line)), "")
    beside = _PAIR.sub("", last).strip(" \t,;")
    if len(_PAIR.findall(last)) > 1 and (not beside or is_stamp(beside)):
        return Rewritten(*[lambda text: _PAIR.sub(r"\1 \2 ", text)] * 2)
    plain = _LIST.sub("0", last)
    delimiter = max(",;\t|", key=lambda mark: sum(bool(_VALUE.fullmatch(cell)) for cell in cells_of(plain, mark)))
    cells = cells_of(last, delimiter)
    if plain != last:

        def spread(text: str) -> str:
            return _LIST.sub(lambda cell: delimiter.join(re.split(r"[,\s]+", cell[1].strip())), text)

        sizes = [len(cells_of(spread(f'"{cell}"'), delimiter)) for cell in cells]

        def wide(line: str) -> str:
            above = cells_of(line, delimiter)
            if _LIST.search(line) or len(above) != len(sizes):
                return spread(line)
            return delimiter.join(cell if n == 1 else delimiter.join(f"{cell}[{k}]" for k in range(n)) for cell, n in zip(above, sizes))

        return Rewritten(spread, wide)
    rows = [row for line in lines if len(row := cells_of(line, delimiter)) == len(cells) > 1]
    units = [match[2] if (match := _VALUE.fullmatch(cell)) and (known_unit(match[2]) or match[2] == "%") else "" for cell in cells]
    units = [unit if 2 * sum(row[i].endswith(unit) for row in rows) > len(rows) else "" for i, unit in enumerate(units)]
    if not any(units):
        return Rewritten()
    known = "|".join(map(re.escape, sorted({*units} - {""}, key=len, reverse=True)))
    behind = re.compile(rf"(?<=[\d.])\s?(?:{known})(?=\"?\s*(?:{re.escape(delimiter)}|$))", re.MULTILINE)

    def stated(line: str) -> str:
        above = cells_of(line, delimiter)
        if behind.search(line) or len(above) != len(units):
            return behind.sub("", line)
        return delimiter.join(f"{cell} [{unit}]" if unit and cell else cell for cell, unit in zip(above, units))

    return Rewritten(lambda text: behind.sub("", text), stated)
