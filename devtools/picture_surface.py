"""Make the pictures of docs/surface.md: the paper's three parts as cut by the twin.

python devtools/picture_surface.py                    docs/pictures/surface/*.png, about two minutes
"""

from __future__ import annotations

import argparse
from pathlib import Path

from twin.machine.machine import load_machine
from twin.surface.levels import levels_of_program
from twin.surface.machining import machine_part
from twin.surface.paper_parts import PARTS
from twin.surface.part import read_part
from twin.surface.picture import draw_cut, draw_levels

ROOT = Path(__file__).resolve().parent.parent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "pictures" / "surface")
    args = parser.parse_args()
    machine = load_machine()
    for name in PARTS:
        part = read_part(ROOT / "examples" / "parts" / f"{name}.toml")
        program = ROOT / "examples" / "parts" / f"{name}.mpf"
        levels = levels_of_program(program, machine, part.tool, ("programmed", "commanded", "followed"), ("velocity+torque", "off"))
        machining = machine_part(part, levels)
        draw_cut(machining, machining.cuts[-1], args.out / f"{name}_off.png")
        draw_levels(machining, part.surfaces[0].name, args.out / f"{name}_levels.png")
        print(args.out / f"{name}_off.png", args.out / f"{name}_levels.png")


if __name__ == "__main__":
    main()
