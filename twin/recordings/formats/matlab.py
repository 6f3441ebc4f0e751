"""MATLAB .mat up to version 7 (scipy), 7.3 is HDF5. Vectors by name, fields of a struct as 'struct.field', structs with a label and values by their label."""

from pathlib import Path
from typing import Any

import numpy as np

from twin.limits import most_bytes, refuse_bytes
from twin.recordings.formats import hdf5
from twin.recordings.formats.arrays import REMEDY, arrays_recording, try_first
from twin.recordings.signals import ReadOptions, Recording, head_of

_TRIAL = """
import sys
from scipy.io import loadmat, whosmat
import math
size = 8 * sum(math.prod(shape) for _, shape, _ in whosmat(sys.argv[1]))
print(size)
if size > float(sys.argv[2]):
    sys.exit(0)  # the calling process refuses it
try:
    loadmat(sys.argv[1])
except MemoryError:
    sys.exit(3)
"""


def read(path: Path, options: ReadOptions) -> Recording:
    """Vectors as signals on the map's time column or interval. Single numbers are reported, not imported."""
    if head_of(path).startswith(b"MATLAB 7.3"):
        return hdf5.read(path, options)
    from scipy.io import loadmat

    if (said := try_first(path, "MATLAB", _TRIAL, str(most_bytes()))).isdigit():
        refuse_bytes(int(said), str(path), REMEDY)
    columns: dict[str, np.ndarray] = {}
    lists: list[list[str]] = []
    for name, value in loadmat(path, squeeze_me=False, struct_as_record=True).items():
        if not name.startswith("__"):
            _collect(name, value, columns, lists)
    names: dict[str, list[str]] = {}
    for name, width in ((name, min(values.shape)) for name, values in columns.items() if values.ndim == 2):
        names[name] = next((own for own in lists if len(own) == width > 1), [f"{name}({i + 1})" for i in range(width)])
    return arrays_recording(columns, "MATLAB", path, options, names)


def _collect(name: str, value: Any, columns: dict[str, np.ndarray], lists: list[list[str]]) -> None:
    """Numbers of a variable, and of the fields of a struct, and lists of texts. A sparse matrix is no signal."""
    from scipy.sparse import issparse

    if issparse(value):
        return
    value = np.asarray(value)
    if value.dtype.names:
        for number, row in enumerate(value.ravel(), start=1):
            label = next((text for part in _LABELS if part in value.dtype.names and (text := _plain(row[part]))), "")
            own = label or (name if value.size == 1 else f"{name}({number})")
            for part in value.dtype.names:
                _collect(own if label and part.lower() in _VALUES else f"{own}.{part}", row[part], columns, lists)
    elif value.dtype == object and value.size == 1:
        _collect(name, value.ravel()[0], columns, lists)
    elif value.dtype.kind in "OU" and all(texts := [_plain(one) for one in value.ravel()]):
        lists.append(texts)
    elif np.issubdtype(value.dtype, np.number) and not np.iscomplexobj(value) and value.size:
        columns[name] = value


_LABELS, _VALUES = ("Name", "name", "label"), ("data", "values")
"""Fields of a struct that is one signal, as Simulink and dSPACE save them in an array."""


def _plain(value: Any) -> str:
    """A text in arrays of one element each; "" for anything else."""
    while isinstance(value, np.ndarray) and value.size == 1:
        value = value.ravel()[0]
    return str(value).strip() if isinstance(value, str) else ""
