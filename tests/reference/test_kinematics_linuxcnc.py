"""The five-axis transformation against LinuxCNC's kinematics of a tilting rotary table, on a million poses.

Its source is read where it lies (../shared, not part of this repository) and its expressions are evaluated as they stand. Its axes name the
turn of the tool against the table where `con` is 1, and that of the table, which is the opposite and ours, where it is -1, its default. Both are
checked. Its coordinates are the machine's at A = C = 0, ours the part's.
"""

from __future__ import annotations

from pathlib import Path
import re

import numpy as np
import pytest

from tests.conftest import SHARED
from twin.geometry.kinematics import Kinematics, kinematics_of
from twin.machine.machine import Machine

POSES = 1_000_000
CLOSE = 1e-12
"""1e-9 mm in m."""
GEOMETRIES = {
    "axes meet": {},
    "C beside and below A": {"geometry.a_axis_to_c_axis_y_m": 0.031, "geometry.a_axis_to_c_axis_z_m": -0.047},
}


def source() -> str:
    """The source of LinuxCNC's transformation; skips the test if it is missing."""
    folder = SHARED / "data" / "linuxcnc" / "kinematics"
    files = sorted(folder.glob("trtfuncs.c")) if folder.is_dir() else []
    if not files:
        pytest.skip("no ../shared/data/linuxcnc/kinematics/trtfuncs.c beside this repository")
    return Path(files[0]).read_text(encoding="utf-8")


def expressions(function: str, target: str) -> dict[str, str]:
    """Right-hand sides of `target`.x, .y, .z in a function of the source, as Python."""
    text = source()
    body = text[text.index(f"int {function}(") :]
    found = {}
    for axis in "xyz":
        match = re.search(rf"{re.escape(target)}\.{axis}\s*=(.*?);", body, re.S)
        assert match is not None
        python = re.sub(r"joints\[J([XYZ])\]", r"\1", match[1])
        found[axis] = " ".join(re.sub(r"pos->tran\.([xyz])", r"\1", python).split())
    return found


def settings(kinematics: Kinematics, angles: np.ndarray, con: float) -> dict[str, object]:
    """Its names and their values for our machine."""
    x, y, _ = kinematics.turn.anchor
    a, c = -con * angles[:, 0], -con * angles[:, 1]
    here = {"cos": np.cos, "sin": np.sin, "a_rad": a, "c_rad": c, "con": con, "x_rot_point": x, "y_rot_point": y}
    # the tilting axis: its place above the turning one is a coordinate of its own
    return {**here, "z_rot_point": kinematics.tilt.anchor[2], "dy": kinematics.tilt.anchor[1] - y, "dz": 0.0}


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_forward_and_inverse(mikron: Machine, geometry: str) -> None:
    """Tip in the part for random axes, and the axes for that tip: both to 1e-9 mm."""
    kinematics = kinematics_of(mikron.with_values(GEOMETRIES[geometry]))
    rng = np.random.default_rng(710)
    worst = np.zeros(2)
    for i in range(10):
        count = POSES // 10
        low, high = np.clip(kinematics.travel, -np.pi, np.pi).T
        axes = rng.uniform(low, high, (count, 5))
        tip, _ = kinematics.forward(axes)
        values = settings(kinematics, axes[:, 3:], -1.0 if i % 2 else 1.0)
        bed = kinematics.tool_tip + axes[:, :3] @ kinematics.slides.T
        forward = expressions("xyzacKinematicsForward", "pos->tran")
        its = np.column_stack([eval(forward[k], {**values, **dict(zip("XYZ", bed.T))}) for k in "xyz"])
        worst[0] = max(worst[0], np.abs(its - kinematics.part_origin - tip).max())
        inverse = expressions("xyzacKinematicsInverse", "P.tran")
        back = np.column_stack([eval(inverse[k], {**values, **dict(zip("xyz", (tip + kinematics.part_origin).T))}) for k in "xyz"])
        worst[1] = max(worst[1], np.abs(back - bed).max(), np.abs(kinematics.linear_axes(tip, axes[:, 3:]) - axes[:, :3]).max())
    assert worst.max() < CLOSE
