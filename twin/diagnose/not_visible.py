"""Effects of usual size that these runs and signals would not show. The verdict "none" does not exclude them.

    s = 1/2 sum of credit (a - J theta)^2        a: response to the effect, over noise; J theta: its projection on re-tuning

is the largest gain that a fit could reach. s grows with the square of the size, so the effect would have the evidence it needs from
sqrt(needed / s) times its usual size.
"""

from collections.abc import Sequence
from dataclasses import replace
import math

import numpy as np

from twin.diagnose.candidates import Start, middle_starts
from twin.diagnose.columns import Column, Columns
from twin.diagnose.cross_validation import evidence_needed
from twin.diagnose.settings import T
from twin.diagnose.state import GroupState
from twin.effects import Setting
from twin.errors import TwinError
from twin.machine.machine import Machine


def effects_not_visible(state: GroupState, starts: Sequence[Start], folds: int) -> dict[tuple[str, str, str | None], float]:
    """Effects that are not visible at their usual size, with the smallest multiple of it that is visible (inf: none).

    The middle start of each effect is used, and the worse of two phases.
    """
    by_key = middle_starts(starts)
    middle = [_usual(start, state.group.machine) for start in by_key.values()]
    answered = iter(state.cached_responses([s for settings in middle for s in settings]))
    columns = [(settings, [next(answered) for _ in settings]) for settings in middle]
    shares = state.group.mapper(lambda item: _share(state, item[0], item[1], folds), columns)
    return {key: math.inf if share < T.collinear else share**-0.5 for key, share in zip(by_key, shares) if share < 1.0}


def _usual(start: Start, machine: Machine) -> tuple[Setting, ...]:
    """Settings of usual size. The start of a size that is read from the record, such as a current limit, may be far from it."""
    first, size = start.settings[0], start.effect.size
    if not size.scan:
        return start.settings
    low, high = size.usual_range(machine, machine.axis(start.axis))
    return (replace(first, parameters={**first.parameters, size.name: math.sqrt(low * high)}),)


def _share(state: GroupState, settings: Sequence[Setting], answers: Sequence[Column | TwinError], folds: int) -> float:
    """Possible evidence over needed evidence; infinite if the effect cannot be simulated, because no machine runs with it."""
    tuning = state.tuning
    columns = Columns([column for column in answers if isinstance(column, Column)], state.group.size)
    if len(columns) < len(answers):
        return math.inf
    residual = [column - tuning.jacobian.times(tuning.solve(column)) for column in map(columns.whole, range(len(columns)))]
    return min(0.5 * float(state.group.credit @ np.square(rows)) for rows in residual) / evidence_needed(state, settings[0], folds)
