"""Compensations that a control can switch on, at its position cycle: friction pulse, backlash value, table of position errors.

    table      x_c = x + E(x) - E(x_0)          E: points with linear interpolation, held at the ends, or repeated on a turning table
    backlash   x_c = x - c,  c works towards (b / 2) d in steps of b / n;   d: direction of the last motion of the set point
    pulse      when set point and speed command go one way that differs from that of the last pulse:  p = A(a) in that direction;
               it falls as exp(-t / T) and is added to the speed command.  A(a) = A min(a / a1, 1), up to a2; falls to A_low at a3
x is the encoder in the loop, x_0 where the run starts. Written from the manuals of SINUMERIK (K3: EEC, MD32450, MD32490 ff), not from the twin.
Settings hold them by the number of the axis: pulses (A, A_low, T, a1, a2, a3), plays (b, n), tables ((first point, spacing, repeats), errors).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .compiled import compiled
from .parameters import Settings

RESTS = 1e-11  # an axis whose set point changes by less in a cycle rests [m, rad]


class Compensation(NamedTuple):
    """Arrays [axis, number]; zeros switch a compensation off."""

    pulse: np.ndarray  # A, A_low [axis units/s], share left after a cycle, a1, a2, a3 [axis units per cycle^2]
    play: np.ndarray  # half the value, largest change in a cycle
    grid: np.ndarray  # first point, spacing, number of points, 1 if the table repeats
    error: np.ndarray  # [axis, point]


def compensation_of(s: Settings) -> Compensation:
    """Arrays from settings."""
    cycle = s.tick * s.cycle_ticks
    n = len(s.ratio)
    pulse, play, grid = np.zeros((n, 6)), np.zeros((n, 2)), np.zeros((n, 4))
    error = np.zeros((n, max([2, *(len(table[1]) for table in s.tables.values())])))
    for k, (a, low, seconds, *knees) in s.pulses.items():
        pulse[k] = [a, low, math.exp(-cycle / seconds), *(knee * cycle**2 for knee in knees)]
    for k, (width, cycles) in s.plays.items():
        play[k] = 0.5 * width, abs(width) / cycles
    for k, ((first, spacing, repeats), values) in s.tables.items():
        grid[k] = first, spacing, len(values), float(repeats)
        error[k, : len(values)] = values
    return Compensation(pulse, play, grid, error)


# State of an axis: last set point, its last two changes, direction and size of the pulse, direction and size of the shift, E(x_0)
S_LAST, PULSE_WAY, PULSE, PLAY_WAY, SHIFT, AT_START = range(6)
COMPENSATION_STATES = 6


@compiled(inline=True)
def table_error(c: Compensation, k: int, x: float) -> float:
    """E(x) of axis k."""
    if c.grid[k, 2] == 0.0:
        return 0.0
    last = c.grid[k, 2] - 1.0
    at = (x - c.grid[k, 0]) / c.grid[k, 1]
    if c.grid[k, 3] != 0.0:
        at -= last * math.floor(at / last)
    at = min(max(at, 0.0), last)
    i = int(min(math.floor(at), last - 1.0))
    return c.error[k, i] + (at - i) * (c.error[k, i + 1] - c.error[k, i])


@compiled(inline=True)
def compensated_position(c: Compensation, own: np.ndarray, k: int, set_point: float, x: float) -> float:
    """The position that the controller of axis k uses; keeps the motion of its set point in `own` [axis, state]."""
    way = set_point - own[k, S_LAST]
    own[k, S_LAST] = set_point
    if c.play[k, 0] != 0.0:
        if abs(way) > RESTS:
            own[k, PLAY_WAY] = math.copysign(1.0, way)
        missing = c.play[k, 0] * own[k, PLAY_WAY] - own[k, SHIFT]
        own[k, SHIFT] += math.copysign(min(abs(missing), c.play[k, 1]), missing)
    return x + table_error(c, k, x) - own[k, AT_START] - own[k, SHIFT]


@compiled(inline=True)
def friction_pulse(c: Compensation, own: np.ndarray, k: int, speed: float, way: float, way_before: float) -> float:
    """Pulse [axis units/s] on the speed command `speed` of axis k, from the last two steps of the set point that its feedforward differentiates."""
    full, low, left, a1, a2, a3 = c.pulse[k]
    if full == 0.0:
        return 0.0
    own[k, PULSE] *= left
    if abs(way) > RESTS and way * speed > 0.0 and math.copysign(1.0, way) != own[k, PULSE_WAY]:
        own[k, PULSE_WAY] = math.copysign(1.0, way)
        a = abs(way - way_before)
        size = full
        if a < a1:
            size *= a / a1
        elif a3 > 0.0 and a >= a3:
            size = low
        elif a3 > 0.0 and a > a2:
            size += (low - full) * (a - a2) / (a3 - a2)
        own[k, PULSE] = own[k, PULSE_WAY] * size
    return own[k, PULSE]


def compensation_at_rest(c: Compensation, set_point: np.ndarray, x: np.ndarray) -> np.ndarray:
    """State [axis, state] at the start of a run, with encoders at `x`."""
    own = np.zeros((len(x), COMPENSATION_STATES))
    own[:, S_LAST] = set_point
    own[:, AT_START] = [table_error(c, k, x[k]) for k in range(len(x))]
    return own
