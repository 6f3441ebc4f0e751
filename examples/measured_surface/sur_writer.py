"""Writes height maps of Digital Surf (`.sur`), the inverse of the reader in `twin.surface.measured`."""

from __future__ import annotations

from pathlib import Path
import struct

import numpy as np

from twin.files import beside
from twin.surface.measured import HEAD_BYTES, PLACES, SIGNATURE, UNITS_AT


def write_sur(path: Path, dx: float, dy: float, height: np.ndarray) -> None:
    """Write heights (row, column) [m] with increments dx, dy [m] as 32-bit integers of 0.1 nm; NaN: not measured."""
    step = 1e-10
    known = np.isfinite(height)
    numbers = np.round(np.where(known, height, 0.0) / step).astype(np.int64)
    least = int(numbers[known].min())
    numbers[~known] = least - 2
    head = bytearray(HEAD_BYTES)
    head[:12] = SIGNATURE
    values = {
        "objects": 1,
        "special_points": int(not known.all()),
        "bits": 32,
        "least": least,
        "columns": height.shape[1],
        "rows": height.shape[0],
        "dx": dx * 1e3,
        "dy": dy * 1e3,
        "dz": step * 1e6,
    }
    for name, value in values.items():
        struct.pack_into(PLACES[name][0], head, PLACES[name][1], value)
    struct.pack_into("<hhii", head, 16, 1, 2, 0, 0)  # version, kind: a surface
    struct.pack_into("<i", head, 104, int(numbers.max()))
    struct.pack_into("<i", head, 116, height.size)
    for axis, unit in (("x", b"mm"), ("y", b"mm"), ("z", b"um")):
        head[UNITS_AT[axis] : UNITS_AT[axis] + 16] = unit.ljust(16)
    with beside(path) as partial:
        partial.write_bytes(bytes(head) + numbers.astype("<i4").tobytes())
