"""Laws in closed loop: added to the corrected twin, fitted together with its effects and its tuning, and judged on runs left out.

All that the machine of an axis is made of is one vector: the numbers of laws and effects, and the deviations of toleranced parameters, which
have a prior. The twin is simulated for each (Gauss-Newton, in the decoupled plant), and what the fit of the other runs leaves on each fold of
runs is the loss that decides: a law is kept only if it makes that smaller.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any

import numpy as np

from twin.diagnose.channel import Channel
from twin.diagnose.observe import Group, Variation
from twin.diagnose.simulations import Mapper
from twin.diagnose.tolerance import UNIFORM, Nuisance, nuisances_of
from twin.diagnose.tuning import zeros_of
from twin.effects import Setting, settings_of, with_effects
from twin.effects.law import NAME
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.simulation.run import all_or_raise

STEPS = 8
"""Gauss-Newton steps at most."""

RELATIVE_STEP = 0.03
"""Step of a number over which its slope is taken, as a share of it."""

ANGLE_STEP = 0.1
"""The same of an angle [rad]."""

LARGEST_MOVE = 0.5
"""Largest change in one step of a number to which the machine does not answer in proportion, as a share of it."""

PRIOR_WEIGHT_ROWS = 60.0
"""Samples that count as independent: the prior of the tuning is so much lighter than the sum over all rows."""

DAMPINGS = (0.0, 0.3, 3.0)
"""Levenberg-Marquardt dampings that are tried in turn, as multiples of the normal matrix' diagonal."""

CONVERGED = 2e-4
"""Relative gain of the loss below which the fit has converged."""


@dataclass(frozen=True)
class Unknown:
    """One number of the machine that is fitted: a parameter of an effect or law (`setting`), or a toleranced parameter."""

    setting: int | None
    name: str
    step: float
    logarithmic: bool
    nuisance: Nuisance | None = None


Name = Nuisance | tuple[tuple[str, str, str | None], str]
"""A toleranced parameter, or a parameter of the setting with this key."""


@dataclass(frozen=True)
class State:
    """A machine in the making: the nominal one, what of its file is changed, settings, and deviations of toleranced parameters."""

    machine: Machine  # nominal, without effects
    values: Mapping[str, Any]  # of the machine file, by path
    settings: tuple[Setting, ...]
    nuisances: tuple[Nuisance, ...]
    deviations: tuple[float, ...]

    def machine_of(self, machine: Machine) -> Machine:
        """A run's nominal machine made into this one."""
        machine = machine.with_values(dict(self.values)) if self.values else machine
        for nuisance, deviation in zip(self.nuisances, self.deviations):
            if deviation != 0.0:
                machine = nuisance.apply(machine, 1.0 + deviation)
        return with_effects(machine, self.settings)

    def corrected(self) -> Machine:
        """The machine itself."""
        return self.machine_of(self.machine)

    def moved(self, unknowns: Sequence[Unknown], move: np.ndarray) -> State:
        """The state with every unknown moved by so many of its steps, inside its bounds."""
        settings, deviations = list(self.settings), list(self.deviations)
        for u, m in zip(unknowns, move):
            if u.nuisance is not None:
                i = self.nuisances.index(u.nuisance)
                deviations[i] += float(m) * u.step
                continue
            assert u.setting is not None
            setting = settings[u.setting]
            parameter = setting.effect.parameter(u.name)
            value = setting.parameters[u.name]
            new = value * math.exp(u.step * float(m)) if u.logarithmic else value + u.step * float(m)
            if parameter.periodic:
                new = math.remainder(new, 2.0 * math.pi)
            settings[u.setting] = replace(setting, parameters={**setting.parameters, u.name: min(max(new, parameter.low), parameter.high)})
        return replace(self, settings=tuple(settings), deviations=tuple(deviations))


def state_of(machine: Machine, corrected: Machine, axes: Sequence[str], thresholds: Any) -> State:
    """The corrected twin as a state whose numbers on these axes can be fitted; `machine` is the nominal one without effects."""
    nuisances = nuisances_of(machine, axes, thresholds) if machine.parameter_tolerance > 0.0 else ()
    return State(machine, _differences(machine.document, corrected.document), settings_of(corrected), nuisances, (0.0,) * len(nuisances))


