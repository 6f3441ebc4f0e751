"""Friction effects: Coulomb and viscous friction off nominal, and their dependence on direction and position."""

import math

from twin.effects.change import Change
from twin.effects.effect import DEGREES, PERCENT, Parameter, Picture, effect, factor_of
from twin.effects.scan import AlongTravel
from twin.machine.machine import Axis
from twin.simulation import loop_terms
from twin.simulation.loop_terms import FORCE, arrays, term


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
            scan=AlongTravel(), shown=DEGREES,
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
def friction_along_travel(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F *= 1 + p[0] sin(p[1] q)."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, loop_terms.X_FRICTION_LEVEL] *= 1.0 + p[0] * math.sin(p[1] * x[axis, loop_terms.X_LOAD_MIDDLE])


@term
def asymmetric_viscous(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F -= p[0] |v| at the middle of the step."""
    p, s, x = arrays(parameters, state, signals)
    speed = x[axis, loop_terms.X_LOAD_SPEED] + 0.5 * x[axis, loop_terms.X_STEP] * x[axis, loop_terms.X_LOAD_ACCELERATION]
    x[axis, loop_terms.X_FRICTION_FORCE] -= p[0] * abs(speed)
