"""Closed-loop fit of laws, together with the effects and the tuning of the corrected machine, cross-validated on runs left out.

The unknowns of an axis form one vector: the parameters of laws and effects, and the deviations of toleranced parameters, which have a
prior. Gauss-Newton fits them by simulations of the decoupled plant. A law is kept only if it reduces the cross-validated loss: the residual
on each fold of runs after the fit to the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import copy
from dataclasses import dataclass, field, replace
import math
from typing import Any

import numpy as np

from twin.diagnose.channel import Channel
from twin.diagnose.fit import relative_step
from twin.diagnose.law.residual import ONE_RUN
from twin.diagnose.observe import Group, Variation
from twin.diagnose.settings import DEFAULT, Thresholds
from twin.diagnose.simulations import Mapper
from twin.diagnose.tolerance import SPRING_EFFECT, UNIFORM, Nuisance, nuisances_of, tuned
from twin.diagnose.tuning import zeros_of
from twin.effects import Setting, settings_of, with_effects
from twin.effects.law import NAME
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.simulation.run import all_or_raise

STEPS = 8
"""Largest number of Gauss-Newton steps."""

RELATIVE_STEP = 0.03
"""Relative step of a parameter for its finite-difference slope."""

ANGLE_STEP = 0.1
"""Finite-difference step of an angle [rad]."""

LARGEST_MOVE = 0.5
"""Largest relative change in one Gauss-Newton step of a parameter with a nonlinear response."""

PRIOR_WEIGHT_ROWS = 60.0
"""Weight of the prior of the tuning relative to a single row; consecutive samples are not independent. It grows with the loss over that of
noise: what no law explains yet is model error, and must not pull a parameter out of its tolerance."""

DAMPINGS = (0.0, 0.3, 3.0)
"""Levenberg-Marquardt dampings, tried in order, as multiples of the diagonal of the normal matrix."""

SHORTEST_REST_S = 5e-3
"""Duration of a rest from which an axis sticks. A shorter one is a reversal without a stop: its motion is not random, and laws of friction show there."""

CONVERGED = 2e-4
"""Relative decrease of the loss below which the fit has converged."""


@dataclass(frozen=True)
class Unknown:
    """One fitted parameter: of an effect or law (`setting`), or a toleranced machine parameter."""

    setting: int | None
    name: str
    step: float
    logarithmic: bool
    nuisance: Nuisance | None = None


Name = Nuisance | tuple[tuple[str, str, str | None], str]
"""Identity of an unknown: a toleranced parameter, or key and parameter name of a setting."""


@dataclass(frozen=True)
class State:
    """A machine during the fit: nominal machine, changed values, settings, and deviations of toleranced parameters."""

    machine: Machine  # nominal, without effects
    values: Mapping[str, Any]  # of the machine file, by path
    settings: tuple[Setting, ...]
    nuisances: tuple[Nuisance, ...]
    deviations: tuple[float, ...]

    def machine_of(self, machine: Machine) -> Machine:
        """The machine of this state for a run with the given nominal machine."""
        machine = machine.with_values(dict(self.values)) if self.values else machine
        return with_effects(tuned(self.nuisances, np.asarray(self.deviations))(machine), self.settings)

    def corrected(self) -> Machine:
        """The machine of this state."""
        return self.machine_of(self.machine)

    def moved(self, unknowns: Sequence[Unknown], move: np.ndarray) -> State:
        """The state with each unknown moved by a multiple of its step, within its bounds."""
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
            changed = {u.name: min(max(new, parameter.low), parameter.high)}
            if _is_play(setting):
                changed["height"] = math.copysign(changed["length"], setting.parameters["height"])
            settings[u.setting] = replace(setting, parameters={**setting.parameters, **changed})
        return replace(self, settings=tuple(settings), deviations=tuple(deviations))


def state_of(machine: Machine, corrected: Machine, axes: Sequence[str], thresholds: Any) -> State:
    """The corrected machine as a state with fitted parameters on these axes; `machine` is the nominal machine without effects."""
    nuisances = nuisances_of(machine, axes, thresholds) if machine.parameter_tolerance > 0.0 else ()
    return State(machine, _differences(machine.document, corrected.document), settings_of(corrected), nuisances, (0.0,) * len(nuisances))


def _differences(before: Mapping[str, Any], after: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values of `after` by path that differ from `before`, without effects."""
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


