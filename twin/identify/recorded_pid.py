"""The parts of a PID that a recorded speed set point shows, as LinuxCNC's `pid` has them.

    v* = P e' + F1 f + I int e' dt + F2 df/dt + D de'/dt + F3 d2f/dt2 + F0 s

f is made of the set points s alone, e' is e without the dead band, and there are no delays. D, F3 and F0 resemble filters and delays of other
controls: they count only where the law without them leaves more than rounding, and with them no more.
"""

import math
from typing import NamedTuple

import numpy as np

from twin.control.block import keyed
from twin.control.command_law import ROUNDED
from twin.control.pid import PID
from twin.estimate.held_out_gain import held_out, is_better
from twin.estimate.regression import Fit, regress, solved
from twin.identify.found_law import Found, rms
from twin.identify.position_law import OF_ROUNDING, PID_TERMS, ROUNDING, SLOPE, PositionLaw

INTEGRAL, BAND, FEWEST_TERMS = 2, 2 + len(PID_TERMS), 4
"""Columns of the integral and of the dead band in the terms of a PID. Without D, FF3 and FF0 it has so many."""

DEAD_BAND_STEPS, OF_COLUMNS = 12, 1e-4
"""Steps of Gauss and Newton to the dead band. Standard deviation of a number of `pid` due to rounded columns, as a share of it."""


class _Part(NamedTuple):
    """A law with some of the terms: their indices, columns (row, term) and fit, the dead band [axis units], and what the rounding of the record leaves."""

    terms: list[int]
    columns: np.ndarray
    fit: Fit
    dead_band: float
    rounding: float


def recorded_pid(plain: Found, _starts: dict[PositionLaw, np.ndarray]) -> Found | None:
    """The PID on the runs of a law, if there is such a controller.

    Rounding in the columns X of n rows, of covariance N a row, moves the numbers b by up to (X'X)^-1 n N b.
    """
    law = plain.law
    own = PositionLaw(law.axis, law.runs, law.way if law.way != SLOPE else "cubic")
    own.recorded = False
    every, given, clusters, of_piece = own.terms()
    least, noise = ROUNDED * float(np.std(given)), own.rounding_of_terms()

    def left_out(columns: np.ndarray) -> np.ndarray:
        return held_out(columns, given, of_piece)

    def part_of(terms: list[int]) -> _Part:
        dead_band, banded = 0.0, every
        for _ in range(DEAD_BAND_STEPS):
            numbers, before = solved(banded[:, [*terms, BAND]], given), dead_band
            dead_band = max(dead_band + float(numbers[-1] / numbers[0]), 0.0)
            if dead_band == before:
                break
            banded = own.terms(dead_band, float(numbers[terms.index(INTEGRAL)] / numbers[0]) if INTEGRAL in terms else 0.0)[0]
        columns = every
        if dead_band > 0.0 and is_better(left_out(banded[:, terms]), left_out(every[:, terms]), least):
            columns, terms = banded, [*terms, BAND]
        fit = regress(columns[:, terms], given, clusters)
        rounded = OF_ROUNDING * math.sqrt(max(float(fit.values @ noise[np.ix_(terms, terms)] @ fit.values), 0.0))
        return _Part(terms, columns[:, terms], fit, dead_band if BAND in terms else 0.0, max(rounded, ROUNDING * float(np.std(given))))

    best = part_of(list(range(FEWEST_TERMS)))
    if rms(best.fit) > best.rounding and rms((whole := part_of(list(range(BAND)))).fit) <= whole.rounding:
        best = whole
    needed = [
        term
        for i, term in enumerate(best.terms)
        if term < INTEGRAL or is_better(left_out(best.columns), left_out(np.delete(best.columns, i, axis=1)), least)
    ]
    if needed != best.terms:
        best = part_of([term for term in needed if term < BAND])
    columns, fit = best.columns, best.fit
    away = np.abs(solved(columns.T @ columns, len(given) * noise[np.ix_(best.terms, best.terms)] @ fit.values))
    found = _numbers(best, np.hypot(fit.deviations, away))
    if not found or any(found.get(n, (0.0,))[0] < 0.0 for n in ("integral", "derivative", "dead_band")):  # no such controller
        return None
    x, blocks = np.array([*fit.values[:2], 0.0, 0.0]), keyed(PID, found, law.axis.kind)
    words = f"a PID: {', '.join(f'{key} = {value:.4g}' for key, (value, _) in blocks.items())}"
    others = [x + np.array([*away[:2], 0.0, 0.0])]
    return Found(own, fit, x, others, rms(fit), best.rounding, left_out(columns), words, blocks=blocks, delayed=False)


def _numbers(part: _Part, deviations: np.ndarray) -> dict[str, tuple[float, float]]:
    """Numbers of the block beside P and FF1 that are not zero, with their half intervals, from the standard deviations (term,)."""
    fit, names = part.fit, [PID_TERMS[term - 2] for term in part.terms[2:] if term < BAND]
    values, spread = (dict(zip(names, numbers[2:].tolist())) for numbers in (fit.values, deviations))
    if part.dead_band > 0.0:
        values["dead_band"], spread["dead_band"] = part.dead_band, float(deviations[-1] / fit.values[0])
    found = {n: (float(v), fit.quantile * math.hypot(spread[n], OF_COLUMNS * v)) for n, v in values.items()}
    return {n: (v, half) for n, (v, half) in found.items() if abs(v) > half}
