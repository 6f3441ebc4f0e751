"""Effects in motor and load, against the balance of forces."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.builders.one_axis import MACHINE, NO_COULOMB, TICK, axis_of, follow, missing_force, steady, swing, there_and_back, total_inertia
from twin.effects import with_effects
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

G = 9.81


def test_torque_constant():
    """The holding current of Z is m g r / (factor Kt), independent of the control's constant."""
    a = axis_of("Z")
    trace = follow("Z", np.zeros(100), [{"name": "torque_constant", "factor": 0.9}])
    expected = a.moving_mass_kg * G * a.ratio / (0.9 * a.motor.torque_constant_nm_per_a)
    assert trace.get("Z", "current") == pytest.approx(np.full(len(trace.time), expected), rel=1e-9)


@pytest.mark.parametrize("axis", ["X", "A"])
def test_inertia(axis):
    """added a / r more torque while the axis accelerates, none at rest (no weight on A)."""
    a = axis_of(axis)
    added = 0.25 * total_inertia(axis)
    t = np.arange(301) * 1e-3
    accelerating = 0.5 * 1.5 * np.maximum(t - 0.02, 0.0) ** 2
    torque, speed = (
        [follow(axis, accelerating, e).get(axis, s)[-641:-1] for e in ([], [{"name": "inertia", "added": added}])]
        for s in ("torque", "velocity")
    )
    # A has gravity that changes with its angle, alike in both runs to a few parts of the following error's change
    extra = (torque[1] - torque[0]).mean() / a.ratio
    change = [np.diff(v).mean() / TICK for v in speed]
    expected = (total_inertia(axis) + added) * change[1] - total_inertia(axis) * change[0]
    assert expected == pytest.approx(added * 1.5, rel=0.02)
    assert extra == pytest.approx(expected, rel=5e-3)
    still = follow(axis, np.zeros(50), [{"name": "inertia", "added": added}]), follow(axis, np.zeros(50))
    assert still[0].get(axis, "current")[-1] == pytest.approx(still[1].get(axis, "current")[-1], abs=1e-9)


def test_inertia_on_a_vertical_axis_has_weight():
    a = axis_of("Z")
    trace = follow("Z", np.zeros(50), [{"name": "inertia", "added": 80.0}])
    expected = (a.moving_mass_kg + 80.0) * G * a.ratio / a.motor.torque_constant_nm_per_a
    assert trace.get("Z", "current")[-1] == pytest.approx(expected, rel=1e-9)


def test_constant_force():
    """The force is held from the first tick and adds to the friction in both directions."""
    a = axis_of("X")
    effect = {"name": "constant_force", "force": 400.0}
    still = follow("X", np.zeros(50), [effect])
    assert still.get("X", "torque") == pytest.approx(np.full(len(still.time), 400.0 * a.ratio), rel=1e-9)
    means = [follow("X", steady(v, 0.4), [effect]).get("X", "torque")[-321:-1].mean() / a.ratio for v in (0.05, -0.05)]
    assert sum(means) / 2 == pytest.approx(400.0, rel=1e-3)
    assert (means[0] - means[1]) / 2 == pytest.approx(a.coulomb_friction + a.viscous_friction * 0.05, rel=1e-3)


def test_constant_load_of_the_file_equals_the_constant_force_effect():
    """A steady load in the machine file acts like a constant force effect, in both plants."""
    axis = axis_of("X")
    loaded = MACHINE.with_values({"axis.X.constant_torque_nm": 400.0 * axis.ratio}).with_axes(["X"])
    shaken = with_effects(MACHINE.with_axes(["X"]), [{"name": "constant_force", "axis": "X", "force": 400.0}])
    assert loaded.axis("X").constant_force == pytest.approx(400.0)
    setpoints = Setpoints(there_and_back(0.02, 0.1)[:, None], 1e-3)
    one, other = (simulate(machine, setpoints).trace for machine in (loaded, shaken))
    for signal in ("position", "current"):
        np.testing.assert_allclose(one.get("X", signal), other.get("X", signal), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("tilt", "turn"), [(0.0, 0.0), (-math.pi / 2, 0.3), (-1.0, 1.2), (0.4, -2.5)])
