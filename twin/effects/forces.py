"""Effects of forces on the load and of friction: constant, from another axis, periodic in time; off nominal, by direction, along the travel."""

import math

from twin.effects.change import Change, weight
from twin.effects.effect import DEGREES, PERCENT, Parameter, Picture, effect, factor_of
from twin.machine.machine import Axis
from twin.simulation import loop_terms
from twin.simulation.loop_terms import FORCE, arrays, term
from twin.simulation.waves import sine


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
        Parameter("frequency_hz", "frequency", 0.1, 500.0, (7.0, 35.0), logarithmic=True, scan="time"),
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


@effect(
    block="mechanics",
    parameters=(factor_of("coulomb_friction_nm", 0.0, 10.0, (0.5, 1.5), beyond_tolerance=3.0),),
    separating_move="micro-reversals",
    rivals="Coulomb friction offsets the current at all speeds above 0.5 mm/s; Stribeck and pre-sliding act at low speed only.",
    picture=Picture(
        "The current is offset by the same amount at every speed, against the motion; larger error at reversal.",
        "reversal",
        sizes={"factor": 1.4},
    ),
)  # fmt: skip
def coulomb_friction(change: Change, axis: Axis, factor: float) -> None:
    """Coulomb friction off nominal.

    Fc = factor x nominal, at all speeds. Source: paper, section 2.2.
    """
    change.scale(axis, coulomb_friction_nm=factor)


@effect(
    block="mechanics",
    parameters=(factor_of("viscous_friction_nm_s_per_rad", 0.0, 10.0, (0.4, 1.6), beyond_tolerance=4.0),),
    rivals="Coulomb friction offsets the current by the same amount at every speed; viscous friction grows with speed.",
    picture=Picture("The current rises in proportion to speed.", "gentle", sizes={"factor": 1.6}),
)  # fmt: skip
def viscous_friction(change: Change, axis: Axis, factor: float) -> None:
    """Viscous friction off nominal.

    b = factor x nominal: a force proportional to speed. Source: paper, section 2.2.
    """
    change.scale(axis, viscous_friction_nm_s_per_rad=factor)


@effect(
    block="mechanics",
    parameters=(Parameter("fraction", "number", -1.0, 1.0, (-0.35, 0.35), neutral=0.0, shown=PERCENT),),
    rivals="A constant force offsets both directions equally at every speed; the asymmetry grows with speed.",
    picture=Picture("One direction needs more current than the other, in proportion to speed.", "gentle", sizes={"fraction": 0.35}),
)
def viscous_asymmetry(change: Change, axis: Axis, fraction: float) -> None:
    """Direction-dependent viscous friction.

    F = b (1 + fraction sign v) v: the additional force b fraction |v| always acts towards -q.
    """
    change.add_term(asymmetric_viscous, FORCE, axis, [axis.viscous_friction * fraction])


@effect(
    block="mechanics",
    parameters=(
        Parameter("fraction", "number", -1.0, 1.0, (0.25, 0.5), neutral=0.0, shown=PERCENT),
        Parameter(
            "wavelength", "length", 1e-4, 10.0,
            lambda m, a: (0.02, 0.1) if a.kind == "linear" else (math.radians(10), math.radians(60)), logarithmic=True,
            scan="travel", shown=DEGREES,
        ),
    ),
    rivals="A torque ripple keeps its sign at a reversal; position-dependent friction changes sign.",
    picture=Picture(
        "Friction varies along the travel and changes sign with the direction.", "constant speed", sizes={"wavelength": 0.02}
    ),
)  # fmt: skip
def position_dependent_friction(change: Change, axis: Axis, fraction: float, wavelength: float) -> None:
    """Coulomb friction that varies along the travel.

    Fc (1 + fraction sin(2 pi q / wavelength)). Unlike ripple, it changes sign with direction.
    """
    change.add_term(friction_along_travel, FORCE, axis, [fraction, 2.0 * math.pi / wavelength], order=0)


@term
def cross_axis_force(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F -= p[0] a of axis p[1]."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, loop_terms.X_LOAD_FORCE] -= p[0] * x[int(p[1]), loop_terms.X_LOAD_ACCELERATION]


@term
def periodic_force(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F += p[1] sin(p[0] t), at the middle of the step."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, loop_terms.X_LOAD_FORCE] += p[1] * sine(p[0] * (x[axis, loop_terms.X_TIME] + 0.5 * x[axis, loop_terms.X_STEP]))


@term
def friction_along_travel(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F *= 1 + p[0] sin(p[1] q)."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, loop_terms.X_FRICTION_LEVEL] *= 1.0 + p[0] * sine(p[1] * x[axis, loop_terms.X_LOAD_MIDDLE])


@term
def asymmetric_viscous(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F -= p[0] |v| at the middle of the step."""
    p, s, x = arrays(parameters, state, signals)
    speed = x[axis, loop_terms.X_LOAD_SPEED] + 0.5 * x[axis, loop_terms.X_STEP] * x[axis, loop_terms.X_LOAD_ACCELERATION]
    x[axis, loop_terms.X_FRICTION_FORCE] -= p[0] * abs(speed)
