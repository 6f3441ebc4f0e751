"""Meshes as stock: rays end at their first exit."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from twin.surface.machining import _with_stock
from twin.surface.part import part_from_document


def heights(tmp_path: Path, bodies: list[list[list[float]]], at: float, inside_out: bool = False) -> np.ndarray:
    """Heights [mm] of rays 0.5 mm deep towards +x on a wall at x = `at` [mm] in a stock of boxes [[x, y, z], [x, y, z]] in mm."""
    stock = trimesh.util.concatenate([trimesh.creation.box(bounds=b) for b in bodies])
    if inside_out:
        stock.invert()
    stock.export(tmp_path / "stock.stl")
    wall = {"kind": "plane", "origin_mm": [at, 0, 0], "u_direction": [0, 1, 0], "v_direction": [0, 0, 1], "spacing_mm": 1.0}
    document = {
        "tool": {"kind": "ball", "diameter_mm": 4},
        "stock": {"mesh": "stock.stl", "unit": "mm"},
        "surface": [{**wall, "along_mm": [-4.03, 4.03], "across_mm": [-4.07, 4.07], "depth_mm": 0.5}],
    }
    part = part_from_document(document, tmp_path, "part.toml")
    return _with_stock(part.surfaces[0].rays(part.placed, part.allowance), part).height * 1e3


NEAR, OPPOSITE = [[-10, -5, -5], [1, 5, 5]], [[31, -5, -5], [40, 5, 5]]


@pytest.mark.parametrize("inside_out", [False, True])
def test_the_opposite_wall_of_a_pocket_does_not_count_as_stock(tmp_path: Path, inside_out: bool) -> None:
    """A nominal wall at x = 0 with 1 mm of stock, the wall across the pocket 30 mm away: the rays end at 1 mm."""
    np.testing.assert_allclose(heights(tmp_path, [NEAR, OPPOSITE], 0.0, inside_out), 1.0, atol=1e-3)


def test_stock_that_ends_below_the_nominal_surface(tmp_path: Path) -> None:
    """Stock 0.2 mm too small: the last exit below the surface counts; no stock within the depth: the ray is empty."""
    np.testing.assert_allclose(heights(tmp_path, [NEAR, OPPOSITE], 1.2), -0.2, atol=1e-3)
    np.testing.assert_allclose(heights(tmp_path, [NEAR, OPPOSITE], 2.0), -0.5, atol=1e-9)


def test_a_wall_thinner_than_the_depth_of_the_rays(tmp_path: Path) -> None:
    thin = [[-0.3, -5, -5], [0.1, 5, 5]]
    np.testing.assert_allclose(heights(tmp_path, [thin, OPPOSITE], 0.0), 0.1, atol=1e-3)
