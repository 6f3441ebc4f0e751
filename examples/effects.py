"""What does 15 um of backlash look like? A machine with effects, a slow reversal, and what motor and scale show of it.

    python examples/effects.py [--out out/effects]

Moves X slowly out and back on the nominal machine, with backlash, and with backlash, compliance and more friction at once;
prints the gap between motor and scale beside the closed form; writes the loose machine as a file for `twin run --machine`.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from twin.effects import load_inertia, with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine, load_machine, write_machine
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

CLEARANCE = 15e-6
BACKLASH = {"name": "backlash", "axis": "X", "clearance": CLEARANCE}
MORE = [
    {"name": "transmission_compliance", "axis": "X", "stiffness": 1.2e8},
    {"name": "coulomb_friction", "axis": "X", "factor": 1.4},
]
SPEED = 0.002


def gap_at_reversal(machine: Machine) -> float:
    """Motor minus scale on the way out, less that on the way back [m]."""
    few = machine.with_axes(["X"])
    times, position = moves_in_turn(0.0, [0.002, -0.002], SPEED, 0.5, 50.0, 0.05, 1e-3)
    trace = simulate(few, Setpoints(position[:, None], 1e-3)).trace
    gap = trace.get("X", "motor_position") - trace.get("X", "position")
    speed = np.gradient(position, times)
    return float(np.median(gap[speed > 0.99 * SPEED]) - np.median(gap[speed < -0.99 * SPEED]))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/effects"), metavar="DIR", help="folder for the machine file")
    out = parser.parse_args().out
    nominal = load_machine()
    loose = with_effects(nominal, [BACKLASH])
    worn = with_effects(nominal, [BACKLASH, *MORE])

    # the contact's spring and the screw's are in series; friction winds them up to either side
    x = nominal.axis("X")
    load, rotor = load_inertia(nominal, x), x.reflected_inertia
    contact = (2.0 * math.pi * 450.0) ** 2 * load * rotor / (load + rotor)
    friction = x.coulomb_friction + x.viscous_friction * SPEED
    more_friction = friction + 0.4 * x.coulomb_friction
    expected = (0.0, CLEARANCE + 2.0 * friction / contact, CLEARANCE + 2.0 * more_friction * (1.0 / contact + 1.0 / 1.2e8))

    print("motor minus scale over a slow reversal of X, um: simulated, closed form")
    for name, machine, closed in zip(("nominal", "backlash", "and compliance, friction"), (nominal, loose, worn), expected):
        print(f"{gap_at_reversal(machine) * 1e6:8.2f} {closed * 1e6:8.2f}  {name}")

    write_machine(loose, out / "loose_x.toml")
    print(f"written: {out / 'loose_x.toml'}; try: twin run examples/x_200mm.csv --machine {out / 'loose_x.toml'}")


if __name__ == "__main__":
    main()
