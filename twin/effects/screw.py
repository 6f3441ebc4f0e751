"""Effects of an inexact ratio of motor and load: a wrong lead, an error that comes back every motor turn.

The load is ahead of the rotor by e(q). Over a rigid transmission rotor and load are one body: the motor encoder shows q - e, torque
and rotor inertia stay reflected through the nominal ratio. Where a spring or a gap parts them, the rotor is a body of its own: e lies
in series with the spring, the rotor's inertia feels it, and the motor encoder shows the rotor. Recordings of machines with drive trains
of 250 to 450 Hz agree with that: the rotor's share of e'' is missing otherwise.
"""

from __future__ import annotations

import math

from twin.compiled_functions import compiled
from twin.effects.change import Change
from twin.effects.effect import DEGREES, Parameter, effect
from twin.effects.picture import Picture
from twin.machine.machine import Axis
from twin.simulation.loop_terms import (
    X_MOTOR_POSITION,
    X_MOTOR_SPEED,
    X_ROTOR_POSITION,
    X_ROTOR_SPEED,
    X_TRANSMISSION_ERROR,
    X_TRANSMISSION_ERROR_SPEED,
    arrays,
    term,
)
from twin.simulation.sine import sine_and_cosine
from twin.units import ARCSEC


@effect(
    block="transmission",
    axes="linear",
    parameters=(Parameter("fraction", "number", -0.01, 0.01, (-80e-6, 80e-6), neutral=0.0, shown={"1": ("um/m", 1e6)}),),
    rivals="Thermal drift goes on while the axis rests, and in the same move later; a wrong lead follows the position.",
    picture=Picture("Motor and scale part in proportion to the way.", "constant speed", axis="X", sizes={"fraction": 60e-6}),
)
def lead_error(change: Change, axis: Axis, fraction: float) -> None:
    """Lead of the screw off by a fraction.

    e = fraction (q - q0), q0 where the run starts; the speed loop feels its derivative. Source: ISO 3408-3 lead deviation.
    """
    change.add_transmission_error(wrong_lead, axis, [fraction])


@effect(
    block="transmission",
    axes="turning motor",
    parameters=(
        Parameter(
            "amplitude", "length", 0.0, 1e-3,
            lambda m, a: (2e-6, 7e-6) if a.kind == "linear" else (4 * ARCSEC, 15 * ARCSEC), neutral=0.0, logarithmic=True,
        ),
        Parameter("phase_rad", "angle", -2 * math.pi, 2 * math.pi, default=0.0, shape=True, periodic=True, shown=DEGREES),
    ),
    rivals="An eccentric encoder comes back every table turn, a cyclic error every motor turn.",
    picture=Picture("Once a motor turn between motor and scale; the speed loop shakes the axis with it.", "constant speed", axis="X"),
)  # fmt: skip
def cyclic_error(change: Change, axis: Axis, amplitude: float, phase_rad: float) -> None:
    """Error between motor and load that comes back every motor turn (wobble of the screw, worm).

    e = amplitude (sin(q / r + phase) - sin(q0 / r + phase)).
    """
    change.add_transmission_error(every_motor_turn, axis, [amplitude, 1.0 / axis.ratio, phase_rad])


@term
def wrong_lead(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """e = p[0] (q - q0); p[3] says whether the rotor is a body of its own."""
    p, s, x = arrays(parameters, state, signals)
    if s[1] == 0.0:
        s[0] = x[axis, X_ROTOR_POSITION]
        s[1] = 1.0
    carried_ahead(x[axis], p[3], p[0] * (x[axis, X_ROTOR_POSITION] - s[0]), p[0] * x[axis, X_ROTOR_SPEED])


@term
def every_motor_turn(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """e = p[0] (sin(p[1] q + p[2]) - sin(p[1] q0 + p[2])); p[3] says whether the rotor is a body of its own."""
    p, s, x = arrays(parameters, state, signals)
    angle = p[1] * x[axis, X_ROTOR_POSITION] + p[2]
    wave, slope = sine_and_cosine(angle)
    if s[1] == 0.0:
        s[0] = wave
        s[1] = 1.0
    carried_ahead(x[axis], p[3], p[0] * (wave - s[0]), p[0] * p[1] * slope * x[axis, X_ROTOR_SPEED])


@compiled(inline=True)
def carried_ahead(x, own_body, error, speed):  # type: ignore[no-untyped-def]
    """The load is ahead of the rotor: a rotor of its own shows it through the coupling, a rigid one at the motor encoder."""
    if own_body > 0.0:
        x[X_TRANSMISSION_ERROR] += error
        x[X_TRANSMISSION_ERROR_SPEED] += speed
    else:
        x[X_MOTOR_POSITION] -= error
        x[X_MOTOR_SPEED] -= speed
