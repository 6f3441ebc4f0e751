"""The scene of a model: its bodies as a tree of entities, the shapes of each, and both as logged for the viewer.

Shapes of a machine come from its MJCF. Frames come from the machine file, as in the simulation: its offsets, table height and tool
length take precedence. Every shape is a mesh in the frame of its body [m]. The transform of a body is parent_from_body, logged only while it moves.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import functools
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import rerun as rr
import trimesh
from trimesh import creation

from twin.errors import InputError
from twin.geometry.body_poses import Pose, rotation_of
from twin.machine.machine import Machine
from twin.machine.model_limits import compiled_spec
from twin.machine.urdf import shown_urdf
from twin.replay.names import TIMELINE, entity
from twin.simulation.plant_spec import frames_of_model, load_spec

ROOT = "machine"
LAST_SEEN_GROUP = 2
"""Geoms of higher groups are for collision or marks and are not shown, as in MuJoCo's viewer."""
SHEET = 2e-4
"""Thickness of a drawn plane [m]."""
_UNSET_COLOUR = np.array([0.5, 0.5, 0.5, 1.0])
CREASE = np.radians(35.0)
"""An edge is smoothed below this angle between its face normals."""
SAME_POSE = 1e-9
"""Poses that differ by less count as equal [m, 1]; a body at rest is logged at the start and end of its rest."""
SMOOTH_FACES = 30_000
"""Meshes with more faces get one normal per vertex; creases would multiply their size."""


@dataclass(frozen=True)
class Shape:
    """One shape as a mesh: vertices (vertex, 3) [m] in the frame of its body, faces (face, 3), colour (red, green, blue, alpha)."""

    body: int
    name: str
    colour: tuple[int, int, int, int]
    vertices: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True)
class Scene:
    """Bodies (tree and joints in `model`), their entity paths, and the shapes.

    `tool` and `part` are sites of the model, or -1. Without a tool site the tip is the end of the longest chain of joints; without a
    part site the path is drawn in the world.
    """

    name: str
    model: mujoco.MjModel
    body_paths: tuple[str, ...]
    shapes: tuple[Shape, ...]
    tool: int
    part: int
    mimics: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)
    """Joints that follow another one: joint -> (other, factor, offset)."""

    @functools.cached_property
    def joints(self) -> dict[str, str]:
        """Slides and hinges: name -> kind of axis."""
        kinds = {mujoco.mjtJoint.mjJNT_SLIDE: "linear", mujoco.mjtJoint.mjJNT_HINGE: "rotary"}
        own = ((self.model.joint(j).name, mujoco.mjtJoint(kind)) for j, kind in enumerate(self.model.jnt_type))
        return {name: kinds[kind] for name, kind in own if kind in kinds}

    @property
    def tip_body(self) -> int:
        """The body of the tool, else the body with the most joints above it."""
        if self.tool >= 0:
            return int(self.model.site_bodyid[self.tool])
        depth = np.zeros(self.model.nbody, int)
        for body in range(1, self.model.nbody):
            depth[body] = depth[self.model.body_parentid[body]] + self.model.body_jntnum[body]
        return int(np.argmax(depth))

    @property
    def part_path(self) -> str:
        """Entity of the part frame, the parent of the tool paths."""
        if self.part < 0:
            return entity(self.body_paths[0], "part_frame")
        return entity(self.body_paths[self.model.site_bodyid[self.part]], "part_frame")


def scene_of(machine: Machine) -> Scene:
    """The scene of a machine file, with the simulated frames; bodies added by effects have no shapes."""
    return _scene(frames_of_model(machine), machine.name)


def placed_at(scene: Scene, root: str) -> Scene:
    """The scene below another root entity, for several scenes in one recording."""
    return replace(scene, body_paths=tuple(root + path.removeprefix(f"/{ROOT}") for path in scene.body_paths))


def read_scene(path: Path) -> Scene:
    """The scene of a model file: URDF if it ends in .urdf, else MJCF."""
    if not path.is_file():
        raise InputError(f"{path}: no such model; give an MJCF (.xml) or URDF file")
    if path.suffix.lower() != ".urdf":
        return _scene(compiled_spec(load_spec(path), str(path)), path.stem)
    model, mimics = shown_urdf(path)
    return replace(_scene(model, path.stem), mimics=mimics)


