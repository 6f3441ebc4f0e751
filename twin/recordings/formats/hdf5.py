"""HDF5: what MATLAB 7.3, pandas and h5py write. Every dataset of real numbers is an array of the name of its path, 'run1.axis_X.position'.

An attribute of a dataset, such as `counts_per_revolution`, converts its counts to turns, and `mm_per_rev` beside it to mm. The attributes of groups and file
hold for datasets whose unit is counts.
"""

from pathlib import Path
import re
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.limits import refuse_bytes
from twin.recordings.formats.arrays import REMEDY, arrays_recording, fields_of, try_first
from twin.recordings.signals import ReadOptions, Recording, known_unit
from twin.recordings.table_file import BYTES_PER_NUMBER
from twin.recordings.time_column import interval_of

_OF_MATLAB = "MATLAB_class"
_NAMES = ("columns", "names", "axis0", "{}_items")
"""Where the names of a table's columns stand: an attribute of it, or a dataset beside it. pandas writes 'block0_items' for 'block0_values'."""
_UNITS = ("unit", "units", "unit_string")
"""Attributes of a dataset with its unit."""
_COUNTS_OF_A_TURN = re.compile(
    r"(encoder_)?((counts?|increments?|inc|pulses)_per_(turn|rev|revolution)|cpr|(encoder_)?resolution_counts)", re.IGNORECASE
)
_LEAD_MM = re.compile(r"(screw_|spindle_)?((lead|pitch)_mm(_per_(turn|rev|revolution))?|mm_per_(turn|rev|revolution))", re.IGNORECASE)
_COUNTS = re.compile(r"(counts?|cnts?|inc|increments?|pulses?)", re.IGNORECASE)
_TRIAL = """
import sys, h5py
with h5py.File(sys.argv[1], "r") as file:
    file.visititems(lambda name, item: isinstance(item, h5py.Dataset) and not (item.external or item.is_virtual) and item[()] is None or None)
"""


def read(path: Path, options: ReadOptions) -> Recording:
    """Arrays as signals on the map's time column or interval."""
    import h5py

    try_first(path, "HDF5", _TRIAL)
    arrays: dict[str, np.ndarray] = {}
    names: dict[str, list[str]] = {}
    units: dict[str, str] = {}
    intervals: dict[str, float] = {}
    sizes = []

    def attributes(item: Any, own: str) -> None:
        for key, value in item.attrs.items():
            text = value.decode(errors="replace") if isinstance(value, bytes) else value
            if isinstance(text, str) and key.lower() in _UNITS:
                units[own] = known_unit(text)
            elif np.ndim(value) == 0 and isinstance(value, np.number) and (interval := interval_of(key, float(value))):
                if own in arrays:  # of this dataset alone
                    intervals[own] = interval
                else:
                    arrays[key] = np.asarray(value)

    def scale(item: Any, own: str) -> None:
        """Counts of a dataset to turns or mm."""
        if own not in arrays or units.get(own):
            return
        counted = any(_COUNTS.fullmatch(str(item.attrs.get(key, ""))) for key in _UNITS)
        stated = {
            key: value for holder in (item.file, item.parent, item) if counted or holder is item for key, value in holder.attrs.items()
        }
        numbers = {key: float(value) for key, value in stated.items() if isinstance(value, np.number) and value > 0}
        turn, lead = (next((key for key in reversed(numbers) if what.fullmatch(key)), "") for what in (_COUNTS_OF_A_TURN, _LEAD_MM))
        if turn:
            arrays[own] = arrays[own] * (numbers.get(lead, 1.0) / numbers[turn])
            units[own] = "mm" if lead else "rev"
            arrays.update({f"{own}.{key}": np.asarray(numbers[key]) for key in (turn, lead) if key})

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#") or not (item.dtype.names or item.dtype.kind in "iufb"):
            return
        if item.external or item.is_virtual:
            raise InputError(f"{path}: '{name}' is in another file, which is not opened; save it as one file")
        sizes.append(float(item.size * max(item.dtype.itemsize, BYTES_PER_NUMBER)))
        refuse_bytes(sum(sizes), str(path), REMEDY)
        if item.attrs.get(_OF_MATLAB) in (b"char", b"cell"):
            return
        # MATLAB stores a table by columns
        values = np.asarray(item).T if _OF_MATLAB in item.attrs else np.asarray(item)
        own = name.replace("/", ".")
        arrays.update(fields_of(own, values))
        attributes(item, own)
        scale(item, own)
        if heads := _heads(item):
            names[own] = heads

    with h5py.File(path, "r") as file:
        attributes(file, "")
        file.visititems(visit)
    return arrays_recording(arrays, "HDF5", path, options, names, units, intervals)


def _heads(item: Any) -> list[str]:
    """Names of the columns of a table, from its attributes or the dataset beside it; [] if there are none."""
    beside, own = item.parent, item.name.rsplit("/", 1)[-1].removesuffix("_values")
    for key in (name.format(own) for name in _NAMES):
        found = item.attrs[key] if key in item.attrs else beside[key][()] if key in beside and hasattr(beside[key], "shape") else ()
        texts = [cell.decode(errors="replace") if isinstance(cell, bytes) else cell for cell in np.ravel(found)]
        if len(texts) in item.shape and all(isinstance(text, str) for text in texts):
            return texts
    return []
