"""The card as a page with a picture of every axis: motion, error, effort over speed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin.diagnose.first.axis_facts import AxisFacts
from twin.diagnose.first.card import HEADING, Card, rows_of
from twin.diagnose.first.people import shown_effort, shown_error, shown_position, shown_speed
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
        Section("Axes", tables=[Table(HEADING, rows_of(card), left=2)], figures=[Figure(figure_svg(figure), _CAPTION)] if figure else []),
        Section("What is odd", items=[f"{o.axis} {o.sentence}" for o in card.odd] or ["Nothing beyond the scatter of this recording."]),
        Section("What this recording shows, and what it cannot", items=[*card.can, *(f"not: {s}" for s in card.cannot)]),
        Section("Diagnosis and next measurement", items=list(verdict)),
    ]
    lead = "The first answer to a recording: what the axes did, what is odd, what the recording cannot show. Intervals are 95 %."
    write_page(out / "card.html", title, lead, sections)
    if figure:
        save_png(figure, out / "card.png")


_CAPTION = (
    "Each axis in motion. Left: measured position. Middle: the part of the following error that lag and acceleration do not explain. "
    "Right: effort over speed, with inertia taken out; the step at zero is twice the Coulomb friction."
)


def card_figure(card: Card) -> MplFigure | None:
    """A row for each axis that moves; None if none does."""
    moving = [one for one in card.facts if one.rows is not None]
    if not moving:
        return None
    figure, panels = new_figure(len(moving), 3, width=13.0, height=2.2)
    for i, (one, row) in enumerate(zip(moving, panels)):
        colour = hexadecimal(axis_colour(one.name, i))
        _position(one, row[0], colour)
        _error(one, row[1], colour)
        _effort(one, row[2], colour)
        row[0].set_ylabel(one.name, rotation=0, fontsize=13, fontweight="bold", labelpad=14)
    for panel, label in zip(panels[-1], ("time [s]", "time [s]", None)):
        if label:
            panel.set_xlabel(label)
    return figure


def _runs_in_a_row(one: AxisFacts) -> np.ndarray:
    """Times (row,) [s] with the runs one after the other."""
    assert one.rows is not None
    ends = [float(one.rows.time[one.rows.run == r].max(initial=0.0)) for r in range(int(one.rows.run.max()) + 1)]
    return one.rows.time + np.concatenate([[0.0], np.cumsum(ends)])[one.rows.run]


def _thinned(count: int) -> slice:
    return slice(None, None, max(1, count // MOST_POINTS))


def _position(one: AxisFacts, panel: Axes, colour: str) -> None:
    assert one.rows is not None
    size, thin = shown_position(one.kind), _thinned(len(one.rows.time))
    panel.plot(_runs_in_a_row(one)[thin], one.rows.position[thin] * size.factor, ".", ms=1.5, color=colour)
    panel.set_title(f"position in motion [{size.unit}]")


def _error(one: AxisFacts, panel: Axes, colour: str) -> None:
    assert one.rows is not None
    if "error" not in one.left:
        _empty(panel, "no following error recorded")
        return
    size, thin = shown_error(one.kind), _thinned(len(one.rows.time))
    panel.plot(_runs_in_a_row(one)[thin], one.left["error"][thin] * size.factor, ".", ms=1.5, color=colour)
    panel.set_title(f"error beside the lag [{size.unit}]")


def _effort(one: AxisFacts, panel: Axes, colour: str) -> None:
    assert one.rows is not None
    f = one.friction
    if f is None:
        _empty(panel, "no friction seen")
        return
    size, speed, thin = shown_effort(f.effort), shown_speed(one.kind), _thinned(len(one.rows.time))
    v = one.rows.speed
    coulomb, viscous = (f.coulomb.value, f.viscous.value) if f.coulomb and f.viscous else (f.at_speed.value, 0.0)
    law = coulomb * np.sign(v) + viscous * v + (f.constant.value if f.constant else 0.0)
    panel.plot(v[thin] * speed.factor, (law + one.left[f.effort])[thin], ".", ms=1.5, color=SOFT)
    order = np.argsort(v)
    panel.plot(v[order][thin] * speed.factor, law[order][thin], color=colour, lw=1.6)
    panel.set_title(f"{f.effort} without inertia [{size.unit}] over speed [{speed.unit}]")


def _empty(panel: Axes, words: str) -> None:
    panel.set_axis_off()
    panel.text(0.5, 0.5, words, ha="center", va="center", color=SOFT, transform=panel.transAxes)
