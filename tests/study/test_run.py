"""Execution of studies: rows, tables, resumption, limits, output files."""

from concurrent.futures import Future
from dataclasses import replace
import json
from pathlib import Path
import re
import sqlite3
import subprocess
import sys

import numpy as np
import pyarrow.parquet
import pytest

from tests.builders.other_structures import write_slides
from tests.builders.refused import refused
from tests.builders.study_files import FACTOR, GRID, rows_of, write_meshes, write_move, write_spec
from twin.cli import main
from twin.errors import InputError
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine, load_machine
from twin.recordings.trace import Trace, read_trace, write_trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of
from twin.study.design import variants_of
from twin.study.evaluate import Answer, _source, evaluate, files_of_study, motion_of, work_of
from twin.study.execution import FILE, Store, Workers, carry_out, fingerprint
from twin.study.labels import valued
from twin.study.results import answers_of, surrogate_from, table_of
from twin.study.spec import read_study
from twin.surface.levels import levels_of_program
from twin.surface.machining import machine_part, report_of
from twin.surface.part import read_part


def listed(rows: str) -> str:
    return FACTOR + f'[design]\nkind = "list"\nrows = {rows}\n'


def test_responses_are_those_of_the_run(tmp_path: Path) -> None:
    spec = write_spec(tmp_path, listed("[[800.0]]"))
    ((_, _, found, reason),) = rows_of(spec, tmp_path / "out")
    machine = load_machine().with_values({"axis.X.moving_mass_kg": 800.0})
    run = simulate(machine, setpoints_of(read_trace(tmp_path / "move.csv"), machine), count_load=True)
    trace, load = run.trace, run.load["X"]
    s, x, i, v = (trace.get("X", name) for name in ("setpoint", "position", "current", "velocity"))
    assert reason is None
    assert found["following_error_max_X_um"] == pytest.approx(np.abs(s - x).max() * 1e6)
    assert found["following_error_rms_X_um"] == pytest.approx(np.sqrt(np.mean((s - x) ** 2)) * 1e6)
    # the control delays the set point by two samples of the record
    assert found["control_deviation_max_X_um"] == pytest.approx(np.abs(s[:-2] - x[2:]).max() * 1e6, rel=1e-6)
    # of every tick (tests/simulation/test_drive_load.py), where a record of 1 kHz misses the peaks of the ripple
    assert found["current_max_X_a"] == load.effort_max >= np.abs(i).max()
    assert found["current_rms_X_a"] == load.effort_rms
    assert found["current_rms_X_a"] ** 2 == pytest.approx(found["current_smooth_rms_X_a"] ** 2 + found["current_ripple_rms_X_a"] ** 2)
    assert found["current_limit_used_X"] == load.effort_max / 46.0
    assert found["speed_limit_used_X"] == pytest.approx(np.abs(v).max() / 0.5, rel=1e-3)
    assert found["copper_loss_X_w"] == pytest.approx(1.4 / 0.81 * 0.5 * load.effort_rms**2)
    assert found["mechanical_energy_X_j"] == load.work
    # the vertical axis is held by its current all the time
    assert (
        found["electrical_energy_j"] > found["electrical_energy_X_j"] + 0.5 * 0.5 * trace.time[-1] * (350 * 9.81 * 0.01 / 6.283 / 1.4) ** 2
    )
    assert found["holding_current_Z_a"] == pytest.approx(350 * 9.81 * 0.01 / (2 * np.pi) / 1.4, rel=1e-6)
    assert found["cycle_time_s"] == pytest.approx(trace.time[-1])
    assert not any("_Y_" in name and "_loop_" not in name for name in found)  # Y stands, and is level
    last = np.flatnonzero(np.diff(s))[-1] + 1
    outside = np.flatnonzero(np.abs(s - x) > 1e-6)
    assert found["settling_time_X_ms"] == pytest.approx((outside[-1] + 1 - last) * 1.0)
    # a straight move of one axis: the contour error is what the other axes do
    assert found["contour_error_max_um"] < 0.05


