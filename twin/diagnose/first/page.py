"""The card as a page with a picture of every axis: motion, error, effort over speed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin.diagnose.first.axis_facts import AxisFacts
from twin.diagnose.first.card import HEADING, Card, rows_of
from twin.diagnose.first.people import shown
from twin.identify.recorded_axis import Strokes
from twin.report import Figure, Section, Table, figure_svg, new_figure, save_png, write_page
from twin.report.colours import axis_colour, hexadecimal
from twin.report.figure import SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

MOST_POINTS = 4000
"""Points of a panel; more are thinned evenly."""


def write_card_page(card: Card, title: str, verdict: Sequence[str], out: Path) -> None:
    """Write `card.html` and `card.png` into the folder `out`; `verdict` are the sentences on diagnosis and next measurement."""
    figure = card_figure(card)
    sections = [
        Section("Axes", tables=[_table(card)], figures=[Figure(figure_svg(figure), _CAPTION)] if figure else []),
        Section("What is odd", items=[f"{o.axis} {o.sentence}" for o in card.odd] or ["Nothing beyond the scatter of this recording."]),
        Section("What this recording shows, and what it cannot", items=[*card.can, *(f"not: {s}" for s in card.cannot)]),
        Section("Diagnosis and next measurement", items=list(verdict)),
    ]
    lead = "".join(f"{said.removesuffix('.')}. " for said in verdict[:1])
    lead += "Below: what the axes did, what is odd, what the recording cannot show. Intervals are 95 %."
    write_page(out / "card.html", title, lead, sections)
    if figure:
        save_png(figure, out / "card.png")


def _table(card: Card) -> Table:
    """A column for each axis, without what no recording shows."""
    names, *lines = zip(HEADING, *rows_of(card))
    return Table(names, [line for line in lines if set(line[1:]) != {"-"}], words=frozenset(range(1, len(names))))


_CAPTION = (
    "Each axis in motion. Left: measured position. Middle: the part of the following error that lag and acceleration do not explain. "
    "Right: effort over speed, with inertia taken out; the step at zero is twice the Coulomb friction."
)


def card_figure(card: Card) -> MplFigure | None:
    """A row for each axis that moves; None if none does."""
    moving = [(one, one.rows) for one in card.facts if one.rows is not None]
    if not moving:
        return None
    figure, panels = new_figure(len(moving), 3, width=13.0, height=2.2)
    for i, ((one, rows), row) in enumerate(zip(moving, panels)):
        colour, thin = hexadecimal(axis_colour(one.name, i)), slice(None, None, max(1, len(rows.time) // MOST_POINTS))
        ends = [float(rows.time[rows.run == r].max(initial=0.0)) for r in range(int(rows.run.max()) + 1)]
        time = rows.time + np.concatenate([[0.0], np.cumsum(ends)])[rows.run]  # the runs one after the other
        size = shown("position", one.kind)
        row[0].plot(time[thin], rows.position[thin] * size.factor, ".", ms=1.5, color=colour)
        row[0].set_title(f"position in motion [{size.unit}]")
        row[0].set_ylabel(one.name, rotation=0, fontsize=13, fontweight="bold", labelpad=14)
        if "error" in one.left:
            size = shown("error", one.kind).at(float(np.ptp(one.left["error"])))
            row[1].plot(time[thin], one.left["error"][thin] * size.factor, ".", ms=1.5, color=colour)
            row[1].set_title(f"error beside the lag [{size.unit}]")
        else:
            _empty(row[1], "no following error recorded")
        _effort(one, rows, row[2], colour, thin)
    for panel in panels[-1][:2]:
        panel.set_xlabel("time [s]")
    return figure


def _effort(one: AxisFacts, rows: Strokes, panel: Axes, colour: str, thin: slice) -> None:
    f = one.friction
    if f is None:
        _empty(panel, "no friction seen")
        return
    size, speed, v = shown(f.effort), shown("speed", one.kind), rows.speed
    coulomb, viscous = (f.coulomb.value, f.viscous.value) if f.coulomb and f.viscous else (f.at_speed.value, 0.0)
    law = coulomb * np.sign(v) + viscous * v + (f.constant.value if f.constant else 0.0)
    panel.plot(v[thin] * speed.factor, (law + one.left[f.effort])[thin], ".", ms=1.5, color=SOFT)
    order = np.argsort(v)
    panel.plot(v[order][thin] * speed.factor, law[order][thin], color=colour, lw=1.6)
    panel.set_title(f"{f.effort} without inertia [{size.unit}]")
    panel.set_xlabel(f"speed [{speed.unit}]")


def _empty(panel: Axes, words: str) -> None:
    panel.set_axis_off()
    panel.text(0.5, 0.5, words, ha="center", va="center", color=SOFT, transform=panel.transAxes)
