"""examples/emps as a whole: on the measured axis if its recording is available, and on a simulated recording."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
import re
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from examples.emps.single_axis import fit_single_axis
from tests.builders.script import carried_out, script
from tests.conftest import ROOT, SHARED
from twin.diagnose.tolerance import with_added
from twin.effects import check_setting
from twin.machine.machine import Machine, load_machine
from twin.simulation.gap import SignalGap
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

CONTROL = ("position controller", "speed controller")
RECORD = SHARED / "data" / "emps" / "DATA_EMPS.mat"
PLANTED = {"viscous_asymmetry": {"fraction": -0.19}, "torque_ripple": {"amplitude_nm": 4e-4, "periods_per_rev": 1.0}}


@pytest.fixture(scope="module")
def example() -> ModuleType:
    """The example's script as a module."""
    return script("examples/emps/run.py", "emps_example")


def gaps_on_last_third(example: ModuleType, out: Path, machines: dict[str, Machine]) -> dict[str, dict[str, SignalGap]]:
    """Gap of X on the last third of the recording, by machine and signal."""
    run, predictions = example.last_third(out, machines)
    return {name: example.gap_of(machines[name], run, p)["X"] for name, p in predictions.items()}


def control_is_not_blamed(document: dict[str, Any]) -> None:
    """No place, no effect, and no candidate with an influence on the gap is in a controller."""
    assert not [p for p in document["where"] if p["block"] in CONTROL]
    assert not [e for e in document["effects"] if e["block"] in CONTROL]
    alone = {c["effect"]: c["explained"] for c in document["candidates"] if "beside" not in c}
    asked = ("position_gain", "speed_gain", "loop_delay", "set_point_filter", "current_filter")
    assert document["where"]
    assert alone
    assert all(alone.get(name, 0.0) < 0.05 for name in asked)  # candidates without influence are not listed


def at_low_speed(law: dict[str, Any]) -> float:
    """Friction [N] of a law over the speed at its lowest speed, less that at its highest: the height of a formula, or the ends of a table."""
    if "points" in law:
        return float(law["points"][0][1] - law["points"][-1][1])
    return float(law["parameters"].get("height", {"value": 0.0})["value"])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, example: ModuleType) -> Path:
    """A recording like the measured one, simulated with planted effects: three speeds there and back, 24.84 s."""
    machine = load_machine(example.MACHINE)
    settings = [check_setting({"name": n, "axis": "X", **p}, machine, "planted") for n, p in PLANTED.items()]
    times = [0.0, 0.05, 0.45, 0.5, 0.6, 1.25, 1.35, 1.4, 1.55, 2.6, 2.75, 2.8, 2.85, 3.02, 3.07, 3.12]
    speeds = [0.0, 0.042, 0.042, 0.0, 0.083, 0.083, 0.0, 0.0, 0.125, 0.125, 0.0, 0.0, 0.042, 0.042, 0.0, 0.0]
    t = np.arange(24_841) * 1e-3
    speed = np.interp(t % 3.12, times, speeds) * np.where(t % 6.24 < 3.12, 1.0, -1.0)
    setpoint = np.cumsum(speed) * 1e-3
    trace = simulate(with_added(machine, settings), Setpoints(setpoint[:, None], 1e-3), noise_seed=1).trace
    count = len(setpoint)
    columns = {
        "t": t,
        "qg": setpoint,
        "qm": trace.get("X", "motor_position")[:count],
        "vir": trace.get("X", "voltage")[:count],
    }
    path = tmp_path_factory.mktemp("emps") / "DATA_EMPS.mat"
    savemat(path, {**{k: v[:, None] for k, v in columns.items()}, "kp": 160.18, "kv": 243.45, "gtau": 35.15065})
    return path


def test_planted_effects_are_found_largest_first(example: ModuleType, made: Path, tmp_path: Path) -> None:
    example.import_record(made, tmp_path, picture=False)
    document = example.diagnosed(tmp_path, quick=True)
    gaps = gaps_on_last_third(example, tmp_path, {"file": load_machine(example.MACHINE), "corrected": example.corrected(tmp_path)})
    found = {e["effect"]: e["parameters"] for e in document["effects"]}
    assert set(found) == set(PLANTED)
    assert found["viscous_asymmetry"]["fraction"]["value"] == pytest.approx(-0.19, rel=0.03)
    assert found["torque_ripple"]["amplitude_nm"]["value"] == pytest.approx(4e-4, rel=0.05)
    assert found["torque_ripple"]["periods_per_rev"]["value"] == pytest.approx(1.0, rel=1e-3)
    control_is_not_blamed(document)
    assert gaps["corrected"]["motor_position"].rms < 0.1 * gaps["file"]["motor_position"].rms
    text = example.order_text(document)
    assert text.index("viscous asymmetry") < text.index("torque ripple") < text.index("unexplained")


