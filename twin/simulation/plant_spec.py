"""The MuJoCo model of a machine: its MJCF with the masses, inertias and friction of the machine file.

Values of the machine file override those of the MJCF. An axis whose motor is not rigidly coupled to its load (backlash,
compliance) gets a separate joint for the rotor, `<axis>.rotor` in axis units; the coupling force is a term of the loop.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import copy
from dataclasses import dataclass
import functools
import math
from pathlib import Path
from typing import TypeVar

import mujoco
import numpy as np

from twin.errors import InputError, nearest
from twin.machine.machine import Axis, Machine
from twin.machine.model_file import check_safe, state_of_model
from twin.machine.model_limits import compiled_spec, compiles, quiet_engine, refuse_singular

Result = TypeVar("Result")

ModelEdit = Callable[["mujoco.MjSpec"], None]
"""A change of the model by an effect, for example an additional body on the table. Equal edits make equal models."""

ENGINE_TOLERANCE = 1e-12
SOFT_FRICTION_S = 0.02
STICKING = ([0.0005, 1.0], [0.9999, 0.9999, 0.001, 0.5, 2.0])
"""Parameters of friction without creep, as in the model of the Mikron. They replace the defaults of MuJoCo, recognised by SOFT_FRICTION_S."""


@dataclass(frozen=True)
class Plant:
    """A compiled model with one engine state, and the indices (axis,) uint64 of the driven axes."""

    model: mujoco.MjModel
    data: mujoco.MjData
    load_position: np.ndarray
    load_dof: np.ndarray
    rotor_position: np.ndarray
    rotor_dof: np.ndarray
    friction_dof: np.ndarray  # of the load, or of the rotor
    actuator: np.ndarray


def inertial_key(machine: Machine) -> tuple[object, ...]:
    """Cache key: all that masses, inertias and weights of the compiled model depend on.

    The key holds the content of the model files, geometry, bodies, gravity, and mass, rotor, ratio and travel of each driven axis: weights are
    calculated over the travel of rotary axes. Friction, motors and loops are not part of it.
    """
    if "inertial" not in machine.derived:
        axes = tuple(
            (axis.name, axis.kind, axis.moving_mass_kg, axis.rotor_inertia_kg_m2, axis.ratio, axis.travel) for axis in machine.axes
        )
        geometry = tuple((key, str(value)) for key, value in sorted(machine.geometry.items()))
        machine.derived["inertial"] = (str(machine.model_path), axes, machine.bodies, geometry, machine.gravity)
    return state_of_model(machine.model_path), machine.derived["inertial"]


MOST_REMEMBERED = 64
"""Largest number of cached results of a function."""


def remembered(of_machine: Callable[..., Result]) -> Callable[..., Result]:
    """Decorator: cache a function that depends on the `inertial_key` of a machine and on its other arguments, which are keys themselves."""
    known: dict[object, Result] = {}

    @functools.wraps(of_machine)
    def answer(machine: Machine, *keys: object) -> Result:
        key = (inertial_key(machine), *keys)
        found = known.get(key)
        if found is None:
            found = of_machine(machine, *keys)
            if len(known) > MOST_REMEMBERED:
                known.clear()
            known[key] = found
        return found

    return answer


def load_spec(path: Path) -> mujoco.MjSpec:
    """Parse an MJCF file, cached by its content. Raises InputError."""
    return _parsed(path, state_of_model(path)).copy()


@functools.lru_cache(maxsize=8)
def _parsed(path: Path, _state: bytes) -> mujoco.MjSpec:
    quiet_engine()
    compiles(path, check_safe(path))
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        for actuator in [a for a in spec.actuators if not a.target]:  # the engine keeps its name, but loses it in a copy
            spec.delete(actuator)
        return spec
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"{path}: MuJoCo cannot read this model: {' '.join(str(error).split())}; correct it there") from None


def build_plant(machine: Machine, edits: Sequence[ModelEdit] = (), split_axes: Sequence[str] = ()) -> Plant:
    """Compile the model of a machine; `split_axes` get a separate rotor joint."""
    model = compile_model(machine, edits, split_axes)
    data = mujoco.MjData(model)
    joints = [model.joint(axis.name) for axis in machine.axes]
    rotors = [model.joint(f"{axis.name}.rotor") if axis.name in split_axes else joint for axis, joint in zip(machine.axes, joints)]
    rubbing = [rotor if axis.friction_side == "motor" else joint for axis, joint, rotor in zip(machine.axes, joints, rotors)]

    def index(values: Sequence[int]) -> np.ndarray:
        return np.array(values, np.uint64).reshape(len(machine.axes))

    return Plant(
        model=model,
        data=data,
        load_position=index([j.qposadr[0] for j in joints]),
        load_dof=index([j.dofadr[0] for j in joints]),
        rotor_position=index([j.qposadr[0] for j in rotors]),
        rotor_dof=index([j.dofadr[0] for j in rotors]),
        friction_dof=index([j.dofadr[0] for j in rubbing]),
        actuator=index([model.actuator(axis.name).id for axis in machine.axes]),
    )


def compile_model(machine: Machine, edits: Sequence[ModelEdit] = (), split_axes: Sequence[str] = ()) -> mujoco.MjModel:
    """MjModel of the machine: masses, inertias, friction and geometry of the machine file, base tick as time step."""
    frictions = tuple((axis.coulomb_friction, axis.viscous_friction, axis.friction_side, axis.other_side_friction) for axis in machine.axes)
    return copy.copy(_compiled(machine, (frictions, machine.base_tick), tuple(edits), tuple(split_axes)))


@remembered
def _compiled(machine: Machine, _friction_and_tick: object, edits: Sequence[ModelEdit], split_axes: Sequence[str]) -> mujoco.MjModel:
    spec = load_spec(machine.model_path)
    where = str(machine.path or machine.name)
    spec.compiler.discardvisual = True  # geoms without mass only cost time here
    spec.option.timestep = machine.base_tick
    spec.option.gravity = [0.0, 0.0, -machine.gravity]
    # the control limits the travel; a joint limit would push back an axis that overshoots its end by a micrometre
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    _set_engine(spec)
    _set_inertias(spec, where)
    _check_joints(spec, machine, where)
    _set_bodies(spec, machine, where)
    _set_moving_masses(spec, machine, where)
    _set_geometry(spec, machine)
    for axis in machine.axes:
        _set_drive(spec, axis, split=axis.name in split_axes)
    driven = set(machine.axis_names)
    for joint in list(spec.joints):
        if joint.name not in driven and not joint.name.endswith(".rotor"):
            _lock(spec, joint)
    for edit in edits:
        edit(spec)
    return compiled_spec(spec, where)


def _check_joints(spec: mujoco.MjSpec, machine: Machine, where: str) -> None:
    """Raise InputError if an axis has no joint in the model, or a joint of the wrong type."""
    names = [joint.name for joint in spec.joints]
    for axis in machine.axes:
        if axis.name not in names:
            raise InputError(f"{where}: axis {axis.name} has no joint in {machine.model_path.name}; {nearest(axis.name, names)}")
        slides = spec.joint(axis.name).type == mujoco.mjtJoint.mjJNT_SLIDE
        if slides != (axis.kind == "linear"):
            raise InputError(
                f"{where}: axis {axis.name} is {axis.kind}, its joint in {machine.model_path.name} is a {'slide' if slides else 'hinge'}; "
                "correct kind or joint"
            )


def _set_engine(spec: mujoco.MjSpec) -> None:
    """Set solver and integrator as assumed by the decoupled plant; remove contacts, sensors and actuators that are not plain motors."""
    option = spec.option
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.solver = mujoco.mjtSolver.mjSOL_PGS
    option.tolerance = min(option.tolerance, ENGINE_TOLERANCE)
    option.density, option.viscosity = 0.0, 0.0
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_ISLAND
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    # an actuator that is not a plain motor, such as a position servo, would add its own force
    names = {joint.name for joint in spec.joints}
    foreign = [a for a in spec.actuators if a.name not in names or a.name != a.target or a.biastype != mujoco.mjtBias.mjBIAS_NONE]
    if foreign:
        for key in list(spec.keys):
            spec.delete(key)
    for actuator in foreign:
        spec.delete(actuator)


def _set_inertias(spec: mujoco.MjSpec, where: str) -> None:
    """Replace masses derived from shapes by explicit ones, so that they can be set and scaled."""
    from_shapes = [b for b in spec.bodies[1:] if b.geoms and (not b.explicitinertial or spec.compiler.inertiafromgeom == 1)]
    if not from_shapes or spec.compiler.inertiafromgeom == 0:
        return
    model = compiled_spec(spec.copy(), where)
    for body in from_shapes:
        compiled = model.body(body.name) if body.name else model.body(body.id)
        _set_inertia(body, float(compiled.mass[0]), compiled.ipos, compiled.iquat, compiled.inertia)
    spec.compiler.inertiafromgeom = 0


@remembered
def frames_of_model(machine: Machine) -> mujoco.MjModel:
    """MjModel for kinematics and pictures: the MJCF with the geometry of the machine file."""
    spec, where = load_spec(machine.model_path), str(machine.path or machine.name)
    _check_joints(spec, machine, where)
    _set_geometry(spec, machine)
    return compiled_spec(spec, where)


def home_inertia_at_motor(machine: Machine) -> np.ndarray:
    """Inertia at each motor (axis,) [kg m2] with all axes at zero: rotor, screw or gear, and load.

    J = r^2 M_ii(q = 0); the torque feedforward is commissioned with it.
    """
    return at_home(machine)[0] * np.array([axis.ratio for axis in machine.axes]) ** 2


@remembered
def at_home(machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """Inertia with rotor, and bias force, of every axis (axis,) with all axes at zero [kg, kg m2; N, Nm]."""
    plant = build_plant(machine)
    plant.data.qpos[:] = 0.0
    mujoco.mj_forward(plant.model, plant.data)
    refuse_singular(plant.model, plant.data, str(machine.model_path))
    return np.diag(full_inertia(plant.model, plant.data))[plant.load_dof].copy(), plant.data.qfrc_bias[plant.load_dof].copy()


def commissioned_inertia(machine: Machine) -> np.ndarray:
    """J_ff (axis,) [kg m2 at the motor]: from the machine file, or else from the model in the home pose."""
    known = [axis.commissioned_inertia for axis in machine.axes]
    if all(value is not None for value in known):
        return np.array(known, float)
    return np.where([value is None for value in known], home_inertia_at_motor(machine), np.array(known, float))


def with_commissioned_inertia(machine: Machine) -> Machine:
    """The machine with J_ff written down for every axis. A later change of its masses then leaves the control as it was commissioned."""
    known = zip(machine.axes, commissioned_inertia(machine).tolist())
    missing = {axis.name: {"commissioned_inertia": inertia} for axis, inertia in known if axis.commissioned_inertia is None}
    return machine.with_each_axis(missing) if missing else machine


def full_inertia(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Joint-space inertia matrix (dof, dof) with reflected rotor inertias, for the state last passed to mj_forward."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


def _set_bodies(spec: mujoco.MjSpec, machine: Machine, where: str) -> None:
    for body in machine.bodies:
        target = spec.body(body.name)
        if target is None:
            known = [b.name for b in spec.bodies if b.name]
            raise InputError(f"{where}: [body.{body.name}]: no such body in {machine.model_path.name}; {nearest(body.name, known)}")
        _set_inertia(target, body.mass_kg, body.centre_of_mass_m, [1.0, 0.0, 0.0, 0.0], body.inertia_kg_m2)


def _set_inertia(body: mujoco.MjsBody, mass: float, centre: Sequence[float], frame: Sequence[float], principal: Sequence[float]) -> None:
    """Give a body an explicit mass, centre of mass, and principal inertia in a frame about it."""
    body.mass, body.ipos, body.iquat, body.inertia = mass, centre, frame, principal
    body.fullinertia = [math.nan] * 6
    body.explicitinertial = mass > 0.0


def _set_moving_masses(spec: mujoco.MjSpec, machine: Machine, where: str) -> None:
    """Set the mass of each slide: `moving_mass_kg`, the total mass that the screw moves, minus the mass of the bodies that the slide carries."""
    wanted = {axis.name: axis.moving_mass_kg for axis in machine.axes if axis.moving_mass_kg is not None}
    by_body = {spec.joint(name).parent.name: name for name in wanted}

    def set_below(body: mujoco.MjsBody) -> float:
        children = sum(set_below(child) for child in body.bodies)
        if body.name in by_body:
            total = wanted[by_body[body.name]]
            own = total - children
            if own <= 0.0:
                raise InputError(
                    f"{where}: [axis.{by_body[body.name]}]: moving_mass_kg = {total:g} does not exceed the {children:g} kg that the slide carries; "
                    "give the total mass that the screw moves"
                )
            if body.mass > 0:
                body.inertia = np.asarray(body.inertia) * own / body.mass
            body.mass = own
        return children + body.mass

    set_below(spec.worldbody)


def _set_geometry(spec: mujoco.MjSpec, machine: Machine) -> None:
    """Move the frames of the model by the offsets, table height, spindle nose and tool length of the machine file."""
    geometry = machine.geometry
    table, workpiece, tool = spec.body("table"), spec.site("workpiece"), spec.site("tool")
    if table is not None and "a_axis_to_c_axis_y_m" in geometry:
        table.pos = [0.0, geometry["a_axis_to_c_axis_y_m"], geometry.get("a_axis_to_c_axis_z_m", 0.0)]
    if workpiece is not None and "table_top_above_a_axis_m" in geometry:
        # the workpiece frame lies on the table top; the machine file gives its height above the A axis
        workpiece.pos = [*np.asarray(workpiece.pos)[:2], geometry["table_top_above_a_axis_m"] - geometry.get("a_axis_to_c_axis_z_m", 0.0)]
    if tool is not None and {"spindle_nose_at_home_m", "tool_length_m"} <= geometry.keys():
        nose = np.array(geometry["spindle_nose_at_home_m"], float)
        body = tool.parent
        carrier = np.zeros(3)
        while body is not None and body.name != "world":
            carrier += np.asarray(body.pos)
            body = body.parent
        tool.pos = nose - [0.0, 0.0, geometry["tool_length_m"]] - carrier


def _set_drive(spec: mujoco.MjSpec, axis: Axis, split: bool) -> None:
    """Set friction, gear ratio and rotor of one axis; with `split` the rotor gets its own joint."""
    joint = spec.joint(axis.name)
    joint.armature = 0.0
    _set_friction(joint, axis)
    actuator = spec.actuator(axis.name)
    if actuator is None:
        actuator = spec.add_actuator(name=axis.name, target=axis.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.gear = [1.0 / axis.ratio, 0.0, 0.0, 0.0, 0.0, 0.0]
    actuator.armature = axis.rotor_inertia_kg_m2
    if split:
        # a body, no armature: the softness of a friction constraint follows the mass of the body
        actuator.armature, mass = 0.0, axis.reflected_inertia
        body = spec.worldbody.add_body(name=f"{axis.name}.rotor", mass=mass, inertia=[mass] * 3, explicitinertial=True)
        # a horizontal slide in axis units, on which gravity does not act
        rotor = body.add_joint(name=f"{axis.name}.rotor", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1.0, 0.0, 0.0])
        actuator.target = f"{axis.name}.rotor"
        rotor.solref_friction, rotor.solimp_friction = joint.solref_friction, joint.solimp_friction
        for one, share in ((joint, axis.friction_share("load")), (rotor, axis.friction_share("motor"))):
            _set_friction(one, axis, share)


def _set_friction(joint: mujoco.MjsJoint, axis: Axis, share: float = 1.0) -> None:
    """Give a share of the Coulomb and viscous friction of an axis to a joint."""
    joint.frictionloss = share * axis.coulomb_friction
    joint.damping = [share * axis.viscous_friction, 0.0, 0.0]
    if joint.solref_friction[0] == SOFT_FRICTION_S:  # the default of MuJoCo creeps
        joint.solref_friction = STICKING[0]
        joint.solimp_friction = STICKING[1]


def _lock(spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> None:
    """Fix an axis that is not driven: delete its joint and its actuators."""
    for actuator in list(spec.actuators):
        if actuator.target == joint.name:
            spec.delete(actuator)
    for key in list(spec.keys):
        spec.delete(key)
    spec.delete(joint)
