"""The cut surface against closed forms, each to 0.1 um: scallops, grooves, a flat end, tilted and turning tools."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.surface.height_rays import HeightRays, grid_rays
from twin.surface.metrology import scallop_height
from twin.surface.removal import cut
from twin.surface.steps import Steps, steps_between
from twin.surface.tools import Tool, end_mill, revolution

TOLERANCE = 1e-7
R = 5e-3


def plane(width: float = 4e-3, spacing: float = 2e-5, height: float = 1e-4, length: float = 2e-4) -> HeightRays:
    """Rays along z on the plane z = 0, `length` along x and `width` along y."""
    u, v = np.arange(0.0, length, spacing), np.arange(-width / 2, width / 2 + spacing / 2, spacing)
    point = np.stack([*np.meshgrid(u, v), np.zeros((len(v), len(u)))], axis=-1)
    return grid_rays("plane", point, np.broadcast_to([0.0, 0.0, 1.0], point.shape), u, v, height, 2e-3)


def straight(tool: Tool, y: float = 0.0, z: float = 0.0, axis: tuple[float, float, float] = (0.0, 0.0, 1.0), points: int = 5) -> Steps:
    """A pass along x at height z."""
    tip = np.column_stack([np.linspace(-9e-3, 9e-3, points), np.full(points, y), np.full(points, z)])
    return steps_between(tip, np.tile(axis, (points, 1)), tool.reach)


def test_scallop_of_a_ball_end() -> None:
    """Passes at a pitch p leave R - sqrt(R^2 - p^2 / 4)."""
    tool, pitch, rays = end_mill(2 * R, R), 0.25e-3, plane(spacing=1.25e-5, length=5e-5)
    for k in range(-9, 10):
        rays, _ = cut(rays, straight(tool, y=k * pitch), tool)
    profile = rays.map()[:, int(np.argmin(np.abs(rays.u)))]
    inner = np.abs(rays.v) < 1e-3
    off = np.abs(rays.v) % pitch
    off = np.minimum(off, pitch - off)
    np.testing.assert_allclose(profile[inner], (R - np.sqrt(R**2 - off**2))[inner], atol=1e-10)
    assert scallop_height(profile[inner]) == pytest.approx(R - math.sqrt(R**2 - pitch**2 / 4), abs=TOLERANCE)


@pytest.mark.parametrize("depth", [1e-6, 20e-6, 1e-3])
def test_groove_of_known_depth(depth: float) -> None:
    tool = end_mill(2 * R, R)
    after, _ = cut(plane(), straight(tool, z=-depth), tool)
    expected = np.minimum(R - depth - np.sqrt(R**2 - after.v**2), 1e-4)
    np.testing.assert_allclose(after.map()[:, 3], expected, atol=TOLERANCE)


def test_flat_end_cuts_a_plane_and_a_cylinder_wall() -> None:
    tool = end_mill(2 * R, 0.0)
    after, _ = cut(plane(width=14e-3, spacing=1e-4), straight(tool, z=-3e-5), tool)
    inside = np.abs(after.v) < R
    np.testing.assert_allclose(after.map()[inside], -3e-5, atol=1e-12)
    np.testing.assert_allclose(after.map()[~inside], 1e-4, atol=1e-12)
    # rays across the axis, standing on a wall at y = -R that the side mills: a plunge leaves the cylinder itself
    x = np.linspace(-3e-3, 3e-3, 61)
    point = np.stack([x, np.full(61, -R), np.full(61, 8e-3)], axis=-1)[None]
    wall = grid_rays("wall", point, np.broadcast_to([0.0, 1.0, 0.0], point.shape), x, np.zeros(1), 5e-3, 1e-3)
    plunged, _ = cut(wall, steps_between(np.array([[0, 0, 5e-3], [0, 0, 0.0]]), np.tile([0, 0, 1.0], (2, 1)), tool.reach), tool)
    np.testing.assert_allclose(plunged.height, R - np.sqrt(R**2 - x**2), atol=TOLERANCE)
    milled, _ = cut(wall, straight(tool), tool)
    np.testing.assert_allclose(milled.height, 0.0, atol=TOLERANCE)


@pytest.mark.parametrize("tilt_deg", [1.0, 10.0, 40.0])
def test_tilted_flat_end_cuts_an_ellipse(tilt_deg: float) -> None:
    """Tilted by b about y and moved along x, the disc's rim leaves the projection of a circle: z = -sin b sqrt(R^2 - y^2)."""
    b, tool = math.radians(tilt_deg), end_mill(2 * R, 0.0, cutting_length=0.03)
    rays = plane(width=6e-3, height=4e-3)
    after, _ = cut(rays, straight(tool, z=2e-3, axis=(math.sin(b), 0.0, math.cos(b)), points=9), tool)
    np.testing.assert_allclose(after.map()[:, 2], 2e-3 - math.sin(b) * np.sqrt(R**2 - after.v**2), atol=TOLERANCE)


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0])
def test_bull_nose_profile(tilt_deg: float) -> None:
    """Upright: flat to Rm, then a quarter circle. Tilted along the way: lowest of the ellipse of Rm, rounded by r."""
    r, b = 1e-3, math.radians(tilt_deg)
    tool = end_mill(2 * R, r, cutting_length=0.03)
    rays = plane(width=7e-3, height=4e-3)
    after, _ = cut(rays, straight(tool, z=5e-4, axis=(math.sin(b), 0.0, math.cos(b)), points=9), tool)
    phi = np.linspace(0.0, 2.0 * math.pi, 400_001)
    # the rim's circle in the part: centre r above the tip along the axis; each of its points sweeps a cylinder along x
    ring_y, ring_z = (R - r) * np.sin(phi), 5e-4 + r * math.cos(b) - (R - r) * np.cos(phi) * math.sin(b)
    for y, h in zip(after.v[::35], after.map()[::35, 2]):
        gap = r**2 - (y - ring_y) ** 2
        expected = (ring_z - np.sqrt(np.maximum(gap, 0.0)))[gap >= 0].min(initial=np.inf)
        if tilt_deg == 0.0 and abs(y) <= R - r:
            expected = 5e-4
        assert h == pytest.approx(expected, abs=TOLERANCE)


