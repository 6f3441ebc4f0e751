"""Diagnose a user effect: one file with its law, a simulated campaign, a diagnosis.

    python examples/own_effect/run.py [--out out/own_effect]

Each step is a command, printed before it runs. The twin records the campaign with the effect and with measuring noise. This shows that all
commands use the file; the diagnosis of a real machine is harder.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

import numpy as np
import pyarrow.parquet as pq

from twin.cli import main as twin
from twin.geometry.scurve import moves_in_turn

EFFECT = Path(__file__).with_name("load_friction.py")
SIGNALS = ("setpoint", "position", "motor_position", "velocity", "velocity_setpoint", "current")
MOVES = {"gentle": (0.06, 0.1, 0.5, 5.0), "brisk": (0.15, 0.25, 2.0, 5.0), "mixed": (0.08, 0.2, 0.8, 5.0)}
"""Distance [m], speed [m/s], acceleration [m/s2] and jerk [m/s3] of the forward and return move of each run."""


def command(*words: object) -> None:
    """Run a command; an error ends the example."""
    arguments = [str(word) for word in words]
    print("twin", " ".join(arguments))
    if code := twin(arguments):
        sys.exit(code)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/own_effect"), metavar="DIR", help="folder for campaign and diagnosis")
    out = parser.parse_args().out
    campaign = out / "campaign"
    campaign.mkdir(parents=True, exist_ok=True)
    lines = ['machine = "mikron_ucp710"']
    for seed, (name, (distance, speed, acceleration, jerk)) in enumerate(MOVES.items()):
        time, position = moves_in_turn(0.0, [distance, -distance], speed, acceleration, jerk, 0.1, 1e-3)
        strokes = out / f"{name}.csv"
        np.savetxt(strokes, np.column_stack([time, 1e3 * position]), "%.6f", ",", header="time [s],X.setpoint [mm]", comments="")
        with_it = ("--effects", EFFECT, "--effect", "load_friction:X:coefficient=0.3")
        command("run", strokes, *with_it, "--noise-seed", seed, "--no-recording", "--out", out / name)
        # keep the signals that a control records of the moving axis
        recorded = pq.read_table(out / name / "trace.parquet")
        seen = [c for c in recorded.column_names if c.split(" ")[0] in ("time", *(f"X.{signal}" for signal in SIGNALS))]
        pq.write_table(recorded.select(seen), campaign / f"{name}.parquet")
        lines.append(f'[[run]]\nfile = "{name}.parquet"\nfeedforward = "velocity+torque"')
    (campaign / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")

    command("effects", "load_friction", "--effects", EFFECT, "--picture", out / "load_friction.png")
    command("diagnose", campaign, "--effects", EFFECT, "--quick", "--out", out)
    command("gap", campaign, "--machine", out / "machine.toml", "--effects", EFFECT)


if __name__ == "__main__":
    main()
