"""Laws that the library does not list, in the twin and in the second plant: the same machine, by two implementations.

The second plant has its own equations, its own integrator and steps eight times finer.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.conftest import swings
from tests.reference.test_dsc import fine_measuring
from twin.effects import load_inertia, with_effects
from twin.errors import InputError
from twin.exam.plant.parameters import AXES, settings_of, unit_factors
from twin.exam.plant.plant import run
from twin.machine.machine import Machine
from twin.simulation.run import simulate

SPRING_HZ = 60.0
REACH = 3e-6  # windup at which the hardening spring is twice as stiff


def spring_of(machine: Machine) -> tuple[float, float]:
    """Stiffness and damping of a drive train of X."""
    load = load_inertia(machine, machine.axis("X"))
    stiffness = (2.0 * math.pi * SPRING_HZ) ** 2 * load
    return stiffness, 2.0 * 0.3 * math.sqrt(stiffness * load)


def law(block: str, output: str, variable: str, formula: str, **numbers: float) -> dict:
    return {"name": "law", "axis": "X", "block": block, "output": output, "variables": [variable], "formula": formula, **numbers}


def compliance(stiffness: float, damping: float) -> dict:
    return {"name": "transmission_compliance", "axis": "X", "stiffness": stiffness, "damping": damping}


def cases(machine: Machine) -> dict[str, tuple[list[dict], dict[str, float], float]]:
    """Effects of the twin, settings of the second plant, and the position that they may differ by (RMS) [m]."""
    k, b = spring_of(machine)
    hard = 16.0 * k  # of the stiff stage of a lost motion
    soft, half = 0.05, 8e-6
    return {
        "notch": (
            [law("speed controller", "current", "current_setpoint", "notch", width=0.8, frequency_hz=120.0)],
            {"notch_hz": 120.0, "notch_width": 0.8},
            0.05e-6,
        ),
        "smoothing": (
            [law("position controller", "received_speed", "speed_setpoint", "lag", time_constant_s=4e-3)],
            {"speed_lag": 4e-3},
            0.2e-6,
        ),
        "inverter": (
            [law("current loop", "voltage", "current", "saturation", height=-15.0, scale=0.2)],
            {"dead_time_v": 15.0},
            0.1e-6,
        ),
        "late record": ([law("measurement", "current", "current", "dead time", time_s=4e-3)], {"skew_s": 4e-3}, 0.05e-6),
        "hardening": (
            [compliance(k, b), law("transmission", "force", "windup", "power", height=k * REACH, reach=REACH, n=3.0)],
            {"stiffness": k, "damping": b, "hardening": 1.0 / REACH**2},
            0.05e-6,
        ),
        "two stages": (
            [compliance(hard, b), law("transmission", "force", "windup", "stage", height=-(1.0 - soft) * hard * half, width=half)],
            {"stiffness": hard, "damping": b, "soft_gap": 2.0 * half, "soft_share": soft},
            0.1e-6,
        ),
    }


@pytest.mark.parametrize("name", ["notch", "smoothing", "inverter", "late record", "hardening", "two stages"])
def test_twin_and_second_plant_agree(mikron: Machine, name: str) -> None:
    effects, there, allowed = cases(mikron)[name]
    machine = fine_measuring(mikron)
    points = swings(machine, 0.6)
    trace = simulate(with_effects(machine, effects), points).trace
    settings = settings_of(dict(machine.document), unit_factors())
    for field, value in there.items():
        getattr(settings, field)[AXES.index("X")] = value
    other = run(settings, points.position, noise=False)
    nominal = simulate(machine, points).trace
    signal = "current" if name == "late record" else "motor_position"
    # the effect of the law is much larger than the difference of the two plants
    tolerance = 0.005 * np.ptp(other.current[:, 0]) if name == "late record" else allowed
    assert np.sqrt(np.mean((nominal.get("X", signal) - trace.get("X", signal)) ** 2)) > 3.0 * tolerance
    assert np.sqrt(np.mean((trace.get("X", "position") - other.position[:, 0]) ** 2)) < allowed
    assert np.sqrt(np.mean((trace.get("X", "motor_position") - other.motor_position[:, 0]) ** 2)) < allowed
    assert np.sqrt(np.mean((trace.get("X", "current") - other.current[:, 0]) ** 2)) < 0.005 * np.ptp(other.current[:, 0])


def test_a_law_over_the_windup_needs_a_spring(mikron: Machine) -> None:
    effect = law("transmission", "force", "windup", "power", height=100.0, reach=REACH, n=3.0)
    with pytest.raises(InputError, match="needs a spring"):
        simulate(with_effects(mikron, [effect]), swings(mikron, 0.1))
