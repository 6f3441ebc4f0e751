"""Gaps, rounded and jittering times, skew and other intervals are detected, reported and handled as the map requires."""

import json
import math
from pathlib import Path
import tomllib

import numpy as np
import pytest

from tests.builders.recorded_files import MAP, Array, move, write_csv, write_xml
from twin.cli import main
from twin.errors import InputError
from twin.machine.machine import load_machine
from twin.recordings.campaign import ChannelFact, MeasuredRun, any_unsigned, read_campaign
from twin.recordings.formats.by_content import read_recording
from twin.recordings.relations import force_sign
from twin.recordings.signals import Clock, ReadOptions, known_unit, split_heading
from twin.recordings.skew import skews_of
from twin.recordings.time_column import find_time
from twin.recordings.timing import timing_of
from twin.recordings.trace import Trace, read_trace

TIME = np.arange(4000) * 1e-3


def imported(tmp_path: Path, file: Path, text: str = MAP) -> dict[str, Trace]:
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    assert main(["import", str(file), "--map", str(tmp_path / "map.toml"), "--out", str(tmp_path / "out"), "--no-picture"]) == 0
    campaign = tomllib.loads((tmp_path / "out" / "campaign.toml").read_text(encoding="utf-8"))
    return {run["file"]: read_trace(tmp_path / "out" / run["file"]) for run in campaign["run"]}


def recorded(tmp_path: Path, time: Array, kept: Array | None = None, digits: int = 9) -> Path:
    columns = {"t": np.round(time, digits), **move(time)}
    return write_csv(tmp_path / "run.csv", {k: v if kept is None else v[kept] for k, v in columns.items()})


def test_a_gap_splits_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = np.r_[0:1500, 1540:4000]
    traces = imported(tmp_path, recorded(tmp_path, TIME, kept))
    assert "1 gap in time (41 ms after 1.499 s): the run is split there" in capsys.readouterr().out
    assert list(traces) == ["run_1.parquet", "run_2.parquet"]
    assert [len(t.time) for t in traces.values()] == [1500, 2460]
    truth = move(TIME)["ist"]
    assert np.abs(traces["run_2.parquet"].get("X", "position") * 1e3 - truth[1540:]).max() < 1e-9
    campaign = tomllib.loads((tmp_path / "out" / "campaign.toml").read_text(encoding="utf-8"))
    assert campaign["run"][1]["started_at_s"] == pytest.approx(1.54, abs=1e-6)


def test_pieces_of_a_run_leave_the_names_of_other_runs(tmp_path: Path) -> None:
    """'run' is split and 'run_1' is another run: each of the three traces gets its own file, in any order."""
    kept = np.r_[0:1500, 1540:4000]
    other = write_csv(tmp_path / "run_1.csv", {"t": TIME[:1000], **move(TIME[:1000])})
    files = [recorded(tmp_path, TIME, kept), other]
    (tmp_path / "map.toml").write_text(MAP, encoding="utf-8")
    for order in (files, files[::-1]):
        out = tmp_path / order[0].stem
        assert main(["import", *map(str, order), "--map", str(tmp_path / "map.toml"), "--out", str(out), "--no-picture"]) == 0
        campaign = tomllib.loads((out / "campaign.toml").read_text(encoding="utf-8"))
        lengths = {run["file"]: len(read_trace(out / run["file"]).time) for run in campaign["run"]}
        assert lengths == {"run_1.parquet": 1000, "run_2.parquet": 1500, "run_3.parquet": 2460}
        assert len(campaign["run"]) == 3


