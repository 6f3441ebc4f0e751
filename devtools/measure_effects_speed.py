"""Processing time of effects: the loop with effects over bare `mj_step` of the same, larger model.

    python devtools/measure_effects_speed.py [--seconds 60]

Measured like scripts/benchmark. Prints the nominal machine, machines with compliance and backlash, and one with all effects.
"""

from __future__ import annotations

import argparse
import statistics

import mujoco
import numpy as np

from devtools.benchmark import BareEngine, in_turns, moving_setpoints
from twin.effects import EFFECTS, Effect, apply_effects, with_effects
from twin.machine.machine import Machine, load_machine
from twin.simulation.engine_calls import engine_function_address
from twin.simulation.plant_spec import build_plant
from twin.simulation.prepared import STRETCH_TICKS

TWO_EFFECTS = [
    {"name": "transmission_compliance", "axis": "X", "stiffness": 8e7},
    {"name": "backlash", "axis": "Y", "clearance": 15e-6},
]


class EngineWithRotors(BareEngine):
    """The model with effects, rotors on joints of their own, at steady speed and advanced by `mj_step` alone."""

    def __init__(self, machine: Machine, velocity: np.ndarray) -> None:
        change = apply_effects(machine)
        self.plant = plant = build_plant(change.machine, change.model_edits, tuple(change.couplings))
        model, data = plant.model, plant.data
        data.qvel[plant.load_dof] = data.qvel[plant.rotor_dof] = velocity
        mujoco.mj_forward(model, data)
        # forces on the loads balance gravity and friction, so that the speed stays constant
        data.qfrc_applied[plant.load_dof] = (
            data.qfrc_bias[plant.load_dof]
            + np.sign(velocity) * [a.coulomb_friction for a in change.machine.axes]
            - data.qfrc_passive[plant.load_dof]
        )
        self.start = mujoco.MjData(model)
        mujoco.mj_copyData(self.start, model, data)
        self.step = engine_function_address("mj_step")
        self.seconds(100)


def effects_of(machine: Machine) -> list[Effect]:
    """The effects that an axis of the machine can have: no parts of control blocks that its file does not list."""
    return [effect for effect in EFFECTS.values() if effect.axes(machine)]


def usual_effects(machine: Machine) -> list[dict[str, object]]:
    """Every effect at the low end of its usual size, each on one axis, the axes in turn."""
    tables = []
    for i, effect in enumerate(effects_of(machine)):
        axes = effect.axes(machine)
        axis = axes[i % len(axes)]
        source = {"from_axis": next(a.name for a in axes if a is not axis)} if effect.from_axis else {}
        sizes = {p.name: p.usual_range(machine, axis)[0] for p in effect.parameters if not p.shape}
        tables.append({"name": effect.name, "axis": axis.name, **source, **sizes})
    return tables


def ratio(machine: Machine, seconds: float) -> tuple[float, float, float]:
    """Loop over engine, and microseconds per tick of loop and engine."""
    setpoints = moving_setpoints(machine, seconds)
    engine = EngineWithRotors(machine, np.array([0.05 if axis.kind == "linear" else 0.2 for axis in machine.axes]))
    pairs = list(zip(*in_turns(machine, setpoints, engine)))
    tick = 1e6 / STRETCH_TICKS
    return (
        statistics.median(a / b for a, b in pairs),
        statistics.median(a for a, _ in pairs) * tick,
        statistics.median(b for _, b in pairs) * tick,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="machine time to simulate (default: 60, at least 8)")
    args = parser.parse_args()
    machine = load_machine()
    cases = {
        "nominal": [],
        "compliance on X, backlash on Y": TWO_EFFECTS,
        "compliance and backlash on X": [{**t, "axis": "X"} for t in TWO_EFFECTS],
        f"all {len(effects_of(machine))} effects at once": usual_effects(machine),
    }
    print("loop over bare mj_step of the same model; us per tick of loop and engine")
    for name, effects in cases.items():
        print("{:6.2f} {:8.2f} {:8.2f}  {}".format(*ratio(with_effects(machine, effects), max(args.seconds, 8.0)), name))


if __name__ == "__main__":
    main()