def unknowns_of(state: State, axes: Sequence[str], tolerance: float, thresholds: Thresholds = DEFAULT) -> list[Unknown]:
    """Parameters of effects and laws on these axes, then their toleranced parameters.

    Normal imperfections keep their fitted values. The spring of an axis with a law between its encoders is fitted again with its damping,
    because the search sized both without that law.
    """
    found = []
    between_encoders = {s.axis for s in state.settings if s.effect.name == NAME and is_between_encoders(s)}
    for i, setting in enumerate(state.settings):
        beside = setting.axis in between_encoders and setting.effect.name == SPRING_EFFECT
        if setting.axis not in axes or (setting.effect.normal and not beside):
            continue
        for p in setting.effect.parameters:
            value = setting.parameters.get(p.name)
            if value is None or not math.isfinite(value):
                continue
            if p.shape and not p.periodic and not (beside and p.fitted):
                continue
            if value == 0.0 and not p.periodic:  # unused by the shape
                continue
            if _is_play(setting) and p.name != "length":  # both are half the width of the play
                continue
            positive = value > 0.0 and (p.logarithmic or p.low >= 0.0)
            relative = relative_step(p, value, state.machine.axis(setting.axis), RELATIVE_STEP, thresholds)
            step = ANGLE_STEP if p.periodic else relative * (1.0 if positive else abs(value))
            found.append(Unknown(i, p.name, step, positive and not p.periodic))
    for nuisance in state.nuisances:
        found.append(Unknown(None, nuisance.quantity, tolerance * float(UNIFORM), False, nuisance))
    return found


def _identity(unknown: Unknown, state: State) -> Name:
    """Identity of an unknown, independent of its index in the state."""
    if unknown.nuisance is not None:
        return unknown.nuisance
    assert unknown.setting is not None
    return state.settings[unknown.setting].key, unknown.name


def _is_proportional(unknown: Unknown, state: State) -> bool:
    """Whether the response is proportional to an unknown. Its step is then unlimited and may change the sign."""
    if unknown.setting is None:
        return True
    effect = state.settings[unknown.setting].effect
    return not unknown.logarithmic and effect.is_linear and effect.size.name == unknown.name


def is_between_encoders(law: Setting) -> bool:
    """Whether a law changes motor minus scale: by a displacement, or by a force over the windup."""
    return law.effect.definition.get("output") == "displacement" or law.effect.definition.get("variables") == ["windup"]


def _is_play(law: Setting) -> bool:
    """Whether a law is a play: a displacement that follows the load up to `height` within a travel of `length`, which are equal."""
    return law.effect.definition.get("variables") == ["slack"] and "height" in law.parameters


@dataclass(frozen=True)
class Fitted:
    """A state fitted to axes of a group, with its cross-validated loss and the fit without each fold."""

    state: State
    unknowns: list[Unknown]
    left: np.ndarray  # (row,) weighted
    columns: np.ndarray = field(repr=False)  # (row, unknown)
    loss: float
    held_out: float  # half the sum of squares on runs left out; of a halved fold, on the half left out
    moves: tuple[np.ndarray, ...]  # of the fit without each fold, in steps; zero for a halved fold
    deviations: np.ndarray  # (unknown,) standard deviations in steps

    @property
    def slopes(self) -> dict[Name, np.ndarray]:
        """Slopes (row,) by identity of the unknown, per unit instead of per step."""
        return {_identity(u, self.state): self.columns[:, i] / u.step for i, u in enumerate(self.unknowns)}

    def without(self, fold: int) -> State:
        """The state fitted to the other folds."""
        return self.state.moved(self.unknowns, self.moves[fold])


