"""TDMS (LabVIEW, DAQ systems): each channel with its own waveform start and increment, else a time channel from the map."""

from datetime import datetime
import logging
from pathlib import Path

import numpy as np

from twin.errors import InputError
from twin.limits import refuse_bytes
from twin.recordings.signals import ReadOptions, Recording, Signal, TimeSource, known_unit
from twin.recordings.time_column import share_time


def read(path: Path, options: ReadOptions) -> Recording:
    """Channels as 'group/channel'."""
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    log_manager.set_level(logging.CRITICAL)  # its warnings are reported below
    with TdmsFile.open(path) as file:
        if file.file_status.incomplete_final_segment:
            raise InputError(f"{path}: the TDMS file is cut off in its last segment; export it again")
        channels = [c for group in file.groups() for c in group.channels()]
        refuse_bytes(sum(8.0 * len(c) for c in channels), str(path), "export the recording in parts")
        raw = [(c, f"{c.group_name}/{c.name}", np.asarray(c[:]).astype(float)) for c in channels if np.issubdtype(c.dtype, np.number)]
    signals: dict[str, Signal] = {}
    started: datetime | None = None
    clocks: dict[tuple[float, float, int], np.ndarray] = {}
    without: dict[str, tuple[np.ndarray, str]] = {}
    for channel, name, values in raw:
        unit = known_unit(str(channel.properties.get("unit_string", "")))
        increment = float(channel.properties.get("wf_increment", 0.0))
        if increment > 0.0 and options.clock.column is None:
            begin = channel.properties.get("wf_start_time")
            if started is None and begin is not None:
                started = begin.astype(datetime) if isinstance(begin, np.datetime64) else begin
            key = (float(channel.properties.get("wf_start_offset", 0.0)), increment, len(values))
            time = clocks.setdefault(key, key[0] + increment * np.arange(len(values)))
            signals[name] = Signal(name, values, time, unit, str(channel.properties.get("description", "")))
        else:
            without[name] = (values, unit)
    source, restarts = TimeSource(), 0
    if without and not signals:
        signals, source, restarts = share_time(without, options.clock, str(path))
    else:
        signals |= {name: Signal(name, values, np.empty(0), unit) for name, (values, unit) in without.items()}
    return Recording(path, "TDMS", signals, started, (f"TDMS: {len(raw)} channels",), restarts=restarts, source=source)
