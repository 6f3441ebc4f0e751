"""The pulses of a control's friction compensation in its recorded speed set point (block `friction_pulse`).

    v* = law + A d exp(-(t - t_d) / T)         d, t_d: direction of the last reversal and its time, by the block's own law

With the decay time T the pulses are linear in the amplitude A. A pulse at the first motion of a run depends on what the control did before and has an
amplitude of its own. Source of the law: `twin.control.friction_pulse`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from twin.control.command_law import ROUNDED
from twin.control.friction_pulse import since_reversal
from twin.estimate.held_out_gain import held_out, is_better
from twin.estimate.regression import Fit, regress, solved
from twin.identify.position_law import RIVAL_RATIO, SHARP, PositionLaw, level

LONGEST_S = 0.2
"""Longest decay time [s] that is searched."""

ROUNDS = 4
"""Rounds in which the numbers of the law, the reversals of its output and the pulses are fitted."""


class RecordedPulse(NamedTuple):
    """Numbers of the block by name, SI, with the half widths of their 95 % intervals; the law beside it (4,), its fit, and the RMS that both leave."""

    numbers: dict[str, tuple[float, float]]
    x: np.ndarray
    fit: Fit
    left: float


def recorded_pulse(law: PositionLaw, starts: Sequence[np.ndarray], rounding: float) -> RecordedPulse | None:
    """The pulses after reversals beside the law, searched from each of `starts`, if they predict most of them better than none.

    `starts`: values of NAMES (4,). `rounding`: RMS of the speed set point [axis units a second] that is no residual.
    """
    different = {tuple(x): x for x in starts}.values()
    found = [one for x in different if (one := _beside(law, x, rounding)) is not None]
    return min(found, key=lambda one: one.left, default=None)


class _Pulses:
    """Pulses that follow the reversals of a law with the numbers x (4,), and what this law leaves of the recorded runs."""

    def __init__(self, law: PositionLaw, x: np.ndarray) -> None:
        self.keep, self.cycle = law.usable_rows(), law.runs[0].cycle
        late = round(x[3] / self.cycle) * self.cycle  # the control has set points of whole cycles
        self.since = [since_reversal(law.read(run, run.start - late), law.wanted(k, x)) for k, run in enumerate(law.runs)]
        self.number = [np.cumsum(np.diff(direction, prepend=0.0) != 0.0) for direction, _ in self.since]  # 1: the first motion
        self.clusters = np.concatenate([run.clusters(k)[rows] for k, (run, rows) in enumerate(zip(law.runs, self.keep))])
        self.columns, self.rest = law.columns(x, self.keep), law.rest(x, self.keep)

    def shapes(self, time: float) -> np.ndarray:
        """(row, 1 + run) Pulses of amplitude 1 after reversals, and at the first motion of each run."""
        out = []
        for k, ((direction, age), number, rows) in enumerate(zip(self.since, self.number, self.keep)):
            pulse = direction * np.exp(-age * self.cycle / time)
            columns = np.zeros((len(pulse), 1 + len(self.keep)))
            columns[:, 0], columns[:, 1 + k] = pulse * (number > 1), pulse * (number == 1)
            out.append(level(columns[rows]))
        return np.vstack(out)

    def fit(self, time: float) -> Fit:
        """Corrections of the law, and the amplitudes."""
        return regress(np.column_stack([self.columns, self.shapes(time)]), self.rest, self.clusters)

    def decay_time(self) -> float:
        """The decay time [s] that leaves the least."""

        def left(time: float) -> float:
            columns = np.column_stack([self.columns, self.shapes(time)])
            return float(np.std(self.rest - columns @ solved(columns, self.rest)))

        return float(minimize_scalar(left, bounds=(self.cycle, LONGEST_S), method="bounded", options={"xatol": 1e-7}).x)

    def are_seen(self, time: float, rest: np.ndarray, rounding: float) -> bool:
        """Whether the pulses after reversals predict each other in what the law leaves (row,) better than none."""
        first = np.cumsum([0, *(number[-1] + 1 for number in self.number)])
        of_pulse = np.concatenate([start + number[rows] for start, number, rows in zip(first, self.number, self.keep)])
        used = np.concatenate([number[rows] > 1 for number, rows in zip(self.number, self.keep)])
        shape = self.shapes(time)[:, :1]
        return is_better(held_out(shape, rest, of_pulse, used), held_out(0.0 * shape, rest, of_pulse, used), rounding)


def _at_whole_cycles(x: np.ndarray, cycle: float) -> np.ndarray:
    """The numbers x (4,) with delays next to whole cycles at them: between recorded set points that are joined by lines no descent ends there."""
    whole = np.round(x[2:] / cycle) * cycle + 0.0  # no -0
    return np.concatenate([x[:2], np.where(np.abs(x[2:] - whole) < SHARP * cycle, whole, x[2:])])


def _beside(law: PositionLaw, x: np.ndarray, rounding: float) -> RecordedPulse | None:
    """The pulses beside the law, whose numbers are fitted with them from `x` on."""
    rounds: list[tuple[float, np.ndarray, float, _Pulses, Fit]] = []
    for _ in range(ROUNDS):
        pulses = _Pulses(law, x)
        time = pulses.decay_time()
        fit = pulses.fit(time)
        x = _at_whole_cycles(x + fit.values[: len(x)], pulses.cycle)
        rest = law.rest(x, pulses.keep) - pulses.shapes(time) @ fit.values[len(x) :]
        rounds.append((float(np.std(rest)) if np.all(np.isfinite(rest)) else np.inf, x, time, pulses, fit))
    left, x, time, pulses, fit = min(rounds, key=lambda one: one[0])
    without = float(np.std(pulses.rest - pulses.columns @ solved(pulses.columns, pulses.rest)))
    if RIVAL_RATIO * left > without or not pulses.are_seen(time, law.rest(x, pulses.keep), rounding):
        return None
    shapes, amplitude = pulses.shapes(time), float(fit.values[len(x)])
    slope = (pulses.shapes(1.001 * time) - pulses.shapes(0.999 * time))[:, 0] * amplitude / (0.002 * time)
    whole = regress(np.column_stack([pulses.columns, shapes, slope]), fit.residual, pulses.clusters)
    half = (whole.quantile * whole.deviations[[len(x), -1]] + ROUNDED * np.array([amplitude, time])).tolist()
    if amplitude <= half[0]:
        return None
    return RecordedPulse({"amplitude": (amplitude, half[0]), "decay_time": (time, half[1])}, x, whole, left)
