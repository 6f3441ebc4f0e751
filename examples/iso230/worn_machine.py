"""A circle test of a worn machine: the second plant, with backlash on X and too little position gain on Y, measured by two scales.

    python examples/iso230/worn_machine.py out/worn
    twin diagnose out/worn --out out/worn_diagnosis
    twin iso 230-4 out/worn --diagnosis out/worn_diagnosis --json out/worn.json

The second plant shares no code with the twin. What is written is what a control records of a circle: set points and scales of two axes, both directions.
Beside it lies what a ballbar measures of the same run, ballbar.csv, on a machine whose axes are also out of square:

    twin iso 230-4 out/worn/ballbar.csv --radius-mm 50 --feed-mm-per-min 6000 --feedforward off --campaign out/ballbar
    twin diagnose out/ballbar --out out/ballbar_diagnosis
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
from twin.exam.plant.plant import Trace
from twin.exam.programme import TestRun, _circle

SEED = 230
RADIUS, FEED, TURNS = 0.05, 0.1, 2
"""Radius of the circle [m], feed [m/s], and turns in each direction: the middle one counts."""
WORN = (
    {"name": "backlash", "axis": "X", "clearance": 12e-6},
    {"name": "position_gain", "axis": "Y", "factor": 0.92},
)
SQUARENESS, OFF_CENTRE, BALLBAR_NOISE = 20e-6, (3e-6, -2e-6), 1e-7
"""Squareness of Y to X [rad], where the bar stands beside the centre [m], and its noise [m]."""


def record(folder: Path) -> None:
    """Write the campaign: the circle counter-clockwise and clockwise in one run, without feedforward."""
    folder.mkdir(parents=True, exist_ok=True)
    machine = tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8"))
    case = Case(SEED, "worn", 1.0, WORN, unit_factors(), Richness.off())
    there = _circle(0, 1, RADIUS, FEED, TURNS, limits_of(machine))
    both = np.vstack([there, there * np.array([1.0, -1.0, 1.0, 1.0, 1.0])])
    print("recording on the second plant, which is compiled first", flush=True)
    trace = simulate(case, machine, TestRun("circle", "test", "off", both))
    columns = {key: v for key, v in columns_of(trace, ("setpoint", "position")).items() if key.startswith(("time", "X.", "Y."))}
    pq.write_table(pa.table(columns), folder / "circle.parquet", compression="zstd")
    lines = ['machine = "mikron_ucp710"', "", "[[run]]", 'file = "circle.parquet"', 'feedforward = "off"', ""]
    (folder / "campaign.toml").write_text("\n".join(lines), encoding="utf-8")
    write_ballbar(trace, folder / "ballbar.csv")


def write_ballbar(trace: Trace, file: Path) -> None:
    """The middle turn of each direction as a ballbar measures it, a reading each 0.5 degrees."""
    scales = trace.setpoint[:, :2]
    centre = 0.5 * (scales.min(axis=0) + scales.max(axis=0))
    tool = trace.load[:, :2] - centre + SQUARENESS * np.outer(trace.load[:, 1] - centre[1], [1.0, 0.0]) + OFF_CENTRE
    angle, rng = np.unwrap(np.arctan2(tool[:, 1], tool[:, 0])), np.random.default_rng(SEED)
    on_circle = np.hypot(*(scales - centre).T) > 0.999 * RADIUS
    lines = ["direction,angle_deg,deviation_um"]
    for direction, sign in (("ccw", 1.0), ("cw", -1.0)):
        rows = np.flatnonzero(on_circle & (sign * np.gradient(angle) > 0.5 * FEED / RADIUS * 1e-3))
        rows = rows[: np.flatnonzero(np.diff(rows) > 1)[0] + 1] if (np.diff(rows) > 1).any() else rows
        start = angle[rows[0]] + 0.5 * (angle[rows[-1]] - angle[rows[0]] - sign * 2.0 * np.pi)
        at = start + sign * np.radians(np.arange(0.0, 360.1, 0.5))
        radius = np.interp(sign * at, sign * angle[rows], np.hypot(*tool[rows].T)) + rng.normal(0.0, BALLBAR_NOISE, len(at))
        lines += [f"{direction},{np.degrees(a):.4f},{(r - RADIUS) * 1e6:.4f}" for a, r in zip(at, radius)]
    file.write_text("\n".join([*lines, ""]), encoding="utf-8")


def main() -> None:
    """Record the circle test."""
    parser = argparse.ArgumentParser(description="Record a circle test of a worn machine on the second plant.")
    parser.add_argument("folder", type=Path, help="where the campaign is written")
    folder = parser.parse_args().folder
    record(folder)
    print(
        f"{folder}: a circle of {RADIUS * 1e3:g} mm at {FEED * 60:g} m/min in both directions, set points and scales of X and Y; ballbar.csv"
    )


if __name__ == "__main__":
    main()
