"""Effects of the direct measuring system: frame vibration, eccentric encoder disc, thermal drift."""

import math

from twin.effects.change import Change
from twin.effects.effect import DEGREES, PERCENT, Parameter, Picture, effect
from twin.effects.structural_mode import advance_swing, swing_parameters
from twin.machine.machine import Axis
from twin.simulation.loop_terms import MEASURE, X_LOAD_ACCELERATION, X_LOAD_POSITION, X_SCALE, X_TIME, arrays, term
from twin.simulation.waves import sine
from twin.units import ARCSEC


@effect(
    block="measurement",
    parameters=(
        Parameter("frequency_hz", "frequency", 1.0, 500.0, (20.0, 45.0), logarithmic=True, scan="resonance"),
        Parameter("mass_ratio", "number", 0.0, 1.0, (0.03, 0.10), default=0.06, shape=True, neutral=0.0, logarithmic=True, shown=PERCENT),
        Parameter("damping_ratio", "number", 0.0, 1.0, (0.02, 0.1), default=0.05, shape=True, logarithmic=True),
    ),
    separating_move="chirp",
    rivals="A compliant transmission appears in both encoders; frame vibration appears in the scale and hardly at the motor.",
    picture=Picture(
        "Each change of acceleration makes the scale signal ring, but hardly the motor.",
        "jerk",
        sizes={"frequency_hz": 28.0, "mass_ratio": 0.08},
    ),
)
def frame_vibration(change: Change, axis: Axis, frequency_hz: float, mass_ratio: float, damping_ratio: float) -> None:
    """Vibration of the bed by the acceleration of the carriage; visible in the scale, not at the motor.

    Scale = q + f with f'' + 2 damping_ratio w f' + w^2 f = mass_ratio q'', w = 2 pi frequency. Source: base mode of a machine
    on its levelling elements, 20 to 60 Hz.
    """
    swing = swing_parameters(2.0 * math.pi * frequency_hz, damping_ratio, mass_ratio, change.machine.base_tick)
    change.add_term(frame, MEASURE, axis, swing)


@effect(
    block="measurement",
    axes="full turn",
    parameters=(
        Parameter("amplitude", "length", 0.0, 1e-2, (4 * ARCSEC, 15 * ARCSEC), neutral=0.0, logarithmic=True),
        Parameter("phase_rad", "angle", -2 * math.pi, 2 * math.pi, default=0.0, shape=True, periodic=True, shown=DEGREES),
    ),
    rivals="A cyclic error has the period of a motor turn and disturbs the motor; eccentricity has the period of a table turn.",
    picture=Picture("Motor minus scale has the period of a table turn.", "turn", axis="C"),
)
def encoder_eccentricity(change: Change, axis: Axis, amplitude: float, phase_rad: float) -> None:
    """Eccentric disc of the direct encoder: an error with the period of a table turn.

    Scale = q + amplitude (sin(q + phase) - sin(q0 + phase)), q0 at the start of the run.
    """
    change.add_term(eccentric_scale, MEASURE, axis, [amplitude, phase_rad])


@effect(
    block="measurement",
    axes="linear",
    parameters=(Parameter("rate", "speed", -1e-4, 1e-4, (-0.4e-6, 0.4e-6), neutral=0.0, shown={"m/s": ("um/min", 6e7)}),),
    separating_move="rest",
    rivals="A lead error follows the position; drift continues at rest and from run to run.",
    picture=Picture(
        "Motor and scale drift apart with time, independent of the motion; this run began 20 s into the campaign.",
        "again",
        sizes={"rate": 0.4e-6},
        started_at=20.0,
    ),
)
def thermal_drift(change: Change, axis: Axis, rate: float) -> None:
    """Scale drifts against the motor at a constant rate, across runs.

    Scale = q + rate (started_at_s + t). Source: thermal expansion of screw and bed, 12 um per metre and kelvin.
    """
    change.scale_offset[change.index(axis)] += rate * change.started_at
    change.add_term(drifting_scale, MEASURE, axis, [rate, change.started_at])


@term
def frame(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """The scale shows q + f."""
    p, s, x = arrays(parameters, state, signals)
    advance_swing(p, s, x[axis, X_LOAD_ACCELERATION])
    x[axis, X_SCALE] += s[0]


@term
def eccentric_scale(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
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
