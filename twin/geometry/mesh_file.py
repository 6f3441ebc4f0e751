"""Meshes of other people: STL, OBJ, PLY and DAE, read from the one file that is named; what such a file names in turn is not opened."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from twin.documents import reading
from twin.errors import InputError

ENDINGS = (".stl", ".obj", ".ply", ".dae")
LARGEST_BYTES = 300_000_000
"""About six million triangles of a binary STL [bytes]."""
LARGEST_COORDINATE = 1e9
"""A thousand kilometres in mm: nearest corners are found in whole numbers, which end at 9e10."""


def load_mesh(path: Path, *, process: bool, endings: tuple[str, ...] = ENDINGS) -> Any:
    """The mesh of a file as one trimesh.Trimesh in the file's units; `process` joins equal corners.

    Raises:
        InputError: the file is too large, is no mesh of one of these endings, or holds no triangle or a corner that is no number.
    """
    import trimesh

    ending = path.suffix.lower()
    if ending not in endings:
        raise InputError(f"{path}: not a mesh that can be read; give one of {', '.join(endings)}")
    with reading(path, "mesh"):
        if (size := path.stat().st_size) > LARGEST_BYTES:
            raise InputError(f"{path}: {size / 1e6:.0f} MB; a mesh has at most {LARGEST_BYTES / 1e6:.0f} MB: make it coarser")
        content = path.read_bytes()
        if ending == ".dae":
            _check_xml(content)
        # read from memory and without a resolver, so that no material, texture or buffer is looked for
        mesh: Any = trimesh.load(io.BytesIO(content), file_type=ending[1:], force="mesh", process=False)
        faces = len(mesh.faces)
    if not faces:
        raise InputError(f"{path}: the mesh has no triangle; export it again")
    check_corners(mesh.vertices, str(path))
    if process:
        mesh.process()
    return mesh


def check_corners(corners: np.ndarray, where: str) -> None:
    """Refuse corners (corner, 3) that are no number, or further away than any machine is large."""
    if not np.all(np.isfinite(corners)):
        raise InputError(f"{where}: a vertex of the mesh is no finite number; export it again")
    if (farthest := float(np.max(np.abs(corners), initial=0.0))) > LARGEST_COORDINATE:
        raise InputError(f"{where}: a vertex of the mesh lies at {farthest:.3g}, the limit is {LARGEST_COORDINATE:g}; correct its scale")


def _check_xml(content: bytes) -> None:
    """Refuse document types, entities and external references."""
    from defusedxml.ElementTree import fromstring

    fromstring(content, forbid_dtd=True)
