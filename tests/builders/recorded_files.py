"""A move of one axis as a control would record it, and files of it by independent writers (csv, nptdms, asammdf, scipy.io)."""

from collections.abc import Callable, Mapping
import csv
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
