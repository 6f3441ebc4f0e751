"""Contents of the report beside the document: the intervals to show, the map of blocks, levels by run, re-tuned values."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.diagnose.corrected import limited_deviations
from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.force_balance import MOTION
from twin.diagnose.settings import T
from twin.simulation.gap import COMPARED
from twin.simulation.gap_level import levels
from twin.units import in_words

BLOCKS_NEED = {
    "position controller": (),  # seen through its channel, see `_is_seen`
    "speed controller": (("velocity",), ("velocity_setpoint",), ("current",)),
    "current loop": (MOTION, ("current",)),
    "mechanics": (MOTION, ("current",)),
    "transmission": (("position",), ("motor_position",)),
    "measurement": (("position",), ("motor_position",)),
}
"""Blocks in the order of the loop, and the signals that a block needs; one signal of each group is sufficient."""

MARGIN = 0.15
"""Share of an interval that is shown before and after it."""


@dataclass(frozen=True)
class Stretch:
    """An interval to show: axis, run, start and stop [s], block ('' if none was named)."""

    axis: str
    run: str
    start: float
    stop: float
    block: str


def blocks_map(diagnosis: Diagnosis, document: dict[str, Any]) -> tuple[list[str], list[list[tuple[str, float, float]]]]:
    """Axes that moved, and (state, share, level) per axis and block; the state is 'place', 'healthy' or 'unseen'."""
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
    """Was the law of a block compared with the record?

    The law of the position controller, or of two P controllers together, has a channel. The command of an axis without current loop counts as
    its current.
    """
    own = diagnosis.machine.axis(axis)
    law = any(f.group.has(axis, "controller") for f in diagnosis.states)
    if block == "position controller" or (law and block in own.loops.one_law):
        return law
    return any(
        view.moves(axis)
        and (block != "speed controller" or view.on_each_cycle)
        and all(any(view.trace.has(axis, own.recorded_as(s)) for s in one_of) for one_of in BLOCKS_NEED[block])
        for view in next((f.group.views for f in diagnosis.states if axis in f.group.axes), ())
    )


def stretches(diagnosis: Diagnosis, document: dict[str, Any]) -> list[Stretch]:
    """Intervals to show, largest excess first: one per place and effect; without places, the largest gap of the campaign."""
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
    """The half second with the largest position gap of one of the axes to the nominal twin."""
    best: tuple[float, Stretch] | None = None
    for run in diagnosis.campaign.runs:
        prediction = diagnosis.held_out.predictions["before"][run.name].trace
        for axis in axes:
            if not run.trace.moves(axis):
                continue
            signal = next((s for s in COMPARED if run.trace.has(axis, s)), None)
            gap = diagnosis.held_out.gaps["before"][run.name][axis].get(signal or "")
            if signal is None or gap is None or gap.noise <= 0.0:
                continue
            square = (run.trace.get(axis, signal) - prediction.get(axis, signal)) ** 2
            width = min(len(square), max(2, round(T.stretch_s / run.trace.period)))
            energy = np.convolve(square, np.ones(width), mode="valid")
            at = int(np.argmax(energy))
            if best is None or gap.times_noise > best[0]:
                best = gap.times_noise, Stretch(axis, run.name, float(run.trace.time[at]), float(run.trace.time[at + width - 1]), block)
    return [best[1]] if best else []


def run_levels(diagnosis: Diagnosis) -> tuple[list[str], list[tuple[str, list[tuple[float, float] | None]]]]:
    """Axes, and per run the level of each axis before and after correction; None if the axis did not move."""
    axes = [a for a in diagnosis.machine.axis_names if any(run.trace.moves(a) for run in diagnosis.campaign.runs)]
    rows = []
    for run in diagnosis.campaign.runs:
        before, after = (levels({run.name: diagnosis.held_out.gaps[which][run.name]}) for which in ("before", "after"))
        rows.append((run.name, [(before[a], after[a]) if run.trace.moves(a) and a in before and a in after else None for a in axes]))
    return axes, rows


def retuned_values(diagnosis: Diagnosis) -> list[tuple[str, str, float]]:
    """Re-tuned parameters: owner (axis or body), quantity, deviation from the machine file as a fraction."""
    return [
        (nuisance.owner, "mass and inertia" if nuisance.quantity == "body" else in_words(nuisance.quantity), float(deviation))
        for state in diagnosis.states
        for nuisance, deviation in zip(state.tuning.nuisances, limited_deviations(state))
        if not nuisance.is_imperfection
    ]
