"""The key of the plots, a strip below them with colour and width of each line, so that no legend covers a curve; and colour bars."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont
import rerun as rr
import rerun.blueprint as rrb

from twin.replay.curves import PlotLine, line_width
from twin.replay.names import CONTOUR_ERROR, KEY, LEGEND, entity
from twin.report.colours import Colour

GROUND = (13, 16, 17)
"""The viewer's background."""
INK = (205, 210, 215)
HEIGHT, SAMPLE, SPACE, FONT_SIZE = 30, 46, 26, 17
"""Pixels: height of the strip, length of a sample of a line, space between entries, size of the letters."""
LEAST_WIDTH = 1200


def log_keys(recording: rr.RecordingStream, curves: Sequence[PlotLine]) -> dict[str, str]:
    """Log a key for every axis, and '' for the contour error of several runs. Returns their entities."""
    found: dict[str, str] = {}
    for axis in dict.fromkeys(_axis_of(curve) for curve in curves):
        entries = {(c.key, c.colour, c.run): None for c in curves if _axis_of(c) == axis and c.key}
        if (len(entries) > 1 or axis) and entries:
            found[axis] = entity(KEY, axis or "contour_error")
            recording.log(found[axis], rr.Image(key_picture([*entries], LEAST_WIDTH if axis else 1)), static=True)
    return found


def key_picture(entries: Sequence[tuple[str, Colour, int]], least_width: int = LEAST_WIDTH) -> np.ndarray:
    """A strip (row, column, RGB) with a piece of line and a word for each entry (word, colour, index of the run)."""
    font = ImageFont.load_default(FONT_SIZE)
    widths = [SAMPLE + 8 + int(font.getlength(word)) + SPACE for word, _, _ in entries]
    picture = Image.new("RGB", (max(sum(widths) + SPACE, least_width), HEIGHT), GROUND)
    pen, x = ImageDraw.Draw(picture), SPACE // 2
    several = any(run for *_, run in entries)
    for (word, colour, run), width in zip(entries, widths):
        width_of_line = round(2.0 * line_width(run, several))
        pen.line([(x, HEIGHT // 2), (x + SAMPLE - 2, HEIGHT // 2)], fill=colour, width=width_of_line)
        pen.text((x + SAMPLE + 8, HEIGHT // 2), word, fill=INK, font=font, anchor="lm")
        x += width
    return np.asarray(picture)


def _axis_of(curve: PlotLine) -> str:
    """Axis of a curve, '' for the contour error."""
    return "" if curve.path.startswith(CONTOUR_ERROR) else curve.path.split("/")[2]


BAND_PIXELS = (40, 16)
"""Width and height of a band [pixels]."""


def log_colour_bar(recording: rr.RecordingStream, bands: np.ndarray, numbers: Sequence[float], quantity: str) -> None:
    """Log a bar of bands (band, 3) [RGB] with evenly spaced numbers [um] below, the last with ">" and unit: its colour also stands for larger values."""
    count = 8
    picture = np.repeat(bands.astype(np.uint8)[None], BAND_PIXELS[1], axis=0)
    picture = np.repeat(picture, BAND_PIXELS[0] * count // len(bands), axis=1)
    step = float(np.diff(numbers).min())
    digits = int(np.clip(np.ceil(-np.log10(max(step, 1e-12))), 0, 4))
    labels = [f"{number:.{digits}f}" for number in numbers]
    labels[-1] = f"> {labels[-1]} um"
    x = np.linspace(0.0, picture.shape[1], len(numbers))
    recording.log(entity(LEGEND, "bands"), rr.Image(picture), static=True)
    places, dot = np.column_stack([x, np.full(len(x), BAND_PIXELS[1])]), rr.Radius.ui_points(1.5)
    marks = rr.Points2D(places, labels=labels, colors=[(60, 64, 70)], radii=dot, show_labels=True)
    meaning = rr.AnyValues(quantity=quantity, unit="um", limits=np.asarray(numbers, float))
    recording.log(entity(LEGEND, "limits"), marks, meaning, static=True)


def colour_bar_view(title: str) -> rrb.View:
    """The view of a colour bar and its numbers."""
    bounds = rrb.VisualBounds2D(x_range=[-25, 345], y_range=[-3, 34])
    return rrb.Spatial2DView(origin=LEGEND, name=title, background=(255, 255, 255), visual_bounds=bounds)
