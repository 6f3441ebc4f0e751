"""A history in SQLite: one transaction a campaign, so that a command that is killed at any time loses no judged campaign and counts none twice.

    history  (key, value)             machine and directions: a history belongs to one reference
    campaign (name, digest, content)  digest: of the recording's files; content: day, program, noise, and `twin.history.projection` of each group

Everything else (sizes, changes, alarms) follows from these rows and is computed anew each time.
"""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
import sqlite3
import zlib

import msgspec
import numpy as np

from twin.errors import InputError
from twin.files import output_file, output_folder
from twin.history.projection import Noise, Projection

FILE = "history.sqlite"

_TABLES = (
    "CREATE TABLE IF NOT EXISTS history (key TEXT PRIMARY KEY, value TEXT)",
    "CREATE TABLE IF NOT EXISTS campaign (name TEXT PRIMARY KEY, digest TEXT UNIQUE, content BLOB)",
)
_CONTENT = msgspec.msgpack.Decoder(
    tuple[datetime, tuple[float, ...], tuple[dict[str, float], ...], list[tuple[tuple[str, ...], bytes, bytes]]]
)


@dataclass(frozen=True)
class Row:
    """A judged campaign: name, day, what identifies its program, the noise of its runs, and its projections by group of axes."""

    digest: str
    name: str
    day: datetime
    program: tuple[float, ...]
    noise: tuple[Noise, ...]
    projections: dict[tuple[str, ...], Projection]


class Store:
    """The history of one machine in a folder; only one command at a time can open it."""

    def __init__(self, folder: Path, reference: str) -> None:
        """`reference` identifies machine and directions. Raises InputError if the folder holds the history of another one."""
        self.path = output_file(output_folder(folder) / FILE)  # no link, which the library would follow
        with self._said():
            self.connection = sqlite3.connect(self.path, timeout=0.2, isolation_level=None)
            self.connection.execute("PRAGMA locking_mode = EXCLUSIVE")
        with self._transaction():
            for table in _TABLES:
                self.connection.execute(table)
            known = self.connection.execute("SELECT value FROM history WHERE key = 'reference'").fetchone()
            if known is None:
                self.connection.execute("INSERT INTO history VALUES ('reference', ?)", (reference,))
        if known is not None and known[0] != reference:
            self.close()
            raise InputError(f"{self.path}: the history of another machine file or of another version of twin; give another --out")

    @contextlib.contextmanager
    def _said(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.DatabaseError, zlib.error, msgspec.DecodeError, ValueError, TypeError) as error:
            what = (
                "another twin command is writing here; wait for it"
                if "locked" in str(error)
                else f"cannot be used ({error}); check the disk"
            )
            raise InputError(f"{self.path}: {what} or give another --out") from None

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._said():
            self.connection.execute("BEGIN IMMEDIATE")
            try:
                yield
            except BaseException:
                self.connection.execute("ROLLBACK")
                raise
            self.connection.execute("COMMIT")

    def put(self, row: Row) -> None:
        """Commit one campaign, in place of an earlier one of this name."""
        groups = [(axes, p.gram.astype("<f4").tobytes(), p.right.astype("<f8").tobytes()) for axes, p in row.projections.items()]
        content = zlib.compress(msgspec.msgpack.encode((row.day, row.program, row.noise, groups)), 3)
        with self._transaction():
            self.connection.execute("INSERT OR REPLACE INTO campaign VALUES (?, ?, ?)", (row.name, row.digest, content))

    def rows(self) -> list[Row]:
        """All campaigns in the order in which they were judged."""
        with self._said():
            found = []
            for name, digest, content in self.connection.execute("SELECT * FROM campaign ORDER BY rowid"):
                day, program, noise, groups = _CONTENT.decode(zlib.decompress(content))
                projections = {}
                for axes, gram, right in groups:
                    b = np.frombuffer(right, "<f8")
                    projections[axes] = Projection(axes, np.frombuffer(gram, "<f4").astype(float).reshape(len(b), -1), b)
                found.append(Row(digest, name, day, program, noise, projections))
        return found

    def close(self) -> None:
        """Close the data base and release its lock."""
        self.connection.close()
