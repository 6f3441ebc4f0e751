"""The second plant against closed forms, against itself, and against the recorded campaigns."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
import math
from pathlib import Path
import tomllib

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.integrate import solve_ivp

from devtools.truth_file import truth_toml
from twin.exam import draw as drawing
from twin.exam.draw import (
    EFFECTS,
    SHIPPED_MACHINE,
    SIGNALS,
    Case,
    draw_case,
    peaks_of,
    settings_for,
    simulate,
    truth_of,
    what_lacks,
    write_campaign,
)
from twin.exam.paths import limits_of, within_limits
from twin.exam.plant.effects import LIBRARY, DrawContext, apply_effect, draw_effect
from twin.exam.plant.mechanics import CURRENT, QM, STATES, VM, Q, V, advance, bristle_force
from twin.exam.plant.outside import OUTSIDE
from twin.exam.plant.parameters import AXES, Richness, settings_of, unit_factors
from twin.exam.plant.plant import PlantError, machine_of, run
from twin.exam.plant.tilting_pair import holding_torque, pair_terms
from twin.exam.programme import TestRun, programme

MACHINE = tomllib.loads(SHIPPED_MACHINE.read_text())
SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "campaigns"
STEP = 125e-6 / 8
X, Y, Z, A, C = range(5)


def nominal(*effects):
    s = settings_of(MACHINE, unit_factors())
    for effect in effects:
        apply_effect(s, effect, EFFECTS)
    return s


def energy(pair: np.ndarray, a: float, c: float, va: float, vc: float) -> float:
    """Kinetic plus potential energy [J] of the pair without rotors."""
    maa, mac, mcc, _, _ = pair_terms(pair, a, c, va, vc)
    dy = pair[5] * math.sin(c) + pair[6] * math.cos(c)
    height = math.sin(a) * (pair[2] + pair[8] * pair[4] + dy) + math.cos(a) * (pair[3] + pair[7])
    return 0.5 * maa * va * va + mac * va * vc + 0.5 * mcc * vc * vc + pair[0] * height


def coast(m, pair, y, seconds, voltage=None, step=STEP, watch=None):
    """Moves y with drives at a held voltage; `watch`(y) is recorded at every millisecond."""
    z, other, work = np.zeros(5), np.zeros(5), np.zeros((8, STATES, 5))
    u = np.zeros(5) if voltage is None else voltage
    seen, block = [], round(1e-3 / step)
    for n in range(round(seconds / 1e-3)):
        if watch:
            seen.append(watch(y))
        advance(m, pair, np.zeros((5, 5)), y, z, other, u, np.ones(5), np.zeros(5), n * 1e-3, step, block, work)
    return np.array(seen)


def without_drives_and_friction(s):
    m, pair = machine_of(s)
    m["kt"] = m["coulomb"] = m["viscous"] = 0.0
    return m, pair


# --- closed forms ------------------------------------------------------------------------------------


def test_z_falls_with_rotor_inertia_and_no_friction():
    s = nominal()
    m, pair = without_drives_and_friction(s)
    y = np.zeros((STATES, 5))
    coast(m, pair, y, 0.2)
    a = -s.load_mass[Z] * 9.81 / (s.load_mass[Z] + s.motor_mass[Z])
    assert y[V, Z] == pytest.approx(a * 0.2, rel=1e-9)
    assert y[Q, Z] == pytest.approx(a * 0.02, rel=1e-9)


def test_a_swings_like_a_pendulum():
    s = nominal()
    m, pair = without_drives_and_friction(s)
    m["coulomb"][C] = 1e6  # C sticks
    rest = math.atan2(holding_torque(pair, 0.0, 0.0)[0], -holding_torque(pair, math.pi / 2, 0.0)[0])  # gravity asks nothing there
    stiffness = (holding_torque(pair, rest + 1e-6, 0.0)[0] - holding_torque(pair, rest - 1e-6, 0.0)[0]) / 2e-6
    if stiffness < 0:
        rest, stiffness = rest + math.pi, -stiffness
    inertia = pair_terms(pair, rest, 0.0, 0.0, 0.0)[0] + s.motor_mass[A]
    period = 2 * math.pi * math.sqrt(inertia / stiffness)
    y = np.zeros((STATES, 5))
    y[[Q, QM], A] = rest + 1e-3
    seen = coast(m, pair, y, 1.25 * period, watch=lambda y: (y[Q, A] - rest, y[Q, C]))
    turns = np.flatnonzero(np.diff(np.sign(seen[:, 0])))
    crossing = [n + seen[n, 0] / (seen[n, 0] - seen[n + 1, 0]) for n in turns[:2]]
    assert 2 * (crossing[1] - crossing[0]) * 1e-3 == pytest.approx(period, rel=1e-5)
    assert np.ptp(seen[:, 1]) < 1e-12


def test_tilting_pair_keeps_its_energy():
    s = nominal({"name": "table_unbalance", "axis": "A", "mass_kg": 50.0, "radius_m": 0.2, "angle_rad": 1.0, "height_m": 0.15})
    m, pair = without_drives_and_friction(s)

    def total(y):
        return energy(pair, y[Q, A], y[Q, C], y[V, A], y[V, C]) + 0.5 * (s.motor_mass[A] * y[V, A] ** 2 + s.motor_mass[C] * y[V, C] ** 2)

    y = np.zeros((STATES, 5))
    y[Q, [A, C]] = y[QM, [A, C]] = (-0.9, 0.4)
    y[V, [A, C]] = y[VM, [A, C]] = (2.0, 4.0)
    seen = coast(m, pair, y, 2.0, watch=total)
    assert np.ptp(seen) < 1e-8 * 0.5 * 60 * 4
    assert abs(y[V, C] - 4.0) > 0.05  # the axes did exchange energy


def test_pair_forces_are_those_of_lagrange():
    """h = d/dt(dL/dv) - dL/dq without accelerations, from numerical derivatives of the energy alone."""
    _, pair = machine_of(nominal())

    def potential(*x):
        return energy(pair, x[0], x[1], 0.0, 0.0)

    def kinetic(*x):
        return energy(pair, *x) - potential(*x)

    def slope(f, x, k, d=1e-5):
        step = np.eye(4)[k] * d
        return (f(*(x + step)) - f(*(x - step))) / (2 * d)

    for x in np.random.default_rng(4).uniform(-2, 2, (20, 4)):
        torques = pair_terms(pair, *x)[3:]
        for k in (0, 1):
            momentum = partial(lambda k, *y: slope(kinetic, np.array(y), 2 + k), k)
            turning = slope(momentum, x, 0) * x[2] + slope(momentum, x, 1) * x[3]
            assert torques[k] == pytest.approx(turning - slope(kinetic, x, k) + slope(potential, x, k), abs=2e-3)


def test_friction_holds_below_and_slides_at_its_level():
    s = nominal()
    m, pair = machine_of(s)
    m["kt"] = 0.0
    m["steady_force"][X] = -0.9 * s.coulomb[X]  # pushes to +q
    y = np.zeros((STATES, 5))
    coast(m, pair, y, 1.0)
    assert abs(y[Q, X]) < 1e-12
    m["steady_force"][X] = -1.2 * s.coulomb[X]
    m["viscous"][X] = 0.0
    coast(m, pair, y, 0.1)
    assert y[V, X] == pytest.approx(0.2 * s.coulomb[X] / (s.load_mass[X] + s.motor_mass[X]) * 0.1, rel=1e-6)


def test_current_at_constant_speed_is_coulomb_plus_viscous():
    s = nominal()
    t = np.arange(1200) * 1e-3
    v = 0.1
    points = np.zeros((len(t), 5))
    points[:, X] = v * np.maximum(t - 0.1, 0.0)
    trace = run(s, points, noise=False)
    expected = (s.coulomb[X] + s.viscous[X] * v) * s.ratio[X] / s.kt[X]
    assert trace.true_current[-200:, X].mean() == pytest.approx(expected, rel=1e-4)


def test_bristle_step_is_the_exact_solution_of_its_law():
    level, stiffness, v, z0, h = 1100.0, 2e9, 3e-3, -2e-7, 4e-4
    force, z = bristle_force(level, stiffness, 0.0, z0, v, h)
    exact = solve_ivp(lambda t, y: [v - stiffness * abs(v) * y[0] / level, y[0]], (0, h), [z0, 0.0], rtol=1e-11, atol=1e-16).y[:, -1]
    assert z == pytest.approx(exact[0], rel=1e-7)
    assert force == pytest.approx(-stiffness * exact[1] / h, rel=1e-7)


def test_current_rises_with_its_electrical_time_constant():
    s = nominal()
    m, pair = machine_of(s)
    m["motor_mass"] = 1e15  # locked
    y = np.zeros((STATES, 5))
    seen = coast(m, pair, y, 0.03, voltage=np.full(5, 2.0), watch=lambda y: y[CURRENT].copy())
    t = np.arange(30)[:, None] * 1e-3
    assert np.allclose(seen, 2.0 / s.resistance * (1 - np.exp(-t * s.resistance / s.inductance)), rtol=0, atol=1e-9)


def test_compliance_has_its_antiresonance_and_its_resonance():
    stiffness = 8e7
    s = nominal({"name": "transmission_compliance", "axis": "X", "stiffness": stiffness, "damping": 0.0})
    for motor in (1e15, s.motor_mass[X]):
        m, pair = without_drives_and_friction(s)
        m["motor_mass"][X] = motor
        y = np.zeros((STATES, 5))
        y[Q, X] = 1e-5
        seen = coast(m, pair, y, 0.4, watch=lambda y: y[Q, X] - y[QM, X])
        turns = np.flatnonzero(np.diff(np.sign(seen)))
        at = [n + seen[n] / (seen[n] - seen[n + 1]) for n in (turns[0], turns[-1])]
        hz = (len(turns) - 1) / 2 / ((at[1] - at[0]) * 1e-3)
        reduced = s.load_mass[X] * motor / (s.load_mass[X] + motor)
        assert hz == pytest.approx(math.sqrt(stiffness / reduced) / (2 * math.pi), rel=2e-4)


def test_slow_reversal_shows_clearance_and_contact():
    clearance = 15e-6
    s = nominal({"name": "backlash", "axis": "X", "clearance": clearance})
    t = np.arange(4000) * 1e-3
    points = np.zeros((len(t), 5))
    points[:, X] = 2e-3 * np.sin(2 * math.pi * 0.5 * t)
    trace = run(s, points, noise=False)
    gap = (trace.motor_position - trace.load)[2000:, X]
    m, _ = machine_of(s)
    sliding = np.abs(np.gradient(points[2000:, X])) > 3e-6  # at a steady slow speed
    flanks = [np.median(gap[sliding & (side * np.gradient(points[2000:, X]) > 0)]) for side in (1, -1)]
    drag = s.coulomb[X] + s.viscous[X] * 2e-3 * 2 * math.pi * 0.5 * 0.8
    assert flanks[0] - flanks[1] == pytest.approx(clearance + 2 * drag / m["stiffness"][X], abs=0.03e-6)


def test_measurement_effects_are_their_formulas():
    t = np.arange(600) * 1e-3
    wave = (np.sin(2 * math.pi * 2 * t - math.pi / 2) + 1.0)[:, None]
    points = 0.3 + wave * np.array([0.02, 0.02, 0.02, 0.05, 0.5])
    effects = (
        {"name": "thermal_drift", "axis": "Y", "rate": 3e-7},
        {"name": "lead_error", "axis": "X", "fraction": 1e-4},
        {"name": "cyclic_error", "axis": "A", "amplitude": 5e-5, "phase_rad": 0.7},
        {"name": "encoder_eccentricity", "axis": "C", "amplitude": 6e-5, "phase_rad": 2.0},
    )
    s = nominal(*effects)
    trace = run(s, points, started_at_s=50.0, noise=False)
    q, q0 = trace.load, trace.load[0]
    assert np.allclose(trace.position[0], points[0], rtol=0, atol=6e-8)  # the scale shows the set point
    drift = trace.position[:, Y] - q[:, Y]
    assert np.allclose(drift, 3e-7 * (50.0 + t), rtol=0, atol=6e-8)
    assert np.allclose(trace.motor_position[:, X], q0[X] + (q[:, X] - q0[X]) * (1 - 1e-4), rtol=0, atol=6e-9)
    shown = q[:, A] - 5e-5 * (np.sin(q[:, A] * 180 + 0.7) - np.sin(q0[A] * 180 + 0.7))
    assert np.allclose(trace.motor_position[:, A], shown, rtol=0, atol=1e-9)
    shown = q[:, C] + 6e-5 * (np.sin(q[:, C] + 2.0) - np.sin(q0[C] + 2.0))
    assert np.allclose(trace.position[:, C], shown, rtol=0, atol=5e-8)


# --- starting conditions, seeds ----------------------------------------------------------------------


@pytest.mark.parametrize("on_motor", [False, True])
def test_a_machine_at_rest_stays_at_rest(on_motor):
    """Gravity, unbalance and constant force are carried from the first tick, through springs, gaps and a notch."""
    effects = [
        {"name": "constant_force", "axis": "X", "force": 500.0},
        {"name": "backlash", "axis": "Z", "clearance": 2e-5},
        {"name": "transmission_compliance", "axis": "A", "stiffness": 2e6, "damping": 2e3},
        {"name": "notch_filter", "axis": "Z", "frequency_hz": 120.0, "width": 1.0},
        {"name": "two_stage_lost_motion", "axis": "C", "width": 1e-4, "share": 0.05, "stiffness": 5e6, "damping": 700.0},
        {"name": "magnetic_saturation", "axis": "Z", "saturation_a": 12.0},
        {"name": "inverter_dead_time", "axis": "Z", "voltage_v": 14.0},
    ]
    s = nominal(*effects)
    s.on_motor[:] = on_motor
    points = np.tile([0.1, 0.0, 0.05, -0.7, 0.3], (200, 1))
    trace = run(s, points, noise=False)
    closing = trace.motor_position if on_motor else trace.position
    assert np.abs(closing - points).max() < 1e-7
    assert np.abs(trace.load - trace.load[0]).max() < 1e-10
    assert np.abs(trace.true_current - trace.true_current[0]).max() < 1e-3


def test_same_seed_same_trace():
    case = draw_case(11, "pair", MACHINE)
    assert truth_of(case) == truth_of(draw_case(11, "pair", MACHINE))
    short = TestRun("short", "test", "velocity+torque", programme(MACHINE, 11)[5].set_points[:300])
    one, two, other = (simulate(c, MACHINE, short) for c in (case, case, replace(case, noise_seed=12)))
    assert np.array_equal(one.position, two.position)
    assert np.array_equal(one.current, two.current)
    assert not np.array_equal(one.current, other.current)
    assert truth_of(draw_case(12, "pair", MACHINE)) != truth_of(case)


# --- effects -----------------------------------------------------------------------------------------


def lively() -> TestRun:
    """0.9 s in which every axis accelerates, reverses and moves slowly, each at its own frequency."""
    t = np.arange(900) * 1e-3
    ease = np.minimum(1.0, t / 0.2) ** 2 * (3 - 2 * np.minimum(1.0, t / 0.2))
    columns = [
        start + size * ease * np.sin(2 * math.pi * hz * t)
        for start, size, hz in zip((0.0, 0.05, -0.02, -0.6, 0.2), (0.02, 0.018, 0.016, 0.12, 0.3), (1.7, 2.1, 2.6, 1.3, 1.9))
    ]
    return TestRun("lively", "test", "velocity+torque", np.column_stack(columns))


LIVELY = lively()
BASE = Case(1, "healthy", 1.0, (), unit_factors(), Richness(), noise=False)


def outputs(effects) -> np.ndarray:
    trace = run(settings_for(replace(BASE, effects=effects), MACHINE), LIVELY.set_points, 3, 30.0, substeps=3, noise=False)
    unit = np.array([1e6] * 3 + [206265.0] * 2)  # um, arcsec, and A times 10
    return np.stack([trace.position * unit, trace.motor_position * unit, trace.current * 10.0])


@pytest.fixture(scope="module")
def healthy():
    return outputs(())


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_acts_and_so_does_each_of_its_parameters(name, healthy):
    effect = EFFECTS[name]
    axis = effect.axes[0]
    context = DrawContext(
        np.random.default_rng(1), AXES.index(axis), 1.0, settings_of(MACHINE, BASE.factors), *peaks_of(MACHINE, BASE.factors, [LIVELY])
    )
    drawn = draw_effect(name, axis, context, EFFECTS)
    there = outputs((drawn,))
    assert np.abs(there - healthy).max() > 0.3
    for key in (k for k in drawn if k not in ("name", "axis")):
        changed = {"Y": "Z", "Z": "Y"}[drawn[key]] if key == "from_axis" else drawn[key] * 1.15
        assert np.abs(outputs(({**drawn, key: changed},)) - there).max() > 1e-4, key


def test_library_names_and_axes_are_those_of_the_effects_table():
    linear = {"lead_error", "thermal_drift", "cross_axis_coupling"}
    assert len(LIBRARY) == 29
    assert len(OUTSIDE) >= 8
    assert not set(LIBRARY) & set(OUTSIDE)
    assert sum(len(effect.axes) for effect in LIBRARY.values()) == 24 * 5 + 3 * 3 + 1 + 1
    assert {e.block for e in OUTSIDE.values()} == {e.block for e in LIBRARY.values()}
    for name, effect in LIBRARY.items():
        special = {"table_unbalance": ("A",), "encoder_eccentricity": ("C",)} | dict.fromkeys(linear, ("X", "Y", "Z"))
        assert effect.axes == special.get(name, AXES)
    with pytest.raises(ValueError, match="no effect 'rust'"):
        apply_effect(nominal(), {"name": "rust", "axis": "X"})
    with pytest.raises(ValueError, match="lead_error cannot be on axis 'C'"):
        apply_effect(nominal(), {"name": "lead_error", "axis": "C", "fraction": 1e-4})


def test_drawn_sizes_shrink_with_scale():
    for name, key, neutral in (("backlash", "clearance", 0.0), ("speed_gain", "factor", 1.0), ("coulomb_friction", "factor", 1.0)):
        big, small = (draw_case(5, "single", MACHINE, effect=name, axis="Y", scale=scale).effects[0][key] for scale in (1.0, 0.2))
        assert small - neutral == pytest.approx(0.2 * (big - neutral), rel=1e-9)
    soft = [draw_case(5, "single", MACHINE, effect="transmission_compliance", axis="Y", scale=scale) for scale in (1.0, 0.2)]
    big, small = (case.effects[0]["stiffness"] for case in soft)
    assert small == pytest.approx(5 * big, rel=1e-9)


def test_kinds_of_cases():
    assert [len(draw_case(3, kind, MACHINE).effects) for kind in ("healthy", "single", "pair", "triple", "outside")] == [0, 1, 2, 3, 1]
    wide = draw_case(3, "healthy", MACHINE, spread=0.3).factors
    values = np.array([v for table in wide.values() for v in table.values()])
    assert 0.7 <= values.min() < 0.8
    assert 1.2 < values.max() <= 1.3
    with pytest.raises(ValueError, match="no kind 'twin'"):
        draw_case(3, "twin", MACHINE)


def test_a_state_that_is_not_finite_is_reported():
    s = nominal()
    s.inductance[Y] = 1e-9  # far too fast for the step
    with pytest.raises(PlantError, match="axis Y is unstable"):
        run(s, LIVELY.set_points)


# --- programme and files -----------------------------------------------------------------------------


def test_set_points_stay_within_the_machine():
    limits = limits_of(MACHINE)
    for seed in range(6):
        runs = programme(MACHINE, seed)
        assert [sum(r.kind == kind for r in runs) for kind in ("test", "program", "exam")] == [10, 3, 3]
        for r in runs:
            assert within_limits(r.set_points, limits).max() < 1.0, r.name
            assert (r.set_points >= limits.low).all()
            assert (r.set_points <= limits.high).all()
            assert np.abs(np.diff(r.set_points, axis=0)[[0, -1]]).max() < 2e-6  # starts and ends at rest
    assert not np.array_equal(programme(MACHINE, 1)[5].set_points.shape, programme(MACHINE, 2)[5].set_points.shape)


@pytest.mark.parametrize("signals", SIGNALS)
def test_a_written_campaign_has_the_agreed_form_and_does_not_reveal_the_truth(tmp_path, monkeypatch, signals):
    short = [
        TestRun("constant_velocity", "test", "velocity", LIVELY.set_points[:120]),
        TestRun("other", "test", "off", LIVELY.set_points[:150]),
    ]
    monkeypatch.setattr(drawing, "programme", lambda machine, seed: short)
    case = replace(BASE, effects=({"name": "backlash", "axis": "X", "clearance": 2e-5},), noise=True)
    files = write_campaign(case, tmp_path / "c", MACHINE, signals=signals)
    assert sorted(p.name for p in (tmp_path / "c").iterdir()) == sorted([*files, "campaign.toml"])
    text = (tmp_path / "c" / "campaign.toml").read_text()
    campaign = tomllib.loads(text)
    assert "backlash" not in text
    assert campaign["machine"] == "mikron_ucp710"
    assert [(r["file"], r["feedforward"]) for r in campaign["run"]] == [("constant_velocity.parquet", "velocity"), ("other.parquet", "off")]
    assert campaign["run"][1]["started_at_s"] == pytest.approx(0.120 + 5.0)
    table = pq.read_table(tmp_path / "c" / files[0])
    assert table.column_names[0] == "time [s]"
    assert table.num_rows == 120
    units = {"current": ("A", "A"), "velocity": ("mm/s", "deg/s"), "velocity_setpoint": ("mm/s", "deg/s")}
    expected = [f"{a}.{signal} [{units.get(signal, ('mm', 'deg'))[a in 'AC']}]" for a in AXES for signal in SIGNALS[signals]]
    assert table.column_names[1:] == expected
    encoder = next(c for c in ("X.position [mm]", "X.motor_position [mm]") if c in table.column_names)
    position = table[encoder].to_numpy()
    assert np.array_equal(position, np.round(position, 4 if encoder == "X.position [mm]" else 5))
    assert table.schema.metadata is None


def test_truth_reads_back():
    case = draw_case(21, "triple", MACHINE)
    truth = truth_of(case)
    back = tomllib.loads(truth_toml(truth))
    assert [(e["name"], e["axis"]) for e in back["effect"]] == [(e["name"], e["axis"]) for e in truth["effect"]]
    assert back["parameter"]["X"]["torque_constant"] == pytest.approx(truth["parameter"]["X"]["torque_constant"], rel=1e-8)
    outside = tomllib.loads(truth_toml(truth_of(draw_case(21, "outside", MACHINE))))
    assert "effect" not in outside
    assert outside["outside"][0]["block"]


# --- recorded campaigns ------------------------------------------------------------------------------

RECORDED = [("nominal", "circle_zx"), ("nominal", "acceleration"), ("f", "five_axis"), ("e", "acceleration_ff_off")]


@pytest.mark.parametrize(("campaign", "name"), RECORDED)
def test_recorded_runs_are_reproduced(campaign, name):
    """Without richness and with the true parameters and effects only two independent noises remain, here and in the recording."""
    if not SHARED.is_dir():
        pytest.skip("the recorded campaigns (../shared/campaigns beside the repository) are not here")
    about = {r["file"]: r for r in tomllib.loads((SHARED / campaign / "campaign.toml").read_text())["run"]}[f"{name}.parquet"]
    truth = tomllib.loads((SHARED / campaign / "truth.toml").read_text())
    table = pq.read_table(SHARED / campaign / f"{name}.parquet")
    unit = np.array([1e-3] * 3 + [math.pi / 180] * 2)

    def read(signal):
        return np.column_stack([table[next(c for c in table.column_names if c.startswith(f"{a}.{signal} "))].to_numpy() for a in AXES])

    case = Case(1, "record", 1.0, tuple(truth.get("effect", ())), truth["parameter"], Richness.off())
    trace = run(settings_for(case, MACHINE, about["feedforward"]), read("setpoint") * unit, 5, about["started_at_s"])
    gap = np.sqrt(np.mean((trace.position - read("position") * unit) ** 2, axis=0))
    assert (gap[:3] < 0.105e-6).all()
    assert (gap[3:] < math.radians(0.21 / 3600)).all()
    moving = np.abs(np.gradient(read("setpoint"), axis=0)) > 0.2e-3
    for k in np.flatnonzero(moving.any(axis=0)):
        assert np.sqrt(np.mean((trace.current - read("current"))[moving[:, k], k] ** 2)) < 0.072


def test_set_points_of_a_program_keep_their_period():
    """Every second sample with a period of 2 ms is the same run; read with 1 ms it would be millimetres off."""
    settings = settings_of(MACHINE, unit_factors())
    points = LIVELY.set_points[:401]
    whole, half = run(settings, points, noise=False), run(settings, points[::2], noise=False, set_point_period_s=2e-3)
    assert np.allclose(half.time, whole.time)
    moved = np.ptp(points, axis=0)
    assert np.abs(half.setpoint - whole.setpoint).max() < 1e-3 * moved.max()
    assert np.abs(half.load - whole.load).max() < 1e-3 * moved.max()
    assert np.abs(run(settings, points[::2], noise=False).load - whole.load[:201]).max() > 0.1 * moved.max()


def test_a_machine_that_records_at_another_period_than_the_programme_is_refused() -> None:
    machine = tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8"))
    assert what_lacks(machine) is None
    machine["measurement"]["sample_period_us"] = 2000.0
    assert "sample_period_us = 2000" in (what_lacks(machine) or "")