def test_two_runs_have_joined_and_own_responses(tmp_path: Path) -> None:
    write_move(tmp_path / "long.csv", distance=0.02)
    run = '[[run]]\ninput = "move.csv"\n[[run]]\ninput = "move.csv"\nname = "off"\nfeedforward = "off"\n[[run]]\ninput = "long.csv"\n'
    ((_, _, found, _),) = rows_of(write_spec(tmp_path, listed("[[800.0]]"), run), tmp_path / "out")
    names = ("move", "off", "long")

    def over_time(values: list[float]) -> float:
        return float(np.average(values, weights=[found[f"{n}.cycle_time_s"] for n in names]))

    assert found["off.following_error_max_X_um"] > 3 * found["move.following_error_max_X_um"]
    assert found["cycle_time_s"] == pytest.approx(sum(found[f"{n}.cycle_time_s"] for n in names))
    assert found["current_max_X_a"] == max(found[f"{n}.current_max_X_a"] for n in names)
    assert found["current_rms_X_a"] == pytest.approx(np.sqrt(over_time([found[f"{n}.current_rms_X_a"] ** 2 for n in names])))
    assert found["copper_loss_X_w"] == pytest.approx(over_time([found[f"{n}.copper_loss_X_w"] for n in names]))
    assert found["electrical_energy_j"] == pytest.approx(sum(found[f"{n}.electrical_energy_j"] for n in names))


def test_a_variant_that_fails_or_breaks_a_limit_is_a_row_with_its_reason(tmp_path: Path) -> None:
    factors = "".join(
        f'[[factor]]\nname = "{name}"\npath = "axis.X.{path}"\n'
        for name, path in (("mass", "moving_mass_kg"), ("gain", "loops.speed_gain_nm_s_per_rad"), ("limit", "motor.peak_current_a"))
    )
    rows = "[[700, 3.4, 46], [100, 3.4, 46], [700, 340, 46], [700, 3.4, 2.5], [700, 3.4, 0.001]]"
    spec = write_spec(tmp_path, factors + f'[design]\nkind = "list"\nrows = {rows}\n')
    found = rows_of(spec, tmp_path / "out")
    reasons = [reason or "" for *_, reason in found]
    assert [n for n, *_ in found] == [0, 1, 2, 3, 4]
    assert reasons[0] == ""
    assert "moving_mass_kg = 100 does not exceed the 350 kg" in reasons[1]
    assert "loops are unstable" in reasons[2] or "diverges" in reasons[2]
    assert "time at current limit of X is" in reasons[3]
    assert [bool(responses) for _, _, responses, _ in found] == [True, False, False, True, True]
    study = read_study(spec)
    # a single variant shows no effect of any factor
    assert answers_of(study, found[:2]).without_effect == []
    # a variant at its limit is not the best, not on the front, and in no effect
    answers = answers_of(study, found)
    assert (answers.failed, answers.broken, answers.best, answers.pareto) == (2, 2, 0, [0])


def test_the_commanded_path_of_a_trace_is_that_of_each_variant(tmp_path: Path) -> None:
    """The same set points give another tool path on another geometry, but the same contour error of the drives."""
    time, tilt = moves_in_turn(0.0, [0.3], 0.5, 2.0, 50.0, 0.06, 1e-3)
    signals = {("A", "setpoint"): tilt, ("C", "setpoint"): np.zeros(len(time)), ("Z", "setpoint"): np.zeros(len(time))}
    write_trace(Trace(time, signals, {"A": "rotary", "C": "rotary", "Z": "linear"}), tmp_path / "move.csv")
    factor = '[[factor]]\nname = "offset"\npath = "geometry.a_axis_to_c_axis_y_m"\n[design]\nkind = "list"\nrows = [[0.0], [0.2]]\n'
    nominal, other = rows_of(write_spec(tmp_path, factor), tmp_path / "out")
    assert 0.0 < nominal[2]["contour_error_max_um"] < 1000.0
    assert 0.2 < other[2]["contour_error_max_um"] / nominal[2]["contour_error_max_um"] < 5.0


