"""The report of a remedy: the first page answers what to set, what it brings, how sure, what gets worse."""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.errors import InputError
from twin.remedy.choose import faults_of
from twin.remedy.remedy import Remedy, refusals, sentence
from twin.report import Figure, Section, Table, address, figure_svg, link_from, write_page
from twin.report.curves import SETPOINT, Curve, Panel, curves_figure
from twin.simulation.summary import feedforward_line
from twin.system import shell_word
from twin.units import in_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

REPLAY = "replay.rrd"
"""The motion before and after, beside the page."""


def in_short(found: Remedy, document: Mapping[str, Any]) -> list[str]:
    """Sentences on the error before and after the changes, the target, the tolerance, and a slower feed as the last resort."""
    goal, largest = found.task.goal, document["largest"]
    low, high = document["low"], document["high"]
    digits = 3 if high and f"{low:.2f}" == f"{high:.2f}" else 2
    spread = f" ({low:.{digits}f} to {high:.{digits}f})" if high and high > low else ""
    reached = "reached" if found.after.rms <= goal.rms else "not reached"
    count = len(found.changes)
    brings = f" now, {document['after']:.2f} um after {count} change{'s' * (count > 1)}{spread}" if count else f" now{spread}, no change"
    lines = [
        f"{found.task.on.name}: {document['before']:.2f} um RMS at the tool point{brings}; target {document['target_um']:g} um {reached}",
        f"feedforward: {feedforward_line(found.task.machine)}, as in the machine file",
    ]
    if found.faultless > max(goal.rms, 0.5 * found.after.rms):
        lines.append(
            f"without its faults the machine has {1e6 * found.faultless:.2f} um: friction, gains, feedforward and delays make the rest; "
            "twin tune MACHINE shows what other gains, feedforward and delays bring"
        )
    if math.isfinite(goal.largest):
        now, then = ("inside" if e.largest <= goal.largest else "outside" for e in (found.before, found.after))
        lines.append(
            f"largest error {largest['before']:.2f} um now, {largest['after']:.2f} um after; tolerance {document['tolerance_um']:g} um: {now} now, {then} after"
        )
    if found.override is not None:
        share, error = found.override
        lines.append(
            f"the last resort: {100.0 * share:.0f} % of the feed after the changes gives {1e6 * error.rms:.2f} um RMS, {1e6 * error.largest:.2f} um at most, and costs "
            f"{found.duration * (1.0 / share - 1.0):.1f} s in {found.duration:.1f} s"
        )
    elif found.slower:
        lines.append(f"a slower feed does not help: none down to {100.0 * found.slower[-1][0]:.0f} % reaches what is asked")
    return lines


def entry_text(entry: Mapping[str, Any]) -> str:
    """One datum to enter, with its old value."""
    old = "note the old value" if entry["old"] is None else f"was {entry['old']:.6g}"
    return f"{entry['name']} = {entry['value']:.6g}{' ' + entry['unit'] if entry['unit'] else ''} ({old})"


def cause_of(found: Remedy, diagnosis: Mapping[str, Any]) -> str:
    """What causes the error, as far as it is known, in one sentence."""
    probable = {(e["effect"], e["axis"]): e.get("probability") for e in diagnosis.get("effects", ())}
    causes = [
        f"{in_words(s.effect.name)} of {s.axis}" + (f" (probability {p:.2f})" if (p := probable.get((s.effect.name, s.axis))) else "")
        for s in faults_of(found.task.machine, found.task.calibrated)
        if not probable or (s.effect.name, s.axis) in probable
    ]
    return f"Cause: {', '.join(causes) or 'nothing beyond the friction that every axis has'}."


def surety(found: Remedy, diagnosis: Mapping[str, Any]) -> str:
    """How sure the prediction is, in one sentence."""
    missing = "the diagnosis gives none for these sizes" if diagnosis else "the sizes of the effects are given, not measured"
    interval = "the interval comes from those of the diagnosis" if found.high > found.low else f"no interval: {missing}"
    tried = " Each change was also simulated at other feeds and with 20 % more and less friction, and made none of them worse."
    return f"How sure: {interval}.{tried if found.changes else ''}"


