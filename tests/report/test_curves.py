"""Curves over time: labels of peaks apart from each other, bands instead of solid blocks, a colour of its own for each axis, numbers that people read."""

import numpy as np
import pytest

from twin.report.curves import Curve, Panel, curves_figure
from twin.units import plain

TIME = np.arange(0.0, 3.0, 125e-6)


@pytest.mark.parametrize(("swing", "band"), [(0.0, False), (0.2, True)])
def test_a_curve_that_swings_within_a_line_is_a_band(swing: float, band: bool) -> None:
    """The saw-tooth of a current at 500 Hz; its moving mean stays the line."""
    slow = np.sin(4.0 * TIME)
    figure = curves_figure(TIME, [Panel("current", [Curve("", slow + swing * np.sign(np.sin(3140.0 * TIME)), "X")])], "")
    (axes,) = figure.axes
    (line,) = axes.lines
    assert bool(axes.collections) == band
    assert (axes.get_legend() is not None) == band  # it says what the band is
    x, y = line.get_data()
    assert np.abs(y - np.interp(x, TIME, slow)).max() < 0.11 * (swing > 0.0) + 1e-12


def test_axes_have_colours_of_their_own_whatever_their_names() -> None:
    for names in ("xyz", ["J1", "J2", "J3", "J4"], "XYZABC"):
        figure = curves_figure(TIME[:9], [Panel(n, [Curve("", TIME[:9], n), Curve("asked", TIME[:9], "setpoint")]) for n in names], "")
        assert len({axes.lines[0].get_color() for axes in figure.axes}) == len(names)


@pytest.mark.parametrize(
    ("value", "text"),
    [(14400.3, "14400"), (3.27e-17, "0"), (6.92e-05, "< 0.001"), (-0.0, "0"), (9.951, "9.95"), (0.0123, "0.0123"), (-123.4, "-123")],
)
def test_numbers_have_no_exponent(value: float, text: str) -> None:
    assert plain(value) == text
    assert plain(value, sign="+") == (f"+{text}" if value >= 0.001 else text)


def test_peaks_at_one_place_have_their_labels_below_each_other() -> None:
    time = np.linspace(0.0, 1.0, 200)
    swing = np.sin(2.0 * np.pi * time)
    curves = [
        Curve("first", 158.0 * swing, "setpoint"),
        Curve("second", 155.0 * swing, "X"),
        Curve("third", 150.0 * np.roll(swing, 80), "Y"),
    ]
    figure = curves_figure(time, [Panel("error, um", curves, peaks="um")], "two runs")
    figure.canvas.draw()
    labels = [text for text in figure.axes[0].texts if "um" in text.get_text()]
    boxes = [label.get_window_extent() for label in labels]
    assert [label.get_text() for label in labels] == ["158 um", "155 um", "150 um"]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[i + 1 :])


def test_equal_peaks_at_one_place_have_one_label() -> None:
    """A following axis reaches what it was told; as far elsewhere is a peak of its own."""
    time = np.linspace(0.0, 1.0, 200)
    swing = 200.0 * np.sin(np.pi * time) ** 4
    curves = [Curve("asked", swing, "setpoint"), Curve("reached", swing, "X"), Curve("later", np.roll(swing, 80), "Y")]
    (axes,) = curves_figure(time, [Panel("position, mm", curves, peaks="mm")], "").axes
    assert [label.get_text() for label in axes.texts] == ["200 mm", "200 mm"]
    assert axes.texts[1].xy[0] > axes.texts[0].xy[0] + 0.3


def test_the_label_of_a_plateau_stands_at_its_middle_and_says_its_peak() -> None:
    time = np.linspace(0.0, 1.0, 1001)
    plateau = -np.clip(10.0 - 50.0 * np.abs(time - 0.4), 0.0, 5.0) - 0.01 * time
    (label,) = curves_figure(time, [Panel("error, um", [Curve("", plateau, "X")], peaks="um")], "").axes[0].texts
    assert abs(label.xy[0] - 0.4) < 0.005
    assert label.get_text() == f"{np.abs(plateau).max():.2f} um"


def test_a_limit_has_no_peak_to_label() -> None:
    """Its label would stand on the line of the limit, or on the label of a curve."""
    curves = [Curve("error", 3.5 * np.sin(TIME), "X"), Curve("tolerance 5 um", np.full(len(TIME), 0.9), "tolerance", "--")]
    (axes,) = curves_figure(TIME, [Panel("error, um", curves, peaks="um")], "").axes
    assert [text.get_text() for text in axes.texts] == ["3.50 um"]


def test_the_label_of_a_plateau_does_not_cross_its_curve() -> None:
    """A plateau as wide as its label: what stands to the right of its middle would lie on the fall behind it."""
    time = np.linspace(0.0, 1.0, 1001)
    for sign in (1.0, -1.0):
        plateau = sign * np.clip(50000.0 * (0.15 - np.abs(time - 0.4)), 0.0, 5500.0)
        figure = curves_figure(time, [Panel("error, um", [Curve("", plateau, "X")], peaks="um")], "")
        figure.canvas.draw()
        (axes,) = figure.axes
        box = axes.texts[0].get_window_extent()
        assert not any(box.contains(*point) for point in axes.transData.transform(np.column_stack([time, plateau])))
