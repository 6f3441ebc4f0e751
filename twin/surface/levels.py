"""The tool paths to cut: programmed, commanded by the interpolator (level 1), followed by the drives (levels 1 and 2).

Each level is cut separately, which shows the cause of a mark: the interpolator (programmed to commanded) or the drives (commanded
to followed).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.geometry.kinematics import Kinematics, kinematics_of
from twin.geometry.tool_path import ToolPath, axes_of_trace, contour_error, path_of_axes, search_window
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.surface.steps import GAP_LENGTH, refined_axes
from twin.surface.tools import Tool

PROGRAMMED, COMMANDED, FOLLOWED = "programmed", "commanded", "followed"
LEVELS = (PROGRAMMED, COMMANDED, FOLLOWED)
SIGNALS = {COMMANDED: "setpoint", FOLLOWED: "position"}
"""Signal of the path of a trace."""


@dataclass(frozen=True)
class Level:
    """One path to cut: `level` of LEVELS, `feedforward` of the run ('' if it has no influence, 'as filed' as in the machine file), path and its errors.

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
    finer, at = refined_axes(axes, path, reach)
    if len(finer) == len(axes):
        return path
    return path_of_axes(kinematics, finer, np.interp(at, np.arange(len(time)), time))


def levels_of_trace(trace: Trace, machine: Machine, tool: Tool, levels: Sequence[str], where: str) -> list[Level]:
    """Commanded and followed path of a recorded or simulated run."""
    there = [name for name, signal in SIGNALS.items() if any(trace.has(axis, signal) for axis in trace.axes)]
    if not there:
        raise InputError(f"{where}: neither set points nor positions of an axis; give a run of the twin or a recorded trace")
    if not set(levels) & set(there):
        raise InputError(
            f"{where}: no {' or '.join(levels)} path, this trace holds the {' and the '.join(there)} one; "
            f"give --level {there[0]}, or a program or run with that path"
        )
    found = {name: _level(name, trace, machine, tool, where=where) for name in there}
    if len(found) == 2:
        found[FOLLOWED] = replace(found[FOLLOWED], errors=_errors(found[FOLLOWED], found[COMMANDED], machine))
    return [found[name] for name in there if name in levels]


def levels_of_program(
    path: Path,
    machine: Machine,
    tool: Tool,
    levels: Sequence[str],
    feedforward: Sequence[str | None],
    progress: Callable[[float], None] | None = None,
) -> list[Level]:
    """Programmed, commanded and followed paths of a program, which is simulated once for each feedforward setting.

    None is the feedforward of the machine file, which may differ from axis to axis.
    """
    from twin.program import interpolate, read_program
    from twin.simulation.run import simulate
    from twin.simulation.setpoints import setpoints_of

    program = read_program(path, machine)
    out = [Level(PROGRAMMED, "", programmed_path(program), {})] if PROGRAMMED in levels else []
    if COMMANDED not in levels and FOLLOWED not in levels:
        return out
    parts = 1 + len(feedforward) * (FOLLOWED in levels)

    def report(done: int) -> Callable[[float], None] | None:
        return (lambda share: progress((done + share) / parts)) if progress else None

    setpoints = interpolate(program, machine, progress=report(0))
    commanded = _level(COMMANDED, setpoints, machine, tool)
    out += [commanded] if COMMANDED in levels else []
    for i, word in enumerate(feedforward if FOLLOWED in levels else ()):
        run = simulate(machine.with_feedforward(word), setpoints_of(setpoints, machine), progress=report(1 + i))
        followed = _level(FOLLOWED, run.trace, machine, tool, word or "as filed")
        out.append(replace(followed, errors={**_errors(followed, commanded, machine), **_rotary(run.trace)}))
    return out


def _level(name: str, trace: Trace, machine: Machine, tool: Tool, feedforward: str = "", where: str = "tool path") -> Level:
    """The commanded or followed path of a trace."""
    kinematics = kinematics_of(machine).with_tool_length(tool.length)
    path = axis_path(kinematics, axes_of_trace(trace, SIGNALS[name], machine), trace.time, tool.reach, where=where)
    return Level(name, feedforward, path, {}, trace)


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


def _errors(followed: Level, commanded: Level, machine: Machine) -> dict[str, float]:
    """Largest contour and orientation error of the followed path against the commanded one."""
    error = contour_error(followed.path, commanded.path, search_window(machine))
    return {"contour_um": float(error.error.max() * 1e6), "orientation_deg": float(np.degrees(error.orientation.max()))}


def _rotary(trace: Trace) -> dict[str, float]:
    """Largest deviation of each rotary axis from its set points [deg]: at the same time, and without the constant delay."""
    out = {}
    for axis in trace.axes:
        s, x = trace.get(axis, "setpoint"), trace.get(axis, "position")
        if trace.kinds[axis] != "rotary" or np.ptp(s) < 1e-6:
            continue
        speed = np.gradient(s, trace.time)
        delay = float((s - x) @ speed / (speed @ speed))
        deviation = np.interp(trace.time - delay, trace.time, s) - x
        out[f"{axis}_following_deg"] = float(np.degrees(np.abs(s - x).max()))
        out[f"{axis}_delay_ms"] = delay * 1e3
        out[f"{axis}_deviation_deg"] = float(np.degrees(np.abs(deviation).max()))
        out[f"{axis}_deviation_rms_deg"] = float(np.degrees(np.sqrt(np.mean(deviation**2))))
    return out
