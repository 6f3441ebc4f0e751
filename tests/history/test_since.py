"""`twin diagnose --since`: what changed and nothing else, also where it became less; what the twin lacks in both is no news."""

from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path
import re
import shutil
from types import SimpleNamespace

import jsonschema
import numpy as np
import pyarrow.parquet as pq
import pytest

from devtools.histories import Fault, History, draw_history, machine_tables, program, write_week
from tests.conftest import ROOT
from twin import load_machine, write_machine
from twin.cli.parser import main
from twin.diagnose.settings import T
from twin.effects import settings_of
from twin.effects.change import add_effects
from twin.geometry.scurve import moves_in_turn
from twin.history.columns import changed, directions_of
from twin.history.contrast import Contrast
from twin.history.since import _probability
from twin.history.since_output import ShownChange, change_figure, write_since
from twin.machine.machine import Machine, default_machine_path
from twin.recordings.trace import Trace, write_trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

QUIET = ("kelvin", "scatter", "tool_kg", "workpiece_kg")


def everyday() -> History:
    """A machine with a small error of every kind on every axis, none of which the twin knows, and nothing that varies."""
    drawn = draw_history(1, 6, faulty=False)
    return replace(drawn, **{name: 0.0 * getattr(drawn, name) for name in QUIET})


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Baseline, the same machine again, then with other friction on Y and another gain on C."""
    folder, run = tmp_path_factory.mktemp("campaigns"), program(machine_tables(), 3.0)
    changes = [
        None,
        None,
        {"name": "coulomb_friction", "axis": "Y", "factor": 0.88},
        {"name": "position_gain", "axis": "C", "factor": 0.95},
    ]
    return [
        write_week(replace(everyday(), fault=change and Fault(change, 0, 0)), week, folder, run=run) for week, change in enumerate(changes)
    ]


def since(campaigns: list[Path], number: int, reference: Path, out: Path) -> dict:
    assert main(["diagnose", str(campaigns[number]), "--since", str(campaigns[0]), "--machine", str(reference), "--out", str(out)]) == 0
    document = json.loads((out / "diagnosis.json").read_text())
    jsonschema.validate(document, json.loads((ROOT / "twin" / "report" / "schemas" / "diagnosis.json").read_text()))
    return document


@pytest.mark.parametrize(("effects", "least"), [((), 0.0), (("backlash:X:clearance=12e-6",), -12e-6)])
def test_no_machine_has_less_than_no_backlash(mikron: Machine, effects: tuple[str, ...], least: float) -> None:
    """Less of it than the machine has was simulated as none, and could still be named with a size."""
    directions = [
        d for d in directions_of(add_effects(mikron, *effects), ("X",)) if d.cause[0] in ("backlash", "coulomb_friction", "cyclic_error")
    ]
    eye, none = np.eye(len(directions))[None], np.zeros((1, len(directions)))
    contrast = Contrast(directions, [], [eye], [none], ["X position"], np.zeros(len(directions)), 1.0, [])
    zero = np.zeros(len(directions))
    for k, direction in enumerate(directions):
        possible = [contrast.is_possible(zero, size * (np.arange(len(directions)) == k)[None], [], [k]) for size in (0.3, -0.3, -9.0)]
        backlash = direction.cause[0] == "backlash"
        assert possible == ([True, bool(effects), False] if backlash else [True, True, direction.cause[0] == "cyclic_error"])
        assert not backlash or direction.least * direction.unit == pytest.approx(least)


def test_a_cause_below_what_none_explains_is_no_more_than_even(mikron: Machine) -> None:
    """Beside a mass 25 % larger, of an axis with a tried control, a speed gain that nobody had changed stood with 0.98."""
    directions = directions_of(mikron, ("X",))[:4]
    eye, none = np.eye(4)[None], np.zeros((1, 4))
    contrast = Contrast(directions, [], [eye], [none], ["X position"], np.zeros(4), 1.0, [])
    left = np.full((1, 4), 6.0)
    found = [_probability(contrast, rest, np.full((1, 1, 4), own), 0.0) for rest, own in ((left, 5.0), (left, 7.0), (0.2 * left, 0.9))]
    assert found == [0.5, T.confidence, T.confidence]


@pytest.fixture
def reference(tmp_path: Path, mikron: Machine) -> Path:
    """A machine that a diagnosis of the baseline may have left: one effect of the many."""
    write_machine(add_effects(mikron, "stribeck:X:excess=60,velocity=0.003"), tmp_path / "reference.toml")
    return tmp_path / "reference.toml"


def test_the_same_machine_is_no_news(campaigns: list[Path], reference: Path, tmp_path: Path) -> None:
    document = since(campaigns, 1, reference, tmp_path / "out")
    assert (document["verdict"], document["effects"]) == ("none", [])
    assert document["since"] == [campaigns[0].name]


@pytest.mark.parametrize(("left", "said"), [(40.0, True), (1.1, False)])
def test_a_baseline_that_its_machine_does_not_explain_is_said(
    campaigns: list[Path],
    reference: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    left: float,
    said: bool,
) -> None:
    """Compared with a machine file that is not that of the machine, 20 % more friction was 16 % with a narrow interval, and nothing besides."""
    baseline = SimpleNamespace(verdict="unknown", corrected=load_machine(reference))
    monkeypatch.setattr("twin.history.since_output.diagnose", lambda *_, **__: baseline)
    monkeypatch.setattr("twin.history.since_output.write_diagnosis", lambda *_: {"gap": {"after": left}})
    document = since(campaigns, 1, default_machine_path(), tmp_path / "out")
    assert any("leaves 40.0 times the noise" in note and "machine new --from-recording" in note for note in document["notes"]) is said
    assert ("leaves 40.0 times the noise" in capsys.readouterr().out) is said


@pytest.mark.parametrize(("number", "effect", "axis", "factor"), [(2, "coulomb_friction", "Y", 0.88), (3, "position_gain", "C", 0.95)])
def test_a_change_is_named_and_sized(
    campaigns: list[Path],
    reference: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    number: int,
    effect: str,
    axis: str,
    factor: float,
) -> None:
    drawn: list[ShownChange] = []
    monkeypatch.setattr("twin.history.since_output.change_figure", lambda shown: drawn.append(shown) or change_figure(shown))
    document = since(campaigns, number, reference, tmp_path / "out")
    assert document["verdict"] == "effect"
    (found,) = document["effects"]
    assert (found["effect"], found["axis"]) == (effect, axis)
    assert found["parameters"]["factor"]["value"] - 1.0 == pytest.approx(factor - 1.0, rel=0.15)
    assert f"{document['effects'][0]['axis']} " in document["sentence"]
    assert "less" in document["sentence"]
    today = {s.key: s for s in settings_of(load_machine(tmp_path / "out" / "machine.toml"))}
    assert today[effect, axis, None].parameters["factor"] == pytest.approx(factor, abs=0.02)
    assert document["gap"]["after"] < document["gap"]["before"]
    assert document["budget"]["rows"][0]["effect"] == effect
    assert not [note for note in document["notes"] if "only tried" in note]
    (shown,) = drawn
    assert (shown.axis, shown.run) == (axis, document["where"][0]["runs"][0])
    recorded = shown.now - shown.then
    assert np.corrcoef(recorded, shown.twin)[0, 1] > 0.7  # a gain of 5 % moves hardly more than noise
    assert shown.caption in (tmp_path / "out" / "report.html").read_text()


def test_a_size_on_an_axis_whose_control_is_only_tried_has_its_warning(campaigns: list[Path], reference: Path, tmp_path: Path) -> None:
    """Of a PD drive with a tried control, 40 % more friction was 41.9 % with an interval of 1.1 %."""
    head, _, tail = reference.read_text(encoding="utf-8").partition("[axis.Y.loops]")
    text = re.sub(r"(position_gain_per_s = \S+)", r"\1  # tried", tail, count=1)
    reference.write_text(f"{head}[axis.Y.loops]{text}", encoding="utf-8")
    notes = since(campaigns, 2, reference, tmp_path / "out")["notes"]
    assert [note for note in notes if note.startswith("axis Y: numbers of the control are only tried") and "more than its interval" in note]


def test_runs_that_are_left_out_confirm_a_change(campaigns: list[Path], reference: Path, tmp_path: Path) -> None:
    """Two runs a campaign: each is predicted from the other, and the difference that is left is that of repetitions."""

    def joined(name: str, *numbers: int) -> Path:
        (tmp_path / name).mkdir()
        for i, number in enumerate(numbers):
            shutil.copy(campaigns[number] / "production.parquet", tmp_path / name / f"run_{i}.parquet")
        runs = [f'[[run]]\nfile = "run_{i}.parquet"\nfeedforward = "velocity+torque"\n' for i in range(len(numbers))]
        (tmp_path / name / "campaign.toml").write_text("\n".join(runs))
        return tmp_path / name

    document = since([joined("then", 0, 1), joined("now", 2, 2)], 1, reference, tmp_path / "out")
    assert document["verdict"] == "effect"
    assert [(e["effect"], e["axis"]) for e in document["effects"]] == [("coulomb_friction", "Y")]
    assert document["gap"]["held_out_runs"] == ["run_0", "run_1"]
    assert document["gap"]["after"] < 1.5 < document["gap"]["before"]


def test_a_run_may_lack_a_signal_that_others_have(campaigns: list[Path], reference: Path, tmp_path: Path) -> None:
    """What only one of two recordings of a program shows is not compared; the rest is."""
    for name, number in (("then", 0), ("now", 2)):
        (tmp_path / name).mkdir()
        recorded = pq.read_table(campaigns[number] / "production.parquet")
        pq.write_table(recorded, tmp_path / name / "run_0.parquet")
        lost = "motor_position" if name == "now" else "velocity ["
        pq.write_table(recorded.select([c for c in recorded.column_names if lost not in c]), tmp_path / name / "run_1.parquet")
        runs = [f'[[run]]\nfile = "run_{i}.parquet"\nfeedforward = "velocity+torque"\n' for i in range(2)]
        (tmp_path / name / "campaign.toml").write_text("\n".join(runs))
    document = since([tmp_path / "then", tmp_path / "now"], 1, reference, tmp_path / "out")
    assert [(e["effect"], e["axis"]) for e in document["effects"]] == [("coulomb_friction", "Y")]


def test_what_is_no_campaign_is_one_line(campaigns: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diagnose", str(campaigns[0]), "--since", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "--since compares campaigns" in said
    assert said.count("\n") == 1
    assert main(["diagnose", str(campaigns[0]), "--since", str(tmp_path / "mistyped"), "--out", str(tmp_path / "out")]) == 2
    assert "mistyped: no such folder; give a campaign\n" in capsys.readouterr().err


def test_changes_add_up_with_the_effects_of_the_machine(mikron: Machine) -> None:
    """Factors multiply, amounts add, compliances add, waves add as phasors; what falls to nothing goes."""
    machine = add_effects(
        mikron,
        "coulomb_friction:X:factor=1.2",
        "backlash:X:clearance=10um",
        "presliding:Y:stiffness=4e7",
        "cyclic_error:Z:amplitude=3e-6,phase_rad=0",
    )
    of = {(d.setting.effect.name, d.setting.axis, d.phase): d for axis in "XYZ" for d in directions_of(machine, (axis,))}

    def after(*changes: tuple[tuple[str, str, int], float]) -> dict:
        return {s.key[:2]: s.parameters for s in settings_of(changed(machine, [(of[key], theta) for key, theta in changes]))}

    friction, play, spring, wave = (
        of[key] for key in [("coulomb_friction", "X", 0), ("backlash", "X", 0), ("presliding", "Y", 0), ("cyclic_error", "Z", 1)]
    )
    assert after((("coulomb_friction", "X", 0), -0.1 / friction.unit))["coulomb_friction", "X"]["factor"] == pytest.approx(1.08)
    assert after((("backlash", "X", 0), 4e-6 / play.unit))["backlash", "X"]["clearance"] == pytest.approx(14e-6)
    assert after((("presliding", "Y", 0), spring.unit / 4e7))["presliding", "Y"]["stiffness"] == pytest.approx(2e7)
    assert after((("cyclic_error", "Z", 1), 4e-6 / wave.unit))["cyclic_error", "Z"]["amplitude"] == pytest.approx(5e-6)
    assert ("backlash", "X") not in after((("backlash", "X", 0), -1.0))


def test_couplings_that_do_not_show_are_named_with_both_axes(mikron: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One axis couples with several others: without them one line stood on the page twice."""
    monkeypatch.setattr("twin.history.since_output.write_json", lambda *_: None)
    coupling = {"effect": "cross_axis_coupling", "axis": "Z"}
    document = {
        "gap": {"before": 1.0, "after": 1.0, "held_out_runs": []}, "budget": {"rows": []}, "effects": [], "ambiguous_with": [], "notes": [],
        "not_visible": [{**coupling, "from_axis": "X"}, {**coupling, "from_axis": "Y"}], "since": ["may"], "sentence": "No change.",
    }  # fmt: skip
    write_since(document, mikron, [], tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "<li>cross axis coupling on Z from X</li>" in page
    assert "<li>cross axis coupling on Z from Y</li>" in page


def test_a_machine_that_no_file_describes(mikron: Machine, tmp_path: Path) -> None:
    """Its machine is made from the baseline: a slide U of position and current every 1 ms, whose speed gain then falls by a fifth."""
    way = moves_in_turn(0.0, [0.06, -0.06, 0.03, -0.03, 0.01, -0.01], 0.1, 2.0, 40.0, 0.1, 1e-3)[1]
    slide = mikron.with_axes(["X"])
    softer = slide.with_axis("X", speed_gain_nm_s_per_rad=0.8 * slide.axis("X").loops.speed_gain_nm_s_per_rad)
    for name, machine, seed in (("then", slide, 1), ("now", softer, 2)):
        trace = simulate(machine, Setpoints(way[:, None], 1e-3), noise_seed=seed).trace
        kept = ("setpoint", "velocity_setpoint", "position", "velocity", "current")
        write_trace(Trace(trace.time, {("U", s): trace.get("X", s) for s in kept}, {"U": "linear"}), tmp_path / name / "run.parquet")
        (tmp_path / name / "campaign.toml").write_text('[[run]]\nfile = "run.parquet"\nfeedforward = "velocity+torque"\n', encoding="utf-8")
    assert main(["diagnose", str(tmp_path / "now"), "--since", str(tmp_path / "then"), "--out", str(tmp_path / "out")]) == 0
    document = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    (found,) = document["effects"]
    assert (found["effect"], found["axis"]) == ("speed_gain", "U")
    factor = found["parameters"]["factor"]
    assert factor["value"] == pytest.approx(0.8, abs=0.03)
    assert factor["low"] < 0.8 < factor["high"]
