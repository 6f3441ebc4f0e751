"""The parts of a PID that a recorded speed set point shows, as LinuxCNC's `pid` has them.

    v* = P e' + F1 f + I int e' dt + F2 df/dt + D de'/dt + F3 d2f/dt2 + F0 s

f is made of the set points s alone, e' is e without the dead band, and there are no delays. D, F3 and F0 resemble filters and delays of other
controls: they count only where the law without them leaves more than rounding, and with them no more.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from twin.control.block import keyed
from twin.control.command_law import ROUNDED
from twin.control.pid import PID
from twin.estimate.held_out_gain import held_out, is_better
from twin.estimate.regression import Fit, regress, solved
from twin.identify.position_law import OF_ROUNDING, PID_TERMS, ROUNDING, SLOPE, PositionLaw, level

INTEGRAL, BAND, FEWEST_TERMS = 2, 2 + len(PID_TERMS), 4
"""Columns of the integral and of the dead band in the terms of a PID. Without D, FF3 and FF0 it has so many."""

DEAD_BAND_STEPS, OF_COLUMNS = 12, 1e-4
"""Steps of Gauss and Newton to the dead band. Standard deviation of a number of `pid` due to rounded columns, as a share of it."""


@dataclass(frozen=True)
class RecordedPid:
    """The law of a PID: its fit, how far rounding may move gain and weight (2,), the numbers of block `pid` as `keyed`, and whether it leaves no more than rounding."""

    law: PositionLaw
    fit: Fit
    of_rounding: np.ndarray
    numbers: dict[str, tuple[float, float]]
    exact: bool


class _Part(NamedTuple):
    """A law with some of the terms: their indices, columns (row, term) and fit, the dead band [axis units], and whether rounding explains what it leaves."""

    terms: list[int]
    columns: np.ndarray
    fit: Fit
    dead_band: float
    exact: bool


def recorded_pid(law: PositionLaw, left: Sequence[np.ndarray]) -> RecordedPid | None:
    """The PID on the runs of a law, if it predicts better than another law, which leaves `left` (cycle,) of each run.

    Rounding in the columns X of n rows, of covariance N a row, moves the numbers b by up to (X'X)^-1 n N b.
    """
    own = PositionLaw(law.axis, law.runs, law.way if law.way != SLOPE else "cubic")
    own.recorded = False
    rest = np.concatenate([level(of_run[law.usable(run)]) for run, of_run in zip(law.runs, left)])
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
        exact = bool(np.std(fit.residual) < max(rounded, ROUNDING * float(np.std(given))))
        return _Part(terms, columns[:, terms], fit, dead_band if BAND in terms else 0.0, exact)

    best = part_of(list(range(FEWEST_TERMS)))
    if not best.exact and (whole := part_of(list(range(BAND)))).exact:
        best = whole
    needed = [
        term
        for i, term in enumerate(best.terms)
        if term < INTEGRAL or is_better(left_out(best.columns), left_out(np.delete(best.columns, i, axis=1)), least)
    ]
    if needed != best.terms:
        best = part_of([term for term in needed if term < BAND])
    if not is_better(left_out(best.columns), held_out(np.zeros((len(rest), 1)), rest, of_piece), least):
        return None
    columns, fit = best.columns, best.fit
    away = np.abs(solved(columns.T @ columns, len(given) * noise[np.ix_(best.terms, best.terms)] @ fit.values))
    found = _numbers(best, np.hypot(fit.deviations, away))
    if not found or any(found.get(n, (0.0,))[0] < 0.0 for n in ("integral", "derivative", "dead_band")):  # no such controller
        return None
    return RecordedPid(own, fit, away[:2], keyed(PID, found, law.axis.kind), best.exact)


def _numbers(part: _Part, deviations: np.ndarray) -> dict[str, tuple[float, float]]:
    """Numbers of the block beside P and FF1 that are not zero, with their half intervals, from the standard deviations (term,)."""
    fit, names = part.fit, [PID_TERMS[term - 2] for term in part.terms[2:] if term < BAND]
    values, spread = (dict(zip(names, numbers[2:].tolist())) for numbers in (fit.values, deviations))
    if part.dead_band > 0.0:
        values["dead_band"], spread["dead_band"] = part.dead_band, float(deviations[-1] / fit.values[0])
    found = {n: (float(v), fit.quantile * math.hypot(spread[n], OF_COLUMNS * v)) for n, v in values.items()}
    return {n: (v, half) for n, (v, half) in found.items() if abs(v) > half}
