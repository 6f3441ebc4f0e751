"""MATLAB .mat up to version 7 (scipy), 7.3 is HDF5. Vectors by name, fields of a struct as 'struct.field', structs with a label and values by their label."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.limits import most_bytes, refuse_bytes
from twin.recordings.formats import hdf5
from twin.recordings.formats.arrays import REMEDY, arrays_recording
from twin.recordings.signals import ReadOptions, Recording, head_of
from twin.system import tried

LOADED_BYTES = 2_000_000_000
"""Address space of the process that tries a file, before it reads it [bytes]."""
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
    columns: dict[str, np.ndarray] = {}
    _older(path, columns)
    names = {name: [f"{name}({i + 1})" for i in range(min(values.shape))] for name, values in columns.items() if values.ndim == 2}
    return arrays_recording(columns, "MATLAB", path, options, names)


def _older(path: Path, columns: dict[str, np.ndarray]) -> None:
    from scipy.io import loadmat

    # a damaged file can crash the library, so it is first read in a process of its own
    trial = tried(_TRIAL, str(path), str(most_bytes()), most_bytes=LOADED_BYTES + 2 * most_bytes(), seconds=60)
    if trial is not None and (said := trial.stdout.strip()).isdigit():
        refuse_bytes(int(said), str(path), REMEDY)
    problem = "does not end" if trial is None else {0: "", 1: "", 3: "fills the memory"}.get(trial.returncode, "crashes")
    if problem:
        raise InputError(f"{path}: a damaged MATLAB file (reading it {problem}); save it again")
    for name, value in loadmat(path, squeeze_me=False, struct_as_record=True).items():
        if not name.startswith("__"):
            _collect(name, value, columns)


def _collect(name: str, value: Any, columns: dict[str, np.ndarray]) -> None:
    """Numbers of a variable, and of the fields of a struct. A sparse matrix is no signal."""
    from scipy.sparse import issparse

    if issparse(value):
        return
    value = np.asarray(value)
    if value.dtype.names:
        for number, row in enumerate(value.ravel(), start=1):
            label = next((text for part in _LABELS if (text := _text(row, part))), "")
            own = label or (name if value.size == 1 else f"{name}({number})")
            for part in value.dtype.names:
                _collect(own if label and part.lower() in _VALUES else f"{own}.{part}", row[part], columns)
    elif value.dtype == object and value.size == 1:
        _collect(name, value.ravel()[0], columns)
    elif np.issubdtype(value.dtype, np.number) and not np.iscomplexobj(value) and value.size:
        columns[name] = value


_LABELS, _VALUES = ("Name", "name", "label"), ("data", "values")
"""Fields of a struct that is one signal, as Simulink and dSPACE save them in an array."""


def _text(row: Any, part: str) -> str:
    """Text of a field of a struct; "" if there is none."""
    value = row[part] if part in row.dtype.names else ""
    while isinstance(value, np.ndarray) and value.size == 1:
        value = value.ravel()[0]
    return str(value) if isinstance(value, str) else ""
