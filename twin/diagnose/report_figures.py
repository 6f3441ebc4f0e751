"""Figures of the report: waterfall of the gap, map of axes and blocks, curves of an interval. Each function returns a figure.

Colours: measured black, machine file orange, corrected machine blue, noise grey.
"""

import base64
from collections.abc import Sequence
import html
from textwrap import fill
from typing import Any

from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
import numpy as np

from twin.diagnose.budget import FINDINGS
from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.report_contents import BLOCKS_NEED, MARGIN, Stretch
from twin.diagnose.wording import effect_title, percent, times
from twin.machine.machine import Axis
from twin.recordings.trace import ENCODERS, Trace
from twin.report import Figure as Picture
from twin.report import figure_svg, new_figure
from twin.simulation.errors_of_run import delayed_set_point
from twin.simulation.gap import gap_unit, is_moving, sensor_noise
from twin.simulation.motor_and_scale import has_both, motor_minus_scale
from twin.units import in_words, plain

MEASURED, NOMINAL, CORRECTED = "#15181c", "#e07b10", "#1764c0"
NOISE, CLOSED = "#8b929c", "#b9d3f0"
HEAT = LinearSegmentedColormap.from_list("heat", ["#fff7e6", "#ffcc73", "#ed7333", "#b81c1c"], gamma=0.7)
"""Colour of a share, from white over yellow to red."""
WORTH_A_SHARE = 0.1
"""Smallest drop of the squared level with shares."""
MOST_POINTS = 4000
"""Largest number of points of a curve in the page."""


def image(figure: Figure, caption: str) -> Picture:
    """The figure as an image of the page, which keeps its many points out of the text."""
    data = base64.b64encode(figure_svg(figure).encode()).decode()
    return Picture(f'<img alt="{html.escape(caption)}" src="data:image/svg+xml;base64,{data}">', caption)


def closes_something(steps: Sequence[tuple[str, float]]) -> bool:
    """Whether the correction has effects or laws, or re-tuning closes a part of the gap that is worth a share."""
    return len(steps) > 2 or steps[0][1] ** 2 - steps[-1][1] ** 2 > WORTH_A_SHARE


