"""A history in SQLite: one transaction a campaign, so that a command that is killed at any time loses no judged campaign and counts none twice.

    history    (key, value)                                         format, machine, directions: a history belongs to one reference
    campaign   (digest, name, day, program)                         key: the digest of the recording's files
    projection (digest, axes, gram, right)                          `twin.history.projection`, in the order of the directions

Everything else (sizes, changes, alarms) follows from these rows and is computed anew each time.
"""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
from dataclasses import dataclass
from datetime import datetime
import json
from pathlib import Path
import sqlite3
import zlib

import numpy as np

from twin.errors import InputError
from twin.files import output_file, output_folder
from twin.history.projection import Projection

FILE = "history.sqlite"

_TABLES = (
    "CREATE TABLE IF NOT EXISTS history (key TEXT PRIMARY KEY, value TEXT)",
    "CREATE TABLE IF NOT EXISTS campaign (digest TEXT PRIMARY KEY, name TEXT, day TEXT, program TEXT)",
    "CREATE TABLE IF NOT EXISTS projection (digest TEXT, axes TEXT, gram BLOB, right BLOB, PRIMARY KEY (digest, axes))",
)


@dataclass(frozen=True)
class Row:
    """A judged campaign: name, day, what identifies its program, and its projections by group of axes."""

    digest: str
    name: str
    day: datetime
    program: tuple[float, ...]
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
        except (sqlite3.DatabaseError, zlib.error, ValueError, TypeError) as error:
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

    def digests(self) -> set[str]:
        """Digests of the campaigns that were judged."""
        with self._said():
            return {row[0] for row in self.connection.execute("SELECT digest FROM campaign")}

    def put(self, row: Row) -> None:
        """Commit one campaign, in place of an earlier one of this name."""
        with self._transaction():
            for (old,) in self.connection.execute("SELECT digest FROM campaign WHERE name = ?", (row.name,)).fetchall():
                for table in ("campaign", "projection"):
                    self.connection.execute(f"DELETE FROM {table} WHERE digest = ?", (old,))
            self.connection.execute(
                "INSERT INTO campaign VALUES (?, ?, ?, ?)", (row.digest, row.name, row.day.isoformat(), json.dumps(row.program))
            )
            for axes, p in row.projections.items():
                values = (row.digest, " ".join(axes), _packed(p.gram, "<f4"), _packed(p.right, "<f8"))
                self.connection.execute("INSERT INTO projection VALUES (?, ?, ?, ?)", values)

    def rows(self) -> list[Row]:
        """All campaigns by day."""
        with self._said():
            campaigns = self.connection.execute("SELECT digest, name, day, program FROM campaign ORDER BY day, name").fetchall()
            found: dict[str, dict[tuple[str, ...], Projection]] = {}
            for digest, axes, gram, right in self.connection.execute("SELECT * FROM projection"):
                b = _unpacked(right, "<f8")
                group = tuple(axes.split())
                found.setdefault(digest, {})[group] = Projection(group, _unpacked(gram, "<f4").reshape(len(b), len(b)), b)
        return [
            Row(digest, name, datetime.fromisoformat(day), tuple(json.loads(program)), found.get(digest, {}))
            for digest, name, day, program in campaigns
        ]

    def close(self) -> None:
        """Close the data base and release its lock."""
        self.connection.close()


def _packed(values: np.ndarray, kind: str) -> bytes:
    return zlib.compress(values.astype(kind).tobytes(), 3)


def _unpacked(content: bytes, kind: str) -> np.ndarray:
    return np.frombuffer(zlib.decompress(content), kind).astype(float)
