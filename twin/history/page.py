"""The page of a history: what changed first, then one row an axis with its sizes over time."""

from datetime import datetime
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from twin.diagnose.wording import effect_title, sentence_case
from twin.history.judge import LEAST
from twin.report import Figure, Section, Table, figure_svg, new_figure, write_page
from twin.report.figure import BLUE, RED, SOFT
from twin.units import in_words, plain

SHOWN = 5
"""Sparklines in the row of an axis."""


def write_history_page(document: dict[str, Any], path: Path) -> None:
    """Write the page."""
    changes, rule = document["changes"], document["rule"]
    lead = "; ".join(c["sentence"] for c in changes) or "no change beyond what normally differs between recordings"
    rows = [[c["onset"][:10], c["alarm"][:10], c["sentence"]] for c in changes]
    folded = [
        Table(
            ("effect", "scatter [usual sizes]", "smallest change that shows", "now"),
            [
                [in_words(e["effect"]), f"{e['scatter']:.3f}", f"{e['smallest_change']:.2f}", f"{e['usual_sizes'][-1]:+.3f}"]
                for e in effects
            ],
            folded=f"All effects of axis {axis}",
        )
        for axis, effects in document["axes"].items()
    ]
    drill = [f"{sentence_case(effect_title(c))}, in depth: {c['diagnose']}" for c in changes]
    sections = [
        Section("What changed", items=drill, tables=[Table(("since", "alarm", "what"), rows, left=2, words=frozenset({2}))] if rows else [],
                paragraphs=[f"One rule for all {rule['causes']} effects and axes: at most one false alarm in {rule['mean_recordings_between_false_alarms']:.0f} "
                            f"recordings. The evidence for a further change is {plain(rule['statistic'])} now; the alarm is at {rule['alarm_at']:.0f}."]),
        Section("Sizes over time", figures=[Figure(figure_svg(sparklines(document)), "One row for each axis: the effects that moved most. Size in usual sizes of the "
                "effect as a fault, free of temperature, season, tool and workpiece; grey: twice the scatter between recordings; red: since the onset.")],
                tables=folded),
        Section("What cannot be seen", items=[effect_title(c) for c in document["not_seen"]] or ["Every watched effect shows."],
                paragraphs=[f"Not watched: {', '.join(in_words(n) for n in document['not_watched'])}. A diagnosis finds them."]),
        *([Section("Notes", items=document["notes"])] if document["notes"] else []),
    ]  # fmt: skip
    write_page(path, f"History: {document['machine']}", f"{sentence_case(lead)}.", sections)


def sparklines(document: dict[str, Any]) -> Any:
    """One row an axis, its effects that moved most over time."""
    axes = document["axes"]
    days = [datetime.fromisoformat(c["day"]) for c in document["campaigns"]]
    changed = {(c["effect"], c["axis"]): datetime.fromisoformat(c["onset"]) for c in document["changes"]}
    figure, panels = new_figure(max(len(axes), 1), SHOWN, height=1.15)
    for row, (axis, effects) in zip(panels, axes.items()):
        # those that changed, then those that moved most in their scatter
        moved = {e["effect"]: np.max(np.abs(e["usual_sizes"])) / max(np.nan_to_num(e["scatter"]), LEAST / 5.0) for e in effects}
        order = sorted(effects, key=lambda e: ((e["effect"], axis) not in changed, -moved[e["effect"]]))[:SHOWN]
        for panel, effect in zip(row, order):
            when = [days[i] for i in effect["campaigns"]]
            y, wide = np.array(effect["usual_sizes"]), 2.0 * np.nan_to_num(effect["scatter"])
            panel.axhspan(-wide, wide, color=SOFT, alpha=0.2, lw=0)
            panel.plot(when, y, color=BLUE, lw=0.9)
            if onset := changed.get((effect["effect"], axis)):
                since = [d >= onset for d in when]
                panel.plot(np.array(when)[since], y[since], color=RED, lw=1.2)
            panel.set_title(fill(in_words(effect["effect"]), 18), fontsize=7.5)
            low, high = panel.get_ylim()
            panel.set_ylim(min(low, -LEAST), max(high, LEAST))
            panel.tick_params(labelsize=6.5)
            panel.set_xticks([when[0], when[-1]], [f"{when[0]:%y-%m-%d}", f"{when[-1]:%y-%m-%d}"])
            panel.grid(visible=False)
        for panel in row[len(order) :]:
            panel.set_visible(False)
        row[0].set_ylabel(axis, rotation=0, fontsize=11, labelpad=10)
    return figure
