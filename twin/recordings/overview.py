"""Overview of an import: a table on the terminal, a picture of each trace."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.recordings.signals import Recording
from twin.recordings.understand import Understood
from twin.recordings.write import ERROR, Written
from twin.report.colours import SETPOINT_COLOUR, axis_colour, hexadecimal
from twin.report.figure import INK, SOFT, STYLE, new_figure, save_png
from twin.simulation.summary import table
from twin.units import AXIS_UNITS

MOST_AXES = 8


def understood_table(known: Understood, traces: Sequence[Written]) -> str:
    """One line per column: source, meaning, interval, range."""
    rows = []
    for channel in known.channels:
        key = channel.key if channel.key in traces[0].units else (channel.key[0], "position")
        low, high = min(t.low[key] for t in traces), max(t.high[key] for t in traces)
        rows.append(
            [
                channel.column.name,
                ".".join(channel.key),
                channel.conversion.unit,
                f"{channel.column.factor:g}",
                f"{channel.source.timing.interval * 1e3:.4g} ms",
                f"{channel.source.skew_s * 1e3:.3g} ms" if channel.source.skew_s else "-",
                f"{low:.5g} .. {high:.5g} {traces[0].units[key]}",
            ]
        )
    return table(["column", "signal", "unit", "factor", "interval", "skew removed", "range"], rows, left=3)


def listing(recording: Recording) -> str:
    """Content of a file, before there is a map."""
    rows = []
    for signal in recording.signals.values():
        if not len(signal.values):
            continue
        low, high, total = np.inf, -np.inf, 0
        for _, values in signal.blocks():
            good = values[np.isfinite(values)]
            total += len(values)
            if len(good):
                low, high = min(low, float(good.min())), max(high, float(good.max()))
        interval = "-"
        if signal.time is not None and len(signal.time) > 1:
            ends = float(signal.time[0:1][0]), float(signal.time[len(signal.time) - 1 : len(signal.time)][0])
            interval = f"{(ends[1] - ends[0]) / (len(signal.time) - 1) * 1e3:.4g} ms"
        rows.append([signal.name, signal.description, signal.unit or "-", str(total), interval, f"{low:.5g} .. {high:.5g}"])
    if all(not row[1] for row in rows):
        return table(["column", "unit", "samples", "interval", "range"], [[r[0], *r[2:]] for r in rows], left=2)
    return table(["column", "description", "unit", "samples", "interval", "range"], rows, left=3)


def draw_run(known: Understood, trace: Written, path: Path) -> None:
    """Draw position and set point, following error, speed, and current (or torque, voltage) of each axis over time."""
    from matplotlib import rc_context

    with rc_context(STYLE):
        _draw(known, trace, path)


def _draw(known: Understood, trace: Written, path: Path) -> None:
    axes = list(dict.fromkeys(axis for axis, _ in trace.units))[:MOST_AXES]
    figure, panels = new_figure(len(axes), 4, width=15.0, height=2.3, sharex=True)
    for row, (axis, line) in enumerate(zip(axes, panels)):
        colour = hexadecimal(axis_colour(axis, row))
        setpoint = hexadecimal(SETPOINT_COLOUR)
        position = next((s for s in ("position", "motor_position") if (axis, s) in trace.units), None)
        line[0].set_ylabel(axis, rotation=0, fontsize=14, fontweight="bold", color=INK, labelpad=14)
        line[0].set_title(f"position [{trace.units[axis, 'setpoint']}]")
        line[0].plot(*trace.curve((axis, "setpoint")), color=setpoint, lw=2.2, label="set point")
        if position:
            line[0].plot(*trace.curve((axis, position)), color=colour, lw=1.0, label=position.replace("_", " "))
        line[0].legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=2, borderaxespad=0.0, handlelength=1.2, columnspacing=1.0)
        _draw_error(known, trace, axis, line[1], colour)
        _draw_speed(trace, axis, line[2], colour, setpoint)
        force = [s for s in ("current", "torque", "voltage") if (axis, s) in trace.units][:1]
        if not force:
            _absent(line[3], "current, torque, voltage")
        else:
            line[3].set_title(f"{force[0]} [{trace.units[axis, force[0]]}]")
            line[3].plot(*trace.curve((axis, force[0])), color=colour, lw=0.7)
        for panel in line:
            panel.margins(x=0.01)
    for column in panels.T:
        drawn = [panel for panel in column if panel.axison]
        if drawn:
            drawn[-1].set_xlabel("time [s]")
            drawn[-1].tick_params(labelbottom=True)
    title = f"{trace.name}: {trace.piece.count * trace.piece.period:.2f} s every {trace.piece.period * 1e3:g} ms, from {', '.join(known.run.files)}"
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold", color=INK)
    save_png(figure, path)


def _draw_error(known: Understood, trace: Written, axis: str, panel: Any, colour: str) -> None:
    """Set point minus position."""
    unit, factor = AXIS_UNITS[known.kinds[axis]].error
    if (axis, ERROR) not in trace.curves:
        _absent(panel, "position")
        return
    times, errors = trace.curve((axis, ERROR))
    panel.set_title(f"set point minus position [{unit}]")
    panel.plot(times, errors * factor, color=colour, lw=0.8)


def _absent(panel: Any, what: str) -> None:
    panel.set_axis_off()
    panel.text(0.5, 0.5, f"{what}: not recorded", ha="center", va="center", transform=panel.transAxes, color=SOFT)


def _draw_speed(trace: Written, axis: str, panel: Any, colour: str, setpoint: str) -> None:
    """Speed and its set point."""
    shown = [s for s in ("velocity_setpoint", "velocity") if (axis, s) in trace.units]
    if not shown:
        _absent(panel, "speed")
        return
    panel.set_title(f"speed [{trace.units[axis, shown[0]]}]")
    for signal in shown:
        main = signal == "velocity"
        panel.plot(
            *trace.curve((axis, signal)),
            color=colour if main else setpoint,
            lw=0.8 if main else 1.8,
            label="measured" if main else "set point",
        )
    if len(shown) > 1:
        panel.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=2, borderaxespad=0.0, handlelength=1.2, columnspacing=1.0)
