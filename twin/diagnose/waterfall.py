"""The gap step by step: machine file, re-tuned within tolerance and with its normal imperfections, with each effect, with the unlisted laws.

The levels of the machine file and of the corrected machine, without and with unlisted laws, are measured on held-out runs. The levels in
between are interpolated by the fit. With E the mean square residual over noise of an axis in the fit, step k of the axis has

    level_k^2 = after^2 + (E_k - E_end) / (E_0 - E_end) (before^2 - after^2)

and the gap is the root mean square over the axes. E_0 is that of the machine file, which has no normal imperfections. The last step of
each axis has its measured level.
"""

from collections.abc import Collection, Mapping, Sequence
import math

from twin.diagnose.cross_validation import retuned_within
from twin.diagnose.state import GroupState, squares_by_axis
from twin.diagnose.wording import effect_title
from twin.effects.setting import Key
from twin.simulation.gap_level import overall

Ends = Mapping[str, tuple[float, float]]
"""Axis -> squared level before and after correction."""


def waterfall(states: Sequence[GroupState], ends: Ends, kept: Collection[Key], with_laws: Mapping[str, float]) -> list[tuple[str, float]]:
    """Gap in multiples of noise: before, re-tuned, after each effect, with unlisted laws. The last level is the gap that remains.

    `states` holds the final state of each group of axes, `kept` the effects that no law replaced. `ends` are without laws; `with_laws` holds the
    squared level that remains on axes with laws.
    """
    effects = {state.group.axes: _accepted(state, kept) for state in states}
    current = {axis: before for axis, (before, _) in ends.items()}
    steps: list[tuple[str, float]] = []

    def step(label: str, now: Mapping[str, float]) -> None:
        current.update(now)
        if steps and steps[-1][0] == label:
            steps.pop()
        steps.append((label, overall({axis: math.sqrt(square) for axis, square in current.items()})))

    step("machine file", {})
    for state in states:
        left = retuned_within(state).residual(state.group)
        now = _levels_after(state, squares_by_axis(state.group, left), ends)
        # without a later step of its own, an axis ends here
        ended = {axis: ends[axis][1] for axis in now if not effects[state.group.axes] and axis not in with_laws}
        step("re-tuned within tolerance", now | ended)
    # groups of axes are independent: the one whose effects close most comes first
    for state in sorted(states, key=lambda f: sum(ends[a][1] - ends[a][0] for a in f.group.axes if a in ends)):
        for label, squares in effects[state.group.axes]:
            step(label, _levels_after(state, squares, ends))
    for axis, square in with_laws.items():
        step(f"unlisted law {axis}", {axis: square})
    return steps


def retuning_share(steps: Sequence[tuple[str, float]]) -> float:
    """Share of the squared gap above noise that re-tuning closes, from the steps of a waterfall."""
    levels = [level**2 for _, level in steps]
    return min(max((levels[0] - levels[1]) / (levels[0] - 1.0), 0.0), 1.0) if len(levels) > 1 and levels[0] > 1.0 else 0.0


def _levels_after(state: GroupState, now: Mapping[str, float], ends: Ends) -> dict[str, float]:
    """Squared level of each axis of a group after a step that leaves the mean squares `now`, interpolated between the measured ends."""
    first = squares_by_axis(state.rigid, state.rigid.residual)
    last = squares_by_axis(state.group, state.fit.residual(state.group))
    out = {}
    for axis, (before, after) in ends.items():
        if axis in now:
            drop = first[axis] - last[axis]
            share = (now[axis] - last[axis]) / drop if drop > 0.0 else 0.0
            out[axis] = max(after + share * (before - after), 0.0)
    return out


def _accepted(state: GroupState, kept: Collection[Key]) -> list[tuple[str, dict[str, float]]]:
    """What the rounds that accepted effects leave on each axis; the last one leaves what the final fit leaves."""
    steps: list[tuple[str, dict[str, float]]] = []
    seen: set[Key] = set()
    for settings, squares in state.accepted:
        new = [s for s in settings if s.key in kept and s.key in state.keys - seen]
        seen |= {s.key for s in settings}
        if not new:
            continue
        title = effect_title({"effect": new[0].effect.name, "axis": new[0].axis, "from_axis": new[0].from_axis})
        steps.append((title if len(new) == 1 else f"{title} and {len(new) - 1} more", squares))
    return [*steps[:-1], (steps[-1][0], squares_by_axis(state.group, state.fit.residual(state.group)))] if steps else []
