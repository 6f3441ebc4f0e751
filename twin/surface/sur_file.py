"""Height maps of Digital Surf (`.sur`, MountainsMap and many profilometers): a header of 512 bytes, then the heights as integers.

    height = number * z increment + z offset          in the unit of the header; row after row along x
    not measured: the header's smallest number minus 2, if the header announces such points

Layout from the open readers Gwyddion (`modules/file/surffile.c`) and digitalsurf of RosettaSciIO. Little-endian. Packed files
("DSCOMPRESSED") and files with several surfaces are refused.
"""

from __future__ import annotations

from pathlib import Path
import struct
from typing import NamedTuple

import numpy as np

from twin.errors import InputError

SIGNATURE = b"DIGITAL SURF"
HEAD_BYTES = 512
METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "\u00b5m": 1e-6, "\u03bcm": 1e-6, "nm": 1e-9, "pm": 1e-12}
PLACES = {
    "objects": ("<h", 14),
    "special_points": ("<h", 86),
    "bits": ("<h", 98),
    "least": ("<i", 100),
    "columns": ("<i", 108),
    "rows": ("<i", 112),
    "dx": ("<f", 120),
    "dy": ("<f", 124),
    "dz": ("<f", 128),
    "comment_bytes": ("<H", 334),
    "private_bytes": ("<H", 336),
    "z_offset": ("<f", 474),
}
"""Format and offset of the header's numbers."""
UNITS_AT = {"x": 180, "y": 196, "z": 212}
"""Offsets of the units of the increments, 16 bytes each."""


class SurMap(NamedTuple):
    """Increments along x and y [m] and heights (row, column) [m]; NaN: not measured."""

    dx: float
    dy: float
    height: np.ndarray


def read_sur(path: Path) -> SurMap:
    """The surface of a `.sur` file; raises InputError if it cannot be read."""
    raw = path.read_bytes()
    if raw[:12] != SIGNATURE or len(raw) < HEAD_BYTES:
        packed = raw[:12] == b"DSCOMPRESSED"
        raise InputError(f"{path}: {'a packed SUR file' if packed else 'not a SUR file'}; save it as uncompressed SUR or as X3P")
    head = {name: struct.unpack_from(kind, raw, at)[0] for name, (kind, at) in PLACES.items()}
    if head["objects"] != 1 or head["bits"] not in (16, 32):
        raise InputError(f"{path}: {head['objects']} objects of {head['bits']} bits; save one surface of 16 or 32 bits")
    factor = {axis: _metres(raw[at : at + 16], axis, path) for axis, at in UNITS_AT.items()}
    columns, rows = head["columns"], head["rows"]
    start, width = HEAD_BYTES + head["comment_bytes"] + head["private_bytes"], head["bits"] // 8
    if columns < 1 or rows < 1 or len(raw) < start + columns * rows * width:
        raise InputError(f"{path}: the file ends before its {columns} x {rows} points; export it again")
    numbers = np.frombuffer(raw, f"<i{width}", columns * rows, start).reshape(rows, columns)
    height = (numbers * float(head["dz"]) + head["z_offset"]) * factor["z"]
    if head["special_points"]:
        height[numbers == head["least"] - 2] = np.nan
    return SurMap(head["dx"] * factor["x"], head["dy"] * factor["y"], height)


def _metres(field: bytes, axis: str, path: Path) -> float:
    """Factor of a unit to metres."""
    unit = field.split(b"\0")[0].decode("latin-1").strip()
    if unit not in METRES:
        raise InputError(f"{path}: the unit of {axis} is '{unit}'; save the map with one of {', '.join(list(METRES)[:3])}, nm")
    return METRES[unit]
