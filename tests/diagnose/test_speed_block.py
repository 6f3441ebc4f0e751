"""The speed controller is compared with its recorded inputs only if each of its set points was recorded."""

from pathlib import Path

import numpy as np
import pytest

from twin.diagnose import diagnose
from twin.diagnose.blocks import block_residuals
from twin.diagnose.observe import observe
from twin.diagnose.view import view_of
from twin.effects import parse_setting, with_effects
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.recordings.trace import read_trace
from twin.simulation.drive_setpoints import speed_set_point
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "x_200mm.csv"


@pytest.mark.parametrize(("period_s", "blocks"), [(1e-3, 1), (2e-3, 1), (4e-3, 0)])
def test_law_of_the_speed_controller(period_s: float, blocks: int) -> None:
    machine = load_machine().with_axes(["X"])
    setpoints = setpoints_of(read_trace(EXAMPLE), machine)
    trace = simulate(machine, setpoints, sample_period=period_s, noise_seed=1).trace
    view = view_of(machine, MeasuredRun("out and back", trace, "velocity+torque", 0.0))
    found = [b for b in block_residuals(observe([view], ("X",)), lambda m: m) if b.block == "speed controller"]
    assert len(found) == blocks
    assert all(float(np.std(b.residual)) < 1.3 * b.sigma for b in found)


@pytest.mark.parametrize("period_s", [5e-4, 2e-3])
@pytest.mark.parametrize("faulty", [False, True])
def test_a_drive_that_closes_the_position_loop(period_s: float, faulty: bool) -> None:
    """The drive computes the input of its speed loop from the command of the NC. A healthy drive follows its law, one with low gain does not."""
    nominal = dsc_machine()
    real = with_effects(nominal, [parse_setting("speed_gain:X:factor=0.6", nominal)]) if faulty else nominal
    setpoints = setpoints_of(read_trace(EXAMPLE), nominal)
    trace = simulate(real, setpoints, sample_period=period_s, noise_seed=1).trace
    view = view_of(nominal, MeasuredRun("out and back", trace, "velocity+torque", 0.0))
    scores = {b.block: float(np.mean(b.normed**2)) for b in block_residuals(observe([view], ("X",)), lambda m: m)}
    assert (scores["speed controller"] > 1.5) == faulty, scores
    assert scores["position controller"] < 1.5, scores


@pytest.mark.parametrize("delay_s", [5.25e-3, 5.3e-3, 5e-4])
def test_the_reconstructed_set_point_is_that_of_the_drive(delay_s: float) -> None:
    """The set point reconstructed from recorded command and position equals that of the simulated drive at each recorded cycle."""
    machine = dsc_machine().with_values({"axis.X.loops.dsc_delay_s": delay_s})
    trace = simulate(machine, setpoints_of(read_trace(EXAMPLE), machine)).trace
    axis = machine.axis("X")
    made = speed_set_point(trace, axis, machine.speed_cycle)
    assert made.shape == (len(trace.time), round(trace.period / machine.speed_cycle))
    follows, sent = trace.get("X", "drive_velocity_setpoint"), trace.get("X", "velocity_setpoint")
    assert np.abs(made[:, 0] - follows).max() < 1e-5 * np.abs(follows).max()
    assert np.abs(sent - follows).max() > 0.01 * np.abs(follows).max()


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 0.7])
def test_diagnosis_of_a_drive_that_closes_the_position_loop(factor: float) -> None:
    """No block of a healthy drive is blamed; a low speed gain is found in the speed controller."""
    nominal = dsc_machine()
    real = nominal if factor == 1.0 else with_effects(nominal, [parse_setting(f"speed_gain:X:factor={factor}", nominal)])
    setpoints = setpoints_of(read_trace(EXAMPLE), nominal)
    traces = [simulate(real, setpoints, sample_period=2e-3, noise_seed=seed).trace for seed in (1, 2)]
    runs = tuple(MeasuredRun(f"run {k}", trace, "velocity+torque", 0.0) for k, trace in enumerate(traces))
    diagnosis = diagnose(Campaign(EXAMPLE, nominal.name, runs), nominal, quick=True)
    found = [(setting.effect.name, setting.parameters["factor"]) for setting, _, _ in diagnosis.named]
    assert [place["block"] for place in diagnosis.where] == ([] if factor == 1.0 else ["speed controller"])
    assert found == ([] if factor == 1.0 else [("speed_gain", pytest.approx(factor, abs=0.02))])


def dsc_machine() -> Machine:
    """X of the default machine under a control like a SINUMERIK with dynamic servo control."""
    return (
        load_machine()
        .with_axes(["X"])
        .with_values(
            {"axis.X.loops.dsc_delay_s": 5.25e-3, "axis.X.loops.position_delay_s": 3e-3, "control.setpoint_interpolation": "linear"}
        )
    )
