"""Motion of any model: from a trace with columns named like its joints, or a sweep through their ranges."""

from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from twin.errors import InputError, nearest
from twin.recordings.trace import read_trace
from twin.replay.scene import Scene, scene_bounds
from twin.replay.toolpaths import followed_joints

SWEEP_SECONDS = 4.0
"""Duration of the sweep of each joint [s]."""
SWEEP_RATE = 50.0
FREE_SLIDE = 0.1
"""Sweep of a slide without limits each way, relative to the model's size."""


def motion_from_trace(scene: Scene, path: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Time (sample,) [s] and joint positions (sample,) by joint [m, rad], from a trace whose axes are joints of the scene."""
    trace = read_trace(path, axes=scene.joints)
    joints = followed_joints(trace)
    if not joints:
        unit = "mm" if "linear" in scene.joints.values() else "deg"
        raise InputError(
            f"{path}: no position of a joint of {scene.name}; it needs columns such as '{next(iter(scene.joints), 'joint')}.position [{unit}]'"
        )
    return trace.time - trace.time[0], joints


def sweep(scene: Scene) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Move each joint in turn from its reference to its lower end, its upper end and back, with a stop at each."""
    free = [name for name in scene.joints if name not in scene.mimics]
    if not free:
        raise InputError(f"{scene.name}: the model has no slide or hinge to move; give a model with joints")
    if "" in free:
        raise InputError(f"{scene.name}: a joint has no name; give every joint a name")
    time = np.arange(round(len(free) * SWEEP_SECONDS * SWEEP_RATE) + 1) / SWEEP_RATE
    size = float(np.linalg.norm(np.subtract(*scene_bounds(scene))))
    joints = {}
    for i, name in enumerate(free):
        joint = scene.model.joint(name).id
        start = float(scene.model.qpos0[scene.model.jnt_qposadr[joint]])
        reach = FREE_SLIDE * size if scene.joints[name] == "linear" else np.pi
        low, high = scene.model.jnt_range[joint] if scene.model.jnt_limited[joint] else (start - reach, start + reach)
        # three moves with a soft start and end: to the lower end, to the upper end, home
        part = np.clip((time - i * SWEEP_SECONDS) / SWEEP_SECONDS, 0.0, 1.0) * 4.0
        joints[name] = CubicHermiteSpline([0.0, 1.0, 3.0, 4.0], [start, low, high, start], np.zeros(4))(part)
    return time, joints


def with_mimics(scene: Scene, joints: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Add joints that follow others: value = factor * other + offset."""
    followed = dict(joints)
    for name, (other, factor, offset) in scene.mimics.items():
        if name not in joints and other in joints:
            followed[name] = factor * joints[other] + offset
        elif other not in scene.joints:
            raise InputError(f"{scene.name}: joint '{name}' follows joint '{other}', which does not exist; {nearest(other, scene.joints)}")
    return followed
