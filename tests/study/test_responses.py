"""Responses of a variant against closed forms and against a record of every tick of 125 us."""

from pathlib import Path

import numpy as np
import pytest

from tests.builders.study_files import rows_of, write_move, write_spec
from twin.geometry.scurve import moves_in_turn
from twin.geometry.tool_path import contour_error, search_window, tool_path_of
from twin.machine.loops import loops_of, margins_of
from twin.machine.machine import Machine, load_machine, write_machine
from twin.recordings.trace import Trace, read_trace, write_trace
from twin.simulation.run import Run, simulate
from twin.simulation.setpoints import setpoints_of
from twin.study.design import machine_of
from twin.study.paths import inertia_at_motor
from twin.study.spec import read_study

TICK = 125e-6
RATED = {
    f"axis.X.motor.{key}": value
    for key, value in {"rated_torque_nm": 18.0, "thermal_time_constant_s": 0.05, "max_speed_rev_per_min": 3600.0}.items()
}
MASS = '[[factor]]\nname = "mass"\npath = "axis.X.moving_mass_kg"\n[design]\nkind = "list"\nrows = [[800.0]]\n'


def answered(folder: Path, text: str) -> tuple[dict[str, float], str | None, Machine, Run]:
    """Responses and reason of a study's one variant, its machine, and its run recorded at every tick."""
    spec = write_spec(folder, text)
    ((_, row, found, reason),) = rows_of(spec, folder / "out")
    machine = machine_of(read_study(spec), np.array(row))
    return found, reason, machine, simulate(machine, setpoints_of(read_trace(folder / "move.csv"), machine), sample_period=TICK)


