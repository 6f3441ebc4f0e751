"""Meshes as nominal part or stock: read, checked, converted to metres, and turned into rays.

STL, OBJ and PLY have no unit: it is guessed from the size (a part between 5 mm and 2 m) and reported; `unit` in the part file takes
precedence. A mesh with holes is refused as stock and accepted with a note as a nominal surface.
"""

from collections.abc import Callable
from pathlib import Path
import sys
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.geometry.mesh_file import load_mesh
from twin.limits import refuse_above
from twin.surface.height_rays import HeightRays, grid_rays
from twin.units import UNITS

Placed = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Transforms points and directions (.., 3) of a part into the machine's part frame."""

ENDINGS = (".stl", ".obj", ".ply")
SMALLEST_PART, LARGEST_PART = 5e-3, 2.0
"""Plausible range of a part's longest side [m]."""
SHARP_EDGE = np.radians(20.0)
"""The common edge of two faces is sharp above this angle between them [rad]."""
MOST_MESH_RAYS = 2_000_000
"""Most rays of a subdivided mesh."""
GUESSES = ("mm", "m", "um")


def read_mesh(path: Path, unit: str | None, *, closed: bool) -> tuple[Any, str]:
    """A mesh in metres, and a note on its unit."""
    mesh: Any = load_mesh(path, process=True, endings=ENDINGS)
    size = float(np.ptp(mesh.vertices, axis=0).max())
    if unit is None:
        fits = [u for u in GUESSES if SMALLEST_PART <= size * UNITS[u][1] <= LARGEST_PART]
        if not fits:
            raise InputError(
                f'{path}: longest side {size:g} is not plausible in any of {", ".join(GUESSES)}; give unit = "mm" in the part file'
            )
        unit = fits[0]
        said = f'{path.name}: unit guessed as {unit} (longest side {size * UNITS[unit][1] * 1e3:g} mm); give unit = "{unit}" to confirm'
    elif unit not in UNITS or UNITS[unit][0] != "length":
        raise InputError(f"{path}: unit '{unit}' is not a length; use mm, m or um")
    else:
        said = f"{path.name}: longest side {size * UNITS[unit][1] * 1e3:g} mm"
    mesh.apply_scale(UNITS[unit][1])
    if not mesh.is_watertight:
        edges = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)[1]
        holes = int((edges == 1).sum())
        if closed:
            raise InputError(f"{path}: the mesh is not watertight ({holes} open edges); close it, or give allowance_mm instead")
        said += f"; not watertight ({holes} open edges)"
    return mesh, said


def mesh_rays(name: str, file: Path, unit: str | None, spacing: float, placed: Placed, allowance: float, depth: float) -> HeightRays:
    """Rays at the vertices of a mesh, subdivided until no edge is longer than the spacing; lengths in m."""
    import trimesh

    mesh, said = read_mesh(file, unit, closed=False)
    print(f"note: {said}", file=sys.stderr)
    rays = float(mesh.area) / spacing**2
    refuse_above(rays, MOST_MESH_RAYS, f"rays at {spacing * 1e6:g} um", str(file), "enlarge spacing_mm")
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, spacing)
    _, first, index = np.unique(np.round(vertices, 9), axis=0, return_index=True, return_inverse=True)
    fine = trimesh.Trimesh(vertices[first], index.ravel()[faces], process=False)
    # at sharp edges each side keeps its own rays, because a mean normal would overestimate the deviation
    fine = trimesh.graph.smooth_shade(fine, angle=SHARP_EDGE)
    point, direction = placed(np.asarray(fine.vertices)[:, None], np.asarray(fine.vertex_normals)[:, None])
    return grid_rays(name, point, direction, np.zeros(1), np.arange(float(len(point))), allowance, depth, np.asarray(fine.faces))


def stock_heights(rays: HeightRays, stock: tuple[Path, str | None], placed: Placed) -> np.ndarray:
    """Height (ray,) where each ray leaves the stock mesh, seen from the nominal surface; -depth if it is never inside.

    Material beyond the first gap above the nominal surface (the opposite wall of a pocket) is ignored.
    """
    mesh, said = read_mesh(*stock, closed=True)
    print(f"note: {said}", file=sys.stderr)
    vertices, _ = placed(np.asarray(mesh.vertices), np.zeros((1, 3)))
    mesh.vertices = vertices
    if not mesh.is_volume:
        mesh.fix_normals()  # inverted normals
    origin = rays.point - rays.depth * rays.direction
    where, ray, triangle = mesh.ray.intersects_location(origin, rays.direction, multiple_hits=True)
    height = np.einsum("ij,ij->i", where - origin[ray], rays.direction[ray]) - rays.depth
    outwards = np.einsum("ij,ij->i", mesh.face_normals[triangle], rays.direction[ray]) > 0.0
    first_in, first_out, below = (np.full(len(rays), start) for start in (np.inf, np.inf, -rays.depth))
    for out, choose, rows in (
        (first_in, np.minimum, (height > 0.0) & ~outwards),
        (first_out, np.minimum, (height > 0.0) & outwards),
        (below, np.maximum, (height <= 0.0) & outwards),
    ):
        choose.at(out, ray[rows], height[rows])
    # nominal surface inside the stock: first exit above it; outside: last exit below it
    return np.where(first_out < first_in, first_out, below)
