"""The decoupled plant, used for fits, against the MuJoCo plant: the same loop with another integration."""

import numpy as np
import pytest

from twin.effects import with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import load_machine
from twin.simulation.decoupled_plant import DecoupledPlant, Motion
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints
from twin.units import ARCSEC

PERIOD = 1e-3


def set_points() -> np.ndarray:
    """Moves of all axes at once, out and back, the rotary ones far enough to change gravity and inertia."""
    distance = {"X": 0.02, "Y": 0.02, "Z": 0.02, "A": -0.5, "C": 0.8}
    columns = [moves_in_turn(0.0, [d, -d], 0.3, 2.0, 40.0, 0.05, PERIOD)[1] for d in distance.values()]
    length = max(map(len, columns))
    return np.column_stack([np.pad(c, (0, length - len(c)), mode="edge") for c in columns])


@pytest.fixture(scope="module")
def nominal():
    machine = load_machine()
    setpoints = Setpoints(set_points(), PERIOD)
    return machine, setpoints, simulate(machine, setpoints).trace


def decoupled_trace(machine, setpoints, nominal_trace, axes):
    """The decoupled axes, along the nominal motion."""
    index = tuple(machine.axis_names.index(a) for a in axes)
    speed = nominal_trace.matrix("velocity", axes)
    motion = Motion(nominal_trace.matrix("position", axes), speed, np.gradient(speed, PERIOD, axis=0), PERIOD)
    return simulate(machine.with_axes(axes), setpoints.part(index), plant_of=lambda change: DecoupledPlant(change, motion)).trace


@pytest.mark.parametrize("axes", [("X",), ("Y",), ("Z",), ("A", "C")])
def test_nominal_axis_agrees_with_the_engine(nominal, axes):
    machine, setpoints, trace = nominal
    alone = decoupled_trace(machine, setpoints, trace, axes)
    for axis in axes:
        bound = 0.01e-6 if axis in "XYZ" else 0.05 * ARCSEC
        assert np.abs(alone.get(axis, "position") - trace.get(axis, "position")).max() < bound
        assert np.abs(alone.get(axis, "current") - trace.get(axis, "current")).max() < 0.01


@pytest.mark.parametrize(
    "effect",
    [
        {"name": "backlash", "axis": "X", "clearance": 15e-6},
        {"name": "transmission_compliance", "axis": "X", "stiffness": 5e7},
        {"name": "presliding", "axis": "X", "stiffness": 1e8},
        {"name": "inertia", "axis": "X", "added": 500.0},
    ],
    ids=lambda e: e["name"],
)
def test_axis_with_an_effect_agrees_with_the_engine(nominal, effect):
    agrees_with_the_engine(nominal, [effect])


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_axis_with_friction_at_the_motor_agrees_with_the_engine(nominal, share):
    machine, setpoints, trace = nominal
    spring = {"name": "transmission_compliance", "axis": "X", "stiffness": 5e7}
    stribeck = {"name": "stribeck", "axis": "X", "excess": 300.0, "velocity": 0.01}
    agrees_with_the_engine((machine.with_axis("X", friction_side="motor", other_side_friction=share), setpoints, trace), [spring, stribeck])


def agrees_with_the_engine(nominal, effects):
    machine, setpoints, trace = nominal
    changed = with_effects(machine, effects)
    full = simulate(changed, setpoints).trace
    alone = decoupled_trace(changed, setpoints, trace, ("X",))
    assert np.abs(full.get("X", "position") - trace.get("X", "position")).max() > 0.1e-6  # the effect does something
    assert np.abs(alone.get("X", "position") - full.get("X", "position")).max() < 0.01e-6


def test_cached_results_are_not_used_for_other_machines(nominal):
    machine, setpoints, trace = nominal
    first = decoupled_trace(machine, setpoints, trace, ("X",)).get("X", "position")
    heavier = decoupled_trace(machine.with_values({"axis.X.moving_mass_kg": 800.0}), setpoints, trace, ("X",)).get("X", "position")
    again = decoupled_trace(machine, setpoints, trace, ("X",)).get("X", "position")
    assert np.array_equal(first, again)
    assert not np.array_equal(first, heavier)
