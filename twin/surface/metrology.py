"""Metrology of a cut surface: profile sections, the mark, scallops, areal parameters.

Deviations are heights of rays above the nominal surface [m]: positive where material is left, negative where the cut is too deep. The
areal parameters follow ISO 25178-2 on the primary surface after form removal (F-operator: least-squares polynomial of u and v),
without S- or L-filter:

    Sa = mean |z|,  Sq = sqrt(mean z^2),  Sp = max z,  Sv = -min z,  Sz = Sp + Sv,  Ssk = mean z^3 / Sq^3,  Sku = mean z^4 / Sq^4
"""

import numpy as np
import scipy

from twin.errors import InputError
from twin.surface.height_rays import HeightRays


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


def without_form(height: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Height map minus its least-squares quadratic."""
    if height.size < 6:
        raise InputError(f"areal parameters: a patch of {height.size} points is too small; take at least 6")
    a, b = (x - x.mean() for x in (u, v))
    a, b = (x / max(np.abs(x).max(), 1e-30) for x in (a, b))
    # terms are products of a row and a column function, so the normal equations are small for any map
    terms = [(i, j) for i in range(3) for j in range(3 - i)]
    rows, columns = b[:, None] ** [j for _, j in terms], a[:, None] ** [i for i, _ in terms]
    matrix = (rows.T @ rows) * (columns.T @ columns)
    right = np.einsum("rt,rc,ct->t", rows, height, columns, optimize=True)
    weight = np.linalg.lstsq(matrix, right, rcond=None)[0]
    return height - np.einsum("rt,t,ct->rc", rows, weight, columns, optimize=True)


def mark(cut: HeightRays, reference: HeightRays) -> dict[str, float]:
    """The mark of a cut: its lowest place relative to the same rays cut without it (by the slow passes alone, or the programmed path).

    `depth_um` below the reference, and `left_um` of the highest point above it; `width_mm` and `length_mm` at half depth across (v) and along (u),
    `u_mm`, `v_mm` of the deepest point, NaN for rays without u and v; `below_nominal_um`, its depth below the nominal surface.
    """
    if cut.shape != reference.shape:
        raise InputError("mark: the two surfaces have different rays; cut the same rays twice")
    below = (reference.height - cut.height).reshape(cut.shape)
    row, column = np.unravel_index(int(np.argmax(below)), below.shape)
    depth, places = float(below[row, column]), dict.fromkeys(("width_mm", "length_mm", "u_mm", "v_mm"), float("nan"))
    if cut.is_grid:
        width, length = (_width(*line) for line in ((cut.v, below[:, column], row), (cut.u, below[row], column)))
        places = dict(zip(places, (1e3 * width, 1e3 * length, 1e3 * float(cut.u[column]), 1e3 * float(cut.v[row]))))
    return {
        "depth_um": 1e6 * depth,
        "left_um": -1e6 * float(below.min()),
        **places,
        "below_nominal_um": -1e6 * float(cut.map()[row, column]),
    }


def scallop_height(profile: np.ndarray) -> float:
    """Scallop height [m] of a section across the passes: mean peak minus mean valley, without the ends."""
    peaks, valleys = (scipy.signal.find_peaks(sign * profile)[0] for sign in (1.0, -1.0))
    return float(np.mean(profile[peaks]) - np.mean(profile[valleys])) if len(peaks) and len(valleys) else 0.0


def _width(x: np.ndarray, y: np.ndarray, at: np.intp) -> float:
    """Length of the interval around index `at` where y exceeds half its value there, over equidistant x."""
    if y[at] <= 0.0:
        return 0.0
    whole = (y[[at]], np.array([0]), np.array([len(y) - 1]))  # from the peak down to 0, over all of y
    return float(scipy.signal.peak_widths(y, [at], 0.5, whole)[0][0] * (x[1] - x[0]))
