"""Sampled linear systems; the margins of the loops are computed with them: x(k+1) = a x(k) + b u(k), y(k) = c x(k)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from scipy.linalg import block_diag

GRID = 3000
LOWEST_HZ = 0.05
STABLE = 1.0 + 1e-9
"""Largest radius of the poles of a stable closed loop. A viscous axis at rest without an integral part has a pole on the unit circle."""


@dataclass(frozen=True)
class Loop:
    """An open loop x+ = a x + b e, y = c x with sample `period` [s]; `name`: current, speed or position."""

    name: str
    period: float
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    def open_response(self, frequency: np.ndarray) -> np.ndarray:
        """L at frequencies [Hz] (frequency,), complex."""
        z = np.exp(2j * np.pi * np.atleast_1d(frequency) * self.period)
        matrices = z[:, None, None] * np.eye(len(self.a)) - self.a
        states = np.linalg.solve(matrices, np.broadcast_to(self.b.astype(complex), (len(z), *self.b.shape)))
        return np.asarray((self.c @ states)[:, 0, 0])

    def closed_response(self, frequency: np.ndarray) -> np.ndarray:
        """L / (1 + L) at frequencies [Hz]."""
        response = self.open_response(frequency)
        return response / (1.0 + response)

    @property
    def is_stable(self) -> bool:
        """True if all poles of the closed loop lie inside the unit circle."""
        return bool(np.abs(np.linalg.eigvals(self.a - self.b @ self.c)).max() < STABLE)

    def grid(self, count: int = GRID) -> np.ndarray:
        """Frequencies [Hz] up to half the sampling rate: `count` logarithmic ones, and those of the open loop's poles."""
        even = np.geomspace(min(LOWEST_HZ, 1e-3 / self.period), 0.5 / self.period * (1.0 - 1e-6), count)
        # a resonance may be narrower than the steps, so its frequency is added
        own = np.abs(np.angle(np.linalg.eigvals(self.a))) / (2.0 * np.pi * self.period)
        return np.union1d(even, own[(own > even[0]) & (own < even[-1])])


def sampled(a: np.ndarray, b: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Discretise with a zero-order hold over a period."""
    a, b, *_ = scipy.signal.cont2discrete((a, b, np.eye(len(a)), np.zeros_like(b)), period)
    return a, b


def held(a: np.ndarray, b: np.ndarray, cycles: int) -> tuple[np.ndarray, np.ndarray]:
    """The plant over several cycles with constant input."""
    count = b.shape[1]
    power = np.linalg.matrix_power(np.block([[a, b], [np.zeros((count, len(a))), np.eye(count)]]), cycles)
    return power[:-count, :-count], power[:-count, -count:]


def with_past(a: np.ndarray, b: np.ndarray, row: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The plant with the last values of a row of its states as further states, newest first."""
    size = len(a)
    a = block_diag(a, np.eye(count, k=-1))
    a[size, :size] = row
    return a, np.vstack([b, np.zeros((count, 1))])


def with_controller(name: str, period: float, plant: tuple[np.ndarray, np.ndarray, np.ndarray], gain: float, integral: float) -> Loop:
    """A plant with a P or PI controller: u = gain e + I, I+ = I + integral e."""
    a, b, c = plant
    if integral == 0.0:
        return Loop(name, period, a, gain * b, c)
    n = len(a)
    wide = block_diag(a, 1.0)
    wide[:n, n:] = b
    return Loop(name, period, wide, np.vstack([gain * b, [[integral]]]), np.hstack([c, [[0.0]]]))


def with_transfer(plant: Loop, gain: float, added: Sequence[tuple[np.ndarray, np.ndarray]]) -> Loop:
    """A plant with a P controller and further transfer functions beside it: polynomials in 1/z of equal length, numerator and denominator."""
    a, b, c, direct = plant.a, plant.b, plant.c, gain
    into = np.zeros((len(a), 1))
    for numerator, denominator in added:
        own, entry, out, through = scipy.signal.tf2ss(numerator, denominator)
        direct += float(through[0, 0])
        a = np.block([[a, np.vstack([plant.b @ out, np.zeros((len(a) - len(plant.a), len(own)))])], [np.zeros((len(own), len(a))), own]])
        into = np.vstack([into, entry])
        c = np.hstack([c, np.zeros((1, len(own)))])
    b = np.vstack([b * direct, into[len(plant.a) :]])
    return Loop(plant.name, plant.period, a, b, c)


def closed(loop: Loop) -> tuple[np.ndarray, np.ndarray]:
    """The closed loop, from set point to state."""
    return loop.a - loop.b @ loop.c, loop.b


def padded(row: np.ndarray, size: int) -> np.ndarray:
    return np.append(row, np.zeros(size - len(row)))
