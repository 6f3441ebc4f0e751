"""Screening: the part of the residual that each start explains, as one linear problem over cached responses.

The response to a small effect is proportional to its size, so one simulation per start is sufficient. With the columns

    X = [re-tuning | slopes of the effects found | responses to all starts | residual]

the gain of a start next to others follows from X'X: columns are eliminated one after another (Schur complement), and the gain is read
from the row of the residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from twin.diagnose.columns import Column, Columns
from twin.diagnose.settings import T
from twin.diagnose.starts import Start, combine, softened
from twin.diagnose.state import GroupState
from twin.diagnose.tuning import FREE, solved
from twin.effects import Setting
from twin.effects.setting import Key
from twin.machine.machine import Machine


class Gain(NamedTuple):
    """Gain of a start (drop of the loss) with its best sizes, as multiples of the start's."""

    gain: float
    sizes: tuple[float, ...]


@dataclass(frozen=True)
class Screening:
    """Inner products of the residual and the responses to starts, with re-tuning and other columns eliminated.

    `gram` (column, column) holds the columns of the starts at the slices `at`, and the residual as its last column.
    """

    starts: tuple[Start, ...]
    at: tuple[slice, ...]
    gram: np.ndarray
    own: np.ndarray  # (column,) squares of the columns before elimination

    def gain(self, i: int) -> Gain:
        """Gain of start i."""
        inner, target = self.gram[self.at[i], self.at[i]], self.gram[self.at[i], -1]
        if not np.all(np.diag(inner) > T.collinear * self.own[self.at[i]]):
            return Gain(0.0, ())
        return _best_size(self.starts[i], inner, target)

    def without(self, i: int) -> Screening:
        """The screening with start i eliminated, at any size."""
        at = np.arange(self.at[i].start, self.at[i].stop)
        return Screening(self.starts, self.at, eliminated(self.gram, at, np.full(len(at), FREE)), self.own)

    def best(self) -> dict[Key, tuple[int, Gain]]:
        """The best start of each effect and axis with a positive gain."""
        found: dict[Key, tuple[int, Gain]] = {}
        for i, start in enumerate(self.starts):
            gain = self.gain(i)
            if gain.gain > found.get(start.key, (0, Gain(0.0, ())))[1].gain:
                found[start.key] = i, gain
        return found

    def setting(self, i: int, gain: Gain, machine: Machine) -> Setting:
        """The setting of start i at the sizes of `gain`."""
        start = self.starts[i]
        if start.effect.size.is_spring:
            return softened(start, machine, gain.sizes[0])
        return combine(start, gain.sizes, machine) if start.effect.size.is_scaled else start.settings[0]


def screening(state: GroupState, starts: Sequence[Start]) -> Screening:
    """All starts that can be simulated, next to the tuning and the effects of the last fit."""
    residual = state.group.residual - state.fit.response
    answered = iter(state.cached_responses([s for start in starts for s in start.settings], forget=True))
    both = [(start, [next(answered) for _ in start.settings]) for start in starts]
    simulated = [(start, [c for c in of_start if isinstance(c, Column)]) for start, of_start in both]
    simulated = [(start, of_start) for start, of_start in simulated if len(of_start) == len(start.settings)]
    columns = [c for _, of_start in simulated for c in of_start]
    before = state.tuning.jacobian.beside(state.fit.columns)
    everything = before.beside(Columns(columns, before.rows))
    onto = everything.onto(residual)[:, None]
    gram = np.block([[everything.gram(state.group.mapper), onto], [onto.T, np.array([[residual @ residual]])]])
    first = len(before)
    prior = np.concatenate([state.tuning.prior, np.full(len(state.fit.columns), FREE)])
    own = np.diag(gram)[first:-1].copy()
    reduced = eliminated(gram, np.arange(first), prior)[first:, first:] if first else gram
    at, n = [], 0
    for _, of_start in simulated:
        at.append(slice(n, n + len(of_start)))
        n += len(of_start)
    return Screening(tuple(s for s, _ in simulated), tuple(at), reduced, own)


def eliminated(gram: np.ndarray, at: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Inner products (column, column) after eliminating the columns `at` with this prior."""
    return gram - gram[at].T @ solved(gram[np.ix_(at, at)] + np.diag(prior), gram[at])


def _best_size(start: Start, inner: np.ndarray, target: np.ndarray) -> Gain:
    size = start.effect.size
    if size.is_spring:
        share = float(np.clip(target[0] / inner[0, 0], T.near_noise, T.largest_size))
        return Gain(share * float(target[0] - 0.5 * share * inner[0, 0]), (share,))
    if not size.is_scaled:
        return Gain(float(target[0] - 0.5 * inner[0, 0]), (1.0,))
    sizes = np.linalg.lstsq(inner, target, rcond=1e-9)[0]
    if len(sizes) == 1:
        neutral = size.neutral or 0.0
        deviation = start.settings[0].parameters[size.name] - neutral
        low, high = (size.low - neutral) / deviation, (size.high - neutral) / deviation
        sizes = np.clip(sizes, max(min(low, high), -T.largest_size), min(max(low, high), T.largest_size))
        if size.low >= neutral and not size.is_factor:
            sizes = np.maximum(sizes, 0.0 if size.lag_cycle else T.near_noise)  # a short lag delays by almost nothing
    return Gain(float(sizes @ target - 0.5 * sizes @ inner @ sizes), tuple(sizes.tolist()))
