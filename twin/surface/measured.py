"""Measured height maps: read from NPZ, CSV, SUR or X3P, registered to a simulated cut, and compared with it.

A map is a grid of heights over u and v, the coordinates of the simulated map up to a shift and a tilt. Registration finds the shift with
the best correlation, up to half a map, and removes the least-squares plane. Lengths in m; NaN: not measured.
"""

from dataclasses import dataclass
from pathlib import Path
import struct
from typing import Any
import zipfile

import numpy as np
import scipy

from twin.documents import reading
from twin.errors import InputError, nearest
from twin.limits import refuse_above
from twin.recordings.table_file import read_table

MOST_BYTES = 500_000_000
"""Most bytes of an unpacked height map."""
ENDINGS = (".npz", ".csv", ".sur", ".x3p")
LEAST_OVERLAP = 0.25
"""Least covered share of the simulated map."""
LARGEST = 10.0
"""Limit of coordinates and heights [m]: nothing that a machine cuts is larger."""

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


@dataclass(frozen=True)
class HeightMap:
    """Heights (row, column) [m] over `u` (column,) and `v` (row,) [m], both increasing and equidistant."""

    u: np.ndarray
    v: np.ndarray
    height: np.ndarray


@dataclass(frozen=True)
class Comparison:
    """A levelled measured map on the simulated grid (row, column) [m]; the removed shift (u, v) [m]; RMS of the difference [m]."""

    measured: np.ndarray
    shift: tuple[float, float]
    rms: float

    def depth(self, simulated: np.ndarray) -> tuple[float, float]:
        """Depth of the deepest point below the mean [m], simulated and measured, over the points known in both."""
        both = np.isfinite(self.measured)
        return tuple(float(z[both].mean() - z[both].min()) for z in (simulated, self.measured))  # type: ignore[return-value]


def read_height_map(path: Path) -> HeightMap:
    """Read a height map; every error is an InputError."""
    if not path.is_file():
        raise InputError(f"{path}: no such height map; give one of {', '.join(ENDINGS)}")
    readers = {".npz": _npz, ".csv": _csv, ".sur": _sur, ".x3p": _x3p}
    if path.suffix.lower() not in readers:
        raise InputError(f"{path}: not a height map that can be read; {nearest(path.suffix.lower(), ENDINGS)}")
    with reading(path, "height map"):
        found = readers[path.suffix.lower()](path)
    if found.height.shape != (len(found.v), len(found.u)) or min(found.height.shape) < 8:
        raise InputError(f"{path}: a map of {found.height.shape[0]} x {found.height.shape[1]} points; give at least 8 x 8")
    known = np.isfinite(found.height)
    if not known.any():
        raise InputError(f"{path}: the map holds no measured point; export it again")
    for what, values in (("u", found.u), ("v", found.v), ("heights", found.height[known])):
        if not np.abs(values).max() < LARGEST:
            raise InputError(f"{path}: {what} up to {np.abs(values).max():.3g} m, the limit is {LARGEST:g} m; check the unit of the map")
    if not ((np.diff(found.u) > 0.0).all() and (np.diff(found.v) > 0.0).all()):
        raise InputError(f"{path}: u or v does not increase from point to point; export the map again")
    return found


def compare(measured: HeightMap, simulated: HeightMap) -> Comparison:
    """Register the measured map on the simulated grid by shift and plane. Raises InputError if they hardly overlap."""
    mean = float(np.nanmean(measured.height))
    # there is no common origin: start with coinciding centres
    start = np.array([simulated.v.mean() - measured.v.mean(), simulated.u.mean() - measured.u.mean()])
    read = scipy.interpolate.RegularGridInterpolator(
        (measured.v, measured.u), measured.height - mean, bounds_error=False, fill_value=np.nan
    )
    grid = np.stack(np.meshgrid(simulated.v, simulated.u, indexing="ij"), axis=-1)
    first = read(grid - start)
    step = np.array([np.diff(simulated.v).mean(), np.diff(simulated.u).mean()])
    # the shift in rows and columns of largest correlation
    found = scipy.signal.correlate(_levelled(simulated.height, grid), _levelled(first, grid), mode="same", method="fft")
    best = np.array(np.unravel_index(int(np.argmax(found)), found.shape)) - np.array(found.shape) // 2
    shift = start + best * step
    shift = _refined(read, grid, simulated.height, shift, step)
    on_grid = read(grid - shift)
    overlap = float(np.isfinite(on_grid).mean())
    if overlap < LEAST_OVERLAP:
        raise InputError(f"measured map: covers {overlap:.0%} of the simulated one; measure the same zone, or check the unit")
    both = np.isfinite(on_grid)
    difference = _levelled(on_grid - simulated.height, grid)
    levelled = np.where(both, simulated.height + difference, np.nan)
    return Comparison(levelled, (float(shift[1]), float(shift[0])), float(np.sqrt(np.mean(difference[both] ** 2))))


