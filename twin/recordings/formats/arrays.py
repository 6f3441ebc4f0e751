"""Arrays of numbers by name as signals, and the files of numpy that hold them: .npy (one array) and .npz (several).

A vector is a signal. A table has one signal a column, `name[0]`, or by the names of its columns. A record array has one signal a field. A single
number may be the interval of the samples: `Ts = 0.001`, `sample_rate_hz = 1000`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
import zipfile

import numpy as np

from twin.errors import InputError
from twin.limits import most_bytes, refuse_bytes
from twin.recordings.signals import ReadOptions, Recording
from twin.recordings.table_file import BYTES_PER_NUMBER
from twin.recordings.time_column import interval_of, share_time
from twin.system import tried

REMEDY = "save fewer signals, or in parts"
TRIAL_BYTES, TRIAL_S = 2_000_000_000, 60
"""Address space, before it reads, and processor time of the process that tries a file."""


def read(path: Path, options: ReadOptions) -> Recording:
    """The arrays of a .npy or .npz file. Objects are not read: that would run code of the file."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            refuse_bytes(float(sum(one.file_size for one in archive.infolist())), str(path), REMEDY)
        with np.load(path, allow_pickle=False) as opened:
            arrays = {name: opened[name] for name in opened.files}
    else:
        refuse_bytes(float(path.stat().st_size), str(path), REMEDY)
        arrays = {"": np.load(path, mmap_mode="r", allow_pickle=False)}  # a map refuses a size that the file has not
    refuse_bytes(float(BYTES_PER_NUMBER * sum(array.size for array in arrays.values())), str(path), REMEDY)
    fields = {name: part for key, array in arrays.items() for name, part in fields_of(key, array).items()}
    return arrays_recording(fields, "numpy", path, options)


def fields_of(name: str, array: np.ndarray) -> dict[str, np.ndarray]:
    """An array of real numbers under its name, a record array as 'name.field'; none of another kind or without a number."""
    if array.dtype.names:
        parts = [fields_of(f"{name}.{field}".lstrip("."), array[field]) for field in array.dtype.names]
        return {part: values for own in parts for part, values in own.items()}
    return {name: array} if array.dtype.kind in "iufb" and array.size else {}


def arrays_recording(
    arrays: Mapping[str, np.ndarray],
    kind: str,
    path: Path,
    options: ReadOptions,
    names: Mapping[str, Sequence[str]] | None = None,
    units: Mapping[str, str] | None = None,
    intervals: Mapping[str, float] | None = None,
) -> Recording:
    """Vectors and the columns of tables as signals on the map's time column or interval. Single numbers are reported, not imported.

    Args:
        arrays: by name; more than two dimensions are left out
        kind: format, for the notes
        names: names of the columns of a table, if the file has them; else name[0], name[1], ...
        units: units of vectors, if the file has them
        intervals: intervals of the samples of vectors [s], if each has its own

    Raises:
        InputError: no array, or its length differs from that of the time
    """
    if not arrays:
        raise InputError(f"{path}: holds no vector of numbers; save the signals as vectors")
    vectors: dict[str, tuple[np.ndarray, str]] = {}
    tables = [one for one in arrays.values() if one.ndim == 2 and one.shape[0] > one.shape[1] > 1]
    if len(tables) > 1 and np.all(np.diff(tables[0][:, 0]) > 0.0) and all(np.array_equal(one[:, 0], tables[0][:, 0]) for one in tables):
        # each table has the time in its first column, as Simulink saves signals
        vectors["time"] = tables[0][:, 0].astype(float), ""
        arrays = {name: one[:, 1:] if one.ndim == 2 and one.shape[0] > one.shape[1] > 1 else one for name, one in arrays.items()}
    for name, values in arrays.items():
        if values.ndim == 2 and min(values.shape) > 1:
            table = values if values.shape[0] >= values.shape[1] else values.T
            own = (names or {}).get(name, ())
            heads = own if len(own) == table.shape[1] else [f"{name}[{i}]" for i in range(table.shape[1])]
            vectors |= {head: (table[:, i].astype(float), "") for i, head in enumerate(heads)}
        elif values.ndim <= 2 and values.size > 1:
            vectors[name] = (values.ravel().astype(float), (units or {}).get(name, ""))
    single = {name: float(values.ravel()[0]) for name, values in arrays.items() if values.size == 1}
    stated = next((found for name, value in single.items() if (found := interval_of(name, value))), None)
    each = {name: step for name, step in (intervals or {}).items() if name in vectors}
    signals, source, restarts = share_time(vectors, options.clock, str(path), stated or next(iter(each.values()), None), each)
    numbers = [f"{name} = {value:g}" for name, value in single.items()]
    note = f"{kind}: {', '.join([f'{len(vectors)} vectors', *numbers])}"
    notes = (note, source.text) if source.known and not source.column else (note,)
    return Recording(path, kind, signals, None, notes, restarts=restarts, source=source)


def try_first(path: Path, kind: str, code: str, *arguments: str) -> str:
    """What Python code that reads a file prints in a process of its own: a damaged file can crash its library, fill the memory (code 3) or never end.

    An error that Python sees is none here: it is reported where the file is read.
    """
    trial = tried(code, str(path), *arguments, most_bytes=TRIAL_BYTES + 2 * most_bytes(), seconds=TRIAL_S)
    problem = "does not end" if trial is None else {0: "", 1: "", 3: "fills the memory"}.get(trial.returncode, "crashes")
    if problem or trial is None:
        raise InputError(f"{path}: a damaged {kind} file (reading it {problem}); save it again")
    return trial.stdout.decode().strip()
