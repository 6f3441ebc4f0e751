"""The commands as a newcomer uses them: what they write, what they print, and that the demo and the benchmark work."""

import io
import json
import os
from pathlib import Path
import re
import subprocess
import sys
import threading
import time
from unittest.mock import MagicMock

import numpy as np
import pytest

from devtools import benchmark
from tests.builders.recording_read import read_recording
from tests.conftest import ROOT
from twin import progress
from twin.cli import main
from twin.cli.demo import paper_test
from twin.cli.parser import COMMANDS
from twin.errors import InputError
from twin.limits import raised, raised_by
from twin.machine.machine import load_machine
from twin.progress import Progress, hushed
from twin.recordings.trace import read_trace
from twin.simulation.run import simulate

EXAMPLE = ROOT / "examples" / "x_200mm.csv"


def test_first_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(EXAMPLE), "--out", str(tmp_path), "--strict"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "following error max" in out
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["axes"]["X"]["following_error_max"] == pytest.approx(500.0, abs=1.0)
    assert summary["axes"]["X"]["following_error_unit"] == "um"
    trace = read_trace(tmp_path / "trace.parquet")
    assert trace.axes == ("X", "Y", "Z", "A", "C")
    np.testing.assert_allclose(trace.get("X", "setpoint"), read_trace(EXAMPLE).get("X", "setpoint"), rtol=0, atol=1e-12)