def _scene(model: mujoco.MjModel, name: str) -> Scene:
    shapes = [shape for geom in range(model.ngeom) if (shape := _geom_shape(model, geom)) is not None]
    sites = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site) for site in ("tool", "workpiece")]
    return Scene(name, model, body_paths(model), tuple(shapes), *sites)


def body_paths(model: mujoco.MjModel) -> tuple[str, ...]:
    """Entity path of each body below its parent's; the world is the root."""
    paths = [f"/{ROOT}"]
    for body in range(1, model.nbody):
        paths.append(entity(paths[model.body_parentid[body]], model.body(body).name or f"body_{body}"))
    return tuple(paths)


def shape_path(scene: Scene, shape: Shape) -> str:
    """Entity path of a shape below its body; renamed if a body has the same name."""
    path = entity(scene.body_paths[shape.body], shape.name)
    return path if path not in scene.body_paths else entity(scene.body_paths[shape.body], f"{shape.name}_shape")


def shapes_of_tool(scene: Scene) -> tuple[str, ...]:
    """Entities of the tool: shapes of its body with names that start with 'tool'."""
    return tuple(shape_path(scene, s) for s in scene.shapes if s.body == scene.tip_body and s.name.startswith("tool"))


def scene_bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner (3,) of all shapes in the reference pose [m]."""
    data = mujoco.MjData(scene.model)
    mujoco.mj_kinematics(scene.model, data)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for shape in scene.shapes:
        points = shape.vertices @ data.xmat[shape.body].reshape(3, 3).T + data.xpos[shape.body]
        low, high = np.minimum(low, points.min(0)), np.maximum(high, points.max(0))
    return (low, high) if scene.shapes else (np.full(3, -0.5), np.full(3, 0.5))


def _geom_shape(model: mujoco.MjModel, geom: int) -> Shape | None:
    """The shape of a geom; None if it is not drawn (hidden group, transparent, infinite plane)."""
    rgba = model.geom_rgba[geom]
    if model.geom_matid[geom] >= 0 and np.allclose(rgba, _UNSET_COLOUR):
        rgba = model.mat_rgba[model.geom_matid[geom]]
    mesh = None if model.geom_group[geom] > LAST_SEEN_GROUP or rgba[3] == 0.0 else _geom_mesh(model, geom)
    if mesh is None:
        return None
    red, green, blue, alpha = np.rint(255 * np.clip(rgba, 0.0, 1.0)).astype(int).tolist()
    vertices, faces = mesh
    placed = rotation_of(model.geom_quat[geom]).apply(vertices) + model.geom_pos[geom]
    name = model.geom(geom).name or f"shape_{geom}"
    return Shape(int(model.geom_bodyid[geom]), name, (red, green, blue, alpha), placed, faces)


def _geom_mesh(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices (vertex, 3) [m] in the frame of a geom, and its faces (face, 3); None for an infinite plane."""
    kinds = mujoco.mjtGeom
    kind, size = kinds(model.geom_type[geom]), model.geom_size[geom]
    if kind in (kinds.mjGEOM_MESH, kinds.mjGEOM_SDF):
        mesh = model.mesh(model.geom_dataid[geom])
        first, first_face = int(mesh.vertadr[0]), int(mesh.faceadr[0])
        vertices = model.mesh_vert[first : first + int(mesh.vertnum[0])].astype(float)
        return vertices, model.mesh_face[first_face : first_face + int(mesh.facenum[0])]
    if kind == kinds.mjGEOM_HFIELD:
        return _height_field(model, model.geom_dataid[geom])
    if kind == kinds.mjGEOM_PLANE and np.all(size[:2] > 0.0):
        solid = creation.box(extents=(2.0 * size[0], 2.0 * size[1], SHEET))
    elif kind == kinds.mjGEOM_BOX:
        solid = creation.box(extents=2.0 * size)
    elif kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
        solid = creation.icosphere(subdivisions=3).apply_scale(size if kind == kinds.mjGEOM_ELLIPSOID else size[0])
    elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
        solid = (creation.cylinder if kind == kinds.mjGEOM_CYLINDER else creation.capsule)(radius=size[0], height=2.0 * size[1])
    else:
        return None
    return np.asarray(solid.vertices), np.asarray(solid.faces)


