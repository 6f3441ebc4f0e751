"""Effects of forces on the load: constant, from the acceleration of another axis, periodic in time."""

import math

from twin.effects.change import Change, weight
from twin.effects.effect import Parameter, Picture, effect
from twin.effects.scan import InTime
from twin.machine.machine import Axis
from twin.simulation.loop_terms import FORCE, X_LOAD_ACCELERATION, X_LOAD_FORCE, X_STEP, X_TIME, arrays, term


@effect(
    block="mechanics",
    parameters=(
        Parameter(
            "force", "force", -1e5, 1e5, lambda m, a: (-0.5 * a.coulomb_friction, 0.5 * a.coulomb_friction), neutral=0.0,
            beyond_tolerance=3.0, part_of=weight,
        ),
    ),
    rivals="On a vertical axis, an error of the weight looks the same; only a force beyond the tolerance of the weight is an effect.",
    picture=Picture("The current is offset by the same amount in both directions.", "reversal", sizes={"force": 500.0}),
)  # fmt: skip
def constant_force(change: Change, axis: Axis, force: float) -> None:
    """Constant force against +q (counterbalance, cable drag).

    F = -force. Direction-dependent Coulomb friction is equivalent: Fc (1 + f sign v) sign v = Fc sign v + f Fc.
    """
    change.add_force(axis, -force)


@effect(
    block="mechanics",
    axes="linear",
    from_axis=True,
    parameters=(
        Parameter(
            "mass", "mass", -1e4, 1e4, lambda m, a: (0.08 * (a.moving_mass_kg or 1.0), 0.25 * (a.moving_mass_kg or 1.0)), neutral=0.0
        ),
    ),
    separating_move="accelerations",
    rivals="Inertia follows the acceleration of this axis. Moves in which only one of the two axes accelerates distinguish them.",
    picture=Picture("X moves at constant speed; each acceleration of Y disturbs it.", from_axis="Y", sizes={"mass": 170.0}),
)
def cross_axis_coupling(change: Change, axis: Axis, from_axis: Axis, mass: float) -> None:
    """Acceleration of another axis acts on this axis.

    F = -mass x acceleration of from_axis (centre of mass off the screw, guides not square).
    """
    change.add_term(cross_axis_force, FORCE, axis, [mass, change.index(from_axis)])


@effect(
    block="mechanics",
    parameters=(
        Parameter("frequency_hz", "frequency", 0.1, 500.0, (7.0, 35.0), logarithmic=True, scan=InTime()),
        Parameter(
            "force", "force", 0.0, 1e5, lambda m, a: (0.15 * a.coulomb_friction, 0.40 * a.coulomb_friction), neutral=0.0, logarithmic=True
        ),
    ),
    separating_move="rest",
    rivals="The frequency of a torque ripple changes with speed; a periodic disturbance keeps its frequency and acts at rest, too.",
    picture=Picture("A sine in time, the same at rest and at any speed.", sizes={"frequency_hz": 18.0, "force": 450.0}),
)
def periodic_disturbance(change: Change, axis: Axis, frequency_hz: float, force: float) -> None:
    """Force that is periodic in time, independent of the motion (pump, fan, neighbouring machine).

    F = force sin(2 pi f t), t from the start of the run.
    """
    change.add_term(periodic_force, FORCE, axis, [2.0 * math.pi * frequency_hz, force])


@term
def cross_axis_force(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F -= p[0] a of axis p[1]."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_LOAD_FORCE] -= p[0] * x[int(p[1]), X_LOAD_ACCELERATION]


@term
def periodic_force(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F += p[1] sin(p[0] t), at the middle of the step."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_LOAD_FORCE] += p[1] * math.sin(p[0] * (x[axis, X_TIME] + 0.5 * x[axis, X_STEP]))