def _differences(before: Mapping[str, Any], after: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values of a document by path that differ from another one, effects apart."""
    out: dict[str, Any] = {}
    for key, value in after.items():
        if not prefix and key in ("effect", "model"):
            continue
        old = before.get(key)
        if isinstance(value, Mapping) and isinstance(old, Mapping):
            out |= _differences(old, value, f"{prefix}{key}.")
        elif value != old:
            out[f"{prefix}{key}"] = value
    return out


def unknowns_of(state: State, axes: Sequence[str], tolerance: float) -> list[Unknown]:
    """Numbers of effects and laws on these axes, then their toleranced parameters.

    What every machine has a little of stays as it was found, but for the spring of an axis with a law between its two encoders: without that
    law the search found it from a windup that was something else.
    """
    found = []
    wound = {s.axis for s in state.settings if s.effect.name == NAME and _is_between_encoders(s)}
    for i, setting in enumerate(state.settings):
        beside = setting.axis in wound and setting.effect.block == "transmission"
        if setting.axis not in axes or (setting.effect.normal and not beside):
            continue
        for p in setting.effect.parameters:
            value = setting.parameters.get(p.name)
            if value is None or (p.shape and not p.periodic) or not math.isfinite(value):
                continue
            if value == 0.0 and not p.periodic:  # a place that the shape does not use
                continue
            positive = value > 0.0 and (p.logarithmic or p.low >= 0.0)
            step = ANGLE_STEP if p.periodic else RELATIVE_STEP * (1.0 if positive else abs(value))
            found.append(Unknown(i, p.name, step, positive and not p.periodic))
    for nuisance in state.nuisances:
        found.append(Unknown(None, nuisance.quantity, tolerance * float(UNIFORM), False, nuisance))
    return found


def _name(unknown: Unknown, state: State) -> Name:
    """Which number of which state's machine this is, whatever its index there."""
    if unknown.nuisance is not None:
        return unknown.nuisance
    assert unknown.setting is not None
    return state.settings[unknown.setting].key, unknown.name


def _is_in_proportion(unknown: Unknown, state: State) -> bool:
    """Does the machine answer in proportion to a number, which may then go as far as it asks for, through nothing to the other sign?"""
    if unknown.setting is None:
        return True
    effect = state.settings[unknown.setting].effect
    return not unknown.logarithmic and effect.is_linear and effect.size.name == unknown.name


def _is_between_encoders(law: Setting) -> bool:
    """Does a law change motor minus scale: by a displacement, or as a force over the windup?"""
    return law.effect.definition.get("output") == "displacement" or law.effect.definition.get("variables") == ["windup"]


@dataclass(frozen=True)
class Fitted:
    """A state fitted to a group of axes, with the loss on folds of runs left out and what the fit of the others is on each fold."""

    state: State
    unknowns: list[Unknown]
    left: np.ndarray  # (row,) weighted
    columns: np.ndarray = field(repr=False)  # (row, unknown)
    loss: float
    held_out: float  # half the squares on runs left out, of a single run on the half left out
    moves: tuple[np.ndarray, ...]  # of each fold, in steps; of the only run none
    deviations: np.ndarray  # (unknown,) standard deviations in steps

    @property
    def slopes(self) -> dict[Name, np.ndarray]:
        """The columns by what they are the slope of, for one unit of it instead of a step."""
        return {_name(u, self.state): self.columns[:, i] / u.step for i, u in enumerate(self.unknowns)}

    def without(self, fold: int) -> State:
        """The state fitted to the other folds."""
        return self.state.moved(self.unknowns, self.moves[fold])


class ClosedLoop:
    """The gap of some axes of a group as a function of a state, with the folds on which it is judged."""

    def __init__(self, group: Group, axes: Sequence[str], folds: Sequence[Sequence[int]], mapper: Mapper) -> None:
        self.group, self.axes, self.mapper = group, tuple(axes), mapper
        self.rows = np.concatenate([np.arange(c.rows.start, c.rows.stop) for c in self._channels()])
        self.root = np.sqrt(group.credit[self.rows])
        self.expected = 0.5 * float(group.expected[self.rows] @ group.credit[self.rows])
        self.only_run = len(folds) == 1
        if self.only_run:  # its first half is predicted from its second one, and the other way round
            first = np.concatenate([np.arange(len(c.residual)) < len(c.residual) // 2 for c in self._channels()])
            self.fold_rows = [first, ~first]
        else:
            self.fold_rows = [np.any([group.run_rows(r)[self.rows] for r in fold], axis=0) for fold in folds]
        zeros = zeros_of(group)[self.rows] * self.root[:, None]
        self.zeros = np.linalg.qr(zeros[:, np.any(zeros != 0.0, axis=0)])[0]  # orthonormal

    def _channels(self) -> list[Channel]:
        return [c for c in self.group.channels if c.axis in self.axes]

    def left(self, state: State) -> np.ndarray:
        """What a state leaves of the measured runs (row,), weighted, beside the constants of each run that are zeros of encoders."""
        return all_or_raise(self.left_by_each([state]))[0]

    def left_by_each(self, states: Sequence[State]) -> list[np.ndarray | TwinError]:
        """What each of several states leaves, which have slip alike, or the error of one that cannot be simulated."""
        # slip shows in shaken simulations alone
        creeps = any(s.axis in self.axes and s.effect.normal == "slip" for s in states[0].settings)
        variations = [Variation(state.machine_of, axes=self.axes) for state in states]
        out: list[np.ndarray | TwinError] = []
        for change in self.group.responses(variations, shaken=creeps, mapper=self.mapper):
            if isinstance(change, TwinError):
                out.append(change)
                continue
            rest: np.ndarray = (self.group.residual - change)[self.rows] * self.root
            out.append(rest - self.zeros @ (self.zeros.T @ rest))
        return out

    def fit(self, state: State, tolerance: float, steps: int = STEPS, like: Fitted | None = None) -> Fitted | None:
        """Gauss-Newton from a state; None where it cannot be simulated.

        Slopes are those of the fit `like` where it has them. They are taken again only where a step does not bring what they promise, and
        those of toleranced parameters never: the machine answers to these in proportion.
        """
        unknowns = unknowns_of(state, self.axes, tolerance)
        prior = np.array([PRIOR_WEIGHT_ROWS if u.nuisance is not None else 1e-6 for u in unknowns])
        try:
            left = self.left(state)
        except TwinError:
            return None
        known = like.slopes if like else {}
        names = [_name(u, state) for u in unknowns]
        columns = np.zeros((len(self.rows), len(unknowns)), order="F")
        for i, name in enumerate(names):
            columns[:, i] = known[name] * unknowns[i].step if name in known else 0.0
        asked = [i for i, name in enumerate(names) if name not in known]
        bent = {i for i, u in enumerate(unknowns) if u.nuisance is None}
        taken_here: set[int] = set()  # slopes that were taken at this state
        # of the nuisances from what the machine file says, in steps
        offset = np.array(
            [state.deviations[state.nuisances.index(u.nuisance)] / u.step if u.nuisance is not None else 0.0 for u in unknowns]
        )
        loss = 0.5 * float(left @ left)
        for _ in range(steps):
            columns[:, asked] = self._slopes(state, unknowns, asked, left)
            taken_here |= set(asked)
            asked = sorted(bent - taken_here)
            better = self._better(state, unknowns, columns, left, prior, offset)
            if better is None and asked:
                continue  # slopes from elsewhere led nowhere
            if better is None:
                break
            state, after, move = better
            offset = offset + np.where(prior == PRIOR_WEIGHT_ROWS, move, 0.0)
            promised, gained = loss - 0.5 * float(np.sum(np.square(left - columns @ move))), loss - 0.5 * float(after @ after)
            holds = gained > self.group.thresholds.slopes_hold * promised
            left, loss = after, loss - gained
            if gained < CONVERGED * loss and (holds or not asked):
                break
            taken_here, asked = set(), [] if holds else sorted(bent)
        return self._judged(state, unknowns, left, columns, loss, prior, offset)

    def _slopes(self, state: State, unknowns: Sequence[Unknown], asked: Sequence[int], left: np.ndarray) -> np.ndarray:
        """Slopes (row, asked) of some of the unknowns over a step up, or down where that changes nothing or cannot be simulated."""
        slopes = np.zeros((len(left), len(asked)))
        missing = list(range(len(asked)))
        for side in (1.0, -1.0):
            moved = [state.moved(unknowns, side * np.eye(len(unknowns))[asked[j]]) for j in missing]
            for j, rest in zip(missing, self.left_by_each(moved) if moved else []):
                if not isinstance(rest, TwinError):
                    slopes[:, j] = (left - rest) * side
            missing = [j for j in missing if not slopes[:, j].any()]
        return slopes

    def _better(  # type: ignore[no-untyped-def]
        self, state: State, unknowns: Sequence[Unknown], columns: np.ndarray, left: np.ndarray, prior: np.ndarray, offset: np.ndarray
    ):
        """The state after one step that makes the loss smaller, with what it leaves and the move (Levenberg-Marquardt); None where no step does."""
        before = 0.5 * float(left @ left) + 0.5 * float(prior @ offset**2)
        normal, slope = columns.T @ columns, columns.T @ left - prior * offset
        limits = np.array([math.inf if _is_in_proportion(u, state) else LARGEST_MOVE / RELATIVE_STEP for u in unknowns])
        for damping in DAMPINGS:
            move = np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + np.diag(prior), slope)
            move = np.clip(move, -limits, limits)
            tried = state.moved(unknowns, move)
            try:
                after = self.left(tried)
            except TwinError:
                continue
            if 0.5 * float(after @ after) + 0.5 * float(prior @ (offset + move) ** 2) < before:
                return tried, after, move
        return None

    def _judged(self, state, unknowns, left, columns, loss, prior, offset) -> Fitted:  # type: ignore[no-untyped-def]
        normal = columns.T @ columns + np.diag(prior)
        slope = columns.T @ left - prior * offset
        moves, held_out = [], 0.0
        for rows in self.fold_rows:
            own = columns[rows]
            move = np.linalg.solve(normal - own.T @ own + 1e-9 * np.eye(len(normal)), slope - own.T @ left[rows])
            moves.append(np.zeros(len(normal)) if self.only_run else move)
            held_out += 0.5 * float(np.sum((left[rows] - own @ move) ** 2))
        inflation = max(1.0, loss / max(self.expected, 1e-300))
        deviations = np.sqrt(np.diag(np.linalg.pinv(normal)) * inflation)
        return Fitted(state, list(unknowns), left, columns, loss, held_out, tuple(moves), deviations)


def with_law(state: State, setting: Setting) -> State:
    """The state with one more law."""
    return replace(state, settings=(*state.settings, setting))


def laws_in(state: State) -> tuple[Setting, ...]:
    """The laws of a state."""
    return tuple(s for s in state.settings if s.effect.name == NAME)


Say = Callable[[str], None]
