"""Metrology and steps: parameters of known surfaces, marks of known size, merged and refined paths."""

from __future__ import annotations

from dataclasses import replace
import itertools
import math

import numpy as np
import pytest

from twin.errors import InputError
from twin.geometry.tool_path import ToolPath, contour_error
from twin.surface.height_rays import HeightRays, grid_rays, tile_bounds, tiles_of
from twin.surface.metrology import areal, mark, scallop_height, without_form
from twin.surface.steps import refined_axes, steps_between, steps_of
from twin.surface.tools import end_mill, revolution, tool_from_table


def patch(height: np.ndarray, spacing: float = 1e-5) -> HeightRays:
    rows, columns = height.shape
    u, v = np.arange(columns) * spacing, np.arange(rows) * spacing
    point = np.stack([*np.meshgrid(u, v), np.zeros((rows, columns))], axis=-1)
    rays = grid_rays("patch", point, np.broadcast_to([0.0, 0.0, 1.0], point.shape), u, v, 0.0, 1e-3)
    return replace(rays, height=height.ravel())


def test_areal_parameters_of_a_sine() -> None:
    """Wave of amplitude a: Sa = 2 a / pi, Sq = a / sqrt 2, Sz = 2 a, Sku = 1.5; second-order form is removed."""
    x, y = (np.arange(20_000) + 0.5) * 2e-7, np.arange(50) * 1e-6
    wave = 1e-6 * np.sin(2.0 * math.pi * x / 1e-4)[None] + 0.0 * y[:, None]
    form = 3e-4 * (x[None] / 4e-3) ** 2 - 2e-5 * y[:, None] / 5e-5 + 1e-5 * x[None] * y[:, None] / 2e-7
    for height in (wave, wave + form):
        got = areal(height, x, y)
        assert got["sa"] == pytest.approx(2e-6 / math.pi, rel=3e-3)
        assert got["sq"] == pytest.approx(1e-6 / math.sqrt(2.0), rel=3e-3)
        assert got["sz"] == pytest.approx(2e-6, rel=0.03)  # the form takes a little of the wave along
        assert got["ssk"] == pytest.approx(0.0, abs=0.01)
        assert got["sku"] == pytest.approx(1.5, rel=0.01)


def test_form_removal_removes_a_form_completely() -> None:
    u, v = np.linspace(0.0, 0.02, 70), np.linspace(-0.001, 0.001, 40)
    form = 1.0 + 2.0 * u[None] + 3.0 * v[:, None] + 40.0 * u[None] ** 2 + 50.0 * u[None] * v[:, None] - 60.0 * v[:, None] ** 2
    assert np.abs(without_form(form, u, v)).max() < 1e-12
    with pytest.raises(InputError, match="too small"):
        areal(np.zeros((1, 3)), np.arange(3.0), np.zeros(1))


def test_mark_of_known_size() -> None:
    row, column = np.mgrid[0:101, 0:301]
    pit = -20e-6 * np.exp(-0.5 * (((row - 40) / 10.0) ** 2 + ((column - 200) / 40.0) ** 2))
    found = mark(patch(pit), patch(np.zeros_like(pit)))
    half = 2.0 * math.sqrt(2.0 * math.log(2.0))
    assert found["depth_um"] == pytest.approx(20.0)
    assert (found["u_mm"], found["v_mm"]) == (pytest.approx(2.0), pytest.approx(0.4))
    assert found["width_mm"] == pytest.approx(half * 0.1, rel=2e-3)
    assert found["length_mm"] == pytest.approx(half * 0.4, rel=2e-3)
    assert found["below_nominal_um"] == pytest.approx(20.0)


def test_scallop_height_of_arcs() -> None:
    y = np.arange(-400, 401) * 2.5e-6
    off = np.abs((y + 1.25e-4) % 2.5e-4 - 1.25e-4)
    profile = 5e-3 - np.sqrt(25e-6 - off**2)
    assert scallop_height(profile) == pytest.approx(profile.max(), rel=1e-9)
    assert scallop_height(np.zeros(50)) == 0.0


