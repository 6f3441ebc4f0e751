"""Dexels of closed meshes: thickness and volume are the mesh's."""

import numpy as np
import pytest
import trimesh

from twin.surface.dexels import mesh_dexels


def thickness(dexels) -> np.ndarray:
    """Material along each ray (ray,) [m]."""
    lengths = dexels.intervals[:, :, 1] - dexels.intervals[:, :, 0]
    return np.where(np.arange(lengths.shape[1]) < dexels.count[:, None], lengths, 0.0).sum(axis=1)


def test_every_ray_through_a_box_is_as_long_as_the_box_is_high():
    dexels = mesh_dexels(trimesh.creation.box(extents=[0.02, 0.01, 0.005]), 0.001)
    assert np.all(dexels.count == 1)
    assert thickness(dexels) == pytest.approx(0.005, abs=1e-9)


def test_volume_of_a_sphere_and_of_a_hollow_one():
    spacing = 0.0002
    outer, inner = trimesh.creation.icosphere(4, 0.01), trimesh.creation.icosphere(4, 0.006)
    assert thickness(mesh_dexels(outer, spacing)).sum() * spacing**2 == pytest.approx(outer.volume, rel=3e-3)
    inner.invert()
    hollow = mesh_dexels(trimesh.util.concatenate([outer, inner]), spacing)
    assert hollow.count.max() == 2
    assert thickness(hollow).sum() * spacing**2 == pytest.approx(outer.volume + inner.volume, rel=3e-3)
