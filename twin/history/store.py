"""A history in a file, one row a campaign; it belongs to one machine with its directions.

    campaign (name, digest, content)  digest: of the recording's files; content: day, program, noise, and `twin.history.projection` of each group

Everything else (sizes, changes, alarms) follows from these rows and is computed anew each time.
"""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
import zlib

import msgspec
import numpy as np

from twin.history.projection import Noise, Projection
from twin.study.row_file import RowFile

FILE = "history.sqlite"

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


class Store(RowFile):
    """The history of one machine in a folder; only one command at a time can open it."""

    def __init__(self, folder: Path, reference: str) -> None:
        """`reference` identifies machine and directions. Raises InputError if the folder holds the history of another one."""
        columns = "name TEXT PRIMARY KEY, digest TEXT UNIQUE, content BLOB"
        super().__init__(folder, FILE, "campaign", columns, reference, "the history of another machine file or of another version of twin")

    def put(self, row: Row) -> None:
        """Commit one campaign, in place of an earlier one of this name."""
        groups = [(axes, p.gram.astype("<f4").tobytes(), p.right.astype("<f8").tobytes()) for axes, p in row.projections.items()]
        content = zlib.compress(msgspec.msgpack.encode((row.day, row.program, row.noise, groups)), 3)
        self.insert((row.name, row.digest, content), instead=True)

    def rows(self) -> list[Row]:
        """All campaigns in the order of their judgement."""
        found = []
        for name, digest, content in self.select("name, digest, content"):
            with self.in_one_line():
                day, program, noise, groups = _CONTENT.decode(zlib.decompress(content))
                projections = {}
                for axes, gram, right in groups:
                    b = np.frombuffer(right, "<f8")
                    projections[axes] = Projection(np.frombuffer(gram, "<f4").astype(float).reshape(len(b), -1), b)
                found.append(Row(digest, name, day, program, noise, projections))
        return found
