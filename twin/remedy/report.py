"""The report of a remedy: the first page answers what to set, what it brings, how sure, what gets worse."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.remedy.remedy import Remedy, refusals, sentence
from twin.report import Figure, Section, Table, figure_svg, new_figure, write_page
from twin.report.figure import BLUE, RED

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure


def write_remedy_report(found: Remedy, document: dict[str, Any], path: Path) -> None:
    """Write the page."""
    change = 1.0 - found.after.rms / max(found.before.rms, 1e-12)
    lead = (
        f"On {found.motion}: {document['before']:.2f} um RMS at the tool point now, {document['after']:.2f} um with all changes "
        f"({change:.0%} less). Target {document['target_um']:g} um: {'reached' if found.reached else 'not reached'}."
    )
    if found.high > found.low:
        lead += f" With the intervals of the diagnosis: {document['low']:.2f} to {document['high']:.2f} um."
    rows = [
        [sentence(found, c), ", ".join(f"{n} = {v:.6g}" for n, v in e["control"].items()) or "-", f"{e['before']:.2f}", f"{e['after']:.2f}", f"{e['alone']:.2f}"]
        for c, e in zip(found.chosen.changes, document["changes"])
    ]  # fmt: skip
    peaks = [[a, f"{p['before']:.2f}", f"{p['after']:.2f}"] for a, p in document["quadrant_peaks"].items()]
    sections = [
        Section(
            "What to set",
            tables=[Table(("change", f"enter ({document['control']})", "before [um]", "after [um]", "alone [um]"), rows, left=2)] if rows else [],
            paragraphs=[] if rows else ["No change of the control brings the error down further."],
            figures=[Figure(figure_svg(remedy_figure(found)), "Contour error over the path, before and after. The measured circle can refute this picture.")],
            items=document["by_hand"],
        ),
        Section("Largest error after a reversal", tables=[Table(("axis", "before [um, arcsec]", "after [um, arcsec]"), peaks)]),
        Section("At the machine", items=[f"{one['axis']} {one['effect'].replace('_', ' ')}: {one['do']}" for one in document["at_the_machine"]]),
        Section("What no setting cures", items=refusals(found.chosen.refused) or ["Nothing was refused."]),
        Section("What gets worse", items=[f"{e['axis']} {e['function'].replace('_', ' ')}: {w}" for e in document["changes"] for w in e["worse"]] or ["Nothing is known."]),
    ]  # fmt: skip
    write_page(path, f"Remedy: {found.machine.name}", lead, sections)


def remedy_figure(found: Remedy) -> MplFigure:
    """Contour error over the motion, before and after."""
    figure, [[panel]] = new_figure(1, 1, height=3.2)
    share = np.linspace(0.0, 100.0, len(found.before.contour))
    panel.plot(share, 1e6 * found.before.contour, color=RED, lw=1.0, label="before")
    panel.plot(share, 1e6 * found.after.contour, color=BLUE, lw=1.0, label="after")
    panel.set_xlabel("share of the motion [%]")
    panel.set_ylabel("contour error [um]")
    panel.legend(loc="upper right")
    return figure
