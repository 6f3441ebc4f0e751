"""Processor time and memory of a diagnosis against the length of the record and the number of axes, as a table and a picture.

    python -m devtools.measure_growth --out FOLDER [--seed 4711] [--quick] [--picture docs/pictures/growth.png]

One machine of the second plant with one fault records ten runs. It is diagnosed with the first 1, 2, 4, 7 and 10 of them, and all ten with one,
two, three and five of its axes, each in a process of its own. A cost that grows in proportion is a straight line.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
import tomllib

import numpy as np

from devtools.measure_memory import peak
from twin.exam.draw import SHIPPED_MACHINE, draw_case, write_campaign
from twin.machine.machine import Machine, load_machine, write_machine
from twin.recordings.campaign import MeasuredRun, read_campaign
from twin.report.figure import AMBER, BLUE, new_figure, save_png
from twin.simulation.campaign_file import write_campaign as write_runs

RUNS, AXES = (1, 2, 4, 7, 10), ("X", "XY", "XYZ", "XYZAC")

Point = tuple[str, float, float, float]
"""What is varied, its amount (minutes of motion or number of axes), processor time [s], memory [GB]."""


def diagnosed(machine: Machine, runs: Sequence[MeasuredRun], folder: Path, quick: bool) -> tuple[float, float]:
    """(processor time [s], memory [GB]) of a diagnosis of these runs with the axes of the machine."""
    file = folder / "machine.toml"
    folder.mkdir(parents=True, exist_ok=True)
    write_machine(machine, file)
    kept = {run.name: replace(run, trace=run.trace.select(list(machine.axis_names))) for run in runs}
    write_runs({name: run for name, run in kept.items() if any(run.trace.moves(a) for a in run.trace.axes)}, folder / "campaign")
    memory, seconds, code = peak("diagnose", folder / "campaign", "--machine", file, "--out", folder / "out", *["--quick"] * quick)
    if code not in (0, 1):
        raise RuntimeError(f"twin diagnose ended with {code} in {folder}")
    return seconds, memory


def minutes(runs: Sequence[MeasuredRun]) -> float:
    """Length of the record [min]."""
    return sum(float(run.trace.time[-1]) for run in runs) / 60.0


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=4711)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--picture", type=Path)
    args = parser.parse_args()
    tables = tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8"))
    write_campaign(draw_case(args.seed, "single", tables, axis="X"), args.out / "whole", tables)
    machine = load_machine(SHIPPED_MACHINE)
    runs = read_campaign(args.out / "whole", machine).runs
    points: list[Point] = []
    print("| varied | amount | processor time | memory |\n|---|---|---|---|")
    for what, parts in (
        ("minutes", [(machine, runs[:n], n) for n in RUNS]),
        ("axes", [(machine.with_axes(list(a)), runs, len(a)) for a in AXES]),
    ):
        for which, some, n in parts:
            seconds, memory = diagnosed(which, some, args.out / f"{what}_{n}", args.quick)
            points.append((what, minutes(some) if what == "minutes" else float(n), seconds, memory))
            print("| {} | {:.2f} | {:.0f} s | {:.2f} GB |".format(*points[-1]), flush=True)
    if args.picture:
        draw(points, args.picture)
    return 0


def draw(points: Sequence[Point], path: Path) -> None:
    """Time and memory over minutes and over axes, each with the straight line through its points."""
    figure, panels = new_figure(1, 2, height=3.2)
    for panel, (what, label) in zip(panels[0], (("minutes", "length of the record [min]"), ("axes", "axes"))):
        x, seconds, memory = np.array([p[1:] for p in points if p[0] == what]).T
        right = panel.twinx()
        for on, y, colour in ((panel, seconds, BLUE), (right, memory, AMBER)):
            on.plot(x, y, "o", color=colour)
            at = np.array([0.0, x.max()])
            on.plot(at, np.polyval(np.polyfit(x, y, 1), at), color=colour, lw=1.0)
            on.set_ylim(bottom=0.0)
        panel.set_xlabel(label)
        panel.set_ylabel("processor time [s]", color=BLUE)
        right.set_ylabel("memory [GB]", color=AMBER)
    save_png(figure, path)


if __name__ == "__main__":
    raise SystemExit(main())
