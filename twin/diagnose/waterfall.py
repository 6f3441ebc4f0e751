"""The gap step by step: machine file, re-tuned within tolerance and with its normal imperfections, with each effect, with the unlisted laws.

The levels of the machine file and of the corrected machine, without and with unlisted laws, are measured on held-out runs. The levels in
between are interpolated by the fit. With E the mean square residual over noise of an axis in the fit, step k of the axis has

    level_k^2 = after^2 + (E_k - E_end) / (E_0 - E_end) (before^2 - after^2)

and the gap is the root mean square over the axes. E_0 is that of the machine file, which has no normal imperfections. The last step of
each axis has its measured level.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
import math

import numpy as np

from twin.diagnose.cross_validation import retuned_within
from twin.diagnose.fit import Fit
from twin.diagnose.observe import Group
from twin.diagnose.state import GroupState, Key
from twin.diagnose.wording import effect_title
from twin.simulation.gap_level import overall

Ends = Mapping[str, tuple[float, float]]
"""Axis -> squared level before and after correction."""


def waterfall(
    states: Sequence[GroupState], ends: Ends, tolerance: float, kept: Collection[Key], with_laws: Mapping[str, float] | None = None
) -> list[tuple[str, float]]:
    """Gap in multiples of noise: before, re-tuned, after each effect, with unlisted laws. The last level is the gap that remains.

    `states` holds the final state of each group of axes, `tolerance` that of the machine's parameters (a fraction), `kept` the effects that no
    law replaced. `ends` are without laws; `with_laws` holds the squared level that remains on axes with laws.
    """
    with_laws = with_laws or {}
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
        now = _levels_after(state, retuned_within(state, tolerance), ends)
        # without a later step of its own, an axis ends here
        ended = {axis: ends[axis][1] for axis in now if not effects[state.group.axes] and axis not in with_laws}
        step("re-tuned within tolerance", now | ended)
    # groups of axes are independent: the one whose effects close most comes first
    for state in sorted(states, key=lambda f: sum(ends[a][1] - ends[a][0] for a in f.group.axes if a in ends)):
        for label, fit in effects[state.group.axes]:
            step(label, _levels_after(state, fit, ends))
    for axis, square in with_laws.items():
        step(f"unlisted law {axis}", {axis: square})
    return steps


def retuning_share(steps: Sequence[tuple[str, float]]) -> float:
    """Share of the squared gap above noise that re-tuning closes, from the steps of a waterfall."""
    levels = [level**2 for _, level in steps]
    return min(max((levels[0] - levels[1]) / (levels[0] - 1.0), 0.0), 1.0) if len(levels) > 1 and levels[0] > 1.0 else 0.0


def _levels_after(state: GroupState, fit: Fit, ends: Ends) -> dict[str, float]:
    """Squared level of each axis of a group after a step, interpolated between the measured ends."""
    first = _squares_by_axis(state.rigid, state.rigid.residual)
    now, last = (_squares_by_axis(state.group, _left_by(state, f)) for f in (fit, state.fit))
    out = {}
    for axis, (before, after) in ends.items():
        if axis in now:
            drop = first[axis] - last[axis]
            share = (now[axis] - last[axis]) / drop if drop > 0.0 else 0.0
            out[axis] = max(after + share * (before - after), 0.0)
    return out


def _accepted(state: GroupState, kept: Collection[Key]) -> list[tuple[str, Fit]]:
    """The fits of the rounds that accepted effects; the last one is the final fit."""
    steps: list[tuple[str, Fit]] = []
    seen: set[Key] = set()
    for fit in state.accepted:
        new = [s for s in fit.settings if s.key in kept and s.key in state.keys - seen]
        seen |= {s.key for s in fit.settings}
        if not new:
            continue
        title = effect_title({"effect": new[0].effect.name, "axis": new[0].axis, "from_axis": new[0].from_axis})
        steps.append((title if len(new) == 1 else f"{title} and {len(new) - 1} more", fit))
    return [*steps[:-1], (steps[-1][0], state.fit)] if steps else []


def _left_by(state: GroupState, fit: Fit) -> np.ndarray:
    """Residual (row,) that a fit leaves, weighted."""
    residual: np.ndarray = state.group.residual - fit.response
    # a later round may have other normal imperfections, so that the coefficients belong to other nuisances
    same_nuisances = len(fit.tuning) == state.tuning.jacobian.shape[1]
    return residual - (fit.retuning if same_nuisances else state.tuning.jacobian @ state.tuning.solve(residual))


def _squares_by_axis(group: Group, residual: np.ndarray) -> dict[str, float]:
    """Mean square over noise of a residual (row,), weighted, of each axis over runs and measured signals."""
    squares: dict[str, list[float]] = {}
    for channel in group.channels:
        if channel.name != "controller":  # motor_minus_scale represents the motor encoder
            normed = residual[channel.rows] / channel.weight / channel.sigma
            squares.setdefault(channel.axis, []).append(float(np.mean(normed**2)))
    return {axis: float(np.mean(values)) for axis, values in squares.items()}