def test_samples_that_leave_the_motion_are_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Regression: 12 of 16000 hid friction and mass behind "motion explains 0 %"."""
    columns = {"t": TIME, **move(TIME)}
    imported(tmp_path, write_csv(tmp_path / "run.csv", columns))
    assert "leaves its motion" not in capsys.readouterr().out
    columns["ist"] = columns["ist"] + 40.0 * np.isin(np.arange(len(TIME)), [700, 2100, 2102])
    (tmp_path / "again").mkdir()
    imported(tmp_path / "again", write_csv(tmp_path / "run.csv", columns))
    assert "X.position leaves its motion for single samples, 3 times by up to 40" in capsys.readouterr().out


def test_a_gap_is_filled_if_the_map_asks_for_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = np.r_[0:1500, 1508:4000]
    (trace,) = imported(tmp_path, recorded(tmp_path, TIME, kept), 'gaps = "fill"\n' + MAP).values()
    assert "filled by a cubic" in capsys.readouterr().out
    assert len(trace.time) == 4000
    truth = move(TIME)["ist"]
    assert np.abs(trace.get("X", "position") * 1e3 - truth).max() < 1e-4


def test_lost_samples_of_a_control_are_a_gap_and_held_values_are_none(tmp_path: Path) -> None:
    time = np.arange(1000) * 2e-3
    columns = move(time)
    columns["soll"][100:400] = columns["soll"][100]
    signals = {n: (0.0, 2e-3, v) for n, v in columns.items()}
    text = 'units = "report"\n' + MAP
    traces = imported(tmp_path, write_xml(tmp_path / "run.xml", signals), text)
    assert list(traces) == ["run.parquet"]
    lossy = write_xml(tmp_path / "run.xml", signals, drop=lambda name, k: name == "ist" and 500 <= k < 520)
    traces = imported(tmp_path, lossy, text)
    assert [len(t.time) for t in traces.values()] == [500, 480]


@pytest.mark.parametrize(("period", "digits"), [(1.25e-3, 3), (0.25e-3, 3), (0.4e-3, 3)])
def test_times_printed_with_few_digits(tmp_path: Path, capsys: pytest.CaptureFixture[str], period: float, digits: int) -> None:
    time = np.arange(8000) * period
    (trace,) = imported(tmp_path, recorded(tmp_path, time, digits=digits)).values()
    assert trace.period == pytest.approx(period, rel=1e-5)
    assert f"times printed to {10.0 ** (3 - digits):g} ms" in capsys.readouterr().out
    assert len(trace.time) == len(time)
    assert np.abs(trace.get("X", "position") * 1e3 - move(time)["ist"]).max() < 1e-9


def test_a_clock_that_jitters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time = TIME + 1e-4 * np.random.default_rng(1).uniform(-1.0, 1.0, len(TIME))
    (trace,) = imported(tmp_path, recorded(tmp_path, time)).values()
    assert "the clock deviates by" in capsys.readouterr().out
    # 0.1 ms at 100 mm/s would be 10 um; the recorded times are used
    start = timing_of(time, "here").stretches[0].begin
    assert np.abs(trace.get("X", "position") * 1e3 - move(start + trace.time)["ist"])[5:-5].max() < 2e-5


def test_a_clock_that_jitters_while_the_samples_do_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A logger stamps even samples when it gets them, and loses some: at 100 mm/s, 0.1 ms of its clock would be 10 um."""
    random = np.random.default_rng(1)
    table = {"t": TIME + 1e-4 * random.uniform(-1.0, 1.0, len(TIME)), **move(TIME)}
    kept = random.random(len(TIME)) > 2e-3
    traces = imported(tmp_path, write_csv(tmp_path / "run.csv", {k: v[kept] for k, v in table.items()}))
    assert "the clock jitters, the samples are 1 ms apart" in capsys.readouterr().out
    for trace in traces.values():
        assert np.abs(np.diff(trace.get("X", "position"), 2)).max() < 1e-6