def test_run_compares_a_machine_with_an_effect_to_the_nominal_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    effect = ["--effect", "backlash:X:clearance=15e-6", "--beside"]
    assert main(["run", "examples/x_200mm.csv", *effect, "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "effects: backlash X (clearance 15.0 um); feedforward: velocity+torque" in out
    assert "nominal and with backlash X differ on X: position by up to" in out
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["feedforward"] == "velocity+torque"
    (x,) = (e for e in json.loads((tmp_path / "compare.json").read_text())["errors"] if e["axis"] == "X")
    assert x["first"] == pytest.approx(9.7, abs=0.3)
    assert x["second"] == pytest.approx(18.1, abs=0.5)
    shown = read_recording(tmp_path / "run.rrd")["/summary"]["TextDocument:text"].values[0][0]
    assert "effects: backlash X (clearance 15.0 um)" in shown
    page = (tmp_path / "report.html").read_text()
    assert "Made by twin" in page
    assert "backlash X (clearance 15.0 um)" in page
    assert main(["run", "examples/x_200mm.csv", "--beside", "--out", str(tmp_path)]) == 2
    assert "--beside needs an --effect" in capsys.readouterr().err


def test_feedforward(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--feedforward", "off", "--no-recording", "--out", str(tmp_path)]
    assert main(["run", str(EXAMPLE), *arguments]) == 0
    capsys.readouterr()
    assert json.loads((tmp_path / "summary.json").read_text())["axes"]["X"]["following_error_max"] == pytest.approx(5500, abs=5)


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    listed = re.findall(r"^  ([a-z0-9]+) {2,}\S", out, re.M)
    assert listed == [name for group in COMMANDS.values() for name in group]
    assert {path.stem for path in (ROOT / "twin" / "cli").glob("*.py")} - {"__init__", "arguments", "parser"} == {
        name.replace("import", "import_recordings") for group in COMMANDS.values() for name in group
    }
    assert "cascade + plant" in out


def test_stopped_by_the_user(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("twin.stopping._said", threading.Lock())  # it is said once a process

    def stopped(_: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr("twin.cli.effects.carry_out", stopped)
    assert main(["effects"]) == 130
    assert capfd.readouterr().err == "twin: stopped by the user\n"


def test_disk_that_is_full(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def full(_: object) -> int:
        raise OSError(28, "No space left on device", "out/trace.parquet")

    monkeypatch.setattr("twin.cli.effects.carry_out", full)
    assert main(["effects"]) == 2
    assert capsys.readouterr().err == "twin: out/trace.parquet: No space left on device; choose another place or free space there\n"


def test_interpolate_writes_set_points_and_feed(tmp_path: Path) -> None:
    program = EXAMPLE.parent / "two_planes.mpf"
    out, plot = tmp_path / "setpoints.parquet", tmp_path / "feed.png"
    assert main(["interpolate", str(program), "--out", str(out), "--plot", str(plot)]) == 0
    trace = read_trace(out, need=("setpoint",))
    assert np.ptp(trace.get("X", "setpoint")) > 1e-3
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_picture_of_no_known_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = EXAMPLE.parent / "two_planes.mpf"
    assert main(["interpolate", str(program), "--out", str(tmp_path / "s.csv"), "--plot", str(tmp_path / "feed.foo")]) == 2
    assert "a picture ends in .png, .svg, .pdf" in capsys.readouterr().err
    assert not (tmp_path / "s.csv").exists()


def test_period_longer_than_the_run() -> None:
    with pytest.raises(InputError, match="record it more often"):
        simulate(load_machine(), read_trace(EXAMPLE), sample_period=100.0)


def test_help_needs_no_engine() -> None:
    """Usage is there at once: neither engine nor viewer nor plots are loaded for it, nor what half of the other imports would take again."""
    loaded = "import sys; from twin.cli.parser import build_parser; build_parser('diagnose'); print(*sys.modules)"
    modules = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True).stdout.split()
    assert not {"mujoco", "rerun", "matplotlib", "pyarrow", "scipy.signal", "scipy.stats"} & set(modules)


def test_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    for feedforward in ("off", "velocity", "velocity+torque"):
        assert f"\n{feedforward} " in out
    assert (tmp_path / "x_200mm.png").read_bytes().startswith(b"\x89PNG")
    assert len(list(tmp_path.glob("*.parquet"))) == 3


def test_the_example_holds_the_set_points_of_the_demo() -> None:
    made, kept = paper_test(load_machine()), read_trace(EXAMPLE)
    np.testing.assert_allclose(made.get("X", "setpoint"), kept.get("X", "setpoint"), rtol=0, atol=1e-15)


def test_benchmark_prints_its_json_and_fills_the_table_of_the_readme(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    readme = (EXAMPLE.parents[1] / "README.md").read_text(encoding="utf-8")
    (tmp_path / "README.md").write_text(readme, encoding="utf-8")
    assert benchmark.main(["--json", "--seconds", "8", "--no-startup", "--page", str(tmp_path / "README.md")]) == 0
    numbers = json.loads(capsys.readouterr().out)
    # no bounds: times on a loaded computer say nothing; the figures themselves come from scripts/benchmark
    assert {"loop_over_engine", "realtime_factor", "python_loop_over_engine"} <= numbers.keys()
    assert all(value > 0.0 for value in numbers.values())
    page = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert f"| times real time | {numbers['realtime_factor']:.3g} (" in page
    assert page.partition("<!-- benchmark -->")[0] == readme.partition("<!-- benchmark -->")[0]


def test_quiet_and_verbose(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TQDM_DISABLE", "0")
    assert main(["effects", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert main(["effects", "backlash", "--verbose"]) == 0
    out, err = capsys.readouterr()
    assert "clearance" in out
    assert re.match(r"twin [\d.]+, mujoco [\d.]+, numpy [\d.]+, numba [\d.]+: [\d.]+ s\n", err)


def test_default_machine_of_the_environment(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWIN_MACHINE", str(ROOT / "examples" / "lab_axis" / "axis.toml"))
    assert main(["effects", "backlash"]) == 0
    lab = capsys.readouterr().out
    monkeypatch.delenv("TWIN_MACHINE")
    assert main(["effects", "backlash"]) == 0
    assert lab != capsys.readouterr().out


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_contains_commands_and_options(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    out = capsys.readouterr().out
    assert "interpolate" in out
    assert "feedforward" in out


def test_an_example_is_found_outside_the_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As in an installed package, whose examples lie inside it."""
    package = tmp_path / "site" / "twin"
    package.mkdir(parents=True)
    (package / "examples").symlink_to(ROOT / "examples")
    monkeypatch.setattr("twin.__file__", str(package / "__init__.py"))
    monkeypatch.chdir(tmp_path)
    assert main(["interpolate", "examples/two_planes.mpf", "--out", str(tmp_path / "s.csv")]) == 0
    assert main(["interpolate", "examples/none.mpf", "--out", str(tmp_path / "s.csv")]) == 2
    assert "examples/none.mpf" in capsys.readouterr().err


def test_a_command_uses_one_blas_thread() -> None:
    asked = "import twin.__main__, numpy, scipy.linalg; from threadpoolctl import threadpool_info; print({i['num_threads'] for i in threadpool_info()})"
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    threads = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True, env=environment).stdout
    assert threads.strip() == "{1}"


def test_two_machine_files_give_a_comparison_page(tmp_path: Path) -> None:
    """No page of an earlier comparison is left in the folder as if it were this one's."""
    (tmp_path / "report.html").write_text("of an earlier comparison")
    assert main(["compare", "examples/gantry/gantry.toml", "examples/lab_axis/axis.toml", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "report.html").read_text()
    assert "axis.X.moving_mass_kg" in page
    assert "Gantry and axis" in page


@pytest.mark.parametrize("words", [["machine", "show", "--quiet"], ["machine", "--quiet", "show"]])
def test_an_action_takes_the_options_of_every_command(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 0
    assert capsys.readouterr().out == ""


def test_a_command_leaves_nothing_behind_in_the_process(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The options of one call do not change the next call, also after an error."""
    monkeypatch.setenv("TWIN_LIMITS", "3")
    before = dict(os.environ)
    for words in (["effects", "--limits", "7", "--quiet"], ["effects", "no such effect", "--limits", "7", "--quiet"]):
        main(words)
        assert dict(os.environ) == before
        assert raised_by() == 3.0
        assert not progress._hushed
    with raised(5.0), hushed():
        assert raised_by() == 5.0
        assert Progress("work").bar.disable


def test_a_bar_leaves_nothing_behind_even_where_the_work_never_reports(monkeypatch: pytest.MonkeyPatch) -> None:
    """Results would begin in its line."""
    terminal = io.StringIO()
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setattr(progress, "FIRST_S", 0.01)
    with Progress("drawing", total=0):
        while "drawing" not in terminal.getvalue():
            time.sleep(0.01)
    assert terminal.getvalue().split("\r")[-2].isspace()


def test_the_demo_shows_what_it_does_while_it_simulates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is the first command of a newcomer, and it also compiles."""
    shown = MagicMock()
    monkeypatch.setattr("twin.cli.demo.Progress", shown)
    monkeypatch.setattr("twin.cli.demo.run_test", MagicMock(side_effect=InputError("enough seen")))
    assert main(["demo", "--out", str(tmp_path)]) == 2
    shown.assert_called_once_with("simulating the test with each feedforward", total=0)
