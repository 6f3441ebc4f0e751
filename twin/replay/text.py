"""The text panel of a recording: runs, errors, events, missing signals."""

from collections.abc import Mapping, Sequence

import numpy as np

from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.replay.curves import difference, not_recorded, position_errors
from twin.replay.events import KINDS, MOST_EVENTS, Event
from twin.replay.toolpaths import ToolPaths
from twin.simulation.errors_of_run import axis_errors
from twin.units import AXIS_UNITS, plain

SAME_SETPOINT = 1e-6
"""Set points of two runs that differ by less count as equal [m, rad]; covers rounding of a recording."""


def summary_text(machine: Machine, runs: Mapping[str, Trace], paths: ToolPaths | None, events: Sequence[Event], summary: str) -> str:
    """The panel as markdown; `summary` is plain text of the caller."""
    parts = [f"# {machine.name}"]
    for order, (label, trace) in enumerate(runs.items()):
        colours = "" if order else " (colours of the tool path)"
        missing = not_recorded(trace, machine)
        lines = [f"sampled every {trace.period * 1e3:g} ms", "Not recorded: " + "; ".join(missing) if missing else ""]
        parts.append(_run_text(machine, label, trace, paths, colours, lines))
    labels = list(runs)
    for label in labels[1:]:
        parts.append(_overlay_text(machine, runs[labels[0]], runs[label], labels[0], label))
    if events:
        counts = ", ".join(f"{kind} {count}x" for kind in KINDS if (count := sum(e.kind == kind for e in events)))
        if len(events) > MOST_EVENTS:
            counts += f" (the first {MOST_EVENTS} are marked)"
        parts.append(f"**Events** {counts or 'none'}. Click a time in the list *Events* to go there.")
    if paths:
        shown = "It is too small to magnify."
        if len(paths.magnifications) > 1:
            shown = "The view *deviation* magnifies it; the reference path stays true to scale."
        parts.append(f"The contour error is the distance of the tool point from the path of the set points, in the part frame. {shown}")
    if summary:
        parts.append(f"```\n{summary.strip()}\n```")
    return "\n\n".join(parts) + "\n"


def design_text(designs: Mapping[str, tuple[Machine, Trace]], paths: Sequence[ToolPaths] | None, summary: str) -> str:
    """The panel of two designs side by side, as markdown: time, contour error and axes of each."""
    parts = [f"# {' beside '.join(designs)}"]
    if summary:
        parts.append(f"```\n{summary.strip()}\n```")
    for i, (label, (machine, trace)) in enumerate(designs.items()):
        parts.append(_run_text(machine, label, trace, paths[i] if paths else None, "", [machine.name]))
    if paths:
        own = "Each contour error is the distance of the tool point from the path of its own set points."
        parts.append(f"{own} Both panes have the same colours and magnification.")
    return "\n\n".join(parts) + "\n"


def _run_text(machine: Machine, label: str, trace: Trace, paths: ToolPaths | None, colours: str, said: Sequence[str]) -> str:
    """One run: duration and what is `said` of it, contour error, axes."""
    lines = [f"## {label}", f"{trace.time[-1] - trace.time[0]:.3f} s, {said[0]}"]
    if paths:
        error = paths.contours[label].error * 1e6
        worst = int(np.argmax(error))
        rms = np.sqrt(np.mean(error**2))
        lines.append(f"**Contour error** largest {error[worst]:.2f} um at {trace.time[worst]:.3f} s, RMS {rms:.2f} um{colours}")
    return "\n\n".join(filter(None, [*lines, _axis_table(machine, trace), *said[1:]]))


def _axis_table(machine: Machine, trace: Trace) -> str:
    rows = []
    for axis in machine.axes:
        if not position_errors(trace, axis):
            continue
        errors = axis_errors(trace, axis)
        unit, factor = AXIS_UNITS[axis.kind].error
        peak = f"{plain(np.abs(trace.get(axis.name, axis.effort)).max())} {axis.effort_unit}" if trace.has(axis.name, axis.effort) else "-"
        sizes = f"{errors.following * factor:.1f} | {errors.without_delay * factor:.2f} | {errors.without_delay_rms * factor:.2f}"
        rows.append(f"| {axis.name} | {sizes} | {unit} | {peak} |")
    what = "Largest following error with and without the delay, RMS without the delay, peak of current or torque:"
    return "\n".join([what, "", "| axis | with | without | RMS | | peak |", "|---|---:|---:|---:|---|---:|", *rows]) if rows else ""


def _overlay_text(machine: Machine, first: Trace, second: Trace, label: str, other: str) -> str:
    """A sentence on the difference of two runs."""
    apart = {axis.name: difference(first, second, axis.name, "setpoint") for axis in machine.axes}
    worst = max(machine.axes, key=lambda axis: np.abs(apart[axis.name][1]).max(initial=0.0))
    time, off = apart[worst.name][0], np.abs(apart[worst.name][1])
    if off.max(initial=0.0) <= SAME_SETPOINT:
        return f"**{other} - {label}** both runs have the same set points; curves of *{other}* are thin."
    unit, factor = AXIS_UNITS[worst.kind].error
    return (
        f"**{other} - {label}**: the set points differ by up to {off.max() * factor:.3g} {unit} ({worst.name} at {time[off.argmax()]:.3f} s), "
        "which is part of the difference."
    )
