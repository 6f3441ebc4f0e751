"""What does half the inertia of each axis buy? On the paper's three parts and on a five-axis program.

    python examples/half_inertia/run.py [--out out/half_inertia] [--quick] [--resume]

Eleven designs (study.toml beside this file): the machine as it is, half the inertia at the motor of one axis after the other, of all
with the margins that the loops had and with the gains that they had; twice the gains on the machine as it is; twice the acceleration and jerk. Prints error, time, current and energy of each on each program, and draws
them. The mark is where the followed path cuts too deep, on the three parts. --quick: the five-axis program alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
import math
from pathlib import Path
import sys
from typing import Any

import numpy as np

from twin.errors import TwinError
from twin.progress import Progress
from twin.report import new_figure, save_png
from twin.report.figure import AMBER, BLUE, GREEN, RED
from twin.simulation.summary import table
from twin.study.design import machine_of, variants_of
from twin.study.execution import simulated, threads_here
from twin.study.paths import inertia_at_motor
from twin.study.results import Row
from twin.study.spec import Study, read_study

HERE = Path(__file__).resolve().parent
DESIGNS = (
    "as it is",
    "half X",
    "half Y",
    "half Z",
    "half A",
    "half C",
    "half, all axes",
    "half, gains kept",
    "as it is, gains x 2",
    "as it is, limits x 2",
    "half, all axes, limits x 2",
)
SHOWN = (
    ("contour_error_max_um", "largest contour error [um]"),
    ("mark_depth_um", "depth of the mark [um]"),
    ("cycle_time_s", "time [s]"),
    ("copper_loss_w", "heat of all motors [W]"),
    ("electrical_energy_j", "electrical energy [kJ]"),
    ("current_limit_used", "largest current, share of the limit [%]"),
)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/half_inertia"), metavar="DIR", help="folder for results and picture")
    parser.add_argument("--quick", action="store_true", help="the five-axis program alone")
    parser.add_argument("--resume", action="store_true", help="simulate only what the folder lacks")
    args = parser.parse_args(arguments)
    try:
        study = read_study(HERE / "study.toml")
        if args.quick:
            study = replace(study, runs=study.runs[-1:])
        variants = variants_of(study)
        with Progress("designs", total=len(variants)) as bar:
            rows, _ = simulated(study, variants, args.out, threads_here(), args.resume, bar)
    except TwinError as error:
        print(f"twin: {error}", file=sys.stderr)
        return 2
    print(
        table(
            [
                "axis",
                "inertia at the motor [kg m2]",
                "share of rotor and screw or gear",
                "remaining share of these",
                "speed gain after / before",
            ],
            shares(study),
        )
    )
    for run in study.runs:
        print(f"\n{run.name}")
        found = [numbers(row, run.name, len(study.runs) > 1) for row in rows]
        columns = [(key, label) for key, label in SHOWN if any(math.isfinite(one[key]) for one in found)]
        lines = [[name, *(said(one[key], key) for key, _ in columns)] for name, one in zip(DESIGNS, found)]
        print(table(["design", *(label for _, label in columns)], lines))
    marked = [f"{name}: {reason}" for name, (*_, reason) in zip(DESIGNS, rows) if reason]
    least = [min(value for key, value in row[2].items() if key.startswith("phase_margin_")) for row in rows if row[2]]
    print(f"\nleast phase margin of all loops and designs: {min(least):.0f} degrees")
    print("constraints: " + ("; ".join(marked) or "all kept"))
    save_png(picture(study, rows), args.out / "half_inertia.png")
    print(f"written to {args.out}: half_inertia.png")
    return 0


def shares(study: Study) -> list[list[str]]:
    """Per axis: inertia at the motor, the rotor's part of it, that part when the whole is halved, and the speed gain that is left."""
    out = []
    half = machine_of(study, np.array([0.5] * 5 + [1.0, 1.0]))
    for axis in study.machine.axes:
        whole, own, other = inertia_at_motor(study.machine, axis), axis.rotor_inertia_kg_m2, half.axis(axis.name)
        share, after = f"{100 * own / whole:.0f} %", f"{100 * other.rotor_inertia_kg_m2 / own:.0f} %"
        gain = f"{other.loops.speed_gain_nm_s_per_rad / axis.loops.speed_gain_nm_s_per_rad:.2f}"
        out.append([axis.name, f"{whole:.5f}", share, after, gain])
    return out


def numbers(row: Row, run: str, several: bool) -> dict[str, float]:
    """What is shown of one design on one program; nothing (NaN) of one that could not be run."""
    prefix = f"{run}." if several else ""
    found = {name.removeprefix(prefix): value for name, value in row[2].items() if name.startswith(prefix)}
    if not found:
        return {key: float("nan") for key, _ in SHOWN}
    return (
        {"mark_depth_um": float("nan")}
        | found
        | {
            "copper_loss_w": sum(value for name, value in found.items() if name.startswith("copper_loss_")),
            "current_limit_used": max(value for name, value in found.items() if name.startswith("current_limit_used_")),
        }
    )


def said(value: float, key: str) -> str:
    """A number of the table."""
    if math.isnan(value):
        return "-"
    if key == "current_limit_used":
        return f"{100 * value:.0f}"
    return f"{value / 1e3 if key == 'electrical_energy_j' else value:.4g}"


def picture(study: Study, rows: Sequence[Row]) -> Any:
    """Change of every number against the machine as it is, a panel each, a colour for each program."""
    found = {run.name: [numbers(row, run.name, len(study.runs) > 1) for row in rows] for run in study.runs}
    shown = [
        (key, label)
        for key, label in SHOWN
        if key != "copper_loss_w" and any(math.isfinite(one[key]) for every in found.values() for one in every)
    ]
    figure, axes = new_figure(1, len(shown), width=2.0 + 2.7 * len(shown), height=4.2, sharey=True)
    places = np.arange(len(DESIGNS))[::-1]
    for panel, (key, label) in zip(axes[0], shown):
        for (name, every), colour, offset in zip(found.items(), (BLUE, GREEN, AMBER, RED), (0.24, 0.08, -0.08, -0.24)):
            values = np.array([one[key] for one in every])
            panel.plot(100.0 * (values / values[0] - 1.0), places + offset, "o", color=colour, markersize=5.5, label=name)
        panel.axvline(0.0, color="#9aa3ab", linewidth=0.9)
        panel.set_xlabel(f"{label.split(' [')[0]}:\nchange [%]")
    axes[0][0].set_yticks(places, DESIGNS)
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    return figure


if __name__ == "__main__":
    sys.exit(main())
