"""Colours: one per axis, part of the torque and kind of path, the same in the viewer, the plots and the reports.

Each is readable on a white page and on the viewer's dark ground. RGB, 0 to 255.
"""

from __future__ import annotations

Colour = tuple[int, int, int]

AXIS_COLOURS: dict[str, Colour] = {
    "X": (226, 74, 51),
    "Y": (46, 160, 67),
    "Z": (56, 128, 240),
    "A": (240, 150, 10),
    "B": (0, 170, 170),
    "C": (176, 92, 220),
}
_OTHER_AXES: tuple[Colour, ...] = ((200, 120, 90), (120, 160, 60), (90, 140, 190), (210, 110, 160), (150, 130, 110), (90, 170, 140))

TORQUE_COLOURS: dict[str, Colour] = {
    "inertia": (74, 144, 226),
    "friction": (214, 96, 60),
    "gravity": (60, 170, 110),
    "feedforward": (190, 160, 20),
}
"""Parts of a motor torque; the whole has the colour of its axis."""

SETPOINT_COLOUR: Colour = (140, 146, 156)
"""Set points, of any axis: what was asked for is grey, what happened has colour."""
LIMIT_COLOUR: Colour = (200, 30, 45)
DIFFERENCE_COLOUR: Colour = (230, 60, 160)
PROGRAM_COLOUR: Colour = (20, 20, 24)
"""The programmed path."""

ERROR_BANDS: tuple[Colour, ...] = (
    (38, 92, 205),
    (20, 150, 200),
    (25, 170, 120),
    (130, 190, 40),
    (235, 190, 20),
    (245, 140, 20),
    (230, 80, 30),
    (190, 15, 45),
)
"""Contour error from nothing (blue) to the end of the scale (red), in equal bands."""


def axis_colour(axis: str, order: int = 0) -> Colour:
    """The colour of an axis; an axis of another name gets one by its place in the machine."""
    return AXIS_COLOURS.get(axis, _OTHER_AXES[order % len(_OTHER_AXES)])


def lighter(colour: Colour, part: float = 0.5) -> Colour:
    """The colour mixed with white: the second of two runs."""
    return tuple(round(c + (255 - c) * part) for c in colour)  # type: ignore[return-value]


def hexadecimal(colour: Colour) -> str:
    """'#rrggbb', as plots want it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
