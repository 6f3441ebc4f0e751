"""A structural mode: a mass that swings on a spring in the direction of an axis, and that the axis feels.

The bed on its mounts swings under the axis, mass M against the axis' m; or a part swings that the axis carries. Displacement f, position q of
the axis relative to the bed:

    f'' + 2 z w f' + w^2 f = -r q''        w, z: natural frequency and damping ratio with the axis held;  r = m / (M + m)
    load force += -m f''

All encoders and the friction are relative to the bed. For a carried part, r is its share of the moving mass: the axis moves alike. Source:
two masses in series, q'' (1 - r s^2 / (s^2 + 2 z w s + w^2)) = F / m.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import expm

from twin.simulation.loop_terms import FORCE, X_LOAD_ACCELERATION, X_LOAD_FORCE, arrays, term

if TYPE_CHECKING:
    from twin.effects.change import Change
    from twin.machine.machine import Axis


def add_structural_mode(change: Change, axis: Axis) -> None:
    """Add the mode of the keys `mode_frequency_hz`, `mode_mass_share` and `mode_damping_ratio`."""
    stiffness, damping, share = oscillator(axis.mode_frequency_hz, axis.mode_damping_ratio, axis.mode_mass_share)
    step = forced_step(stiffness, damping, -share, change.machine.base_tick)
    change.add_term(structural_mode, FORCE, axis, [*step, change.load_inertia(axis), share, damping, stiffness])


def oscillator(frequency_hz: float, damping_ratio: float, share: float) -> tuple[float, float, float]:
    """w^2 [1/s2], 2 z w [1/s] and the share."""
    w = 2.0 * math.pi * frequency_hz
    return w * w, 2.0 * damping_ratio * w, share


def forced_step(stiffness: float, damping: float, gain: float, tick: float) -> np.ndarray:
    """Six numbers that advance [f, f'] by a tick, f'' + damping f' + stiffness f = gain a, exact for a constant acceleration a."""
    system = np.array([[0.0, 1.0, 0.0], [-stiffness, -damping, gain], [0.0, 0.0, 0.0]])
    return np.asarray(expm(system * tick)[:2].ravel())


@term
def structural_mode(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F -= m f'' with the mean acceleration q'' of the last tick. State: f, f'. p: forced step (6), m, r, 2 z w, w^2."""
    p, s, x = arrays(parameters, state, signals)
    a = x[axis, X_LOAD_ACCELERATION]
    f, rate = s[0], s[1]
    s[0] = p[0] * f + p[1] * rate + p[2] * a
    s[1] = p[3] * f + p[4] * rate + p[5] * a
    x[axis, X_LOAD_FORCE] += p[6] * (p[7] * a + p[8] * s[1] + p[9] * s[0])
