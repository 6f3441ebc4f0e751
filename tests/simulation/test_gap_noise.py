"""The gap as a multiple of noise: without noise in the machine file, in motion and at rest, without set points."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin.errors import InputError
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import read_trace
from twin.simulation.gap import LEAST_NOISE, gap_of, is_moving, predict
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "x_200mm.csv"


@pytest.mark.parametrize("rough_um", [0.0, 0.5])
def test_without_noise_in_the_machine_file_the_quiet_part_of_the_record_counts(rough_um: float) -> None:
    """The record of a smooth signal has the smallest noise."""
    machine = load_machine()
    noises = {key: 0.0 for key in machine.document["measurement"] if "noise" in key or "resolution" in key}
    machine = machine.with_axes(["X"]).with_values({f"measurement.{key}": value for key, value in noises.items()})
    assert machine.noise(machine.axis("X")).position == 0.0
    trace = simulate(machine, setpoints_of(read_trace(EXAMPLE), machine)).trace
    rough = 1e-6 + rough_um * 1e-6 * np.random.default_rng(1).standard_normal(len(trace.time))
    trace = replace(trace, signals={**trace.signals, ("X", "position"): trace.get("X", "position") + rough})
    gaps = gap_of(machine, run := MeasuredRun("out and back", trace, None, 0.0), predict(machine, run, realisations=1))["X"]
    assert gaps["position"].rms > 0.9
    assert gaps["position"].noise == pytest.approx(max(rough_um, 1e6 * LEAST_NOISE["position"]), rel=0.1)
    assert all(gap.noise > 0.0 for gap in gaps.values())


@pytest.fixture(scope="module")
def recorded() -> tuple:
    """The machine with X alone, its run out and back, and the prediction."""
    machine = load_machine().with_axes(["X"])
    run = MeasuredRun("run", simulate(machine, setpoints_of(read_trace(EXAMPLE), machine), noise_seed=1).trace, None, 0.0)
    return machine, run, predict(machine, run, realisations=2)


def test_the_own_noise_of_a_signal_leaves_out_that_of_the_prediction(recorded: tuple) -> None:
    """It is that of one recording beside another. Two realisations predict with a noise as large again."""
    machine, run, prediction = recorded
    gap = gap_of(machine, run, prediction)["X"]["motor_position"]
    again = [
        simulate(machine, setpoints_of(read_trace(EXAMPLE), machine), noise_seed=i).trace.get("X", "motor_position") for i in range(2, 12)
    ]
    own = 1e6 * np.sqrt(np.mean(np.var(again, axis=0, ddof=1)))
    assert gap.own_noise == pytest.approx(own, rel=0.15)
    assert gap.noise > 1.25 * own


def changed(run: MeasuredRun, **signals: np.ndarray | None) -> MeasuredRun:
    """The run with other signals of X; None removes one."""
    kept = {**run.trace.signals, **{("X", name): values for name, values in signals.items()}}
    return replace(run, trace=replace(run.trace, signals={key: values for key, values in kept.items() if values is not None}))


def test_an_axis_that_sticks_elsewhere_has_a_gap_at_rest_only(recorded: tuple) -> None:
    machine, run, prediction = recorded
    stuck = np.where(is_moving(run.trace, machine.axis("X")), 0.0, 20e-6)
    gap = gap_of(machine, changed(run, position=run.trace.get("X", "position") + stuck), prediction)["X"]["position"]
    assert gap.rms > 30.0 * gap.noise
    assert gap.times_noise_moving < 1.5


def test_an_axis_without_set_points_is_compared_over_the_whole_run(recorded: tuple) -> None:
    """Its current is refused: it is compared in motion only."""
    machine, run, prediction = recorded
    shifted = changed(run, position=run.trace.get("X", "position") + 2e-6, setpoint=None, current=None)
    gap = gap_of(machine, shifted, prediction)["X"]["position"]
    assert gap.times_noise_moving == pytest.approx(gap.rms / gap.noise)
    with pytest.raises(InputError, match="setpoint"):
        gap_of(machine, changed(run, setpoint=None), prediction)
