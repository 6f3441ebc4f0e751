"""Sizes over time: the projections of all campaigns as one series per direction, free of what differs between recordings of a healthy machine.

A recording moves b by G (theta + u): theta is the change of the machine, u ~ N(0, diag(scatter^2)) what normally differs from recording to recording
(load, friction, growth by temperature). The best unbiased size of one direction next to u is

    y = w'b / w'G e        w = (G + G S G)^-1 G e = (1 + S G)^-1 e        S = diag(scatter^2), e the direction

and A = G (1 + S G)^-1 is the information that a recording holds about each direction once u is allowed for. What all axes do together is not a
change of one of them: the median of the others is a thermometer of each group of axes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import functools

import numpy as np

from twin.history.columns import Direction
from twin.history.projection import Projection
from twin.history.store import Row

LOAD, FRICTION, GROWTH, ELSE = 1.0, 0.2, 0.2, 0.01
SCATTER = {
    "inertia": LOAD,
    "table_unbalance": LOAD,
    "coulomb_friction": FRICTION,
    "viscous_friction": FRICTION,
    "thermal_drift": GROWTH,
    "lead_error": GROWTH,
}
"""Standard deviation between recordings of a healthy machine, in usual sizes of the effect: tool and workpiece, lubrication, temperature."""

FIRST, LEAST_KNOWN, ROOM = 12, 6, 2.0
"""First recordings that show how much the load of each axis differs normally, the fewest of them beside a constant for each program, and the room
above their scatter: a tool or workpiece of another size may come.
"""

LEAST_SCATTER = 0.01
"""Smallest scatter between recordings in usual sizes: load and friction act on the rest too, in ways that are not linear."""

WARMS = ("coulomb_friction", "viscous_friction", "viscous_asymmetry", "stribeck", "thermal_drift", "lead_error", "frame_vibration")
"""Effects that temperature acts on; frame vibration through the moment of break-away."""

THERMOMETERS = ("viscous_friction", "coulomb_friction", "lead_error")
"""Effects that show temperature and season on the other axes."""

RIVAL = 0.8
"""Another cause is named beside the best cause if it explains at least this share of what the best cause explains."""

SAME_PROGRAM = 0.01
"""Two recordings are of the same program if their paths and travels differ by less than this share."""


@dataclass(frozen=True)
class Series:
    """One group of axes: sizes y of all directions [usual sizes] in the recordings at `at` (index into the rows), and the mean G."""

    axes: tuple[str, ...]
    directions: Sequence[Direction]
    at: np.ndarray  # (recording,)
    sizes: np.ndarray  # (recording, direction)
    gram: np.ndarray  # (direction, direction)
    scatter: np.ndarray  # normal scatter of each direction between recordings (direction,)

    @functools.cached_property
    def warms(self) -> np.ndarray:
        """Directions that temperature acts on (direction,)."""
        return np.array([d.setting.effect.name in WARMS for d in self.directions])

    @functools.cached_property
    def seen(self) -> np.ndarray:
        """Directions that a recording shows (direction,)."""
        return seen(self.gram, self.scatter)

    def explained_by(self, blocks: Sequence[Sequence[int]], change: np.ndarray, scatter: np.ndarray) -> list[tuple[float, np.ndarray]]:
        """What the directions of each block explain together of a change of the sizes (direction,) [chi^2], and their sizes (block,).

        `scatter` (direction,) is that between these recordings; the change is taken as a difference of two of them.
        """
        prior = information(self.gram, self.scatter)
        moved = change * np.diag(prior)
        right = moved + self.gram @ (self.scatter**2 * moved)  # b from the scores w'b
        w = filters(self.gram, scatter)
        inner, score = self.gram @ w, w.T @ right
        out = []
        for block in blocks:
            theta = np.linalg.lstsq(inner[np.ix_(block, block)], score[list(block)], rcond=1e-9)[0]
            out.append((float(theta @ score[list(block)]), theta))
        return out


def seen(gram: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    """Directions that show at a fifth of their usual size, at two standard deviations, next to all that scatters but themselves (direction,)."""
    own = np.diag(information(gram, scatter))
    return own / np.maximum(1.0 - scatter**2 * own, 1e-12) > (2.0 / 0.2) ** 2


def is_load(effect: str) -> bool:
    """Is an effect what the axis carries, such as a tool or a workpiece? That is no fault of the machine."""
    return SCATTER.get(effect) == LOAD


def scatter_of(directions: Sequence[Direction]) -> np.ndarray:
    """Normal scatter between recordings [usual sizes] (direction,)."""
    return np.array([SCATTER.get(d.setting.effect.name, ELSE) for d in directions])


def filters(gram: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    """w of each direction, the columns of (1 + S G)^-1."""
    return np.linalg.inv(np.eye(len(gram)) + scatter[:, None] ** 2 * gram)


def information(gram: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    """A = G (1 + S G)^-1 (direction, direction)."""
    return gram @ filters(gram, scatter)


def sizes(gram: np.ndarray, right: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    """y of all directions (direction,) from G and b; 0 for a direction that the recording does not show."""
    w = filters(gram, scatter)
    own = np.diag(gram @ w)
    return np.asarray(w.T @ right / np.where(own > 0.0, own, np.inf))


def series_of(rows: Sequence[Row], axes: tuple[str, ...], directions: Sequence[Direction], programs: np.ndarray) -> Series | None:
    """The series of a group of axes; None if no recording moves it. `programs` (row,) numbers the program of each."""
    at = np.array([i for i, row in enumerate(rows) if axes in row.projections])
    if not at.size:
        return None
    projections = [rows[i].projections[axes] for i in at]
    scatter = _with_learnt_load(scatter_of(directions), directions, projections[:FIRST], programs[at[:FIRST]])
    gram = np.mean([p.gram for p in projections], axis=0)
    return Series(axes, directions, at, np.array([sizes(p.gram, p.right, scatter) for p in projections]), gram, scatter)


def _with_learnt_load(
    scatter: np.ndarray, directions: Sequence[Direction], first: Sequence[Projection], programs: np.ndarray
) -> np.ndarray:
    """The scatter (direction,) with that of the load as the first recordings show it: most axes always carry the same, and then their inertia separates a
    torque constant from friction. A direction shows its own scatter best if none is expected of it.
    """
    constants = constants_of(programs)
    free = len(first) - constants.shape[1]
    if free < LEAST_KNOWN:
        return scatter
    learnt = scatter.copy()
    for k in [k for k, d in enumerate(directions) if is_load(d.cause[0])]:
        none = np.where(np.arange(len(scatter)) == k, 0.0, scatter)
        y = np.array([sizes(p.gram, p.right, none)[k] for p in first])
        left = y - constants @ np.linalg.lstsq(constants, y, rcond=None)[0]
        learnt[k] = min(scatter[k], max(ROOM * float(np.sqrt(left @ left / free)), LEAST_SCATTER))
    return learnt


def thermometers(series: Sequence[Series], of: Series, count: int) -> np.ndarray:
    """What the axes outside a group show of temperature (row, thermometer): the median of each kind over at least two axes, if there are."""
    columns = []
    for name in THERMOMETERS:
        others = np.full((count, 0), np.nan)
        for one in series:
            if one is not of:
                picked = [k for k, d in enumerate(one.directions) if d.setting.effect.name == name and one.seen[k]]
                full = np.full((count, len(picked)), np.nan)
                full[one.at] = one.sizes[:, picked]
                others = np.column_stack([others, full])
        if others.shape[1] >= 2:
            known = np.isfinite(others).any(axis=1)
            column = np.zeros(count)
            column[known] = np.nanmedian(others[known] - np.nanmean(others, axis=0), axis=1)
            columns.append(column)
    return np.column_stack(columns) if columns else np.zeros((count, 0))


def programs_of(rows: Sequence[Row]) -> np.ndarray:
    """Number of the program of each recording (row,); those that were recorded once or twice are one class."""
    known: list[tuple[float, ...]] = []
    numbers = []
    for row in rows:
        k = next((k for k, p in enumerate(known) if same_program(p, row.program)), len(known))
        known += [row.program] if k == len(known) else []
        numbers.append(k)
    counts = np.bincount(numbers)
    return np.array([k if counts[k] > 2 else -1 for k in numbers])


def same_program(a: Sequence[float], b: Sequence[float]) -> bool:
    """Do two recordings have the same axes, paths and travels?"""
    return len(a) == len(b) and np.allclose(a, b, rtol=SAME_PROGRAM, atol=1e-6)


def constants_of(programs: np.ndarray) -> np.ndarray:
    """A constant for each program (row, program)."""
    return np.column_stack([programs == k for k in np.unique(programs)]).astype(float)
