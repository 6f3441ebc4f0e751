"""Plots over time: labels of peaks do not lie on each other."""

from __future__ import annotations

import numpy as np

from twin.report.curves import Curve, Panel, curves_figure


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
