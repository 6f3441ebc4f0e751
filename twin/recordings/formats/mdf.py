"""MDF4 and MDF3: each channel on the time master of its group, in physical values."""

from __future__ import annotations

from datetime import datetime
import gc
import logging
from pathlib import Path
import sys
from typing import Any

import numpy as np

from twin.documents import reason_of
from twin.errors import InputError
from twin.limits import refuse_bytes
from twin.recordings.signals import ReadOptions, Recording, Signal, known_unit, starts_with


def read(path: Path, options: ReadOptions) -> Recording:
    """Channels by name; a name that occurs in several groups becomes 'name (group 2)'."""
    try:
        from asammdf import MDF
    except ImportError:
        raise InputError(f"{path}: MDF needs the package asammdf; install it with: pip install 'twin[mdf]'") from None
    if not starts_with(path, b"MDF", b"UnFinMF"):
        raise InputError(f"{path}: not an MDF file; give it the ending of its true format")
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)
    signals: dict[str, Signal] = {}
    started: datetime | None = None
    problem = ""
    said, sys.unraisablehook = sys.unraisablehook, lambda _: None  # a partly opened MDF prints errors when it is deleted
    try:
        try:
            with MDF(path) as file:
                started = file.header.start_time
                sizes = [(float(g.channel_group.cycles_nr), g.channel_group.samples_byte_nr + 8.0 * len(g.channels)) for g in file.groups]
                refuse_bytes(sum(rows * width for rows, width in sizes), str(path), "export the recording in parts")
                _collect(file, signals)
        except InputError:
            raise
        except Exception as error:  # the package raises many classes for damaged files
            problem = reason_of(error)
        if problem:
            gc.collect()
    finally:
        sys.unraisablehook = said
    if problem:
        raise InputError(f"{path}: not a readable MDF file ({problem}); export it again")
    return Recording(path, "MDF", signals, started, (f"MDF: {len(signals)} channels",))


def _collect(file: Any, signals: dict[str, Signal]) -> None:
    """Numeric channels of all groups; groups of equal times share them."""
    clocks: dict[bytes, np.ndarray] = {}
    for number in range(len(file.groups)):
        for one in _of_group(file, number):
            if not np.issubdtype(one.samples.dtype, np.number) or one.samples.ndim != 1:
                continue
            name = one.name if one.name not in signals else f"{one.name} (group {number + 1})"
            time = np.asarray(one.timestamps, float)
            time = clocks.setdefault(time.tobytes(), time)
            signals[name] = Signal(name, one.samples.astype(float), time, known_unit(one.unit or ""), one.comment or "")


def _of_group(file: Any, number: int) -> list[Any]:
    """All channels of a group except its master."""
    master = file.masters_db.get(number)
    return [file.get(group=number, index=i) for i in range(len(file.groups[number].channels)) if i != master]
