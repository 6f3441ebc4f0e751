"""Pictures of laws: measured points with their confidence band, and the formula."""

from collections.abc import Sequence

import numpy as np

from twin.diagnose.law.laws import FoundLaw
from twin.diagnose.law.relations import variable_of
from twin.effects.law import VARIABLES, law_in
from twin.effects.law_shapes import JITTER
from twin.estimate.regression import NORMAL_95
from twin.machine.machine import Machine
from twin.report.figure import AMBER, BLUE, SOFT, new_figure
from twin.simulation.law_picture import draw_response, output_in, shown_in
from twin.units import AXIS_UNITS, in_words

HARDLY = 0.002
"""Largest fraction of the samples at a point that is hardly measured."""


def laws_figure(laws: Sequence[FoundLaw], machine: Machine):  # type: ignore[no-untyped-def]
    """One panel per law: the measured curve with its band and the formula; points with few samples are marked."""
    figure, places = new_figure(len(laws), 1, 8.6, 3.1)
    for place, law in zip(places[:, 0], laws):
        axis = machine.axis(law.axis)
        source = machine.axis(law.setting.from_axis) if law.setting.from_axis else axis
        table = law_in(law.setting)
        curve = law.measured.curve
        place.set_title(f"axis {law.axis}, {law.block}")
        if table.shape.is_filter:
            low, high = curve.y - NORMAL_95 * curve.band, curve.y + NORMAL_95 * curve.band
            place.fill_between(curve.x, low, high, color=SOFT, alpha=0.35, lw=0)
            place.plot(curve.x, curve.y, "o", color=SOFT, markersize=3.5, label="measured, with 95 % band")
            draw_response(place, table, law.setting.parameters, machine, BLUE)
            place.legend(loc="lower left")
            continue
        unit, factor = output_in(table, axis)
        x_unit, per = shown_in(VARIABLES[table.variable].quantity, source)
        if table.variable == "following_error":
            x_unit, per = AXIS_UNITS[axis.kind].error
        x = np.linspace(curve.x[0], curve.x[-1], 500)
        formula = table.values(x, law.setting.parameters, axis)
        # level and, over a speed, slope belong to the nominal machine: fit both curves to the same ones
        weight = np.sqrt(_sample_density(law, curve.x))
        apart = curve.y - np.interp(curve.x, x, formula)
        y = (
            curve.y
            if table.shape.code == JITTER
            else curve.y - curve.free @ np.linalg.lstsq(curve.free * weight[:, None], apart * weight, rcond=None)[0]
        )
        place.fill_between(
            per * curve.x, factor * (y - NORMAL_95 * curve.band), factor * (y + NORMAL_95 * curve.band), color=SOFT, alpha=0.35, lw=0
        )
        place.plot(per * curve.x, factor * y, "o", color=SOFT, markersize=3.5, label="measured, with 95 % band")
        place.plot(per * x, factor * formula, color=BLUE, linewidth=1.8, label=str(table.definition().get("formula", "table")))
        hardly = weight**2 < HARDLY
        place.plot(per * curve.x[hardly], factor * y[hardly], "o", color=AMBER, markersize=3.5)
        span = max(float(np.ptp(formula)), 1e-300) * factor
        middle = 0.5 * factor * float(formula.max() + formula.min())
        place.set_ylim(middle - 0.9 * span, middle + 0.9 * span)
        place.set_xlabel(f"{in_words(table.variable)}{f' of {source.name}' if source is not axis else ''} [{x_unit or '1'}]")
        place.set_ylabel(f"{in_words(table.output)} [{unit}]")
        place.legend(loc="lower right" if formula[0] < formula[-1] else "upper left")
    return figure


def _sample_density(law: FoundLaw, at: np.ndarray) -> np.ndarray:
    """Fraction of the samples closest to each point (point,)."""
    x = variable_of(law.samples, law.measured.relation)
    period = law.measured.relation.wraps
    x = np.mod(x, period) if period else x
    edges = np.concatenate([[-np.inf], 0.5 * (at[1:] + at[:-1]), [np.inf]])
    share: np.ndarray = np.histogram(x, edges)[0] / max(len(x), 1)
    return share
