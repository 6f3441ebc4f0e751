"""Pre-sliding and a structural mode in the fit of a drive: found where they are, left out where they are not."""

from pathlib import Path

import numpy as np
import pytest

from tests.builders.other_structures import slides, write_slides
from twin.estimate.held_out_gain import predicts_better
from twin.geometry.scurve import moves_in_turn
from twin.identify.drive_fit import FOLDS, fit_drives, folds_of
from twin.identify.drive_residuals import Fitted
from twin.identify.parameters import with_drives
from twin.machine.machine import Machine, load_machine
from twin.machine.parameters import MOST_MODE_SHARE
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

RECORDED = ("setpoint", "position", "velocity_setpoint", "current")
MODE = {"mode_frequency_hz": 29.0, "mode_mass_share": 0.35, "mode_damping_ratio": 0.04}
SLIP = {"presliding_stiffness_n_per_m": 5e6}


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    stiff = {"axis.Z.loops.speed_filter_time_s": 0.0, "axis.Z.loops.speed_gain_nm_s_per_rad": 0.15}
    return load_machine(write_slides(tmp_path)).with_axes(["Z"]).with_values(stiff)


def changed(machine: Machine, values: dict[str, float]) -> Machine:
    return machine.with_values({f"axis.Z.{k}": v for k, v in values.items()})


def recording(machine: Machine, ways: list[float]) -> MeasuredRun:
    """Short moves of Z with pauses and measuring noise, sampled every 2 ms."""
    position = moves_in_turn(0.0, ways, 0.05, 1.0, 60.0, 0.3, 1e-3)[1]
    trace = simulate(machine, Setpoints(position[:, None], 1e-3), sample_period=2e-3, noise_seed=1).trace
    kept = {k: v for k, v in trace.signals.items() if k[1] in RECORDED}
    return MeasuredRun("made", Trace(trace.time, kept, trace.kinds), "velocity", 0.0)


def fitted(machine: Machine, values: dict[str, float], ways: list[float]) -> tuple[Machine, dict[str, Fitted]]:
    run = recording(changed(machine, values), ways)
    return fit_drives(machine, [run], {"Z": [np.ones(len(run.trace.time), bool)]}, known=[("Z", "position_delay_s")])


WAYS = [0.004, -0.003, 0.004, -0.005]


def test_both_are_found_together(machine: Machine) -> None:
    refined, fits = fitted(machine, {**MODE, **SLIP}, WAYS)
    found = refined.axis("Z")
    assert found.mode_frequency_hz == pytest.approx(29.0, rel=0.03)
    assert found.mode_mass_share == pytest.approx(0.35, rel=0.2)
    assert found.presliding_stiffness == pytest.approx(5e6, rel=0.4)
    table = {p.name: p for p in with_drives([], machine, fits)}
    assert table["mode_frequency_hz"].unit == "Hz"
    assert table["mode_mass_share"].value.high <= MOST_MODE_SHARE


def test_a_rigid_axis_with_plain_friction_gets_neither(machine: Machine) -> None:
    """Also where the friction of its file is another."""
    found = fitted(machine, {"coulomb_friction_nm": 0.08}, WAYS)[0].axis("Z")
    assert (found.presliding_stiffness, found.mode_mass_share) == (0.0, 0.0)


def test_a_single_move_shows_neither(machine: Machine) -> None:
    found = fitted(machine, {**MODE, **SLIP}, [0.004])[0].axis("Z")
    assert (found.presliding_stiffness, found.mode_mass_share) == (0.0, 0.0)


FAST = {"control.position_cycle_us": 125.0, "control.speed_cycle_us": 125.0}


