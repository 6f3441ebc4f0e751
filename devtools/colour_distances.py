"""Distances between the colours of the project, also for colour-blind sight: `python -m devtools.colour_distances`.

OKLab distances times 100: black to white is 100, a difference of 2 is just visible side by side. Colour-blind sight after Machado,
Oliveira and Fernandes (2009), "A physiologically-based model for simulation of color vision deficiency", at full severity.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from twin.report.colours import (
    AXIS_COLOURS,
    ERROR_BANDS,
    LIMIT_COLOUR,
    RUN_COLOURS,
    SETPOINT_COLOUR,
    TORQUE_COLOURS,
    Colour,
)

SIGHTS: dict[str, np.ndarray] = {
    "normal": np.eye(3),
    "protanopia": np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]),
    "deuteranopia": np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]),
    "tritanopia": np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]),
}
"""Kind of sight -> matrix on linear RGB (3, 3)."""
_CONES = np.array(
    [[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566], [0.0883024619, 0.2817188376, 0.6299787005]]
)
_LAB = np.array(
    [[0.2104542553, 0.7936177850, -0.0040720468], [1.9779984951, -2.4285922050, 0.4505937099], [0.0259040371, 0.7827717662, -0.8086757660]]
)


def oklab(colours: np.ndarray, sight: str = "normal") -> np.ndarray:
    """OKLab (n, 3) times 100 of colours (n, 3) in sRGB 0 to 255, for a kind of sight."""
    share = np.asarray(colours, float) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ SIGHTS[sight].T, 0.0, 1.0)
    return 100.0 * np.cbrt(seen @ _CONES.T) @ _LAB.T


def closest(colours: Mapping[str, Colour], sight: str) -> tuple[float, str, str]:
    """The smallest distance between two colours of a group, and their names."""
    names = list(colours)
    lab = oklab(np.array([colours[name] for name in names]), sight)
    return min((float(np.linalg.norm(lab[i] - lab[j])), names[i], names[j]) for i, j in combinations(range(len(names)), 2))


def groups() -> dict[str, dict[str, Colour]]:
    """Groups of colours that appear together: the axes, and the curves in a plot of one axis."""
    found: dict[str, dict[str, Colour]] = {"axes": dict(AXIS_COLOURS)}
    for axis, colour in AXIS_COLOURS.items():
        runs = {f"run {i + 2}": run for i, run in enumerate(RUN_COLOURS)}
        found[f"runs of {axis}"] = {axis: colour, **runs, "set point": SETPOINT_COLOUR, "limit": LIMIT_COLOUR}
        found[f"torque of {axis}"] = {f"motor {axis}": colour, **TORQUE_COLOURS}
    return found


def band_steps(sight: str) -> np.ndarray:
    """Lightness steps between the bands of the contour error (band - 1,); all of one sign if the scale is monotone."""
    return np.diff(oklab(np.array(ERROR_BANDS), sight)[:, 0])


def main() -> None:
    """Print the smallest distance of every group for every sight, and the lightness steps of the contour error."""
    print(f"{'group':14}" + "".join(f"{sight:>40}" for sight in SIGHTS))
    for name, colours in groups().items():
        cells = (closest(colours, sight) for sight in SIGHTS)
        print(f"{name:14}" + "".join(f"{f'{distance:.1f} ({a}, {b})':>40}" for distance, a, b in cells))
    print("\nlightness of the contour error, from band to band")
    for sight in SIGHTS:
        print(f"{sight:14}" + "  ".join(f"{step:6.1f}" for step in band_steps(sight)))


if __name__ == "__main__":
    main()
