"""Files of a cut surface: meshes with deviations as vertex colours, and height maps."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from twin.files import beside
from twin.surface.height_rays import HeightRays

MOST_VERTICES = 400_000
"""Most vertices of a mesh; larger ones are thinned."""
COLOUR_MAP = "RdBu"
"""Red: cut too deep, blue: material left."""


def deviation_colours(height: np.ndarray, end: float) -> np.ndarray:
    """RGBA bytes (ray, 4) for deviations [m] on a scale from -end to end."""
    import matplotlib

    return (matplotlib.colormaps[COLOUR_MAP](np.clip(0.5 + 0.5 * height / end, 0.0, 1.0)) * 255).astype(np.uint8)


def triangles(rays: HeightRays) -> np.ndarray:
    """Triangles (face, 3) over the rays, oriented outwards."""
    if rays.faces is not None:
        return rays.faces
    rows, columns = rays.shape
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = np.vstack([np.column_stack([a, a + 1, a + columns + 1]), np.column_stack([a, a + columns + 1, a + columns])])
    corner = rays.point[faces[0]]
    outwards = np.cross(corner[1] - corner[0], corner[2] - corner[0]) @ rays.direction[faces[0, 0]]
    return faces if outwards > 0 else faces[:, ::-1]


def thinned(rays: HeightRays, most: int = MOST_VERTICES) -> HeightRays:
    """Every n-th row and column, so that at most `most` rays remain."""
    step = int(np.ceil(np.sqrt(len(rays) / most)))
    if step <= 1 or not rays.is_grid:
        return rays
    kept = np.arange(len(rays)).reshape(rays.shape)[::step, ::step]
    of_rays = {name: getattr(rays, name)[kept.ravel()] for name in ("point", "direction", "height", "cutter")}
    return replace(rays, **of_rays, shape=kept.shape, u=rays.u[::step], v=rays.v[::step])


def write_mesh(rays: HeightRays, path: Path, end: float) -> None:
    """Write PLY or STL in mm; PLY has the deviations as vertex colours on a scale from -end to end [m]."""
    import trimesh

    rays = thinned(rays)
    mesh = trimesh.Trimesh(rays.surface * 1e3, triangles(rays), vertex_colors=deviation_colours(rays.height, end), process=False)
    with beside(path) as partial:
        mesh.export(partial)


def write_height_map(rays: HeightRays, path: Path) -> None:
    """Write NPZ (u, v, height, point, direction; m) or CSV (u [mm], v [mm], deviation [um])."""
    if path.suffix == ".npz":
        point, direction = (array.astype(np.float32) for array in (rays.point, rays.direction))
        with beside(path) as partial:
            np.savez_compressed(partial, u=rays.u, v=rays.v, height=rays.map(), point=point, direction=direction)
        return
    import pyarrow as pa
    import pyarrow.csv

    u, v = np.meshgrid(rays.u, rays.v) if rays.is_grid else (rays.point[:, 0], rays.point[:, 1])
    table = pa.table({"u [mm]": u.ravel() * 1e3, "v [mm]": v.ravel() * 1e3, "deviation [um]": rays.height * 1e6})
    with beside(path) as partial:
        pyarrow.csv.write_csv(table, partial)