def test_tool_of_revolution_equals_the_same_tool_of_elements() -> None:
    quarter = revolution([(0.0, 0.0), (R, R, R), (R, 0.04)], name="ball by its outline")
    path = steps_between(np.array([[-4e-3, 1e-3, 0.0], [4e-3, -1e-3, -2e-4]]), np.array([[0.1, 0.0, 1.0], [0.2, 0.1, 1.0]]), 0.01)
    ball, _ = cut(plane(spacing=1e-4), path, end_mill(2 * R, R))
    chords, _ = cut(plane(spacing=1e-4), path, quarter)
    np.testing.assert_allclose(chords.height, ball.height, atol=TOLERANCE)


def test_a_ball_end_turning_about_its_centre_cuts_a_ball() -> None:
    """A ball-end that turns about the centre of its ball cuts only the ball."""
    tool = end_mill(2 * R, R, cutting_length=0.02)
    # sub-steps of 5 nm bulge: the tip moves on a straight line between poses, so the poses must be close
    fine = np.array([[math.sin(a), 0.0, math.cos(a)] for a in np.linspace(0.0, math.radians(25.0), 4001)])
    centre = np.array([1e-4, 0.0, R - 5e-5])
    after, _ = cut(plane(), steps_between(centre - R * fine, fine, tool.reach), tool)
    x, y = np.meshgrid(after.u, after.v)
    expected = np.minimum(centre[2] - np.sqrt(R**2 - (x - centre[0]) ** 2 - y**2), 1e-4)
    np.testing.assert_allclose(after.map(), expected, atol=TOLERANCE)


