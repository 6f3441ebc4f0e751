"""Files of controls are imported with one command: names are known; units, signs and axes follow from the numbers."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from tests.builders.recorded_files import edge_columns, move, write_csv, write_edge
from tests.conftest import ROOT
from twin.cli import main
from twin.recordings.campaign import MeasuredRun, read_campaign
from twin.recordings.names import meaning_of
from twin.recordings.signals import Event, split_heading

TIME = np.arange(3000) * 2e-3
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def block_at(folder: Path, run: MeasuredRun, time: float) -> Event | None:
    """The program block that was active at a time [s] of the trace."""
    rows = pyarrow.parquet.read_table(folder / "events.parquet").to_pylist()
    past = [Event(r["time"], r["channel"], r["block"], r["text"]) for r in rows if r["run"] == run.name and r["time"] <= time]
    return max(past, key=lambda event: event.time, default=None)


def imported(tmp_path: Path, *files: Path) -> dict[str, MeasuredRun]:
    """Runs of `twin import FILES --out`."""
    assert main(["import", *map(str, files), "--out", str(tmp_path / "out"), "--no-picture"]) == 0
    return {run.name: run for run in read_campaign(tmp_path / "out").runs}


def test_set_points_that_stand_for_a_cycle_of_the_control_are_no_steps(tmp_path: Path) -> None:
    """An oscilloscope of 0.6 ms on a control of 3 ms: as steps, they were accelerations that the axis does not have, and were refused."""
    t = np.arange(4000) * 6e-4
    path = 40.0 * np.sin(3.0 * t) ** 2
    held = path[np.maximum((np.arange(4000) - 2) // 5 * 5 + 2, 0)]
    late = np.interp(t - 0.012, t, path)
    rows = "\n".join(f"{a * 1e3:.1f};{b:.5f};{c:.5f}" for a, b, c in zip(t, held, late))
    (tmp_path / "run.txt").write_text(f"t [ms];s noml X [mm];s actual X [mm]\n{rows}\n", encoding="utf-8")
    assert main(["import", str(tmp_path / "run.txt"), "--out", str(tmp_path / "out"), "--no-picture"]) == 0
    trace = read_campaign(tmp_path / "out").runs[0].trace
    assert trace.period == pytest.approx(6e-4)
    assert np.abs(trace.get("X", "setpoint") * 1e3 - np.interp(trace.time, t - t[2], path)).max() < 2e-4


def test_a_position_that_is_read_once_in_several_rows_is_not_late(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A logger of 1 ms repeats a scale that it reads every 5 ms: each value is 0 to 4 ms old, which is no lag of the axis."""
    t = np.arange(4000) * 1e-3
    path = 40.0 * np.sin(3.0 * t) ** 2
    late = np.interp(t - 0.006, t, path)
    rows = "\n".join(f"{a * 1e3:.0f};{b:.5f};{c:.5f}" for a, b, c in zip(t, path, np.repeat(late[::5], 5)))
    (tmp_path / "run.txt").write_text(f"t [ms];cmd X [mm];scale X [mm]\n{rows}\n", encoding="utf-8")
    assert main(["import", str(tmp_path / "run.txt"), "--out", str(tmp_path / "out"), "--no-picture"]) == 0
    assert "the position stands for 5 samples" in capsys.readouterr().out
    trace = read_campaign(tmp_path / "out").runs[0].trace
    assert trace.period == pytest.approx(1e-3)
    assert (
        np.abs(trace.get("X", "position") * 1e3 - np.interp(trace.time, t, late)).max() < 2e-3
    )  # 0.4 mm if the values are taken as they stand


