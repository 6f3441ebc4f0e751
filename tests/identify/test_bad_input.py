"""Bad recordings are noticed and named: what is missing, wrong flags, late, clipped and stuck channels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.builders.identify_campaigns import ONE_WAY, SHORT_LADDER, campaign, path, recorded, usual_runs, with_signal
from twin.cli import main
from twin.errors import InputError
from twin.identify.axis_run import axis_run
from twin.identify.identify import identify
from twin.identify.result import Identification
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun


@pytest.fixture(scope="module")
def machine(mikron: Machine) -> Machine:
    return mikron.with_axes(["X"])


@pytest.fixture(scope="module")
def runs(machine: Machine) -> list[MeasuredRun]:
    return usual_runs(machine, short=True)


@pytest.fixture(scope="module")
def good(machine: Machine, runs: list[MeasuredRun]) -> Identification:
    """The identification of the runs without a fault."""
    return identified(machine, runs)


def identified(machine: Machine, runs: list[MeasuredRun]) -> Identification:
    return identify(campaign(runs), machine, refine=False, gaps=False)


def said(result: Identification) -> str:
    return " | ".join(str(f) for f in result.findings)


def test_a_good_recording_has_no_findings(good: Identification) -> None:
    assert said(good) == ""
    assert good.parameter("X", "inertia").estimate.value == pytest.approx(0.008573, rel=0.005)


@pytest.mark.parametrize(
    ("signal", "words"),
    [
        ("current", "no current in any run: cannot identify inertia"),
        ("velocity_setpoint", "no velocity set point in any run"),
        ("velocity", "no velocity in any run"),
    ],
)
def test_missing_signals_are_named_with_the_parameters_that_need_them(
    machine: Machine, runs: list[MeasuredRun], signal: str, words: str
) -> None:
    result = identified(machine, [with_signal(r, "X", signal, None) for r in runs])
    assert words in said(result)
    assert not any((c.axis, c.signal) == ("X", signal) for c in result.skews)  # no lateness of what was not recorded
    names = {p.name for p in result.parameters}
    assert ("inertia" in names) == (signal != "current")
    assert ("velocity_feedforward" in names) == (signal != "velocity_setpoint")


def test_one_encoder_is_enough_for_the_mechanics(machine: Machine, runs: list[MeasuredRun]) -> None:
    result = identified(machine, [with_signal(r, "X", "motor_position", None) for r in runs])
    assert result.parameter("X", "inertia").estimate.value == pytest.approx(0.008573, rel=0.01)


def test_nothing_to_identify_is_an_error_with_a_remedy(machine: Machine, runs: list[MeasuredRun]) -> None:
    bare = [with_signal(with_signal(r, "X", "current", None), "X", "velocity_setpoint", None) for r in runs]
    with pytest.raises(InputError, match="record position, current and velocity_setpoint"):
        identified(machine, bare)


def test_a_wrong_feedforward_flag_is_noticed_and_put_right(machine: Machine, runs: list[MeasuredRun]) -> None:
    wrong = [replace(r, feedforward={"quick_off": "velocity+torque", "quick": "off"}.get(r.name, r.feedforward)) for r in runs]
    result = identified(machine, wrong)
    assert "run quick_off: campaign.toml has feedforward 'velocity+torque', but the signals show 'off'" in said(result)
    assert "run quick: campaign.toml has feedforward 'off', but the signals show 'velocity+torque'" in said(result)
    assert result.parameter("X", "velocity_feedforward").value.value == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("samples", [2, -3])
def test_the_delay_of_a_late_current_is_measured_and_corrected(machine: Machine, runs: list[MeasuredRun], samples: int) -> None:
    late = [with_signal(r, "X", "current", np.roll(r.trace.get("X", "current"), samples)) for r in runs]
    result = identified(machine, late)
    item = next(c for c in result.skews if c.signal == "current")
    assert item.seconds == pytest.approx(samples * 1e-3, abs=0.25e-3)
    assert "current was recorded" in said(result)
    assert result.parameter("X", "inertia").estimate.value == pytest.approx(0.008573, rel=0.03)


def test_the_delay_of_a_late_motor_encoder_is_measured(machine: Machine, runs: list[MeasuredRun]) -> None:
    late = [with_signal(r, "X", "motor_position", np.roll(r.trace.get("X", "motor_position"), 1)) for r in runs]
    result = identified(machine, late)
    item = next(c for c in result.skews if c.signal == "motor_position")
    assert item.seconds == pytest.approx(1e-3, abs=2e-5)
    assert said(result).count("; corrected") == 1  # the other channels, timed against the motor, are not late


def test_a_late_speed_set_point_is_taken_back(machine: Machine, runs: list[MeasuredRun]) -> None:
    late = [with_signal(r, "X", "velocity_setpoint", np.roll(r.trace.get("X", "velocity_setpoint"), 4)) for r in runs[1:]]
    result = identified(machine, late)
    assert "velocity_setpoint was recorded 4.000 ms late" in said(result)
    assert "campaign.toml has" not in said(result)  # late, it looks like another feedforward
    assert result.parameter("X", "position_delay_s").value.value == pytest.approx(0.002, abs=5e-6)


def test_a_clipped_current_is_reported_and_not_used(machine: Machine, runs: list[MeasuredRun]) -> None:
    clipped = [with_signal(r, "X", "current", np.clip(r.trace.get("X", "current"), -4.0, 4.0)) for r in runs]
    result = identified(machine, clipped)
    assert "current at its limit or clipped" in said(result)
    assert result.parameter("X", "coulomb_friction").estimate.value == pytest.approx(1.8, rel=0.01)


@pytest.mark.parametrize("signal", ["velocity", "velocity_setpoint", "motor_position", "position"])
def test_a_clipped_channel_is_reported_and_its_clipped_parts_not_used(machine: Machine, runs: list[MeasuredRun], signal: str) -> None:
    share = 0.6 if signal.startswith("velocity") else 0.8
    clipped = []
    for run in runs:
        values = run.trace.get("X", signal)
        limit = share * np.abs(values).max()
        clipped.append(with_signal(run, "X", signal, np.clip(values, -limit, limit)))
    result = identified(machine, clipped)
    assert f"{signal} stays at its largest value for" in said(result)
    assert result.parameter("X", "coulomb_friction").estimate.value == pytest.approx(1.8, rel=0.01)
    assert result.parameter("X", "position_delay_s").value.value == pytest.approx(0.002, abs=20e-6)


def test_a_saturated_current_is_reported_and_not_used(machine: Machine) -> None:
    weak = machine.with_axis("X", peak_current_a=4.5)
    result = identified(weak, usual_runs(weak))
    assert "current at its limit or clipped" in said(result)
    assert result.parameter("X", "coulomb_friction").estimate.value == pytest.approx(1.8, rel=0.01)
    assert "no run identifies speed gain; add runs that stay below the current limit" in said(result)


def test_the_delay_of_a_late_speed_is_measured(machine: Machine, runs: list[MeasuredRun]) -> None:
    late = [with_signal(r, "X", "velocity", np.roll(r.trace.get("X", "velocity"), 2)) for r in runs]
    item = next(c for c in identified(machine, late).skews if c.signal == "velocity")
    assert item.seconds == pytest.approx(2e-3, abs=5e-5)


def test_an_unidentified_parameter_is_named_with_the_run_that_identifies_it(machine: Machine, runs: list[MeasuredRun]) -> None:
    result = identified(machine, [r for r in runs if r.feedforward != "velocity+torque"])
    assert "no run identifies torque feedforward; add accelerations with torque feedforward on" in said(result)


def test_the_only_run_with_a_feedforward_setting_is_not_held_out(machine: Machine, runs: list[MeasuredRun], good: Identification) -> None:
    assert good.held_out == ()
    again = [*runs, recorded(machine, "again", SHORT_LADDER, "velocity", 9)]
    assert identified(machine, again).held_out == ("again",)


def test_motion_in_one_direction_only_is_reported(machine: Machine) -> None:
    runs = [recorded(machine, f"way_{k}", ONE_WAY, "velocity", k) for k in range(2)]
    assert "moves in one direction only" in said(identified(machine, runs))


def test_in_one_direction_coulomb_friction_and_weight_are_one_number(machine: Machine) -> None:
    result = identified(machine, [recorded(machine, "way", ONE_WAY, "velocity", 1)])
    assert "coulomb_friction" not in {p.name for p in result.parameters}
    assert "no run identifies Coulomb friction; add constant speeds in both directions" in said(result)
    assert result.machine.axis("X").coulomb_friction_nm == pytest.approx(1.8, rel=0.05)


def test_a_current_of_the_wrong_sign_is_not_used(machine: Machine, runs: list[MeasuredRun]) -> None:
    result = identified(machine, [with_signal(r, "X", "current", -r.trace.get("X", "current")) for r in runs])
    assert "so it contradicts the motion and is not used; check the sign of the column" in said(result)
    assert "inertia" not in {p.name for p in result.parameters}
    assert result.machine.axis("X").coulomb_friction_nm == machine.axis("X").coulomb_friction_nm
    assert result.parameter("X", "position_gain_per_s").value.value == pytest.approx(50.0, rel=1e-3)


def test_a_current_in_another_unit_is_not_used(machine: Machine, runs: list[MeasuredRun]) -> None:
    result = identified(machine, [with_signal(r, "X", "current", 1e3 * r.trace.get("X", "current")) for r in runs])
    assert "the motor's peak is 46 A: not used; check the unit of the column" in said(result)
    assert "inertia" not in {p.name for p in result.parameters}


def test_a_short_run_is_not_used_and_no_other_run_is_an_error(machine: Machine, runs: list[MeasuredRun]) -> None:
    def cut(run: MeasuredRun, samples: int) -> MeasuredRun:
        signals = {key: values[:samples] for key, values in run.trace.signals.items()}
        return replace(run, trace=replace(run.trace, time=run.trace.time[:samples], signals=signals))

    result = identified(machine, [*runs, cut(replace(runs[0], name="broken off"), 40)])
    assert "run broken off: only 0.039 s long: not used" in said(result)
    assert "broken off" not in result.training + result.held_out
    with pytest.raises(InputError, match="no run is longer than"):
        identified(machine, [cut(r, 2) for r in runs])


def test_peaks_that_the_recorder_clipped_are_not_used(machine: Machine, runs: list[MeasuredRun]) -> None:
    """The saw-tooth of the current meets the limit for single samples: none stays on it."""
    limit = 0.85 * max(np.abs(r.trace.get("X", "current")).max() for r in runs)
    result = identified(machine, [with_signal(r, "X", "current", np.clip(r.trace.get("X", "current"), -limit, limit)) for r in runs])
    assert "current at its limit or clipped" in said(result)
    inertia = result.parameter("X", "inertia").estimate
    assert inertia.value == pytest.approx(0.008573, rel=0.01)
    assert inertia.low <= 0.008573 <= inertia.high


def test_a_narrow_range_of_speeds_is_reported(machine: Machine) -> None:
    points = path([0.2, -0.2, 0.2, -0.2], [0.15] * 4)
    assert "too narrow a range of speeds" in said(
        identified(machine, [recorded(machine, f"one_speed_{k}", points, "velocity", k) for k in range(2)])
    )


def test_an_axis_that_never_moves_is_named(mikron: Machine) -> None:
    both = mikron.with_axes(["X", "Y"])
    result = identified(both, usual_runs(both, short=True))
    assert "axis Y: never moves" in said(result)
    assert {p.axis for p in result.parameters if p.product} == {"X"}


def test_a_stuck_channel_is_named(machine: Machine, runs: list[MeasuredRun]) -> None:
    stuck = [with_signal(r, "X", "velocity", np.zeros(len(r.trace.time))) if r.name == "quick" else r for r in runs]
    assert "run quick axis X: velocity never changes" in said(identified(machine, stuck))


def test_a_campaign_that_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["identify", str(tmp_path / "nowhere"), "--out", str(tmp_path / "m.toml")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_period_that_does_not_fit_the_cycle_is_an_error(machine: Machine, runs: list[MeasuredRun]) -> None:
    odd = [replace(r, trace=replace(r.trace, time=r.trace.time * 1.5)) for r in runs]
    with pytest.raises(InputError, match="whole number of samples in a position cycle"):
        identified(machine, odd)


@pytest.mark.parametrize("samples", [3, 5, 64])
def test_samples_between_the_ticks_are_an_error(machine: Machine, runs: list[MeasuredRun], samples: int) -> None:
    """16 ticks a cycle are no three samples; a machine of 4 ms is told its own periods."""
    for cycle_ms, known in ((2, "2, 1, 0.5, 0.25, 0.125 ms"), (4, "4, 2, 1, 0.5, 0.25, 0.125 ms")):
        other = machine.with_values({"control.position_cycle_us": cycle_ms * 1e3})
        period = other.position_cycle / samples
        odd = replace(runs[0], trace=replace(runs[0].trace, time=np.arange(len(runs[0].trace.time)) * period))
        words = (
            f"sampled every {period * 1e3:g} ms, the position cycle is {cycle_ms} ms; .* divides its {8 * cycle_ms} ticks: every {known}"
        )
        with pytest.raises(InputError, match=words):
            axis_run(other, other.axis("X"), odd)


def test_a_current_without_its_sign_is_named_and_not_fitted(machine: Machine, runs: list[MeasuredRun]) -> None:
    unsigned = [with_signal(r, "X", "current", np.abs(r.trace.get("X", "current"))) for r in runs]
    result = identified(machine, unsigned)
    assert "current is recorded without its sign" in said(result)
    assert "record X.current with its sign" in said(result)
    assert "inertia" not in {p.name for p in result.parameters}
    assert "position_gain_per_s" in {p.name for p in result.parameters}


@pytest.mark.parametrize(
    ("signal", "factor", "words"),
    [
        ("velocity", 60.0, "recorded per minute, taken as per second?"),
        ("position", 1e3, "mm taken as m"),
        ("motor_position", -1.0, "it runs the other way"),
        ("current", 1e3, "check the unit of the column"),
    ],
)
def test_a_wrong_unit_is_named_before_anything_is_fitted(
    machine: Machine, runs: list[MeasuredRun], signal: str, factor: float, words: str
) -> None:
    result = identified(machine, [with_signal(r, "X", signal, factor * r.trace.get("X", signal)) for r in runs])
    assert words in said(result)
    gain = [p for p in result.parameters if p.name == "position_gain_per_s"]
    assert all(p.estimate.value == pytest.approx(machine.axis("X").loops.position_gain_per_s, rel=0.02) for p in gain)