def test_stamps_of_few_digits_that_jitter_are_no_gaps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A loop of 3.38 ms with some jitter, printed to 1 ms, reads 3, 4, 3, 5 ms: median 3 ms."""
    random = np.random.default_rng(4)
    time = np.round(np.cumsum(3.38e-3 + np.where(random.random(1500) < 0.08, 1.1e-3, -0.1e-3)), 3)
    assert np.median(np.diff(time)) == pytest.approx(3e-3)
    traces = imported(tmp_path, write_csv(tmp_path / "run.csv", {"t": time, **move(time)}))
    assert list(traces) == ["run.parquet"]
    assert traces["run.parquet"].period == pytest.approx(float(np.mean(np.diff(time))), rel=1e-3)
    lost = np.r_[0:700, 702:1500]
    assert len(imported(tmp_path, write_csv(tmp_path / "run.csv", {"t": time[lost], **move(time[lost])}))) == 2


def test_a_logger_that_asks_at_uneven_times_loses_no_rows(tmp_path: Path) -> None:
    """It gets a sample every 50 or every 100 ms, or several in a burst: none is missing. A pause is one, and so is a change of the interval for good."""
    random = np.random.default_rng(5)
    asked = np.round(np.cumsum(random.choice([50e-3, 60e-3, 100e-3, 115e-3], 400)), 3)
    burst = np.round(np.cumsum(random.choice([1e-3, 2e-3, 3e-3, 12e-3], 400)), 3)
    for time in (asked, burst):
        traces = imported(tmp_path, write_csv(tmp_path / "run.csv", {"t": time, **move(time)}))
        assert list(traces) == ["run.parquet"]
        truth = move(time[0] + traces["run.parquet"].time)["ist"]
        assert np.abs(traces["run.parquet"].get("X", "position") * 1e3 - truth).max() < 0.02 * np.ptp(truth)
    paused = np.r_[asked[:200], asked[200:] + 1.0]
    assert len(imported(tmp_path, write_csv(tmp_path / "run.csv", {"t": paused, **move(paused)}))) == 2
    with pytest.raises(InputError, match="the interval changes"):
        timing_of(np.cumsum(np.r_[np.full(300, 1e-3), np.full(300, 1.2e-3)]), "here")


def test_a_late_row_is_no_gap_and_a_lost_one_is(tmp_path: Path) -> None:
    """After a late sample the next one comes early; after a lost one all come late."""
    random = np.random.default_rng(7)
    late = np.where(random.random(1500) < 0.04, 1.6e-3, 0.0)
    time = np.round(np.arange(1500) * 2e-3 + random.exponential(5e-5, 1500) + late, 6)
    assert list(imported(tmp_path, write_csv(tmp_path / "run.csv", {"t": time, **move(time)}))) == ["run.parquet"]
    lost = np.r_[0:700, 702:1500]
    assert len(imported(tmp_path, write_csv(tmp_path / "run.csv", {"t": time[lost], **move(time[lost])}))) == 2


def test_a_given_interval_says_what_an_uneven_time_says_against_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A program that waits for its serial port writes rows of 2 ms and every ninth one after 13 ms."""
    time = np.cumsum(np.where(np.arange(600) % 9 == 8, 13.0, 2.0))
    for column, uneven in ((time, True), (np.arange(600) * 2.0, False)):
        write_csv(tmp_path / "run.csv", {"time": column, **move(column * 1e-3)})
        assert main(["import", str(tmp_path / "run.csv"), "--interval-ms", "2"]) == 0
        assert ("'time' steps by 2 to 13" in " ".join(capsys.readouterr().out.split())) == uneven


def test_rows_that_a_logger_writes_twice_are_left_out(tmp_path: Path) -> None:
    random = np.random.default_rng(2)
    time = np.cumsum(5e-3 + np.abs(random.normal(0.0, 5e-4, 1000)))
    twice = np.sort(np.r_[np.arange(1000), random.choice(1000, 12, replace=False)])
    write_csv(tmp_path / "run.csv", {"t": time[twice], **{name: values[twice] for name, values in move(time).items()}})
    found = read_recording(tmp_path / "run.csv", ReadOptions(Clock(), None, tmp_path / "scratch"))
    assert all(len(signal.values) == 1000 for signal in found.signals.values())
    assert any("left out" in note for note in found.notes)


