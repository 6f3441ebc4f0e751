"""What the report shows, taken from a diagnosis: steps of the waterfall, the telling stretch, tables.

The waterfall begins and ends with the measured gap of runs left out (`gap.before`, `gap.after`); between them the fit says
how much each step closes on each axis. With E the mean square of an axis' residual over noise in the fit, step k is told as

    level_k^2 = mean over axes of  after^2 + (E_k - E_end) / (E_0 - E_end) (before^2 - after^2)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.diagnose.blocks import MOTION
from twin.diagnose.corrected import within
from twin.diagnose.cross_validation import retuned_within
from twin.diagnose.fit import Fit
from twin.diagnose.state import Found
from twin.diagnose.tolerance import NORMAL
from twin.diagnose.where import STRETCH_S
from twin.diagnose.wording import effect_title
from twin.simulation.gap import COMPARED

if TYPE_CHECKING:
    from twin.diagnose.diagnosis import Diagnosis

BLOCKS_NEED = {
    "position controller": (("position", "motor_position"), ("velocity_setpoint",)),
    "speed controller": (("velocity",), ("velocity_setpoint",), ("current",)),
    "current loop": (MOTION, ("current",)),
    "mechanics": (MOTION, ("current",)),
    "transmission": (("position",), ("motor_position",)),
    "measurement": (("position",), ("motor_position",)),
}
"""Blocks in the order of the loop, and the recorded signals, one of each, without which a block cannot be seen."""

CONTROLLERS = ("position controller", "speed controller")

MARGIN = 0.15
"""Part of a stretch that is shown before and after it."""


@dataclass(frozen=True)
class Stretch:
    """A place to look at: axis, run, from and to [s], block ('' where none was named)."""

    axis: str
    run: str
    start: float
    stop: float
    block: str


def waterfall(diagnosis: Diagnosis) -> list[tuple[str, float]]:
    """Levels of the gap in multiples of noise: before, re-tuned, after each effect; the last is the gap that is left."""
    ends = {axis: (diagnosis.axis_level("before", axis) ** 2, diagnosis.axis_level("after", axis) ** 2) for axis in diagnosis.axes}
    current = {axis: before for axis, (before, _) in ends.items()}
    steps: list[tuple[str, float]] = []

    def step(label: str, found: Found | None = None, fit: Fit | None = None) -> None:
        if found is not None:
            current.update(_told_squares(found, fit, ends))
        square = float(np.mean(list(current.values()))) if current else 1.0
        if steps and steps[-1][0] == label:
            steps.pop()
        steps.append((label, float(np.sqrt(square))))

    step("as the machine file says")
    for found in diagnosis.found:
        step("re-tuned within tolerance", found, retuned_within(found, diagnosis.machine.parameter_tolerance))
    # groups of axes do not touch each other: the one whose effects close most comes first
    for found in sorted(diagnosis.found, key=lambda f: sum(ends[a][1] - ends[a][0] for a in f.group.axes if a in ends)):
        for label, fit in _accepted(found):
            step(label, found, fit)
    return steps


def retuning_share(steps: Sequence[tuple[str, float]]) -> float:
    """Share of the squared gap above noise that re-tuning closes, of the steps of a waterfall."""
    levels = [level**2 for _, level in steps]
    return min(max((levels[0] - levels[1]) / (levels[0] - 1.0), 0.0), 1.0) if len(levels) > 1 and levels[0] > 1.0 else 0.0


def _told_squares(found: Found, fit: Fit | None, ends: dict[str, tuple[float, float]]) -> dict[str, float]:
    """Squared level of each axis of a group after a step: the fit's share between the measured ends."""
    first, now, last = (_axis_squares(found, f) for f in (None, fit, found.fit))
    out = {}
    for axis, (before, after) in ends.items():
        if axis in now:
            drop = first[axis] - last[axis]
            share = (now[axis] - last[axis]) / drop if drop > 0.0 else 0.0
            out[axis] = max(after + share * (before - after), 0.0)
    return out


def _accepted(found: Found) -> list[tuple[str, Fit]]:
    """The fits by which effects came in, one after another; the last is the final one."""
    steps: list[tuple[str, Fit]] = []
    for fit in found.accepted:
        last = fit.settings[-1]
        if last.key in found.keys:
            steps.append((effect_title({"effect": last.effect.name, "axis": last.axis, "from_axis": last.from_axis}), fit))
    return [*steps[:-1], (steps[-1][0], found.fit)] if steps else []


def _axis_squares(found: Found, fit: Fit | None) -> dict[str, float]:
    """Mean square of residual over noise of each axis over its runs and measured signals, `fit` None: the nominal machine."""
    left = found.group.residual.copy()
    if fit is not None:
        left -= fit.response
        # a later round may have found another normal imperfection: then what was re-tuned belongs to other nuisances
        known = len(fit.tuning) == len(found.tuning.nuisances)
        left -= fit.retuning if known else found.tuning.jacobian @ found.tuning.solve(left)
    squares: dict[str, list[float]] = {}
    for channel in found.group.channels:
        if channel.name != "controller":  # windup stands for the motor encoder
            normed = left[channel.rows] / channel.weight / channel.sigma
            squares.setdefault(channel.axis, []).append(float(np.mean(normed**2)))
    return {axis: float(np.mean(values)) for axis, values in squares.items()}


