"""The gap is a multiple of noise even if the machine file states no noise."""

from dataclasses import replace
from pathlib import Path

from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import read_trace
from twin.simulation.gap import LEAST_NOISE, gap_of, predict
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "x_200mm.csv"


def test_a_machine_file_without_noise_uses_the_smallest_noise() -> None:
    machine = load_machine()
    noises = {key: 0.0 for key in machine.document["measurement"] if "noise" in key or "resolution" in key}
    machine = machine.with_axes(["X"]).with_values({f"measurement.{key}": value for key, value in noises.items()})
    assert machine.noise(machine.axis("X")).position == 0.0
    trace = simulate(machine, setpoints_of(read_trace(EXAMPLE), machine)).trace
    trace = replace(trace, signals={**trace.signals, ("X", "position"): trace.get("X", "position") + 1e-6})
    gaps = gap_of(machine, run := MeasuredRun("out and back", trace, None, 0.0), predict(machine, run, realisations=1))["X"]
    assert gaps["position"].rms > 0.9
    assert gaps["position"].noise == 1e6 * LEAST_NOISE["position"]
    assert all(gap.noise > 0.0 for gap in gaps.values())
