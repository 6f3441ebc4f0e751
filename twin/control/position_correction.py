"""Correction over position: a table of the control that holds a slope and a wave (SINUMERIK EEC, LinuxCNC COMP_FILE, ISG SSFK).

    E(q) = slope (q - origin) + sine sin(k q) + cosine cos(k q),   k = 2 pi / wavelength
    every Tp:   s -= E(s) - E(s0)                               s0: set point at the start of the run

E is the true minus the commanded position. A run starts with encoders that show the set point, as after referencing, so the correction is 0 there. Lead errors are slopes; the wobble of a screw, a worm or an eccentric disc is a wave. A control
holds E as points of a table with linear interpolation (`twin.remedy.files`); with sixteen points a wave the difference is 2 % of it. Right
where the loop closes on the motor encoder, and for errors of the scale itself. Source: SINUMERIK Extended Functions K3 (EEC).
"""

import math

from twin.control.block import Block, Cycles, Values, listed_number, register
from twin.control.number import Key, positive
from twin.simulation.loop_terms import SETPOINT, X_SETPOINT, arrays, term


@term
def moved_by_correction(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """s -= E(s) - E(s0), E(s) = p[0] (s - p[1]) + p[2] sin(p[4] s) + p[3] cos(p[4] s); state: E(s0), 1 after the first cycle."""
    p, s, x = arrays(parameters, state, signals)
    q = x[axis, X_SETPOINT]
    error = p[0] * (q - p[1]) + p[2] * math.sin(p[4] * q) + p[3] * math.cos(p[4] * q)
    if s[1] == 0.0:
        s[0] = error
        s[1] = 1.0
    x[axis, X_SETPOINT] = q - error + s[0]


def _constants(values: Values, cycles: Cycles, _gain: float) -> list[float]:
    return [values["slope"] * 1e-6, values["origin"], values["sine"], values["cosine"], 2.0 * math.pi / values["wavelength"]]


POSITION_CORRECTION = register(
    Block(
        "position_correction",
        (
            listed_number("slope", "slope_ppm", "slope_ppm", Key(-1e4, 1e4)),
            listed_number("origin", "origin_m", "origin_deg", Key()),
            listed_number("sine", "sine_m", "sine_deg", Key(-10.0, 10.0)),
            listed_number("cosine", "cosine_m", "cosine_deg", Key(-10.0, 10.0)),
            listed_number("wavelength", "wavelength_m", "wavelength_deg", positive()),
        ),
        SETPOINT,
        moved_by_correction,
        _constants,
        strengths=(("slope", "sine", "cosine"),),
    )
)
