"""Results in a SQLite file: rows that are committed as they arrive, so that a command that is killed at any time loses none and counts none twice.

owner (name)        what the rows belong to, such as a digest of all that they depend on; rows of another owner are never mixed in
and the table of the rows
"""

from collections.abc import Iterator
import contextlib
from pathlib import Path
import sqlite3
from typing import Any
import zlib

from twin.errors import InputError
from twin.files import output_file, output_folder


class RowFile:
    """A table of rows in one file of an output folder. Only one command at a time can open it."""

    def __init__(self, folder: Path, file: str, table: str, columns: str, owner: str, other: str) -> None:
        """Open the file, or create it with a `table` of `columns`. Raises InputError for a file in use, or of another owner: `other` says what it holds."""
        self.path = output_file(output_folder(folder) / file)  # no link, which the library would follow
        self.table = table
        with self.in_one_line():
            self.connection = sqlite3.connect(self.path, timeout=0.2, isolation_level=None)
        try:
            with self.in_one_line():
                self.connection.execute("PRAGMA locking_mode = EXCLUSIVE")  # until it is closed
                self.connection.execute("BEGIN IMMEDIATE")
                self.connection.execute("CREATE TABLE IF NOT EXISTS owner (name TEXT)")
                self.connection.execute(f"CREATE TABLE IF NOT EXISTS {table} ({columns})")
                known = self.connection.execute("SELECT name FROM owner").fetchone()
                if known is None and not self.select("count(*)")[0][0]:
                    self.connection.execute("INSERT INTO owner VALUES (?)", (known := (owner,)))
                self.connection.execute("COMMIT")
            if known != (owner,):
                raise InputError(f"{self.path}: {other}; give another --out")
        except BaseException:
            self.connection.close()
            raise

    @contextlib.contextmanager
    def in_one_line(self) -> Iterator[None]:
        """Context: an error of the file becomes a message of one line."""
        try:
            yield
        except sqlite3.IntegrityError:  # the same row twice is a defect of the caller
            raise
        except (sqlite3.DatabaseError, zlib.error, ValueError, TypeError) as error:  # the message of a damaged file may not be text
            what = (
                "another twin command is writing here; wait for it" if "locked" in str(error) else f"cannot be used ({error}); move it away"
            )
            raise InputError(f"{self.path}: {what} or give another --out") from None

    def select(self, columns: str, order: str = "rowid") -> list[tuple[Any, ...]]:
        """These columns of all rows."""
        with self.in_one_line():
            return self.connection.execute(f"SELECT {columns} FROM {self.table} ORDER BY {order}").fetchall()

    def insert(self, row: tuple[Any, ...], instead: bool = False) -> None:
        """Commit a row; `instead` of one with the same key, which is refused otherwise."""
        with self.in_one_line():
            self.connection.execute(f"INSERT {'OR REPLACE ' * instead}INTO {self.table} VALUES ({', '.join('?' * len(row))})", row)

    def close(self) -> None:
        """Close the file and release its lock."""
        self.connection.close()
