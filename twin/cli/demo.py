"""The paper's test: X 200 mm out and back at 15 m/min with a jerk of 5 m/s3, with feedforward off and on.

Writes traces, a recording and a plot like the paper's Fig. 4, and prints the errors. `scripts/demo` runs it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
import sys
from typing import TYPE_CHECKING

import numpy as np

from twin.cli.arguments import MACHINE, arg, machine_of, out_argument
from twin.geometry.scurve import moves_in_turn, phases_of_move
from twin.machine.machine import FEEDFORWARD, Machine
from twin.recordings.trace import Trace, write_trace
from twin.report.colours import SETPOINT_COLOUR, axis_colour, hexadecimal, lighter
from twin.report.figure import new_figure, save_png
from twin.simulation.errors_of_run import error_without_delay
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of
from twin.simulation.summary import table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AXIS = "X"
DISTANCE = 0.2
SPEED = 0.25
JERK = 5.0
DWELL = 0.2
PERIOD = 1e-3
START = -DISTANCE / 2.0
TITLE = f"X {DISTANCE * 1e3:.0f} mm out and back at {SPEED * 60:.0f} m/min, jerk {JERK:g} m/s3"


@dataclass(frozen=True)
class Finding:
    """Results of one run, SI: largest following error, following error at constant speed, largest error without the delay,
    overshoot at the stops, largest current."""

    error_max: float
    error_at_speed: float
    deviation_max: float
    overshoot: float
    current_max: float


def paper_test(machine: Machine) -> Trace:
    """Set points of the test for the X axis of a machine, as a trace."""
    axis = machine.axis(AXIS)
    times, position = moves_in_turn(START, [DISTANCE, -DISTANCE], SPEED, axis.max_acceleration, JERK, DWELL, PERIOD)
    return Trace(times, {(AXIS, "setpoint"): position}, {AXIS: axis.kind})


def run_test(machine: Machine, setpoints: Trace) -> dict[str, Trace]:
    """The simulated trace for each feedforward."""
    points = setpoints_of(setpoints, machine)
    return {word: simulate(machine.with_feedforward(word), points).trace for word in FEEDFORWARD}


def finding_of(machine: Machine, trace: Trace) -> Finding:
    """Results of one run."""
    axis = machine.axis(AXIS)
    setpoint, position = trace.get(AXIS, "setpoint"), trace.get(AXIS, "position")
    error = setpoint - position
    at_speed = _times_at_speed(machine, trace.time)
    beyond = np.maximum(position - setpoint.max(), setpoint.min() - position)
    return Finding(
        error_max=float(np.abs(error).max()),
        error_at_speed=float(np.abs(error[at_speed]).mean()),
        deviation_max=float(np.abs(error_without_delay(trace, axis)).max()),
        overshoot=float(max(beyond.max(), 0.0)),
        current_max=float(np.abs(trace.get(AXIS, "current")).max()),
    )


def findings_table(findings: Mapping[str, Finding]) -> str:
    """The results as a table in um and A."""
    heading = ["feedforward", "following error max", "at constant speed", "without the delay", "overshoot", "current max"]
    rows = [
        [
            word,
            f"{f.error_max * 1e6:.1f} um",
            f"{f.error_at_speed * 1e6:.1f} um",
            f"{f.deviation_max * 1e6:.1f} um",
            f"{f.overshoot * 1e6:.2f} um",
            f"{f.current_max:.2f} A",
        ]
        for word, f in findings.items()
    ]
    return table(heading, rows)


def draw(machine: Machine, traces: Mapping[str, Trace], path: Path) -> None:
    """Position, following error, error without the delay, speed and current; feedforward off left, on right."""
    strong, light, grey = (hexadecimal(c) for c in (axis_colour(AXIS), lighter(axis_colour(AXIS), 0.5), SETPOINT_COLOUR))
    columns = {"feedforward off": [("off", strong)], "feedforward on": [("velocity", light), ("velocity+torque", strong)]}
    figure, axes = new_figure(5, 2, width=12.0, height=2.3, sharex=True)
    for column, (title, words) in enumerate(columns.items()):
        position, error, deviation, speed, current = axes[:, column]
        for word, colour in words:
            trace = traces[word]
            time, setpoint, followed = trace.time, trace.get(AXIS, "setpoint"), trace.get(AXIS, "position")
            if word == words[0][0]:
                position.plot(time, setpoint * 1e3, color=grey, linewidth=3.0, label="set point")
                speed.plot(time, np.gradient(setpoint, trace.period) * 60.0, color=grey, linewidth=3.0)
            line = {"color": colour, "linewidth": 1.3, "label": "feedforward " + word.replace("+", " and ")}
            position.plot(time, followed * 1e3, **{**line, "label": "position"})
            error.plot(time, (setpoint - followed) * 1e6, **line)
            deviation.plot(time, error_without_delay(trace, machine.axis(AXIS)) * 1e6, **line)
            speed.plot(time, trace.get(AXIS, "velocity") * 60.0, **line)
            # the speed set point changes once per position cycle, so the current ripples: drawn faint, its moving mean strong
            ripple = max(1, round(machine.position_cycle / trace.period))
            current.plot(time, trace.get(AXIS, "current"), color=grey, linewidth=0.5, alpha=0.7)
            current.plot(time, np.convolve(trace.get(AXIS, "current"), np.full(ripple, 1.0 / ripple), "same"), **line)
        position.set_title(title)
        _mark_largest(error, strong)
        _mark_largest(deviation, strong)
        current.set_xlabel("time in s")
        current.margins(x=0.0)
    axes[0, 0].legend(labels=("set point", "position"), loc="lower center")
    axes[2, 1].legend(loc="lower left")
    labels = ("position\nmm", "following error\num", "error without\nthe delay, um", "speed\nm/min", "motor current\nA")
    for row, label in enumerate(labels):
        axes[row, 0].set_ylabel(label)
        if row not in (1, 2):
            axes[row, 1].sharey(axes[row, 0])
    figure.align_ylabels(axes[:, 0])
    figure.suptitle(f"{machine.name}: {TITLE}", x=0.01, ha="left", size=13)
    save_png(figure, path)


def _mark_largest(axes: Axes, colour: str) -> None:
    """Label the largest value of the last line."""
    time, values = (np.asarray(d) for d in axes.lines[-1].get_data())
    largest = int(np.argmax(np.abs(values)))
    axes.margins(y=0.2)
    size = abs(float(values[largest]))
    text, place = f"{size:.0f} um" if size >= 100.0 else f"{size:.1f} um", (time[largest], values[largest])
    axes.annotate(text, place, xytext=(6, 4), textcoords="offset points", color=colour, weight="bold")


ARGUMENTS = (
    out_argument("folder for traces, recording and plot", type=Path, default=Path("out/demo")),
    MACHINE,
    arg("--setpoints", "FILE", "only write the set points of the test to this file (.csv .parquet)", type=Path),
)


def carry_out(args: argparse.Namespace) -> int:
    """Run the test; write traces, recording and plot; print the results."""
    machine = machine_of(args)
    setpoints = paper_test(machine)
    if args.setpoints:
        write_trace(setpoints, args.setpoints)
        print(f"written: {args.setpoints}")
        return 0
    _report(machine, run_test(machine, setpoints), args.out)
    return 0


def _report(machine: Machine, traces: Mapping[str, Trace], out: Path) -> None:
    written = []
    for word, trace in traces.items():
        written.append(out / f"x_200mm_{word.replace('+', '_')}.parquet")
        write_trace(trace, written[-1])
    findings = {word: finding_of(machine, trace) for word, trace in traces.items()}
    text = findings_table(findings)
    written.append(out / "x_200mm.png")
    draw(machine, traces, written[-1])
    try:
        from twin.replay import write_recording
    except ImportError:
        print("no recording: twin.replay cannot be imported", file=sys.stderr)
    else:
        written.append(out / "x_200mm.rrd")
        write_recording(written[-1], machine, {f"feedforward {word}": trace for word, trace in traces.items()}, summary=text)
    loops = machine.axis(AXIS).loops
    lag = SPEED * (1.0 / loops.position_gain_per_s + loops.set_point_delay_s)
    print(f"{machine.name}: {TITLE}\n")
    print(text)
    print(
        f"\nWithout feedforward the axis lags by v (1/Kv + delay) = {lag * 1e6:.0f} um at constant speed. "
        f"With feedforward only the set-point delay remains: {loops.set_point_delay_s * 1e3:g} ms, {SPEED * loops.set_point_delay_s * 1e6:.0f} um."
    )
    print("\nwritten: " + "\n         ".join(map(str, written)))


def _times_at_speed(machine: Machine, time: np.ndarray) -> np.ndarray:
    """True (sample,) in the second half of both phases of constant speed, when the loops have settled."""
    t_j, t_a, t_v = phases_of_move(DISTANCE, SPEED, machine.axis(AXIS).max_acceleration, JERK)
    ramp = 2.0 * t_j + t_a
    begin = DWELL + ramp
    again = begin + t_v + ramp + DWELL + ramp
    return np.any([(time > b + t_v / 2) & (time < b + t_v) for b in (begin, again)], axis=0)
