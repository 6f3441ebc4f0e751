"""Processor time of `twin.gap` for each of many short runs, beside that of one long run with as many samples.

    python -m devtools.measure_gap [RUNS]

The short runs begin at rest or in motion; one that begins in motion is simulated from 0.4 s before its first sample. The runs are strokes of X.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import sys
import time

import numpy as np

import twin
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.simulation.setpoints import Setpoints

SAMPLES, PERIOD = 120, 1e-3
RECORDED = ("setpoint", "position", "motor_position", "velocity", "velocity_setpoint", "current")


def runs_of(count: int, samples: int, begin: float) -> list[MeasuredRun]:
    """Runs that move up and down by 1 mm in SAMPLES samples; `begin` is the part of the stroke that is over at the first sample."""
    machine = twin.load_machine()
    part = (np.arange(samples) / (SAMPLES - 1) + begin) % 1.0
    way = np.zeros((samples, len(machine.axes)))
    way[:, machine.axis_names.index("X")] = 1e-3 * np.sin(np.pi * part) ** 4
    trace = twin.simulate(machine, Setpoints(way, PERIOD), noise_seed=1).trace
    trace = twin.Trace(trace.time, {("X", s): trace.get("X", s) for s in RECORDED}, trace.kinds)
    return [MeasuredRun(f"r{i}", trace, ("off", "velocity", "velocity+torque")[i % 3], float(i)) for i in range(count)]


def main(words: Sequence[str]) -> int:
    """Print a table."""
    count = int(words[0]) if words else 100
    machine = twin.load_machine()
    kinds = {
        f"{count} runs from rest": runs_of(count, SAMPLES, 0.0),
        f"{count} runs from motion": runs_of(count, SAMPLES, 0.2),
        "one run of as many samples": runs_of(1, count * SAMPLES, 0.0),
    }
    print(f"| runs of X | processor time for {SAMPLES} samples |\n|---|---|")
    for kind, runs in kinds.items():
        campaign = Campaign(Path("c"), machine.name, tuple(runs))
        twin.gap(Campaign(Path("c"), machine.name, tuple(runs[:1])), machine)  # compiles
        begun = time.process_time()
        twin.gap(campaign, machine)
        print(f"| {kind} | {1e3 * (time.process_time() - begun) / count:.1f} ms |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
