"""A second implementation: thousands of random sweeps of all tools against brute-force distances to the moving tool.

The tool's outline is a distance in the half-plane (radius, height), evaluated at many moments of a step and refined; a ray's end
must lie on the swept volume within 0.1 um (distance along the ray), and nothing of the tool may lie below it.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.surface.height_rays import grid_rays
from twin.surface.removal import cut
from twin.surface.steps import steps_between
from twin.surface.tools import end_mill, revolution

TOLERANCE = 1e-7
"""0.1 um along the ray."""
TOOLS = {
    "ball": end_mill(10e-3, 5e-3, cutting_length=0.02),
    "flat": end_mill(10e-3, 0.0, cutting_length=0.02),
    "bull": end_mill(10e-3, 1.5e-3, cutting_length=0.02),
    "cone": revolution([(1e-3, 0.0), (4e-3, 6e-3), (4e-3, 12e-3), (2e-3, 12e-3), (2e-3, 20e-3)]),
}


def outside(tool: str, rho: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Signed distance of a point (radius, height) from the tool (negative inside; a bound of right sign inside)."""

    def box(r: np.ndarray, h: np.ndarray, radius: float, low: float, high: float) -> np.ndarray:
        a, b = r - radius, np.maximum(low - h, h - high)
        return np.hypot(np.maximum(a, 0.0), np.maximum(b, 0.0)) + np.minimum(np.maximum(a, b), 0.0)

    if tool == "ball":
        return np.minimum(np.hypot(rho, z - 5e-3) - 5e-3, box(rho, z, 5e-3, 5e-3, 20e-3))
    if tool == "flat":
        return box(rho, z, 5e-3, 0.0, 20e-3)
    if tool == "bull":
        ring = np.hypot(np.maximum(rho - 3.5e-3, 0.0), z - 1.5e-3) - 1.5e-3
        return np.minimum(ring, box(rho, z, 5e-3, 1.5e-3, 20e-3))
    # cone: the slanted side as a half-plane, cut at its faces
    side = ((rho - 1e-3) * 6e-3 - z * 3e-3) / math.hypot(6e-3, 3e-3)
    frustum = np.maximum(np.maximum(side, -z), z - 6e-3)
    return np.minimum(np.minimum(frustum, box(rho, z, 4e-3, 6e-3, 12e-3)), box(rho, z, 2e-3, 12e-3, 20e-3))


def depth_of(tool: str, points: np.ndarray, tip: np.ndarray, axis: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Signed distance (s, point) of points from the tool at the parts s of a step between two poses."""
    angle = math.acos(min(1.0, float(axis[0] @ axis[1])))
    if angle > 1e-12:
        u = (np.sin((1 - s) * angle)[:, None] * axis[0] + np.sin(s * angle)[:, None] * axis[1]) / math.sin(angle)
    else:
        u = np.repeat(axis[:1], len(s), axis=0)
    y = points[None] - (tip[0] + s[:, None] * (tip[1] - tip[0]))[:, None]
    z = np.einsum("spi,si->sp", y, u)
    rho = np.sqrt(np.maximum(np.einsum("spi,spi->sp", y, y) - z * z, 0.0))
    return outside(tool, rho, z)


def closest(tool: str, point: np.ndarray, tip: np.ndarray, axis: np.ndarray) -> float:
    """Smallest signed distance of one point from the tool over the step: samples, then ever finer about the best."""
    low, high = 0.0, 1.0
    best = math.inf
    for _ in range(6):
        s = np.linspace(low, high, 41)
        d = depth_of(tool, point[None], tip, axis, s)[:, 0]
        k = int(np.argmin(d))
        best = min(best, float(d[k]))
        low, high = s[max(k - 1, 0)], s[min(k + 1, 40)]
    return best


@pytest.mark.parametrize("turning", [False, True], ids=["straight", "turning"])
@pytest.mark.parametrize("tool", list(TOOLS))
def test_random_sweeps(tool: str, turning: bool) -> None:
    rng = np.random.default_rng(7 + turning)
    cut_count = 0
    for _ in range(250):
        # a patch of rays across the way of the tool, standing anywhere between along and across its axis
        axis = np.array([0.0, 0.0, 1.0]) + 0.6 * rng.standard_normal(3) * [1, 1, 0]
        axes = np.array([axis, axis + (rng.uniform(0.0, 0.12) * rng.standard_normal(3) if turning else 0.0)])
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        tips = rng.uniform(-1e-3, 1e-3, 3) + np.array([np.zeros(3), rng.standard_normal(3) * 10 ** rng.uniform(-6, -2.5)])
        n = rng.standard_normal(3)
        n[2] = abs(n[2])
        n /= np.linalg.norm(n)
        across = np.linalg.svd(n[None])[2][1:]
        points = rng.uniform(-6e-3, 6e-3, (3, 2)) @ across + axes[0] * rng.uniform(0.0, 8e-3)
        rays = grid_rays("random", points[None], np.broadcast_to(n, (1, 3, 3)), np.arange(3.0), np.zeros(1), 0.05, 0.05)
        steps = steps_between(tips, axes, 0.02, tolerance=1e-9)
        after, _ = cut(rays, steps, TOOLS[tool], threads=1)
        for i in range(3):
            h = after.height[i]
            # nothing of the tool below the end of the ray
            below = points[i] + np.linspace(-0.05, h - TOLERANCE, 400)[:, None] * n
            if h < 0.05:
                below = np.vstack([below, points[i] + (h - np.geomspace(TOLERANCE, 1e-3, 60))[:, None] * n])
            inside = depth_of(tool, below, tips, axes, np.linspace(0.0, 1.0, 61)).min()
            assert inside > -2e-9, f"tool is {-inside * 1e6:.4f} um in the material left"
            if h >= 0.05:
                continue
            cut_count += 1
            # and the end itself is touched: just above it the tool is there, or it lies on the tool's surface
            here = min(closest(tool, points[i] + (h + e) * n, tips, axes) for e in (0.0, 0.5 * TOLERANCE, TOLERANCE))
            assert here < 2e-9, f"the end of the ray is {here * 1e6:.4f} um off the swept tool"
    assert cut_count > 120
