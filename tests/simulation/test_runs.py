"""Runs are independent and reproducible bit for bit, need no more memory than their trace, and work for any machine and axes."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
import tracemalloc

import mujoco
import numpy as np
import pytest

from tests.builders.small_machine import write_small_machine
from tests.conftest import swings
from twin.cli import main
from twin.effects import apply_effects, with_effects
from twin.errors import SimulationError
from twin.machine.machine import Machine, load_machine, write_machine
from twin.recordings.trace import Trace, read_trace, write_trace
from twin.simulation.mujoco_plant import MujocoPlant
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints


def assert_same_bits(a: Trace, b: Trace) -> None:
    assert list(a.signals) == list(b.signals)
    for key, values in a.signals.items():
        np.testing.assert_array_equal(values, b.signals[key], err_msg=str(key))


@pytest.mark.parametrize("seed", [None, 7])
def test_repeats_bit_for_bit(mikron: Machine, seed: int | None) -> None:
    points = swings(mikron, 0.6)
    first, second = (simulate(mikron, points, noise_seed=seed).trace for _ in range(2))
    assert_same_bits(first, second)


def test_runs_in_threads_equal_sequential_runs(mikron: Machine) -> None:
    machines = [mikron, mikron.with_feedforward("off"), mikron.with_axis("X", coulomb_friction_nm=2.5), mikron.with_axes(["Z", "C"])]
    jobs = [(machine, swings(machine, 1.5)) for machine in machines]
    serial = [simulate(*job, noise_seed=i).trace for i, job in enumerate(jobs)]
    with ThreadPoolExecutor(max_workers=4) as pool:
        threaded = list(pool.map(lambda i: simulate(*jobs[i], noise_seed=i).trace, range(len(jobs))))
    for a, b in zip(serial, threaded):
        assert_same_bits(a, b)


def test_the_engine_reads_no_clock(mikron: Machine) -> None:
    """Its timers count the steps and measure nothing."""
    plant = MujocoPlant(apply_effects(mikron)).plant
    mujoco.mj_step(plant.model, plant.data, 10)
    timer = plant.data.timer[mujoco.mjtTimer.mjTIMER_STEP]
    assert (timer.number, timer.duration) == (10, 0.0)


def test_noise_depends_on_the_seed_and_is_absent_without(mikron: Machine) -> None:
    points = swings(mikron, 0.3)
    ideal, one, two = (simulate(mikron, points, noise_seed=seed).trace for seed in (None, 1, 2))
    assert not np.array_equal(one.get("X", "current"), two.get("X", "current"))
    error = one.get("X", "current") - ideal.get("X", "current")
    assert 0.03 < np.std(error) < 0.08  # 0.04 A of the sensor, plus the reaction of the loops to noisy speed
    clean = simulate(mikron, points, noise_seed=1).without_noise
    assert np.std(clean.get("X", "current") - ideal.get("X", "current")) < np.std(error)


def test_longer_than_a_stretch_is_the_same(mikron: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    points = swings(mikron, 1.0)
    whole = simulate(mikron, points).trace
    monkeypatch.setattr("twin.simulation.prepared.STRETCH_TICKS", 1_600)
    parts = simulate(mikron, points).trace
    for key, values in whole.signals.items():
        np.testing.assert_allclose(parts.signals[key], values, rtol=1e-9, atol=1e-11, err_msg=str(key))


@pytest.mark.parametrize("axes", [["X"], ["C"], ["A", "C"], ["X", "Y", "Z"], ["Y", "A"]])
def test_any_subset_of_axes(mikron: Machine, axes: list[str]) -> None:
    points = swings(mikron, 0.5)
    machine = mikron.with_axes(axes)
    columns = [mikron.axis_names.index(name) for name in axes]
    alone = simulate(machine, Setpoints(points.position[:, columns], points.period)).trace
    assert alone.axes == tuple(axes)
    if "A" in axes or "C" in axes:
        return  # A and C are coupled by the unbalance of the workpiece
    together = simulate(mikron, points).trace
    for name in axes:
        # nothing else couples X, Y and Z
        np.testing.assert_allclose(alone.get(name, "position"), together.get(name, "position"), rtol=0, atol=1e-11)


def test_another_machine(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_small_machine(tmp_path)
    machine = load_machine(path)
    assert machine.axis_names == ("B", "U")
    points = swings(machine, 0.8)
    time = np.arange(len(points.position)) * points.period
    signals = {(axis.name, "setpoint"): points.position[:, a] for a, axis in enumerate(machine.axes)}
    write_trace(Trace(time, signals, machine.kinds), tmp_path / "swing.parquet")
    out = tmp_path / "out"
    arguments = ["run", str(tmp_path / "swing.parquet"), "--machine", str(path), "--out", str(out), "--no-recording"]
    assert main(arguments) == 0
    assert "small" in capsys.readouterr().out
    trace = read_trace(out / "trace.parquet")
    assert trace.axes == ("B", "U")
    for axis in machine.axes:
        delayed = np.interp(time - axis.loops.position_delay_s, time, trace.get(axis.name, "setpoint"))
        error = np.abs(delayed - trace.get(axis.name, "position")).max()
        assert error < (20e-6 if axis.kind == "linear" else 500e-6)  # no torque feedforward
        assert np.ptp(trace.get(axis.name, "position")) > 0.01


def test_a_machine_survives_its_file(mikron: Machine, tmp_path: Path) -> None:
    changed = mikron.with_values({"axis.X.moving_mass_kg": 690.0, "axis.A.coulomb_friction_nm": 0.6})
    write_machine(changed, tmp_path / "changed.toml", {"axis.X.moving_mass_kg": "weighed"})
    read = load_machine(tmp_path / "changed.toml")
    assert read.axes == changed.axes
    text = (tmp_path / "changed.toml").read_text()
    assert "moving_mass_kg = 690.0 # weighed" in " ".join(text.split())
    assert "# A  stated" in text or "Grades:" in text  # comments of the source stay
    assert_same_bits(simulate(changed, swings(mikron, 0.2)).trace, simulate(read, swings(mikron, 0.2)).trace)


def test_divergence_names_axis_and_time_and_keeps_the_trace(mikron: Machine) -> None:
    wild = mikron.with_axis("Y", position_gain_per_s=5e3, peak_current_a=1e5, bus_limit_v=1e6)
    with pytest.raises(SimulationError, match=r"diverges: axis Y at 0\.\d+ s") as stopped:
        simulate(wild, swings(mikron, 2.0))
    trace = stopped.value.trace
    assert isinstance(trace, Trace)
    told = float(str(stopped.value).split(" at ")[1].split(" s")[0])
    assert trace.time[-1] == pytest.approx(told, abs=2e-3)
    assert all(np.all(np.isfinite(values)) for values in trace.signals.values())


def test_decimated_record_is_every_nth_sample(mikron: Machine) -> None:
    points = swings(mikron, 0.8)
    full = simulate(mikron, points, sample_period=125e-6).trace
    coarse = simulate(mikron, points, sample_period=10e-3).trace
    for key, values in full.decimated(80).signals.items():
        if key[1] != "setpoint":
            np.testing.assert_allclose(coarse.signals[key], values, rtol=1e-9, atol=1e-11, err_msg=str(key))
    assert coarse.period == pytest.approx(10e-3)


def peak_bytes(machine: Machine, seconds: float, period: float) -> tuple[int, int]:
    """Peak memory of a run beyond its set points, and the size of its trace."""
    points = swings(machine, seconds)
    tracemalloc.start()
    trace = simulate(machine, points, sample_period=period).trace
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak, trace.time.nbytes + sum(values.nbytes for values in trace.signals.values())


def test_memory_grows_with_the_trace_only(mikron: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """The memory of a long run is that of its trace."""
    monkeypatch.setattr("twin.simulation.setpoints._KEEP_SPLINE", 1_000)  # treat both as long runs
    machine = mikron.with_axes(["X"])
    simulate(machine, swings(machine, 0.1))  # compile first
    short, short_trace = peak_bytes(machine, 39.9, 50e-3)  # whole parts of the record's splines
    long, long_trace = peak_bytes(machine, 159.9, 50e-3)
    # twice the trace: the set points are assembled while the record exists
    assert long - short < 2.0 * (long_trace - short_trace) + 50_000
    assert long < 5e6


def test_the_drift_of_a_scale_does_not_move_an_axis_that_is_controlled_on_its_motor_encoder(mikron: Machine) -> None:
    machine = mikron.with_axes(["X"]).with_values({"axis.X.encoder": "motor"})
    drifting = with_effects(machine, [{"name": "thermal_drift", "axis": "X", "rate": 4e-7}])
    still = Setpoints(np.zeros((50, 1)), 1e-3)
    run = simulate(drifting, still, sample_period=1e-3, started_at=20.0)
    assert np.abs(run.trace.get("X", "motor_position")).max() < 1e-8
    assert np.abs(run.trace.get("X", "velocity")).max() < 1e-6
