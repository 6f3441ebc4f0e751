"""Encoders without a common zero: a constant in each run is fitted, also after correction. Axes that are pushed by another axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.builders.diagnosis_state import found_of
from twin.diagnose.columns import Column
from twin.diagnose.fit import Slope, fit_effects
from twin.diagnose.observe import observe
from twin.diagnose.tuning import tuning_of
from twin.diagnose.verdict import with_zeros_out
from twin.diagnose.view import view_of
from twin.effects import settings_of, with_effects
from twin.estimate.regression import NORMAL_95
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import MeasuredRun, read_campaign
from twin.recordings.trace import Trace, write_trace
from twin.simulation.campaign_gap import gap
from twin.simulation.encoder_zeros import aligned, clear_zeros, with_common_zeros, zeros_left
from twin.simulation.gap import gap_of, predict
from twin.simulation.motor_and_scale import motor_minus_scale, shifted
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

YZ = load_machine().with_axes(["Y", "Z"])
SPRING = {"name": "transmission_compliance", "axis": "Z", "stiffness": 1e9}
"""The weight of Z winds the spring up by 3.5 um."""
TILT = {
    "name": "law", "axis": "Z", "from_axis": "Y", "block": "measurement", "output": "displacement", "variables": ["position"],
    "formula": "line", "height": 1e-5, "reach": 0.1,
}  # fmt: skip


def recorded(machine: Machine, moving: str, name: str, offset: float = 0.0) -> MeasuredRun:
    """A run in which one axis moves back and forth; the motor encoder of Z has a different zero."""
    way = moves_in_turn(0.0, [0.03, -0.03], 0.1, 1.0, 20.0, 0.1, 1e-3)[1]
    position = np.column_stack([way if axis == moving else np.zeros_like(way) for axis in YZ.axis_names])
    trace = simulate(machine, Setpoints(position, 1e-3), sample_period=1e-3, noise_seed=len(name)).trace
    return MeasuredRun(name, shifted(trace, YZ.axis("Z"), offset), None, 0.0)


@pytest.fixture(scope="module")
def elastic() -> Machine:
    return with_effects(YZ, [SPRING])


def test_constant_windup_is_no_gap_if_encoders_have_no_common_zero(elastic: Machine) -> None:
    runs, zeros = with_common_zeros([recorded(elastic, "Z", "first", 80e-6), recorded(elastic, "Z", "second", 80e-6)], YZ)
    assert set(zeros) == {"Z"}
    assert all(run.own_zeros == {"Z"} for run in runs)
    gap = gap_of(YZ, runs[0], predict(elastic, runs[0]))["Z"]["motor_position"]
    assert gap.rms < 2.0 * gap.noise


@pytest.mark.parametrize("taken_out", [True, False])
def test_an_offset_that_the_import_took_out_leaves_no_common_zero(elastic: Machine, tmp_path: Path, taken_out: bool) -> None:
    """The steady windup of the spring went with the offset; it must not speak against the spring."""
    run = recorded(elastic, "Z", "run")
    centred = float(np.mean(motor_minus_scale(run.trace, "Z")))
    write_trace(shifted(run.trace, YZ.axis("Z"), centred), tmp_path / "run.parquet")
    channel = f'axis = "Z"\nsignal = "position"\noffset_m = {centred}\noffset_taken_out = {str(taken_out).lower()}\n'
    (tmp_path / "campaign.toml").write_text(f'[[run]]\nfile = "run.parquet"\n[[run.channel]]\n{channel}', encoding="utf-8")
    (read,) = read_campaign(tmp_path, YZ).runs
    gap = gap_of(YZ, read, predict(elastic, read))["Z"]["motor_position"]
    assert (gap.rms < 2.0 * gap.noise) == taken_out


def test_constants_after_correction_are_zeros_but_a_trend_is_not(elastic: Machine) -> None:
    run = recorded(elastic, "Z", "run")
    times = (0.0, 60.0, 120.0, 180.0)
    offsets = np.array([2e-6, -2e-6, -2e-6, 2e-6])
    runs = [
        MeasuredRun(f"{k}", shifted(run.trace, YZ.axis("Z"), 1e-6 * k + offset), None, t)
        for k, (offset, t) in enumerate(zip(offsets, times))
    ]
    predicted = {r.name: run.trace for r in runs}
    left = zeros_left(runs, YZ, predicted)
    drift = 1e-6 * np.arange(4)
    np.testing.assert_allclose([left["Z", k] for k in range(4)], -offsets - drift.mean(), atol=1e-9)
    cleared = aligned(runs, YZ, predicted)
    means = [float(np.mean(motor_minus_scale(r.trace, "Z") - motor_minus_scale(run.trace, "Z"))) for r in cleared]
    np.testing.assert_allclose(means, drift.mean() - drift, atol=1e-9)


def test_two_or_three_runs_tell_no_growth() -> None:
    """Their trend may be zeros that differ, as after an import that takes an offset out of each file."""
    run = recorded(YZ, "Y", "run")
    for count in (2, 3):
        runs = [MeasuredRun(f"{k}", shifted(run.trace, YZ.axis("Y"), 2e-6 * k), None, 60.0 * k) for k in range(count)]
        left = zeros_left(runs, YZ, {r.name: run.trace for r in runs})
        np.testing.assert_allclose([left["Y", k] for k in range(count)], -2e-6 * np.arange(count), atol=1e-12)


def test_a_zero_that_follows_the_place_of_the_start_is_no_growth(elastic: Machine) -> None:
    """The last run starts 30 mm away, where a lead error that kept its zero shows 3 um: without it the zeros have no trend."""
    run, away = recorded(elastic, "Z", "run"), 0.03
    elsewhere = replace(run.trace, signals={key: values + away for key, values in run.trace.signals.items() if key[0] == "Z"})
    traces = [run.trace, run.trace, run.trace, shifted(elsewhere, YZ.axis("Z"), 1e-4 * away)]
    runs = [MeasuredRun(f"{k}", trace, None, 60.0 * k) for k, trace in enumerate(traces)]
    left = zeros_left(runs, YZ, {r.name: run.trace for r in runs})
    np.testing.assert_allclose([left["Z", k] for k in range(4)], [0.0, 0.0, 0.0, -1e-4 * away], atol=1e-9)


def test_the_interval_of_a_growth_contains_the_scatter_of_the_zeros() -> None:
    """Each run is displaced by 40 nm, as an axis that stuck is. The interval holds the true rate, and without the scatter it does not."""
    rate, times = 2e-8, 20.0 * np.arange(8)
    machine = with_effects(YZ, [{"name": "thermal_drift", "axis": "Y", "rate": rate}])
    run = recorded(YZ, "Y", "run")
    group = observe([view_of(YZ, replace(run, name=f"{k}", started_at=t)) for k, t in enumerate(times)], ("Y",))
    tuning = tuning_of(group)
    (setting,) = settings_of(machine)
    known: Mapping[Slope, Column] = {}
    held, held_alone = [], []
    for seed in range(20):
        offsets = -rate * times + np.random.default_rng(seed).normal(0.0, 4e-8, len(times))
        displaced = [replace(c, residual=c.residual + (offsets[c.run] if c.name == "motor_minus_scale" else 0.0)) for c in group.channels]
        this = replace(group, channels=displaced)
        fit = fit_effects(this, tuning, [setting], known=known)
        assert fit is not None
        known = fit.slopes
        state = found_of(this, tuning, fit)
        for out, within in ((state, held_alone), (with_zeros_out(state), held)):
            ((free, deviation),) = out.fit.sizes().deviations().values()
            within.append(abs(free.value(fit.settings) - rate) < NORMAL_95 * deviation * free.unit)
    assert np.mean(held) >= 0.9
    assert np.mean(held_alone) < 0.5


def test_an_axis_that_sticks_elsewhere_for_a_while_has_the_same_zeros(elastic: Machine) -> None:
    """For a quarter of the run the load rests 30 um away from its prediction, through a play for example."""
    run = recorded(elastic, "Z", "run")
    stuck = np.where(np.arange(len(run.trace.time)) > 0.75 * len(run.trace.time), 30e-6, 0.0)
    key = ("Z", "motor_position")
    measured = replace(run, trace=replace(run.trace, signals={**run.trace.signals, key: run.trace.signals[key] + stuck}))
    assert abs(zeros_left([measured], YZ, {"run": run.trace})["Z", 0]) < 1e-9


@pytest.mark.parametrize("offset", [3e-8, 4e-7, 8e-5, 0.2])
def test_a_gap_and_a_diagnosis_treat_zeros_alike(elastic: Machine, offset: float, tmp_path: Path) -> None:
    """On a new run of the corrected machine a constant between the encoders is no gap, however large; only a clear one gets a note."""
    for name in ("first", "second"):
        write_trace(recorded(elastic, "Z", name, offset).trace, tmp_path / f"{name}.parquet")
    entries = (f'[[run]]\nfile = "{name}.parquet"\nstarted_at_s = {t}\n' for name, t in (("first", 0.0), ("second", 60.0)))
    (tmp_path / "campaign.toml").write_text("".join(entries), encoding="utf-8")
    found = gap(tmp_path, elastic)
    assert found.outliers == []
    assert [note.split(":")[0] for note in found.notes] == (["axis Z"] if offset > 1e-6 else [])


def test_a_constant_of_a_resting_axis_is_a_zero_whatever_its_trend() -> None:
    """Where an axis rests throughout, the constant is where it stuck. Two runs have always a trend: that is no growth of the screw."""
    run = recorded(YZ, "Y", "run")
    runs = [MeasuredRun(f"{k}", shifted(run.trace, YZ.axis("Z"), offset), None, 60.0 * k) for k, offset in enumerate((4e-8, -9e-8))]
    left = zeros_left(runs, YZ, {r.name: run.trace for r in runs})
    np.testing.assert_allclose([left["Z", 0], left["Z", 1]], [-4e-8, 9e-8], atol=1e-12)
    assert clear_zeros(left, YZ) == {}


def test_an_axis_at_rest_that_is_pushed_is_observed() -> None:
    pushed = view_of(YZ, recorded(with_effects(YZ, [TILT]), "Y", "pushed"))
    assert pushed.pushed == {"Z"}
    assert [c.name for c in observe([pushed], ("Z",)).channels] == ["motor_minus_scale"]
    assert not view_of(YZ, recorded(YZ, "Y", "still")).pushed


def test_an_oscillation_without_motion_of_others_is_not_a_push() -> None:
    run = recorded(YZ, "Y", "hunting")
    swing = 5e-6 * np.sin(2.0 * np.pi * 7.0 * run.trace.time)
    signals = {**run.trace.signals, ("Z", "motor_position"): run.trace.get("Z", "motor_position") + swing}
    assert not view_of(YZ, MeasuredRun("run", Trace(run.trace.time, signals, run.trace.kinds), None, 0.0)).pushed
