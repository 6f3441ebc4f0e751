"""Colours: one per axis, part of the torque and kind of path, the same in the viewer, the plots and the reports.

Each is readable on a white page and on the viewer's dark ground, and can be separated by colour-blind eyes:
`python -m devtools.colour_distances` prints how far they lie apart. RGB, 0 to 255.
"""

from __future__ import annotations

Colour = tuple[int, int, int]

AXIS_COLOURS: dict[str, Colour] = {
    "X": (185, 88, 14),
    "Y": (2, 147, 145),
    "Z": (20, 88, 180),
    "A": (249, 140, 42),
    "B": (88, 189, 255),
    "C": (164, 76, 247),
}
_OTHER_AXES: tuple[Colour, ...] = ((200, 120, 90), (120, 160, 60), (90, 140, 190), (210, 110, 160), (150, 130, 110), (90, 170, 140))

TORQUE_COLOURS: dict[str, Colour] = {
    "inertia": (68, 238, 255),
    "friction": (255, 221, 0),
    "gravity": (204, 255, 187),
    "feedforward": (170, 187, 170),
}
"""Parts of a motor torque, for the viewer's dark ground; the whole has the colour of its axis."""

RUN_COLOURS: tuple[Colour, ...] = ((255, 221, 0), (187, 255, 255))
"""Second and third of several runs over each other in the viewer; the first has the colour of its axis. They are dashed, too."""

SETPOINT_COLOUR: Colour = (166, 170, 178)
"""Set points, of any axis: what was asked for is grey, what happened has colour."""
LIMIT_COLOUR: Colour = (255, 40, 120)
PROGRAM_COLOUR: Colour = (20, 20, 24)
"""The programmed path."""

ERROR_BANDS: tuple[Colour, ...] = (
    (234, 197, 3),
    (224, 162, 8),
    (210, 129, 6),
    (194, 95, 2),
    (179, 55, 2),
    (156, 1, 28),
    (116, 2, 44),
    (79, 1, 44),
)
"""Contour error from nothing (yellow) to the end of the scale (dark red), in equal bands; each is darker than the one before."""


def axis_colour(axis: str, order: int = 0) -> Colour:
    """The colour of an axis; an axis of another name gets one by its place in the machine."""
    return AXIS_COLOURS.get(axis, _OTHER_AXES[order % len(_OTHER_AXES)])


def lighter(colour: Colour, part: float = 0.5) -> Colour:
    """The colour mixed with white: the second of two runs."""
    return tuple(round(c + (255 - c) * part) for c in colour)  # type: ignore[return-value]


def run_colour(order: int, first: Colour) -> Colour:
    """The colour of one of several runs over each other: the first has its own, the others one of RUN_COLOURS."""
    return first if order == 0 else RUN_COLOURS[(order - 1) % len(RUN_COLOURS)]


def hexadecimal(colour: Colour) -> str:
    """'#rrggbb', as plots want it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
