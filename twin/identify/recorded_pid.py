"""The parts of a PID that a recorded speed set point shows, as LinuxCNC's `pid` has them.

    v* = P e' + F1 f + I int e' dt + F2 df/dt + D de'/dt + F3 d2f/dt2 + F0 s

f is made of the set points s alone, e' is e without the dead band, and there are no delays. D, F3 and F0 resemble filters and delays of other
controls: they count only where the law without them leaves more than rounding, and with them no more.
"""

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np

from twin.control.block import keyed
from twin.control.command_columns import ROUNDED
from twin.control.pid import PID, TERMS, recorded_terms
from twin.estimate.held_out_gain import held_out, is_better
from twin.estimate.regression import Fit, regress, solved
from twin.identify.position_law import ROUNDING, SLOPE, PositionLaw, level, loop_position
from twin.identify.position_law_search import OF_ROUNDING, Found, pieces, rms
from twin.recordings.roughness import step_of

INTEGRAL, BAND, FEWEST_TERMS = 2, 2 + len(TERMS), 4
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


def recorded_pid(plain: Found) -> Found | None:
    """The PID on the runs of a law, if there is such a controller.

    Rounding in the columns X of n rows, of covariance N a row, moves the numbers b by up to (X'X)^-1 n N b.
    """
    law = plain.law
    own = PositionLaw(law.axis, law.runs, law.way if law.way != SLOPE else "cubic")
    own.recorded = False
    keep = own.usable_rows()
    every, given, clusters, of_piece = _terms(own, keep), own.asked_on(keep), own.clusters(keep), pieces(keep)
    least, noise = ROUNDED * float(np.std(given)), _rounding_of_terms(own)

    def left_out(columns: np.ndarray) -> np.ndarray:
        return held_out(columns, given, of_piece)

    def part_of(terms: list[int]) -> _Part:
        dead_band, banded = 0.0, every
        for _ in range(DEAD_BAND_STEPS):
            numbers, before = solved(banded[:, [*terms, BAND]], given), dead_band
            dead_band = max(dead_band + float(numbers[-1] / numbers[0]), 0.0)
            if dead_band == before:
                break
            banded = _terms(own, keep, dead_band, float(numbers[terms.index(INTEGRAL)] / numbers[0]) if INTEGRAL in terms else 0.0)
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
    fit, names = part.fit, [TERMS[term - 2] for term in part.terms[2:] if term < BAND]
    values, spread = (dict(zip(names, numbers[2:].tolist())) for numbers in (fit.values, deviations))
    if part.dead_band > 0.0:
        values["dead_band"], spread["dead_band"] = part.dead_band, float(deviations[-1] / fit.values[0])
    found = {n: (float(v), fit.quantile * math.hypot(spread[n], OF_COLUMNS * v)) for n, v in values.items()}
    return {n: (v, half) for n, (v, half) in found.items() if abs(v) > half}


def _terms(law: PositionLaw, keep: Sequence[np.ndarray], dead_band: float = 0.0, per_s: float = 0.0) -> np.ndarray:
    """Columns (row, 8) of a PID without delays on some rows of each run.

    The columns are error, feedforward, those of TERMS, and the change of the error and of its integral, of weight `per_s` [1/s], by the dead band.
    """
    columns = []
    for run, on, rows in zip(law.runs, law.on, keep):
        error, slopes = law.error(run, 0.0), np.array([law.fed(run, late * run.cycle) for late in range(3)])
        error = np.copysign(np.maximum(np.abs(error) - dead_band, 0.0), error)
        less = np.sign(error) + per_s * np.cumsum(np.sign(error)) * run.cycle
        further = recorded_terms(error, law.read(run, run.start), slopes, run.cycle)  # a program switches the feedforward of the speed only
        columns.append(level(np.column_stack([error, on * slopes[0], further, -less])[rows]))
    return np.vstack(columns)


def _rounding_of_terms(law: PositionLaw) -> np.ndarray:
    """Covariance (8, 8) of the rounding of set points and positions in a row of `_terms`; that of the integral is small.

    Where positions have a coarser step than set points it is that of the encoder, which the control sees, too.
    """
    run, per_s = law.runs[0], 1.0 / law.runs[0].cycle
    weights = ([1, 0, 0, 0], [1, -1, 0, 0], [1, -2, 1, 0], [1, -3, 3, -1])
    now, first, second, third = (np.array(own) * per_s**k for k, own in enumerate(weights))
    none = np.zeros(4)
    of_setpoint = np.array([now, first, none, second, first, third, now, none])
    of_position = np.array([now, none, none, none, first, none, none, none])
    position = loop_position(run, law.axis)
    assert position is not None
    step = step_of(run.setpoint_at(run.start))
    both = (step, of_setpoint), (min(step, step_of(position)), of_position)
    return np.asarray(sum(size**2 / 12.0 * of @ of.T for size, of in both))
