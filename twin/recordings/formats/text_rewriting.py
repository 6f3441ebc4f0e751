"""Cells that hold more than a number, rewritten so that each holds a number or a name.

lists   "[0.1, 0.2]"     0.1,0.2      and each name above once an element: q[0],q[1]
units   12.5 mm          12.5         and the name above with its unit: pos [mm]
names   pos=12.5         pos 12.5     pairs of a name and a number
"""

from collections.abc import Callable, Sequence
import re
from typing import NamedTuple

from twin.recordings.formats.text_cells import cells_of
from twin.recordings.signals import known_unit

Rewriting = Callable[[str], str]
_NUMBER = r"[-+]?(?:\d+(?:[.,]\d+)*|\.\d+)(?:[eE][-+]?\d+)?"
_LIST = re.compile(r'"?[\[(]\s*([-+.\d][-+.\deE]*(?:[,\s]+[-+.\d][-+.\deE]*)+)\s*[\])]"?')
_VALUE = re.compile(rf'"?({_NUMBER})\s?([^\W\d_][^\s";,|]*|%|)"?')
_PAIR = re.compile(rf"([^\W\d][\w.\[\]-]*)\s*[=:]\s*({_NUMBER})[,;]?(?=\s|$)")


class Rewritten(NamedTuple):
    """How lines with numbers, and lines above them, are rewritten."""

    rows: Rewriting = str
    heading: Rewriting = str


def rewriting_of(lines: Sequence[str]) -> Rewritten:
    """How these lines of a text are rewritten; by the last of them."""
    last = next((line for line in reversed(lines) if any(c.isdigit() for c in line)), "")
    if len(_PAIR.findall(last)) > 1 and not _PAIR.sub("", last).strip(" \t,;"):
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
    behind = re.compile(
        rf"(?<=[\d.])\s?(?:{'|'.join(map(re.escape, sorted({*units} - {''}, key=len, reverse=True)))})(?=\"?\s*(?:{re.escape(delimiter)}|$))",
        re.MULTILINE,
    )

    def stated(line: str) -> str:
        above = cells_of(line, delimiter)
        if behind.search(line) or len(above) != len(units):
            return behind.sub("", line)
        return delimiter.join(f"{cell} [{unit}]" if unit and cell else cell for cell, unit in zip(above, units))

    return Rewritten(lambda text: behind.sub("", text), stated)