def test_without_a_set_point_nothing_shows_what_a_speed_set_point_is(tmp_path: Path) -> None:
    time = np.arange(3000) * 2e-3
    m = move(time)
    write_csv(
        tmp_path / "run.csv", {"t": time, "n_soll [rpm]": 20.0 * (m["soll"] - m["ist"]), "n_ist [rpm]": m["speed"], "strom": m["strom"]}
    )
    assert main(["import", str(tmp_path / "run.csv"), "--no-picture", "--out", str(tmp_path / "out")]) == 0
    run = read_campaign(tmp_path / "out").runs[0]
    assert not run.trace.has("X", "velocity_setpoint")
    assert run.profiles == frozenset()


def test_the_stamp_of_the_sample_counts_not_that_of_its_arrival(tmp_path: Path) -> None:
    at = 1_700_000_000_000_000_000 + np.arange(1000) * 8_000_000
    late = at + np.random.default_rng(3).integers(200_000, 900_000, 1000)
    m = move(np.arange(1000) * 8e-3)
    rows = "\n".join(f"{a},{b},{s:.6f},{x:.6f}" for a, b, s, x in zip(late, at, m["soll"], m["ist"]))
    (tmp_path / "run.csv").write_text(f"%time,field.header.stamp,field.desired,field.actual\n{rows}\n", encoding="utf-8")
    found = read_recording(tmp_path / "run.csv", ReadOptions(Clock(), None, tmp_path / "scratch"))
    assert found.source.column == "field.header.stamp"


def test_other_period_by_the_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = recorded(tmp_path, np.arange(16000) * 0.25e-3)
    (trace,) = imported(tmp_path, file, "period_ms = 1.0\n" + MAP).values()
    assert trace.period == pytest.approx(1e-3)
    assert "recorded every 0.25 ms, picked every 1 ms; period_ms = 0.25 in the map keeps all of it" in capsys.readouterr().out
    assert np.abs(trace.get("X", "position") * 1e3 - move(trace.time)["ist"]).max() < 1e-9


def test_mixed_intervals_with_a_period(tmp_path: Path) -> None:
    time = np.concatenate([np.arange(1000) * 1e-3, 1.0 + np.arange(500) * 2e-3])
    (trace,) = imported(tmp_path, recorded(tmp_path, time), "period_ms = 1.0\n" + MAP).values()
    assert len(trace.time) == 1999
    assert np.abs(trace.get("X", "position") * 1e3 - move(trace.time)["ist"]).max() < 1e-3


def test_part_of_a_recording(tmp_path: Path) -> None:
    text = MAP + '[[run]]\nfile = "run.csv"\nname = "part"\nfrom_s = 0.5\nto_s = 1.5\n'
    (trace,) = imported(tmp_path, recorded(tmp_path, TIME), text).values()
    assert len(trace.time) == 1001
    assert trace.get("X", "position")[0] * 1e3 == pytest.approx(move(TIME)["ist"][500])
    assert "started_at_s = 0.5\n" in (tmp_path / "out" / "campaign.toml").read_text(encoding="utf-8").replace("00000", "")


@pytest.mark.parametrize("late", [-0.04, -0.0023, 0.0037, 0.12])
def test_skew_is_estimated(late: float) -> None:
    columns, shifted = move(TIME), move(TIME - late)
    rng = np.random.default_rng(2)
    signals = {
        ("X", "position"): columns["ist"] * 1e-3 + 1e-7 * rng.standard_normal(len(TIME)),
        ("X", "motor_position"): shifted["ist"] * 1e-3,
        ("X", "velocity"): shifted["speed"] * 1e-3 + 1e-4 * rng.standard_normal(len(TIME)),
        ("X", "current"): shifted["strom"] + 0.05 * rng.standard_normal(len(TIME)),
    }
    found = {item.signal: item for item in skews_of(signals, 1e-3, {"X": "linear"})}
    assert found["motor_position"].seconds == pytest.approx(late, abs=2e-5)
    assert found["velocity"].seconds == pytest.approx(late, abs=1e-4)
    assert found["current"].seconds == pytest.approx(late, abs=1e-3)
    assert found["motor_position"].clear
    assert found["velocity"].clear


