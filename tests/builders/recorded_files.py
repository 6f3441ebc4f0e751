"""A move of one axis as a control would record it, and files of it by independent writers (csv, nptdms, asammdf, scipy.io)."""

from collections.abc import Callable, Mapping
import csv
import json
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

MAP = """
feedforward = "off"
[[column]]
name = "soll"
axis = "X"
signal = "setpoint"
unit = "mm"
[[column]]
name = "ist"
axis = "X"
signal = "position"
unit = "mm"
[[column]]
name = "speed"
axis = "X"
signal = "velocity"
unit = "mm/s"
[[column]]
name = "strom"
axis = "X"
signal = "current"
unit = "A"
"""


def move(time: Array) -> dict[str, Array]:
    """There and back by 100 mm with dwell-free smooth reversals: set point and position [mm], speed [mm/s], current [A] at any times [s]."""
    w = np.array([1.7, 4.1])
    size = np.array([40.0, 10.0])

    def at(t: Array, order: int) -> Array:
        phase = np.outer(t, w) + order * np.pi / 2.0
        return np.sin(phase) @ (size * w**order)

    late = 0.01
    speed, acceleration = at(time - late, 1), at(time - late, 2)
    current = 0.02 * acceleration + 0.01 * speed + 1.5 * np.tanh(speed / 2.0)
    return {"soll": at(time, 0), "ist": at(time - late, 0), "speed": speed, "strom": current}


def write_csv(
    path: Path,
    columns: Mapping[str, Array],
    *,
    delimiter: str = ",",
    decimal: str = ".",
    before: str = "",
    encoding: str = "utf-8",
    units: list[str] | None = None,
) -> Path:
    """By the csv module, every number with 17 digits; `before` are lines above the heading."""
    with open(path, "w", newline="", encoding=encoding) as file:
        file.write(before)
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow(columns)
        if units:
            writer.writerow(units)
        for row in zip(*columns.values(), strict=True):
            writer.writerow(["" if np.isnan(v) else repr(float(v)).replace(".", decimal) for v in row])
    return path


def write_xml(
    path: Path, signals: Mapping[str, tuple[float, float, Array]], *, drop: Callable[[str, int], bool] | None = None, head: str = ""
) -> Path:
    """A SINUMERIK trace: signal -> (begin [s], interval [s], values); servo signals only where they change, `drop` loses samples."""
    lines = [
        '<?xml version="1.0" encoding="utf-8" ?>',
        head,
        '<traceSession version="01.00.03.02">',
        "<traceCaptureSetup/>",
        '<traceData dataFrames="1">',
    ]
    lines += ["<dataFrame>", '<frameHeader startTime="2024-05-14T08:21:07.250Z" dropOuts="0" stopInc="1"/>']
    records: dict[int, list[str]] = {}
    for i, (name, (begin, interval, values)) in enumerate(signals.items()):
        kept = [k for k in range(len(values)) if not (drop and drop(name, k))]
        lines.append(
            f'<dataSignal id="f{i + 1}" name="{name}" description="signal {i + 1}" interval="{interval:.6f}" datapointCount="{len(kept)}" '
            'unitsType="posn" dataType="double" event="255"/>'
        )
        shown = None
        for k in kept:
            text = f"{values[k]:.6f}"
            if text != shown or k == kept[-1]:
                records.setdefault(round((begin + k * interval) * 1e6), []).append(f'f{i + 1}="{text}"')
            shown = text
    lines += [f'<rec time="{us / 1e6:.6f}" {" ".join(cells)}/>' for us, cells in sorted(records.items())]
    lines += ["</dataFrame>", "</traceData>", "</traceSession>"]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def write_tdms(path: Path, columns: Mapping[str, Array], interval: float, units: Mapping[str, str] | None = None) -> Path:
    """By nptdms, with waveform properties."""
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as writer:
        for name, values in columns.items():
            properties = {"wf_increment": interval, "wf_start_offset": 0.0, "unit_string": (units or {}).get(name, "")}
            writer.write_segment([ChannelObject("axis", name, values, properties=properties)])
    return path


def write_mdf(path: Path, groups: list[tuple[Array, Mapping[str, tuple[Array, str]]]]) -> Path:
    """By asammdf: groups of (times [s], signal -> (values, unit))."""
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        for times, columns in groups:
            file.append([Signal(values, times, name=name, unit=unit) for name, (values, unit) in columns.items()])
        file.save(path, overwrite=True)
    return path


def write_edge(
    path: Path,
    columns: Mapping[str, Array],
    *,
    cycle_ms: float = 2.0,
    lost: tuple[int, int] | None = None,
    blocks: Mapping[int, str] | None = None,
    labels: Mapping[str, str] | None = None,
) -> Path:
    """A SINUMERIK Edge recording: `SIGNAL|axis` -> values; cycles lost[0] .. lost[1] are missing, `blocks` became active at a cycle."""
    first = 1000
    count = len(next(iter(columns.values())))
    kept = [k for k in range(count) if lost is None or not lost[0] <= k < lost[1]]
    signals = [{"Name": "CYCLE", "Type": "INTEGER", "Axis": "Cycle", "Address": "CYCLE"}]
    signals += [{"Name": n, "Type": "DOUBLE", "Axis": (labels or {}).get(n.rpartition("|")[2], ""), "Address": n} for n in columns]
    payload: list[dict[str, object]] = [
        {"HFCallEvent": {"HFProbeCounter": first, "Channel": 1, "SeekOffset": 1, "Path": "/_N_MPF_DIR/_PART"}}
    ]
    for start in range(0, len(kept), 100):
        rows = kept[start : start + 100]
        for k in (k for k in (blocks or {}) if rows[0] <= k <= rows[-1]):
            payload.append({"HFBlockEvent": {"HFProbeCounter": first + k, "Channel": 1, "SeekOffset": 10 * k, "GCode": (blocks or {})[k]}})
        payload.append({"HFTimestamp": {"Time": "2023-12-22T14:26:01.312Z", "HFProbeCounter": first + rows[0]}})
        payload.append({"HFData": [[first + k, *(float(v[k]) for v in columns.values())] for k in rows]})
    header = {
        "SignalListHFData": signals,
        "CycleTimeMs": cycle_ms,
        "Initial": {"Time": "2023-12-22T14:25:56.836Z", "HFProbeCounter": first - 500},
    }
    path.write_text(json.dumps({"Header": header, "Payload": payload, "Footer": {}}), encoding="utf-8")
    return path


def edge_columns(time: Array) -> dict[str, Array]:
    """Signals of a control on three axes: 1 moves and counts its current the other way round, 2 spins, 3 stands."""
    m = move(time)
    lag = move(time - 0.004)
    slope = np.gradient(m["soll"], time)
    place = lag["ist"] + 2e-3 * np.sin(37.0 * time)  # what the set point does not explain, and the position controller answers
    command = 30.0 * (m["soll"] - place) + slope
    still, spin = np.full_like(time, 12.5), 4000.0 * time
    return {
        "DES_POS|1": m["soll"], "ENC_POS|1": place, "CMD_SPEED|1": command, "VEL_FFW|1": slope, "TORQUE_FFW|1": 0.0 * time,
        "CURRENT|1": -lag["strom"], "LOAD|1": np.abs(lag["strom"]),
        "DES_POS|2": spin, "ENC_POS|2": spin - 3.0, "CURRENT|2": 0.1 * np.sin(time),
        "DES_POS|3": still, "ENC_POS|3": still + 1e-4 * np.sin(900.0 * time),
    }  # fmt: skip
