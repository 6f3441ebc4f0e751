"""MDF4 and MDF3: each channel on the time master of its group, in physical values."""

from datetime import datetime
import gc
import logging
from pathlib import Path
import sys

import numpy as np

from twin.errors import InputError
from twin.limits import refuse_bytes
from twin.recordings.signals import ReadOptions, Recording, Signal, known_unit


def read(path: Path, options: ReadOptions) -> Recording:
    """Channels by name; a name that occurs in several groups becomes 'name (group 2)'."""
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)
    signals: dict[str, Signal] = {}
    said, sys.unraisablehook = sys.unraisablehook, lambda _: None  # a partly opened MDF prints errors when it is deleted
    damaged, started = False, None
    try:
        started = _channels(path, signals)
    except InputError:
        raise
    except Exception:  # the package raises many classes for damaged files
        damaged = True
    finally:
        gc.collect()
        sys.unraisablehook = said
    if damaged:
        raise InputError(f"{path}: not a readable MDF file; it is damaged or cut off: export it again")
    return Recording(path, "MDF", signals, started, (f"MDF: {len(signals)} channels",))


def _channels(path: Path, signals: dict[str, Signal]) -> datetime | None:
    """Add the numeric channels of all groups, without their masters, and return the start time. Groups of equal times share them."""
    from asammdf import MDF

    clocks: dict[bytes, np.ndarray] = {}
    with MDF(path) as file:
        sizes = [(float(g.channel_group.cycles_nr), g.channel_group.samples_byte_nr + 8.0 * len(g.channels)) for g in file.groups]
        refuse_bytes(sum(rows * width for rows, width in sizes), str(path), "export the recording in parts")
        for number, channels in enumerate(g.channels for g in file.groups):
            for index in range(len(channels)):
                if index == file.masters_db.get(number):
                    continue
                one = file.get(group=number, index=index)
                if np.issubdtype(one.samples.dtype, np.number) and one.samples.ndim == 1:
                    name = one.name if one.name not in signals else f"{one.name} (group {number + 1})"
                    time = np.asarray(one.timestamps, float)
                    time = clocks.setdefault(time.tobytes(), time)
                    signals[name] = Signal(name, one.samples.astype(float), time, known_unit(one.unit or ""), one.comment or "")
        return file.header.start_time