def test_friction_that_is_held_at_rest_is_no_lateness() -> None:
    """Between two strokes the bristles of the friction stay bent, and bend back at the next start."""
    strokes = [
        np.r_[np.full(n, v), np.zeros(300)] for v, n in ((60.0, 900), (-60.0, 900), (150.0, 400), (-150.0, 400), (20.0, 800), (-20.0, 800))
    ]
    speed = np.convolve(np.convolve(np.concatenate([np.zeros(300), *strokes]), np.ones(100) / 100.0, "same"), np.ones(50) / 50.0, "same")
    bent = np.zeros(len(speed))
    for k in range(1, len(speed)):
        bent[k] = np.clip(bent[k - 1] + 1e-3 * (speed[k] - abs(speed[k]) * bent[k - 1] / 0.05), -0.05, 0.05)
    rng = np.random.default_rng(3)
    current = 0.003 * np.gradient(speed, 1e-3) + 1.2 * bent / 0.05 + 0.02 * rng.standard_normal(len(speed))
    place = (np.cumsum(speed) - 0.5 * speed) * 1e-6 + 1e-7 * rng.standard_normal(len(speed))
    [found] = skews_of({("X", "position"): place, ("X", "current"): current}, 1e-3, {"X": "linear"})
    assert not found.clear
    assert abs(found.seconds) < 1e-4


def test_a_short_piece_in_one_direction_does_not_take_the_sign_of_a_force() -> None:
    force = move(TIME)["strom"]
    whole, piece = (Trace(TIME[:n], {("X", "current"): v[:n]}, {"X": "linear"}) for n, v in ((len(TIME), force), (60, np.abs(force))))
    note = {("X", "current"): ChannelFact(axis="X", signal="current", unsigned=True)}
    runs = [MeasuredRun("piece", piece, None, 0.0, note), MeasuredRun("whole", whole, None, 0.0)]
    assert any_unsigned(runs[:1], "X", "current")
    assert not any_unsigned(runs, "X", "current")


def test_synchronous_channels_have_no_skew_and_backlash_is_not_a_delay() -> None:
    columns = move(TIME)
    speed = columns["speed"] * 1e-3
    position = columns["ist"] * 1e-3
    # a backlash of 20 um and windup by acceleration are not a delay
    motor = position + 10e-6 * np.tanh(speed / 1e-3) + 1e-5 * np.gradient(speed, 1e-3)
    signals = {
        ("X", "position"): position,
        ("X", "motor_position"): motor,
        ("X", "velocity"): np.gradient(motor, 1e-3),
        ("X", "current"): columns["strom"],
    }
    found = skews_of(signals, 1e-3, {"X": "linear"})
    assert len(found) == 3
    assert not any(item.clear for item in found)
    assert [force_sign(sign * columns["strom"], position, 1e-3, "linear").sign for sign in (1.0, -1.0)] == [1, -1]


