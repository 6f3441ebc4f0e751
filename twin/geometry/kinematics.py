"""Kinematic transformation of a machine: tool pose in the part frame from axis positions, and the inverse.

The frames (joint axes, anchors, sites `tool` and `workpiece`) come from the MJCF at rest with the lengths of the machine file. A machine
has three slides, and up to two rotary axes that turn the part (table) or the tool (head). The *turning* axis is the rotary axis nearer
to the part in the chain, the *tilting* axis the one nearer to the tool. Table-table: both turn the part. Head-table: the turning axis
turns the part, the tilting axis the tool. Head-head: both turn the tool.

workpiece_from_tool = (bed_from_workpiece(tilt, turn))^-1 @ bed_from_tool(X, Y, Z, tilt, turn)

The direction of a slide under the table is reversed. Positions in m, angles in rad, right-handed. Arrays are (sample, axis) in the order
X, Y, Z, tilting axis, turning axis (A and C of the Mikron). The tool axis is the unit vector from the tip to the spindle. Axes may be
skew and offset. Slides carried by a rotary axis are not covered.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.errors import InputError
from twin.geometry.chain import Joint, frames_at_rest
from twin.machine.machine import Machine
from twin.machine.model_file import state_of_model

SINGULAR_SINE = 1e-9
"""A tool axis closer (as a sine) to the turning axis leaves C undetermined; C then keeps its angle."""
REACH_TOLERANCE = 1e-9
"""A tool axis that misses the reachable cone by less (as a cosine) counts as reachable, because programs are rounded."""
FEWER_AXES_TOLERANCE = 1e-5
"""The same for a machine with fewer than two rotary axes, which cannot adapt to rounding."""


@dataclass(frozen=True)
class Kinematics:
    """Frames of a machine at rest, in the bed (world) frame.

    slides              (3, 3), directions of X, Y, Z as columns, reversed for slides under the table
    tool_tip, tool_axis (3,)
    tilt, turn          the rotary axes; `on_table`: turns the part (True) or the tool (False)
    part_origin         (3,), and part_axes (3, 3) with the axes as columns: the part frame
    travel              (5, 2), may be infinite
    names               axes of the machine, '' for a missing one
    letters             axis letters of programs
    """

    slides: np.ndarray
    tool_tip: np.ndarray
    tool_axis: np.ndarray
    tilt: Joint
    turn: Joint
    part_origin: np.ndarray
    part_axes: np.ndarray
    travel: np.ndarray
    tool_length: float
    names: tuple[str, ...]
    letters: tuple[str, ...]

    @property
    def label(self) -> tuple[str, ...]:
        """Names of the five axes in messages: the name, or the letter of a missing axis."""
        return tuple(name or letter for name, letter in zip(self.names, self.letters))

    def with_tool_length(self, length: float) -> Kinematics:
        """The same machine with a tool of another length [m], measured along the tool axis from the spindle nose."""
        return replace(self, tool_tip=self.tool_tip - (length - self.tool_length) * self.tool_axis, tool_length=length)

    def _turned(self, points: np.ndarray, angles: np.ndarray, table: bool, *, back: bool = False, anchored: float = 1.0) -> np.ndarray:
        """Points (sample or 1, 3) turned by the rotary axes (sample, 2) of the table or of the head, or `back`; directions with `anchored` 0."""
        tilt, turn = (self.tilt, angles[:, 0]), (self.turn, angles[:, 1])
        # a table turns before it tilts, a head tilts before it turns; the way back is the other way round
        for joint, angle in (tilt, turn) if table == back else (turn, tilt):
            if joint.on_table == table:
                points = turned(points, joint.axis, anchored * joint.anchor, -angle if back else angle)
        return points

    def tip(self, axes: np.ndarray) -> np.ndarray:
        """Tool tip (sample, 3) in the part frame, for axes (sample, 5)."""
        axes = np.atleast_2d(axes)
        in_bed = axes[:, :3] @ self.slides.T + self._turned(self.tool_tip[None], axes[:, 3:], table=False)
        return np.asarray((self._turned(in_bed, axes[:, 3:], table=True, back=True) - self.part_origin) @ self.part_axes)

    def direction(self, angles: np.ndarray) -> np.ndarray:
        """Tool axis (sample, 3) in the part frame, for rotary axes (sample, 2)."""
        angles = np.atleast_2d(angles)
        in_bed = self._turned(np.broadcast_to(self.tool_axis, (len(angles), 3)), angles, table=False, anchored=0.0)
        return self._turned(in_bed, angles, table=True, back=True, anchored=0.0) @ self.part_axes

    def forward(self, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tool tip (sample, 3) and tool axis (sample, 3) in the part frame, for axes (sample, 5)."""
        axes = np.atleast_2d(axes)
        return self.tip(axes), self.direction(axes[:, 3:])

    def linear_axes(self, tip: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """X, Y, Z (sample, 3) that place the tip at (sample, 3) in the part frame, for given rotary axes (sample, 2)."""
        tip, angles = np.atleast_2d(tip), np.atleast_2d(angles)
        in_bed = self._turned(self.part_origin + tip @ self.part_axes.T, angles, table=True)
        return (in_bed - self._turned(self.tool_tip[None], angles, table=False)) @ np.linalg.inv(self.slides).T

    def angles(self, tool_axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Both solutions (tilt, turn) for tool axes (sample, 3) in the part frame.

        Returns angles (solution 0 or 1, sample, 2) in (-pi, pi], and reachable (sample,). If the tool axis is parallel to the turning axis,
        any turn is possible and NaN is returned. With one rotary axis both solutions are equal.
        """
        axis = np.atleast_2d(tool_axis)
        axis = (axis / np.linalg.norm(axis, axis=1, keepdims=True)) @ self.part_axes.T
        # a head that turns by +angle equals a table that turns by -angle: its axis is reversed
        a, c = (joint.axis if joint.on_table else -joint.axis for joint in (self.tilt, self.turn))
        z = self.tool_axis
        pairs = np.zeros((2, len(axis), 2))
        if not self.names[3]:
            off = axis @ c - c @ z if self.names[4] else np.linalg.norm(axis - z, axis=1)
            pairs[:, :, 1] = _turn_between(axis, np.broadcast_to(z, axis.shape), c) if self.names[4] else np.nan
            return pairs, np.abs(off) <= FEWER_AXES_TOLERANCE
        # c . Rot(a, -A) z = c . axis is one equation in A alone: p cos A + q sin A = r
        p, q = c @ z - (a @ z) * (a @ c), -(c @ np.cross(a, z))
        r = axis @ c - (a @ z) * (a @ c)
        size = np.hypot(p, q)
        if size < SINGULAR_SINE:
            raise InputError("machine: the tilting axis is parallel to the turning axis; check the joints of the MJCF")
        reachable = np.abs(r) <= size * (1.0 + REACH_TOLERANCE)
        half = np.arccos(np.clip(r / size, -1.0, 1.0))
        for k, sign in enumerate((1.0, -1.0)):
            tilt = _wrapped(np.arctan2(q, p) + sign * half)
            # C must turn the tool axis into this direction, after A is undone
            goal = turned(z[None], a, np.zeros(3), -tilt)
            pairs[k, :, 0] = tilt
            pairs[k, :, 1] = _turn_between(axis, goal, c)
        return pairs, reachable

    def outside_travel(self, axes: np.ndarray) -> tuple[int, int] | None:
        """First (sample, axis) outside travel, but for rounding, or None."""
        outside = (axes < self.travel[:, 0] - 1e-9) | (axes > self.travel[:, 1] + 1e-9)
        hits = np.argwhere(outside)
        return (int(hits[0][0]), int(hits[0][1])) if len(hits) else None


def turned(points: np.ndarray, axis: np.ndarray, anchor: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Points (sample or 1, 3) turned about a unit axis (3,) through an anchor (3,) by angles (sample,): Rodrigues' formula without matrices."""
    arm = points - anchor
    x, y, z = axis
    across = arm @ np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # axis x arm
    along = np.outer(arm @ axis, axis)
    return np.asarray(anchor + along + np.cos(angle)[:, None] * (arm - along) + np.sin(angle)[:, None] * across)


def great_circle(a: np.ndarray, b: np.ndarray, angle: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Directions (sample, 3) at shares of the great circle from unit vectors a to b, `angle` [rad] apart and not opposite."""
    way = np.where(angle < 1e-9, a, np.sin((1.0 - share) * angle) * a + np.sin(share * angle) * b)
    return np.asarray(way / np.linalg.norm(way, axis=-1, keepdims=True))


def _turn_between(axis: np.ndarray, goal: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Angles (sample,) about c (3,) that turn directions (sample, 3) to their goals; NaN for a direction parallel to c."""
    have, want = axis - np.outer(axis @ c, c), goal - np.outer(goal @ c, c)
    turn = np.arctan2(np.cross(have, want) @ c, np.einsum("ni,ni->n", have, want))
    return np.where(np.linalg.norm(have, axis=1) < SINGULAR_SINE, np.nan, turn)


def _wrapped(angle: np.ndarray) -> np.ndarray:
    """Angles in (-pi, pi]."""
    return np.pi - np.mod(np.pi - angle, 2.0 * np.pi)


def kinematics_of(machine: Machine, *, sites_needed: bool = True) -> Kinematics:
    """The kinematics of a machine: frames from its MJCF, lengths and travels from its machine file. Results are cached.

    With `sites_needed` False, a machine of slides alone may lack the sites tool and workpiece.
    """
    travels = {axis.name: axis.travel for axis in machine.axes}
    tables = repr((machine.geometry, machine.document.get("program"), travels, list(machine.document["axis"])))
    key = (machine.model_path, state_of_model(machine.model_path), tables, sites_needed)
    if key not in _KNOWN:
        frames = frames_at_rest(machine, sites_needed)
        if len(_KNOWN) >= MOST_KNOWN:
            _KNOWN.clear()
        _KNOWN[key] = Kinematics(**frames, travel=np.array([travels.get(name, (0.0, 0.0)) for name in frames["names"]]))
    return _KNOWN[key]


_KNOWN: dict[object, Kinematics] = {}
MOST_KNOWN = 16
"""Most kinematics in the cache, keyed by all that they depend on."""
