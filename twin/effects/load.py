"""Effects of the load: additional inertia of an axis, a mass clamped on the table."""

from dataclasses import dataclass
import math

import mujoco

from twin.effects.change import Change, total_inertia, upward
from twin.effects.effect import DEGREES, Parameter, Picture, effect
from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.simulation.plant_spec import frames_of_model, remembered

MILLIMETRES = {"m": ("mm", 1e3)}


@effect(
    block="mechanics",
    parameters=(
        Parameter(
            "added",
            "mass",
            -1e5,
            1e5,
            lambda m, a: (0.10 * total_inertia(m, a), 0.35 * total_inertia(m, a)),
            neutral=0.0,
            beyond_tolerance=2.0,
            part_of=total_inertia,
            any_size=True,
        ),
    ),
    separating_move="accelerations",
    rivals="A wrong torque feedforward acts only with feedforward on. An elastic drive train looks like a small inertia.",
    picture=Picture("The current rises in proportion to acceleration.", sizes={"added": 800.0}),
    sets=("moving_mass_kg", "rotor_inertia_kg_m2"),
)
def inertia(change: Change, axis: Axis, added: float) -> None:
    """Additional mass or inertia of one axis.

    M = M_nominal + added, for this axis only (no gravity and no coupling on rotary axes). On a vertical axis its
    weight also acts: F = -added g. Source: paper, section 3 (equivalent inertia).
    """
    if added < 0.0 and added <= -(load := change.load_inertia(axis)):
        unit = "kg" if axis.kind == "linear" else "kg m2"
        raise InputError(
            f"inertia on axis {axis.name}: added = {added:g} {unit} removes the entire load of {load:.4g} {unit}; "
            f"give more than {-load:.4g}"
        )
    change.add_inertia(axis, added)
    up = upward(change.machine, axis)
    if axis.kind == "linear" and up:
        change.add_force(axis, -added * change.machine.gravity * up)


@effect(
    block="mechanics",
    axes="tilting",
    edits_bodies=True,
    parameters=(
        # gravity identifies mass times radius, hardly each of them
        Parameter("mass_kg", "kilogram", 0.0, 500.0, (20.0, 60.0), neutral=0.0, judged_with="radius_m"),
        Parameter("radius_m", "metre", 0.0, 1.0, (0.1, 0.2), shown=MILLIMETRES),
        Parameter("angle_rad", "angle", 0.0, 2.0 * math.pi, (0.0, 2.0 * math.pi), periodic=True, shown=DEGREES),
        Parameter("height_m", "metre", -1.0, 1.0, (0.05, 0.2), default=0.1, shape=True, shown=MILLIMETRES),
    ),
    separating_move="accelerations",
    rivals="An additional inertia has no weight. A constant force does not change with the tilt.",
    picture=Picture(
        "Gravity torque that changes with the tilt.", axis="A", with_axes="C", sizes={"angle_rad": 1.2, "radius_m": 0.2, "mass_kg": 50.0}
    ),
)
def table_unbalance(change: Change, axis: Axis, mass_kg: float, radius_m: float, angle_rad: float, height_m: float) -> None:
    """Mass clamped on the table that is missing in the machine file.

    Point mass at (radius cos angle, radius sin angle, height above the tilting axis) in the table frame: gravity torque
    m g r about both rotary axes, inertia and coupling. Source: rigid-body mechanics.
    """
    carried, above = _last_carried(change.machine, axis.name)
    position = (radius_m * math.cos(angle_rad), radius_m * math.sin(angle_rad), height_m - above)
    change.model_edits.append(_PointMass(carried, position, mass_kg))


@dataclass(frozen=True)
class _PointMass:
    """The edit that fixes a point mass to a body."""

    body: str
    position: tuple[float, float, float]
    mass_kg: float

    def __call__(self, spec: mujoco.MjSpec) -> None:
        inertia = [1e-9 * self.mass_kg] * 3
        spec.body(self.body).add_body(
            name="unbalance", pos=self.position, ipos=[0.0, 0.0, 0.0], mass=self.mass_kg, inertia=inertia, explicitinertial=True
        )


@remembered
def _last_carried(machine: Machine, axis: str) -> tuple[str, float]:
    """Body of the last rotary axis that this one carries, and the height of its frame above this axis in the home pose [m]."""
    model = frames_of_model(machine)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    carrier = last = int(model.joint(axis).bodyid[0])
    for body in model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE].tolist():
        parent = body
        while parent > carrier:  # a body has a higher number than its parent
            parent = int(model.body_parentid[parent])
        last = body if parent == carrier else last
    return str(model.body(last).name), float(data.xpos[last][2] - data.xanchor[model.joint(axis).id][2])