def waterfall_figure(steps: Sequence[tuple[str, float]]) -> Figure:
    """Gap in multiples of noise; each bar is what one step closes, the last bar what remains. Only the first if nothing is closed."""
    figure, ((ax,),) = new_figure(1, 1, 6.2, 3.5)
    if not closes_something(steps):
        steps = steps[:1]
    levels = [level for _, level in steps]
    ax.bar(0, levels[0], color=NOMINAL, width=0.62)
    for i in range(1, len(steps)):
        low, high = sorted((levels[i - 1], levels[i]))
        grown = levels[i] > levels[i - 1]
        ax.bar(i, high - low, bottom=low, color="#d9534f" if grown else CLOSED, edgecolor=CORRECTED, linewidth=0.8, width=0.62)
        ax.plot([i - 1 + 0.31, i + 0.31], [levels[i - 1]] * 2, color=NOISE, linewidth=0.8)
    names, ends = [label for label, _ in steps], [(0, levels[0])]
    if len(steps) > 1:
        names.append("corrected machine")
        ends.append((len(steps), levels[-1]))
        ax.bar(len(steps), levels[-1], color=CORRECTED, width=0.62)
        ax.plot([len(steps) - 0.69, len(steps) + 0.31], [levels[-1]] * 2, color=NOISE, linewidth=0.8)
    top = max(*levels, 1.0)
    ax.axhline(1.0, color=NOISE, linestyle=(0, (4, 3)), linewidth=1.2)
    if len(levels) > 1 and levels[1] > 1.0 + 0.1 * top:  # space below the second bar
        ax.text(1, 1.0 + 0.012 * top, "1: noise alone", color="#5c636d", fontsize=8, va="bottom", ha="center")
    for i, level in ends:
        ax.text(i, level + 0.02 * top, times(level), ha="center", fontsize=11, weight="bold", color=MEASURED)
    total = levels[0] ** 2 - levels[-1] ** 2
    for i in range(1, len(steps) if total > WORTH_A_SHARE else 0):
        share = (levels[i - 1] ** 2 - levels[i] ** 2) / total
        closed = f"+{percent(-share)}" if share <= -0.005 else percent(share)
        ax.text(i, max(levels[i - 1], levels[i]) + 0.02 * top, closed, ha="center", fontsize=9.5, color=CORRECTED)
    labels = [fill(label, max(9, 76 // (len(steps) + 1))) for label in names]
    ax.set_xticks(range(len(labels)), labels, fontsize=8.5 if len(labels) < 7 else 7.5)
    ax.set_ylim(0.0, 1.16 * top)
    ax.set_ylabel("gap, multiples of noise (RMS)", fontsize=9)
    return figure


BUDGET_SHOWN = 12
"""Contributions that are shown one by one."""


def budget_figure(budget: dict[str, Any]) -> Figure:
    """Contribution of each effect at the tool point, largest first, then the unexplained rest (hatched) and the noise floor.

    For a program, which was not measured, the first bar is the combined change by all effects.
    """
    measured = "after" in budget
    effects = [r for r in budget["rows"] if r["kind"] in FINDINGS]
    other = [r for r in budget["rows"] if r["kind"] not in FINDINGS]
    shown = effects[:BUDGET_SHOWN]
    whole = ("gap of the machine file", budget["before"]) if measured else ("all together", budget["change"])
    bars: list[tuple[str, float, str]] = [(*whole, NOMINAL)]
    bars += [(effect_title(r), r["tool_point"], CORRECTED) for r in shown]
    for label, group in ((f"{len(effects) - len(shown)} smaller effects", effects[len(shown) :]), ("re-tuned and normal", other)):
        if group:
            bars.append((label, float(np.sqrt(sum(r["tool_point"] ** 2 for r in group))), CLOSED))
    names, values = [name for name, _, _ in bars], [value for _, value, _ in bars]
    figure, ((ax,),) = new_figure(1, 1, 8.6, 1.1 + 0.27 * (len(bars) + measured))
    for i, (_, value, color) in enumerate(bars):
        ax.barh(i, value, color=color, height=0.64)
    for i, row in enumerate(shown, start=1):
        ax.plot([row["low"], row["high"]], [i, i], color=MEASURED, linewidth=1.2)
    if measured:
        ax.barh(len(bars), budget["after"], facecolor="white", edgecolor="#c9302c", hatch="////", height=0.64)
        names, values = [*names, "not explained"], [*values, budget["after"]]
        ax.axvline(budget["floor"], color=NOISE, linestyle=(0, (4, 3)), linewidth=1.2)
        ax.text(budget["floor"], -0.75, " noise floor", color="#5c636d", fontsize=8, va="center")
    ends = dict(enumerate((row["high"] for row in shown), start=1))
    for i, value in enumerate(values):
        ax.text(max(value, ends.get(i, 0.0)), i, f"  {plain(value)} um", va="center", fontsize=8.5, color=MEASURED)
    ax.set_yticks(range(len(names)), names, fontsize=8.5)
    ax.set_ylim(len(names) - 0.4, -1.1)
    ax.set_xlim(0.0, 1.14 * max(*values, budget.get("floor", 0.0), 1e-9))
    ax.set_xlabel(f"um at the tool point, RMS over {'the campaign' if measured else budget['program']}", fontsize=9)
    return figure


def map_figure(axes: Sequence[str], rows: Sequence[Sequence[tuple[str, float, float]]]) -> Figure:
    """Share of the gap by axis and block, with the level of the block's residual over noise."""
    figure, ((ax,),) = new_figure(1, 1, 6.2, 1.1 + 0.48 * len(axes))
    ax.grid(visible=False)
    for r, row in enumerate(rows):
        for b, (state, share, level) in enumerate(row):
            colour = HEAT(share) if state == "place" else "#eef3ee" if state == "healthy" else "#ffffff"
            hatch = "////" if state == "unseen" else None
            ax.add_patch(Rectangle((b + 0.03, r + 0.04), 0.94, 0.92, facecolor=colour, edgecolor="#d8dce2", hatch=hatch, linewidth=0.8))
            if state == "place":
                ink = "white" if share > 0.45 else MEASURED
                ax.text(b + 0.5, r + 0.38, percent(share), ha="center", va="center", fontsize=11, weight="bold", color=ink)
                ax.text(b + 0.5, r + 0.73, f"{times(level)} × noise" if level else "", ha="center", va="center", fontsize=7.5, color=ink)
            elif state == "healthy":
                ax.text(b + 0.5, r + 0.5, "as specified", ha="center", va="center", fontsize=7.5, color="#6b8a6f")
            else:
                ax.text(
                    b + 0.5, r + 0.5, "not recorded", ha="center", va="center", fontsize=7.5, color=NOISE,
                    bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
                )  # fmt: skip
    ax.set_xlim(0, len(BLOCKS_NEED))
    ax.set_ylim(len(axes), 0)
    ax.set_xticks(
        np.arange(len(BLOCKS_NEED)) + 0.5, [b.replace(" controller", "\ncontroller").replace(" loop", "\nloop") for b in BLOCKS_NEED]
    )
    ax.set_yticks(np.arange(len(axes)) + 0.5, axes, weight="bold")
    ax.tick_params(length=0, top=False, labelsize=9.5)
    ax.xaxis.set_ticks_position("top")
    ax.spines[:].set_visible(False)
    return figure


def stretch_figure(diagnosis: Diagnosis, stretch: Stretch) -> Figure:
    """Following error, signal of the block, and gap, measured against both machines."""
    run = next(r for r in diagnosis.campaign.runs if r.name == stretch.run)
    axis = diagnosis.machine.axis(stretch.axis)
    margin = MARGIN * (stretch.stop - stretch.start)
    shown = np.flatnonzero((run.trace.time >= stretch.start - margin) & (run.trace.time <= stretch.stop + margin))
    shown = shown[:: max(1, -(-len(shown) // MOST_POINTS))]
    series = [
        ("measured", MEASURED, run.trace),
        ("machine file as it is", NOMINAL, diagnosis.held_out.predictions["before"][run.name].trace),
        ("corrected machine", CORRECTED, diagnosis.held_out.predictions["after"][run.name].trace),
    ]
    panels = _panels(axis, run.trace, stretch.block)
    figure, parts = new_figure(len(panels) + 1, 1, 12.6, 2.2, sharex=True)
    parts = parts[:, 0]
    time = run.trace.time[shown]
    for ax, (label, signals) in zip(parts, panels):
        for name, colour, trace in series:
            values, unit = signal_of(axis, trace, run.trace, signals)
            wide = {"linewidth": 4.0, "alpha": 0.35} if name == "measured" else {"linewidth": 1.3}
            ax.plot(time, values[shown], color=colour, label=name, **wide)
        ax.set_ylabel(f"{label} [{unit}]", fontsize=9)
    signal = _gap_signal(run.trace, axis, stretch.block)
    unit, factor = gap_unit(axis, signal)
    scatter = diagnosis.held_out.predictions["after"][run.name].scatter[axis.name, signal]
    noise = 2.0 * factor * np.hypot(scatter, sensor_noise(diagnosis.machine, axis, signal))[shown]
    parts[-1].fill_between(
        time, -noise, noise, color="#d5dae1", zorder=0, linewidth=0, label="noise: sensor, and the motion it causes (95 %)"
    )
    for name, colour, trace in series[1:]:
        difference = (run.trace.get(axis.name, signal) - trace.get(axis.name, signal)) * factor
        if signal == axis.effort:
            difference = np.where(is_moving(run.trace, axis), difference, np.nan)
        parts[-1].plot(time, difference[shown], color=colour, linewidth=1.3, label=f"measured − {name}")
    parts[-1].set_ylabel(f"gap of {in_words(signal)} [{unit}]", fontsize=9)
    parts[-1].set_xlabel("time in the run [s]", fontsize=9)
    for ax in parts:
        ax.axvspan(stretch.start, stretch.stop, color="#fff6d6", zorder=-1)
        ax.margins(x=0)
    for ax in (parts[0], parts[-1]):
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=3, fontsize=9, frameon=False, borderpad=0.1)
    figure.align_ylabels()
    return figure


def _panels(axis: Axis, measured: Trace, block: str) -> list[tuple[str, str]]:
    """Panels of an interval, as far as recorded: (label, signal)."""
    panels = []
    if measured.has(axis.name, "position"):
        panels.append(("following error", "following error"))
    if block in ("transmission", "measurement") and has_both(measured, axis.name):
        panels.append(("motor − scale", "motor_minus_scale"))
    elif measured.has(axis.name, axis.effort):
        panels.append((axis.effort, axis.effort))
    signal = _gap_signal(measured, axis, block)
    return panels or [(in_words(signal), signal)]


def signal_of(axis: Axis, trace: Trace, measured: Trace, signal: str) -> tuple[np.ndarray, str]:
    """A signal of a panel (sample,) and its unit; the following error, without the position delay, by the set points of the recording."""
    unit, factor = gap_unit(axis, "position")
    if signal == "following error":
        delayed = delayed_set_point(measured, axis)
        return (delayed - trace.get(axis.name, measured.measured_position(axis.name) or "position")) * factor, unit
    if signal == "motor_minus_scale":
        return motor_minus_scale(trace, axis.name) * factor, unit
    unit, factor = gap_unit(axis, signal)
    return trace.get(axis.name, signal) * factor, unit


def _gap_signal(measured: Trace, axis: Axis, block: str) -> str:
    """The signal whose gap is drawn: the current for faults of the mechanics, otherwise the position."""
    first = (axis.effort,) if block in ("mechanics", "current loop", "speed controller") else ()
    return next(s for s in (*first, *ENCODERS, "velocity", axis.effort) if measured.has(axis.name, s))