def _refined(read: Any, grid: np.ndarray, height: np.ndarray, shift: np.ndarray, step: np.ndarray) -> np.ndarray:
    """The shift of least RMS near the given one, to a fraction of a sample."""
    thin = tuple(slice(None, None, max(1, n // 200)) for n in height.shape)
    places, heights = grid[thin], height[thin]

    def rms(samples: np.ndarray) -> float:
        difference = read(places - shift - samples * step) - heights
        known = np.isfinite(difference)
        return float(np.std(_levelled(difference, places)[known])) if known.mean() > LEAST_OVERLAP else LARGEST

    simplex = np.array([[0.0, 0.0], [1.5, 0.0], [0.0, 1.5]])
    least = scipy.optimize.minimize(rms, [0.0, 0.0], method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 0.02})
    return shift + step * least.x


def _levelled(height: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Heights minus their least-squares plane; 0 at unknown points."""
    known = np.isfinite(height)
    if not known.any():
        return np.zeros_like(height)
    plane = np.column_stack([np.ones(known.sum()), grid[known]])
    weight = np.linalg.lstsq(plane, height[known], rcond=None)[0]
    return np.where(known, height - weight[0] - grid @ weight[1:], 0.0)


def _npz(path: Path) -> HeightMap:
    with zipfile.ZipFile(path) as archive:
        _check_unpacked(archive, path)
    with np.load(path) as stored:
        for name in ("u", "v", "height"):
            if name not in stored:
                raise InputError(f"{path}: has no '{name}'; store u, v [m] and height (row, column) [m] as twin cut does")
        return HeightMap(np.asarray(stored["u"], float), np.asarray(stored["v"], float), np.asarray(stored["height"], float))


def _csv(path: Path) -> HeightMap:
    table = read_table(path)
    needed = ("u [mm]", "v [mm]", "deviation [um]")
    for name in needed:
        if name not in table:
            raise InputError(f"{path}: no column '{name}'; write {', '.join(needed)}, one point per line")
    u, v, z = (table[name] for name in needed)
    columns, rows = np.unique(np.round(u, 6)), np.unique(np.round(v, 6))
    height = np.full((len(rows), len(columns)), np.nan)
    height[np.searchsorted(rows, np.round(v, 6)), np.searchsorted(columns, np.round(u, 6))] = z * 1e-6
    return HeightMap(columns * 1e-3, rows * 1e-3, height)


def _sur(path: Path) -> HeightMap:
    """A `.sur` file of Digital Surf (MountainsMap and many profilometers): a header of 512 bytes, then the heights as integers, row after row along x.

        height = number * z increment + z offset          in the unit of the header
        not measured: the header's smallest number minus 2, if the header announces such points

    Layout from the open readers Gwyddion (`modules/file/surffile.c`) and digitalsurf of RosettaSciIO. Little-endian. Packed files
    ("DSCOMPRESSED") and files with several surfaces are refused.
    """
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
    return HeightMap(head["dx"] * factor["x"] * np.arange(columns), head["dy"] * factor["y"] * np.arange(rows), height)


def _metres(field: bytes, axis: str, path: Path) -> float:
    """Factor of a unit to metres."""
    unit = field.split(b"\0")[0].decode("latin-1").strip()
    if unit not in METRES:
        raise InputError(f"{path}: the unit of {axis} is '{unit}'; save the map with one of {', '.join(list(METRES)[:3])}, nm")
    return METRES[unit]


def _x3p(path: Path) -> HeightMap:
    """ISO 25178-72: main.xml with axes and sizes, heights as a binary matrix in rows along x."""
    from defusedxml import ElementTree

    with zipfile.ZipFile(path) as archive:
        _check_unpacked(archive, path)
        root = ElementTree.fromstring(archive.read("main.xml"))
        columns, rows = (int(_text(root, f"MatrixDimension/{name}")) for name in ("SizeX", "SizeY"))
        kinds = {"D": "<f8", "F": "<f4", "L": "<i4", "I": "<i2"}
        raw = np.frombuffer(archive.read(_text(root, "PointDataLink")), kinds[_text(root, "CZ/DataType")])
    height = raw[: columns * rows].reshape(rows, columns).astype(float)
    if raw.dtype.kind == "i" and root.find(".//CZ/Increment") is not None:
        height = height * float(_text(root, "CZ/Increment"))
    du, dv = (float(_text(root, f"{name}/Increment")) for name in ("CX", "CY"))
    return HeightMap(du * np.arange(columns), dv * np.arange(rows), height)


def _check_unpacked(archive: zipfile.ZipFile, path: Path) -> None:
    """Refuse an archive whose content would fill the memory."""
    refuse_above(sum(file.file_size for file in archive.infolist()), MOST_BYTES, "bytes unpacked", str(path), "measure a smaller area")


def _text(root: Any, path: str) -> str:
    found = str(root.findtext(f".//{path}") or "").strip()
    if not found:
        raise InputError(f"x3p: main.xml has no {path}; export the map again")
    return found
