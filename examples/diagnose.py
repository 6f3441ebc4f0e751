"""Can the twin say what is wrong with a machine? A machine with a hidden effect is recorded, then diagnosed without being told.

    python examples/diagnose.py [--effect backlash] [--axis X] [--seed 1] [--out out/diagnose]

The machine is the examination's plant, which shares no law with the twin: its parameters are spread, its friction is another, its
signals are rounded and noisy. Two short runs are recorded, a slow reversal and a few accelerations.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import tomllib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from twin.diagnose import diagnose
from twin.diagnose.output import summary_text, write_diagnosis
from twin.exam.draw import SIGNALS, Case, columns_of, draw_case, simulate
from twin.exam.plant.parameters import AXES
from twin.exam.programme import TestRun
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import default_machine_path, load_machine
from twin.recordings.campaign import read_campaign


def short_runs(axis: str) -> list[TestRun]:
    """A slow reversal in small and large steps, and accelerations, of one axis (1 kHz)."""
    one = 1.0 if axis in "XYZ" else 8.0  # linear axes in m, rotary ones in rad
    slow = moves_in_turn(0.0, [0.002 * one, -0.002 * one, 20e-6 * one, -20e-6 * one], 0.006 * one, 1.0, 50.0, 0.05, 1e-3)[1]
    fast = moves_in_turn(0.0, [0.04 * one, -0.04 * one, 0.02 * one, -0.02 * one], 0.15 * one, 2.0 * one, 50.0 * one, 0.1, 1e-3)[1]
    runs = []
    for name, feedforward, position in (("reversal", "velocity+torque", slow), ("acceleration", "velocity", fast)):
        set_points = np.zeros((len(position), len(AXES)))
        set_points[:, AXES.index(axis)] = position
        runs.append(TestRun(name, "test", feedforward, set_points))
    return runs


def record(case: Case, runs: list[TestRun], axes: str, folder: Path, machine: dict) -> None:
    """Record the runs on the case's machine, the columns of some axes only, and write them as a campaign."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f'machine = "{machine["name"]}"']
    for run in runs:
        columns = columns_of(simulate(case, machine, run), SIGNALS["full"])
        seen = {name: values for name, values in columns.items() if name.startswith("time") or name[0] in axes}
        pq.write_table(pa.table(seen), folder / f"{run.name}.parquet")
        lines.append(f'[[run]]\nfile = "{run.name}.parquet"\nfeedforward = "{run.feedforward}"')
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--effect", default="backlash", help="hidden effect; `twin effects` lists them")
    parser.add_argument("--axis", default="X", choices=AXES)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/diagnose"), metavar="DIR", help="folder for campaign and diagnosis")
    args = parser.parse_args()
    table = tomllib.loads(default_machine_path().read_text(encoding="utf-8"))
    case = draw_case(args.seed, "single", table, effect=args.effect, axis=args.axis)
    record(case, short_runs(args.axis), args.axis, args.out / "campaign", table)

    machine = load_machine()
    document = write_diagnosis(diagnose(read_campaign(args.out / "campaign", machine), machine, quick=True), args.out)
    print(summary_text(document))
    print(f"hidden: {case.effects[0]}")
    print(f"report: {args.out / 'report.html'}; corrected machine: {args.out / 'machine.toml'}")


if __name__ == "__main__":
    main()
