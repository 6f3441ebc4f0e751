"""Speed controllers that the regression's law does not hold for: it states no number of them, the inertia's interval holds the truth, and the fit in
closed loop finds both."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.builders.one_axis import swing
from twin.identify.axis_run import AxisRun, axis_run
from twin.identify.check_recording import checked_flags
from twin.identify.drive_fit import fit_drives
from twin.identify.regressions import regress_blocks
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.plant_spec import with_commissioned_inertia
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

PATH = swing(0.03, 0.8, 4.0) + swing(0.004, 3.1, 4.0)
LOOPS = "axis.X.loops."


def machine_with(mikron: Machine, **loops: float) -> Machine:
    return with_commissioned_inertia(mikron.with_axes(["X"]).with_values({LOOPS + key: value for key, value in loops.items()}))


def recorded(machine: Machine, seed: int | None = None, feedforward: str = "velocity+torque") -> tuple[MeasuredRun, AxisRun]:
    on = machine.with_feedforward(feedforward) if feedforward == "off" else machine
    trace = simulate(on, Setpoints(PATH[:, None], 1e-3), sample_period=1e-3, noise_seed=seed).trace
    run = MeasuredRun("made", trace, feedforward, 0.0)
    seen = axis_run(machine, machine.axis("X"), run)
    assert seen is not None
    return run, seen


@pytest.mark.parametrize("loops", [{}, {"speed_reference_time_s": 5e-4}, {"dsc_delay_s": 5e-3}, {"speed_filter_time_s": 1e-3}])
def test_what_a_regression_with_another_law_finds_is_not_stated(mikron: Machine, loops: dict[str, float]) -> None:
    machine = machine_with(mikron, **loops)
    found = regress_blocks(machine, {"X": [recorded(machine, 5, "off")[1]]}, {"X": [recorded(machine, None, "off")[1]]})
    axis, speed = machine.axis("X"), found.speed.get("X")
    if loops:
        assert speed is None or speed.half["speed_gain_nm_s_per_rad"] == math.inf
    else:
        assert speed is not None
        half = speed.half["speed_gain_nm_s_per_rad"]
        assert (
            abs(speed.values["speed_gain_nm_s_per_rad"] - axis.loops.speed_gain_nm_s_per_rad)
            < half
            < 0.1 * axis.loops.speed_gain_nm_s_per_rad
        )
    balance = found.balance["X"].fit
    assert abs(balance.values[0] - axis.commissioned_inertia) < 1.2 * balance.quantile * balance.deviations[0]


@pytest.mark.parametrize(
    "loops",
    [
        {"speed_filter_time_s": 1e-3},
        {"dsc_delay_s": 5e-3},
        {"speed_mean_cycles": 4},
        {"speed_reference_time_s": 5e-4, "torque_feedforward": 0.8},
    ],
)
def test_the_fit_in_closed_loop_finds_a_controller_behind_a_filter_or_in_the_drive(mikron: Machine, loops: dict[str, float]) -> None:
    machine = machine_with(mikron, **loops)
    run, _ = recorded(machine, 5)
    axis = machine.axis("X")
    file = machine_with(mikron, **loops, speed_gain_nm_s_per_rad=2.6, speed_integral_time_s=0.014).with_values(
        {"axis.X.moving_mass_kg": 500.0}
    )
    found = fit_drives(file, [run], {"X": [np.ones(len(run.trace.time), bool)]})[1]["X"]
    true = {
        "speed_gain_nm_s_per_rad": axis.loops.speed_gain_nm_s_per_rad,
        "speed_integral_time_s": axis.loops.speed_integral_time_s,
        "torque_feedforward": axis.loops.torque_feedforward,
        "inertia": axis.commissioned_inertia,
        "coulomb_friction_nm": axis.coulomb_friction_nm,
    }
    for name, value in true.items():
        assert abs(found[name][0] - value) < found[name][1] < 0.05 * value, name


def test_a_controller_with_the_recorded_law_is_left_to_the_regression(mikron: Machine) -> None:
    machine = machine_with(mikron)
    run, _ = recorded(machine, 5)
    assert not fit_drives(machine, [run], {"X": [np.ones(len(run.trace.time), bool)]})[1]


def test_a_feedforward_of_half_the_weight_is_on(mikron: Machine) -> None:
    machine = machine_with(mikron, velocity_feedforward=0.45, torque_feedforward=0.45)
    run, seen = recorded(machine, 5)
    flags, findings = checked_flags(machine, [run], {"X": [seen]})
    assert flags == ["velocity+torque"]
    assert not findings


def test_the_torque_feedforward_of_another_speed_loop_is_not_read(mikron: Machine) -> None:
    """The law of a position loop in the NC gave a weight of 75 for one in the drive."""
    machine = machine_with(mikron, dsc_delay_s=5e-3, torque_feedforward=0.0)
    run, seen = recorded(machine, 5)
    run = MeasuredRun(run.name, run.trace, "velocity", 0.0)
    flags, findings = checked_flags(machine, [run], {"X": [seen]})
    assert flags == ["velocity"]
    assert not findings