def test_a_variant_without_phase_margin_has_its_reason(tmp_path: Path) -> None:
    gain = '[[factor]]\nname = "gain"\npath = "axis.X.loops.position_gain_per_s"\n[design]\nkind = "list"\nrows = [[50.0], [330.0]]\n'
    good, poor = rows_of(write_spec(tmp_path, gain), tmp_path / "out")
    assert good[3] is None
    assert good[2]["phase_margin_position_loop_X_deg"] > 60.0
    assert "phase margin of the position loop of X is" in (poor[3] or "") or not poor[2]
    # the same without the constraint, and with one of one's own
    asked = 'least_phase_margin_deg = 0\n[[constraint]]\nresponse = "crossover_position_loop_X_hz"\nleast = 20\n'
    slow, fast = rows_of(write_spec(tmp_path, asked + gain.replace("330.0", "150.0")), tmp_path / "own")
    assert "crossover of the position loop of X is 8.441 Hz, below the least of 20 Hz" in (slow[3] or "")
    assert fast[3] is None


def test_a_moment_at_a_limit_is_allowed(tmp_path: Path) -> None:
    limit = '[[factor]]\nname = "limit"\npath = "axis.X.motor.peak_current_a"\n[design]\nkind = "list"\nrows = [[2.5]]\n'
    ((_, _, found, reason),) = rows_of(write_spec(tmp_path, limit), tmp_path / "out")
    assert found["time_at_current_limit_X_share"] > 0.001
    assert "time at current limit of X is" in (reason or "")
    assert "above the limit of 0.1 %" in (reason or "")
    ((*_, reason),) = rows_of(write_spec(tmp_path, f"most_time_at_limit = 0.9\n{limit}"), tmp_path / "allowed")
    assert reason is None


def test_axes_that_take_a_voltage_or_torque(tmp_path: Path) -> None:
    """P/P on a voltage, P/PI on a current, P/P on a torque: responses use the commanded quantity and its unit."""
    write_slides(tmp_path)
    machine = load_machine(tmp_path / "slides.toml")
    moves = {
        "X": moves_in_turn(0.0, [0.01], 0.1, 2.0, 50.0, 0.06, 1e-3),
        "Z": moves_in_turn(0.0, [0.01], 0.1, 2.0, 50.0, 0.06, 1e-3),
        "B": moves_in_turn(0.0, [0.1], 0.6, 4.0, 80.0, 0.06, 1e-3),
    }
    time = max((t for t, _ in moves.values()), key=len)
    signals = {(a, "setpoint"): np.pad(p, (0, len(time) - len(p)), mode="edge") for a, (_, p) in moves.items()}
    write_trace(Trace(time, signals, machine.kinds), tmp_path / "move.csv")
    factors = (("mass", "axis.X.moving_mass_kg"), ("peak", "axis.X.actuator.peak_voltage_v"), ("load", "axis.Z.moving_mass_kg"))
    text = "".join(f'[[factor]]\nname = "{name}"\npath = "{path}"\n' for name, path in factors)
    text += '[design]\nkind = "list"\nrows = [[95, 10, 20], [95, 0.5, 20], [110, 10, 22]]\n'
    for told in (True, False):
        spec = write_spec(tmp_path, f'machine = "slides.toml"\nrecommission = {str(told).lower()}\n{text}')
        nominal, limited, heavier = rows_of(spec, tmp_path / f"out_{told}")
        found = nominal[2]
        assert {"voltage_max_X_v", "current_rms_Z_a", "torque_limit_used_B", "voltage_limit_used_X"} <= found.keys()
        assert not any(name.startswith("copper_loss") or name == "current_max_X_a" for name in found)
        run = simulate(machine, setpoints_of(read_trace(tmp_path / "move.csv", axes=machine.kinds), machine))
        for axis, signal, name in (
            ("X", "voltage", "voltage_max_X_v"),
            ("Z", "current", "current_max_Z_a"),
            ("B", "torque", "torque_max_B_nm"),
        ):
            assert found[name] == pytest.approx(np.abs(run.trace.get(axis, signal)).max(), rel=0.2)
            assert found[name] >= np.abs(run.trace.get(axis, signal)).max()
        assert found["voltage_limit_used_X"] == pytest.approx(found["voltage_max_X_v"] / 10.0)
        assert nominal[3] is None
        assert "time at voltage limit of X is" in (limited[3] or "")
        assert heavier[2]["current_max_Z_a"] > found["current_max_Z_a"]
        assert heavier[3] is None


