"""The five-axis transformation: where the tool is in the part for given axes, and which axes bring it there.

The frames are read from the MJCF at rest with the machine file's lengths (joint axes, anchors, sites `tool` and `workpiece`);
nothing is typed twice. With axes X Y Z A C the part side is turned by R = Rot(A) Rot(C), both about the joints' own axes, the tool side is
shifted along the slides:

    workpiece_from_tool = (bed_from_workpiece(A, C))^-1 @ bed_from_tool(X, Y, Z)

Positions in m, angles in rad, right-handed; arrays are (sample, axis) in machine order X Y Z A C. The tool axis is the
unit vector from the tip towards the spindle. Any machine of the structure RRTTT is covered, with skew axes and offsets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.errors import InputError
from twin.machine.machine import Machine

if TYPE_CHECKING:
    import mujoco

SINGULAR_SINE = 1e-9
"""A tool axis closer than this (as a sine) to the turning axis leaves C free: C then keeps its angle."""
REACH_TOLERANCE = 1e-9
"""A tool axis may miss the reachable cone by this (as a cosine) and count as on its edge: rounding of the program."""


@dataclass(frozen=True)
class Kinematics:
    """Frames of a RRTTT machine at rest, in the bed (world) frame.

    `slides` (3, 3) has the directions of X Y Z as columns; `tool_tip` (3,), `tool_axis` (3,) belong to the tool;
    `tilt_*` and `turn_*` are axis (3,) and anchor (3,) of the outer (A) and inner (C) rotation; `part_origin` (3,) and
    `part_axes` (3, 3, columns) place the workpiece. `travel` (5, 2) may hold infinities.
    """

    slides: np.ndarray
    tool_tip: np.ndarray
    tool_axis: np.ndarray
    tilt_axis: np.ndarray
    tilt_anchor: np.ndarray
    turn_axis: np.ndarray
    turn_anchor: np.ndarray
    part_origin: np.ndarray
    part_axes: np.ndarray
    travel: np.ndarray
    tool_length: float

    def with_tool_length(self, length: float) -> Kinematics:
        """The same machine with a tool of another length [m], measured along the tool axis from the spindle nose."""
        return replace(self, tool_tip=self.tool_tip - (length - self.tool_length) * self.tool_axis, tool_length=length)

    def with_placement(self, offset: np.ndarray, rotation: np.ndarray | None = None) -> Kinematics:
        """The part frame moved by `offset` (3,) [m] and turned by `rotation` (3, 3), both given in the present part frame."""
        axes = self.part_axes if rotation is None else self.part_axes @ rotation
        return replace(self, part_origin=self.part_origin + self.part_axes @ np.asarray(offset, float), part_axes=axes)

    def part_rotation(self, axes: np.ndarray) -> np.ndarray:
        """bed_from_workpiece rotations (sample, 3, 3)."""
        axes = np.atleast_2d(axes)
        return rotation(self.tilt_axis, axes[:, 3]) @ rotation(self.turn_axis, axes[:, 4]) @ self.part_axes

    def part_position(self, axes: np.ndarray) -> np.ndarray:
        """Origin of the part frame in the bed frame (sample, 3)."""
        axes = np.atleast_2d(axes)
        return self._part_position(rotation(self.tilt_axis, axes[:, 3]), rotation(self.turn_axis, axes[:, 4]))

    def _part_position(self, tilt: np.ndarray, turn: np.ndarray) -> np.ndarray:
        turned = turn @ (self.part_origin - self.turn_anchor) + self.turn_anchor
        return np.einsum("nij,nj->ni", tilt, turned - self.tilt_anchor) + self.tilt_anchor

    def tip_in_bed(self, axes: np.ndarray) -> np.ndarray:
        """Tool tip in the bed frame (sample, 3)."""
        return np.atleast_2d(axes)[:, :3] @ self.slides.T + self.tool_tip

    def forward(self, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tool tip (sample, 3) and tool axis (sample, 3) in the part frame, for axes (sample, 5)."""
        axes = np.atleast_2d(axes)
        tilt, turn = rotation(self.tilt_axis, axes[:, 3]), rotation(self.turn_axis, axes[:, 4])
        workpiece_from_bed = np.swapaxes(tilt @ turn @ self.part_axes, 1, 2)
        tip = np.einsum("nij,nj->ni", workpiece_from_bed, self.tip_in_bed(axes) - self._part_position(tilt, turn))
        return tip, workpiece_from_bed @ self.tool_axis

    def linear_axes(self, tip: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """X Y Z (sample, 3) that hold the tip (sample, 3, part frame) at given A and C (sample, 2)."""
        tip, angles = np.atleast_2d(tip), np.atleast_2d(angles)
        axes = np.column_stack([np.zeros((len(angles), 3)), angles])
        in_bed = np.einsum("nij,nj->ni", self.part_rotation(axes), tip) + self.part_position(axes)
        return (in_bed - self.tool_tip) @ np.linalg.inv(self.slides).T

    def angles(self, tool_axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Both pairs (A, C) for tool axes (sample, 3) in the part frame.

        Returns angles (solution 0 or 1, sample, 2), A and C in (-pi, pi], and reachable (sample,). Where the tool axis
        lies along the turning axis C is NaN: any angle serves.
        """
        axis = np.atleast_2d(tool_axis)
        axis = (axis / np.linalg.norm(axis, axis=1, keepdims=True)) @ self.part_axes.T
        a, c, z = self.tilt_axis, self.turn_axis, self.tool_axis
        # c . Rot(a, -A) z = c . axis is one equation in A alone: p cos A + q sin A = r
        p, q = c @ z - (a @ z) * (a @ c), -(c @ np.cross(a, z))
        r = axis @ c - (a @ z) * (a @ c)
        size = np.hypot(p, q)
        if size < SINGULAR_SINE:
            raise InputError("machine: the tilting axis cannot tilt the tool against the turning axis; check the joints of the MJCF")
        reachable = np.abs(r) <= size * (1.0 + REACH_TOLERANCE)
        half = np.arccos(np.clip(r / size, -1.0, 1.0))
        pairs = np.empty((2, len(axis), 2))
        for k, sign in enumerate((1.0, -1.0)):
            tilt = _wrapped(np.arctan2(q, p) + sign * half)
            # what C must turn the tool axis into, seen after A is undone
            goal = np.einsum("nij,j->ni", rotation(a, -tilt), z)
            have, want = axis - np.outer(axis @ c, c), goal - np.outer(goal @ c, c)
            turn = np.arctan2(np.cross(have, want) @ c, np.einsum("ni,ni->n", have, want))
            pairs[k, :, 0] = tilt
            pairs[k, :, 1] = np.where(np.linalg.norm(have, axis=1) < SINGULAR_SINE, np.nan, turn)
        return pairs, reachable

    def outside_travel(self, axes: np.ndarray, tolerance: float = 1e-9) -> tuple[int, int] | None:
        """First (sample, axis) outside travel, or None."""
        outside = (axes < self.travel[:, 0] - tolerance) | (axes > self.travel[:, 1] + tolerance)
        hits = np.argwhere(outside)
        return (int(hits[0][0]), int(hits[0][1])) if len(hits) else None


def rotation(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotations (sample, 3, 3) about a unit axis (3,) by angles (sample,): Rodrigues' formula, right-handed."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.asarray(angle, float)[:, None, None]
    along = np.outer(axis, axis)
    return along + np.cos(angle) * (np.eye(3) - along) + np.sin(angle) * cross


def _wrapped(angle: np.ndarray) -> np.ndarray:
    """Angles in (-pi, pi]."""
    return np.pi - np.mod(np.pi - angle, 2.0 * np.pi)


def kinematics_of(machine: Machine) -> Kinematics:
    """The kinematics of a machine: frames from its MJCF, lengths and travels from its machine file."""
    order = ("X", "Y", "Z", "A", "C")
    known = {axis.name: axis.travel for axis in machine.axes}
    travel = np.array([known.get(name, (0.0, 0.0)) for name in order])
    return Kinematics(**_frames(machine), travel=travel)


def _frames(machine: Machine) -> Mapping[str, Any]:
    """Read the frames with all axes at zero."""
    import mujoco  # only here: usage and what moves need no engine

    from twin.simulation.plant_spec import frames_of_model

    model_path = machine.model_path
    model = frames_of_model(machine)
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    sites = {}
    for name in ("tool", "workpiece"):
        sites[name] = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
        if sites[name] < 0:
            raise InputError(f"{model_path}: no site '{name}'; the five-axis transformation needs the sites tool and workpiece")
    slides = _chain(model, sites["tool"], mujoco.mjtJoint.mjJNT_SLIDE)
    turns = _chain(model, sites["workpiece"], mujoco.mjtJoint.mjJNT_HINGE)
    joint = {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j): j for j in (*slides, *turns)}
    if len(slides) != 3 or len(turns) != 2 or not {"X", "Y", "Z", "A", "C"} <= set(joint):
        raise InputError(
            f"{model_path}: not a RRTTT machine: the tool must hang on the slides X Y Z and the part on the hinges A C, "
            f"found {', '.join(map(str, joint))}; correct the joints"
        )
    tilt, turn = turns[1], turns[0]  # from the part outwards: first C, then A
    if tilt != joint["A"] or turn != joint["C"]:
        raise InputError(f"{model_path}: the part must hang on C and C on A; reorder the bodies")
    tool_body = model.site_bodyid[sites["tool"]]
    tool_axis = data.site_xmat[sites["tool"]].reshape(3, 3)[:, 2]
    # where the file does not say how long the tool is, the body that carries it begins at the spindle nose
    carrier_to_tip = float((data.xpos[tool_body] - data.site_xpos[sites["tool"]]) @ tool_axis)
    return {
        "slides": np.column_stack([data.xaxis[joint[name]] for name in "XYZ"]),
        "tool_tip": data.site_xpos[sites["tool"]].copy(),
        "tool_axis": tool_axis.copy(),
        "tilt_axis": data.xaxis[tilt].copy(),
        "tilt_anchor": data.xanchor[tilt].copy(),
        "turn_axis": data.xaxis[turn].copy(),
        "turn_anchor": data.xanchor[turn].copy(),
        "part_origin": data.site_xpos[sites["workpiece"]].copy(),
        "part_axes": data.site_xmat[sites["workpiece"]].reshape(3, 3).copy(),
        "tool_length": machine.geometry.get("tool_length_m", carrier_to_tip),
    }


def _chain(model: mujoco.MjModel, site: int, kind: int) -> list[int]:
    """Joints between a site and the bed, from the site outwards; other kinds of joints there are an error of the caller."""
    joints, body = [], model.site_bodyid[site]
    while body:
        first, count = model.body_jntadr[body], model.body_jntnum[body]
        joints += [j for j in range(first + count - 1, first - 1, -1) if model.jnt_type[j] == kind]
        body = model.body_parentid[body]
    return joints
