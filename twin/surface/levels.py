"""The tool paths to cut: programmed, commanded by the interpolator (level 1), followed by the drives (levels 1 and 2).

Each level is cut separately, which shows the cause of a mark: the interpolator (programmed to commanded) or the drives (commanded
to followed).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.geometry.kinematics import Kinematics, kinematics_of
from twin.geometry.tool_path import ToolPath, axes_of_trace, contour_error, path_of_axes, search_window
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.surface.steps import GAP_LENGTH, STEP_TOLERANCE, bend_of, refined_axes
from twin.surface.tools import Tool

PROGRAMMED, COMMANDED, FOLLOWED = "programmed", "commanded", "followed"
LEVELS = (PROGRAMMED, COMMANDED, FOLLOWED)
AS_FILED = "as filed"
"""Label for the feedforward of the machine file, which may differ from axis to axis."""


@dataclass(frozen=True)
class Level:
    """One path to cut: `level` of LEVELS, `feedforward` of the run ('' if it has no influence), path and path errors.

    `trace` is the motion of the axes, None for the programmed path.
    """

    level: str
    feedforward: str
    path: ToolPath
    errors: Mapping[str, float]
    trace: Trace | None = None

    @property
    def label(self) -> str:
        return f"{self.level}, feedforward {self.feedforward}" if self.feedforward else self.level


def axis_path(kinematics: Kinematics, axes: np.ndarray, time: np.ndarray, reach: float, *, where: str = "tool path") -> ToolPath:
    """The tool path of axis positions (sample, 5), resampled more finely where it curves."""
    path = path_of_axes(kinematics, axes, time)
    jump = np.linalg.norm(np.diff(path.tip, axis=0), axis=1)
    if len(jump) and jump.max() > GAP_LENGTH:
        i = int(np.argmax(jump))
        raise InputError(
            f"{where}: the tool jumps by {jump[i] * 1e3:.3g} mm between two samples at {time[i]:.6g} s; "
            "the recording has a gap, split it there"
        )
    finer, at = refined_axes(axes, bend_of(path.tip, path.axis, reach), STEP_TOLERANCE)
    if len(finer) == len(axes):
        return path
    return path_of_axes(kinematics, finer, np.interp(at, np.arange(len(time)), time))


def levels_of_trace(trace: Trace, machine: Machine, tool: Tool, levels: Sequence[str], where: str) -> list[Level]:
    """Commanded and followed path of a recorded or simulated run."""
    kinematics = kinematics_of(machine).with_tool_length(tool.length)
    out = []
    signals = {COMMANDED: "setpoint", FOLLOWED: "position"}
    there = [name for name, signal in signals.items() if any(trace.has(axis, signal) for axis in trace.axes)]
    if not there:
        raise InputError(f"{where}: neither set points nor positions of an axis; give a run of the twin or a recorded trace")
    if not set(levels) & set(there):
        raise InputError(
            f"{where}: no {' or '.join(levels)} path, this trace holds the {' and the '.join(there)} one; "
            f"give --level {there[0]}, or a program or run with that path"
        )
    paths = {
        name: axis_path(kinematics, axes_of_trace(trace, signals[name], machine), trace.time, tool.reach, where=where) for name in there
    }
    for name in there:
        if name in levels:
            errors = _errors(paths[name], paths.get(COMMANDED), machine) if name == FOLLOWED else {}
            out.append(Level(name, "", paths[name], errors, trace))
    return out


def levels_of_program(
    path: Path,
    machine: Machine,
    tool: Tool,
    levels: Sequence[str],
    feedforward: Sequence[str | None],
    progress: Callable[[float], None] | None = None,
) -> list[Level]:
    """Programmed, commanded and followed paths of a program, which is simulated once for each feedforward setting.

    None or AS_FILED is the feedforward of the machine file.
    """
    from twin.program import interpolate, read_program
    from twin.simulation.run import simulate
    from twin.simulation.setpoints import setpoints_of

    program = read_program(path, machine)
    kinematics = kinematics_of(machine).with_tool_length(tool.length)
    out = []
    if PROGRAMMED in levels:
        out.append(Level(PROGRAMMED, "", programmed_path(program), {}))
    if COMMANDED not in levels and FOLLOWED not in levels:
        return out
    parts = 1 + len(feedforward) * (FOLLOWED in levels)

    def report(done: int) -> Callable[[float], None] | None:
        return (lambda share: progress((done + share) / parts)) if progress else None

    setpoints = interpolate(program, machine, progress=report(0))
    commanded = axis_path(kinematics, axes_of_trace(setpoints, "setpoint", machine), setpoints.time, tool.reach)
    if COMMANDED in levels:
        out.append(Level(COMMANDED, "", commanded, {}, setpoints))
    for i, word in enumerate(feedforward if FOLLOWED in levels else ()):
        run = simulate(
            machine.with_feedforward(None if word == AS_FILED else word), setpoints_of(setpoints, machine), progress=report(1 + i)
        )
        followed = axis_path(kinematics, axes_of_trace(run.trace, "position", machine), run.trace.time, tool.reach)
        errors = {**_errors(followed, commanded, machine), **_rotary(run.trace)}
        out.append(Level(FOLLOWED, word or AS_FILED, followed, errors, run.trace))
    return out


def programmed_path(program: Any) -> ToolPath:
    """Poses of the programmed curve, block by block, timed by the programmed feed (rapid moves: 1 m/s or 1 rad/s).

    Within a move A and C are linear, with points every TURN_STEP. Straight moves under TRAORI with ORIWKS need no such points: their
    tool axis turns on the great circle, as between two poses.
    """
    from twin.program.moves import programmed_curve

    curve, moves = programmed_curve(program), program.moves
    poses, row = curve.poses, curve.row[1:]
    # programmed feed, to separate fast and slow cutting; for purely rotary moves that of the rotary axes
    feed = np.where(np.isfinite(moves.feed), moves.feed, 1.0)[row]
    tip, turn = (np.linalg.norm(np.diff(x, axis=0), axis=1) for x in (poses[:, :3], poses[:, 3:]))
    way = np.where(moves.rotary[row], turn, tip)
    time = np.concatenate([[0.0], np.cumsum(np.maximum(way / np.maximum(feed, 1e-9), 1e-9))])
    return ToolPath(time, poses[:, :3], program.kinematics.forward(poses)[1])


def _errors(path: ToolPath, reference: ToolPath | None, machine: Machine) -> dict[str, float]:
    """Largest contour and orientation error of a followed path against the commanded one."""
    if reference is None:
        return {}
    error = contour_error(path, reference, search_window(machine))
    return {"contour_um": float(error.error.max() * 1e6), "orientation_deg": float(np.degrees(error.orientation.max()))}


def _rotary(trace: Trace) -> dict[str, float]:
    """Largest deviation of each rotary axis from its set points [deg]: at the same time, and without the constant delay."""
    out = {}
    for axis in trace.axes:
        known = trace.kinds.get(axis) == "rotary" and trace.has(axis, "position") and trace.has(axis, "setpoint")
        if not known or np.ptp(trace.get(axis, "setpoint")) < 1e-6:
            continue
        s, x = trace.get(axis, "setpoint"), trace.get(axis, "position")
        following = s - x
        speed = np.gradient(s, trace.time)
        delay = float(following @ speed / (speed @ speed))
        out[f"{axis}_following_deg"] = float(np.degrees(np.abs(following).max()))
        out[f"{axis}_delay_ms"] = delay * 1e3
        out[f"{axis}_deviation_deg"] = float(np.degrees(np.abs(np.interp(trace.time - delay, trace.time, s) - x).max()))
        out[f"{axis}_deviation_rms_deg"] = float(np.degrees(np.sqrt(np.mean((np.interp(trace.time - delay, trace.time, s) - x) ** 2))))
    return out
