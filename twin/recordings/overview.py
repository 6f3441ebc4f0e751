"""Overview of an import: a table on the terminal, a picture of each trace."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
import sys
import textwrap
from typing import Any

import numpy as np

from twin.recordings.map_text import grouped
from twin.recordings.propose import Proposal
from twin.recordings.signals import Recording, Signal
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


def proposal_table(proposal: Proposal, recordings: Sequence[Recording], width: int = 100) -> str:
    """What each used column is, its course as a line of blocks, and why; then what is not used. Fits into `width` columns of text."""
    signals = {name: signal for r in recordings for name, signal in r.signals.items()}
    rows = []
    for c in proposal.columns:
        if not c.doubt:
            why = "; ".join(part for part in (c.reason or "its name", *c.extra, "sign = -1" * (c.sign < 0)) if part)
            rows.append([c.name, f"{c.axis}.{c.signal}", c.unit, _blocks(signals[c.name]) if c.name in signals else "", why])
    lines = []
    if rows:
        widths = [
            max(min(max(len(row[i]) for row in rows), most), least)
            for i, (most, least) in enumerate(((24, 6), (26, 6), (9, 4), (COURSE, 6)))
        ]
        room = max(width - sum(widths) - 2 * len(widths), 20)
        for row in [["column", "signal", "unit", "course", "why"], ["-" * w for w in (*widths, room)], *rows]:
            cells = [*(textwrap.wrap(cell, w) or [""] for cell, w in zip(row[:4], widths)), textwrap.wrap(row[4], room)]
            for i in range(max(map(len, cells))):
                parts = [(cell[i] if i < len(cell) else "").ljust(w) for cell, w in zip(cells, (*widths, 0))]
                lines.append("  ".join(parts).rstrip())
    lines += _wrapped([f"not used: '{c.name}' ({c.axis}.{c.signal}): {c.doubt}" for c in proposal.columns if c.doubt], "  - ", width)
    lines += _wrapped(proposal.left_out, "  - ", width)
    if proposal.unknown:
        lines += _wrapped([f"columns without a use: {', '.join(grouped(proposal.unknown))}"], "  - ", width)
    lines += _wrapped(proposal.notes, "  - ", width)
    lines += _wrapped(proposal.questions, "  ? ", width)
    return "\n".join(lines)


COURSE = 16
"""Characters of the course of a column."""
_HEIGHTS = "\u2581\u2582\u2583\u2584\u2585\u2586\u2587\u2588"


def _blocks(signal: Signal) -> str:
    """The course of a column as a line of blocks, empty where the terminal has no such letters."""
    if "utf" not in (getattr(sys.stdout, "encoding", None) or "").lower() or len(signal.values) < 2:
        return ""
    rows = np.linspace(0, len(signal.values) - 1, min(COURSE, len(signal.values))).astype(int)
    values = np.array([float(signal.values[int(r) : int(r) + 1][0]) for r in rows])
    span = float(np.ptp(values))
    return "".join(_HEIGHTS[int(7.999 * (v - values.min()) / span) if span > 0.0 else 0] for v in values)


def _wrapped(texts: Iterable[str], mark: str, width: int) -> list[str]:
    return [line for text in texts for line in textwrap.wrap(text, width, initial_indent=mark, subsequent_indent=" " * len(mark))]


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
