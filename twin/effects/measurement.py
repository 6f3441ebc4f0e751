"""Effects in what the direct measuring system shows: the frame moves, the disc is off centre, the scale grows."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

from twin.effects.change import Change
from twin.effects.effect import DEGREES, PERCENT, Parameter, effect
from twin.effects.picture import Picture
from twin.effects.scan import Resonance
from twin.machine.machine import Axis
from twin.simulation.loop_terms import MEASURE, X_LOAD_ACCELERATION, X_LOAD_POSITION, X_SCALE, X_TIME, arrays, term
from twin.simulation.sine import sine
from twin.units import ARCSEC


@effect(
    block="measurement",
    parameters=(
        Parameter("frequency_hz", "frequency", 1.0, 500.0, (20.0, 45.0), logarithmic=True, scan=Resonance()),
        Parameter("mass_ratio", "number", 0.0, 1.0, (0.03, 0.10), default=0.06, shape=True, neutral=0.0, logarithmic=True, shown=PERCENT),
        Parameter("damping_ratio", "number", 0.0, 1.0, (0.02, 0.1), default=0.05, shape=True, logarithmic=True),
    ),
    separating_move="chirp",
    rivals="A compliant transmission shows between motor and load in both encoders; the frame shows in the scale, hardly in the motor.",
    picture=Picture(
        "Each change of acceleration rings in the scale, hardly in the motor.",
        "jerk",
        axis="X",
        sizes={"frequency_hz": 28.0, "mass_ratio": 0.08},
    ),
)
def frame_vibration(change: Change, axis: Axis, frequency_hz: float, mass_ratio: float, damping_ratio: float) -> None:
    """The bed answers the carriage's acceleration; seen by the scale, not by the motor.

    Scale = q + f with f'' + 2 damping_ratio w f' + w^2 f = mass_ratio q'', w = 2 pi frequency. Source: base mode of a machine
    on its levelling elements, 20 to 60 Hz.
    """
    w = 2.0 * math.pi * frequency_hz
    # exact over a tick for constant acceleration: [f, f'](k+1) = P [f, f'](k) + g q''
    system = np.array([[0.0, 1.0, 0.0], [-(w**2), -2.0 * damping_ratio * w, mass_ratio], [0.0, 0.0, 0.0]])
    step = expm(system * change.machine.base_tick)
    change.add_term(frame, MEASURE, axis, [*step[0], *step[1]])


@effect(
    block="measurement",
    axes="full turn",
    parameters=(
        Parameter("amplitude", "length", 0.0, 1e-2, (4 * ARCSEC, 15 * ARCSEC), neutral=0.0, logarithmic=True),
        Parameter("phase_rad", "angle", -2 * math.pi, 2 * math.pi, default=0.0, shape=True, periodic=True, shown=DEGREES),
    ),
    rivals="A cyclic error comes back every motor turn and shakes the motor; an eccentric encoder comes back every table turn.",
    picture=Picture("Once a table turn between motor and scale, slowly.", "turn", axis="C"),
)
def encoder_eccentricity(change: Change, axis: Axis, amplitude: float, phase_rad: float) -> None:
    """Disc of the direct encoder off centre: an error that comes back every turn of the table.

    Scale = q + amplitude (sin(q + phase) - sin(q0 + phase)), q0 where the run starts.
    """
    change.add_term(every_table_turn, MEASURE, axis, [amplitude, phase_rad])


@effect(
    block="measurement",
    axes="linear",
    parameters=(Parameter("rate", "speed", -1e-4, 1e-4, (-0.4e-6, 0.4e-6), neutral=0.0, shown={"m/s": ("um/min", 6e7)}),),
    separating_move="rest",
    rivals="A wrong lead follows the position; drift goes on at rest and from run to run.",
    picture=Picture(
        "Motor and scale part with time, whatever the axis does; this run began 20 s into the campaign.",
        "again",
        axis="X",
        sizes={"rate": 0.4e-6},
        started_at=20.0,
    ),
)
def thermal_drift(change: Change, axis: Axis, rate: float) -> None:
    """Scale moves against the motor at a steady rate, across runs.

    Scale = q + rate (started_at_s + t). Source: growth of screw and bed, 12 um a metre and kelvin.
    """
    change.scale_offset[change.index(axis)] += rate * change.started_at
    change.add_term(drifting_scale, MEASURE, axis, [rate, change.started_at])


@term
def frame(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """Advance [f, f'] by the tick that passed, under its mean acceleration; the scale shows q + f."""
    p, s, x = arrays(parameters, state, signals)
    a = x[axis, X_LOAD_ACCELERATION]
    f, rate = s[0], s[1]
    s[0] = p[0] * f + p[1] * rate + p[2] * a
    s[1] = p[3] * f + p[4] * rate + p[5] * a
    x[axis, X_SCALE] += s[0]


@term
def every_table_turn(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """Scale += p[0] (sin(q + p[1]) - sin(q0 + p[1]))."""
    p, s, x = arrays(parameters, state, signals)
    wave = sine(x[axis, X_LOAD_POSITION] + p[1])
    if s[1] == 0.0:
        s[0] = wave
        s[1] = 1.0
    x[axis, X_SCALE] += p[0] * (wave - s[0])


@term
def drifting_scale(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """Scale += p[0] (p[1] + t)."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_SCALE] += p[0] * (p[1] + x[axis, X_TIME])
