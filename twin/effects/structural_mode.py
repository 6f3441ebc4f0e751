"""A structural mode: a mass that swings on a spring in the direction of an axis, and that the axis feels.

The bed on its mounts swings under the axis, mass M against the axis' m; or a part swings that the axis carries. Displacement f, position q of
the axis relative to the bed:

    f'' + 2 z w f' + w^2 f = -r q''             w, z: natural frequency and damping ratio with the axis held;  r = m / (M + m)
    m (1 - r) q'' = F + m (2 z w f' + w^2 f)    from m (q'' + f'') = F

All encoders and the friction are relative to the bed. For a carried part, r is its share of the moving mass: the axis moves alike. Source:
two masses in series, q'' (1 - r s^2 / (s^2 + 2 z w s + w^2)) = F / m.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

from twin.compiled_functions import compiled
from twin.machine.machine import Axis
from twin.simulation.loop_terms import X_LOAD_ACCELERATION, X_LOAD_FORCE, X_STEP, arrays, term


def mode_parameters(axis: Axis, mass: float, tick: float) -> list[float]:
    """Parameters of the term for the keys `mode_frequency_hz`, `mode_mass_share` and `mode_damping_ratio`; `mass` of the load [kg, kg m2]."""
    w = 2.0 * math.pi * axis.mode_frequency_hz
    swing = swing_parameters(w, axis.mode_damping_ratio, -axis.mode_mass_share, tick)
    return [*swing, mass * (2.0 * axis.mode_damping_ratio * w), mass * (w * w)]


def swing_parameters(w: float, damping_ratio: float, gain: float, tick: float) -> list[float]:
    """P and g of f'' + 2 z w f' + w^2 f = gain q'', exact over a tick for constant acceleration: [f, f'](k+1) = P [f, f'](k) + g q''."""
    step = expm(np.array([[0.0, 1.0, 0.0], [-(w * w), -2.0 * damping_ratio * w, gain], [0.0, 0.0, 0.0]]) * tick)
    return [*step[0], *step[1]]


@compiled(inline=True)
def advance_swing(p, s, acceleration):  # type: ignore[no-untyped-def]
    """Advance [f, f'] in `s` over the last tick with its mean acceleration, by p[:6]."""
    f, rate = s[0], s[1]
    s[0] = p[0] * f + p[1] * rate + p[2] * acceleration
    s[1] = p[3] * f + p[4] * rate + p[5] * acceleration


@term
def structural_mode(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F += p[6] f' + p[7] f at the middle of the next tick."""
    p, s, x = arrays(parameters, state, signals)
    advance_swing(p, s, x[axis, X_LOAD_ACCELERATION])
    x[axis, X_LOAD_FORCE] += p[6] * s[1] + p[7] * (s[0] + 0.5 * x[axis, X_STEP] * s[1])
