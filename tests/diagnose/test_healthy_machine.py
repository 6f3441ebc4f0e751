"""No false blame: a controller that follows its law, encoders with different zeros."""

from pathlib import Path

import numpy as np
import pytest

from twin.diagnose import diagnose
from twin.diagnose import observe as observing
from twin.effects import parse_setting, with_effects
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.recordings.trace import Trace, read_trace
from twin.simulation.encoder_zeros import with_common_zeros
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "x_200mm.csv"


@pytest.fixture(scope="module")
def machine() -> Machine:
    """One axis whose set point is delayed by one and a half cycles; the set point between the cycles is not recorded."""
    return load_machine().with_axes(["X"]).with_values({"axis.X.loops.position_delay_s": 0.003})


def campaign_of(real: Machine) -> Campaign:
    """Two runs of a control with linear interpolation between its cycles."""
    linear = real.with_values({"control.setpoint_interpolation": "linear"})
    linear = with_effects(linear, real.effects)
    setpoints = setpoints_of(read_trace(EXAMPLE), linear)
    runs = [simulate(linear, setpoints, sample_period=0.002, noise_seed=seed).trace for seed in (1, 2)]
    return Campaign(EXAMPLE, real.name, tuple(MeasuredRun(f"run {k}", trace, "velocity+torque", 0.0) for k, trace in enumerate(runs)))


def test_a_control_that_interpolates_its_own_way_is_healthy(machine: Machine) -> None:
    diagnosis = diagnose(campaign_of(machine), machine, quick=True)
    assert diagnosis.verdict == "none"
    assert not [place for place in diagnosis.where if "controller" in place["block"]]


def test_without_model_error_it_would_be_blamed(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(observing, "between_cycles", lambda view, axis: np.zeros(len(view.trace.time)))
    monkeypatch.setattr(observing, "law_model_error", lambda view, axis: 0.0)
    monkeypatch.setattr("twin.diagnose.validation.find_unlisted_laws", lambda *_: pytest.fail("--quick must not search for laws"))
    assert diagnose(campaign_of(machine), machine, quick=True).verdict != "none"


def test_a_faulty_controller_is_found(machine: Machine) -> None:
    soft = with_effects(machine, [parse_setting("position_gain:X:factor=0.8", machine)])
    diagnosis = diagnose(campaign_of(soft), machine, quick=True)
    assert [setting.effect.name for setting, _, _ in diagnosis.named] == ["position_gain"]
    assert diagnosis.named[0].setting.parameters["factor"] == pytest.approx(0.8, abs=0.01)
    assert diagnosis.where[0]["block"] == "position controller"


def run_with(difference: np.ndarray, started_at: float, at: float = 0.0) -> MeasuredRun:
    """A run whose motor encoder differs from the scale by `difference` (sample,)."""
    position = at + 0.05 * np.sin(np.linspace(0.0, 6.0, len(difference)))
    signals = {("X", "setpoint"): position, ("X", "position"): position, ("X", "motor_position"): position + difference}
    return MeasuredRun("run", Trace(0.002 * np.arange(len(difference)), signals, {"X": "linear"}), None, started_at)


ONES = np.ones(500)


@pytest.mark.parametrize(
    ("differences", "of_zeros"),
    [
        ([3e-5 * ONES, -2e-4 * ONES], True),
        ([0.3 * ONES], True),
        ([5e-8 * ONES, 5e-8 * ONES], False),  # noise
        ([np.where(np.arange(500) < 250, 1e-5, -1e-5)] * 2, False),  # backlash
        ([1e-6 * k * ONES for k in range(8)], False),  # thermal growth from run to run
        ([1e-6 * k * ONES for k in (5, 0, 7, 2, 6, 1, 4, 3)], True),
    ],
)
def test_zeros_are_distinguished_from_faults(differences, of_zeros: bool) -> None:
    runs = [run_with(difference, 60.0 * k) for k, difference in enumerate(differences)]
    mended, found = with_common_zeros(runs, load_machine())
    assert set(found) == ({"X"} if of_zeros else set())
    for run, before in zip(mended, runs):
        left = run.trace.get("X", "motor_position") - run.trace.get("X", "position")
        assert np.allclose(left, 0.0, atol=1e-15) if of_zeros else run is before
