"""Effects of friction, against the closed form of the force at constant speed and over a creeping move."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.builders.one_axis import TICK, axis_of, follow, missing_force, steady, swing, total_inertia

TOLERANCE = 2e-3
"""Remaining acceleration force at the end of a steady move, as a share of the Coulomb level."""


def force_at_speed(speed, effects, axis="X"):
    """Motor force over the last 40 ms of a steady move, acceleration taken out; N or Nm against the motion."""
    a = axis_of(axis)
    seconds = 0.8 if abs(speed) < 0.01 else 0.4
    trace = follow(axis, steady(speed, seconds), effects)
    last = slice(-321, -1)
    pull = trace.get(axis, "torque")[last].mean() / a.ratio
    return pull - total_inertia(axis) * (trace.get(axis, "velocity")[-1] - trace.get(axis, "velocity")[-321]) / (320 * TICK)


@pytest.mark.parametrize("axis", ["X", "C"])
@pytest.mark.parametrize("speed", [0.004, -0.05])
def test_coulomb_and_viscous_friction(axis, speed):
    """sign(v) factor Fc + factor' b v at every speed."""
    a = axis_of(axis)
    expected = 1.4 * math.copysign(a.coulomb_friction, speed) + 0.6 * a.viscous_friction * speed
    found = force_at_speed(speed, [{"name": "coulomb_friction", "factor": 1.4}, {"name": "viscous_friction", "factor": 0.6}], axis)
    assert found == pytest.approx(expected, abs=TOLERANCE * a.coulomb_friction)


@pytest.mark.parametrize("speed", [0.001, 0.004, 0.012, -0.004])
def test_stribeck(speed):
    """Fc + excess exp(-(v / velocity)^2)."""
    a = axis_of("X")
    level = a.coulomb_friction + 600.0 * math.exp(-((speed / 0.004) ** 2))
    found = force_at_speed(speed, [{"name": "stribeck", "excess": 600.0, "velocity": 0.004}])
    assert found == pytest.approx(math.copysign(level, speed) + a.viscous_friction * speed, abs=5 * TOLERANCE * a.coulomb_friction)


@pytest.mark.parametrize("speed", [0.1, -0.1])
def test_viscous_asymmetry(speed):
    """b v (1 + fraction sign v)."""
    a = axis_of("X")
    expected = math.copysign(a.coulomb_friction, speed) + a.viscous_friction * speed * (1.0 + 0.3 * math.copysign(1.0, speed))
    assert force_at_speed(speed, [{"name": "viscous_asymmetry", "fraction": 0.3}]) == pytest.approx(
        expected, abs=TOLERANCE * a.coulomb_friction
    )


@pytest.mark.parametrize("speed", [0.1, -0.1])
def test_position_dependent_friction(speed):
    """sign(v) Fc (1 + fraction sin(2 pi q / wavelength)) along the travel, and its line at that wavelength alone."""
    a = axis_of("X")
    trace = follow("X", steady(speed, 0.8), [{"name": "position_dependent_friction", "fraction": 0.4, "wavelength": 0.02}])
    force = -missing_force(trace, "X")[-4800:]
    q = trace.get("X", "position")
    q = (q[1:] + q[:-1])[-4800:] / 2
    expected = math.copysign(a.coulomb_friction, speed) * (1.0 + 0.4 * np.sin(2 * np.pi * q / 0.02))
    assert np.abs(force - expected).max() < 0.01 * a.coulomb_friction


def test_presliding_breaks_away_as_a_spring():
    """Creeping from rest the contact gives F = Fc (1 - exp(-k x / Fc)): stiffness k at first, 63 % of Fc after Fc / k."""
    a = axis_of("X")
    stiffness = a.coulomb_friction / 10e-6
    trace = follow(
        "X", np.maximum(np.arange(1201) * 1e-3 - 0.02, 0.0) * 50e-6, [{"name": "presliding", "stiffness": stiffness, "damping": 0.0}]
    )
    x = trace.get("X", "position")
    x = (x[1:] + x[:-1]) / 2
    force = -missing_force(trace, "X")
    moving = x > 0.2e-6
    expected = a.coulomb_friction * -np.expm1(-stiffness * x[moving] / a.coulomb_friction)
    assert np.abs(force[moving] - expected).max() < 0.01 * a.coulomb_friction
    early = (x > 0.05e-6) & (x < 0.5e-6)
    assert np.polyfit(x[early], force[early], 1)[0] == pytest.approx(stiffness, rel=0.05)
    broken = np.interp(a.coulomb_friction / stiffness, x, force)
    assert broken == pytest.approx((1 - math.exp(-1)) * a.coulomb_friction, rel=0.01)


@pytest.mark.parametrize("shape", [{}, {"damping": 3e5}, {"excess": 500.0, "velocity": 0.003}])
def test_presliding_in_small_oscillations(shape):
    """Hysteresis of small oscillations: another integrator of the bristle equation gives the same force for the motion of the twin."""
    a = axis_of("X")
    stiffness = a.coulomb_friction / 8e-6
    bristle = {"name": "presliding", "stiffness": stiffness, "damping": shape.get("damping", 0.0)}
    stribeck = [{"name": "stribeck", **shape}] if "excess" in shape else []
    trace = follow("X", swing(30e-6, 8.0, 0.4), [bristle, *stribeck])
    t, v = trace.time, trace.get("X", "velocity")

    def rate(at, z):
        speed = np.interp(at, t, v)
        level = a.coulomb_friction + shape.get("excess", 0.0) * math.exp(-((speed / shape.get("velocity", 1.0)) ** 2))
        return speed - stiffness * abs(speed) * z / level

    z = solve_ivp(rate, (0.0, t[-1]), [0.0], t_eval=t, max_step=TICK, rtol=1e-8, atol=1e-12).y[0]
    bent = stiffness * z + bristle["damping"] * np.array([rate(at, zi) for at, zi in zip(t, z)])
    force = -missing_force(trace, "X")
    assert np.abs(force - (bent[1:] + bent[:-1]) / 2).max() < 0.01 * a.coulomb_friction


@pytest.mark.parametrize(
    "effects",
    [
        [{"name": "presliding", "stiffness": 5e7}, {"name": "stribeck", "excess": 500.0, "velocity": 0.003}],
        [{"name": "viscous_asymmetry", "fraction": 0.3}, {"name": "coulomb_friction", "factor": 1.3}],
    ],
)
def test_recorded_friction_closes_the_balance(effects):
    """The recorded friction is the motor force minus that of the mass at every tick, including the friction of effects."""
    a = axis_of("X")
    trace = follow("X", swing(3e-3, 8.0, 0.4), effects)
    recorded = trace.get("X", "torque_friction")[:-1] / a.ratio
    assert np.abs(recorded + missing_force(trace, "X", viscous=0.0)).max() < 0.01 * a.coulomb_friction
