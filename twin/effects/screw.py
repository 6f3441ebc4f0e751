"""Effects of transmission errors between motor and load: lead error and cyclic error.

The load leads the rotor by e(q). With a rigid transmission, rotor and load are one body: the motor encoder shows q - e, and torque and
rotor inertia are reflected through the nominal ratio. With a spring or a dead zone, the rotor has its own joint: e is in series with the
spring, acts on the rotor inertia, and the motor encoder shows the rotor. Recordings of machines with drive trains of 250 to 450 Hz agree
with this model; without it, the contribution of the rotor to e'' is missing.
"""

from __future__ import annotations

import math

from twin.compiled_functions import compiled
from twin.effects.change import Change
from twin.effects.effect import DEGREES, Parameter, Picture, effect
from twin.machine.machine import Axis
from twin.simulation import loop_terms
from twin.simulation.loop_terms import arrays, term
from twin.simulation.waves import sine_and_cosine
from twin.units import ARCSEC


@effect(
    block="transmission",
    axes="linear",
    parameters=(Parameter("fraction", "number", -0.01, 0.01, (-80e-6, 80e-6), neutral=0.0, shown={"1": ("um/m", 1e6)}),),
    rivals="Thermal drift continues while the axis rests; a lead error follows the position.",
    picture=Picture("Motor minus scale is proportional to the distance.", "constant speed", sizes={"fraction": 60e-6}),
)
def lead_error(change: Change, axis: Axis, fraction: float) -> None:
    """Lead error of the screw.

    e = fraction (q - q0), q0 at the start of the run; its derivative acts on the speed loop. Source: ISO 3408-3 lead deviation.
    """
    change.add_transmission_error(lead_transmission_error, axis, [fraction])


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
    rivals="Eccentricity of an encoder has the period of a table turn, a cyclic error that of a motor turn.",
    picture=Picture("Motor minus scale has the period of a motor turn; the speed loop passes the error on to the axis.", "constant speed"),
)  # fmt: skip
def cyclic_error(change: Change, axis: Axis, amplitude: float, phase_rad: float) -> None:
    """Error between motor and load with the period of a motor turn (wobble of the screw, worm).

    e = amplitude (sin(q / r + phase) - sin(q0 / r + phase)).
    """
    change.add_transmission_error(cyclic_transmission_error, axis, [amplitude, 1.0 / axis.ratio, phase_rad])


@term
def lead_transmission_error(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """e = p[0] (q - q0); p[3] = 1 for a rotor with its own joint."""
    p, s, x = arrays(parameters, state, signals)
    if s[1] == 0.0:
        s[0] = x[axis, loop_terms.X_ROTOR_POSITION]
        s[1] = 1.0
    add_load_lead(x[axis], p[3], p[0] * (x[axis, loop_terms.X_ROTOR_POSITION] - s[0]), p[0] * x[axis, loop_terms.X_ROTOR_SPEED])


@term
def cyclic_transmission_error(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """e = p[0] (sin(p[1] q + p[2]) - sin(p[1] q0 + p[2])); p[3] = 1 for a rotor with its own joint."""
    p, s, x = arrays(parameters, state, signals)
    angle = p[1] * x[axis, loop_terms.X_ROTOR_POSITION] + p[2]
    wave, slope = sine_and_cosine(angle)
    if s[1] == 0.0:
        s[0] = wave
        s[1] = 1.0
    add_load_lead(x[axis], p[3], p[0] * (wave - s[0]), p[0] * p[1] * slope * x[axis, loop_terms.X_ROTOR_SPEED])


@compiled(inline=True)
def add_load_lead(x, own_body, error, speed):  # type: ignore[no-untyped-def]
    """Apply a lead of the load over the rotor: through the coupling for a rotor with its own joint, otherwise at the motor encoder."""
    if own_body > 0.0:
        x[loop_terms.X_TRANSMISSION_ERROR] += error
        x[loop_terms.X_TRANSMISSION_ERROR_SPEED] += speed
    else:
        x[loop_terms.X_MOTOR_POSITION] -= error
        x[loop_terms.X_MOTOR_SPEED] -= speed