def test_a_fault_of_the_twin_is_a_row_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    work = work_of(read_study(write_spec(tmp_path)))
    monkeypatch.setattr("twin.study.evaluate.simulate", lambda *a, **k: 1 / 0)
    assert evaluate(work, (700.0,)).reason == "fault in the twin, please report: ZeroDivisionError: division by zero"


def test_a_worker_with_another_twin_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    work = work_of(read_study(write_spec(tmp_path)))
    monkeypatch.setattr("twin.__version__", "0.0.1")
    with pytest.raises(InputError, match=r"this worker has twin 0\.0\.1"):
        evaluate(work, (700.0,))


def test_the_table_does_not_depend_on_the_number_of_threads(tmp_path: Path) -> None:
    spec = write_spec(tmp_path, FACTOR + GRID.replace("3", "6"))
    one, four = (rows_of(spec, tmp_path / str(n), threads=n) for n in (1, 4))
    assert one == four
    assert len({found["current_max_X_a"] for _, _, found, _ in one}) == 6


def test_a_packed_study_gives_the_same_numbers(tmp_path: Path) -> None:
    import pickle

    work = work_of(read_study(write_spec(tmp_path)))
    packed = pickle.loads(pickle.dumps(work.packed()))
    assert packed.here().study.machine.model_path != work.here().study.machine.model_path
    assert evaluate(packed, (800.0,)) == evaluate(work, (800.0,))


def test_a_worker_needs_no_mesh_of_ours(tmp_path: Path) -> None:
    """A packed study cuts a part of meshes on a machine with a mesh after all of our files are gone."""
    import pickle

    home = tmp_path / "home"
    home.mkdir()
    write_meshes(home)
    (home / "pass.mpf").write_text("G17 G71 G90 G94\nG0 X-4 Y0 Z0 A0 C0\nG1 X4 F2000\nM30\n", encoding="utf-8")
    spec = write_spec(home, 'machine = "machine.toml"\npart = "part.toml"\n' + listed("[[800.0]]"), '[[run]]\ninput = "pass.mpf"\n')
    work = work_of(read_study(spec))
    here = evaluate(work, (800.0,))
    assert here.reason is None
    assert "mark_depth_um" in here.responses
    packed = pickle.loads(pickle.dumps(work.packed()))
    home.rename(tmp_path / "elsewhere")
    assert evaluate(work, (800.0,)).reason is not None
    assert evaluate(packed, (800.0,)) == here


def test_a_program_in_latin_1_runs(tmp_path: Path) -> None:
    (tmp_path / "rapid.mpf").write_bytes("; Fräser\nG17 G71 G90 G94\nG0 X0 Y0 Z0 A0 C0\nG0 X1\nM30\n".encode("latin-1"))
    ((_, _, found, reason),) = rows_of(write_spec(tmp_path, listed("[[700.0]]"), '[[run]]\ninput = "rapid.mpf"\n'), tmp_path / "out")
    assert reason is None
    assert found["cycle_time_s"] > 0.0


def test_a_stopped_study_continues_without_repeating_variants(tmp_path: Path) -> None:
    spec = write_spec(tmp_path, FACTOR + GRID.replace("3", "6"))
    whole = rows_of(spec, tmp_path / "whole")
    study = read_study(spec)
    variants = variants_of(study)
    computed: list[float] = []

    class Counting:
        def submit(self, function, work, row):  # type: ignore[no-untyped-def]
            future: Future[Answer] = Future()
            computed.append(row[0])
            future.set_result(function(work, row))
            return future

    def stop(_: None) -> None:
        if len(computed) >= 3:
            raise KeyboardInterrupt

    workers = Workers(Counting(), lambda: 1, lambda work: work)  # type: ignore[arg-type]
    store = Store(tmp_path / "out", fingerprint(study, variants), resume=False)
    with pytest.raises(KeyboardInterrupt):
        carry_out(study, variants, store, workers, stop)
    done = store.done()
    store.close()
    assert 1 <= len(done) < 6
    computed.clear()
    store = Store(tmp_path / "out", fingerprint(study, variants), resume=True)
    carry_out(study, variants, store, workers, lambda _: None)
    assert sorted(computed) == sorted(variants[i, 0] for i in range(6) if i not in done)
    assert store.rows() == whole
    with pytest.raises(sqlite3.IntegrityError):
        store.put(0, [500.0], Answer())
    store.close()