def test_a_flat_end_turning_about_its_tip_cuts_two_planes() -> None:
    """A flat end that pivots about an axis through its tip leaves the lower of its two discs, up to the first and last pose."""
    tool = end_mill(2 * R, 0.0, cutting_length=0.02)
    b = math.radians(6.0)
    axes = np.array([[0.0, 0.0, 1.0], [math.sin(b), 0.0, math.cos(b)]])
    u = np.linspace(-4e-3, 4e-3, 41)
    point = np.stack([u, np.zeros(41), np.zeros(41)], axis=-1)[None]
    rays = grid_rays("line", point, np.broadcast_to([0.0, 0.0, 1.0], point.shape), u, np.zeros(1), 1e-3, 2e-3)
    after, _ = cut(rays, steps_between(np.zeros((2, 3)), axes, tool.reach), tool)
    # the disc of the last pose falls towards +x: z = -x tan b there, 0 on the other side
    np.testing.assert_allclose(after.height, np.where(u > 0, -u * math.tan(b), 0.0), atol=TOLERANCE)


def test_the_surface_does_not_depend_on_order_tiling_and_threads() -> None:
    rng = np.random.default_rng(3)
    tool, rays = end_mill(2 * R, 1e-3), plane(width=2e-3, spacing=1e-4, length=1e-3)
    tip = np.cumsum(rng.normal(0.0, 3e-4, (12, 3)) * [1, 1, 0.05], axis=0)
    axis = np.array([0.0, 0.0, 1.0]) + 0.05 * rng.standard_normal((12, 3))
    steps = steps_between(tip, axis, tool.reach)
    first, _ = cut(rays, steps, tool, threads=1)
    for tile, threads in ((4, 2), (64, 3)):
        again, _ = cut(rays, steps, tool, tile=tile, threads=threads)
        assert np.array_equal(first.height, again.height)
        assert np.array_equal(first.cutter, again.cutter)
    # another order of rays and of steps
    back = Steps(*(getattr(steps, name)[::-1].copy() for name in ("tip", "way", "axis", "turn", "angle", "rim", "sample")))
    assert np.array_equal(cut(rays, back, tool)[0].height, first.height)
    turned = grid_rays(
        "turned", rays.point.reshape(*rays.shape, 3)[:, ::-1], rays.direction.reshape(*rays.shape, 3), rays.u, rays.v, 1e-4, 2e-3
    )
    assert np.array_equal(cut(turned, steps, tool)[0].map()[:, ::-1], first.map())


def test_converges_with_the_square_of_the_step() -> None:
    """Chords of a circular path of radius 25 mm: the error falls four times when the steps are halved."""
    tool, radius = end_mill(2 * R, R), 25e-3
    rays = plane(width=2e-4, spacing=2e-5, height=1e-3, length=4e-3)
    errors = []
    for count in (40, 80, 160):
        a = np.linspace(-0.3, 0.3, count + 1)
        tip = np.column_stack([2e-3 + radius * np.sin(a), 0.0 * a, radius * (1.0 - np.cos(a))])
        steps = steps_between(tip, np.tile([0.0, 0.0, 1.0], (count + 1, 1)), tool.reach)
        after, _ = cut(rays, steps, tool)
        # the ball's lowest line: a torus of tube R about a circle above; cut from below along its middle
        row = after.shape[0] // 2
        height = radius + R - np.sqrt((radius + R) ** 2 - (after.u - 2e-3) ** 2)
        errors.append(np.abs(after.map()[row] - height).max() - 0.0)
    ratios = np.array(errors[:-1]) / errors[1:]
    assert np.all((ratios > 3.4) & (ratios < 4.6)), (errors, ratios)


def test_ray_density_resolves_a_scallop_with_second_order() -> None:
    """The highest ray of a smooth hump misses its top by at most R'' / 8 of the square of the spacing."""
    tool, depth = end_mill(2 * R, R), 30e-6
    missed = []
    for spacing in (80e-6, 40e-6, 20e-6):
        u, v = np.arange(2) * spacing, (np.arange(-40, 40) + 0.5) * spacing
        point = np.stack([*np.meshgrid(u, v), np.zeros((len(v), 2))], axis=-1)
        rays = grid_rays("plane", point, np.broadcast_to([0.0, 0.0, 1.0], point.shape), u, v, 1e-3, 1e-3)
        after, _ = cut(rays, straight(tool, z=-depth), tool)
        missed.append(after.height.min() + depth)
    np.testing.assert_allclose(np.array(missed[:-1]) / missed[1:], 4.0, rtol=0.02)
