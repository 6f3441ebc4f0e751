"""HTML pages of a gap and of a comparison."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from twin.report import Figure, Section, Table, figure_svg, write_page
from twin.report.stamp import made_line
from twin.simulation.campaign_gap import AS_EXPECTED, CampaignGap

if TYPE_CHECKING:
    from twin.compare.compare import Comparison


def write_gap_page(gap: CampaignGap, path: Path) -> None:
    """Verdict, picture, outliers, then every signal."""
    rows = gap.rows()
    heading = ["run", "axis", "signal", "RMS", "largest", "noise alone", "times noise"]
    cells = [
        [
            r.run,
            r.axis,
            r.signal.replace("_", " "),
            f"{r.gap.rms:.3g} {r.gap.unit}",
            f"{r.gap.max:.3g}",
            f"{r.gap.noise:.3g}",
            f"{r.times_noise:.1f}",
        ]
        for r in rows
    ]
    marked = frozenset(i for i, row in enumerate(rows) if row.times_noise > AS_EXPECTED)
    picture = Figure(figure_svg(gap.plot()), "Gap over what measuring noise alone makes; grey: as it should be.")
    outliers = [Table(heading, cells[: len(marked)], left=3, marked=marked)] if marked else []
    every = Table(heading, cells, left=3, marked=marked, folded=f"{len(cells)} signals, largest first")
    sections = [
        Section("Where the twin and the machine differ", figures=[picture]),
        Section("Outliers", tables=outliers)
        if outliers
        else Section("Outliers", [f"None: no signal is above {AS_EXPECTED:g} times what noise makes."]),
        Section("Every signal", tables=[every]),
    ]
    write_page(path, f"Gap of {gap.campaign}", f"{gap.verdict}.", sections, made_line(gap.machine, gap.campaign))


def write_comparison_page(comparison: Comparison, path: Path, inputs: str) -> None:
    """Verdict, picture, errors of both, differences."""
    errors = [
        [
            e.axis,
            f"{e.first:.2f} {e.unit}",
            f"{e.second:.2f} {e.unit}",
            *("-" if p is None else f"{p:.2f} {e.unit}" for p in (e.first_reversal, e.second_reversal)),
        ]
        for e in comparison.errors
        if e.axis in comparison.differing
    ]
    differences = [
        [d.axis, d.signal.replace("_", " "), f"{d.rms:.3g} {d.unit}", f"{d.max:.3g} {d.unit}", f"{d.at_s:.3f} s"]
        for d in comparison.differences
        if d.axis in comparison.differing
    ]
    a, b = comparison.names
    heading = ["axis", f"error, {a}", f"error, {b}", f"after reversals, {a}", f"after reversals, {b}"]
    sections = [
        Section("In one picture", figures=[Figure(figure_svg(comparison.plot()), f"Grey: {a}; colour: {b}. Aligned by {comparison.by}.")]),
        Section("Errors without the delay of the control", tables=[Table(heading, errors)]),
        Section(f"{b} minus {a}", tables=[Table(["axis", "signal", "RMS", "largest", "at"], differences, left=2)]),
    ]
    write_page(path, f"{a} and {b}", comparison.verdict, sections, made_line(comparison.machine.name, inputs))
