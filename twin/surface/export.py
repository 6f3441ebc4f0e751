"""Files of a cut surface: meshes with deviations as vertex colours, height maps, entities for the viewer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.surface.height_rays import Nails

if TYPE_CHECKING:
    import rerun as rr

MOST_VERTICES = 400_000
"""A mesh for viewers keeps every n-th nail above this."""
COLOUR_MAP = "RdBu"
"""Red where the tool went too deep, blue where material is left."""


def deviation_colours(height: np.ndarray, end: float) -> np.ndarray:
    """RGBA (nail, 4) bytes for deviations [m] on a scale from -end to end."""
    import matplotlib

    return (matplotlib.colormaps[COLOUR_MAP](np.clip(0.5 + 0.5 * height / end, 0.0, 1.0)) * 255).astype(np.uint8)


def triangles(nails: Nails) -> np.ndarray:
    """Triangles (face, 3) over the nails, outwards."""
    if nails.faces is not None:
        return nails.faces
    rows, columns = nails.shape
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = np.vstack([np.column_stack([a, a + 1, a + columns + 1]), np.column_stack([a, a + columns + 1, a + columns])])
    corner = nails.point[faces[0]]
    outwards = np.cross(corner[1] - corner[0], corner[2] - corner[0]) @ nails.direction[faces[0, 0]]
    return faces if outwards > 0 else faces[:, ::-1]


def thinned(nails: Nails, most: int = MOST_VERTICES) -> Nails:
    """Every n-th row and column, so that at most so many nails remain."""
    step = int(np.ceil(np.sqrt(len(nails) / most)))
    if step <= 1 or not nails.is_grid:
        return nails
    rows, columns = np.arange(0, nails.shape[0], step), np.arange(0, nails.shape[1], step)
    index = (rows[:, None] * nails.shape[1] + columns).ravel()
    return Nails(
        nails.name,
        nails.point[index],
        nails.direction[index],
        nails.height[index],
        nails.depth,
        (len(rows), len(columns)),
        nails.u[columns],
        nails.v[rows],
        nails.cutter[index],
    )


def write_mesh(nails: Nails, path: Path, end: float) -> None:
    """Write PLY or STL in mm; PLY has the deviations as vertex colours, on a scale from -end to end [m]."""
    import trimesh

    nails = thinned(nails)
    mesh = trimesh.Trimesh(nails.surface * 1e3, triangles(nails), vertex_colors=deviation_colours(nails.height, end), process=False)
    mesh.export(path)


def write_height_map(nails: Nails, path: Path) -> None:
    """Write NPZ (u, v, height, point, direction; m) or CSV (u [mm], v [mm], deviation [um])."""
    if path.suffix == ".npz":
        np.savez_compressed(
            path,
            u=nails.u,
            v=nails.v,
            height=nails.map(),
            point=nails.point.astype(np.float32),
            direction=nails.direction.astype(np.float32),
        )
        return
    import pyarrow as pa
    import pyarrow.csv

    u, v = np.meshgrid(nails.u, nails.v) if nails.is_grid else (nails.point[:, 0], nails.point[:, 1])
    table = pa.table({"u [mm]": u.ravel() * 1e3, "v [mm]": v.ravel() * 1e3, "deviation [um]": nails.height * 1e6})
    pyarrow.csv.write_csv(table, path)


def log_surface(recording: rr.RecordingStream, entity: str, nails: Nails, end: float, **more: Any) -> None:
    """Log a cut surface as a coloured mesh in the part frame, for the replay; `end` [m] is the end of the colour scale."""
    import rerun

    nails = thinned(nails, 150_000)
    mesh = rerun.Mesh3D(
        vertex_positions=nails.surface.astype(np.float32),
        triangle_indices=triangles(nails),
        vertex_colors=deviation_colours(nails.height, end),
        vertex_normals=nails.direction.astype(np.float32),
    )
    recording.log(entity, mesh, rerun.AnyValues(quantity="deviation", scale_end_um=end * 1e6, **more), static=True)