def _height_field(model: mujoco.MjModel, field: int) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    x, y, z, _ = model.hfield_size[field]
    first = model.hfield_adr[field]
    heights = model.hfield_data[first : first + rows * columns] * z
    gx, gy = np.meshgrid(np.linspace(-x, x, columns), np.linspace(-y, y, rows))
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = np.vstack([np.c_[corner, corner + 1, corner + columns], np.c_[corner + 1, corner + columns + 1, corner + columns]])
    return np.column_stack([gx.ravel(), gy.ravel(), heights]), faces


def log_scene(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log the static content: shapes and part frame."""
    recording.log(scene.body_paths[0], rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for shape in scene.shapes:
        mesh = with_normals(shape.vertices, shape.faces)
        drawn = rr.Mesh3D(
            vertex_positions=mesh.vertices, vertex_normals=mesh.vertex_normals, triangle_indices=mesh.faces, albedo_factor=shape.colour
        )
        recording.log(shape_path(scene, shape), drawn, static=True)
    if scene.part >= 0:
        model, site = scene.model, scene.part
        placed = rr.Transform3D(translation=model.site_pos[site], quaternion=rotation_of(model.site_quat[site]).as_quat())
        recording.log(scene.part_path, placed, static=True)
    # the part frame as three arrows: x red, y green, z blue
    low, high = scene_bounds(scene)
    length = 0.05 * float(np.linalg.norm(high - low))
    colours = [(226, 74, 51), (46, 160, 67), (56, 128, 240)]
    arrows = rr.Arrows3D(vectors=np.eye(3) * length, colors=colours, radii=length / 40, labels=["x", "y", "z"], show_labels=False)
    recording.log(entity(scene.part_path, "axes"), arrows, static=True)


def log_motion(recording: rr.RecordingStream, scene: Scene, time: np.ndarray, local: list[Pose]) -> None:
    """Log parent_from_body at times (sample,) [s]; once for a body that does not move."""
    for path, moving in zip(scene.body_paths[1:], local[1:]):
        steps = moving_steps(moving)
        pose = moving.at(steps)
        position, quaternion = pose.position, pose.rotation.as_quat()
        if len(steps) == 1:
            recording.log(path, rr.Transform3D(translation=position[0], quaternion=quaternion[0]), static=True)
            continue
        columns: dict[str, Any] = {}
        if np.any(position):
            columns["translation"] = np.broadcast_to(position, (len(steps), 3))
        if np.any(quaternion[:, :3]):
            columns["quaternion"] = np.broadcast_to(quaternion, (len(steps), 4))
        recording.send_columns(path, [rr.TimeColumn(TIMELINE, duration=time[steps])], rr.Transform3D.columns(**columns))


def moving_steps(pose: Pose) -> np.ndarray:
    """Indices of the samples of a pose to log: those that differ from a neighbour; one if it never moves."""
    parts = pose.position, pose.rotation.as_quat()
    differs = np.zeros(max(map(len, parts)) - 1, bool)
    for part in parts:
        if len(part) > 1:
            differs |= np.any(np.abs(np.diff(part, axis=0)) > SAME_POSE, axis=1)
    return np.flatnonzero(np.r_[True, differs] | np.r_[differs, False])


def with_normals(vertices: np.ndarray, faces: np.ndarray) -> Any:
    """The mesh with merged vertices and their normals: smooth flat edges and sharp creases, which get separate vertices on either side.

    Meshes above SMOOTH_FACES are smooth all over.
    """
    mesh = trimesh.Trimesh(vertices, faces, process=True)
    return trimesh.graph.smooth_shade(mesh, angle=CREASE) if len(faces) <= SMOOTH_FACES else mesh
