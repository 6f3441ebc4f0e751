"""What a program becomes: its feed as a picture, and its error budget along the path, errors of the interpolator (level 1) and of the drives (level 2).

All errors are distances of the tool tip in the part frame [m]:

    rounding    set point to the programmed curve: corners and chords within the tolerance           level 1
    chord       set points of the interpolation cycle joined by straight lines: sagitta              level 1
    following   actual position to set point at the same time                                        level 2
    drives      actual position to the path of the set points                                        level 2
    contour     actual position to the programmed curve: the error on the part                       both

`following` is mostly along the path, where it does not affect the part; `contour` is the error across the path.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.geometry.tool_path import nearest_along
from twin.machine.machine import Machine
from twin.program.moves import Program, programmed_curve, tips_at
from twin.recordings.trace import PROGRAM, Trace
from twin.report.figure import BLUE, SOFT, new_figure, save_png
from twin.simulation.summary import table

MM_PER_MIN = 60e3
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
        sizes = ("rms_um", "max_um", "at_path_length_mm")
        rows = [
            [r["error"], r["meaning"], str(r["level"] or "1+2"), *(f"{r[n]:.3f}" for n in sizes), str(r["at_line"])] for r in self.summary()
        ]
        worst = [[str(row["line"]), *(f"{row[name]:.3f}" for name in QUANTITIES)] for row in self.worst_lines(lines)]
        whole = table(["error", "meaning", "level", "rms [um]", "max [um]", "at [mm]", "line"], rows, left=2)
        return f"{whole}\n\n{table(['line', *(f'{name} [um]' for name in QUANTITIES)], worst, left=0)}"


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
    step = float(np.linalg.norm(np.diff(tip_wanted, axis=0), axis=1).max())
    rounding, foot = nearest_along(tip_wanted, curve.poses[:, :3], curve.length, None, step, max(SEARCH_AHEAD, 4.0 * step))
    contour, _ = nearest_along(tip_actual, curve.poses[:, :3], curve.length, foot, SEARCH_BACK, SEARCH_AHEAD)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip_wanted, axis=0), axis=1))])
    drives, _ = nearest_along(tip_actual, tip_wanted, along, along, SEARCH_BACK, SEARCH_AHEAD)
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


def plot_feed(setpoints: Trace, path: str | Path, title: str = "") -> None:
    """Programmed and reached feed [mm/min] over path length [mm] into a picture file; rapid moves have no programmed feed."""
    length = setpoints.get(PROGRAM, "path_length") * 1e3
    feed, reached = setpoints.get(PROGRAM, "feed") * MM_PER_MIN, setpoints.get(PROGRAM, "path_speed") * MM_PER_MIN
    figure, grid = new_figure(1, 1, height=3.6)
    axes = grid[0, 0]
    axes.plot(length, np.where(feed > 0.0, feed, np.nan), color=SOFT, linewidth=2.4, label="programmed")
    axes.plot(length, reached, color=BLUE, linewidth=1.2, label="reached")
    axes.set(xlabel="path length in mm", ylabel="feed in mm/min")
    axes.set_title(f"{title}: programmed and reached feed" if title else "", loc="left", weight="bold")
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8.5)  # beside the panel, never on the curves
    save_png(figure, path)