class ClosedLoop:
    """The gap of some axes of a group as a function of a state, with the folds of the cross-validation.

    `shaken`: all simulations have the same noise in the loop. An axis that slips before break-away needs it, and so does a state without the slip
    that is compared with one that has it.
    """

    def __init__(self, group: Group, axes: Sequence[str], folds: Sequence[Sequence[int]], mapper: Mapper, shaken: bool = False) -> None:
        self.group, self.axes, self.mapper, self.shaken = group, tuple(axes), mapper, shaken
        self.rows = np.concatenate([np.arange(c.rows.start, c.rows.stop) for c in self._channels()])
        self.credit = group.credit_after_rests(SHORTEST_REST_S)[self.rows]
        self.root = np.sqrt(self.credit)
        self.expected = 0.5 * float(group.expected[self.rows] @ self.credit)
        of_fold = [np.any([group.run_rows(r)[self.rows] for r in fold], axis=0) for fold in folds]
        self.parts = list(enumerate(of_fold))  # folds and their rows (row,) that are predicted from all other rows
        self.halved: int | None = None
        if len(folds) == 1:
            self._halve(0, np.ones(len(self.rows)))
        zeros = zeros_of(group)[self.rows] * self.root[:, None]
        self.zeros = np.linalg.qr(zeros[:, np.any(zeros != 0.0, axis=0)])[0]  # orthonormal

    @property
    def only_fold(self) -> int | None:
        """The fold that was halved because no other one shows the gap; None for a single fold, which is always halved."""
        return self.halved if len({fold for fold, _ in self.parts}) > 1 else None

    def halving_its_only_loud_fold(self, left: np.ndarray) -> ClosedLoop:
        """A closed loop that halves the fold with almost all of the loss above noise; this one if there is none. `left` (row,): residual.

        The other runs do not show a law that acts in one run only. There, each half of that run is predicted from everything else.
        """
        noise = self.group.expected[self.rows] * self.credit
        above = [float(np.sum(left[rows] ** 2 - noise[rows])) for _, rows in self.parts]
        loudest = int(np.argmax(above))
        if self.halved is not None or above[loudest] < ONE_RUN * sum(max(a, 0.0) for a in above):
            return self
        halving = copy.copy(self)
        halving._halve(loudest, left)
        return halving

    def _halve(self, fold: int, left: np.ndarray) -> None:
        """Divide a fold in time so that the halves of each channel share the loss of a residual `left` (row,)."""
        rows = self.parts[fold][1]
        first = np.zeros(len(self.rows), bool)
        at = 0
        for channel in self._channels():
            own = slice(at, at + len(channel.residual))
            at = own.stop
            loss = np.cumsum(np.where(rows[own], left[own] ** 2, 0.0))
            first[own] = loss <= 0.5 * loss[-1]
        self.parts = [*self.parts[:fold], (fold, rows & first), (fold, rows & ~first), *self.parts[fold + 1 :]]
        self.halved = fold

    def _channels(self) -> list[Channel]:
        return [c for c in self.group.channels if c.axis in self.axes]

    def inflation(self, loss: float) -> float:
        """Loss over the expected loss of noise, at least 1."""
        return max(1.0, loss / max(self.expected, 1e-300))

    def left(self, state: State) -> np.ndarray:
        """Weighted residual (row,) of a state on the measured runs, without the encoder zeros of each run."""
        return all_or_raise(self.residuals_of_each([state]))[0]

    def residuals_of_each(self, states: Sequence[State]) -> list[np.ndarray | TwinError]:
        """Residuals of several states, or the error of a state that cannot be simulated."""
        variations = [Variation(state.machine_of, axes=self.axes) for state in states]
        out: list[np.ndarray | TwinError] = []
        for change in self.group.responses(variations, shaken=self.shaken, mapper=self.mapper):
            if isinstance(change, TwinError):
                out.append(change)
                continue
            rest: np.ndarray = (self.group.residual - change)[self.rows] * self.root
            out.append(rest - self.zeros @ (self.zeros.T @ rest))
        return out

    def fit(self, state: State, tolerance: float, steps: int = STEPS, like: Fitted | None = None) -> Fitted | None:
        """Gauss-Newton fit from a state; None if the state cannot be simulated.

        The fit `like` provides initial slopes. They are computed again only if a step decreases the loss less than predicted. Slopes of
        toleranced parameters are kept, because the response to them is linear.
        """
        unknowns = unknowns_of(state, self.axes, tolerance, self.group.thresholds)
        toleranced = np.array([u.nuisance is not None for u in unknowns], bool)
        try:
            left = self.left(state)
        except TwinError:
            return None
        known = like.slopes if like else {}
        names = [_identity(u, state) for u in unknowns]
        columns = np.zeros((len(self.rows), len(unknowns)), order="F")
        for i, name in enumerate(names):
            columns[:, i] = known[name] * unknowns[i].step if name in known else 0.0
        asked = [i for i, name in enumerate(names) if name not in known]
        bent = set(np.flatnonzero(~toleranced).tolist())
        taken_here: set[int] = set()  # unknowns whose slopes were computed at this state
        # deviation of the toleranced parameters from the machine file, in steps
        offset = np.array(
            [state.deviations[state.nuisances.index(u.nuisance)] / u.step if u.nuisance is not None else 0.0 for u in unknowns]
        )
        loss = 0.5 * float(left @ left)
        for _ in range(steps):
            columns[:, asked] = self._slopes(state, unknowns, asked, left)
            taken_here |= set(asked)
            asked = sorted(bent - taken_here)
            prior = self._prior(toleranced, loss)
            better = self._improving_step(state, unknowns, columns, left, prior, offset)
            if better is None and asked:
                continue  # no improvement with slopes from another state: compute them here
            if better is None:
                break
            state, after, move = better
            offset = offset + np.where(toleranced, move, 0.0)
            promised, gained = loss - 0.5 * float(np.sum(np.square(left - columns @ move))), loss - 0.5 * float(after @ after)
            holds = gained > self.group.thresholds.slopes_hold * promised
            left, loss = after, loss - gained
            if gained < CONVERGED * loss and (holds or not asked):
                break
            taken_here, asked = set(), [] if holds else sorted(bent)
        return self._cross_validated(state, unknowns, left, columns, loss, self._prior(toleranced, loss), offset)

    def _prior(self, toleranced: np.ndarray, loss: float) -> np.ndarray:
        """Weights (unknown,) of the squared deviation of each toleranced parameter, in steps, at a loss."""
        return np.where(toleranced, PRIOR_WEIGHT_ROWS * self.inflation(loss), 1e-6)

    def _slopes(self, state: State, unknowns: Sequence[Unknown], asked: Sequence[int], left: np.ndarray) -> np.ndarray:
        """Slopes (row, asked) of some unknowns by a forward step, or a backward step if the forward step has no effect or fails."""
        slopes = np.zeros((len(left), len(asked)))
        missing = list(range(len(asked)))
        for side in (1.0, -1.0):
            moved = [state.moved(unknowns, side * np.eye(len(unknowns))[asked[j]]) for j in missing]
            for j, rest in zip(missing, self.residuals_of_each(moved) if moved else []):
                if not isinstance(rest, TwinError):
                    slopes[:, j] = (left - rest) * side
            missing = [j for j in missing if not slopes[:, j].any()]
        return slopes

    def _improving_step(  # type: ignore[no-untyped-def]
        self, state: State, unknowns: Sequence[Unknown], columns: np.ndarray, left: np.ndarray, prior: np.ndarray, offset: np.ndarray
    ):
        """State, residual and move of one Levenberg-Marquardt step that decreases the loss, or None."""
        before = 0.5 * float(left @ left) + 0.5 * float(prior @ offset**2)
        normal, slope = columns.T @ columns, columns.T @ left - prior * offset
        limits = np.array([math.inf if _is_proportional(u, state) else LARGEST_MOVE / RELATIVE_STEP for u in unknowns])
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

    def _cross_validated(self, state, unknowns, left, columns, loss, prior, offset) -> Fitted:  # type: ignore[no-untyped-def]
        normal = columns.T @ columns + np.diag(prior)
        slope = columns.T @ left - prior * offset
        moves, held_out = {}, 0.0
        for fold, rows in self.parts:
            own = columns[rows]
            move = np.linalg.solve(normal - own.T @ own + 1e-9 * np.eye(len(normal)), slope - own.T @ left[rows])
            moves[fold] = np.zeros(len(normal)) if fold == self.halved else move
            held_out += 0.5 * float(np.sum((left[rows] - own @ move) ** 2))
        deviations = np.sqrt(np.diag(np.linalg.pinv(normal)) * self.inflation(loss))
        return Fitted(state, list(unknowns), left, columns, loss, held_out, tuple(moves.values()), deviations)


def with_law(state: State, setting: Setting) -> State:
    """The state with an additional law."""
    return replace(state, settings=(*state.settings, setting))


def laws_in(state: State) -> tuple[Setting, ...]:
    """The laws of a state."""
    return tuple(s for s in state.settings if s.effect.name == NAME)


Say = Callable[[str], None]