def test_two_studies_may_not_write_one_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec = write_spec(tmp_path)
    study = read_study(spec)
    code = (
        "import sys\nfrom pathlib import Path\nfrom twin.study.execution import Store\n"
        f"store = Store(Path({str(tmp_path / 'out')!r}), {fingerprint(study, variants_of(study))!r}, False)\n"
        "print('held', flush=True)\nsys.stdin.read()\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout.readline() == b"held\n"
        assert "another twin command is writing here" in refused(capsys, "study", str(spec), "--out", str(tmp_path / "out"))
        other.kill()
    # the lock of a killed process is released
    assert main(["study", str(spec), "--out", str(tmp_path / "out"), "--no-replay"]) == 0


def test_folders_that_cannot_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec = write_spec(tmp_path)
    out = tmp_path / "out"
    rows_of(spec, out)
    assert "already holds 3 variants; add --resume" in refused(capsys, "study", str(spec), "--out", str(out))
    spec.write_text(spec.read_text(encoding="utf-8").replace("levels = 3", "levels = 4"), encoding="utf-8")
    assert "holds another study" in refused(capsys, "study", str(spec), "--out", str(out), "--resume")
    (out / FILE).write_bytes(b"no database at all" * 100)
    assert "file is not a database" in refused(capsys, "study", str(spec), "--out", str(out), "--resume")
    (tmp_path / "file").write_text("")
    assert "cannot create this folder" in refused(capsys, "study", str(spec), "--out", str(tmp_path / "file"))
    (tmp_path / "taken" / FILE).mkdir(parents=True)
    assert "is a folder and is not replaced" in refused(capsys, "study", str(spec), "--out", str(tmp_path / "taken"))


def test_workers_that_are_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    spec = write_spec(tmp_path)
    for no_address in ("nonsense", "tcp://here", "tcp://127.0.0.1:99999"):
        assert "not an address; give host and port" in refused(
            capsys, "study", str(spec), "--out", str(tmp_path / "out"), "--scheduler", no_address
        )
    monkeypatch.setattr("twin.study.execution.SECONDS_TO_ANSWER", 1)
    out = str(tmp_path / "out")
    for address in ("tcp://127.0.0.1:9", "tcp://no.such.host.invalid:8786"):
        message = refused(capsys, "study", str(spec), "--out", out, "--scheduler", address, "--resume")
        assert f"--scheduler {address}: no Dask scheduler answers there" in message
    assert "leave out one of" in refused(capsys, "study", str(spec), "--out", out, "--scheduler", "tcp://127.0.0.1:9", "--threads", "2")
    assert "give a whole number, 1 or more" in refused(capsys, "study", str(spec), "--out", out, "--threads", "0")


def test_no_variant_at_all_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec = write_spec(tmp_path, listed("[[100.0], [200.0]]"))
    message = refused(capsys, "study", str(spec), "--out", str(tmp_path / "out"))
    assert "no variant could be simulated; the first one" in message
    assert "does not exceed the 350 kg" in message


def test_limits_that_scale_change_the_cycle_time(tmp_path: Path) -> None:
    (tmp_path / "rapid.mpf").write_text("G17 G71 G90 G94\nG0 X0 Y0 Z0 A0 C0\nG0 X10\nM30\n", encoding="utf-8")
    factor = '[[factor]]\nname = "jerk"\npath = "axis.X.max_jerk_m_per_s3"\n[design]\nkind = "list"\nrows = [[5.0], [40.0]]\n'
    rows = rows_of(write_spec(tmp_path, factor, '[[run]]\ninput = "rapid.mpf"\n'), tmp_path / "out")
    slow, fast = (found["cycle_time_s"] for _, _, found, _ in rows)
    # jerk alone decides a short move: 4 t_j with t_j = (s / 2 j)^(1/3), in whole interpolation cycles
    whole = [4.0 * (0.01 / (2.0 * jerk)) ** (1.0 / 3.0) for jerk in (5.0, 40.0)]
    assert slow - fast == pytest.approx(whole[0] - whole[1], abs=0.017)
    assert slow - fast > 0.15


def test_a_part_gives_the_depth_of_the_mark(tmp_path: Path) -> None:
    # a roof: without feedforward the axes cut its crest off
    lines = ("G17 G71 G90 G94 FFWOF", "G64", "CYCLE832(0.01,3)", "G0 X-7 Y0 Z-131 A0 C0", "G1 X0 Z-130 F2000", "X7 Z-131", "M30")
    (tmp_path / "roof.mpf").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (tmp_path / "part.toml").write_text(
        '[tool]\nkind = "ball"\ndiameter_mm = 10.0\nlength_mm = 120\n[stock]\nallowance_mm = 2.0\n'
        '[[surface]]\nname = "top"\nkind = "plane"\norigin_mm = [-5.5, -0.2, 169]\nu_direction = [1, 0, 0]\nv_direction = [0, 1, 0]\n'
        "along_mm = [0, 11]\nacross_mm = [0, 0.4]\nspacing_mm = 0.1\ndepth_mm = 1.0\n",
        encoding="utf-8",
    )
    factor = '[[factor]]\nname = "gain"\npath = "axis.*.loops.position_gain_per_s"\n[design]\nkind = "list"\nrows = [[25.0], [50.0]]\n'
    run = '[[run]]\ninput = "roof.mpf"\n[[run]]\nname = "again"\ninput = "roof.mpf"\nfeedforward = "velocity+torque"\n'
    rows = rows_of(write_spec(tmp_path, 'part = "part.toml"\n' + factor, run), tmp_path / "out")
    soft, nominal = (found for _, _, found, _ in rows)
    part = read_part(tmp_path / "part.toml")
    levels = levels_of_program(tmp_path / "roof.mpf", load_machine(), part.tool, ("programmed", "followed"), ("off",))
    machining = machine_part(part, levels)
    assert nominal["roof.mark_depth_um"] == pytest.approx(report_of(machining, machining.cuts[1])["mark"]["depth_um"], rel=1e-6)
    assert soft["roof.mark_depth_um"] > 1.5 * nominal["roof.mark_depth_um"] > 2.0 * nominal["again.mark_depth_um"]
    assert nominal["mark_depth_um"] == nominal["roof.mark_depth_um"]


def test_the_first_mode_of_a_compliant_transmission(tmp_path: Path, mikron) -> None:  # type: ignore[no-untyped-def]
    factor = '[[factor]]\nname = "k"\npath = "effect.transmission_compliance.X.stiffness"\n[design]\nkind = "list"\nrows = [[5e7], [8e7]]\n'
    rows = rows_of(write_spec(tmp_path, factor), tmp_path / "out")
    for _, (k,), found, _ in rows:
        assert found["first_mode_X_hz"] == pytest.approx(np.sqrt(k / 700.0) / (2 * np.pi), rel=1e-6)


def test_everything_is_written_and_the_best_machine_is_the_best(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    idle = '[[factor]]\nname = "idle"\npath = "axis.X.travel_m.1"\nrange = [0.3, 0.355]\n'
    design = '[design]\nkind = "latin_hypercube"\ncount = 8\n'
    spec = write_spec(tmp_path, 'answer = ["current_max_X_a", "contour_error_max_um"]\n' + FACTOR + idle + design)
    out = tmp_path / "out"
    assert main(["study", str(spec), "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "idle has no effect on any response" in told
    assert "largest influence: mass" in told
    assert re.search(r"with variant \d: mass \d+\.?\d* kg, idle \d+\.?\d* mm$", told, re.MULTILINE)
    document = json.loads((out / "study.json").read_text(encoding="utf-8"))
    table = pyarrow.parquet.read_table(out / "table.parquet")
    assert table.column_names[:3] == ["variant", "mass", "idle"]
    assert table.column_names[-1] == "reason"
    assert table.num_rows == 8
    assert document["best"]["responses"]["current_max_X_a"] == min(table.column("current_max_X_a").to_pylist())
    assert document["without_effect"] == ["idle"]
    best = load_machine(out / "best_machine.toml")
    assert best.axis("X").moving_mass_kg == document["best"]["factors"]["mass"]
    again = simulate(best, setpoints_of(read_trace(tmp_path / "move.csv"), best), count_load=True)
    assert again.load["X"].effort_max == pytest.approx(document["best"]["responses"]["current_max_X_a"], rel=1e-12)
    page = (out / "report.html").read_text(encoding="utf-8")
    as_it_is = evaluate(work_of(read_study(spec)), (700.0, 0.355)).responses["current_max_X_a"]
    assert f"The machine as it is has {valued('current_max_X_a', as_it_is)}." in page
    for word in ("Findings", "largest current of X [A]", "Trade-off", "Surrogate", "<svg"):
        assert word in page
    for plot in ("current_max_X_a.png", "current_max_X_a_effects.png", "pareto.png"):
        assert (out / "plots" / plot).stat().st_size > 5000
    assert (out / "best_move.rrd").stat().st_size > 10_000
    assert (out / "table.csv").read_text(encoding="utf-8").count("\n") == 9

    # to interpolate: the surrogate of the finished study, with its own error
    predict = surrogate_from(out, "current_max_X_a")
    value, error = predict({"mass": 700.0, "idle": 0.34})
    found = evaluate(work_of(read_study(spec)), (700.0, 0.34)).responses
    assert abs(value - found["current_max_X_a"]) < 5 * error + 1e-6
    for wrong, word in (
        ({"mass": 700.0}, "'idle' is missing"),
        ({"mas": 1.0}, "no factor 'mas'"),
        ({"mass": 5000.0, "idle": 0.34}, "outside"),
    ):
        with pytest.raises(InputError, match=word):
            predict(wrong)
    with pytest.raises(InputError, match="no response 'current'"):
        surrogate_from(out, "current")

    # answered anew without a run
    assert main(["study", str(spec), "--out", str(out), "--resume", "--no-replay"]) == 0
    assert "8 of them done before" in capsys.readouterr().out


def test_a_study_of_two_variants_is_answered(tmp_path: Path) -> None:
    spec = write_spec(tmp_path, listed("[[600.0], [800.0]]"))
    assert main(["study", str(spec), "--out", str(tmp_path / "out"), "--no-replay"]) == 0
    json.loads((tmp_path / "out" / "study.json").read_text(encoding="utf-8"), parse_constant=lambda c: pytest.fail(f"{c} is no JSON"))


def test_sobol_indices_come_with_the_sobol_design(tmp_path: Path) -> None:
    spec = write_spec(tmp_path, 'answer = ["current_max_X_a"]\n' + FACTOR + (
        '[[factor]]\nname = "friction"\npath = "axis.X.coulomb_friction_nm"\nrange = [1.0, 2.0]\n[design]\nkind = "sobol"\ncount = 4\n'
    ))  # fmt: skip
    study = read_study(spec)
    rows = rows_of(spec, tmp_path / "out")
    (response,) = answers_of(study, rows).responses
    assert len(rows) == 16
    assert set(response.sobol) == {"S1", "S1_conf", "ST", "ST_conf"}
    assert table_of(study, rows).num_rows == 16


def test_a_program_with_a_subprogram_beside_it(tmp_path: Path, mikron: Machine) -> None:
    """The limits vary, so that each variant interpolates the program; an error names the files of the user."""
    (tmp_path / "main.mpf").write_text("G1 X1 F1000\nL100\nM30\n", encoding="utf-8")
    (tmp_path / "L100.spf").write_text("G1 X5 F1000\nM17\n", encoding="utf-8")
    run = '[[run]]\ninput = "main.mpf"\n'
    factor = '[[factor]]\npath = "axis.X.max_acceleration_m_per_s2"\nrange = [2.0, 3.0]\n'
    spec = write_spec(tmp_path, factor + GRID, run)
    study = read_study(spec)
    assert {"main.mpf", "L100.spf"} <= {file.name for file in files_of_study(study)}
    source = _source(study, study.runs[0], None)
    setpoints, _ = motion_of(source, mikron)
    assert np.ptp(setpoints.position[:, 0]) == pytest.approx(5e-3, abs=1e-6)
    broken = replace(source, program=(("main.mpf", b"G1 X1 F1000\nG1 Q!\n"), *source.program[1:]))
    with pytest.raises(InputError, match=re.escape(str(tmp_path / "main.mpf"))):
        motion_of(broken, mikron)