def write_remedy_report(
    found: Remedy, document: dict[str, Any], diagnosis: Mapping[str, Any], folder: Path, diagnosed: Path | None = None
) -> None:
    """Write the page `report.html` in the folder of the remedy; the page of the diagnosis and it get links to each other."""
    page = folder / "report.html"
    brings, *more = in_short(found, document)
    rows = [
        [e["axis"], in_words(e["function"]), entry["name"], entry["unit"] or "-", "as found" if entry["old"] is None else f"{entry['old']:.6g}", f"{entry['value']:.6g}"]
        for e in document["changes"]
        for entry in e["enter"]
    ]  # fmt: skip
    steps = [
        [sentence(found, c), f"{e['before']:.2f}", f"{e['after']:.2f}", "unstable" if e["alone"] is None else f"{e['alone']:.2f}"]
        for c, e in zip(found.changes, document["changes"])
    ]
    peaks = [[a, f"{p['before']:.2f}", f"{p['after']:.2f}", p["unit"]] for a, p in document["quadrant_peaks"].items()]
    worse = [f"{e['axis']} {in_words(e['function'])}: {w}" for e in document["changes"] for w in e["worse"]]
    entered = "no cycle time; the changes are entered in the control, the old values stand beside them"
    costs = f"Cost: {entered if rows else 'none; nothing is changed'}."
    set_in_short = [f"Set: {'; '.join(sentence(found, c) for c in found.changes)}."] if steps else []
    links = [("Replay before and after", REPLAY)]
    if diagnosed is not None and diagnosed.is_file():
        links.append(("Diagnosis", address(diagnosed, page)))
    sections = [
        Section(
            "In short",
            items=[cause_of(found, diagnosis), *set_in_short, *(f"{text[0].upper()}{text[1:]}." for text in more), surety(found, diagnosis), costs],
            links=links,
            figures=[Figure(figure_svg(remedy_figure(found)), "Contour error, before and after. Measure the motion again after the change: the record shows whether the prediction holds.")],
        ),
        Section(
            f"What to set in the control ({document['control']})",
            tables=[Table(("axis", "change", "datum", "unit", "old", "new"), rows, left=4)] if rows else [],
            paragraphs=[] if steps else ["Nothing: the target is met already." if found.after.rms <= found.task.goal.rms else "No change of the control brings the error down further."],
            items=[*document["by_hand"], *(f"File: control/{name}" for name in document["files"])],
        ),
        *([Section("What each change brings", tables=[Table(("change", "before [um]", "after [um]", "alone [um]"), steps)])] if steps else []),
        Section("Largest error of an axis after a reversal", tables=[Table(("axis", "before", "after", "unit"), peaks)]),
        Section("At the machine", items=[f"{one['axis']} {in_words(one['effect'])}: {one['do']}" for one in document["at_the_machine"]]),
        Section("What no setting cures", items=refusals(found.refused) or ["Nothing: no change was refused."]),
        *([Section("What gets worse", items=worse)] if worse else []),
        Section("Replay", paragraphs=[f"{REPLAY} holds the motion before and after; if a click does not open it: twin replay {shell_word(folder)}"]),
    ]  # fmt: skip
    write_page(page, f"Remedy: {found.task.machine.name}", f"On {brings}.", sections)
    if diagnosed is not None and diagnosed.is_file():
        with contextlib.suppress(InputError):  # the folder of the diagnosis may be read-only
            link_from(diagnosed, "Remedy", page)


def remedy_figure(found: Remedy) -> MplFigure:
    """Contour error over the motion, before and after."""
    time = np.linspace(0.0, found.duration, len(found.before.contour))
    curves = [Curve("before", 1e6 * found.before.contour, SETPOINT)]
    curves += [Curve("after", 1e6 * found.after.contour, "after")] if found.changes else []
    if math.isfinite(found.task.goal.largest):
        curves.append(
            Curve(f"tolerance {1e6 * found.task.goal.largest:g} um", np.full(len(time), 1e6 * found.task.goal.largest), "tolerance", "--")
        )
    return curves_figure(time, [Panel("contour error, um", curves, peaks="um")], found.task.on.name)
