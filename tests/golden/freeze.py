"""The frozen run, and the command that stores it again after an intended change:

python -m tests.golden.freeze
"""

from __future__ import annotations

import importlib.metadata
import json
from pathlib import Path

import numpy as np

from twin.machine.machine import Machine, load_machine
from twin.recordings.trace import Trace, write_trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

HERE = Path(__file__).parent
TRACE, VERSIONS = HERE / "five_axes.parquet", HERE / "versions.json"
PACKAGES = ("mujoco", "numpy", "scipy", "numba")


def frozen_run(machine: Machine) -> Trace:
    """All five axes for 0.4 s, each reversing once, every 2 ms."""
    t = np.arange(401) * 1e-3
    swing = np.array([0.004, -0.003, 0.002, 0.03, -0.05])
    start = np.array([0.1, 0.05, -0.1, -0.5, 1.0])
    points = Setpoints(start + np.sin(2 * np.pi * 2.5 * t)[:, None] ** 3 * swing, 1e-3)
    return simulate(machine.with_feedforward("velocity+torque"), points, sample_period=2e-3).trace


def versions() -> dict[str, str]:
    return {name: importlib.metadata.version(name) for name in PACKAGES}


if __name__ == "__main__":
    write_trace(frozen_run(load_machine()), TRACE)
    VERSIONS.write_text(json.dumps(versions(), indent=2) + "\n")
    print(f"frozen: {TRACE}")
