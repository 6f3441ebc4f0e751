"""Pictures of the changes since a baseline: what was recorded then and now where a change shows clearest, and its change beside that of the twin."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from matplotlib.figure import Figure
import numpy as np
from scipy.ndimage import uniform_filter1d

from twin.diagnose.report_figures import CORRECTED, MEASURED, MOST_POINTS, NOISE, signal_of
from twin.diagnose.settings import T
from twin.diagnose.simulations import simulate_group
from twin.errors import TwinError
from twin.history.projection import reference_view
from twin.history.series import same_program
from twin.history.since import Difference
from twin.history.watch import program_of
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.recordings.trace import Trace
from twin.report import new_figure
from twin.units import in_words

DRAWN = {"position": "following error"}
"""A position is drawn as the following error."""

WINDOW_S = 2.0
"""Length of the interval that is drawn [s]."""


class ShownChange(NamedTuple):
    """One signal (sample,) in `unit` over an interval, smoothed: recorded then and now, and the change that the twin makes of the causes found."""

    axis: str
    run: str
    signal: str
    unit: str
    time: np.ndarray
    then: np.ndarray
    now: np.ndarray
    twin: np.ndarray

    @property
    def caption(self) -> str:
        return f"Axis {self.axis}, run {self.run}, where the change shows clearest; means over {1e3 * T.smooth_s:.0f} ms."


def where_changes_show(
    changes: Sequence[Difference], present: Campaign, baselines: Sequence[Campaign], reference: Machine, today: Machine
) -> list[ShownChange]:
    """Where each change shows clearest, each place once; without those that have no recording of the same set points, or cannot be simulated."""
    runs = {run.name: run for run in present.runs}
    earlier = [run for baseline in baselines for run in baseline.runs]
    places = dict.fromkeys(
        (one.runs[0], axis, DRAWN.get(channel, channel)) for one in changes if one.shows for axis, channel in [one.shows]
    )
    found = (_shown(runs[name], earlier, axis, signal, reference, today) for name, axis, signal in places)
    return [shown for shown in found if shown is not None]


def _shown(
    run: MeasuredRun, earlier: Sequence[MeasuredRun], axis: str, signal: str, reference: Machine, today: Machine
) -> ShownChange | None:
    """A signal of an axis where the twin changes it most. None without a recording of the same set points, or if a machine cannot be simulated."""
    own = reference.axis(axis)
    signal = own.recorded_as(signal)
    apart = _offset(run, earlier, axis)
    if apart is None:
        return None
    before, first, start = apart
    try:
        traces = [simulate_group(reference_view(machine, run), (axis,)).without_noise for machine in (reference, today)]
    except TwinError:
        return None
    smooth = max(1, round(T.smooth_s / run.trace.period))
    unit = signal_of(own, run.trace, run.trace, signal)[1]

    def values(trace: Trace, measured: Trace) -> np.ndarray:
        return np.asarray(uniform_filter1d(signal_of(own, trace, measured, signal)[0], smooth))

    count = min(len(run.trace.time) - first, len(before.time) - start)
    without, with_changes = (values(trace, run.trace) for trace in traces)
    twin, now = (values_of[first:][:count] for values_of in (with_changes - without, values(run.trace, run.trace)))
    then = values(before, before)[start:][:count]
    width = min(count, max(1, round(WINDOW_S / run.trace.period)))
    at = int(np.argmax(np.convolve(np.square(twin), np.ones(width), "valid")))
    part = slice(at, at + width, max(1, width // MOST_POINTS))
    return ShownChange(axis, run.name, signal, unit, run.trace.time[first:][part], then[part], now[part], twin[part])


def _offset(run: MeasuredRun, earlier: Iterable[MeasuredRun], axis: str) -> tuple[Trace, int, int] | None:
    """The latest earlier recording of the same program with the same set points of this axis, and the samples of both where the axis begins to move."""
    if not run.trace.has(axis, "setpoint"):
        return None
    found, program = None, program_of([run])
    for one in earlier:
        if one.feedforward != run.feedforward or abs(one.trace.period / run.trace.period - 1.0) > 1e-6:
            continue
        if not same_program(program_of([one]), program):
            continue
        points = [trace.get(axis, "setpoint") for trace in (run.trace, one.trace)]
        first, start = (int(np.argmax(np.diff(p) != 0.0)) for p in points)
        count = min(len(points[0]) - first, len(points[1]) - start)
        now, then = points[0][first:][:count], points[1][start:][:count]
        if np.abs(now - then).max() <= 1.5 * np.abs(np.diff(now)).max():  # one sample apart
            found = one.trace, first, start
    return found


def change_figure(shown: ShownChange) -> Figure:
    """The signal then and now, and its change beside that of the twin."""
    figure, parts = new_figure(2, 1, 12.6, 2.2, sharex=True)
    above, below = parts[:, 0]
    above.plot(shown.time, shown.then, color=NOISE, linewidth=1.3, label="recorded then")
    above.plot(shown.time, shown.now, color=MEASURED, linewidth=1.3, label="recorded now")
    above.set_ylabel(f"{in_words(shown.signal)} [{shown.unit}]", fontsize=9)
    below.plot(shown.time, shown.now - shown.then, color=MEASURED, linewidth=4.0, alpha=0.35, label="recorded change")
    below.plot(shown.time, shown.twin, color=CORRECTED, linewidth=1.3, label="the twin with what it found")
    below.set_ylabel(f"change [{shown.unit}]", fontsize=9)
    below.set_xlabel("time in the run [s]", fontsize=9)
    for ax in (above, below):
        ax.margins(x=0)
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=2, fontsize=9, frameon=False, borderpad=0.1)
    figure.align_ylabels()
    return figure
