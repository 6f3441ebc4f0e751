"""A machine from a recording alone is identified as by `twin identify`, and never follows worse than its first values."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from tests.builders.other_structures import machine_text, write_slides
from tests.conftest import ROOT
from tests.machine.test_from_recording import LAB_AXIS, recorded
from twin.cli import main
from twin.identify import from_recording
from twin.identify.first_values import first_values
from twin.identify.from_recording import Reproduction, machine_from_recording
from twin.identify.held_out import unstable_loops
from twin.identify.recorded_axis import noise_of
from twin.identify.recording import prepare_recording
from twin.machine.axis_lumps import AxisControl, AxisLumps
from twin.machine.commented import ASSUMED, TRIED
from twin.machine.lumped_file import write_lumped_machine
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import read_campaign
from twin.recordings.trace import Trace, read_trace, write_trace
from twin.simulation.plant_spec import with_commissioned_inertia
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints


def test_a_new_machine_follows_like_an_identified_one(tmp_path: Path) -> None:
    for name in ("slides", "campaign"):
        (tmp_path / name).mkdir()
    machine = load_machine(write_slides(tmp_path / "slides", machine_text("Z", cycles_us=(250, 1000)))).with_feedforward("off")
    folder = recorded(tmp_path / "campaign", machine)
    first = machine_from_recording(folder, tmp_path / "first.toml", identified=False)
    made = machine_from_recording(folder, tmp_path / "made.toml")
    assert made.followed["Z"].merit < 0.8 * first.followed["Z"].merit < 0.016
    text = (tmp_path / "made.toml").read_text(encoding="utf-8")
    assert "# tried" in (tmp_path / "first.toml").read_text(encoding="utf-8")
    assert "# tried" not in text
    assert "[identified]" in text


def test_the_first_machine_stays_if_the_fit_follows_worse_or_diverges_on_one_axis(tmp_path: Path) -> None:
    """Axes beside one that diverges have no gap, and a sum with nan is not larger than anything."""
    for name in ("slides", "campaign"):
        (tmp_path / name).mkdir()
    machine = load_machine(write_slides(tmp_path / "slides", machine_text("Z", cycles_us=(250, 1000)))).with_feedforward("off")
    folder, real = recorded(tmp_path / "campaign", machine, 1.0), from_recording._reproductions
    first = machine_from_recording(folder, tmp_path / "made.toml", identified=False)
    text = (tmp_path / "made.toml").read_text(encoding="utf-8")

    def worse(_result: Any, out: Path) -> None:
        out.write_text(text.replace("position_gain", "_"), encoding="utf-8")

    def diverging(machine: Machine, *given: Any) -> dict[str, Reproduction]:
        return {"Z": Reproduction(np.nan, 1.0)} if "identified" in machine.document else real(machine, *given)

    for name, changed in (("write_identified", worse), ("_reproductions", diverging)):
        for file in ("made.toml", "made.xml"):
            (tmp_path / file).unlink()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(from_recording, name, changed)
            made = machine_from_recording(folder, tmp_path / "made.toml")
        assert made.followed == first.followed
        assert (tmp_path / "made.toml").read_text(encoding="utf-8") == text


def test_no_tried_control_is_unstable(tmp_path: Path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    """The recorded move is over before the oscillation shows, so that the unstable axis reproduces it best."""
    unstable = AxisControl({"position_gain_per_s": 27.0, "velocity_feedforward": 1.0, "speed_integral_time_s": 0.4}, lag=0.5, origin=TRIED)
    lumps = AxisLumps("B", "rotary", "motor", (-1.0, 1.0), 1.0, 2.0, 4e-3, unstable, None, 1e-6, 0.0)
    write_lumped_machine(tmp_path / "axis.toml", [lumps], "a test")
    t = np.arange(400) * 4e-3
    way = 0.2 * (1.0 - np.cos(2.0 * np.pi * np.clip(t - 0.2, 0.0, None) / 3.0))
    trace = simulate(load_machine(tmp_path / "axis.toml"), Setpoints(way[:, None], 4e-3), sample_period=4e-3).trace
    (tmp_path / "campaign").mkdir()
    recorded = {key: values for key, values in trace.signals.items() if key[1] in ("setpoint", "motor_position")}
    write_trace(Trace(trace.time, recorded, trace.kinds), tmp_path / "campaign" / "move.parquet")
    (tmp_path / "campaign" / "campaign.toml").write_text('[[run]]\nfile = "move.parquet"\n', encoding="utf-8")
    monkeypatch.setattr(from_recording, "tried_controls", lambda _machine, _runs, axes: {one.name: unstable for one in axes})
    made = machine_from_recording(tmp_path / "campaign", tmp_path / "made.toml")
    assert not unstable_loops(load_machine(tmp_path / "made.toml"))
    assert made.followed["B"].gap > 0.0
    assert "# tried" not in (tmp_path / "made.toml").read_text(encoding="utf-8")


def test_runs_with_and_without_feedforward_separate_gain_and_delay(tmp_path: Path) -> None:
    """Without feedforward the lag is 1/Kv + d, with it d: the shipped traces have Kv 50 1/s and d 2 ms."""
    traces = ROOT / "examples" / "traces"
    files = [str(file) for file in sorted(traces.glob("x_*.*"))]
    assert main(["import", *files, "--map", str(traces / "map.toml"), "--no-picture", "--out", str(tmp_path)]) == 0
    runs = read_campaign(tmp_path).runs
    (one,) = first_values(runs, ["X"])
    assert one.law["position_gain_per_s"] == pytest.approx(50.0, rel=0.01)
    assert one.law.origin == ASSUMED  # a weight of the feedforward would change both
    assert one.law["position_delay_s"] == one.law["feedforward_delay_s"] == pytest.approx(2e-3, rel=0.01)
    (alone,) = first_values(runs[:1], ["X"])
    assert alone.law.origin == ASSUMED
    assert any("only (1 - feedforward) / gain + delays is measured" in note for note in alone.notes)


def test_a_gain_and_a_delay_of_one_lag_are_divided_by_how_the_axis_accelerates(tmp_path: Path) -> None:
    trace = ROOT / "examples" / "traces" / "x_feedforward_off.csv"
    assert main(["import", str(trace), "--no-picture", "--out", str(tmp_path / "campaign")]) == 0
    made = machine_from_recording(tmp_path / "campaign", tmp_path / "made.toml", identified=False)
    assert made.lumps[0].law["position_gain_per_s"] == pytest.approx(50.0, rel=0.01)
    assert made.lumps[0].law["position_delay_s"] == pytest.approx(2e-3, rel=0.02)
    assert made.followed["X"].gap < 1e-6  # 20 um with the whole lag as a gain
    assert load_machine(tmp_path / "made.toml").axis("X").loops.position_gain_per_s == pytest.approx(50.0, rel=0.01)
    assert "position_gain_per_s" in " ".join(
        line for line in (tmp_path / "made.toml").read_text(encoding="utf-8").splitlines() if "# tried" in line
    )


def between_samples(folder: Path, every: int) -> None:
    """A campaign of a P-PI cascade with a cycle of 0.5 ms, recorded once in `every` cycles."""
    strokes = [np.r_[np.full(n, v), np.zeros(300)] for v, n in ((0.1, 1600), (-0.1, 1600), (0.3, 600), (-0.3, 600))]
    speed = np.convolve(np.convolve(np.concatenate([np.zeros(300), *strokes]), np.ones(200) / 200.0, "same"), np.ones(60) / 60.0, "same")
    path = np.cumsum(speed) * 5e-4
    place, command = np.zeros((2, len(path)))
    x = v = summed = 0.0
    for k, s in enumerate(path):
        e = 40.0 * (s - x) - v
        summed += e * 5e-4 / 0.02
        place[k], command[k] = x, 2000.0 * (e + summed)
        v += (command[k] - 10.0 * v - 1.2 * np.tanh(v / 2e-3)) / 10.0 * 5e-4
        x += v * 5e-4
    signals = {("X", "setpoint"): path, ("X", "position"): place, ("X", "current"): command}
    write_trace(Trace(np.arange(len(path)) * 5e-4, signals, {"X": "linear"}).decimated(every), folder / "run.parquet")
    (folder / "campaign.toml").write_text('[[run]]\nfile = "run.parquet"\nfeedforward = "off"\n', encoding="utf-8")


@pytest.mark.parametrize("every", [2, 4])
def test_a_command_between_whose_samples_the_control_computes_shows_no_law(tmp_path: Path, every: int) -> None:
    """The law of the recorded cycle, 1 or 2 ms, has another gain."""
    between_samples(tmp_path, every)
    made = machine_from_recording(tmp_path, tmp_path / "made.toml", identified=False)
    text = (tmp_path / "made.toml").read_text(encoding="utf-8")
    assert made.followed["X"].effort_gap < 0.02 * made.followed["X"].effort_range  # a hundred times as much with the law of the command
    assert "position_gain_per_s = 40.0" in text
    assert not made.lumps[0].law.measured
    assert made.lumps[0].law["position_gain_per_s"] == pytest.approx(40.0, rel=0.01)  # 36.0 by the command every 2 ms


def test_samples_far_apart_show_no_lateness_of_a_command_between_them(tmp_path: Path) -> None:
    """Every 10 ms, three cycles of the control that the machine file assumes: as held from sample to sample the command seems half of that late."""
    between_samples(tmp_path, 20)
    machine_from_recording(tmp_path, tmp_path / "made.toml", identified=False)
    machine = with_commissioned_inertia(load_machine(tmp_path / "made.toml"))
    found = prepare_recording(machine, read_campaign(tmp_path))
    assert not [finding.text for finding in found.findings if "was recorded" in finding.text]


def cascade(
    folder: Path, held: int, fed: float, counts: float, every: int, late: tuple[int, int] = (0, 0), mean: int = 1, step: int = 1
) -> list[AxisLumps]:
    """First values of an axis whose position controller (30 1/s) computes every `held` cycles of 0.25 ms, beside a PI speed controller on a filtered speed.

    Its feedforward is the speed of the profile itself, or the last step of the set points over `step` cycles. `late`: cycles by which it has set
    points and position late. `mean`: cycles over which it takes the mean of the set points.
    """
    tick = 2.5e-4
    strokes = [np.r_[np.full(n, v), np.zeros(400)] for v, n in ((8.0, 3200), (-8.0, 3200), (24.0, 1200), (-24.0, 1200))]
    speed = np.convolve(np.convolve(np.concatenate([np.zeros(400), *strokes]), np.ones(400) / 400.0, "same"), np.ones(120) / 120.0, "same")
    path = np.cumsum(speed) * tick
    place, wanted, command = np.zeros((3, len(path)))
    x = v = seen = summed = w = last = 0.0
    for k in range(len(path)):
        now = np.rint(x * counts) / counts
        seen, last = 0.5 * seen + 0.5 * (now - last) / tick, now
        place[k], asked = now, max(k - late[0], 0)
        w = (
            30.0 * (path[max(asked - mean + 1, 0) : asked + 1].mean() - place[max(k - late[1], 0)])
            + fed * (path[asked] - path[max(asked - step, 0)]) / (step * tick)
            if k % held == 0
            else w
        )
        summed += (w - seen) * tick / 0.015
        wanted[k], command[k] = w, 0.4 * (w - seen + summed)
        v += (command[k] - 1e-3 * v - 0.2 * np.tanh(v / 0.05)) / 1.5e-3 * tick
        x += v * tick
    setpoint = path if counts > 1e6 else np.rint(path * counts) / counts
    signals = {("A", "setpoint"): setpoint, ("A", "position"): place, ("A", "velocity_setpoint"): wanted, ("A", "current"): command}
    write_trace(Trace(np.arange(len(path)) * tick, signals, {"A": "rotary"}).decimated(every), folder / "run.parquet")
    (folder / "campaign.toml").write_text('[[run]]\nfile = "run.parquet"\n', encoding="utf-8")
    return first_values(read_campaign(folder).runs, ["A"])


def test_a_position_controller_of_a_longer_cycle_than_the_samples(tmp_path: Path) -> None:
    """Its output stands for five samples: read at each of them, the gain would be 31 1/s and there would be delays of milliseconds."""
    lumps = cascade(tmp_path, held=10, fed=0.0, counts=1e7, every=2)
    law = lumps[0].law
    assert lumps[0].held == 5
    for key, value, true in (
        ("position_gain_per_s", law["position_gain_per_s"], 30.0),
        ("velocity_feedforward", law["velocity_feedforward"], 0.0),
        ("position_delay_s", law["position_delay_s"], 0.0),
    ):
        assert abs(value - true) <= law.half[key] + 1e-9, key
    assert law["position_gain_per_s"] == pytest.approx(30.0, rel=1e-3)
    write_lumped_machine(tmp_path / "made.toml", lumps, "a recording")
    assert load_machine(tmp_path / "made.toml").position_cycle == pytest.approx(2.5e-3)


@pytest.mark.parametrize(("every", "digits"), [(4, 1e8), (16, 65536.0 / (2.0 * np.pi))])
def test_a_position_controller_that_computes_between_the_samples(tmp_path: Path, every: int, digits: float) -> None:
    """The step of its feedforward lasts one of its own cycles, 1 ms, also where the set points are rounded to more than its errors by another cycle."""
    lumps = cascade(tmp_path, held=4, fed=1.0, counts=digits, every=every, step=4)
    assert lumps[0].held == 4 / every
    assert abs(lumps[0].law["position_gain_per_s"] - 30.0) <= lumps[0].law.half["position_gain_per_s"]
    write_lumped_machine(tmp_path / "made.toml", lumps, "a recording")
    assert load_machine(tmp_path / "made.toml").position_cycle == pytest.approx(1e-3)


def test_a_filter_of_the_set_points_is_no_small_feedforward(tmp_path: Path) -> None:
    """The mean over 11 ms follows as exactly from a delay of 8 ms and a feedforward of 6 %, which no control has."""
    law = cascade(tmp_path, held=4, fed=0.0, counts=1e8, every=4, mean=44)[0].law
    assert abs(law["position_gain_per_s"] - 30.0) <= law.half["position_gain_per_s"] < 0.3
    for key, value in (
        ("velocity_feedforward", law["velocity_feedforward"]),
        ("position_delay_s", law["position_delay_s"]),
        ("feedforward_delay_s", law["feedforward_delay_s"]),
    ):
        assert abs(value) <= law.half.get(key, np.inf), key


def test_a_position_controller_whose_cycle_is_no_whole_number_of_samples_has_no_measured_gain(tmp_path: Path) -> None:
    law = cascade(tmp_path, held=6, fed=0.0, counts=1e8, every=4)[0].law
    assert not law.measured or np.isinf(law.half["position_gain_per_s"])


def test_rounded_set_points_are_no_lag_of_them(tmp_path: Path) -> None:
    """A lag would smooth the rounding of the recorded set points, which the control does not have. What no number of the law shows by itself says so."""
    law = cascade(tmp_path, held=1, fed=1.0, counts=65536.0 / (2.0 * np.pi), every=2)[0].law
    assert law.blocks == {}
    assert abs(law["position_gain_per_s"] - 30.0) <= law.half["position_gain_per_s"]
    assert not law["speed_mean_cycles"] or np.isinf(law.half["speed_mean_cycles"])


def test_a_feedforward_of_the_profile_itself_is_no_longer_delay(tmp_path: Path) -> None:
    """The last step of the set points differs from it by a micrometre a second, which a delay of 7 ms and a weight of 1.13 made up for, to four digits."""
    law = cascade(tmp_path, held=4, fed=1.0, counts=1e8, every=4, late=(16, 4))[0].law
    assert abs(law["position_gain_per_s"] - 30.0) <= law.half["position_gain_per_s"] < 0.3
    for key, value, true in (
        ("velocity_feedforward", law["velocity_feedforward"], 1.0),
        ("position_delay_s", law["position_delay_s"], 4e-3),
    ):
        assert abs(value - true) <= law.half[key], key


def test_the_noise_of_a_channel_that_was_interpolated() -> None:
    noise = 0.02 * np.random.default_rng(0).standard_normal(4000)
    between = CubicSpline(np.arange(4000) * 2.0, noise)(np.arange(7999.0))
    assert noise_of(noise) == pytest.approx(0.02, rel=0.1)
    assert noise_of(between) == pytest.approx(0.02, rel=0.15)


def test_an_axis_whose_control_is_searched_stands_beside_one_whose_command_shows_it(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "campaign", load_machine(LAB_AXIS))
    trace = read_trace(folder / "strokes.parquet")
    path = trace.get("X", "setpoint")
    a = trace.period / 0.02
    more = {("Y", "setpoint"): path, ("Y", "position"): path[0] + lfilter([a], [1.0, a - 1.0], path - path[0])}
    write_trace(replace(trace, signals={**trace.signals, **more}, kinds={"X": "linear", "Y": "linear"}), folder / "strokes.parquet")
    made = machine_from_recording(folder, tmp_path / "made.toml", identified=False)
    assert {one.name: one.law.direct for one in made.lumps} == {"X": True, "Y": False}
    assert made.followed["Y"].gap < 0.1 * made.followed["Y"].following