def test_skew_is_reported_and_corrected_on_request(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns = move(TIME)
    late = {"t": TIME, **columns, "speed": move(TIME - 4e-3)["speed"], "strom": move(TIME - 4e-3)["strom"]}
    file = write_csv(tmp_path / "run.csv", late)
    (trace,) = imported(tmp_path, file).values()
    out = capsys.readouterr().out
    assert "X.velocity is 4.0" in out or "X.velocity is 3.9" in out
    assert "left as it is" in out
    assert np.abs(trace.get("X", "velocity") * 1e3 - late["speed"]).max() < 1e-9
    (trace,) = imported(tmp_path, file, 'skew = "correct"\n' + MAP).values()
    assert "; corrected" in capsys.readouterr().out
    rows = len(trace.time)
    assert np.abs(trace.get("X", "velocity") * 1e3 - columns["speed"][:rows]).max() < 0.02  # 4 ms are 1.5 mm/s
    content = json.loads((tmp_path / "out" / "import.json").read_text(encoding="utf-8"))
    taken = {c["column"]: c["taken_back_s"] for c in content["runs"]["run"]["columns"]}
    assert taken["speed"] == pytest.approx(4e-3, abs=5e-5)
    (trace,) = imported(tmp_path, file, MAP + "skew_ms = 4.0\n").values()
    assert np.abs(trace.get("X", "current") - columns["strom"][: len(trace.time)]).max() < 1e-9
    fact = read_campaign(tmp_path / "out").runs[0].fact("X", "current")
    assert fact is not None
    assert (fact.latency, fact.taken_back) == (pytest.approx(4e-3, abs=5e-4), pytest.approx(4e-3, abs=5e-4))


def test_following_error_motor_turns_force_and_signs(tmp_path: Path) -> None:
    columns = move(TIME)
    table = {
        "t": TIME,
        "soll": columns["soll"],
        "fehler": columns["soll"] - columns["ist"],
        "motor": -columns["ist"] / 10.0,
        "drehzahl": -columns["speed"] / 10.0 * 60.0,
        "kraft": 2.0 * columns["strom"],
    }
    text = MAP.split("[[column]]")[0] + "".join(
        f'[[column]]\nname = "{n}"\naxis = "X"\nsignal = "{s}"\nunit = "{u}"\n{more}\n'
        for n, s, u, more in (
            ("soll", "setpoint", "mm", ""),
            ("fehler", "following_error", "mm", ""),
            ("motor", "motor_position", "rev", "sign = -1\nmm_per_rev = 10.0"),
            ("drehzahl", "velocity", "rpm", "sign = -1\nmm_per_rev = 10.0"),
            ("kraft", "torque", "kN", "mm_per_rev = 10.0\nscale = 0.001"),
        )
    )
    (trace,) = imported(tmp_path, write_csv(tmp_path / "run.csv", table), text).values()
    for signal, expected in (
        ("position", columns["ist"] * 1e-3),
        ("motor_position", columns["ist"] * 1e-3),
        ("velocity", columns["speed"] * 1e-3),
        ("torque", 2.0 * columns["strom"] * 0.01 / (2.0 * np.pi)),
    ):
        assert np.abs(trace.get("X", signal) - expected).max() < 1e-12


def test_a_following_error_of_a_slower_control_gives_no_staircase(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its set point stands for five samples of the oscilloscope, which shows position and following error with few digits."""
    columns = move(TIME)
    held = move(np.floor(TIME / 5e-3 + 1e-9) * 5e-3)["soll"]
    table = {"t": TIME, "ist": np.round(columns["ist"], 4), "fehler": np.round(held - columns["ist"], 4)}
    text = MAP.split("[[column]]")[0] + "".join(
        f'[[column]]\nname = "{n}"\naxis = "X"\nsignal = "{s}"\nunit = "mm"\n'
        for n, s in (("ist", "position"), ("fehler", "following_error"))
    )
    (trace,) = imported(tmp_path, write_csv(tmp_path / "run.csv", table), text).values()
    assert "position plus following error stands for 5 samples" in capsys.readouterr().out
    off = trace.get("X", "setpoint") * 1e3 - columns["soll"][: len(trace.time)]
    assert np.abs(off)[:-10].max() < 2e-3


def test_the_travel_per_motor_turn_comes_from_the_machine_file(tmp_path: Path) -> None:
    columns = move(TIME)
    pitch = load_machine().axis("X").ratio * 2.0 * np.pi * 1e3
    file = write_csv(tmp_path / "run.csv", {"t": TIME, **columns, "speed": columns["speed"] / pitch * 60.0})
    (trace,) = imported(tmp_path, file, 'machine = "mikron_ucp710"\n' + MAP.replace('"mm/s"', '"1/min"')).values()
    assert np.abs(trace.get("X", "velocity") * 1e3 - columns["speed"]).max() < 1e-9
    assert 'machine = "mikron_ucp710"' in (tmp_path / "out" / "campaign.toml").read_text(encoding="utf-8")


def test_units_as_others_write_them() -> None:
    spelled = {
        "U/min": "rev/min",
        "1/min": "rev/min",
        "°": "deg",
        "µm": "um",
        "[mm]": "mm",
        "mm/min": "mm/min",
        "°/s": "deg/s",
        "N·m": "Nm",
        "m/Minute": "m/min",
        "Amp": "A",
    }
    assert {text: known_unit(text) for text in spelled} == spelled
    assert known_unit("furlong") == ""
    assert split_heading("Pos X (mm)") == ("Pos X", "mm")
    assert split_heading("nckServoDataActCurr32 [u1, 7]") == ("nckServoDataActCurr32 [u1, 7]", "")
    assert Clock().column is None


@pytest.mark.parametrize(("step", "unit"), [(0.008, "s"), (1.0, "ms"), (250.0, "ms"), (1000.0, "us"), (1e6, "ns")])
def test_an_assumed_unit_of_the_time_gives_the_rate_of_a_control(step: float, unit: str) -> None:
    """Regression: stamps of a controller in us were taken as ms, and 16 s of strokes as 4.4 h."""
    found = find_time(["Timestamp", "fActPos"], ["", ""], [7e6 + step * np.arange(50.0), np.arange(50.0) ** 2], Clock(), "trace.csv", None)
    assert (found.unit, found.assumed) == (unit, True)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [1e300, math.inf, -math.inf, math.nan])
def test_a_time_that_no_clock_shows(value: float) -> None:
    with pytest.raises(InputError, match=r"signal: the time holds .* at row 3; repair it"):
        timing_of(np.array([0.0, 1e-3, value, 3e-3]), "signal")


@pytest.mark.parametrize(("every", "traces"), [(12, 1), (60, 1), (100, 1), (2000, 2)])
def test_samples_that_are_often_lost_are_filled_and_rare_gaps_split(every: int, traces: int, tmp_path: Path) -> None:
    """Pieces of a few samples would begin in motion, where no simulation begins."""
    lost = np.random.default_rng(1).choice(np.arange(500, len(TIME)), len(TIME) // every - 1, replace=False)
    kept = np.setdiff1d(np.arange(len(TIME)), lost)
    assert main(["import", str(recorded(tmp_path, TIME, kept)), "--out", str(tmp_path / "out"), "--no-picture"]) == 0
    found = sorted((tmp_path / "out").glob("*.parquet"))
    assert len(found) == traces
    if traces == 1:
        trace = read_trace(found[0])
        (axis,) = trace.axes
        assert np.abs(trace.get(axis, "position") * 1e3 - move(TIME)["ist"][: len(trace.time)]).max() < 1e-3


@pytest.mark.parametrize(("off", "zeros"), [(80.0, 300), (0.0, 0)])
def test_zeros_before_the_control_is_on_are_left_out(off: float, zeros: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A logger that runs already writes zeros for all channels. Zeros of an axis that rests at 0 belong to it."""
    columns = move(TIME)
    first = 300 if off else 0
    before = {name: np.where(np.arange(len(TIME)) < first, 0.0, v + off * (name in ("soll", "ist"))) for name, v in columns.items()}
    file = write_csv(tmp_path / "run.csv", {"t": TIME, **before})
    assert main(["import", str(file), "--out", str(tmp_path / "out"), "--no-picture"]) == 0
    assert ("all channels are 0" in capsys.readouterr().out) == (zeros > 0)
    (trace,) = [read_trace(path) for path in (tmp_path / "out").glob("*.parquet")]
    assert len(trace.time) == len(TIME) - zeros
