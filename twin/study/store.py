"""Results of a study in SQLite: one row a variant, committed as it arrives, so that a killed study loses nothing that was done."""

from __future__ import annotations

from collections.abc import Sequence
import json
from pathlib import Path
import sqlite3
from typing import Any

from twin.errors import InputError

FILE = "study.sqlite"


class Store:
    """The results in one folder; held by one study at a time."""

    def __init__(self, folder: Path, fingerprint: str, resume: bool):
        self.path = folder / FILE
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self.connection = sqlite3.connect(self.path, timeout=0.2, isolation_level=None)
            self.connection.execute("PRAGMA locking_mode = EXCLUSIVE")
            self.connection.execute("BEGIN IMMEDIATE")
            self.connection.execute("CREATE TABLE IF NOT EXISTS study (fingerprint TEXT)")
            self.connection.execute(
                "CREATE TABLE IF NOT EXISTS variant (number INTEGER PRIMARY KEY, factors TEXT, responses TEXT, reason TEXT)"
            )
            known = [row[0] for row in self.connection.execute("SELECT fingerprint FROM study")]
            if not known:
                self.connection.execute("INSERT INTO study VALUES (?)", (fingerprint,))
            self.connection.execute("COMMIT")
        except sqlite3.OperationalError as error:
            if "locked" in str(error):
                raise InputError(f"{self.path}: another study writes here; give another --out or wait for it") from None
            raise InputError(f"{self.path}: cannot be used ({error}); give another --out") from None
        except sqlite3.DatabaseError as error:
            raise InputError(f"{self.path}: not a database of a study ({error}); move it away or give another --out") from None
        except OSError as error:
            raise InputError(f"{folder}: cannot make this folder ({error.strerror}); give another --out") from None
        if known and known[0] != fingerprint:
            raise InputError(f"{self.path}: holds another study (factors, runs, machine or design differ); give another --out")
        if self.done() and not resume:
            raise InputError(f"{self.path}: {len(self.done())} variants are done already; add --resume or give another --out")

    def done(self) -> set[int]:
        """Numbers of the variants that have a row."""
        return {row[0] for row in self.connection.execute("SELECT number FROM variant")}

    def put(self, number: int, factors: Sequence[float], result: dict[str, Any]) -> None:
        """Commit one variant; a number that is there already is an error of the caller."""
        reason = result.get("reason")
        responses = json.dumps({} if reason else result)
        self.connection.execute("INSERT INTO variant VALUES (?, ?, ?, ?)", (number, json.dumps(list(factors)), responses, reason))

    def rows(self) -> list[tuple[int, list[float], dict[str, float], str | None]]:
        """(number, factors, responses, reason) in the order of the design."""
        found = self.connection.execute("SELECT number, factors, responses, reason FROM variant ORDER BY number")
        return [(n, json.loads(f), json.loads(r), reason) for n, f, r, reason in found]

    def close(self) -> None:
        """Let others write here."""
        self.connection.close()
