"""The actuator example: on simulated strokes, and on the recorded ones if they are available."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.builders.script import script
from tests.conftest import SHARED

DATA = SHARED / "data" / "actuator"


def written(path: Path, friction: float, per_kgf: float = 5e-3, runs: int = 2) -> Path:
    """Trials of 20 and -40 kgf: strokes at 24 mm/s there and back, a current without sign and with noise."""
    rng = np.random.default_rng(5)
    lines = ["set_point,position_error,current,profile,load,run,fault_type,group,time"]
    for load in (20.0, -40.0):
        for run in range(1, runs + 1):
            t = 0.04 * np.arange(300)
            speed = np.where(t < 5.0, 24.0, np.where(t < 7.0, 0.0, -24.0))
            s = np.cumsum(speed) * 0.04
            current = np.abs(friction * np.sign(speed) - per_kgf * load * np.abs(np.sign(speed))) + 0.02 * rng.standard_normal(len(t))
            lines += [f"{a},0,{b},trap,{load:g},{run},0,1,{c}" for a, b, c in zip(s, current, t)]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_the_load_is_found_and_no_cause_is_named(tmp_path: Path) -> None:
    example = script("examples/real/actuator/run.py", "actuator_example")
    trials = {"a": example.read_trials(written(tmp_path / "a.csv", 0.8)), "b": example.read_trials(written(tmp_path / "b.csv", 0.9))}
    k = trials["a"][0].by_load / trials["a"][0].load
    assert k == pytest.approx(5e-3, rel=0.1)
    assert all(t.by_load / k == pytest.approx(t.load, rel=0.15) for several in trials.values() for t in several)
    said = " ".join(example.summary_lines(trials))
    assert "+12 % at 20 kgf" in said or "+13 % at 20 kgf" in said
    assert "No cause is named" in said


def test_trials_against_healthy_ones(tmp_path: Path) -> None:
    """More friction is said of the trials that have it, of no healthy one, and of no other."""
    example = script("examples/real/actuator/run.py", "actuator_example")
    trials = {
        "a": example.read_trials(written(tmp_path / "a.csv", 0.8, runs=5)),
        "b": example.read_trials(written(tmp_path / "b.csv", 0.9, runs=5)),
    }
    said = example.change_lines(trials)
    rows = {line.split()[0]: [int(n) for n in line.split()[1:]] for line in said[1].splitlines() if line.split()[:1] in (["a"], ["b"])}
    assert rows == {"a": [10, 0, 0], "b": [0, 10, 0]}


def test_a_file_of_another_kind_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example = script("examples/real/actuator/run.py", "actuator_example")
    (tmp_path / "x.csv").write_text("time,current\n0,1\n", encoding="utf-8")
    for name in ("x.csv", "nowhere.csv"):
        assert example.main([str(tmp_path / name)]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_the_recorded_loads() -> None:
    files = [DATA / f"{name}.csv" for name in ("normal", "lackLubrication1", "backlash1")]
    if not all(f.is_file() for f in files):
        pytest.skip("no recording: ../shared/data/actuator is not beside this repository")
    example = script("examples/real/actuator/run.py", "actuator_example")
    trials = {f.stem: example.read_trials(f) for f in files}
    first = trials["normal"][0]
    k = first.by_load / first.load
    assert all(t.by_load / k == pytest.approx(t.load, rel=0.15) for several in trials.values() for t in several)
    said = {
        line.split()[0]: [int(n) for n in line.split()[1:]]
        for line in example.change_lines(trials)[1].splitlines()
        if line.startswith(tuple(trials))
    }
    assert said["normal"][1:] == [0, 0]  # no change among healthy trials
    assert said["lackLubrication1"][1] >= 8
    assert said["lackLubrication1"][2] == 0
    assert "backlash, wear and stiffness cannot be seen" in example.summary_lines(trials)[-1]
