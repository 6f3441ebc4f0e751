"""Replay a machine that is described by a URDF: here a small gantry that draws a spiral with its tilted spindle.

    python examples/replay_urdf.py                          opens the viewer
    python examples/replay_urdf.py --screenshot gantry.png  renders a picture, without a display

The trace is an ordinary one: columns named after the joints of the URDF, `x.position [mm]`, `b.position [deg]`.
With a trace of your own:  twin replay examples/gantry/gantry.urdf my_trace.csv
"""

from pathlib import Path
import sys
import tempfile

import numpy as np

from twin.cli import main as twin_command
from twin.recordings.trace import Trace, write_trace

GANTRY = Path(__file__).resolve().parent / "gantry" / "gantry.urdf"


def spiral(seconds: float = 8.0, period: float = 5e-3) -> Trace:
    """Joint positions of a spiral whose tool tilts by 25 degrees; it starts and ends at rest."""
    time = np.arange(round(seconds / period) + 1) * period
    part = time / seconds
    part = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    turn, radius = 2.0 * np.pi * 4.0 * part, 0.05 + 0.20 * part
    signals = {
        ("x", "position"): radius * np.cos(turn),
        ("y", "position"): 0.15 + radius * np.sin(turn),
        ("z", "position"): -0.03 - 0.05 * part,
        ("b", "position"): np.radians(25.0) * np.sin(turn),
    }
    return Trace(time, signals, {"x": "linear", "y": "linear", "z": "linear", "b": "rotary"})


def spindle_mesh() -> object:
    """The mesh of the spindle in mm, turned from its outline; `examples/gantry/spindle.stl` was written by this."""
    import trimesh

    outline = [(0, 60), (34, 60), (34, -20), (28, -48), (16, -60), (16, -78), (6, -90), (6, -132), (0, -140)]
    return trimesh.creation.revolve(np.array(outline[::-1], float), sections=36)


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder) / "spiral.csv"
        write_trace(spiral(), trace)
        return twin_command(["replay", str(GANTRY), str(trace), *sys.argv[1:]])


if __name__ == "__main__":
    raise SystemExit(main())