def along_its_path(machine: Machine, exact: bool) -> MeasuredRun:
    """A recording of an unknown control: path and current alone; the path is the set point, exactly or nearly."""
    position = moves_in_turn(0.0, WAYS, 0.05, 1.0, 60.0, 0.3, 1.25e-4)[1]
    simulated = simulate(machine.with_values(FAST), Setpoints(position[:, None], 1.25e-4), sample_period=1.25e-4).trace
    path = simulated.get("Z", "position")
    signals = {("Z", "setpoint"): path if exact else path + 1e-9, ("Z", "position"): path, ("Z", "current"): simulated.get("Z", "current")}
    return MeasuredRun("made", Trace(simulated.time, signals, simulated.kinds), "velocity", 0.0)


@pytest.mark.parametrize("exact", [True, False])
def test_without_the_control_a_mode_needs_the_recorded_path(machine: Machine, exact: bool) -> None:
    run = along_its_path(changed(machine, MODE), exact)
    stiff = {"loops.speed_gain_nm_s_per_rad": 0.3, "loops.position_delay_s": 0.0, "loops.position_gain_per_s": 100.0}
    follower = changed(machine, stiff).with_values(FAST)
    refined, _ = fit_drives(follower, [run], {"Z": [np.ones(len(run.trace.time), bool)]}, known=[("Z", "position_delay_s")])
    found = refined.axis("Z")
    if exact:
        assert found.mode_frequency_hz == pytest.approx(29.0, rel=0.05)
        assert found.mode_mass_share == pytest.approx(0.35, abs=0.15)
    else:  # errors of an assumed control would pass for a mode
        assert found.mode_mass_share == 0.0


@pytest.mark.parametrize(("ways", "count"), [([0.004], 0), ([0.004, -0.003], 2), ([0.004, 0.001, -0.005], 3), ([0.004, -0.004] * 4, FOLDS)])
def test_folds_are_whole_moves(machine: Machine, ways: list[float], count: int) -> None:
    run = recording(machine, ways)
    rows = [np.ones(len(run.trace.time), bool)]
    folds = folds_of(machine.axis("Z"), [run], rows)
    assert len(folds) == count
    if folds:
        assert np.array_equal(np.sum([f[0] for f in folds], axis=0), rows[0])
        speed = np.gradient(run.trace.get("Z", "setpoint"), 2e-3)
        # a boundary lies at the beginning of a move
        for fold in folds[1:]:
            assert abs(speed[np.flatnonzero(fold[0])[0]]) < 2e-3


def test_one_fold_that_is_predicted_worse_is_enough_to_refuse() -> None:
    assert predicts_better([-5.3, -5.2], [-5.0, -5.0])
    assert not predicts_better([-5.9, -4.9], [-5.0, -5.0])
    assert not predicts_better([-5.01, -5.01], [-5.0, -5.0])
    assert not predicts_better([-5.5, np.inf], [-5.0, -5.0])


def test_the_whole_load_may_swing_behind_its_rotor(tmp_path: Path) -> None:
    """A drive of two masses: the share is at its upper bound, and the rotor is fitted beside it. Without a rotor such a fit is refused."""
    rigid = slides(tmp_path, "B", (125, 125)).with_values({"axis.B.loops.velocity_feedforward": 1.0})
    mode = {"axis.B.mode_frequency_hz": 12.0, "axis.B.mode_mass_share": MOST_MODE_SHARE, "axis.B.mode_damping_ratio": 0.03}
    position = moves_in_turn(0.0, [0.3, -0.3, 0.3, -0.2], 1.0, 10.0, 600.0, 0.4, 1.25e-4)[1]
    simulated = simulate(rigid.with_values(mode), Setpoints(position[:, None], 1.25e-4), sample_period=1e-3).trace
    run = MeasuredRun(
        "made",
        Trace(simulated.time, {k: v for k, v in simulated.signals.items() if k[1] in ("setpoint", "position", "torque")}, simulated.kinds),
        "velocity",
        0.0,
    )
    found = fit_drives(rigid, [run], {"B": [np.ones(len(run.trace.time), bool)]})[0].axis("B")
    assert found.mode_frequency_hz == pytest.approx(12.0, rel=0.05)
    assert found.mode_mass_share == pytest.approx(MOST_MODE_SHARE, rel=0.05)
