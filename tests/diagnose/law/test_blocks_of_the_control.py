"""Laws of the control: voltage error of the inverter, dead band of the position controller, and the reference of their residuals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.builders.identify_campaigns import SHORT_QUICK, recorded
from tests.builders.other_structures import slides
from tests.diagnose.law.test_closed_loop import X, runs_of
from tests.diagnose.law.test_measure import COUNT, RUNS, M, samples_of
from twin.diagnose.blocks import shows_speed_controller
from twin.diagnose.control_law import characteristic_of, law_error
from twin.diagnose.law.measure import measured_laws
from twin.diagnose.law.residual import CURRENT_LOOP, residuals_of
from twin.diagnose.law.shapes import described
from twin.diagnose.view import view_of
from twin.effects import apply_effects, settings_of, with_effects
from twin.errors import InputError
from twin.simulation.run import simulate

INVERTER = {
    "name": "law", "axis": "X", "block": "current loop", "output": "voltage", "variables": ["current"],
    "formula": "saturation", "height": -14.0, "scale": 0.2,
}  # fmt: skip
BAND = {
    "name": "law", "axis": "X", "block": "position controller", "output": "speed", "variables": ["following_error"],
    "formula": "dead band", "band": 6e-6,
}  # fmt: skip
AXIS = X.axes[0]


def test_a_voltage_is_measured_through_the_current_loop():
    """The simulated loop makes the record; the transfer function recovers the voltage from its samples."""
    views = [view_of(X, run) for run in runs_of([INVERTER])]
    samples = next(s for s in residuals_of(views, lambda m: m, "X", map) if s.block == CURRENT_LOOP)
    curve = measured_laws(samples, AXIS)[0]
    assert (curve.relation.output, curve.relation.variable) == ("voltage", "current")
    best = described(samples, curve, AXIS)
    assert best.shape == "saturation"
    assert best.numbers["height"] == pytest.approx(-14.0, rel=0.15)
    assert 0.1 < best.numbers["scale"] < 0.4  # current noise biases it; the closed-loop fit gives the final value


def test_a_voltage_needs_a_current_loop(tmp_path):
    machine = slides(tmp_path)  # X takes a voltage as its command
    with pytest.raises(InputError, match="a voltage needs a current loop"):
        apply_effects(with_effects(machine, [INVERTER]))


def test_a_dead_band_is_found_beside_following_errors_a_thousand_times_as_large():
    gain = AXIS.loops.position_gain_per_s
    rng = np.random.default_rng(5)
    error = 8e-6 * rng.standard_normal(RUNS * COUNT)
    error[:COUNT] = 5e-3 * np.sin(np.linspace(0.0, 20.0, COUNT))  # a run without feedforward
    motion = {**M, "following_error": error, "speed_setpoint": gain * error}
    samples = samples_of(-gain * np.clip(error, -6e-6, 6e-6), motion, "position controller", 3e-7)
    curve = measured_laws(samples, AXIS)[0]
    assert curve.relation.variable == "following_error"
    best = described(samples, curve, AXIS)
    assert best.shape == "dead band"
    assert best.numbers["band"] == pytest.approx(6e-6, rel=0.02)


def test_a_law_of_the_controller_is_held_against_the_record_at_the_measured_position():
    """Inside a dead band the rest position is arbitrary: the error of the law is evaluated at the measured, not the simulated position."""
    machine = with_effects(X, [BAND])
    run = runs_of([BAND])[0]
    view = view_of(X, run)
    elsewhere = simulate(machine, view.setpoints, sample_period=1e-3, noise_seed=99).trace
    added = characteristic_of(settings_of(machine), AXIS)
    measured, simulated, unfed = (
        law_error(view.trace, view, AXIS),
        law_error(elsewhere, view, AXIS, added),
        law_error(elsewhere, view, AXIS),
    )
    largest = np.abs(measured).max()
    assert np.abs(simulated - measured).max() < 0.02 * largest
    assert np.abs(unfed - measured).max() > 0.1 * largest


def test_a_changed_gain_acts_behind_the_dead_band_of_its_controller():
    """A gain does nothing inside a dead band: of 20 % less the law leaves none."""
    machine = X.with_values({"axis.X.block": {"pid": {"dead_band_m": 2e-5}}})
    less = with_effects(machine, [{"name": "position_gain", "axis": "X", "factor": 0.8}])
    view = view_of(machine, recorded(less, "quick", SHORT_QUICK[:1500], "velocity", 3))
    elsewhere = simulate(less.with_feedforward("velocity"), view.setpoints, sample_period=1e-3, noise_seed=99).trace
    axis = machine.axes[0]
    measured, simulated = law_error(view.trace, view, axis), law_error(elsewhere, view, axis, characteristic_of(settings_of(less), axis))
    assert simulated == pytest.approx(measured, abs=1e-6 * np.abs(measured).max())


def test_a_controller_without_effects_adds_nothing():
    assert characteristic_of([], AXIS) is None


@pytest.mark.parametrize("name", ["speed_set_point_lag", "speed_record_lag"])
def test_the_law_is_held_against_a_record_behind_its_lag(name):
    """The set point that the speed controller got is recorded only if the lag is in the loop."""
    machine = X.with_values({f"axis.X.block.{name}.time_constant_s": 3e-3})
    view = view_of(machine, recorded(machine, "quick", SHORT_QUICK[:1500], "off", 3))
    behind, plain = (np.abs(law_error(view.trace, view, one.axes[0])) for one in (machine, X))
    assert behind.max() < 0.01 * plain.max()
    assert shows_speed_controller(view, machine.axes[0]) == (name == "speed_set_point_lag")


@pytest.mark.parametrize(("name", "numbers"), [
    ("pid", {"dead_band_m": 2e-6, "integral_gain_per_s2": 40.0, "acceleration_feedforward_s": 2e-3, "derivative_gain": 0.02}),
    ("friction_pulse", {"amplitude_m_per_min": 0.1, "decay_time_s": 0.02}),
    ("backlash_value", {"width_m": 2e-5, "cycles": 3}),
    ("position_correction", {"slope_ppm": 50.0, "origin_m": 0.0, "sine_m": 4e-6, "cosine_m": 0.0, "wavelength_m": 0.01}),
    ("set_point_lag", {"time_constant_s": 0.004}),
    ("set_point_average", {"length_s": 0.011}),
])  # fmt: skip
def test_the_law_has_the_blocks_of_its_controller(name, numbers):
    """What a block adds to the speed set point is no error of the controller; a block that the machine lacks is."""
    machine = X.with_values({"axis.X.block": {name: numbers}})
    run = recorded(machine, "quick", SHORT_QUICK[:1500], "velocity", 3)
    views = [(one, view_of(one, run)) for one in (machine, X)]
    own, plain = (np.abs(law_error(run.trace, view, one.axes[0])) for one, view in views)
    assert own.max() < 0.01 * plain.max()


def test_a_profile_speed_beside_pid_is_no_part_of_its_feedforward():
    """LinuxCNC records the speed of its profile; `pid` makes its own of the commands."""
    machine = X.with_values({"axis.X.block": {"pid": {"dead_band_m": 2e-6}}})
    run = recorded(machine, "quick", SHORT_QUICK[:1500], "velocity", 3)
    setpoint = run.trace.get("X", "setpoint")
    cycle = round(machine.position_cycle / run.trace.period)
    profile = np.concatenate([np.zeros(cycle), setpoint[cycle:] - setpoint[:-cycle]]) / machine.position_cycle
    profile += 1e-3 * (np.sin(50.0 * run.trace.time) > 0.9)
    trace = replace(run.trace, signals={**run.trace.signals, ("X", "velocity_feedforward"): profile})
    views = [view_of(machine, replace(run, trace=one)) for one in (run.trace, trace)]
    alone, beside = (law_error(view.trace, view, machine.axes[0]) for view in views)
    assert alone == pytest.approx(beside, abs=1e-9)
