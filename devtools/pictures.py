"""Draws pictures of the documentation.

python devtools/pictures.py exam DIR       docs/results.md, from the folder that `twin exam --out DIR` wrote
python devtools/pictures.py program        docs/programs.md: feed over the path, error budget
python devtools/pictures.py regress        docs/regression.md: a failed case
python devtools/pictures.py surface        docs/surface.md: the paper's three parts; about two minutes
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys
import tempfile

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from twin.machine.machine import load_machine  # noqa: E402

PICTURES = ROOT / "docs" / "pictures"


def exam(folder: Path) -> None:
    """The score of an examination against its targets, and beside three simpler methods."""
    from twin.exam.report import sections_of

    score, beside, *_ = sections_of(json.loads((folder / "exam.json").read_text(encoding="utf-8")))
    for name, section in (("exam_score", score), ("exam_methods", beside)):
        (PICTURES / f"{name}.svg").write_text(section.figures[0].svg, encoding="utf-8")


def program() -> None:
    """Feed over the path and error budget of two example programs."""
    from twin.program import error_budget, interpolate, plot_budget, plot_feed, read_program
    from twin.simulation.run import simulate
    from twin.simulation.setpoints import setpoints_of

    machine = load_machine()
    for name in ("five_axis", "two_planes"):
        read = read_program(ROOT / "examples" / f"{name}.mpf", machine)
        setpoints = interpolate(read, machine)
        plot_feed(setpoints, PICTURES / f"feed_{name}.png", f"{name}.mpf")
        run = simulate(machine.with_feedforward(read.feedforward), setpoints_of(setpoints, machine))
        plot_budget(error_budget(read, setpoints, run.trace, machine), PICTURES / f"budget_{name}.png", f"{name}.mpf")


def regress() -> None:
    """Evidence of a case that fails because the friction of X is 2 % up."""
    from dataclasses import replace

    from twin.regress.golden import read_golden
    from twin.regress.run_suite import compared
    from twin.regress.suite import read_suite

    case = next(c for c in read_suite(ROOT / "examples/regression/nominal.toml") if c.name == "x_feedforward_torque")
    golden = read_golden(case)
    friction = load_machine().document["axis"]["X"]["coulomb_friction_nm"]
    changed = replace(case, table={**case.table, "values": {"axis.X.coulomb_friction_nm": 1.02 * friction}})
    with tempfile.TemporaryDirectory() as folder:
        verdict = compared(changed, golden, Path(folder))
        (PICTURES / "regress_failed.png").write_bytes((Path(folder) / case.name / "plot.png").read_bytes())
    print(verdict.text)


def surface() -> None:
    """The paper's three parts as cut by the twin, with feedforward off and level by level."""
    from twin.surface.levels import LEVELS, levels_of_program
    from twin.surface.machining import machine_part
    from twin.surface.paper_parts import PARTS
    from twin.surface.part import read_part
    from twin.surface.picture import draw_cut, draw_levels

    for name in PARTS:
        file = ROOT / "examples" / "parts" / f"{name}.toml"
        part = read_part(file)
        levels = levels_of_program(file.with_suffix(".mpf"), load_machine(), part.tool, LEVELS, ("velocity+torque", "off"))
        machining = machine_part(part, levels)
        draw_cut(machining, machining.cuts[-1], PICTURES / "surface" / f"{name}_off.png")
        draw_levels(machining, part.surfaces[0].name, PICTURES / "surface" / f"{name}_levels.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True, dest="what")
    commands.add_parser("exam").add_argument("folder", type=Path, metavar="DIR")
    for name in ("program", "regress", "surface"):
        commands.add_parser(name)
    args = parser.parse_args()
    if args.what == "exam":
        exam(args.folder)
    else:
        {"program": program, "regress": regress, "surface": surface}[args.what]()


if __name__ == "__main__":
    main()
