"""The gap of a campaign: verdict, outliers, tables, plot and JSON document.

For every run, axis and signal the gap is the RMS of measured minus simulated, compared with the RMS of measuring noise alone
(twin against twin). A ratio near 1 means that the twin explains the measurement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import html
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import Campaign, read_campaign
from twin.simulation.encoder_zeros import aligned, clear_zeros, notes_of_zeros, with_common_zeros, zeros_left
from twin.simulation.gap import COMPARED, SignalGap, check_compared, gap_of, predict_campaign
from twin.simulation.gap_level import Gaps
from twin.simulation.recorded_noise import with_recorded_noise
from twin.simulation.summary import listed, table
from twin.units import in_words, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    import pyarrow as pa

AS_EXPECTED = 1.5
"""Largest gap over noise of a signal that agrees with the twin. A simulated run with another noise realisation stays below it."""

SMALLEST, LARGEST = 1e-3, 100.0
"""Ends of the colour scale of a plot; ratios beyond them have its first and its last colour."""
PALE = 3.0
"""Fields above this multiple of AS_EXPECTED are dark and get white numbers."""


class Outlier(NamedTuple):
    """Gap of one signal of an axis in a run, and its ratio to noise."""

    run: str
    axis: str
    signal: str
    gap: SignalGap
    times_noise: float


@dataclass(frozen=True)
class CampaignGap:
    """Gap of every run: `runs` maps run -> axis -> signal -> SignalGap, in um, arcsec, mm/s, deg/s, A."""

    machine: str
    campaign: str
    runs: Gaps
    notes: tuple[str, ...] = ()  # where the noise of the record is not that of the machine file, or encoders have no common zero

    def rows(self) -> list[Outlier]:
        """Every signal with its gap over noise, largest first."""
        found = [
            Outlier(run, axis, signal, gap, gap.times_noise)
            for run, axes in self.runs.items()
            for axis, signals in axes.items()
            for signal, gap in signals.items()
            if gap.is_compared
        ]
        return sorted(found, key=lambda row: -row.times_noise)

    @property
    def _axes(self) -> list[str]:
        return list(dict.fromkeys(axis for run in self.runs.values() for axis in run))

    @property
    def _signals(self) -> list[str]:
        """The compared signals that some run has."""
        return [s for s in COMPARED if any(s in signals for axes in self.runs.values() for signals in axes.values())]

    @property
    def outliers(self) -> list[Outlier]:
        """The signals above AS_EXPECTED, largest first."""
        return [row for row in self.rows() if row.times_noise > AS_EXPECTED]

    @property
    def verdict(self) -> str:
        """One sentence: axes that agree with the twin, then each other axis with its largest gap."""
        axes = self._axes
        compared = {row.axis for row in self.rows()}
        worst: dict[str, Outlier] = {}
        for row in self.outliers:
            worst.setdefault(row.axis, row)
        good = [axis for axis in axes if axis in compared and axis not in worst]
        parts = [f"{listed(good)} as {'they' if len(good) > 1 else 'it'} should be"] if good else []
        parts += [
            f"{axis} {plain(row.times_noise)} x noise in run {row.run} ({in_words(row.signal)})"
            for axis, row in sorted(worst.items(), key=lambda item: -item[1].times_noise)
        ]
        parts += [f"{listed(left)} not compared (no measured signal)"] if (left := [a for a in axes if a not in compared]) else []
        return "; ".join(parts)

    def summary_table(self) -> str:
        """Text table with one line per axis: largest gap of each signal over all runs, and its ratio to noise."""
        lines = []
        shown = self._signals
        for axis in self._axes:
            cells = [axis]
            for signal in shown:
                rows = [row for row in self.rows() if (row.axis, row.signal) == (axis, signal)]
                cells += (
                    [f"{plain(rows[0].gap.rms)} {rows[0].gap.unit}", f"{rows[0].times_noise:.1f}", rows[0].run] if rows else ["-", "-", "-"]
                )
            lines.append(cells)
        return table(["axis", *(text for s in shown for text in (in_words(s), "x noise", "in run"))], lines)

    def document(self) -> dict[str, Any]:
        """The document of `twin gap --json`."""
        plain = {run: {a: {s: _entry(g) for s, g in of.items()} for a, of in axes.items()} for run, axes in self.runs.items()}
        notes = {"notes": list(self.notes)} if self.notes else {}
        return {"machine": self.machine, "campaign": self.campaign, "verdict": self.verdict, "runs": plain, **notes}

    def to_table(self) -> pa.Table:
        """One row for each run, axis and signal as a pyarrow table, the largest gap over noise first."""
        import pyarrow as pa

        rows = [{"run": r.run, "axis": r.axis, "signal": r.signal, **_entry(r.gap), "times_noise": r.times_noise} for r in self.rows()]
        return pa.Table.from_pylist(rows)

    def to_pandas(self) -> Any:
        """One row for each run, axis and signal as a pandas data frame."""
        return self.to_table().to_pandas()

    def plot(self) -> Figure:
        """A heat map of gap over noise of every axis and run, one panel per signal; grey up to AS_EXPECTED. The colours suit colour-blind readers."""
        from matplotlib import colormaps
        from matplotlib.colors import LogNorm

        from twin.report import new_figure

        ratios, runs, axes = {(r.signal, r.run, r.axis): r.times_noise for r in self.rows()}, list(self.runs), self._axes
        shown = self._signals
        figure, grid = new_figure(1, len(shown), width=2.2 + 2.1 * len(shown), height=1.2 + 0.3 * len(runs), sharey=True)
        colours = colormaps["cividis_r"].with_extremes(under="#eceff3", bad="white")
        for panel, signal in zip(grid[0], shown):
            values = np.array([[ratios.get((signal, run, axis), np.nan) for axis in axes] for run in runs])
            # the scale is logarithmic, so a zero gap is drawn as SMALLEST
            image = panel.imshow(np.maximum(values, SMALLEST), aspect="auto", cmap=colours, norm=LogNorm(AS_EXPECTED, LARGEST))
            panel.set_title(in_words(signal))
            panel.set_xticks(range(len(axes)), axes)
            panel.set_yticks(range(len(runs)), runs)
            panel.grid(False)
            for i, j in np.argwhere(np.isfinite(values)):
                colour = "white" if values[i, j] > PALE * AS_EXPECTED else "#1c2430"
                panel.text(j, i, f"{values[i, j]:.{int(values[i, j] < 10)}f}", ha="center", va="center", fontsize=8, color=colour)
        if self.outliers:
            label, ticks = "gap, times noise alone", (AS_EXPECTED, 3.0, 10.0, 30.0, LARGEST)
            figure.colorbar(image, ax=list(grid[0]), label=label, extend="both", ticks=ticks, format="%g").minorticks_off()
        return figure

    def __repr__(self) -> str:
        return f"CampaignGap of {self.campaign} against {self.machine}: {self.verdict}"

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(self.verdict)}</p><pre>{html.escape(self.summary_table())}</pre>"


def gap(campaign: Campaign | str | Path, machine: Machine | None = None, *, progress: Callable[[str], None] | None = None) -> CampaignGap:
    """Simulate every run of a measured campaign and compare signal by signal.

    `campaign` is a campaign or its folder; `machine` defaults to the Mikron. `progress` is called with the name of each finished run.
    Raises InputError if no run has a measured signal, or if a set point lies outside the travel of the machine.
    """
    machine = machine or load_machine()
    known = campaign if isinstance(campaign, Campaign) else read_campaign(campaign, machine)
    check_compared(known, machine)
    noisy, notes = with_recorded_noise(machine, known.runs)
    runs, zeros = with_common_zeros(known.runs, noisy)
    predictions = predict_campaign(noisy, runs, progress=progress)
    traces = {name: prediction.trace for name, prediction in predictions.items()}
    zeros = clear_zeros(zeros_left(runs, noisy, traces), noisy) | zeros
    gaps = {run.name: gap_of(noisy, run, predictions[run.name]) for run in aligned(runs, noisy, traces)}
    return CampaignGap(machine.name, known.path.resolve().name, gaps, (*notes, *notes_of_zeros(zeros, noisy)))


def _entry(gap: SignalGap) -> dict[str, Any]:
    """The entry of a gap in `twin gap --json`."""
    return {"rms": gap.rms, "max": gap.max, "noise": gap.noise, "unit": gap.unit}
