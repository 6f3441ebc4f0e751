"""Height rays (an N-buffer): rays along the normals of the nominal surface, each with the height of the material's end.

Ray i starts at point (i, 3) with the outward unit direction (i, 3). Material fills it from -depth to `height` (ray,). Height 0 is the
nominal surface, so the height of a cut ray is the deviation. Rays of a surface with two parameters form a grid (row, column).
All lengths in m.
"""

from dataclasses import dataclass

import numpy as np

TILE = 16
"""Rays along the side of a tile of a grid."""


@dataclass(frozen=True)
class HeightRays:
    """Height rays.

    `shape` is (rows, columns) of the grid (index = row * columns + column), or (count, 1) for scattered rays; `u` (columns,) and
    `v` (rows,) are its coordinates [m]. `cutter` (ray,) is the path sample that cut the ray, -1 for the uncut stock.
    """

    name: str
    point: np.ndarray
    direction: np.ndarray
    height: np.ndarray
    depth: float
    shape: tuple[int, int]
    u: np.ndarray
    v: np.ndarray
    cutter: np.ndarray
    faces: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.point)

    @property
    def is_grid(self) -> bool:
        """Do the rays form a grid over two parameters?"""
        return self.faces is None

    @property
    def surface(self) -> np.ndarray:
        """Points (ray, 3) where the material ends."""
        return self.point + self.height[:, None] * self.direction

    def map(self, values: np.ndarray | None = None) -> np.ndarray:
        """Heights (or other values, one per ray) as (row, column)."""
        return (self.height if values is None else values).reshape(self.shape)


def grid_rays(
    name: str,
    point: np.ndarray,
    direction: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    allowance: float,
    depth: float,
    faces: np.ndarray | None = None,
) -> HeightRays:
    """Uncut rays: point and direction (row, column, 3) at v (row,) and u (column,), or those of a mesh with faces (face, 3) as one column."""
    rows, columns = point.shape[:2]
    point, direction = (np.ascontiguousarray(each.reshape(-1, 3)) for each in (point, direction))
    direction = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    height, cutter = np.full(len(point), float(allowance)), np.full(len(point), -1)
    return HeightRays(name, point, direction, height, depth, (rows, columns), u, v, cutter, faces)


def tiles_of(rays: HeightRays, side: int = TILE) -> tuple[np.ndarray, np.ndarray]:
    """Order (ray,) that groups rays by tile, and the start of each tile in it (tile + 1,)."""
    if rays.is_grid:
        row, column = np.divmod(np.arange(len(rays)), rays.shape[1])
        tile = (row // side) * (-(-rays.shape[1] // side)) + column // side
    else:
        # scattered rays: cells of a lattice with about side^2 rays each
        size = np.ptp(rays.point, axis=0)
        area = max(float(np.sort(size)[1:].prod()), 1e-12)
        cell = max(side * np.sqrt(area / len(rays)), 1e-9)
        lattice = np.floor((rays.point - rays.point.min(axis=0)) / cell).astype(np.int64)
        _, tile = np.unique(lattice, axis=0, return_inverse=True)
        tile = tile.ravel()
    order = np.argsort(tile, kind="stable")
    starts = np.flatnonzero(np.concatenate([[True], np.diff(tile[order]) != 0]))
    return order, np.append(starts, len(rays))


def tile_bounds(rays: HeightRays, order: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Capsules (tile, 7) around the material of each tile: lower end, upper end, radius [m]."""
    low = rays.point - rays.depth * rays.direction
    high = rays.point + rays.height[:, None] * rays.direction
    count = np.diff(starts)[:, None]
    ends = [np.add.reduceat(p[order], starts[:-1], axis=0) / count for p in (low, high)]
    tile = np.repeat(np.arange(len(count)), count[:, 0])
    axis = ends[1] - ends[0]
    square = np.maximum(np.einsum("ij,ij->i", axis, axis), 1e-30)
    radius = np.zeros(len(count))
    for p in (low[order], high[order]):
        # a ray lies within the larger distance of its two ends from the capsule's axis
        part = np.clip(np.einsum("ij,ij->i", p - ends[0][tile], axis[tile]) / square[tile], 0.0, 1.0)
        gap = np.linalg.norm(p - ends[0][tile] - part[:, None] * axis[tile], axis=1)
        radius = np.maximum(radius, np.maximum.reduceat(gap, starts[:-1]))
    return np.column_stack([*ends, radius])
