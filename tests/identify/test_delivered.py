"""Commanded against delivered effort: gain, delay, offset and limit of an actuator that is known."""

import numpy as np
import pytest

from tests.builders.identify_campaigns import campaign, recorded, with_signal
from twin.identify.effort_delivered import delivered_effort
from twin.identify.identify import identify
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

TIME = np.arange(3000) * 1e-3


def run_of(gain: float, delay: float, offset: float, limit: float = np.inf) -> MeasuredRun:
    """A torque that follows its set point with noise."""
    asked = 10.0 * np.sin(2.0 * np.pi * 1.3 * TIME) + 4.0 * np.sin(2.0 * np.pi * 5.1 * TIME)
    made = np.clip(gain * np.interp(TIME - delay, TIME, asked) + offset, -limit, limit)
    made = made + 0.02 * np.random.default_rng(0).standard_normal(len(TIME))
    signals = {("X", "setpoint"): np.sin(TIME), ("X", "torque_setpoint"): asked, ("X", "torque"): made}
    return MeasuredRun("made", Trace(TIME, signals, {"X": "linear"}), None, 0.0)


@pytest.mark.parametrize(("gain", "delay", "offset"), [(1.0, 0.0, 0.0), (0.9, 2.4e-3, 0.5), (1.1, 7e-3, -0.2)])
def test_gain_delay_and_offset_are_found(mikron: Machine, gain: float, delay: float, offset: float) -> None:
    found = delivered_effort(mikron.axis("X"), [run_of(gain, delay, offset)])
    assert found is not None
    assert found.fit.values[0] == pytest.approx(gain, abs=max(4.0 * found.fit.deviations[0], 1e-3))
    assert found.fit.deviations[0] < 2e-3
    assert found.delay_s == pytest.approx(delay, abs=2e-4)
    assert found.fit.values[1] == pytest.approx(offset, abs=0.01)
    assert found.limit is None
    assert found.off == (gain != 1.0)


def test_a_limit_is_found_and_does_not_bend_the_gain(mikron: Machine) -> None:
    found = delivered_effort(mikron.axis("X"), [run_of(1.0, 1e-3, 0.0, limit=8.0)])
    assert found is not None
    assert found.limit == pytest.approx(8.0, abs=0.1)
    assert found.fit.values[0] == pytest.approx(1.0, abs=0.01)
    assert "limited to 8.0" in found.text()


def test_unrelated_command_and_effort_are_not_compared(mikron: Machine) -> None:
    run = with_signal(run_of(1.0, 0.0, 0.0), "X", "torque", np.random.default_rng(1).standard_normal(len(TIME)))
    assert delivered_effort(mikron.axis("X"), [run]) is None
    assert delivered_effort(mikron.axis("X"), [with_signal(run, "X", "torque", None)]) is None


def test_identification_reports_a_delivered_effort_that_differs_from_its_command(mikron: Machine) -> None:
    machine = mikron.with_axes(["X"])
    run = recorded(machine, "strokes", 0.05 * (1.0 - np.cos(4.0 * np.arange(2400) * 1e-3)), "velocity", 0)
    current = run.trace.get("X", "current")
    asked = with_signal(run, "X", "current_setpoint", current / 0.9)
    result = identify(campaign([asked]), machine, refine=False, gaps=False)
    assert any("delivered current = 0.9 " in str(f) for f in result.findings)


def test_a_faultless_drive_is_no_finding(mikron: Machine) -> None:
    """Samples of current and set point stand at fixed phases of the position cycle, which show other means of the two."""
    machine = mikron.with_axes(["C"])
    turns = Setpoints((np.radians(40.0) * (1.0 - np.cos(6.0 * np.arange(3000) * 1e-3)))[:, None], 1e-3)
    run = MeasuredRun("turns", simulate(machine, turns, noise_seed=0).trace, "off", 0.0)
    found = delivered_effort(machine.axes[0], [run])
    assert found is not None
    assert found.off
    result = identify(campaign([run]), machine, refine=False, gaps=False)
    assert not any("delivered current" in str(f) for f in result.findings)
    assert any("delivered current" in str(f) and "faultless" in str(f) for f in result.notes)
    lost = with_signal(run, "C", "current_setpoint", run.trace.get("C", "current_setpoint") / 0.9)
    assert any("delivered current" in str(f) for f in identify(campaign([lost]), machine, refine=False, gaps=False).findings)


def test_a_record_that_is_shorter_than_the_low_pass_is_compared_too(mikron: Machine) -> None:
    run = run_of(1.0, 0.0, 0.0)
    short = MeasuredRun("short", run.trace.samples(slice(50)), None, 0.0)
    found = delivered_effort(mikron.axis("X"), [run, short])
    assert found is not None
    assert not found.off