@pytest.mark.parametrize(
    ("name", "axis", "signal", "unit"),
    [
        ("DES_POS|12", "12", "setpoint", ""),
        ("/Nck/!SD/nckServoDataCmdPos64 [u1, 2]", "2", "setpoint", ""),
        ("/Nck/!SEMA/measPos1 [u1, 2]", "2", "motor_position", ""),
        ("Lagesollwert X", "X", "setpoint", ""),
        ('ns=3;s="DB_X"."SetPosition"', "X", "setpoint", ""),
        ("ns=2;s=Axis1.ActVelocity", "1", "velocity", ""),
        ("Lageistwert Messsystem 1", "X", "motor_position", ""),
        ("Lageistwert Messsystem 2 Y", "Y", "position", ""),
        ("Drehzahlistwert", "X", "velocity", ""),
        ("Stromistwert Z", "Z", "current", ""),
        ("s noml", "X", "setpoint", ""),
        ("V (NOM RPM)", "X", "velocity_setpoint", "mm/min"),
        ("V (N NOML) Y", "Y", "velocity_setpoint", "mm/min"),
        ("I nominal Y", "Y", "current", ""),
        ("joint.0.motor-pos-cmd", "0", "setpoint", ""),
        ("joint.1.f-error", "1", "following_error", ""),
        ("rec.act_vel_mot_deg_per_s(3)", "3", "velocity", "deg/s"),
        ("tau_ff_all(1)", "1", "torque_feedforward", ""),
        ("CURRENT|3", "3", "current", "A"),
        ("r62: Speed setpoint after filter", "X", "velocity_setpoint", ""),
        ("r78: Torque-generating current actual value", "X", "current", ""),
        ("0x60F4 Following error actual value", "X", "following_error", ""),
        ("axis0.encoder.pos_estimate", "0", "position", "rev"),
        ("/joint_states/joint_2/effort", "2", "torque", ""),
        ("/controller_state/reference/joint_2/position", "2", "setpoint", ""),
        ("field.desired.positions0", "0", "setpoint", ""),
        ("指令位置", "X", "setpoint", ""),
        ("X轴实际速度", "X", "velocity", ""),
        ("set_point", "X", "setpoint", ""),
        ("q_d[2]", "2", "setpoint", ""),
        ("AIPos.A1", "A1", "position", "deg"),
        ("r0062 Speed setpoint after the filter", "X", "velocity_setpoint", ""),
        ("FollErr Y", "Y", "following_error", ""),
    ],
)
def test_known_names(name: str, axis: str, signal: str, unit: str) -> None:
    meaning = meaning_of(name)
    assert meaning is not None
    assert (meaning.axis, meaning.signal, meaning.unit) == (axis, signal, unit)


@pytest.mark.parametrize("name", ["fault_type", "tau_c_all(1)", "m_all(2)", "Spindle speed", "run", "Kraft", "pid.x.output"])
def test_unknown_column_names_have_no_meaning(name: str) -> None:
    assert meaning_of(name) is None


