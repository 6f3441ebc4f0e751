"""Colour bars in the viewer: bands or a gradient, with numbers and unit below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from twin.replay.names import entity

BAND_PIXELS = (40, 16)
"""Width and height of a band [pixels]."""


def log_colour_bar(recording: rr.RecordingStream, path: str, bands: np.ndarray, numbers: Sequence[float], unit: str, quantity: str) -> None:
    """Log a bar of bands (band, 3) [RGB] with evenly spaced numbers below, the last with ">" and its unit: its colour also stands for larger values."""
    count = 8
    picture = np.repeat(bands.astype(np.uint8)[None], BAND_PIXELS[1], axis=0)
    picture = np.repeat(picture, BAND_PIXELS[0] * count // len(bands), axis=1)
    step = float(np.diff(numbers).min())
    digits = int(np.clip(np.ceil(-np.log10(max(step, 1e-12))), 0, 4))
    labels = [f"{number:.{digits}f}" for number in numbers]
    labels[-1] = f"> {labels[-1]} {unit}".strip()
    x = np.linspace(0.0, picture.shape[1], len(numbers))
    recording.log(entity(path, "bands"), rr.Image(picture), static=True)
    recording.log(
        entity(path, "limits"),
        rr.Points2D(
            np.column_stack([x, np.full(len(x), BAND_PIXELS[1])]),
            labels=labels,
            colors=[(60, 64, 70)],
            radii=rr.Radius.ui_points(1.5),
            show_labels=True,
        ),
        rr.AnyValues(quantity=quantity, unit=unit, limits=np.asarray(numbers, float)),
        static=True,
    )


def colour_bar_view(path: str, title: str) -> rrb.View:
    """The view of a colour bar and its numbers."""
    bounds = rrb.VisualBounds2D(x_range=[-25, 345], y_range=[-3, 34])
    return rrb.Spatial2DView(origin=path, name=title, background=(255, 255, 255), visual_bounds=bounds)
