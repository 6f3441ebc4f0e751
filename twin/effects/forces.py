"""Effects of forces on the load: constant, from another axis' acceleration, swinging in time."""

from __future__ import annotations

import math

from twin.effects.change import Change, weight
from twin.effects.effect import Parameter, effect
from twin.effects.picture import Picture
from twin.effects.scan import InTime
from twin.machine.machine import Axis, Machine
from twin.simulation.loop_terms import FORCE, X_LOAD_ACCELERATION, X_LOAD_FORCE, X_STEP, X_TIME, arrays, term


@effect(
    block="mechanics",
    parameters=(
        Parameter(
            "force", "force", -1e5, 1e5, lambda m, a: (-0.5 * a.coulomb_friction, 0.5 * a.coulomb_friction), neutral=0.0,
            beyond_tolerance=3.0, part_of=weight,
        ),
    ),
    rivals="On a vertical axis a weight that is off within the tolerance looks the same; only more than that is an effect.",
    picture=Picture("Current shifted the same way in both directions.", "reversal", axis="X", sizes={"force": 500.0}),
)  # fmt: skip
def constant_force(change: Change, axis: Axis, force: float) -> None:
    """Constant force against +q (counterbalance, cable drag).

    F = -force. Coulomb friction that differs by direction is the same thing: Fc (1 + f sign v) sign v = Fc sign v + f Fc.
    """
    change.add_force(axis, -force)


def _part_of_mass(machine: Machine, axis: Axis) -> tuple[float, float]:
    return (0.08 * (axis.moving_mass_kg or 1.0), 0.25 * (axis.moving_mass_kg or 1.0))


@effect(
    block="mechanics",
    axes="linear",
    from_axis=True,
    parameters=(Parameter("mass", "mass", -1e4, 1e4, _part_of_mass, neutral=0.0),),
    separating_move="accelerations",
    rivals="Inertia follows this axis' own acceleration. Moves in which only one of the axes accelerates part them.",
    picture=Picture(
        "X moves steadily; each acceleration of Y, out and back, pushes it.",
        axis="X",
        from_axis="Y",
        sizes={"mass": 170.0},
    ),
)
def cross_axis_coupling(change: Change, axis: Axis, from_axis: Axis, mass: float) -> None:
    """Acceleration of another axis pushes this one.

    F = -mass x acceleration of from_axis (centre of mass off the screw, guides not square).
    """
    change.add_term(pushed_by_axis, FORCE, axis, [mass, change.index(from_axis)])


def _part_of_coulomb(machine: Machine, axis: Axis) -> tuple[float, float]:
    return (0.15 * axis.coulomb_friction, 0.40 * axis.coulomb_friction)


@effect(
    block="mechanics",
    parameters=(
        Parameter("frequency_hz", "frequency", 0.1, 500.0, (7.0, 35.0), logarithmic=True, scan=InTime()),
        Parameter("force", "force", 0.0, 1e5, _part_of_coulomb, neutral=0.0, logarithmic=True),
    ),
    separating_move="rest",
    rivals="A torque ripple changes its frequency with the speed, a force in time does not: it is there at rest too.",
    picture=Picture(
        "A wave in time, at rest, in motion and at any speed the same.", axis="X", sizes={"frequency_hz": 18.0, "force": 450.0}
    ),
)
def periodic_disturbance(change: Change, axis: Axis, frequency_hz: float, force: float) -> None:
    """A force that swings in time, whatever the axis does (pump, fan, neighbouring machine).

    F = force sin(2 pi f t), t from the start of the run.
    """
    change.add_term(swinging_force, FORCE, axis, [2.0 * math.pi * frequency_hz, force])


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
