"""Dashed lines. The viewer has none, so later runs get thick dashes over a thin line with all their data."""

from __future__ import annotations

import numpy as np

from twin.replay.names import entity

DASHES = ((40, 0.6), (80, 0.25))
"""(number of dashes over a run, share of the period that is drawn) for the second and the third run."""
GAP = 1e-9
"""Time between the end of a dash and its gap [s]: the resolution of the viewer."""


def dash_entity(path: str) -> str:
    """Entity of the dashes of a curve, beside it."""
    parent, name = path.rsplit("/", 1)
    return entity(parent, f"{name}_dashes")


def dashes(time: np.ndarray, values: np.ndarray, run: int) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and values (point,) of the dashes over a curve (sample,); NaN ends a dash. `run` is 1 for the second run."""
    count, share = DASHES[(run - 1) % len(DASHES)]
    start, period = float(time[0]), float(time[-1] - time[0]) / count
    first = start + period * np.arange(count)
    last = first + share * period
    inside = np.mod(time - start, period) <= share * period
    inside[-1] = False
    times = np.concatenate([time[inside], first, last, last + GAP])
    drawn = np.concatenate([values[inside], np.interp(np.concatenate([first, last]), time, values), np.full(count, np.nan)])
    order = np.argsort(times, kind="stable")
    return times[order], drawn[order]
