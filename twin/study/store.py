"""Results of a study, one row per variant, committed as it arrives."""

from collections.abc import Sequence
import json
from pathlib import Path
from typing import Any

from twin.errors import InputError
from twin.study.evaluate import FAULT, Answer
from twin.study.row_file import RowFile
from twin.tables import is_number

FILE = "study.sqlite"

Row = tuple[int, list[float], dict[str, float], str | None]
"""Number, factors, responses, reason."""


def _numbers(kind: type[Any], text: object) -> Any:
    """A list or an object of finite numbers in JSON."""
    found = json.loads(text) if isinstance(text, str) else None
    if not isinstance(found, kind) or not all(map(is_number, found.values() if kind is dict else found)):
        raise ValueError("a row is damaged")
    return found


class Store(RowFile):
    """The results in one folder; only one study at a time can open it."""

    def __init__(self, folder: Path, fingerprint: str, resume: bool) -> None:
        columns = "number INTEGER PRIMARY KEY, factors TEXT, responses TEXT, reason TEXT"
        other = "holds another study (factors, runs, machine, part, a mesh, design or the version of twin differ)"
        super().__init__(folder, FILE, "variant", columns, fingerprint, other)
        with self.in_one_line():  # a variant that an error of the program ended is computed again
            self.connection.execute("DELETE FROM variant WHERE reason LIKE ?", (FAULT + "%",))
        if (done := len(self.done())) and not resume:
            self.close()
            raise InputError(f"{self.path}: already holds {done} variants; add --resume or give another --out")

    def done(self) -> set[int]:
        """Numbers of the variants that have a row."""
        return {row[0] for row in self.select("number")}

    def put(self, number: int, factors: Sequence[float], answer: Answer) -> None:
        """Commit one variant; a second row for the same variant is refused."""
        self.insert((number, json.dumps(list(factors)), json.dumps(answer.responses), answer.reason))

    def rows(self) -> list[Row]:
        """All rows in the order of the design."""
        found = self.select("number, factors, responses, reason", "number")
        with self.in_one_line():
            rows = [(n, _numbers(list, f), _numbers(dict, r), None if reason is None else str(reason)) for n, f, r, reason in found]
            if len({len(factors) for _, factors, _, _ in rows}) > 1:
                raise ValueError("rows of different length")
        return rows
