"""A shape to draw on a body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Shape:
    """One shape: `kind` box, cylinder, capsule or ellipsoid with half sizes, or mesh with vertices and faces.

    `size` (3,) [m]: half edges of a box; radii of an ellipsoid; (radius, half length, -) along z of a cylinder or capsule.
    """

    body: int
    name: str
    kind: str
    position: np.ndarray
    quaternion: np.ndarray
    colour: tuple[int, int, int, int]
    size: np.ndarray
    vertices: np.ndarray | None = None
    faces: np.ndarray | None = None
