#!/usr/bin/env python3
"""Draws the pictures of docs/programs.md: feed over the path of an example, corner rounding, error budget.

python devtools/picture_program.py
"""

from __future__ import annotations

from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from twin.machine.machine import load_machine  # noqa: E402
from twin.program import error_budget, interpolate, plot_budget, plot_feed, read_program  # noqa: E402
from twin.simulation.run import simulate  # noqa: E402
from twin.simulation.setpoints import setpoints_of  # noqa: E402


def main() -> None:
    machine, pictures = load_machine(), ROOT / "docs" / "pictures"
    for name in ("five_axis", "two_planes"):
        program = read_program(ROOT / "examples" / f"{name}.mpf", machine)
        setpoints = interpolate(program, machine)
        plot_feed(setpoints, pictures / f"feed_{name}.png", f"{name}.mpf")
        run = simulate(machine.with_feedforward(program.feedforward), setpoints_of(setpoints, machine))
        plot_budget(error_budget(program, setpoints, run.trace, machine), pictures / f"budget_{name}.png", f"{name}.mpf")


if __name__ == "__main__":
    main()
