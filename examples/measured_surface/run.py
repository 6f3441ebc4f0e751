"""A measured surface beside the cut one: the mark that a worn machine leaves, and what the twin says of it.

    python examples/measured_surface/run.py out/measured_surface

The second plant, which shares no code with the twin, makes the part with 15 % too little position gain on Z. Its surface is measured as a profilometer does:
tilted, with noise, as a `.sur` file. Then `twin cut --measured` lays it over the cut of the nominal twin.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import tomllib

import numpy as np
from sur_writer import write_sur

from twin.cli import main as twin_command
from twin.exam.draw import SHIPPED_MACHINE, Case, simulate
from twin.exam.plant.parameters import AXES, Richness, unit_factors
from twin.exam.programme import TestRun
from twin.machine.machine import Machine, load_machine
from twin.program import interpolate, read_program
from twin.recordings.trace import Trace
from twin.surface.levels import levels_of_trace
from twin.surface.machining import machine_part
from twin.surface.part import read_part

HERE = Path(__file__).resolve().parent
PROGRAM, PART = HERE / "dip.mpf", HERE / "dip.toml"
SEED = 25
WORN = 0.85
"""Position gain of Z, against the machine file's."""
NOISE, TILT, OFFSET = 5e-8, (2e-4, -1e-4), 3e-6
"""Of the profilometer: noise [m], slopes along and across, height of its zero [m]."""


def made_on_a_worn_machine(machine: Machine) -> Trace:
    """The run of the worn machine, without feedforward: where its loads truly are."""
    program = interpolate(read_program(PROGRAM, machine), machine)
    points = np.column_stack([program.get(axis, "setpoint") for axis in AXES])
    worn = Case(SEED, "worn", 1.0, ({"name": "position_gain", "axis": "Z", "factor": WORN},), unit_factors(), Richness.off())
    document = tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8"))
    made = simulate(worn, document, TestRun("dip", "program", "off", points, program.period))
    signals = {(axis, "setpoint"): made.setpoint[:, k] for k, axis in enumerate(AXES)}
    signals |= {(axis, "position"): made.load[:, k] for k, axis in enumerate(AXES)}
    return Trace(made.time, signals, program.kinds)


def measure(trace: Trace, machine: Machine, path: Path) -> float:
    """Cut the part along a run and write its zone as a profilometer sees it. Returns the true depth of the deepest point below the mean [m]."""
    part = read_part(PART)
    rays = machine_part(part, levels_of_trace(trace, machine, part.tool, ["followed"], "run")).cuts[0].finest
    height, rng = rays.map(), np.random.default_rng(SEED)
    seen = height + OFFSET + TILT[0] * rays.u + TILT[1] * rays.v[:, None] + rng.normal(0.0, NOISE, height.shape)
    write_sur(path, float(np.diff(rays.u).mean()), float(np.diff(rays.v).mean()), seen)
    return float(height.mean() - height.min())


def main() -> None:
    """Make, measure, compare."""
    parser = argparse.ArgumentParser(description="Lay a measured surface over the cut of the twin.")
    parser.add_argument("out", type=Path, help="folder for map.sur and the cut")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    machine = load_machine()
    depth = measure(made_on_a_worn_machine(machine), machine, out / "map.sur")
    print(f"{out / 'map.sur'}: the mark of the worn machine is {depth * 1e6:.1f} um deep")
    cut = ["cut", str(PROGRAM), "--part", str(PART), "--feedforward", "off", "--measured", str(out / "map.sur"), "--out", str(out)]
    raise SystemExit(twin_command([*cut, "--level", "followed"]))


if __name__ == "__main__":
    main()