def windings(machine: Machine, run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of X: voltage held over each tick [V], which i(t) = final + away exp(-R t / L) shows; mean current over it [A]; speed before it [rad/s]."""
    axis = machine.axis("X")
    motor = axis.motor
    current, speed = run.trace.get("X", "current"), run.trace.get("X", "velocity") / axis.ratio
    kept = np.exp(-motor.resistance_ohm / motor.inductance_h * TICK)
    final = (current[1:] - current[:-1] * kept) / (1.0 - kept)
    mean = final + (current[:-1] - final) * (1.0 - kept) * motor.inductance_h / (motor.resistance_ohm * TICK)
    return final * motor.resistance_ohm + motor.back_emf_v_s_per_rad * speed[:-1], mean, speed[:-1]


def test_drives_are_those_of_a_record_of_every_tick(tmp_path: Path) -> None:
    write_move(tmp_path / "move.csv", distance=0.08, speed=0.25, acceleration=4.0)
    write_machine(load_machine().with_values(RATED), tmp_path / "rated.toml")
    found, _, machine, run = answered(tmp_path, f'machine = "rated.toml"\n{MASS}')
    x = machine.axis("X")
    voltage, mean, speed = windings(machine, run)
    torque = x.motor.torque_constant_nm_per_a * mean
    assert found["electrical_energy_X_j"] == pytest.approx(x.motor.phases * float(voltage @ mean) * TICK, rel=1e-5)
    after = run.trace.get("X", "velocity")[1:] / x.ratio
    work = torque * (speed + after) / 2.0 * TICK
    assert found["mechanical_energy_X_j"] == pytest.approx(work.sum(), rel=2e-3)
    assert found["braking_energy_X_j"] == pytest.approx(-work[work < 0.0].sum(), rel=2e-3)
    # the tick closest to the motor's torque curve; speed bins are 2.5 % of the limit wide
    driving = torque * speed > 0.0
    assert found["torque_curve_used_X"] == pytest.approx(
        np.max(np.abs(torque) / x.motor.torque_at(np.abs(speed)), where=driving, initial=0.0), rel=0.03
    )
    # heat through the thermal time constant, the cycle repeated until it is periodic
    gone, heat, largest = np.exp(-TICK / 0.05), 0.0, 0.0
    for turn in range(8):
        for square in run.trace.get("X", "current")[:-1] ** 2:
            heat = heat * gone + square * (1.0 - gone)
            largest = max(largest, heat) if turn == 7 else 0.0
    assert found["winding_heat_used_X"] == pytest.approx(largest * (1.4 / 18.0) ** 2, rel=0.03)
    assert found["winding_heat_used_X"] > 1.5 * found["torque_rms_used_X"] ** 2
    assert found["inertia_ratio_X"] == pytest.approx(800.0 * x.ratio**2 / x.rotor_inertia_kg_m2, rel=1e-12)
    assert found["motor_speed_used_X"] == pytest.approx(np.abs(run.trace.get("X", "velocity")).max() / x.ratio / (120.0 * np.pi))


def test_contours_are_those_of_a_record_of_every_tick(tmp_path: Path) -> None:
    """Deviations of tool tip and tool axis from the path, of a record of 1 kHz against one of 125 us."""
    signals, longest = {}, 0
    for axis, distance in (("X", 0.02), ("Y", 0.015), ("A", 0.2), ("C", 0.3)):
        time, way = moves_in_turn(0.0, [distance, -distance], 0.2, 2.0, 50.0, 0.06, 1e-3)
        signals[axis, "setpoint"] = way
        longest = max(longest, len(time))
    signals = {key: np.pad(way, (0, longest - len(way)), mode="edge") for key, way in signals.items()}
    trace = Trace(np.arange(longest) * 1e-3, signals, {"X": "linear", "Y": "linear", "A": "rotary", "C": "rotary"})
    write_trace(trace, tmp_path / "move.csv")
    found, _, machine, run = answered(tmp_path, MASS)
    commanded, followed = (tool_path_of(run.trace, signal, machine) for signal in ("setpoint", "position"))
    fine = contour_error(followed, commanded, search_window(machine))
    assert found["contour_error_max_um"] == pytest.approx(fine.error.max() * 1e6, rel=0.01)
    assert found["contour_error_rms_um"] == pytest.approx(np.sqrt(np.mean(fine.error**2)) * 1e6, rel=0.01)
    assert found["orientation_error_max_arcsec"] == pytest.approx(np.degrees(fine.orientation.max()) * 3600.0, rel=0.01)
    assert found["orientation_error_max_arcsec"] > 1.0


def test_a_position_gain_raised_by_its_margin_is_on_the_edge(tmp_path: Path) -> None:
    found, _, machine, _ = answered(tmp_path, MASS)
    x = machine.axis("X")
    for share, stable in ((0.99, True), (1.01, False)):
        gain = x.loops.position_gain_per_s * 10.0 ** (found["gain_margin_position_loop_X_db"] / 20.0) * share
        other = machine.with_values({"axis.X.loops.position_gain_per_s": gain})
        position = next(
            loop for loop in loops_of(other, other.axis("X"), inertia_at_motor(other, other.axis("X"))) if loop.name == "position"
        )
        assert margins_of(position).stable == stable


def test_half_a_millisecond_of_clipped_voltage_is_reported_and_allowed(tmp_path: Path) -> None:
    write_move(tmp_path / "move.csv", distance=0.3, speed=0.2)
    _, _, machine, run = answered(tmp_path, MASS)
    voltage = np.sort(np.abs(windings(machine, run)[0]))
    for rank, allowed in ((4, True), (400, False)):
        (tmp_path / str(rank)).mkdir()
        write_move(tmp_path / str(rank) / "move.csv", distance=0.3, speed=0.2)
        limit = float(voltage[-rank])
        found, reason, machine, run = answered(tmp_path / str(rank), f'[fixed]\n"axis.X.motor.bus_limit_v" = {limit}\n{MASS}')
        clipped = np.count_nonzero(np.abs(windings(machine, run)[0]) > limit * (1.0 - 1e-9)) * TICK
        assert clipped > 0.0
        share = found["time_at_voltage_limit_X_share"]
        assert share == pytest.approx(clipped / found["cycle_time_s"], rel=0.02, abs=1.5 * TICK / found["cycle_time_s"])
        assert ("time at voltage limit of X" in (reason or "")) != allowed
        assert (0.0 < share < 1e-3) == allowed


@pytest.mark.parametrize("stiffness", [0.0, 3.6e6, 3.7e7])
def test_margins_do_not_depend_on_the_grid_of_frequencies(tmp_path: Path, stiffness: float) -> None:
    """On the coarse frequency grid of a study, crossings and -3 dB points are refined and notches between grid points are found."""
    spring = f'"effect.transmission_compliance.X.stiffness" = {stiffness}\n"effect.transmission_compliance.X.damping" = 8000.0\n'
    found, _, machine, _ = answered(tmp_path, (f"[fixed]\n{spring}" if stiffness else "") + MASS)
    x = machine.axis("X")
    for loop in loops_of(machine, x, inertia_at_motor(machine, x)):
        fine, name = margins_of(loop, 6000), f"{loop.name}_loop_X"
        assert found[f"phase_margin_{name}_deg"] == pytest.approx(fine.phase if fine.stable else 0.0, abs=1e-6)
        assert found[f"crossover_{name}_hz"] == pytest.approx(fine.crossover, rel=1e-9)
        if fine.stable:
            assert found[f"bandwidth_{name}_hz"] == pytest.approx(fine.bandwidth, rel=1e-6)
            assert np.abs(loop.closed_response(np.array([fine.bandwidth])))[0] == pytest.approx(np.sqrt(0.5), rel=1e-6)
