"""The elastic coupling of rotor and load, shared by backlash and compliance: dead zone, springs in series, damper."""

from dataclasses import dataclass
import math

from twin.simulation import loop_terms
from twin.simulation.loop_terms import arrays, term

REST_FORCE = 1e-6
"""A smaller holding force, as a fraction of Coulomb friction, leaves the gap centred at rest."""


@dataclass
class Coupling:
    """Elastic coupling of rotor and load: dead zone, springs in series, damper of the softest spring."""

    clearance: float = 0.0
    flexibility: float = 0.0  # sum of 1 / stiffness
    damping: float = 0.0
    softest: float = math.inf
    cause: str = ""  # effect that added the dead zone, or the last spring

    def add(self, cause: str, stiffness: float, damping: float, clearance: float = 0.0) -> None:
        """Add a spring in series [N/m, Nm/rad] with its damping [N s/m, Nm s/rad] and dead zone [m, rad]."""
        self.cause = cause if clearance or not self.clearance else self.cause
        self.clearance += clearance
        self.flexibility += 1.0 / stiffness
        if stiffness < self.softest:
            self.softest, self.damping = stiffness, damping

    @property
    def stiffness(self) -> float:
        """Stiffness of all springs in series, 1 / sum(1 / k) [N/m, Nm/rad]."""
        return 1.0 / self.flexibility

    def rotor_offset(self, held: float, coulomb: float) -> float:
        """Rotor minus load position at rest under a holding force: on the loaded flank with the spring deflected; centred without force."""
        if abs(held) <= REST_FORCE * coulomb:
            return 0.0
        return held * self.flexibility + math.copysign(self.clearance / 2.0, held)


@term
def coupling(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F = k (d -+ c/2) + b d' outside the dead zone |d| <= p[0], on the load; its reaction on the rotor.

    d = rotor + transmission error - load.
    """
    p, s, x = arrays(parameters, state, signals)
    ahead, ahead_speed = x[axis, loop_terms.X_TRANSMISSION_ERROR], x[axis, loop_terms.X_TRANSMISSION_ERROR_SPEED]
    x[axis, loop_terms.X_TRANSMISSION_ERROR] = 0.0
    x[axis, loop_terms.X_TRANSMISSION_ERROR_SPEED] = 0.0
    stretch = (
        x[axis, loop_terms.X_ROTOR_MIDDLE] + ahead + 0.5 * x[axis, loop_terms.X_STEP] * ahead_speed - x[axis, loop_terms.X_LOAD_MIDDLE]
    )
    if stretch > p[0]:
        stretch -= p[0]
    elif stretch < -p[0]:
        stretch += p[0]
    elif p[0] > 0.0:
        return
    force = p[1] * stretch + p[2] * (x[axis, loop_terms.X_ROTOR_SPEED] + ahead_speed - x[axis, loop_terms.X_LOAD_SPEED])
    x[axis, loop_terms.X_LOAD_FORCE] += force
    x[axis, loop_terms.X_ROTOR_FORCE] -= force
