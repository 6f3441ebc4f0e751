"""Filters of a law: first-order lag, notch or dead time, sampled at the cycle of the controller.

`response` is the frequency response of the compiled filter, so diagnosis and simulation use the same filter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math

import numpy as np

from twin.compiled_functions import compiled
from twin.effects.law_shapes import DEAD_TIME, LAG, Shape
from twin.errors import InputError
from twin.simulation.loop_terms import STATE_COUNT

FIRST_FREE = 5
"""First index of a law's state that its filter uses."""

RING = STATE_COUNT - FIRST_FREE - 1
"""Length of the ring buffer of a dead time in cycles."""


def filter_row(shape: Shape, numbers: Mapping[str, float], cycle: float) -> list[float]:
    """Coefficients of a sampled filter.

    lag        y += p0 (x - y)
    notch      b0 b1 b2 a1 a2 by the bilinear rule with prewarping
    dead time  whole cycles and the remaining fraction of a cycle
    """
    if shape.code == LAG:
        return [-math.expm1(-cycle / max(numbers["time_constant_s"], 1e-12))]
    if shape.code == DEAD_TIME:
        cycles = numbers["time_s"] / cycle
        if cycles > RING - 2:
            raise InputError(
                f"law: a dead time of {numbers['time_s']:g} s; give at most {(RING - 2) * cycle:g} s, {RING - 2} cycles of its controller"
            )
        return [float(math.floor(cycles)), cycles - math.floor(cycles)]
    t = math.tan(min(math.pi * numbers["frequency_hz"] * cycle, 1.5))
    a0 = 1.0 + numbers["width"] * t + t * t
    return [v / a0 for v in (1.0 + t * t, 2.0 * (t * t - 1.0), 1.0 + t * t, 2.0 * (t * t - 1.0), 1.0 - numbers["width"] * t + t * t)]


def response(shape: Shape, numbers: Mapping[str, float], cycle: float, frequency_hz: np.ndarray) -> np.ndarray:
    """Complex response (frequency,) of the sampled filter."""
    row: Sequence[float] = filter_row(shape, numbers, cycle)
    back = np.exp(-2j * np.pi * frequency_hz * cycle)  # one cycle back
    if shape.code == LAG:
        return np.asarray(row[0] / (1.0 - (1.0 - row[0]) * back))
    if shape.code == DEAD_TIME:
        return np.asarray(back ** row[0] * (1.0 - row[1] + row[1] * back))
    return np.asarray((row[0] + row[1] * back + row[2] * back**2) / (1.0 + row[3] * back + row[4] * back**2))


@compiled
def filtered(shape, u, p, s, first):  # type: ignore[no-untyped-def]
    """Output of the filter with coefficients p and state s for input `u`; in steady state at the `first` call."""
    if shape == LAG:
        if first:
            s[0] = u
        s[0] += p[0] * (u - s[0])
        return s[0]
    if shape == DEAD_TIME:
        if first:
            s[0] = 0.0
            s[1 : 1 + RING] = u
        at = int(s[0])
        s[1 + at] = u
        s[0] = float((at + 1) % RING)
        late = (at - int(p[0])) % RING
        before = s[1 + late]
        return before + p[1] * (s[1 + (late - 1) % RING] - before)
    b0, b1, b2, a1, a2 = p[0], p[1], p[2], p[3], p[4]
    if first:
        s[1] = (b2 - a2) * u
        s[0] = (b1 - a1) * u + s[1]
    y = b0 * u + s[0]
    s[0] = b1 * u - a1 * y + s[1]
    s[1] = b2 * u - a2 * y
    return y
