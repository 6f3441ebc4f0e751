"""The usual plots of the standards: deviations over the axis with their bands, and the circle with magnified deviations."""

from collections.abc import Mapping
import math
from pathlib import Path

import numpy as np

from twin.iso230.circles import QUADRANTS, CircleTest
from twin.iso230.positioning import COVERAGE, WAYS, Positioning
from twin.report.figure import AMBER, BLUE, GREEN, INK, RED, SOFT, new_figure, save_png
from twin.units import AXIS_UNITS, plain, round_up

COLOURS = {"forward": BLUE, "backward": RED, "ccw": BLUE, "cw": RED}
OTHERS = {"ccw": GREEN, "cw": AMBER}
"""Colours of the circles beside the first one."""


def draw_positioning(results: Mapping[str, Positioning], kinds: Mapping[str, str], path: Path) -> None:
    """One panel per axis: mean deviation of both directions, bands of two standard deviations, A marked."""
    figure, axes = new_figure(len(results), 1, height=4.2)
    for (name, found), ax in zip(results.items(), axes[:, 0]):
        (unit, length), (fine, small) = AXIS_UNITS[kinds[name]].position, AXIS_UNITS[kinds[name]].error
        target, mean = found.target * length, found.mean * small
        lower, upper = mean - COVERAGE * found.spread * small, mean + COVERAGE * found.spread * small
        for i, direction in enumerate(WAYS):
            colour = COLOURS[direction]
            ax.plot(target, mean[i], "o-", color=colour, lw=1.6, ms=4, label=f"{direction}, mean and 2 standard deviations")
            ax.fill_between(target, lower[i], upper[i], color=colour, alpha=0.15, lw=0)
        ax.plot(target, mean.mean(axis=0), color=SOFT, lw=1.0, ls="--", label="mean of both directions")
        for level, label in ((upper.max(), "largest and smallest: A between them"), (lower.min(), None)):
            ax.axhline(level, color=INK, lw=0.8, ls=(0, (1, 2)), label=label)
        numbers = ",  ".join(f"{k} {plain(found.numbers[k] * small)}" for k in ("A", "R", "E", "M", "B"))
        ax.set_title(f"ISO 230-2, axis {name}:  {numbers} {fine}" if name else f"ISO 230-2:  {numbers} {fine}")
        ax.set(xlabel=f"target [{unit}]", ylabel=f"deviation [{fine}]")
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    save_png(figure, path)


def draw_circles(tests: Mapping[str, CircleTest], path: Path) -> None:
    """Polar plot of one circle with magnified deviations. `tests` by label, at most three: 'measured', 'predicted', 'corrected'."""
    figure, ((polar, flat),) = new_figure(1, 2, height=5.6)
    deviations = [p.distance - t.radius for t in tests.values() for p in t.paths.values()]
    worst = max(float(np.abs(d).max()) for d in deviations) * 1e6
    step = round_up(max(worst, 1e-3) / 4.0)  # a division: four hold the largest deviation
    # the radius of the nominal circle is eight divisions, so that the largest deviation stays well inside
    ring = 8.0
    turn = np.linspace(0.0, 2.0 * math.pi, 361)
    for division in range(-4, 5):
        size = ring + division
        polar.plot(size * np.cos(turn), size * np.sin(turn), color=INK if division == 0 else "#d5dbe1", lw=1.2 if division == 0 else 0.6)
    for quadrant in QUADRANTS:
        polar.plot(*np.outer([np.cos(np.radians(quadrant)), np.sin(np.radians(quadrant))], [0.0, ring + 4.5]), color="#d5dbe1", lw=0.6)
    lines = (COLOURS, 1.5, "-"), (OTHERS, 1.0, "--"), (OTHERS, 1.0, ":")
    for (name, test), (colours, width, style) in zip(tests.items(), lines):
        for direction, one in test.paths.items():
            line = {"color": colours[direction], "lw": width, "ls": style}
            shown = ring + (one.distance - test.radius) * 1e6 / step
            polar.plot(shown * np.cos(one.angle), shown * np.sin(one.angle), **line, label=f"{name}, {direction}")
            angle = np.mod(one.angle, 2.0 * math.pi)
            order = np.argsort(angle)
            flat.plot(np.degrees(angle[order]), (one.distance - test.radius)[order] * 1e6, **line)
    first = next(iter(tests.values()))
    polar.set_aspect("equal")
    polar.set_axis_off()
    polar.text(ring + 4.6, 0.0, f"+{first.axes[0]}", ha="left", va="center")
    polar.text(0.0, ring + 4.6, f"+{first.axes[1]}", ha="center", va="bottom")
    polar.text(0.0, 0.0, f"{step:g} um\nper division", ha="center", va="center", color=SOFT)
    feed = f", {first.feed * 60:.3g} m/min" if first.feed > 0.0 else ""
    polar.set_title(f"ISO 230-4, {first.name}, radius {first.radius * 1e3:.4g} mm{feed}")
    polar.legend(loc="lower left", bbox_to_anchor=(-0.05, -0.08), ncols=2)
    flat.set_title("the same, unrolled")
    flat.set(xlabel=f"angle from +{first.axes[0]} [deg]", ylabel="radius minus nominal [um]", xticks=range(0, 361, 45))
    save_png(figure, path)
