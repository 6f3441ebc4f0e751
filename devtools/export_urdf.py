"""Write a machine as URDF: links with the masses of its machine file, joints with its travel and speeds, visual shapes.

    python devtools/export_urdf.py                                the Mikron, to out/mikron_ucp710.urdf
    python devtools/export_urdf.py --machine my.toml --out my.urdf

URDF has no motors: rotor inertia, gear and friction stay in the machine file. tests/reference/test_urdf.py compares the joint
accelerations of the exported URDF with those of the MJCF.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
import sys
from xml.etree import ElementTree

import mujoco
import numpy as np

from twin.errors import InputError, TwinError
from twin.machine.machine import Machine, load_machine
from twin.simulation.plant_spec import build_plant

_SHAPES = {
    int(mujoco.mjtGeom.mjGEOM_BOX): lambda size: ("box", {"size": _numbers(2.0 * size)}),
    int(mujoco.mjtGeom.mjGEOM_SPHERE): lambda size: ("sphere", {"radius": _number(size[0])}),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): lambda size: ("cylinder", {"radius": _number(size[0]), "length": _number(2.0 * size[1])}),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): lambda size: ("cylinder", {"radius": _number(size[0]), "length": _number(2.0 * size[1])}),
}


def export_urdf(machine: Machine, path: Path) -> None:
    """Write the URDF of a machine, and the meshes of its model as STL beside it."""
    model = build_plant(machine).model
    shapes = mujoco.MjModel.from_xml_path(str(machine.model_path))
    robot = ElementTree.Element("robot", name=path.stem)
    # the frame of a link is at its joint, that of a body anywhere
    anchors = np.zeros((model.nbody, 3))
    for body in range(1, model.nbody):
        if model.body_jntnum[body] > 1:
            raise InputError(f"body {model.body(body).name} has {model.body_jntnum[body]} joints; a URDF link has one: split the body")
        if model.body_jntnum[body]:
            anchors[body] = model.jnt_pos[model.body_jntadr[body]]
    for body in range(model.nbody):
        link = ElementTree.SubElement(robot, "link", name=model.body(body).name)
        if body and model.body_mass[body] > 0.0:
            _inertial(link, model, body, anchors[body])
        _visuals(link, shapes, shapes.body(model.body(body).name).id, anchors[body], path)
    for body in range(1, model.nbody):
        _joint(robot, model, machine, body, anchors)
    ElementTree.indent(robot)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text('<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n", encoding="utf-8")


def _inertial(link: ElementTree.Element, model: mujoco.MjModel, body: int, anchor: np.ndarray) -> None:
    inertial = ElementTree.SubElement(link, "inertial")
    _origin(inertial, model.body_ipos[body] - anchor, model.body_iquat[body])
    ElementTree.SubElement(inertial, "mass", value=_number(model.body_mass[body]))
    x, y, z = (_number(v) for v in model.body_inertia[body])
    ElementTree.SubElement(inertial, "inertia", ixx=x, ixy="0", ixz="0", iyy=y, iyz="0", izz=z)


def _joint(robot: ElementTree.Element, model: mujoco.MjModel, machine: Machine, body: int, anchors: np.ndarray) -> None:
    parent = int(model.body_parentid[body])
    has = bool(model.body_jntnum[body])
    j = int(model.body_jntadr[body])
    name = model.joint(j).name if has else f"{model.body(body).name}_fixed"
    kind = "fixed"
    if has:
        axis = machine.axis(name)
        slide = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
        kind = "prismatic" if slide else "revolute" if math.isfinite(axis.travel[0]) else "continuous"
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=model.body(parent).name)
    ElementTree.SubElement(joint, "child", link=model.body(body).name)
    shift = np.zeros(3)
    mujoco.mju_rotVecQuat(shift, anchors[body], model.body_quat[body])
    _origin(joint, model.body_pos[body] + shift - anchors[parent], model.body_quat[body])
    if has:
        ElementTree.SubElement(joint, "axis", xyz=_numbers(model.jnt_axis[j]))
        limits = {"effort": _number(axis.motor.peak_current_a * axis.motor.torque_constant_nm_per_a / axis.ratio)}
        limits["velocity"] = _number(axis.max_velocity)
        if kind != "continuous":
            limits |= {"lower": _number(axis.travel[0]), "upper": _number(axis.travel[1])}
        ElementTree.SubElement(joint, "limit", limits)
        ElementTree.SubElement(joint, "dynamics", damping=_number(axis.viscous_friction), friction=_number(axis.coulomb_friction))


def _visuals(link: ElementTree.Element, model: mujoco.MjModel, body: int, anchor: np.ndarray, path: Path) -> None:
    import trimesh

    for g in np.flatnonzero(model.geom_bodyid == body):
        kind = int(model.geom_type[g])
        if kind == int(mujoco.mjtGeom.mjGEOM_MESH):
            m = int(model.geom_dataid[g])
            first, count = model.mesh_vertadr[m], model.mesh_vertnum[m]
            face, faces = model.mesh_faceadr[m], model.mesh_facenum[m]
            file = path.parent / "meshes" / f"{model.mesh(m).name}.stl"
            file.parent.mkdir(parents=True, exist_ok=True)
            trimesh.Trimesh(model.mesh_vert[first : first + count], model.mesh_face[face : face + faces], process=False).export(file)
            shape = ("mesh", {"filename": f"meshes/{file.name}"})
        elif kind in _SHAPES:
            shape = _SHAPES[kind](model.geom_size[g])
        else:
            continue
        visual = ElementTree.SubElement(link, "visual")
        _origin(visual, model.geom_pos[g] - anchor, model.geom_quat[g])
        ElementTree.SubElement(ElementTree.SubElement(visual, "geometry"), *shape)
        material = model.geom_matid[g]
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[g]
        named = ElementTree.SubElement(visual, "material", name=f"{link.get('name')}_{g}")
        ElementTree.SubElement(named, "color", rgba=_numbers(rgba))


def _origin(parent: ElementTree.Element, position: np.ndarray, quaternion: np.ndarray) -> None:
    """Position, and roll, pitch, yaw about fixed axes."""
    w, x, y, z = quaternion
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    ElementTree.SubElement(parent, "origin", xyz=_numbers(position), rpy=_numbers(np.array([roll, pitch, yaw])))


def _number(value: float) -> str:
    return repr(float(value))


def _numbers(values: np.ndarray) -> str:
    return " ".join(_number(v) for v in values)


def main() -> int:
    parser = argparse.ArgumentParser(description="Write a machine as URDF.")
    parser.add_argument("--machine", metavar="FILE", help="machine file (default: the Mikron UCP 710)")
    parser.add_argument("--out", metavar="FILE", default="out/mikron_ucp710.urdf", help="URDF to write (default: %(default)s)")
    arguments = parser.parse_args()
    try:
        export_urdf(load_machine(arguments.machine), Path(arguments.out))
    except TwinError as error:
        print(error, file=sys.stderr)
        return 2
    print(f"written: {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
