"""Effects of usual size that these runs and signals would not show. The verdict "none" does not exclude them.

    s = 1/2 sum of credit (a - J theta)^2        a: response to the effect, over noise; J theta: its projection on re-tuning

is the largest gain that a fit could reach. s grows with the square of the size, so the effect would have the evidence it needs from
sqrt(needed / s) times its usual size. The sum over one run, with theta chosen for this run alone, is no larger: an effect that one run shows
is not simulated in the others.
"""

from collections.abc import Sequence
from dataclasses import replace
import itertools
import math

import numpy as np

from twin.diagnose.columns import Column, Columns
from twin.diagnose.cross_validation import evidence_needed
from twin.diagnose.fit import simulated_responses
from twin.diagnose.settings import T
from twin.diagnose.starts import Start, middle_starts
from twin.diagnose.state import GroupState
from twin.diagnose.tuning import FREE, tuning_from
from twin.effects import Setting
from twin.effects.setting import Key
from twin.errors import TwinError
from twin.machine.machine import Machine


def effects_not_visible(state: GroupState, starts: Sequence[Start], folds: int) -> dict[Key, float]:
    """Effects that are not visible at their usual size, with the smallest multiple of it that is visible (inf: none).

    The middle start of each effect is used, and the worse of two phases.
    """
    usual = {key: _usual(start, state.group.machine) for key, start in middle_starts(starts).items()}
    new = [settings for settings in usual.values() if not all(map(state.remembers, settings))]
    visible = {key for key, share in shares_in_one_run(state, new, folds).items() if share >= 1.0}
    usual = {key: settings for key, settings in usual.items() if key not in visible}
    answered = iter(state.cached_responses([s for settings in usual.values() for s in settings]))
    columns = [(settings, [next(answered) for _ in settings]) for settings in usual.values()]
    shares = state.group.mapper(lambda item: share_in_all_runs(state, item[0], item[1], folds), columns)
    return {key: math.inf if share < T.collinear else share**-0.5 for key, share in zip(usual, shares) if share < 1.0}


def shares_in_one_run(state: GroupState, asked: Sequence[tuple[Setting, ...]], folds: int) -> dict[Key, float]:
    """Possible over needed evidence of each of the asked settings in the run that moves its axis fastest; none if no run shows its axis."""
    shares: dict[Key, float] = {}
    for axis in dict.fromkeys(settings[0].axis for settings in asked):
        own = [settings for settings in asked if settings[0].axis == axis]
        views = {c.run: state.group.views[c.run] for c in state.group.channels if c.axis == axis}
        if not views:
            continue
        fastest = max(views, key=lambda run: float(np.std(np.gradient(views[run].reference(axis)[1]))))
        group, rows = state.group.part(state.group.axes, {fastest})
        about, seen = state.tuning, np.sqrt(state.group.credit[rows])
        free = np.full(len(about.further), FREE)
        tuning = tuning_from(about.nuisances, about.jacobian.at(rows).scaled(seen), about.spread, FREE, free)
        answers = simulated_responses(group, [[s] for settings in own for s in settings])
        # what cannot be simulated shows nothing
        losses = iter([tuning.loss(seen * answer) if isinstance(answer, np.ndarray) else 0.0 for answer in answers])
        for settings in own:
            shares[settings[0].key] = min(itertools.islice(losses, len(settings))) / evidence_needed(state, settings[0], folds)
    return shares


def _usual(start: Start, machine: Machine) -> tuple[Setting, ...]:
    """Settings of usual size. The start of a size that is read from the record, such as a current limit, may be far from it."""
    first, size = start.settings[0], start.effect.size
    if not size.scan:
        return start.settings
    low, high = size.usual_range(machine, machine.axis(start.axis))
    return (replace(first, parameters={**first.parameters, size.name: math.sqrt(low * high)}),)


def share_in_all_runs(state: GroupState, settings: Sequence[Setting], answers: Sequence[Column | TwinError], folds: int) -> float:
    """Possible evidence over needed evidence; infinite if the effect cannot be simulated, because no machine runs with it."""
    tuning = state.tuning
    columns = Columns([column for column in answers if isinstance(column, Column)], state.group.size)
    if len(columns) < len(answers):
        return math.inf
    residual = [column - tuning.jacobian.times(tuning.solve(column)) for column in map(columns.whole, range(len(columns)))]
    return min(0.5 * float(state.group.credit @ np.square(rows)) for rows in residual) / evidence_needed(state, settings[0], folds)
