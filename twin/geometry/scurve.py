"""Jerk-limited moves from rest to rest in closed form, as set points of tests and examples.

A move has seven phases of constant jerk (+J 0 -J, 0, -J 0 +J). Phases that a short move does not need have zero length.
"""

from collections.abc import Sequence
import math

import numpy as np

from twin.limits import MOST_SETPOINTS, refuse_above


def phases_of_move(distance: float, speed: float, acceleration: float, jerk: float) -> tuple[float, float, float]:
    """Durations [s] of a jerk phase, of constant acceleration and of constant speed, for a move over `distance` > 0.

    With t_j and t_a the move reaches v = J t_j (t_j + t_a), and covers v (2 t_j + t_a) while accelerating and braking.
    """
    # limits apply in this order: speed, acceleration, distance
    t_j = min(math.sqrt(speed / jerk), acceleration / jerk)
    t_a = max(speed / (jerk * t_j) - t_j, 0.0)
    reached = jerk * t_j * (t_j + t_a)
    if reached * (2.0 * t_j + t_a) <= distance:
        return t_j, t_a, distance / reached - 2.0 * t_j - t_a
    # too short to reach the speed: J t_j (t_j + t_a) (2 t_j + t_a) = distance
    t_j = min((distance / (2.0 * jerk)) ** (1.0 / 3.0), acceleration / jerk)
    t_a = max(-1.5 * t_j + math.sqrt(0.25 * t_j**2 + distance / (jerk * t_j)), 0.0)
    return t_j, t_a, 0.0


def sample_times(seconds: float, period: float) -> np.ndarray:
    """Times (sample,) from 0 to at least `seconds`, every `period` [s].

    Raises:
        InputError: there would be more than `MOST_SETPOINTS`.
    """
    what = f"set points ({seconds / 3600.0:.3g} h)"
    refuse_above(
        seconds / period, MOST_SETPOINTS, what, "a move from rest to rest", "raise the speed, acceleration or jerk of the machine file"
    )
    return np.arange(math.ceil(seconds / period - 1e-9) + 1) * period


def time_of_move(distance: float, speed: float, acceleration: float, jerk: float) -> float:
    """Duration [s] of a move from rest to rest."""
    t_j, t_a, t_v = phases_of_move(abs(distance), speed, acceleration, jerk)
    return 4.0 * t_j + 2.0 * t_a + t_v


def jerk_limited_move(distance: float, speed: float, acceleration: float, jerk: float, times: np.ndarray) -> np.ndarray:
    """Position (time,) at `times` [s] after the start of the move: 0 before, `distance` after it."""
    t_j, t_a, t_v = phases_of_move(abs(distance), speed, acceleration, jerk)
    lengths = np.array([t_j, t_a, t_j, t_v, t_j, t_a, t_j])
    jerks = math.copysign(jerk, distance) * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])
    # state at the start of each phase, then the cubic of the phase in which each time lies
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    state = np.zeros((8, 3))
    for i, (t, j) in enumerate(zip(lengths, jerks)):
        x, v, a = state[i]
        state[i + 1] = x + v * t + a * t**2 / 2 + j * t**3 / 6, v + a * t + j * t**2 / 2, a + j * t
    phase = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, 6)
    t = np.clip(times - starts[phase], 0.0, lengths[phase])
    x, v, a = state[phase].T
    return x + v * t + a * t**2 / 2 + jerks[phase] * t**3 / 6


def moves_in_turn(
    start: float, distances: Sequence[float], speed: float, acceleration: float, jerk: float, dwell: float, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """Times and positions, sampled with `period` [s], of consecutive moves with a dwell before, between and after them."""
    begin = dwell
    begins = []
    for distance in distances:
        begins.append(begin)
        begin += time_of_move(distance, speed, acceleration, jerk) + dwell
    times = sample_times(begin, period)
    position = np.full(len(times), start)
    for at, distance in zip(begins, distances):
        position += jerk_limited_move(distance, speed, acceleration, jerk, times - at)
    return times, position
