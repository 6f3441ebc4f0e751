"""Read a recording of the viewer back: the values of each entity and their times."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.replay.names import TIMELINE
from twin.replay.source import check_recording


@dataclass(frozen=True)
class Rows:
    """One component of an entity: times (row,) [s], empty if it is static, and the values of each row."""

    time: np.ndarray
    values: list[list]

    @property
    def array(self) -> np.ndarray:
        """The first value of each row, (row,) or (row, size)."""
        return np.array([row[0] for row in self.values])


def read_recording(path: str | Path) -> dict[str, dict[str, Rows]]:
    """Entity path -> component ('Scalars:scalars', 'Transform3D:translation', ...) -> rows by time."""
    return _read(path, blueprint=False)


def read_layout(path: str | Path) -> dict[str, dict[str, Rows]]:
    """The same for the layout stored in the recording."""
    return _read(path, blueprint=True)


def timelines(path: str | Path) -> set[str]:
    """Names of all timelines."""
    return {name for chunk in _chunks(path, False) for name in chunk.to_record_batch().schema.names if _is_timeline(chunk, name)}


def _read(path: str | Path, blueprint: bool) -> dict[str, dict[str, Rows]]:
    found: dict[str, dict[str, Rows]] = {}
    for chunk in _chunks(path, blueprint):
        batch = chunk.to_record_batch()
        time = np.zeros(0)
        if not chunk.is_static and TIMELINE in batch.schema.names:
            time = batch.column(TIMELINE).cast("int64").to_numpy(zero_copy_only=False) * 1e-9
        for name in batch.schema.names:
            if ":" in name:
                before = found.setdefault(chunk.entity_path, {}).get(name, Rows(np.zeros(0), []))
                times, values = np.r_[before.time, time], before.values + batch.column(name).to_pylist()
                order = np.argsort(times, kind="stable") if len(times) == len(values) else range(len(values))
                found[chunk.entity_path][name] = Rows(np.sort(times), [values[i] for i in order])
    return found


def _chunks(path: str | Path, blueprint: bool) -> list:
    from rerun.chunk import RrdReader

    reader = RrdReader(check_recording(path))
    stores = reader.blueprints() if blueprint else reader.recordings()
    return [chunk for store in stores for chunk in reader.stream(store=store).to_chunks()]


def _is_timeline(chunk: Any, name: str) -> bool:
    return not chunk.is_static and ":" not in name and not name.startswith("rerun.")
