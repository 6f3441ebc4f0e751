"""Overview of an import: a table on the terminal, a picture of each trace."""

from collections.abc import Iterable, Sequence
from pathlib import Path
import sys
import textwrap

import numpy as np

from twin.recordings.map_text import grouped
from twin.recordings.propose import Proposal
from twin.recordings.recorded_run import Understood
from twin.recordings.signals import Recording, Signal
from twin.recordings.write import ERROR, Written
from twin.report.curves import Curve, Panel, curves_figure
from twin.report.figure import save_png
from twin.simulation.summary import table
from twin.units import AXIS_UNITS, in_words

MOST_AXES = 8


def understood_table(known: Understood, traces: Sequence[Written]) -> str:
    """One line per column: source, meaning, interval, range."""
    rows = []
    for channel in known.channels:
        key = channel.key if channel.key in traces[0].units else (channel.key[0], "position")
        low, high = min(t.curve(key).min() for t in traces), max(t.curve(key).max() for t in traces)
        column, source = channel.column, channel.source
        skew = f"{source.skew_s * 1e3:.3g} ms" if source.skew_s else "-"
        span = f"{low + 0.0:.5g} .. {high + 0.0:.5g} {traces[0].units[key]}"
        meant = [column.name, ".".join(channel.key), channel.conversion.unit, f"{column.factor:g}"]
        rows.append([*meant, f"{source.timing.interval * 1e3:.4g} ms", skew, span])
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

    def panel(axis: str, what: str, *signals: str) -> Panel:
        there = [s for s in signals if (axis, s) in trace.units]
        curves = [Curve(in_words(s), trace.curve((axis, s)), "setpoint" if s.endswith("setpoint") else axis) for s in there]
        return Panel(f"{axis} {what}\n{trace.units[axis, there[0]]}" if there else f"{axis} {what}", curves)

    panels = []
    for axis in list(dict.fromkeys(axis for axis, _ in trace.units))[:MOST_AXES]:
        position, force = (
            next((s for s in signals if (axis, s) in trace.units), "")
            for signals in (("position", "motor_position"), ("current", "torque", "voltage"))
        )
        unit, factor = AXIS_UNITS[known.kinds[axis]].error
        error = [Curve("", trace.curve((axis, ERROR)) * factor, axis)] if (axis, ERROR) in trace.curves else []
        panels += [
            panel(axis, "position", "setpoint", position),
            Panel(f"{axis} set point minus\nposition, {unit}", error),
            panel(axis, "speed", "velocity_setpoint", "velocity"),
            panel(axis, force or "current, torque, voltage", force),
        ]
    length = f"{trace.piece.count * trace.piece.period:.2f} s every {trace.piece.period * 1e3:g} ms"
    figure = curves_figure(np.concatenate(trace.times), panels, f"{trace.name}: {length}, from {', '.join(known.run.files)}", columns=4)
    save_png(figure, path)
