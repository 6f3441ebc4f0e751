"""Shapes as viewer entities, and the motion of their bodies as transforms.

The transform of a body is parent_from_body, logged only while it moves.
"""

from typing import Any

import numpy as np
import rerun as rr

from twin.geometry.body_poses import Pose
from twin.replay.names import TIMELINE, entity
from twin.replay.scene import Scene, scene_bounds, shape_path

CREASE = np.radians(35.0)
"""An edge is smoothed below this angle between its face normals."""
SAME_POSE = 1e-9
"""Poses that differ by less count as equal [m, 1]; a body at rest is logged at the start and end of its rest."""
SMOOTH_FACES = 30_000
"""Meshes with more faces get one normal per vertex; creases would multiply their size."""


def log_scene(recording: rr.RecordingStream, scene: Scene) -> list[str]:
    """Log the static content: shapes and part frame. Returns the entity paths of the shapes."""
    recording.log(scene.body_paths[0], rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    paths = []
    for shape in scene.shapes:
        path = shape_path(scene, shape)
        mesh = with_normals(shape.vertices, shape.faces)
        drawn = rr.Mesh3D(
            vertex_positions=mesh.vertices, vertex_normals=mesh.vertex_normals, triangle_indices=mesh.faces, albedo_factor=shape.colour
        )
        recording.log(path, drawn, static=True)
        paths.append(path)
    if scene.part >= 0:
        model, site = scene.model, scene.part
        recording.log(
            scene.part_path, rr.Transform3D(translation=model.site_pos[site], quaternion=_xyzw(model.site_quat[site][None])[0]), static=True
        )
    # the part frame as three arrows: x red, y green, z blue
    low, high = scene_bounds(scene)
    length = 0.05 * float(np.linalg.norm(high - low))
    colours = [(226, 74, 51), (46, 160, 67), (56, 128, 240)]
    arrows = rr.Arrows3D(vectors=np.eye(3) * length, colors=colours, radii=length / 40, labels=["x", "y", "z"], show_labels=False)
    recording.log(entity(scene.part_path, "axes"), arrows, static=True)
    return paths


def log_motion(recording: rr.RecordingStream, scene: Scene, time: np.ndarray, local: list[Pose]) -> None:
    """Log parent_from_body at times (sample,) [s]; once for a body that does not move."""
    for path, moving in zip(scene.body_paths[1:], local[1:]):
        steps = moving_steps(moving)
        pose = moving.at(steps)
        if len(steps) == 1:
            recording.log(path, rr.Transform3D(translation=pose.position[0], quaternion=_xyzw(pose.quaternion)[0]), static=True)
            continue
        columns: dict[str, Any] = {}
        if np.any(pose.position):
            columns["translation"] = np.broadcast_to(pose.position, (len(steps), 3))
        if np.any(pose.quaternion[:, 1:]):
            columns["quaternion"] = np.broadcast_to(_xyzw(pose.quaternion), (len(steps), 4))
        recording.send_columns(path, [rr.TimeColumn(TIMELINE, duration=time[steps])], rr.Transform3D.columns(**columns))


def moving_steps(pose: Pose) -> np.ndarray:
    """Indices of the samples of a pose to log: those that differ from a neighbour; one if it never moves."""
    differs = np.zeros(max(len(pose.position), len(pose.quaternion)) - 1, bool)
    for part in (pose.position, pose.quaternion):
        if len(part) > 1:
            differs |= np.any(np.abs(np.diff(part, axis=0)) > SAME_POSE, axis=1)
    return np.flatnonzero(np.r_[True, differs] | np.r_[differs, False])


def with_normals(vertices: np.ndarray, faces: np.ndarray) -> Any:
    """The mesh with merged vertices and their normals: smooth flat edges and sharp creases, which get separate vertices on either side.

    Meshes above SMOOTH_FACES are smooth all over.
    """
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=True)
    return trimesh.graph.smooth_shade(mesh, angle=CREASE) if len(faces) <= SMOOTH_FACES else mesh


def _xyzw(quaternion: np.ndarray) -> np.ndarray:
    """Quaternions (sample, 4) in the viewer's order."""
    return quaternion[:, [1, 2, 3, 0]]
