"""Metrology of a cut surface: profile sections, the mark, scallops, areal parameters.

Deviations are heights of rays above the nominal surface [m]: positive where material is left, negative where the cut is too deep. The
areal parameters follow ISO 25178-2 on the primary surface after form removal (F-operator: least-squares polynomial of u and v),
without S- or L-filter:

    Sa = mean |z|,  Sq = sqrt(mean z^2),  Sp = max z,  Sv = -min z,  Sz = Sp + Sv,  Ssk = mean z^3 / Sq^3,  Sku = mean z^4 / Sq^4
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.errors import InputError
from twin.surface.height_rays import HeightRays


@dataclass(frozen=True)
class Mark:
    """A mark: the lowest place of the surface relative to a reference without the mark.

    `depth` [m] below the reference, `width` and `length` [m] at half depth across (v) and along (u), `u`, `v` [m] of the deepest
    point, `below_nominal` [m] its depth below the nominal surface, `height` [m] of the highest point above the reference.
    """

    depth: float
    width: float
    length: float
    u: float
    v: float
    below_nominal: float
    height: float


def areal(height: np.ndarray, u: np.ndarray, v: np.ndarray) -> dict[str, float]:
    """Areal parameters [m; Ssk, Sku: 1] of a height map (row, column) over v (row,) and u (column,) after removal of a quadratic form."""
    z = without_form(height, u, v)
    sq = float(np.sqrt(np.mean(z**2)))
    safe = sq if sq > 0.0 else 1.0
    return {
        "sa": float(np.mean(np.abs(z))),
        "sq": sq,
        "sz": float(np.ptp(z)),
        "sp": float(z.max()),
        "sv": float(-z.min()),
        "ssk": float(np.mean(z**3)) / safe**3,
        "sku": float(np.mean(z**4)) / safe**4,
    }


def without_form(height: np.ndarray, u: np.ndarray, v: np.ndarray, order: int = 2) -> np.ndarray:
    """Height map minus its least-squares polynomial (order 0: mean, 1: plane, 2: quadratic)."""
    if height.size < 6:
        raise InputError(f"areal parameters: a patch of {height.size} points is too small; take at least 6")
    a, b = (x - x.mean() for x in (u, v))
    a, b = (x / max(np.abs(x).max(), 1e-30) for x in (a, b))
    # terms are products of a row and a column function, so the normal equations are small for any map
    terms = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    rows, columns = b[:, None] ** [j for _, j in terms], a[:, None] ** [i for i, _ in terms]
    matrix = (rows.T @ rows) * (columns.T @ columns)
    right = np.einsum("rt,rc,ct->t", rows, height, columns, optimize=True)
    weight = np.linalg.lstsq(matrix, right, rcond=None)[0]
    return height - np.einsum("rt,t,ct->rc", rows, weight, columns, optimize=True)


def mark(cut: HeightRays, reference: HeightRays) -> Mark:
    """The mark of a cut, relative to the same rays cut without it (by the slow passes alone, or the programmed path)."""
    if cut.shape != reference.shape:
        raise InputError("mark: the two surfaces have different rays; cut the same rays twice")
    below = (reference.height - cut.height).reshape(cut.shape)
    if not cut.is_grid:
        i = int(np.argmax(below))
        return Mark(
            float(below.ravel()[i]), float("nan"), float("nan"), float("nan"), float("nan"), float(-cut.height[i]), float(-below.min())
        )
    row, column = np.unravel_index(int(np.argmax(below)), below.shape)
    depth = float(below[row, column])
    return Mark(
        depth=depth,
        width=_width(cut.v, below[:, column], int(row), depth / 2.0),
        length=_width(cut.u, below[row], int(column), depth / 2.0),
        u=float(cut.u[column]),
        v=float(cut.v[row]),
        below_nominal=float(-cut.map()[row, column]),
        height=float(-below.min()),
    )


def scallop_height(profile: np.ndarray) -> float:
    """Scallop height [m] of a section across the passes: mean peak minus mean valley, without the ends."""
    inner = np.arange(1, len(profile) - 1)
    peaks = inner[(profile[1:-1] > profile[:-2]) & (profile[1:-1] >= profile[2:])]
    valleys = inner[(profile[1:-1] < profile[:-2]) & (profile[1:-1] <= profile[2:])]
    if len(peaks) == 0 or len(valleys) == 0:
        return 0.0
    return float(np.mean(profile[peaks]) - np.mean(profile[valleys]))


def _width(x: np.ndarray, y: np.ndarray, at: int, level: float) -> float:
    """Length of the interval around index `at` where y exceeds the level, with interpolated ends."""
    if level <= 0.0:
        return 0.0
    ends = []
    for step in (-1, 1):
        i = at
        while 0 <= i + step < len(y) and y[i + step] > level:
            i += step
        j = i + step
        ends.append(float(x[i]) if not 0 <= j < len(y) else float(np.interp(level, [y[j], y[i]], [x[j], x[i]])))
    return ends[1] - ends[0]
