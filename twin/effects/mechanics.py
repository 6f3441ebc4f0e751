"""Effects in motor and load: torque constant, inertia, disturbing forces, masses on the table."""

from __future__ import annotations

import math

import mujoco

from twin.effects.change import Change, load_inertia
from twin.effects.effect import Parameter, effect
from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.simulation.loop_terms import (
    FORCE,
    X_LOAD_ACCELERATION,
    X_LOAD_FORCE,
    X_MOTOR_TORQUE,
    X_ROTOR_MIDDLE,
    X_STEP,
    X_TIME,
    arrays,
    term,
)
from twin.simulation.plant_spec import frames_of_model


@effect(block="current loop", parameters=(Parameter("factor", "number", 0.3, 1.5, (0.88, 0.95), neutral=1.0, logarithmic=True),))
def torque_constant(change: Change, axis: Axis, factor: float) -> None:
    """Motor makes less (or more) torque per ampere than the control believes.

    Kt = factor x nominal; the control still divides by the nominal, the back-EMF stays. Source: magnet temperature,
    saturation; tolerance of motor data 3 to 7.5 %.
    """
    change.scale(axis, torque_constant_nm_per_a=factor)


def _tenth_to_third(machine: Machine, axis: Axis) -> tuple[float, float]:
    total = load_inertia(machine, axis) + axis.reflected_inertia
    return (0.10 * total, 0.35 * total)


@effect(
    block="mechanics",
    parameters=(Parameter("added", "mass", -1e5, 1e5, _tenth_to_third, neutral=0.0),),
)
def inertia(change: Change, axis: Axis, added: float) -> None:
    """More mass or inertia on one axis than the machine file has.

    M = M_nominal + added, felt by this axis alone (no gravity and no coupling on rotary axes); on a vertical axis its
    weight too: F = -added g. Source: paper, section 3 (equivalent inertia).
    """
    if added < 0.0 and added <= -(load := change.load_inertia(axis)):
        unit = "kg" if axis.kind == "linear" else "kg m2"
        raise InputError(
            f"inertia on axis {axis.name}: added = {added:g} {unit} takes away all of the load's {load:.4g} {unit}; "
            f"give more than {-load:.4g}"
        )
    change.add_inertia(axis, added)
    up = upward(change.machine, axis)
    if axis.kind == "linear" and up:
        change.add_force(axis, -added * change.machine.gravity * up)


def _part_of_coulomb(low: float, high: float):  # type: ignore[no-untyped-def]
    return lambda machine, axis: (low * axis.coulomb_friction, high * axis.coulomb_friction)


@effect(
    block="mechanics",
    parameters=(Parameter("force", "force", -1e5, 1e5, lambda m, a: (-0.5 * a.coulomb_friction, 0.5 * a.coulomb_friction), neutral=0.0),),
)
def constant_force(change: Change, axis: Axis, force: float) -> None:
    """Constant force against +q (counterbalance, cable drag).

    F = -force. Coulomb friction that differs by direction is the same thing: Fc (1 + f sign v) sign v = Fc sign v + f Fc.
    """
    change.add_force(axis, -force)


@effect(
    block="mechanics",
    axes="tilting",
    edits_bodies=True,
    parameters=(
        Parameter("mass_kg", "kilogram", 0.0, 500.0, (20.0, 60.0), neutral=0.0),
        Parameter("radius_m", "metre", 0.0, 1.0, (0.1, 0.2)),
        Parameter("angle_rad", "angle", 0.0, 2.0 * math.pi, (0.0, 2.0 * math.pi), periodic=True),
        Parameter("height_m", "metre", -1.0, 1.0, (0.05, 0.2), default=0.1, shape=True),
    ),
)
def table_unbalance(change: Change, axis: Axis, mass_kg: float, radius_m: float, angle_rad: float, height_m: float) -> None:
    """A mass clamped on the table that the machine file does not have.

    Point mass at (radius cos angle, radius sin angle, height above the tilting axis) in the table frame: gravity torque
    m g r over both rotary axes, inertia and coupling. Source: rigid-body mechanics.
    """
    carried = _table_body(change.machine, axis)

    def edit(spec: mujoco.MjSpec) -> None:
        offset = change.machine.geometry.get("a_axis_to_c_axis_z_m", 0.0)
        position = [radius_m * math.cos(angle_rad), radius_m * math.sin(angle_rad), height_m - offset]
        spec.body(carried).add_body(
            name="unbalance", pos=position, ipos=[0.0, 0.0, 0.0], mass=mass_kg, inertia=[1e-9 * mass_kg] * 3, explicitinertial=True
        )

    change.model_edits.append(edit)