def blocks_map(diagnosis: Diagnosis, document: dict[str, Any]) -> tuple[list[str], list[list[tuple[str, float, float]]]]:
    """Axes that moved, and per axis and block (state, share, level): state 'place', 'healthy' or 'unseen'."""
    placed = {(p["axis"], p["block"]): p for p in document["where"]}
    axes = [a for a in diagnosis.machine.axis_names if any(run.trace.moves(a) for run in diagnosis.campaign.runs)]
    rows = []
    for axis in axes:
        row = []
        for block in BLOCKS_NEED:
            place = placed.get((axis, block))
            if place:
                row.append(("place", float(place["share"]), float(place.get("level", 0.0))))
            else:
                row.append(("healthy" if _is_seen(diagnosis, axis, block) else "unseen", 0.0, 0.0))
        rows.append(row)
    return axes, rows


def _is_seen(diagnosis: Diagnosis, axis: str, block: str) -> bool:
    """Was the law of a block held against what was recorded?

    That of the position controller, or of two P controllers together, has a channel. The command of an axis without current loop stands
    for its current.
    """
    own = diagnosis.machine.axis(axis)
    law = any((c.axis, c.name) == (axis, "controller") for f in diagnosis.found for c in f.group.channels)
    if block == "position controller" or (block in CONTROLLERS and law and not own.has_speed_integral):
        return law
    return any(
        view.moves(axis)
        and (block != "speed controller" or view.on_each_cycle)
        and all(any(view.trace.has(axis, own.effort if s == "current" else s) for s in one_of) for one_of in BLOCKS_NEED[block])
        for view in next((f.group.views for f in diagnosis.found if axis in f.group.axes), ())
    )


def stretches(diagnosis: Diagnosis, document: dict[str, Any]) -> list[Stretch]:
    """Telling stretches, the most telling first: one per place and effect; without any, the largest gap of the campaign."""
    found: list[Stretch] = []
    effects = {(e["effect"], e["axis"]) for e in document["effects"]}
    for place in document["where"]:
        if found and (place.get("effect"), place["axis"]) not in effects:
            continue
        if "stretch" in place:
            s = place["stretch"]
            found.append(Stretch(place["axis"], s["run"], s["from_s"], s["to_s"], place["block"]))
        else:
            found += _largest(diagnosis, [place["axis"]], place["block"])
    return found or _largest(diagnosis, diagnosis.machine.axis_names)


def _largest(diagnosis: Diagnosis, axes: Sequence[str], block: str = "") -> list[Stretch]:
    """The half second in which the position of one of the axes differs most from the nominal twin."""
    best: tuple[float, Stretch] | None = None
    for run in diagnosis.campaign.runs:
        prediction = diagnosis.predictions["before"][run.name].trace
        for axis in axes:
            if not run.trace.moves(axis):
                continue
            signal = next((s for s in COMPARED if run.trace.has(axis, s)), None)
            gap = diagnosis.gaps["before"][run.name][axis].get(signal or "")
            if signal is None or gap is None or gap.noise <= 0.0:
                continue
            square = (run.trace.get(axis, signal) - prediction.get(axis, signal)) ** 2
            width = min(len(square), max(2, round(STRETCH_S / run.trace.period)))
            energy = np.convolve(square, np.ones(width), mode="valid")
            at = int(np.argmax(energy))
            level = gap.rms / gap.noise
            if best is None or level > best[0]:
                best = level, Stretch(axis, run.name, float(run.trace.time[at]), float(run.trace.time[at + width - 1]), block)
    return [best[1]] if best else []


def run_levels(diagnosis: Diagnosis) -> tuple[list[str], list[tuple[str, list[tuple[float, float] | None]]]]:
    """Axes, and per run the gap over noise of each axis before and after; None where the axis did not move."""
    axes = [a for a in diagnosis.machine.axis_names if any(run.trace.moves(a) for run in diagnosis.campaign.runs)]
    rows = []
    for run in diagnosis.campaign.runs:
        cells: list[tuple[float, float] | None] = []
        for axis in axes:
            levels = [_level(diagnosis.gaps[which][run.name].get(axis, {})) for which in ("before", "after")]
            cells.append((levels[0], levels[1]) if run.trace.moves(axis) and all(levels) else None)
        rows.append((run.name, cells))
    return axes, rows


def _level(signals: dict[str, Any]) -> float:
    values = [(g.rms / g.noise) ** 2 for g in signals.values() if g.noise > 0 and g.rms > 0]
    return float(np.sqrt(np.mean(values))) if values else 0.0


def retuned_values(diagnosis: Diagnosis) -> list[tuple[str, str, float]]:
    """Re-tuned parameters: owner (axis or body), quantity, deviation from the machine file as a fraction."""
    return [
        (nuisance.owner, "mass and inertia" if nuisance.quantity == "body" else nuisance.quantity.replace("_", " "), float(deviation))
        for found in diagnosis.found
        for nuisance, deviation in zip(found.tuning.nuisances, within(found, diagnosis.machine.parameter_tolerance))
        if nuisance.quantity not in NORMAL
    ]
