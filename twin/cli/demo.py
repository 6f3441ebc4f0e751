"""The paper's test: X 200 mm out and back at 15 m/min with a jerk of 5 m/s3, with feedforward off and on.

Writes traces, a recording and a plot like the paper's Fig. 4, and prints the errors. `scripts/demo` runs it.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from twin.cli.arguments import MACHINE, Args, machine_of, out_argument
from twin.geometry.scurve import moves_in_turn, phases_of_move
from twin.machine.machine import FEEDFORWARD, Machine
from twin.progress import Progress
from twin.recordings.trace import Trace, write_trace
from twin.report.curves import Curve, Panel, curves_figure
from twin.report.figure import save_png
from twin.simulation.errors_of_run import error_without_delay
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of
from twin.simulation.summary import table

AXIS = "X"
DISTANCE = 0.2
SPEED = 0.25
JERK = 5.0
DWELL = 0.2
PERIOD = 1e-3
START = -DISTANCE / 2.0
FORMATS = ("{:.1f} um", "{:.1f} um", "{:.1f} um", "{:.2f} um", "{:.2f} A")
TITLE = f"X {DISTANCE * 1e3:.0f} mm out and back at {SPEED * 60:.0f} m/min, jerk {JERK:g} m/s3"


def paper_test(machine: Machine) -> Trace:
    """Set points of the test for the X axis of a machine, as a trace."""
    axis = machine.axis(AXIS)
    times, position = moves_in_turn(START, [DISTANCE, -DISTANCE], SPEED, axis.max_acceleration, JERK, DWELL, PERIOD)
    return Trace(times, {(AXIS, "setpoint"): position}, {AXIS: axis.kind})


def run_test(machine: Machine, setpoints: Trace) -> dict[str, Trace]:
    """The simulated trace for each feedforward."""
    points = setpoints_of(setpoints, machine)
    return {word: simulate(machine.with_feedforward(word), points).trace for word in FEEDFORWARD}


def finding_of(machine: Machine, trace: Trace) -> dict[str, float]:
    """Results of one run by the columns of the table, in the units of FORMATS; the overshoot is that at the stops."""
    axis = machine.axis(AXIS)
    setpoint, position = trace.get(AXIS, "setpoint"), trace.get(AXIS, "position")
    error = setpoint - position
    at_speed = _times_at_speed(machine, trace.time)
    beyond = np.maximum(position - setpoint.max(), setpoint.min() - position)
    return {
        "following error max": 1e6 * float(np.abs(error).max()),
        "at constant speed": 1e6 * float(np.abs(error[at_speed]).mean()),
        "without the delay": 1e6 * float(np.abs(error_without_delay(trace, axis)).max()),
        "overshoot": 1e6 * float(max(beyond.max(), 0.0)),
        "current max": float(np.abs(trace.get(AXIS, "current")).max()),
    }


def draw(machine: Machine, traces: Mapping[str, Trace], path: Path) -> None:
    """Position, following error, error without the delay, speed and current; feedforward off left, on right."""
    one = traces["off"]
    asked = one.get(AXIS, "setpoint")
    # the speed set point changes once per position cycle, so the current ripples: its moving mean is drawn
    ripple = max(1, round(machine.position_cycle / one.period))
    rows: dict[str, tuple[Callable[[Trace], np.ndarray], np.ndarray | None]] = {
        "position\nmm": (lambda t: t.get(AXIS, "position") * 1e3, asked * 1e3),
        "following error\num": (lambda t: (t.get(AXIS, "setpoint") - t.get(AXIS, "position")) * 1e6, None),
        "error without\nthe delay, um": (lambda t: error_without_delay(t, machine.axis(AXIS)) * 1e6, None),
        "speed\nm/min": (lambda t: t.get(AXIS, "velocity") * 60.0, np.gradient(asked, one.period) * 60.0),
        "motor current\nA": (lambda t: np.convolve(t.get(AXIS, "current"), np.full(ripple, 1.0 / ripple), "same"), None),
    }
    panels = []
    for label, (values, wanted) in rows.items():
        for words in (("off",), ("velocity", "velocity+torque")):
            curves = [] if wanted is None else [Curve("set point", wanted, "setpoint")]
            curves += [Curve(f"feedforward {word}", values(traces[word]), AXIS, "--" if word == "velocity" else "-") for word in words]
            panels.append(Panel(label, curves, peaks="um" if wanted is None and "um" in label else ""))
    save_png(curves_figure(one.time, panels, f"{machine.name}: {TITLE}", columns=2), path)


ARGUMENTS = (
    out_argument("folder for traces, recording and plot", type=Path, default=Path("out/demo")),
    MACHINE,
)


def carry_out(args: Args) -> None:
    """Run the test; write traces, recording and plot; print the results."""
    from twin.replay.recording import write_recording

    machine, out = machine_of(args), args.out
    setpoints = paper_test(machine)
    with Progress("simulating the test with each feedforward", total=0):
        traces = run_test(machine, setpoints)
    written = {word: out / f"x_200mm_{word.replace('+', '_')}.parquet" for word in traces}
    for word, trace in traces.items():
        write_trace(trace, written[word])
    findings = {word: finding_of(machine, trace) for word, trace in traces.items()}
    rows = [[word, *(form.format(value) for form, value in zip(FORMATS, found.values()))] for word, found in findings.items()]
    text = table(["feedforward", *findings["off"]], rows)
    with Progress("drawing and recording", total=0):
        draw(machine, traces, out / "x_200mm.png")
        write_recording(out / "x_200mm.rrd", machine, {f"feedforward {word}": trace for word, trace in traces.items()}, summary=text)
    loops = machine.axis(AXIS).loops
    lag = SPEED * (1.0 / loops.position_gain_per_s + loops.set_point_delay_s)
    print(f"{machine.name}: {TITLE}\n\n{text}\n")
    print(
        f"Without feedforward the axis lags by v (1/Kv + delay) = {lag * 1e6:.0f} um at constant speed. "
        f"With feedforward only the set-point delay remains: {loops.set_point_delay_s * 1e3:g} ms, {SPEED * loops.set_point_delay_s * 1e6:.0f} um."
    )
    print("\nwritten: " + "\n         ".join(map(str, (*written.values(), out / "x_200mm.png", out / "x_200mm.rrd"))))


def _times_at_speed(machine: Machine, time: np.ndarray) -> np.ndarray:
    """True (sample,) in the second half of both phases of constant speed, when the loops have settled."""
    t_j, t_a, t_v = phases_of_move(DISTANCE, SPEED, machine.axis(AXIS).max_acceleration, JERK)
    ramp = 2.0 * t_j + t_a
    begin = DWELL + ramp
    again = begin + t_v + ramp + DWELL + ramp
    return np.any([(time > b + t_v / 2) & (time < b + t_v) for b in (begin, again)], axis=0)
