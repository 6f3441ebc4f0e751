"""Keys of an axis' mechanics: a structural mode against the exact solution of its two masses, pre-sliding against the effect of that name."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.builders.other_structures import write_slides
from tests.conftest import swings
from tests.reference.test_dsc import fine_measuring
from twin.effects import with_effects
from twin.errors import InputError
from twin.exam.plant.parameters import settings_of, unit_factors
from twin.exam.plant.plant import run
from twin.machine.machine import Machine, load_machine
from twin.simulation.decoupled_plant import DecoupledPlant
from twin.simulation.nominal_motion import nominal_motion
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints
from twin.units import ARCSEC

FREQUENCY_HZ, SHARE, DAMPING = 30.0, 0.4, 0.05
MODE = {"mode_frequency_hz": FREQUENCY_HZ, "mode_mass_share": SHARE, "mode_damping_ratio": DAMPING}


def frictionless(folder: Path) -> Machine:
    """Z: load and rotor in the moving mass alone, no friction, a speed controller on a current."""
    free = {
        "coulomb_friction_nm": 0.0,
        "viscous_friction_nm_s_per_rad": 0.0,
        "rotor_and_screw_inertia_kg_m2": 1e-12,
        "loops.speed_gain_nm_s_per_rad": 5e-3,
    }
    machine = load_machine(write_slides(folder)).with_axes(["Z"])
    return machine.with_values({"gravity_m_per_s2": 0.0, **{f"axis.Z.{k}": v for k, v in free.items()}})


def on_a_mode(machine: Machine, name: str) -> Machine:
    return machine.with_values({f"axis.{name}.{k}": v for k, v in MODE.items()})


def strokes(machine: Machine) -> Setpoints:
    t = np.arange(800) * 1e-3
    return Setpoints((5e-3 * (1.0 - np.cos(2 * np.pi * 3.0 * t)) * np.minimum(t / 0.2, 1.0) ** 2)[:, None], 1e-3)


def test_the_axis_moves_like_the_lighter_of_two_masses_on_a_spring(tmp_path: Path) -> None:
    """The recorded force drives bed and carriage, integrated as absolute positions: x'' = F / m, M y'' + c y' + k y = -F; the encoder sees x - y."""
    machine = on_a_mode(frictionless(tmp_path), "Z")
    trace = simulate(machine, strokes(machine), sample_period=machine.base_tick).trace
    axis, h = machine.axis("Z"), machine.base_tick
    force = trace.get("Z", "current") * axis.motor.torque_constant_nm_per_a / axis.ratio
    m = 20.0
    bed, w = m * (1.0 - SHARE) / SHARE, 2.0 * np.pi * FREQUENCY_HZ
    c, k = 2.0 * DAMPING * w * (m + bed), w**2 * (m + bed)

    def motion(t: float, s: np.ndarray) -> np.ndarray:
        f = force[min(int(t / h + 1e-6), len(force) - 1)]
        return np.array([s[1], f / m, s[3], (-f - c * s[3] - k * s[2]) / bed])

    solved = solve_ivp(motion, (0.0, trace.time[-1]), np.zeros(4), t_eval=trace.time, max_step=h, rtol=1e-8, atol=1e-12)
    expected = solved.y[0] - solved.y[2] + trace.get("Z", "position")[0]
    position = trace.get("Z", "position")
    swing = np.abs(solved.y[2]).max()
    assert swing > 3e-5
    # without feedback the double integral of the force drifts: compare what is left beside a straight line
    line = np.polynomial.Polynomial.fit(trace.time, position - expected, 1)(trace.time)
    assert np.abs(position - expected - line).max() < 0.004 * swing


def test_a_mode_shows_in_the_motion_and_no_share_is_no_mode(tmp_path: Path) -> None:
    machine = frictionless(tmp_path)
    still = simulate(machine, strokes(machine)).trace.get("Z", "position")
    without = machine.with_values({"axis.Z.mode_frequency_hz": 30.0, "axis.Z.mode_damping_ratio": 0.05, "axis.Z.mode_mass_share": 0.0})
    assert np.array_equal(simulate(without, strokes(machine)).trace.get("Z", "position"), still)
    swinging = on_a_mode(machine, "Z")
    assert np.abs(simulate(swinging, strokes(machine)).trace.get("Z", "position") - still).max() > 1e-6


def test_both_plants_swing_alike(mikron: Machine) -> None:
    machine = on_a_mode(mikron.with_axes(["X", "Y"]), "X").with_values({"axis.Y.presliding_stiffness_n_per_m": 3e7})
    setpoints = swings(machine, 0.3)
    motion = nominal_motion(machine, setpoints)
    engine = simulate(machine, setpoints).trace
    closed = simulate(machine, setpoints, plant_of=lambda change: DecoupledPlant(change, motion)).trace
    for name in ("X", "Y"):
        assert np.abs(engine.get(name, "position") - closed.get(name, "position")).max() < 1e-8


def test_twin_and_second_plant_swing_alike(mikron: Machine) -> None:
    """The second plant integrates bed and load as two masses, on a linear and on a rotary axis. Compared is what the mode changes."""
    rigid = fine_measuring(mikron)
    swinging = on_a_mode(on_a_mode(rigid, "X"), "A")
    slow = swings(rigid, 1.0)
    setpoints = Setpoints(slow.position[::2], slow.period)
    twin, second = (
        [move(machine) for machine in (rigid, swinging)]
        for move in (
            lambda machine: simulate(machine, setpoints).trace.matrix("position"),
            lambda machine: run(settings_of(dict(machine.document), unit_factors()), setpoints.position, noise=False).position,
        )
    )
    for a, axis in enumerate(rigid.axes):
        change, there = ((with_mode - without)[:, a] for without, with_mode in (twin, second))
        unit = 1e-6 if axis.kind == "linear" else ARCSEC
        swing, gap = (np.sqrt(np.mean(x**2)) / unit for x in (change, change - there))
        assert (swing > 0.1) == (axis.name in "XA"), axis.name
        assert gap < 0.03 * swing or axis.name not in "XA", axis.name


def test_the_key_of_pre_sliding_is_the_effect(mikron: Machine) -> None:
    one = mikron.with_axes(["X"])
    setpoints = swings(one, 0.3)
    by_key = simulate(one.with_values({"axis.X.presliding_stiffness_n_per_m": 3e7}), setpoints).trace.get("X", "position")
    effect = [{"name": "presliding", "axis": "X", "stiffness": 3e7}]
    assert np.array_equal(by_key, simulate(with_effects(one, effect), setpoints).trace.get("X", "position"))
    assert np.abs(by_key - simulate(one, setpoints).trace.get("X", "position")).max() > 1e-8
    # the effect replaces the key
    both = with_effects(one.with_values({"axis.X.presliding_stiffness_n_per_m": 9e7}), effect)
    assert np.array_equal(by_key, simulate(both, setpoints).trace.get("X", "position"))


@pytest.mark.parametrize("share", [-0.1, 1.0])
def test_a_share_outside_its_range_is_refused(mikron: Machine, share: float) -> None:
    with pytest.raises(InputError, match="mode_mass_share"):
        mikron.with_values({"axis.X.mode_mass_share": share})
