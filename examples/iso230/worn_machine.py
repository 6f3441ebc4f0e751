"""A circle test of a worn machine: the second plant, with backlash on X and too little position gain on Y, measured by two scales.

    python examples/iso230/worn_machine.py out/worn
    twin diagnose out/worn --out out/worn_diagnosis
    twin iso 230-4 out/worn --diagnosis out/worn_diagnosis --json out/worn.json

The second plant shares no code with the twin. What is written is what a control records of a circle: set points and scales of two axes, both directions.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import tomllib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from twin.exam.draw import SHIPPED_MACHINE, Case, columns_of, simulate
from twin.exam.paths import limits_of
from twin.exam.plant.parameters import Richness, unit_factors
from twin.exam.programme import TestRun, _circle

SEED = 230
RADIUS, FEED, TURNS = 0.05, 0.1, 2
"""Radius of the circle [m], feed [m/s], and turns in each direction: the middle one counts."""
WORN = (
    {"name": "backlash", "axis": "X", "clearance": 12e-6},
    {"name": "position_gain", "axis": "Y", "factor": 0.92},
)


def record(folder: Path) -> None:
    """Write the campaign: the circle counter-clockwise and clockwise in one run, without feedforward."""
    folder.mkdir(parents=True, exist_ok=True)
    machine = tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8"))
    case = Case(SEED, "worn", 1.0, WORN, unit_factors(), Richness.off())
    there = _circle(0, 1, RADIUS, FEED, TURNS, limits_of(machine), np.random.default_rng(SEED))
    both = np.vstack([there, there * np.array([1.0, -1.0, 1.0, 1.0, 1.0])])
    trace = simulate(case, machine, TestRun("circle", "test", "off", both))
    columns = {key: v for key, v in columns_of(trace, ("setpoint", "position")).items() if key.startswith(("time", "X.", "Y."))}
    pq.write_table(pa.table(columns), folder / "circle.parquet", compression="zstd")
    lines = ['machine = "mikron_ucp710"', "", "[[run]]", 'file = "circle.parquet"', 'feedforward = "off"', ""]
    (folder / "campaign.toml").write_text("\n".join(lines), encoding="utf-8")


def main() -> None:
    """Record the circle test."""
    parser = argparse.ArgumentParser(description="Record a circle test of a worn machine on the second plant.")
    parser.add_argument("folder", type=Path, help="where the campaign is written")
    folder = parser.parse_args().folder
    record(folder)
    print(f"{folder}: a circle of {RADIUS * 1e3:g} mm at {FEED * 60:g} m/min in both directions, set points and scales of X and Y")


if __name__ == "__main__":
    main()
