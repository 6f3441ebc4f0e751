"""Error budget of a program along its path: errors of the interpolator (level 1) and of the drives (level 2).

All errors are distances of the tool tip in the part frame [m]:

    rounding    set point to the programmed curve: corners and chords within the tolerance           level 1
    chord       set points of the interpolation cycle joined by straight lines: sagitta              level 1
    following   actual position to set point at the same time                                        level 2
    drives      actual position to the path of the set points                                        level 2
    contour     actual position to the programmed curve: the error on the part                       both

`following` is mostly along the path, where it does not affect the part; `contour` is the error across the path.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.machine.machine import Machine
from twin.program.curve import nearest_along, programmed_curve
from twin.program.moves import Program, tips_at
from twin.recordings.trace import PROGRAM, Trace

SEARCH_BACK, SEARCH_AHEAD = 15e-3, 3e-3
"""Search range for the actual position along the path, before and after its set point [m]; larger than any following error."""

QUANTITIES = {
    "rounding": (1, "set point to programmed curve"),
    "chord": (1, "straight lines between interpolation cycles"),
    "following": (2, "actual position to set point, same time"),
    "drives": (2, "actual position to path of set points"),
    "contour": (0, "actual position to programmed curve"),
}


@dataclass(frozen=True)
class ErrorBudget:
    """Errors [m] at each set point (sample,); `path_length` [m] along the programmed curve, `line` of the program."""

    time: np.ndarray
    path_length: np.ndarray
    line: np.ndarray
    rounding: np.ndarray
    chord: np.ndarray
    following: np.ndarray
    drives: np.ndarray
    contour: np.ndarray

    def summary(self) -> list[dict[str, Any]]:
        """One row per error: level, RMS and greatest value [um], and where the greatest is."""
        rows = []
        for name, (level, meaning) in QUANTITIES.items():
            values = getattr(self, name)
            worst = int(np.argmax(values))
            sizes = {"rms_um": float(np.sqrt(np.mean(values**2)) * 1e6), "max_um": float(values[worst] * 1e6)}
            place = {"at_path_length_mm": float(self.path_length[worst] * 1e3), "at_line": int(self.line[worst])}
            rows.append({"error": name, "level": level, **sizes, **place, "meaning": meaning})
        return rows

    def worst_lines(self, count: int = 10) -> list[dict[str, float | int]]:
        """The lines of the program with the greatest contour error, and each level's share there [um]."""
        lines, index = np.unique(self.line, return_inverse=True)
        greatest = {name: np.zeros(len(lines)) for name in QUANTITIES}
        for name, values in greatest.items():
            np.maximum.at(values, index, getattr(self, name) * 1e6)
        order = np.argsort(-greatest["contour"])[:count]
        return [{"line": int(lines[i]), **{name: float(values[i]) for name, values in greatest.items()}} for i in order]

    def table(self, lines: int = 10) -> str:
        """Both as text for the terminal."""
        out = ["error      level   rms [um]   max [um]   at [mm]  line  meaning"]
        for row in self.summary():
            level = row["level"] or "1+2"
            out.append(
                f"{row['error']:<10} {level!s:>5} {row['rms_um']:>10.3f} {row['max_um']:>10.3f} {row['at_path_length_mm']:>9.3f} "
                f"{row['at_line']:>5}  {row['meaning']}"
            )
        out += ["", "line    " + "".join(f"{name + ' [um]':>16}" for name in QUANTITIES)]
        out += [f"{row['line']:<8}" + "".join(f"{row[name]:>16.3f}" for name in QUANTITIES) for row in self.worst_lines(lines)]
        return "\n".join(out)


def error_budget(program: Program, setpoints: Trace, followed: Trace, machine: Machine) -> ErrorBudget:
    """Errors of both levels along the path of a program.

    `setpoints`: the result of `interpolate`; `followed`: `<axis>.position` of the run. Missing axes are assumed to follow exactly. Both
    start at the same time.
    """
    if not setpoints.has(PROGRAM, "line"):
        raise InputError("error budget: the set points carry no program.line; make them with `twin interpolate`")
    time = setpoints.time[(setpoints.time >= followed.time[0]) & (setpoints.time <= followed.time[-1] + 1e-9)]
    count = len(time)
    if count < 3:
        raise InputError("error budget: the run does not overlap the set points in time; both must start at the same time")
    line = setpoints.get(PROGRAM, "line")[:count].astype(int)
    home = program.start
    wanted, actual = np.tile(home, (count, 1)), np.tile(home, (count, 1))
    for i, axis in enumerate(program.kinematics.names):
        if setpoints.has(axis, "setpoint"):
            wanted[:, i] = setpoints.get(axis, "setpoint")[:count]
        actual[:, i] = np.interp(time, followed.time, followed.get(axis, "position")) if followed.has(axis, "position") else wanted[:, i]
    m = program.moves
    of_line, shortest = dict(zip(m.line.tolist(), m.tool_length.tolist())), float(m.tool_length.min())
    length = np.array([of_line.get(int(v), shortest) for v in line])
    tip_wanted, tip_actual = (tips_at(program.kinematics, axes, length)[:, :3] for axes in (wanted, actual))
    curve = programmed_curve(program)
    nowhere = np.full(count, np.nan)
    step = float(np.linalg.norm(np.diff(tip_wanted, axis=0), axis=1).max())
    rounding, foot = nearest_along(curve.points, curve.length, tip_wanted, nowhere, step, max(SEARCH_AHEAD, 4.0 * step))
    contour, _ = nearest_along(curve.points, curve.length, tip_actual, foot, SEARCH_BACK, SEARCH_AHEAD)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip_wanted, axis=0), axis=1))])
    drives, _ = nearest_along(tip_wanted, along, tip_actual, along, SEARCH_BACK, SEARCH_AHEAD)
    every = max(1, round(machine.interpolation_cycle / setpoints.period))
    chord = np.zeros(count)
    if count > 2 * every:
        before, at, behind = tip_wanted[: -2 * every], tip_wanted[every:-every], tip_wanted[2 * every :]
        way, bend = behind - before, behind - 2.0 * at + before
        # only the component of the second difference across the path is a sagitta
        along = np.einsum("ni,ni->n", bend, way) / np.maximum(np.linalg.norm(way, axis=1), 1e-12)
        chord[every:-every] = np.sqrt(np.maximum(np.sum(bend**2, axis=1) - along**2, 0.0)) / 8.0
    following = np.linalg.norm(tip_actual - tip_wanted, axis=1)
    return ErrorBudget(time, foot, line, rounding, chord, following, drives, contour)
