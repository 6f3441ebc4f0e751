"""How deep the mark of the paper's first part is, against inertia, position gain, feedforward and jerk of the axes.

    python examples/mark_depth_study.py                  table, and out/mark_depth_study.png

One thing is changed at a time, on all linear axes: the moved mass (the control keeps what it was commissioned with), the position
gain Kv, both feedforwards, the jerk limit of the interpolator. The mark is the deepest point against the programmed cut.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import tempfile

from parts.paper_parts import TangentPlanes

from twin.machine.machine import Machine, load_machine
from twin.report import new_figure, save_png
from twin.simulation.summary import table
from twin.surface.levels import levels_of_program
from twin.surface.machining import machine_part, report_of
from twin.surface.part import read_part

LINEAR = ("X", "Y", "Z")
FACTORS = {
    "moved mass": (0.5, 1.0, 2.0, 3.0),
    "position gain": (0.5, 1.0, 1.5, 2.0),
    "feedforward weight": (0.9, 0.95, 1.0, 1.05),
    "jerk limit": (0.25, 1.0, 4.0, 16.0),
}


def changed(machine: Machine, what: str, factor: float) -> Machine:
    """The machine with one thing multiplied on all linear axes."""
    for name in LINEAR:
        axis = machine.axis(name)
        if what == "moved mass":
            machine = machine.with_values({f"axis.{name}.moving_mass_kg": axis.moving_mass_kg * factor})
        elif what == "position gain":
            machine = machine.with_values({f"axis.{name}.loops.position_gain_per_s": axis.loops.position_gain_per_s * factor})
        elif what == "feedforward weight":
            machine = machine.with_values({f"axis.{name}.loops.{k}_feedforward": factor for k in ("velocity", "torque")})
        else:
            machine = machine.with_values({f"axis.{name}.max_jerk_m_per_s3": axis.max_jerk * factor})
    return machine


def marks(machine: Machine, folder: Path) -> dict[str, float]:
    """Depth of the mark [um] by level, slow passes left out (they do not change what the fast pass cuts deepest)."""
    shape = TangentPlanes(passes=0, tolerance=0.005)
    (folder / "part.mpf").write_text(shape.program(), encoding="utf-8")
    (folder / "part.toml").write_text(shape.part(zone_um=40.0), encoding="utf-8")
    part = read_part(folder / "part.toml")
    levels = levels_of_program(folder / "part.mpf", machine, part.tool, ("programmed", "commanded", "followed"), ("velocity+torque", "off"))
    machining = machine_part(replace(part), levels)
    return {one.level.label: report_of(machining, one)["mark"]["depth_um"] for one in machining.cuts[1:]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out") / "mark_depth_study.png")
    args = parser.parse_args()
    machine, rows, results = load_machine(), [], {}
    with tempfile.TemporaryDirectory() as folder:
        for what, factors in FACTORS.items():
            for factor in factors:
                found = marks(changed(machine, what, factor), Path(folder))
                results[what, factor] = found
                rows.append([what, f"{factor:g}", *(f"{v:.2f}" for v in found.values())])
    print("depth of the mark of part 1 (radius 20 mm, slopes 20 degrees, 10 m/min) against the programmed cut [um]")
    print(table(["changed", "times", *next(iter(results.values()))], rows, left=1))
    draw(results, args.out)
    print(args.out)


def draw(results: dict[tuple[str, float], dict[str, float]], path: Path) -> None:
    """One panel for each thing changed."""
    figure, panels = new_figure(1, len(FACTORS), width=12.0, height=3.6, sharey=True)
    colours = ("#8c929c", "#3880f0", "#d6603c")
    for axes, (what, factors) in zip(panels[0], FACTORS.items()):
        for colour, label in zip(colours, results[what, factors[0]]):
            axes.plot(factors, [results[what, f][label] for f in factors], "o-", color=colour, label=label)
        axes.set_title(what)
        axes.set_xlabel("times nominal")
        axes.set_yscale("log")
    panels[0, 0].set_ylabel("depth of the mark [um]")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_png(figure, path)


if __name__ == "__main__":
    main()
