"""Frames of all languages: a chain of named frames, outermost first, that leads from program to machine coordinates.

A frame takes inner coordinates x to outer ones, M x + shift; `outer @ inner` is both of them. Lengths in m, angles in rad.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
import math
from typing import NamedTuple

import numpy as np

LINEAR, ROTARY, OTHER = ("X", "Y", "Z"), ("A", "C"), ("B", "U", "V", "W")
AXES = (*LINEAR, *ROTARY, *OTHER)
INDEX = {name: i for i, name in enumerate((*LINEAR, *ROTARY))}


def rotation(axis: int, degrees: float) -> np.ndarray:
    """Matrix (3, 3) that turns about x, y or z by an angle, right-handed; exact at right angles."""
    quarter = degrees / 90.0
    if quarter == round(quarter):
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarter) % 4]
    else:
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def rotation_xyz(angles: Mapping[str, float]) -> np.ndarray:
    """Matrix (3, 3) of turns about the fixed axes X, Y, Z, in this order, by the angles [deg] of these names."""
    return rotation(2, angles.get("Z", 0.0)) @ rotation(1, angles.get("Y", 0.0)) @ rotation(0, angles.get("X", 0.0))


class Frame(NamedTuple):
    """Matrix (3, 3) and shift (5,) of x y z A C; neither is changed in place."""

    matrix: np.ndarray
    shift: np.ndarray

    def __matmul__(self, inner: object) -> Frame:
        if not isinstance(inner, Frame):
            return NotImplemented
        shift = np.concatenate([self.shift[:3] + self.matrix @ inner.shift[:3], self.shift[3:] + inner.shift[3:]])
        return Frame(self.matrix @ inner.matrix, shift)


NO_FRAME = Frame(np.eye(3), np.zeros(5))


def shifted(shift: np.ndarray) -> Frame:
    """A shift (5,)."""
    return Frame(np.eye(3), shift)


def about(matrix: np.ndarray, centre: np.ndarray) -> Frame:
    """A matrix (3, 3) whose centre (3,) stays where it is."""
    return Frame(matrix, np.concatenate([centre - matrix @ centre, np.zeros(2)]))


def mirrored(axes: Collection[str]) -> np.ndarray:
    """Matrix (3, 3) that mirrors the axes named."""
    return np.diag([-1.0 if n in axes else 1.0 for n in LINEAR])