def test_a_second_opinion_by_regression(example: ModuleType, made: Path) -> None:
    record = example.read_emps(made)
    assert np.sqrt(np.mean(example.law_error(record) ** 2)) < 4e-3
    text = example.force_text(record)
    assert text.index("viscous friction by direction") < text.index("once a motor turn")


def test_a_wrong_path_is_one_line(example: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert example.main([str(tmp_path / "nowhere.mat"), "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.fixture(scope="module")
def measured(example: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The measured recording by the command of the page: folder and diagnosis."""
    if not RECORD.is_file():
        pytest.skip("no measured axis: ../shared/data/emps is not beside this repository")
    out = tmp_path_factory.mktemp("measured")
    with contextlib.redirect_stdout(io.StringIO()):
        carried_out("examples/emps/run.py", RECORD, "--out", out)
    return out, json.loads((out / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_the_measured_axis(example: ModuleType, measured: tuple[Path, dict[str, Any]]) -> None:
    """Effects, sizes and gap of the measured recording."""
    out, document = measured
    machines = {"file": load_machine(example.MACHINE), "published": example.published(), "corrected": example.corrected(out)}
    gaps = gaps_on_last_third(example, out, machines)
    assert document["effects"][0]["effect"] == "viscous_asymmetry"
    assert -0.25 < document["effects"][0]["parameters"]["fraction"]["value"] < -0.13
    control_is_not_blamed(document)
    assert np.sqrt(np.mean(example.law_error(example.read_emps(RECORD)) ** 2)) < 4.5e-3
    position = {name: gap["motor_position"].rms for name, gap in gaps.items()}
    assert position["corrected"] < 0.5 * position["file"]
    assert position["corrected"] < 0.5 * position["published"]


def number_in(page: str, words: str) -> float:
    """The number at the place of # in these words of the page."""
    before, after = words.split("#")
    (number,) = re.findall(f"{re.escape(before)}(-?[0-9.]+){re.escape(after)}", page)
    return float(number)


@pytest.mark.slow
def test_the_page_has_the_numbers_of_the_current_code(example: ModuleType, measured: tuple[Path, dict[str, Any]]) -> None:
    """docs/measured_axis.md: law, identification, diagnosis, gap on the last third, regression."""
    page = " ".join((ROOT / "docs" / "measured_axis.md").read_text(encoding="utf-8").split())
    (out, document), record = measured, example.read_emps(RECORD)
    axis = example.identified(out).axis("X")
    machines = {"start": load_machine(example.MACHINE), "published": example.published()}
    machines |= {"identified": example.identified(out), "corrected": example.corrected(out)}
    rows = {
        name: f"| {gap['motor_position'].rms:.2f} um | {gap['voltage'].rms:.3f} V | {gap['motor_position'].max:.1f} um |"
        for name, gap in gaps_on_last_third(example, out, machines).items()
    }
    said = [
        f"{np.sqrt(np.mean(example.law_error(record) ** 2)) * 1e3:.1f} mV RMS",
        f"inertia {axis.moving_mass_kg + axis.reflected_inertia:.1f} kg",
        f"Coulomb friction {axis.coulomb_friction:.1f} N",
        f"viscous friction {axis.viscous_friction:.0f} N s/m",
        f"constant force {axis.constant_force:.2f} N",
        f"start of the diagnosis {rows['start']}",
        f"published, with its offset of {example.PUBLISHED_OFFSET_N} N {rows['published']}",
        f"identified from the first two thirds {rows['identified']}",
        f"error is {100 * fit_single_axis(record).force_error:.2f} %; the published model's is {100 * example.PUBLISHED_FORCE_ERROR:.2f} %",
    ]
    assert [words for words in said if words not in page] == []
    # the axis lies between two fits, as the page says: other rounding errors give other laws, and these numbers move by this much
    found = {e["effect"]: e["parameters"] for e in document["effects"]}
    corrected = gaps_on_last_third(example, out, machines)["corrected"]
    for words, value, relative in (
        ("corrected by the diagnosis | # um |", corrected["motor_position"].rms, 0.15),
        ("differs by direction | # % (", -100.0 * found["viscous_asymmetry"]["fraction"]["value"], 0.15),
        ("once a motor turn | # mNm (", 1e3 * found["torque_ripple"]["amplitude_nm"]["value"], 0.4),
        ("remaining gap is # times the noise", document["gap"]["after"], 0.25),
        ("noise of the record, # times before", document["gap"]["before"], 0.05),
    ):
        assert value == pytest.approx(number_in(page, words), rel=relative), words
    assert document["verdict"] in ("law", "unknown")
    assert any(law["variables"] == ["speed"] and at_low_speed(law) < 0.0 for law in document["laws"])
    text = example.force_text(record)
    for shape in ("viscous friction by direction", "once a motor turn", "none of these"):
        share = next(line for line in text.splitlines() if line.startswith(shape)).split()[-2]
        assert f"{shape} {share} %" in page, shape
