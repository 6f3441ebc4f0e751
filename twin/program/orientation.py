"""Angles of A and C for a programmed tool axis: both solutions, travel, shortest way of C, singularity.

Each direction has two solutions (tilt to either side, table half a turn apart). The solution within travel that is nearest to the current
angles is chosen, measured by the larger of the two rotations; C takes the shortest way. If the tool axis is parallel to the turning axis,
C keeps its angle. A turning axis with stops may have to rewind by whole turns. This is reported to the caller, because it is harmless in a
rapid move but ruins a cut.
"""

from dataclasses import dataclass

import numpy as np

from twin.compiled_functions import compiled
from twin.geometry.kinematics import Kinematics, great_circle

OK, UNREACHABLE, OUTSIDE_TRAVEL = 0, 1, 2
TRAVEL_TOLERANCE = 1e-9
WALK_STEP = np.radians(1.0)


@dataclass(frozen=True)
class ChosenAngles:
    """Angles (sample, 2) of A and C, status per sample (OK, UNREACHABLE, OUTSIDE_TRAVEL), and where C had to rewind."""

    angles: np.ndarray
    status: np.ndarray
    rewound: np.ndarray


def choose_angles(kinematics: Kinematics, tool_axis: np.ndarray, start: np.ndarray, fixed: np.ndarray | None = None) -> ChosenAngles:
    """A and C along a sequence of tool axes (sample, 3) in the part frame, beginning at `start` (2,).

    For a tool axis of NaN the angles are `fixed` (sample, 2); an angle that is NaN there is not changed, and so are both where the
    status reports that a direction cannot be reached.
    """
    tool_axis, start = np.atleast_2d(tool_axis), np.asarray(start, float)
    fixed = np.full((len(tool_axis), 2), np.nan) if fixed is None else fixed
    wanted, walked, kept = _walked(kinematics, tool_axis, fixed, start)
    free = np.isnan(wanted[:, 0])
    pairs, reachable = kinematics.angles(np.where(free[:, None], kinematics.tool_axis, wanted))
    found = ChosenAngles(*_choose(pairs, reachable, free, walked, start, kinematics.travel[3:]))
    rewound = np.diff(np.concatenate([[0], np.cumsum(found.rewound)[kept]])) > 0
    return ChosenAngles(found.angles[kept], found.status[kept], rewound)


def _walked(
    kinematics: Kinematics, tool_axis: np.ndarray, fixed: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The directions with intermediate steps where they are far apart, and the rows of the original ones.

    Over a large step the nearest solution may be on the other side of the turning axis, which no continuous motion reaches. With steps
    along the great circle the choice follows the motion.
    """
    first = kinematics.direction(start)
    before = np.vstack([first, tool_axis[:-1]])
    size = np.linalg.norm(tool_axis, axis=1) * np.linalg.norm(before, axis=1)
    cosine = np.einsum("ni,ni->n", before, tool_axis) / np.where(size > 0.0, size, 1.0)
    angle = np.nan_to_num(np.arccos(np.clip(cosine, -1.0, 1.0)))
    steps = np.maximum(1, np.ceil(angle / WALK_STEP)).astype(int)
    kept = np.cumsum(steps) - 1
    if kept[-1] == len(tool_axis) - 1:
        return tool_axis, fixed, kept
    out, walked = np.repeat(tool_axis, steps, axis=0), np.repeat(fixed, steps, axis=0)
    for i in np.flatnonzero(steps > 1):
        a, b = before[i] / np.linalg.norm(before[i]), tool_axis[i] / np.linalg.norm(tool_axis[i])
        share = np.arange(1, steps[i])[:, None] / steps[i]
        if np.pi - angle[i] > 1e-6:  # opposite directions have no great circle of their own
            out[kept[i] - steps[i] + 1 : kept[i]] = great_circle(a, b, angle[i], share)
    return out, walked, kept


def unreachable_text(kinematics: Kinematics, tool_axis: np.ndarray, status: int) -> str:
    """Why a tool axis cannot be reached, and what to do."""
    i, j, k = tool_axis
    low, high = np.degrees(kinematics.travel[3])
    a, c = kinematics.label[3:]
    if status == UNREACHABLE and not kinematics.names[3]:
        return f"tool axis ({i:.4f}, {j:.4f}, {k:.4f}) cannot be had with the rotary axes of this machine; take a five-axis machine file"
    if status == UNREACHABLE:
        return f"tool axis ({i:.4f}, {j:.4f}, {k:.4f}) lies outside what {a} and {c} can reach; turn the part on the table"
    return (
        f"tool axis ({i:.4f}, {j:.4f}, {k:.4f}) needs an angle outside travel in both solutions ({a} {low:g} to {high:g} deg); "
        "tilt less or turn the part on the table"
    )


@compiled(allocates=True)
def _within(angle, near, travel):
    """The angle by whole turns next to `near`, by more of them if that lies outside the travel (2,); NaN if no place fits."""
    whole, (low, high) = 2.0 * np.pi, (travel[0] - TRAVEL_TOLERANCE, travel[1] + TRAVEL_TOLERANCE)
    angle += whole * np.round((near - angle) / whole)
    if angle < low:
        angle += whole * np.ceil((low - angle) / whole)
    if angle > high:
        angle -= whole * np.ceil((angle - high) / whole)
    return angle if low <= angle <= high else np.nan


@compiled(allocates=True)
def _choose(pairs, reachable, free, fixed, start, travel):
    n = pairs.shape[1]
    angles = np.empty((n, 2))
    status = np.zeros(n, np.int8)
    rewound = np.zeros(n, np.bool_)
    tilt, turn = start[0], start[1]
    for i in range(n):
        best, best_tilt, best_turn = np.inf, tilt, turn
        if free[i]:
            best_tilt = tilt if np.isnan(fixed[i, 0]) else fixed[i, 0]
            best_turn = turn if np.isnan(fixed[i, 1]) else fixed[i, 1]
        elif not reachable[i]:
            status[i] = UNREACHABLE
        else:
            for k in range(2):
                new_tilt = _within(pairs[k, i, 0], tilt, travel[0])
                new_turn = _within(turn if np.isnan(pairs[k, i, 1]) else pairs[k, i, 1], turn, travel[1])
                if np.isnan(new_tilt) or np.isnan(new_turn):
                    continue
                distance = max(abs(new_tilt - tilt), abs(new_turn - turn))
                # of two equal ways the one with the smaller tilt step, then the first
                distance += 1e-6 * abs(new_tilt - tilt)
                if distance < best - 1e-12:
                    best, best_tilt, best_turn = distance, new_tilt, new_turn
            if best == np.inf:
                status[i] = OUTSIDE_TRAVEL
            elif abs(best_turn - turn) > np.pi + 1e-9:
                rewound[i] = True
        tilt, turn = best_tilt, best_turn
        angles[i, 0] = tilt
        angles[i, 1] = turn
    return angles, status, rewound
