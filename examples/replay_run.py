"""One five-axis path, simulated with feedforward on and off, replayed with the second run over the first.

    python examples/replay_run.py                                       opens the viewer
    python examples/replay_run.py --screenshot docs/pictures/replay.png --at 5.5   writes the picture of docs/replay.md

The tool follows a flower over the part while the table tilts and turns. What `twin run` and `twin replay` do with files is
done here with a few functions of the package.
"""

import argparse
from pathlib import Path
import tempfile

import numpy as np

from twin.geometry.kinematics import kinematics_of
from twin.machine.machine import Machine, load_machine
from twin.replay.recording import write_recording
from twin.replay.viewer import open_viewer, screenshot
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

PERIOD = 1e-3


def flower(machine: Machine, seconds: float = 7.0) -> Setpoints:
    """Set points that lead the tool tip along a flower above the part, from rest to rest, the table tilting by 15 to 25 degrees."""
    time = np.arange(round((seconds + 0.5) / PERIOD)) * PERIOD
    part = np.clip(time / seconds, 0.0, 1.0)
    turn = 2.0 * np.pi * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    radius = 0.055 + 0.015 * np.cos(5.0 * turn)
    centre = np.array([0.04, 0.025, 0.185])  # above the part, in its frame [m]
    tip = centre + np.column_stack([radius * np.cos(turn), radius * np.sin(turn), 0.006 * np.cos(5.0 * turn)])
    angles = np.column_stack([np.radians(-20.0 + 5.0 * np.cos(2.0 * turn)), np.radians(60.0) * np.sin(turn)])
    return Setpoints(np.column_stack([kinematics_of(machine).linear_axes(tip, angles), angles]), PERIOD)


def main() -> None:
    parser = argparse.ArgumentParser(description="Simulate one path twice and replay both runs over each other.")
    parser.add_argument("--screenshot", type=Path, metavar="FILE.png", help="write a picture instead of opening the viewer")
    parser.add_argument("--at", type=float, metavar="SECONDS", help="time of the picture (default: the end)")
    parser.add_argument("--one", action="store_true", help="only the run with feedforward")
    args = parser.parse_args()

    machine = load_machine()
    setpoints = flower(machine)
    runs = {"feedforward": simulate(machine.with_feedforward("velocity+torque"), setpoints).trace}
    if not args.one:
        runs["no feedforward"] = simulate(machine.with_feedforward("off"), setpoints).trace
    recording = Path(tempfile.mkdtemp(prefix="twin-")) / "flower.rrd"
    write_recording(recording, machine, runs)
    print(f"{recording}: {recording.stat().st_size / 1e6:.1f} MB")
    if args.screenshot:
        print(screenshot(recording, args.screenshot, args.at))
    else:
        open_viewer(recording)


if __name__ == "__main__":
    main()
