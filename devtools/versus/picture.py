"""The picture of the comparison: what each method leaves of the gap on runs that it did not see, from the stored results."""

from __future__ import annotations

from pathlib import Path

from twin.report import new_figure, save_png
from twin.units import in_words

from .table import methods_of, results_in

COLOURS = {
    "machine file": "#9aa3ad",
    "mujoco.sysid": "#e07b10",
    "CMA-ES (PACE)": "#8a5cc2",
    "least squares": "#2c9c69",
    "SINDy": "#c23b3b",
    "twin identify": "#6aa5e8",
    "twin diagnose": "#0b3d91",
    "twin diagnose --quick": "#0b3d91",
}
MARKERS = dict(zip(COLOURS, "xsv^Do**"))


def draw(folder: Path, file: Path) -> None:
    """One line an input, one mark a method, over times noise."""
    results = results_in(folder)
    figure, panels = new_figure(1, 1, width=9.0, height=1.5 + 0.6 * len(results))
    panel = panels[0, 0]
    methods = methods_of(results)
    for row, result in enumerate(results.values()):
        for method, found in result["rows"].items():
            if "gap" in found:  # one above another, so that equal gaps stay visible
                at = row + 0.7 * (methods.index(method) / max(len(methods) - 1, 1) - 0.5)
                panel.plot(found["gap"]["times_noise"], at, MARKERS[method], color=COLOURS[method], markersize=8, linestyle="none")
    for method in methods:
        panel.plot([], [], MARKERS[method], color=COLOURS[method], linestyle="none", label=method)
    panel.axvline(1.0, color="#d5dae1", zorder=0)
    panel.set_xscale("log")
    panel.set_yticks(range(len(results)), [in_words(r["text"].split(";")[0]) for r in results.values()])
    panel.set_ylim(len(results) - 0.4, -0.6)
    panel.set_xlabel("gap on runs left out, times noise")
    panel.legend(ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False)
    save_png(figure, file, 110)