def test_tiles_hold_every_ray_once_and_bounds_hold_the_material() -> None:
    rays = patch(np.random.default_rng(1).uniform(-1e-5, 5e-5, (37, 53)))
    for side in (4, 16, 100):
        order, starts = tiles_of(rays, side)
        assert sorted(order.tolist()) == list(range(len(rays)))
        bounds = tile_bounds(rays, order, starts)
        for tile, (first, last) in enumerate(itertools.pairwise(starts)):
            a, b, radius = bounds[tile, :3], bounds[tile, 3:6], bounds[tile, 6]
            ends = rays.surface[order[first:last]]
            part = np.clip((ends - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            assert np.linalg.norm(ends - a - part[:, None] * (b - a), axis=1).max() <= radius + 1e-15


def test_merged_steps_stay_within_the_tolerance() -> None:
    t = np.linspace(0.0, 1.0, 20_001)
    tip = np.column_stack([0.02 * t, 1e-3 * np.sin(6.0 * t), np.zeros_like(t)])
    axis = np.column_stack([0.1 * t, 0.0 * t, np.ones_like(t)])
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    path = ToolPath(t, tip, axis)
    steps = steps_of(path, 0.02)
    assert len(steps) < 2000
    ends = np.vstack([steps.tip, steps.tip[-1:] + steps.way[-1:]])
    joined = ToolPath(np.arange(float(len(ends))), ends, np.vstack([steps.axis, steps.axis[-1:] + steps.turn[-1:]]))
    assert contour_error(path, joined, None).error.max() < 5.1e-9


def test_spline_between_samples_takes_the_chord_error_away() -> None:
    """10 m/min on a radius of 25 mm, 1 ms: chords miss the arc by 0.14 um, the refined path by less than 0.01 um."""
    angle = np.arange(200) * (1.0 / 6.0 * 1e-3 / 25e-3)
    axes = np.column_stack([25e-3 * np.sin(angle), 0 * angle, 25e-3 * np.cos(angle), 0 * angle, 0 * angle])
    direction = np.tile([0.0, 0.0, 1.0], (200, 1))
    finer, at = refined_axes(axes, ToolPath(np.arange(200) * 1e-3, axes[:, :3], direction), 0.02)
    chord = lambda p: 25e-3 - np.linalg.norm((p[1:, [0, 2]] + p[:-1, [0, 2]]) / 2.0, axis=1)  # noqa: E731
    assert chord(axes).max() == pytest.approx(0.139e-6, rel=0.01)
    assert chord(finer)[5:-5].max() < 1e-8
    assert at[0] == 0.0
    assert at[-1] == 199.0


def test_sub_steps_of_a_turn_go_straight() -> None:
    steps = steps_between(np.zeros((2, 3)), np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), 0.02)
    assert steps.angle.max() ** 2 * 0.02 / 8.0 < 5e-9
    np.testing.assert_allclose(steps.axis[-1] + steps.turn[-1], [1.0, 0.0, 0.0], atol=1e-12)
    # the two directions of the rim stay across the axis
    end = steps.axis + steps.turn
    assert np.abs(np.einsum("ij,ij->i", end, steps.rim[:, 6:9])).max() < 1e-12


def test_contour_and_orientation_error_of_a_shifted_path() -> None:
    t = np.arange(2000) * 1e-3
    tip = np.column_stack([0.02 * np.sin(t), 0.02 * np.cos(t), 0.0 * t])
    axis = np.column_stack([np.sin(0.3 * t), 0.0 * t, np.cos(0.3 * t)])
    reference = ToolPath(t, tip, axis)
    b = 1e-5
    turned = np.column_stack([np.sin(0.3 * t), np.full_like(t, math.sin(b)), np.cos(0.3 * t)])
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    late = ToolPath(t + 0.02, tip * 1.001, turned)
    error = contour_error(late, reference)
    assert error.error[100:-100] == pytest.approx(20e-6, rel=1e-3)
    assert error.orientation[100:-100] == pytest.approx(b, rel=0.02)
    np.testing.assert_allclose(error.magnified(late.tip, 2.0) - late.tip, late.tip - error.nearest, atol=1e-15)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"kind": "bal"}, "did you mean 'ball'"),
        ({"kind": "ball"}, "'diameter_mm' is missing"),
        ({"kind": "ball", "diameter_mm": -3}, "give a number above 0"),
        ({"kind": "ball", "diameter_mm": 10, "corner_mm": 1}, "unknown key 'corner_mm'"),
        ({"kind": "bull", "diameter_mm": 10, "corner_mm": 6}, "between 0 and the tool's radius"),
        ({"kind": "revolution", "profile_mm": [[1, 2]]}, "at least two points"),
        ({"kind": "revolution", "profile_mm": [[0, 0], [5, 5], [5, 3]]}, "non-decreasing heights"),
        ({"kind": "revolution", "profile_mm": [[0, 0], [5, 5, 1]]}, "does not reach"),
    ],
)
def test_bad_tools(table: dict, says: str) -> None:
    with pytest.raises(InputError, match=says):
        tool_from_table(table, "part.toml: [tool]")


def test_tools_know_their_size() -> None:
    assert end_mill(10e-3, 1e-3).radius == pytest.approx(5e-3)
    cone = revolution([(0.0, 0.0), (2e-3, 4e-3), (2e-3, 9e-3)])
    assert (cone.radius, cone.reach) == (pytest.approx(2e-3), pytest.approx(9e-3))


def test_scallops_of_different_height_give_their_mean() -> None:
    assert scallop_height(np.array([5.0, 0.0, 1.0, 0.0, 2.0, 0.0, 3.0, 0.0, 5.0])) == pytest.approx(2.0)
