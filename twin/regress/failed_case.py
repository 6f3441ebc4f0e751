"""Evidence of a failed case, in a folder of its own.

sentence.txt                axis, time, first block and worst difference
checks.json                 every compared quantity with its tolerance
plot.png                    golden and new signals of the axis, and their difference over the allowed one (grey), which is first exceeded at the
                            dotted line; without traces the worst numbers
golden.parquet new.parquet  both traces, at the same samples
overlay.rrd                 both runs in one recording, for `twin replay`
"""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
import textwrap
from typing import Any

from twin.files import output_folder, write_json, write_whole
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.regress.compare import Check, common
from twin.regress.golden import Golden, Outcome, golden_of, write_small
from twin.regress.suite import SIGNAL_UNITS, Case
from twin.regress.where import Place
from twin.simulation.gap import gap_unit

PLOTTED = ("setpoint", "position", "velocity", "current", "voltage", "torque")


def write_evidence(
    folder: Path, case: Case, golden: Golden, outcome: Outcome, checks: Sequence[Check], place: Place | None, text: str
) -> Path:
    """Write the evidence of a failed case; returns its folder."""
    output_folder(folder)
    write_whole(folder / "sentence.txt", text + "\n")
    write_json({"checks": [check_table(c) for c in checks]}, folder / "checks.json", "checks")
    if golden.trace is None or outcome.trace is None or outcome.machine is None:
        _plot_numbers(checks, text, folder / "plot.png")
        return folder
    new = golden_of(outcome, case).trace
    assert new is not None
    write_small(golden.trace, folder / "golden.parquet")
    write_small(new, folder / "new.parquet")
    before, after, _ = common(golden.trace, outcome.trace)
    axis = place.axis if place and place.axis in before.axes else before.axes[0]
    _plot(case, outcome.machine, axis, before, after, place, text, folder / "plot.png")
    _record(outcome.machine, golden.trace, new, place, text, folder / "overlay.rrd")
    return folder


def check_table(check: Check) -> dict[str, Any]:
    """A check as a JSON table."""
    return {"ok": check.ok} | {key: value for key, value in asdict(check).items() if key != "block"}


def _plot(case: Case, machine: Machine, axis: str, before: Trace, after: Trace, place: Place | None, text: str, path: Path) -> None:
    """Plot golden and new signals of one axis, and their differences with the tolerances."""
    from twin.report import save_png
    from twin.report.curves import SETPOINT, Curve, Panel, curves_figure
    from twin.report.figure import RED, SOFT

    signals = [s for s in dict.fromkeys((*PLOTTED, *SIGNAL_UNITS)) if s in case.tolerance and before.has(axis, s) and after.has(axis, s)]
    panels = []
    for signal in signals:
        unit, factor = gap_unit(machine.axis(axis), signal)
        shown, scale = ("mm", 1e-3) if unit == "um" else ("deg", 1.0 / 3600.0) if unit == "arcsec" else (unit, 1.0)
        old, new = before.get(axis, signal) * factor, after.get(axis, signal) * factor
        both = [Curve("golden", old * scale, SETPOINT), Curve("new", new * scale, axis)]
        panels.append(Panel(f"{axis}.{signal} [{shown}]", both))
        panels.append(Panel(f"new - golden [{unit}]\n(grey: +-{case.tolerance[signal]['max']:g})", [Curve("", new - old, axis)]))
    figure = curves_figure(before.time, panels, textwrap.fill(f"{case.name}: {text}", 150), columns=2)
    for panel, signal in zip(figure.axes[1::2], signals):
        largest = case.tolerance[signal]["max"]
        panel.axhspan(-largest, largest, color=SOFT, alpha=0.3, linewidth=0)
    if place and place.since_s is not None:
        for panel in figure.axes:
            panel.axvline(place.since_s, color=RED, linewidth=1.0, linestyle=":")
    save_png(figure, path)


def _plot_numbers(checks: Sequence[Check], text: str, path: Path) -> None:
    """Plot the difference of each number from its golden value over its tolerance."""
    from twin.report import new_figure, save_png
    from twin.report.figure import BLUE, RED

    shown = sorted((c for c in checks if c.excess > 1e-3), key=lambda c: c.excess)[-20:]
    figure, panels = new_figure(1, 1, width=11.0, height=0.28 * len(shown) + 1.4)
    panel = panels[0][0]
    sizes = [min(c.excess, 1e6) for c in shown]
    panel.barh([c.quantity for c in shown], sizes, color=[BLUE if c.ok else RED for c in shown])
    panel.set_xscale("log")
    panel.axvline(1.0, color="black", linewidth=1.0)
    panel.set_xlabel("difference over tolerance (1 = limit)")
    figure.suptitle(textwrap.fill(text, 120), x=0.01, ha="left", fontsize=10)
    save_png(figure, path)


def _record(machine: Machine, golden: Trace, new: Trace, place: Place | None, text: str, path: Path) -> None:
    """Write a recording: the golden run moves the machine, the new run is overlaid."""
    from twin.replay.events import TELLING, Event
    from twin.replay.recording import write_recording

    marks = []
    if place and place.since_s is not None:
        marks.append(Event(TELLING, place.axis, place.since_s, float(min(golden.time[-1], new.time[-1])), text))
    write_recording(path, machine, {"golden": golden, "new": new}, summary=text, also=marks)