def test_table_unbalance(tilt, turn):
    """Torques that hold m at (r, angle, h) on the tilted, turned table: dV/dA and dV/dC of V = m g (r sin(angle + C) sin A + h cos A)."""
    m, r, angle, h = 40.0, 0.15, 0.8, 0.12
    two = MACHINE.with_axes(["A", "C"])
    loaded = with_effects(two, [{"name": "table_unbalance", "axis": "A", "mass_kg": m, "radius_m": r, "angle_rad": angle, "height_m": h}])
    setpoints = Setpoints(np.tile([tilt, turn], (40, 1)), 1e-3)
    bare, with_mass = (simulate(machine, setpoints).trace for machine in (two, loaded))
    expected = {
        "A": m * G * (r * math.sin(angle + turn) * math.cos(tilt) - h * math.sin(tilt)),
        "C": m * G * r * math.cos(angle + turn) * math.sin(tilt),
    }
    for axis, torque in expected.items():
        extra = (with_mass.get(axis, "torque") - bare.get(axis, "torque")) / axis_of(axis).ratio
        assert extra == pytest.approx(np.full(len(extra), torque), abs=1e-6)


def test_height_of_a_table_unbalance_counts_from_the_tilting_axis():
    """`height_m` counts from the A axis, wherever the table lies: tilted by 90 degrees it holds m g h, offset or not."""
    for offset in (0.0, 0.06):
        two = MACHINE.with_values({"geometry.a_axis_to_c_axis_z_m": offset}).with_axes(["A", "C"])
        table = {"name": "table_unbalance", "axis": "A", "mass_kg": 40.0, "radius_m": 0.0, "angle_rad": 0.0, "height_m": 0.12}
        setpoints = Setpoints(np.tile([-math.pi / 2, 0.0], (20, 1)), 1e-3)
        torques = [simulate(machine, setpoints).trace.get("A", "torque")[0] for machine in (two, with_effects(two, [table]))]
        assert (torques[1] - torques[0]) / axis_of("A").ratio == pytest.approx(40.0 * G * 0.12, rel=1e-6)


def test_table_unbalance_adds_inertia():
    """About C it adds m r^2."""
    import mujoco

    from twin.effects import apply_effects
    from twin.simulation.plant_spec import build_plant, full_inertia

    two = MACHINE.with_axes(["A", "C"])
    table = {"name": "table_unbalance", "axis": "A", "mass_kg": 40.0, "radius_m": 0.15, "angle_rad": 0.8, "height_m": 0.12}
    inertias = []
    for machine in (two, with_effects(two, [table])):
        change = apply_effects(machine)
        plant = build_plant(change.machine, change.model_edits)
        mujoco.mj_forward(plant.model, plant.data)
        inertias.append(full_inertia(plant.model, plant.data)[plant.load_dof[1], plant.load_dof[1]])
    assert inertias[1] - inertias[0] == pytest.approx(40.0 * 0.15**2, rel=1e-6)


def test_torque_ripple():
    """The force balance lacks exactly amplitude sin(n q / r + phase), a spectral line at n periods per motor turn."""
    a = axis_of("X")
    trace = follow("X", steady(0.05, 0.9), [{"name": "torque_ripple", "amplitude_nm": 0.2, "periods_per_rev": 6.0, "phase_rad": 0.5}])
    q = trace.get("X", "motor_position")
    q = (q[1:] + q[:-1])[-5600:] / 2
    ripple = (missing_force(trace, "X")[-5600:] + a.coulomb_friction) * a.ratio
    assert np.abs(ripple - 0.2 * np.sin(6.0 * q / a.ratio + 0.5)).max() < 0.004
    # spectrum of the current over whole motor turns: position, not time, carries the line
    turns = (q - q[0]) / (2 * np.pi * a.ratio)
    whole = np.linspace(0.0, 3.0, 3000, endpoint=False)
    current = np.interp(whole, turns, trace.get("X", "current")[-5600:])
    lines = np.abs(np.fft.rfft(current - current.mean()))
    assert np.argmax(lines) == 6 * 3


def test_cross_axis_coupling():
    """Y accelerates, X feels -mass times that acceleration (one tick late)."""
    a = axis_of("X")
    position = np.column_stack([np.zeros(301), swing(0.002, 8.0, 0.3)])
    trace = follow("X", position, [NO_COULOMB, {"name": "cross_axis_coupling", "from_axis": "Y", "mass": 120.0}], with_axes="Y")
    pushed = -120.0 * np.diff(trace.get("Y", "velocity")) / TICK
    felt = missing_force(trace, "X")
    assert np.abs(pushed).max() > 100.0
    assert np.abs(felt[1:] - pushed[:-1]).max() < 0.01 * np.abs(pushed).max()
    assert a.moving_mass_kg > 120.0


def test_periodic_disturbance():
    """force sin(2 pi f t) from the start of the run, independent of the motion."""
    trace = follow("X", there_and_back(0.005, 0.05), [NO_COULOMB, {"name": "periodic_disturbance", "frequency_hz": 21.0, "force": 300.0}])
    t = (np.arange(len(trace.time) - 1) + 0.5) * TICK
    assert np.abs(missing_force(trace, "X") - 300.0 * np.sin(2 * np.pi * 21.0 * t)).max() < 1.6
