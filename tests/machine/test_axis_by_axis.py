"""Axes that are recorded one at a time, each to its own file with its own columns, as the tools of drives do, give one machine."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.builders.refused import refused
from tests.builders.strokes import Planted, strokes
from twin.cli import main
from twin.identify.from_recording import machine_from_recording
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign
from twin.simulation.campaign_gap import gap
from twin.simulation.recorded_noise import with_recorded_noise

LAGS = {"X": 0.020, "Y": 0.012}


def table(path: Path, columns: Mapping[str, np.ndarray]) -> str:
    """A text file with these columns; returns its path."""
    np.savetxt(path, np.column_stack(list(columns.values())), "%.9f", ",", header=",".join(columns), comments="")
    return str(path)


def one_axis(path: Path, axis: str) -> str:
    """A file of strokes of one axis, whose name is in each heading."""
    trace = strokes(Planted(speeds=(0.1, 0.2), lag=LAGS[axis], lost=0.0, constant=0.0, position_noise=1e-9), 1).trace
    units = {"setpoint": (1e3, "cmd [mm]"), "position": (1e3, "act [mm]"), "current": (1.0, "current [A]")}
    return table(path, {"time [s]": trace.time, **{f"{axis} {name}": f * trace.get("X", s) for s, (f, name) in units.items()}})


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    seconds = np.arange(2000) * 5e-4
    other = table(folder / "other.csv", {"stamp": seconds, "Force [V]": np.sin(40.0 * seconds)})
    files = [one_axis(folder / f"{axis.lower()}.csv", axis) for axis in LAGS]
    assert main(["import", *files, other, "--out", str(folder / "campaign"), "--no-picture"]) == 0
    return folder / "campaign"


def test_each_file_is_a_run_of_its_axis(campaign: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The file of another recorder, whose time is no time of the axes, is left out."""
    runs = read_campaign(campaign).runs
    assert [(run.name, run.trace.axes) for run in runs] == [("x", ("X",)), ("y", ("Y",))]
    assert "stamp" not in (campaign / "map.toml").read_text(encoding="utf-8")


def test_files_without_any_column_of_the_map_are_refused(campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [table(tmp_path / f"{n}.csv", {"time [s]": np.arange(9.0), "a": np.arange(9.0)}) for n in (1, 2)]
    said = refused(capsys, "import", *files, "--map", str(campaign / "map.toml"), "--out", str(tmp_path / "out"))
    assert "none of the 2 files has a column of this map, such as 'X cmd'" in said


def test_one_machine_has_the_lag_of_each_axis(campaign: Path, tmp_path: Path) -> None:
    made = machine_from_recording(campaign, tmp_path / "m.toml", identified=False)
    assert all(one.gap < 0.02 * one.following for one in made.followed.values())
    machine = load_machine(tmp_path / "m.toml")
    assert machine.axis_names == ("X", "Y")
    for axis in machine.axes:
        lag = (1.0 - axis.loops.velocity_feedforward) / axis.loops.position_gain_per_s + axis.loops.position_delay_s
        assert lag == pytest.approx(LAGS[axis.name], abs=1e-3)
    gaps = gap(campaign, machine).runs
    assert {run: list(axes) for run, axes in gaps.items()} == {"x": ["X"], "y": ["Y"]}
    # a machine without a current loop; the current was measured all the same, and its noise does not depend on the gains, which are tried
    recorded, _ = with_recorded_noise(machine, read_campaign(campaign, machine).runs)
    assert recorded.noise(recorded.axis("X")).current == pytest.approx(Planted().current_noise, rel=0.1)