def test_a_recording_of_a_sinumerik_edge(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns = edge_columns(TIME)
    file = write_edge(tmp_path / "rec.json", columns, lost=(1200, 1500), blocks={10: "N10 G1 X5", 1600: "G0 X0"}, labels={"3": "C1"})
    runs = imported(tmp_path, file)
    out = capsys.readouterr().out
    assert "axis 2 spins" in out
    assert "axis 3 (C1) does not move" in out
    assert list(runs) == ["rec_1", "rec_2"]
    first, second = runs["rec_1"], runs["rec_2"]
    assert first.feedforward == "velocity"
    # the cycle counters are the time, so the second part begins where they continue
    assert len(first.trace.time) == 1200
    assert second.started_at - first.started_at == pytest.approx(1500 * 2e-3)
    assert first.trace.axes == ("1",)
    for signal, name, factor in (
        ("setpoint", "DES_POS|1", 1e3),
        ("position", "ENC_POS|1", 1e3),
        ("velocity_setpoint", "CMD_SPEED|1", 1e3),
        ("velocity_feedforward", "VEL_FFW|1", 1e3),
        ("current", "CURRENT|1", -1.0),  # it pushes against the motion: its sign is reversed
    ):
        assert np.allclose(second.trace.get("1", signal) * factor, columns[name][1500:], rtol=0, atol=1e-9)
    assert first.fact("1", "current").sign == -1
    active = block_at(tmp_path / "out", second, 0.5)
    assert active is not None
    assert (active.block, active.text) == ("_PART/@16000", "G0 X0")
    before = block_at(tmp_path / "out", second, 0.1)
    assert before is not None  # it began in the first part
    assert before.block == "_PART/N10"
    assert before.time < 0.0
    named = block_at(tmp_path / "out", first, 1.0)
    assert named is not None
    assert named.block == "_PART/N10"


def test_a_map_that_is_edited_is_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write_edge(tmp_path / "rec.json", edge_columns(TIME[:500]))
    imported(tmp_path, file)
    imported(tmp_path, file)  # again: the same map
    path = tmp_path / "out" / "map.toml"
    path.write_text(path.read_text(encoding="utf-8").replace('axis = "1"', 'axis = "X"'), encoding="utf-8")
    assert main(["import", str(file), "--out", str(tmp_path / "out")]) == 2
    assert "differs from the map proposed now" in capsys.readouterr().err
    assert main(["import", str(file), "--map", str(path), "--out", str(tmp_path / "out"), "--no-picture"]) == 0
    assert read_campaign(tmp_path / "out").runs[0].trace.axes == ("X",)


def test_units_of_speeds_follow_from_the_position(tmp_path: Path) -> None:
    m = move(TIME)
    table = {"t": TIME, "Lagesollwert X": m["soll"], "Lageistwert X": m["ist"], "Drehzahlistwert X": -m["speed"] / 8.0 * 60.0}
    (run,) = imported(tmp_path, write_csv(tmp_path / "run.csv", table)).values()
    assert np.abs(run.trace.get("X", "velocity") * 1e3 - m["speed"]).max() < 2e-3 * np.abs(m["speed"]).max()
    text = (tmp_path / "out" / "map.toml").read_text(encoding="utf-8")
    assert 'unit = "rev/min"' in text
    assert "mm_per_rev = 8\n" in text


def test_encoders_apart_and_a_late_one(tmp_path: Path) -> None:
    m, late = move(TIME), move(TIME - 3e-3)
    table = {"t": TIME, "set_point": m["soll"], "act_pos_mot": m["ist"], "act_pos_se": late["ist"] + 0.25, "current": m["strom"]}
    (run,) = imported(tmp_path, write_csv(tmp_path / "run.csv", table)).values()
    fact = run.fact("X", "position")
    assert fact.latency == pytest.approx(3e-3, abs=5e-5)
    assert fact.taken_back == fact.latency
    assert fact.offset == pytest.approx(0.25e-3, rel=1e-3)
    assert fact.offset_taken_out
    gap = run.trace.get("X", "position") - run.trace.get("X", "motor_position")
    assert np.abs(gap).max() < 2e-6


def test_the_encoder_that_closes_the_loop_keeps_its_zero(tmp_path: Path) -> None:
    """With 10 um of play the scale stands on its set point and the motor on either side of it; the scale got a lasting error of the median instead."""
    time = np.arange(8000) * 1e-3
    way = 40.0 * (np.clip(time - 1.0, 0.0, 1.0) - np.clip(time - 3.0, 0.0, 0.6) - np.clip(time - 5.0, 0.0, 1.0))
    scale = np.interp(time - 0.004, time, way)
    motor = scale + 0.01 * (np.gradient(scale) < 0.0).astype(float).cumsum().clip(max=1.0)
    table = {"t": time, "set_point": way, "act_pos_mot": motor, "act_pos_se": scale}
    (run,) = imported(tmp_path, write_csv(tmp_path / "run.csv", table)).values()
    assert run.fact("X", "motor_position").offset_taken_out
    assert not run.fact("X", "position").offset_taken_out
    assert run.trace.get("X", "position")[-1] == pytest.approx(run.trace.get("X", "setpoint")[-1], abs=1e-7)
    assert run.own_zeros == {"X"}


def test_strokes_below_each_other_with_words_and_an_unsigned_current(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time = np.arange(320) * 0.04
    stroke = 40.0 - 40.0 * np.cos(time * 2.0 * np.pi / 12.8)
    speed, acceleration = np.gradient(stroke, 0.04), np.gradient(np.gradient(stroke, 0.04), 0.04)
    lines = ["set_point,position_error,current,profile,load,trial,time"]
    for trial in range(4):
        for k in range(320):
            force = abs(0.4 * np.sign(speed[k]) + 0.01 * speed[k] + 0.02 * acceleration[k])
            error = 0.02 * speed[k]
            lines.append(
                f"{float(stroke[k])!r},{float(error)!r},{float(force)!r},trap,{20 if trial < 2 else 40},{trial + 1},{float(time[k])!r}"
            )
    (tmp_path / "strokes.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    runs = imported(tmp_path, tmp_path / "strokes.csv")
    assert "columns of words, ignored: profile" in capsys.readouterr().out
    assert list(runs) == [f"strokes_{i}" for i in (1, 2, 3, 4)]
    assert [run.labels for run in runs.values()] == [{"load": 20.0 if i < 3 else 40.0, "trial": float(i)} for i in (1, 2, 3, 4)]
    assert all(len(run.trace.time) == 320 for run in runs.values())
    assert all(run.fact("X", "current").unsigned for run in runs.values())


def test_strokes_below_each_other_in_a_file_that_begins_within_one(tmp_path: Path) -> None:
    """The time of the second stroke returns to zero, where the file does not begin."""
    m = move(TIME)
    columns = {"t": TIME, "set_point": m["soll"], "position": m["ist"]}
    table = {name: np.concatenate([values[1000:], values, values]) for name, values in columns.items()}
    runs = imported(tmp_path, write_csv(tmp_path / "cut.csv", table))
    assert [len(run.trace.time) for run in runs.values()] == [2000, 3000, 3000]


def test_a_disturbance_keeps_its_unit(tmp_path: Path) -> None:
    m = move(TIME)
    table = {"t": TIME, "set_point": m["soll"], "position": m["ist"], "pulses_N": np.where(TIME > 3.0, 50.0, 0.0)}
    (run,) = imported(tmp_path, write_csv(tmp_path / "run.csv", table)).values()
    assert list(run.trace.loads("X")) == ["N"]
    assert run.trace.loads("X")["N"].max() == 50.0


def test_an_axis_commanded_by_a_torque_alone_has_its_motion_as_path(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    x = 40.0 * np.sin(1.7 * TIME)
    signals = {"time [s]": TIME, "X.torque_setpoint [Nm]": np.sin(3.0 * TIME), "X.position [mm]": x}
    (run,) = imported(tmp_path, write_csv(tmp_path / "rig.csv", signals)).values()
    said = " ".join(capsys.readouterr().out.split())
    assert "commanded by a torque alone it has no position loop" in said
    assert run.fact("X", "setpoint").made_from == "position"
    assert np.array_equal(run.trace.get("X", "setpoint"), run.trace.get("X", "position"))


def test_the_message_that_no_axis_moves_appears_only_if_none_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns = {n: v for n, v in edge_columns(TIME[:400]).items() if n.endswith("|3")}
    file = write_edge(tmp_path / "rec.json", columns)
    assert main(["import", str(file), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "does not move" in error
    assert len(error.strip().splitlines()) == 1


@pytest.mark.skipif(
    not (DATA / "sinumerik" / "recording.json").exists(), reason="recording of a production machine not beside the repository"
)
def test_a_production_machine(tmp_path: Path) -> None:
    runs = imported(tmp_path, DATA / "sinumerik" / "recording.json")
    assert [len(run.trace.time) for run in runs.values()] == [1494, 322]
    (first, second) = runs.values()
    assert first.trace.axes == ("1", "2", "6")
    assert [first.fact(axis, "current").sign for axis in first.trace.axes] == [-1, -1, 1]
    active = block_at(tmp_path / "out", second, 0.45)
    assert active is not None
    assert active.block == "_CUTTING/N7"


@pytest.mark.skipif(not (DATA / "kr300" / "FF_A.mat").exists(), reason="recordings of a robot not beside the repository")
def test_a_robot_with_two_encoders(tmp_path: Path) -> None:
    (run,) = imported(tmp_path, DATA / "kr300" / "FF_A.mat").values()
    for axis in ("1", "2", "3"):
        assert run.fact(axis, "position").latency == pytest.approx(3.0e-3, abs=0.15e-3)
        assert run.fact(axis, "position").offset_taken_out
    content = json.loads((tmp_path / "out" / "import.json").read_text(encoding="utf-8"))
    assert content["runs"]["FF_A"]["period_s"] == 0.004


def test_positions_in_metres_beside_a_speed_without_unit(tmp_path: Path) -> None:
    m = move(TIME)
    table = {"t": TIME, "Lagesollwert X [m]": m["soll"] / 1e3, "Lageistwert X [m]": m["ist"] / 1e3, "Drehzahlistwert X": m["speed"] / 1e3}
    (run,) = imported(tmp_path, write_csv(tmp_path / "run.csv", table)).values()
    assert np.ptp(run.trace.get("X", "position")) == pytest.approx(np.ptp(m["ist"]) / 1e3, rel=1e-3)
    assert np.abs(run.trace.get("X", "velocity") * 1e3 - m["speed"]).max() < 2e-3 * np.abs(m["speed"]).max()


def test_a_following_error_in_another_unit_than_the_set_point(tmp_path: Path) -> None:
    m = move(TIME)
    table = {
        "t": TIME,
        "Lagesollwert X [mm]": m["soll"],
        "Schleppabstand X [um]": 1e3 * (m["soll"] - m["ist"]),
        "Drehzahlistwert X": m["speed"],
    }
    (run,) = imported(tmp_path, write_csv(tmp_path / "run.csv", table)).values()
    assert np.abs(run.trace.get("X", "velocity") * 1e3 - m["speed"]).max() < 2e-3 * np.abs(m["speed"]).max()


def test_recordings_with_different_feedforward_have_no_common_one(tmp_path: Path) -> None:
    m = move(TIME)
    table = {"t": TIME, "Lagesollwert X": m["soll"], "Lageistwert X": m["ist"]}
    files = [
        write_csv(tmp_path / f"{name}.csv", {**table, "VEL_FFW|X": speed})
        for name, speed in (("on", m["speed"]), ("off", 0.0 * m["speed"]))
    ]
    assert {run.feedforward for run in imported(tmp_path, *files).values()} == {None}
    assert "it differs between the recordings" in (tmp_path / "out" / "map.toml").read_text(encoding="utf-8")
    (run,) = imported(tmp_path / "one", files[0]).values()
    assert run.feedforward == "velocity"


def test_a_bracketed_index_is_no_unit() -> None:
    assert split_heading("pos_cmd[1]") == ("pos_cmd[1]", "")
    assert split_heading("program.block [1]") == ("program.block", "1")
    assert split_heading("pos_cmd [mm]") == ("pos_cmd", "mm")


@pytest.mark.parametrize("last", [True, False])
def test_a_following_error_in_counts_beside_two_speeds_of_the_motor(tmp_path: Path, capsys: pytest.CaptureFixture[str], last: bool) -> None:
    """A drive's scope without positions: the speed of the command is the last or the next step of the set points, half a sample beside their slope.

    The error of a lag of 25 ms gives 10000 counts a turn; with half a sample unknown, it gave 10200, of which no encoder has.
    """
    path = np.cumsum(np.convolve(np.sin(2.0 * np.pi * np.arange(5000) / 1000.0) > 0.4, np.ones(80) / 80.0, "same") * 25.0) * 1e-3  # turns
    path = np.concatenate([path[:2500], path[2500] - (path[2500:] - path[2500])])
    place = np.zeros_like(path)
    for k in range(1, len(path)):
        place[k] = place[k - 1] + 0.04 * (path[k - 1] - place[k - 1])
    step, speed = np.diff(path, prepend=path[0]) / 1e-3, np.gradient(place, 1e-3)
    rows = zip(60.0 * speed, 60.0 * (step if last else np.roll(step, -1)), np.rint(1e4 * (path - place)))
    text = "\n".join(f"{k}\t{a:.2f}\t{b:.2f}\t{c:.0f}" for k, (a, b, c) in enumerate(rows))
    heading = "サンプリング間隔\t1\tms\nNo.\tフィードバック速度[min-1]\t位置指令速度[min-1]\t位置偏差[指令単位]"
    (tmp_path / "scope.csv").write_text(f"{heading}\n{text}\n", encoding="utf-16")
    assert main(["import", str(tmp_path / "scope.csv"), "--out", str(tmp_path / "out"), "--no-picture"]) == 0
    said = capsys.readouterr().out
    assert "10000 a turn of the motor" in said
    assert "early" not in said
    assert "late " not in said
    trace = read_campaign(tmp_path / "out").runs[0].trace
    turns = trace.get("X", "position") / (2.0 * np.pi)
    begun = 0 if last else 1  # the trace has times with samples of all columns
    assert np.ptp(turns - place[begun : begun + len(turns)]) < 1e-3


def test_the_reasons_of_a_map_are_shares_that_people_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither '5.9e-05' without a unit nor '0.0%'."""
    assert main(["import", str(ROOT / "examples" / "traces" / "x_feedforward_off.csv")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "agrees with the position (to < 0.1 % of its travel)" in said
    assert "slope of the position (to < 0.1 %)" in said
    assert "direction of motion (94 %)" in said


def test_counts_of_unknown_size_that_go_one_way_are_no_spindle(tmp_path: Path) -> None:
    """A belt moves on by 44 553 counts: read as degrees they were 124 turns."""
    t = np.arange(800) * 2e-3
    s = np.rint(44553.0 * np.clip(t - 0.2, 0.0, 1.0) ** 2 * (3.0 - 2.0 * np.clip(t - 0.2, 0.0, 1.0)))
    x = np.concatenate([s[:8] * 0.0, s[:-8]])
    np.savetxt(tmp_path / "belt.csv", np.column_stack([1e6 * t, s, x]), "%.0f", ",", header="time_us,pos_cmd,pos_act", comments="")
    assert main(["import", str(tmp_path / "belt.csv"), "--out", str(tmp_path / "campaign"), "--no-picture"]) == 0
