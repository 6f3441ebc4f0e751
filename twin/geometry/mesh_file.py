"""Meshes from unknown sources: STL, OBJ, PLY and DAE. Only the named file is read, no file that it refers to."""

import io
from pathlib import Path
from typing import Any

import numpy as np

from twin.documents import reading
from twin.errors import InputError

ENDINGS = (".stl", ".obj", ".ply", ".dae")
LARGEST_BYTES = 300_000_000
"""Largest file [bytes], about six million triangles of a binary STL."""
LARGEST_COORDINATE = 1e9
"""Largest coordinate: a thousand kilometres in mm. Merging of corners uses integers that end at 9e10."""


def load_mesh(path: Path, *, process: bool, endings: tuple[str, ...] = ENDINGS) -> Any:
    """The mesh of a file as one trimesh.Trimesh in the units of the file. `process`: merge equal corners.

    Raises:
    InputError: the file is too large, not a mesh with one of these endings, or has no triangle or a corner that is not finite.
    """
    from defusedxml.ElementTree import fromstring
    import trimesh

    ending = path.suffix.lower()
    if ending not in endings:
        raise InputError(f"{path}: not a mesh that can be read; give one of {', '.join(endings)}")
    with reading(path, "mesh"):
        if (size := path.stat().st_size) > LARGEST_BYTES:
            raise InputError(f"{path}: {size / 1e6:.0f} MB; a mesh has at most {LARGEST_BYTES / 1e6:.0f} MB: make it coarser")
        content = path.read_bytes()
        if ending == ".dae":
            fromstring(content, forbid_dtd=True)  # no document types, entities and external references
        # read from memory without a resolver, so that no material, texture or buffer is opened
        mesh: Any = trimesh.load(io.BytesIO(content), file_type=ending[1:], force="mesh", process=False)
        faces = len(mesh.faces)
    if not faces:
        raise InputError(f"{path}: the mesh has no triangle; export it again")
    check_corners(mesh.vertices, str(path))
    if process:
        mesh.process()
    return mesh


def check_corners(corners: np.ndarray, where: str) -> None:
    """Refuse corners (corner, 3) that are not finite, or farther away than any machine is large."""
    if not np.all(np.isfinite(corners)):
        raise InputError(f"{where}: a vertex of the mesh is not a finite number; export it again")
    if (farthest := float(np.max(np.abs(corners), initial=0.0))) > LARGEST_COORDINATE:
        raise InputError(f"{where}: a vertex of the mesh lies at {farthest:.3g}, the limit is {LARGEST_COORDINATE:g}; correct its scale")
