"""Colours of axes, parts of the torque and paths, the same in viewer, plots and reports. RGB, 0 to 255.

They are readable on white and on the viewer's dark background, and distinguishable with colour blindness:
`python -m devtools.colour_distances` prints their distances.
"""

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
"""Parts of the motor torque, for the viewer's dark background; the whole torque has the colour of its axis."""

RUN_COLOURS: tuple[Colour, ...] = ((255, 221, 0), (187, 255, 255))
"""Second and third of overlaid runs in the viewer, also thin; the first run has the colour of its axis."""

SETPOINT_COLOUR: Colour = (166, 170, 178)
"""Set points of any axis."""
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
"""Contour error from zero (yellow) to the end of the scale (dark red), in equal bands of rising darkness."""


def axis_colour(axis: str, order: int = 0) -> Colour:
    """Colour of an axis, in either case of its letter; for other names by `order`, its index in the machine."""
    return AXIS_COLOURS.get(axis.upper(), _OTHER_AXES[order % len(_OTHER_AXES)])


def mixed(colour: Colour, share: float, other: Colour = (255, 255, 255)) -> Colour:
    """The colour with this share of another one, white if none is given."""
    return tuple(round(c + (o - c) * share) for c, o in zip(colour, other))  # type: ignore[return-value]


def run_colour(order: int, first: Colour) -> Colour:
    """Colour of one of several overlaid runs: `first` for the first, else one of RUN_COLOURS."""
    return first if order == 0 else RUN_COLOURS[(order - 1) % len(RUN_COLOURS)]


def hexadecimal(colour: Colour) -> str:
    """The colour as '#rrggbb'."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
