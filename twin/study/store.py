"""Results of a study in SQLite: one row per variant, committed as it arrives, so that a killed study loses no finished variant."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
import json
from pathlib import Path
import sqlite3
from typing import Any

from twin.errors import InputError
from twin.files import output_file, output_folder
from twin.study.evaluate import FAULT, Answer
from twin.tables import is_number

FILE = "study.sqlite"

Row = tuple[int, list[float], dict[str, float], str | None]
"""Number, factors, responses, reason."""


def _numbers(kind: type[Any], text: object) -> Any:
    """A list or an object of finite numbers in JSON."""
    found = json.loads(text) if isinstance(text, str) else None
    if not isinstance(found, kind) or not all(map(is_number, found.values() if kind is dict else found)):
        raise ValueError
    return found


class Store:
    """The results in one folder; only one study at a time can open it."""

    def __init__(self, folder: Path, fingerprint: str, resume: bool) -> None:
        self.path = folder / FILE
        output_file(output_folder(folder) / FILE)  # no link, which the library would follow
        with self._said():
            self.connection = sqlite3.connect(self.path, timeout=0.2, isolation_level=None)
        try:
            with self._said():
                # locked until closed, so that two studies never write to one folder
                self.connection.execute("PRAGMA locking_mode = EXCLUSIVE")
                self.connection.execute("BEGIN IMMEDIATE")
                self.connection.execute("CREATE TABLE IF NOT EXISTS study (fingerprint TEXT)")
                self.connection.execute(
                    "CREATE TABLE IF NOT EXISTS variant (number INTEGER PRIMARY KEY, factors TEXT, responses TEXT, reason TEXT)"
                )
                # a variant that an error of the program ended is computed again
                self.connection.execute("DELETE FROM variant WHERE reason LIKE ?", (FAULT + "%",))
                known = [row[0] for row in self.connection.execute("SELECT fingerprint FROM study")]
                if not known:
                    self.connection.execute("INSERT INTO study VALUES (?)", (fingerprint,))
                self.connection.execute("COMMIT")
            if known and known[0] != fingerprint:
                raise InputError(
                    f"{self.path}: holds another study (factors, runs, machine, part, a mesh, design or the version of twin differ); give another --out"
                )
            if (done := len(self.done())) and not resume:
                raise InputError(f"{self.path}: already holds {done} variants; add --resume or give another --out")
        except BaseException:
            self.connection.close()
            raise

    @contextlib.contextmanager
    def _said(self) -> Iterator[None]:
        """Turn SQLite errors into one-line messages."""
        try:
            yield
        except sqlite3.IntegrityError:  # a duplicate variant is an internal error
            raise
        except sqlite3.OperationalError as error:
            if "locked" in str(error):
                raise InputError(f"{self.path}: another study is writing here; give another --out or wait for it") from None
            raise InputError(f"{self.path}: cannot be used ({error}); check the disk or give another --out") from None
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:  # the message of a damaged file may not be text
            raise InputError(f"{self.path}: not the database of a study ({error}); move it away or give another --out") from None

    def done(self) -> set[int]:
        """Numbers of the variants that have a row."""
        with self._said():
            return {row[0] for row in self.connection.execute("SELECT number FROM variant")}

    def put(self, number: int, factors: Sequence[float], answer: Answer) -> None:
        """Commit one variant; a second row for the same variant is refused."""
        row = (number, json.dumps(list(factors)), json.dumps(answer.responses), answer.reason)
        with self._said():
            self.connection.execute("INSERT INTO variant VALUES (?, ?, ?, ?)", row)

    def rows(self) -> list[Row]:
        """All rows in the order of the design."""
        with self._said():
            found = self.connection.execute("SELECT number, factors, responses, reason FROM variant ORDER BY number").fetchall()
        try:
            rows = [(n, _numbers(list, f), _numbers(dict, r), None if reason is None else str(reason)) for n, f, r, reason in found]
            if len({len(factors) for _, factors, _, _ in rows}) > 1:
                raise ValueError("rows of different length")
        except ValueError:
            raise InputError(f"{self.path}: a row is damaged; move the file away or give another --out") from None
        return rows

    def close(self) -> None:
        """Close the database and release its lock."""
        self.connection.close()