SERVO_PEAK_NM = 20.0
"""Peak torque of a machine tool's servo motor from which a ripple has the usual size; a smaller motor has less of it in proportion."""


def _ripple_of_motor(machine: Machine, axis: Axis) -> tuple[float, float]:
    share = min(1.0, axis.motor.torque_constant_nm_per_a * axis.motor.peak_current_a / SERVO_PEAK_NM)
    return (0.04 * share, 0.3 * share)


@effect(
    block="mechanics",
    axes="turning motor",
    parameters=(
        Parameter("amplitude_nm", "torque", 0.0, 10.0, _ripple_of_motor, neutral=0.0, logarithmic=True),
        Parameter("periods_per_rev", "number", 0.1, 500.0, (4.0, 12.0), logarithmic=True),
        Parameter("phase_rad", "angle", -2 * math.pi, 2 * math.pi, default=0.0, shape=True, periodic=True),
    ),
)
def torque_ripple(change: Change, axis: Axis, amplitude_nm: float, periods_per_rev: float, phase_rad: float) -> None:
    """Motor torque ripples with the rotor's angle (cogging).

    T += amplitude sin(n theta + phase), theta = motor position / r. Locked to position, even under reversal. Source:
    detent torque of permanent-magnet motors, 1 to 4 % of rated.
    """
    change.add_term(ripple, FORCE, axis, [amplitude_nm, periods_per_rev / axis.ratio, phase_rad])


def _part_of_mass(machine: Machine, axis: Axis) -> tuple[float, float]:
    return (0.08 * (axis.moving_mass_kg or 1.0), 0.25 * (axis.moving_mass_kg or 1.0))


@effect(
    block="mechanics",
    axes="linear",
    from_axis=True,
    parameters=(Parameter("mass", "mass", -1e4, 1e4, _part_of_mass, neutral=0.0),),
)
def cross_axis_coupling(change: Change, axis: Axis, from_axis: Axis, mass: float) -> None:
    """Acceleration of another axis pushes this one.

    F = -mass x acceleration of from_axis (centre of mass off the screw, guides not square).
    """
    change.add_term(pushed_by_axis, FORCE, axis, [mass, change.index(from_axis)])


@effect(
    block="mechanics",
    parameters=(
        Parameter("frequency_hz", "frequency", 0.1, 500.0, (7.0, 35.0), logarithmic=True),
        Parameter("force", "force", 0.0, 1e5, _part_of_coulomb(0.15, 0.40), neutral=0.0, logarithmic=True),
    ),
)
def periodic_disturbance(change: Change, axis: Axis, frequency_hz: float, force: float) -> None:
    """A force that swings in time, whatever the axis does (pump, fan, neighbouring machine).

    F = force sin(2 pi f t), t from the start of the run.
    """
    change.add_term(swinging_force, FORCE, axis, [2.0 * math.pi * frequency_hz, force])


def upward(machine: Machine, axis: Axis) -> float:
    """Component of a linear axis along +z of the machine frame, 0 where it is level."""
    model = frames_of_model(machine)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    up = float(data.xaxis[model.joint(axis.name).id][2])
    return up if abs(up) > 1e-9 else 0.0


def _table_body(machine: Machine, axis: Axis) -> str:
    """The body of the last rotary axis that this one carries."""
    model = frames_of_model(machine)
    carrier = int(model.joint(axis.name).bodyid[0])
    name = model.body(carrier).name
    for joint in range(model.njnt):
        body = int(model.jnt_bodyid[joint])
        above = body
        while above > 0 and above != carrier:
            above = int(model.body_parentid[above])
        if above == carrier and body != carrier and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
            name = model.body(body).name
    return str(name)


@term
def ripple(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """T += p[0] sin(p[1] q + p[2])."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_MOTOR_TORQUE] += p[0] * math.sin(p[1] * x[axis, X_ROTOR_MIDDLE] + p[2])


@term
def pushed_by_axis(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F -= p[0] a of axis p[1]."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_LOAD_FORCE] -= p[0] * x[int(p[1]), X_LOAD_ACCELERATION]


@term
def swinging_force(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F += p[1] sin(p[0] t), in the middle of the step."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_LOAD_FORCE] += p[1] * math.sin(p[0] * (x[axis, X_TIME] + 0.5 * x[axis, X_STEP]))
