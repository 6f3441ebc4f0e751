"""The pulses of a control's friction compensation in its recorded speed set point (block `friction_pulse`).

    v* = law + A d exp(-(t - t_d) / T)         d, t_d: direction of the last reversal and its time, by the block's own law

With the decay time T the pulses are linear in the amplitude A. A pulse at the first motion of a run depends on what the control did before and has an
amplitude of its own. Source of the law: `twin.control.friction_pulse`.
"""

from dataclasses import replace
import math

import numpy as np
from scipy.optimize import minimize_scalar

from twin.control.block import keyed
from twin.control.command_columns import ROUNDED
from twin.control.friction_pulse import FRICTION_PULSE, since_reversal
from twin.estimate.held_out_gain import held_out, is_better
from twin.estimate.regression import Fit, regress, solved
from twin.identify.position_law import NAMES, SHARP, PositionLaw, level
from twin.identify.position_law_search import RIVAL_RATIO, Found, in_whole_cycles, pieces

LONGEST_S = 0.2
"""Longest decay time [s] that is searched."""

ROUNDS = 8
"""Steps in which the numbers of the law, the reversals of its output and the pulses are fitted."""


def beside_pulses(found: Found) -> Found | None:
    """A law with pulses after its reversals, if they predict most of them better than none.

    Where both leave more than the law without its outliers, the pulses are of another shape, and no number of the block is determined.
    """
    law, least = found.law, max(found.left, found.rounding)
    whole = in_whole_cycles(law)[0] if len(found.x) == len(NAMES) else _at_whole_cycles(found.x, law.runs[0].cycle, 0.5)
    starts = {tuple(x): x for x in (whole, found.x)}.values()  # at rounding the one without a part of a cycle
    beside = [one for x in starts if (one := _beside(found, x, least)) is not None]
    best = min(beside, key=lambda one: max(one.left, one.rounding), default=None)
    if best is None or best.left < least:
        return best and replace(best, others=[one.x for one in beside if one.left < RIVAL_RATIO * max(best.left, best.rounding)])
    undetermined = {key: (value, math.inf) for key, (value, _) in best.blocks.items()}
    return replace(found, blocks=undetermined) if len(found.x) == len(NAMES) else None


class _Pulses:
    """Pulses that follow the reversals of a law with the numbers x, and what this law leaves of the recorded runs."""

    def __init__(self, law: PositionLaw, x: np.ndarray) -> None:
        self.keep, self.cycle, self.law = law.usable_rows(), law.runs[0].cycle, law.at(x)
        late = round(x[3] / self.cycle) * self.cycle  # the control has set points of whole cycles
        self.since = [since_reversal(self.law.read(run, run.start - late), self.law.output(k, x)) for k, run in enumerate(self.law.runs)]
        self.number = [np.cumsum(np.diff(direction, prepend=0.0) != 0.0) for direction, _ in self.since]  # 1: the first motion
        self.clusters = law.clusters(self.keep)
        self.columns, self.rest = law.columns(x, self.keep), law.rest(x, self.keep)

    def shapes(self, time: float) -> np.ndarray:
        """(row, 1 + run) Pulses of amplitude 1 after reversals, and at the first motion of each run."""
        out = []
        for k, ((direction, age), number, rows) in enumerate(zip(self.since, self.number, self.keep)):
            pulse = direction * np.exp(-age * self.cycle / time)
            columns = np.zeros((len(pulse), 1 + len(self.keep)))
            columns[:, 0], columns[:, 1 + k] = pulse * (number > 1), pulse * (number == 1)
            out.append(level(self.law.as_recorded(k, columns.__getitem__, rows)))
        return np.vstack(out)

    def beside(self, time: float) -> np.ndarray:
        """(row, ...) Columns of the law, of the pulses, and of the decay time of those after reversals at amplitude 1."""
        slope = (self.shapes(1.001 * time) - self.shapes(0.999 * time))[:, :1] / (0.002 * time)
        return np.column_stack([self.columns, self.shapes(time), slope])

    def decay_time(self) -> float:
        """The decay time [s] that leaves the least."""

        def left(time: float) -> float:
            columns = np.column_stack([self.columns, self.shapes(time)])
            return float(np.std(self.rest - columns @ solved(columns, self.rest)))

        return float(minimize_scalar(left, bounds=(self.cycle, LONGEST_S), method="bounded").x)

    def are_seen(self, time: float, rest: np.ndarray, rounding: float) -> bool:
        """Whether the pulses after reversals predict each other in what the law leaves (row,) better than none."""
        first = np.cumsum([0, *(number[-1] + 1 for number in self.number)])
        of_pulse = np.concatenate([start + number[rows] for start, number, rows in zip(first, self.number, self.keep)])
        used = np.concatenate([number[rows] > 1 for number, rows in zip(self.number, self.keep)])
        shape = self.shapes(time)[:, :1]
        return is_better(held_out(shape, rest, of_pulse, used), held_out(0.0 * shape, rest, of_pulse, used), rounding)


def _at_whole_cycles(x: np.ndarray, cycle: float, within: float = SHARP) -> np.ndarray:
    """The numbers x with delays next to whole cycles at them: between recorded set points that are joined by lines no descent ends there."""
    whole = np.round(x[2:4] / cycle) * cycle + 0.0  # no -0
    return np.concatenate([x[:2], np.where(np.abs(x[2:4] - whole) <= within * cycle, whole, x[2:4]), x[4:]])


def _beside(found: Found, x: np.ndarray, least: float) -> Found | None:
    """The law with the pulses: steps of Gauss and Newton from the numbers x on, each with the reversals of its output."""
    law, n, kind = found.law, len(x), found.law.axis.kind
    time = _Pulses(law, x).decay_time()
    rounds: list[tuple[float, np.ndarray, float, _Pulses, np.ndarray, Fit]] = []
    for _ in range(ROUNDS):
        pulses = _Pulses(law, x)
        columns = pulses.beside(time)
        fit = regress(columns, pulses.rest, pulses.clusters)
        x = _at_whole_cycles(x + fit.values[:n], pulses.cycle)
        time = float(np.clip(time + fit.values[-1] / (fit.values[n] or math.inf), pulses.cycle, LONGEST_S))
        rest = law.rest(x, pulses.keep) - pulses.shapes(time) @ fit.values[n:-1]
        rounds.append((float(np.std(rest)) if np.all(np.isfinite(rest)) else np.inf, x, time, pulses, columns, fit))
    left, x, time, pulses, columns, fit = min(rounds, key=lambda one: one[0])
    without = float(np.std(pulses.rest - pulses.columns @ solved(pulses.columns, pulses.rest)))
    if RIVAL_RATIO * left > without or not pulses.are_seen(time, law.rest(x, pulses.keep), least):
        return None
    amplitude = float(fit.values[n])
    half = fit.quantile * fit.deviations[[n, -1]] / [1.0, amplitude] + ROUNDED * np.array([amplitude, time])
    if amplitude <= half[0]:
        return None
    numbers = {"amplitude": (amplitude, float(half[0])), "decay_time": (time, float(half[1]))}
    left_out, blocks = held_out(columns, pulses.rest, pieces(pulses.keep)), keyed(FRICTION_PULSE, numbers, kind)
    return replace(found, x=x, others=[], fit=fit, left=left, left_out=left_out, blocks=blocks)
