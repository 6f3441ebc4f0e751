"""Files of a diagnosis, on a small campaign of the examination's plant; bad campaigns are refused with one line."""

from collections.abc import Iterator
import dataclasses
import json
import math
from pathlib import Path
import re
import shlex
import tomllib
from typing import Any

import numpy as np
import pytest

from examples.diagnose import record, short_runs
from tests.builders.recording_read import read_layout, read_recording
from tests.conftest import ROOT
from twin.cli import main
from twin.diagnose import diagnose, report
from twin.diagnose.check_campaign import notes_of
from twin.diagnose.next_measurement import Proposal
from twin.diagnose.output import summary_text, write_proposal
from twin.diagnose.report_figures import waterfall_figure
from twin.diagnose.wording import effect_title, interval_text, moves_text, parameters_of, times, verdict_sentence, where_text
from twin.effects import BLOCKS, EFFECTS, settings_of
from twin.exam.draw import draw_case
from twin.machine.machine import default_machine_path, load_machine
from twin.recordings.campaign import read_campaign
from twin.recordings.trace import Trace, read_trace, write_trace
from twin.replay.names import STEPS
from twin.units import plain

REGIMES = ("reversal", "acceleration", "constant speed", "rest", "all")


@pytest.fixture(scope="module")
def case() -> Any:
    table = tomllib.loads(default_machine_path().read_text(encoding="utf-8"))
    return draw_case(1, "single", table, effect="backlash", axis="X"), table


@pytest.fixture(scope="module")
def campaign(case: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two short runs of a machine with backlash in X; Y is recorded at rest."""
    folder = tmp_path_factory.mktemp("campaign")
    record(case[0], short_runs("X"), "XY", folder, case[1])
    return folder


@pytest.fixture(scope="module")
def diagnosed(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that `twin diagnose` wrote."""
    out = tmp_path_factory.mktemp("diagnosis") / "new folder"
    assert main(["diagnose", str(campaign), "--out", str(out), "--program", str(ROOT / "examples" / "x_200mm.csv")]) == 0
    return out


@pytest.fixture(scope="module")
def document(diagnosed: Path) -> dict[str, Any]:
    return json.loads((diagnosed / "diagnosis.json").read_text(encoding="utf-8"))


def entries(document: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield from document["effects"]
    yield from document["candidates"]


def test_keys_and_types(document: dict[str, Any]) -> None:
    assert document.keys() >= {"verdict", "effects", "candidates", "where", "gap", "ambiguous_with", "next_measurement", "notes"}
    assert document["verdict"] in ("effect", "none", "unknown")
    assert isinstance(document["next_measurement"], str)
    gap = document["gap"]
    assert min(gap["before"], gap["after"], gap["noise_floor"]) > 0.0
    assert set(gap["held_out_runs"]) == {"reversal", "acceleration"}
    assert set(gap["axes"]["X"]) == {"position", "motor_position", "velocity", "current"}
    for place in document["where"]:
        assert place["axis"] in "XY"
        assert place["block"] in BLOCKS
        assert 0.0 <= place["share"] <= 1.0
        assert place["regime"] in REGIMES
        assert isinstance(place["scales_with"], str)
        assert set(place["runs"]) <= {"reversal", "acceleration"}
    assert sum(place["share"] for place in document["where"]) == pytest.approx(1.0)


def test_effects_and_candidates_have_one_form(document: dict[str, Any]) -> None:
    for entry in entries(document):
        assert entry["effect"] in EFFECTS
        assert 0.0 <= entry["probability"] < 1.0
        assert 0.0 <= entry["explained"] <= 1.0
        assert entry["parameters"]
        for name, p in entry["parameters"].items():
            assert p.keys() == {"value", "low", "high", "unit"}
            assert all(math.isfinite(p[key]) for key in ("value", "low", "high"))
            if EFFECTS[entry["effect"]].parameter(name).periodic:
                assert 0.0 <= p["value"] < 2.0 * math.pi
            assert p["low"] <= p["value"] <= p["high"]


def test_effects_that_are_not_visible_are_listed(diagnosed: Path, document: dict[str, Any]) -> None:
    """Y is at rest and not diagnosed. A few effects on X are not visible in two short runs."""
    unseen = document["not_visible"]
    assert unseen
    for entry in unseen:
        assert entry["effect"] in EFFECTS
        assert entry["axis"] == "X"
        assert entry["usual_sizes"] is None or entry["usual_sizes"] > 1.0
        assert entry["effect"].replace("_", " ") in (diagnosed / "report.html").read_text(encoding="utf-8")
    assert any("axis Y does not move" in note for note in document["notes"])


def test_the_result_depends_on_the_seed_but_not_on_threads(campaign: Path, tmp_path: Path) -> None:
    machine = load_machine()
    folder = changed(campaign, tmp_path, lambda signals: {key: v for key, v in signals.items() if key[0] == "X"})
    read = read_campaign(folder, machine)

    def said(seed: int, threads: int) -> str:
        return json.dumps(diagnose(read, machine, quick=True, seed=seed, threads=threads).document())

    first = said(1, 1)
    assert said(1, 4) == first
    assert said(2, 4) != first


def test_the_budget_is_computed_for_a_program(diagnosed: Path, document: dict[str, Any], case: Any) -> None:
    """200 mm back and forth in X: at each reversal the scale on the load shows the backlash until the loop has crossed it."""
    on_program = document["budget_on_program"]
    assert (on_program["program"], on_program["unit"]) == ("x_200mm.csv", document["budget"]["unit"])
    (row,) = [r for r in on_program["rows"] if r["kind"] == "effect"]
    assert (row["effect"], row["axis"], row["run"]) == ("backlash", "X", "x_200mm.csv")
    assert 0.0 < row["tool_point"] < row["largest"] < 1e6 * case[0].effects[0]["clearance"]
    setpoint = read_trace(ROOT / "examples" / "x_200mm.csv", axes=load_machine().kinds, need=("setpoint",))
    assert len(row["at_mm"]) == 3
    assert 0.0 <= row["at_s"] <= setpoint.time[-1]
    assert "Gap budget on x_200mm.csv" in (diagnosed / "report.html").read_text(encoding="utf-8")


def test_every_number_is_plain_json(diagnosed: Path) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    json.loads((diagnosed / "diagnosis.json").read_text(encoding="utf-8"), parse_constant=refuse)


def test_the_hidden_effect_is_named(document: dict[str, Any], case: Any) -> None:
    hidden = case[0].effects[0]
    assert document["verdict"] == "effect"
    assert [(e["effect"], e["axis"]) for e in document["effects"]] == [("backlash", "X")]
    assert document["effects"][0]["parameters"]["clearance"]["value"] == pytest.approx(hidden["clearance"], rel=0.1)
    assert document["effects"][0]["explained"] > 0.95
    text = summary_text(document)
    assert "the corrected machine closes > 99 % of the gap of axis X" in text
    row = next(r for r in document["budget"]["rows"] if r["effect"] == "backlash")
    assert f"moves the tool point by {plain(row['tool_point'])} um RMS, at most {plain(row['largest'])} um; probability" in text
    assert (document["where"][0]["axis"], document["where"][0]["block"]) == ("X", "transmission")
    assert (document["candidates"][0]["effect"], document["candidates"][0]["axis"]) == ("backlash", "X")
    assert document["gap"]["after"] < document["gap"]["before"]


def test_corrected_machine_loads_and_holds_the_effects(diagnosed: Path, document: dict[str, Any]) -> None:
    machine = load_machine(diagnosed / "machine.toml")
    held = {(s.effect.name, s.axis): dict(s.parameters) for s in settings_of(machine)}
    normal = {(n["name"], n["axis"]) for n in document["normal"]}
    assert held.keys() - normal == {("backlash", "X")}
    assert held["backlash", "X"]["clearance"] == document["effects"][0]["parameters"]["clearance"]["value"]
    nominal = load_machine()
    for axis, other in zip(machine.axes, nominal.axes):
        assert axis.coulomb_friction == pytest.approx(other.coulomb_friction, rel=0.1)
        assert axis.motor.torque_constant_nm_per_a == pytest.approx(other.motor.torque_constant_nm_per_a, rel=0.1)


def test_next_measurement_of_an_earlier_diagnosis_is_deleted(tmp_path: Path) -> None:
    file = tmp_path / "next_measurement.csv"
    file.write_text("of another diagnosis", encoding="utf-8")
    write_proposal(Proposal("none needed", None), file)
    assert not file.exists()


def test_the_printed_command_can_be_given_where_it_is_printed(document: dict[str, Any], diagnosed: Path, tmp_path: Path) -> None:
    """From any folder, also one with a blank in its name."""
    command = shlex.split(document["next_measurement"].split("with: ")[1])
    assert command[0] == "twin"
    assert [Path(word).parent for word in command if word.endswith((".csv", ".toml"))] == [diagnosed, diagnosed]
    assert main([*command[1:], "--out", str(tmp_path / "run"), "--no-recording"]) == 0


def test_every_gap_of_the_report_is_one_number(document: dict[str, Any], diagnosed: Path) -> None:
    """Y rests throughout and creeps by more than its noise: it is not diagnosed, so that only X counts."""
    gap = document["gap"]
    assert gap["after"] < 1.4
    assert "from" in (page := (diagnosed / "report.html").read_text(encoding="utf-8"))
    assert f"to {times(gap['after'])} times the noise" in page
    for wrong in ("-0 %", "+0 %", "e-05", "e-06", "e+0"):
        assert wrong not in re.sub(r"src=\"data:[^\"]*\"", "", page)


def test_next_measurement_can_be_run(diagnosed: Path) -> None:
    trace = read_trace(diagnosed / "next_measurement.csv", axes=load_machine().kinds, need=("setpoint",))
    assert np.ptp(trace.get("X", "setpoint")) > 0


def test_report_states_the_verdict_and_is_self_contained(diagnosed: Path, document: dict[str, Any]) -> None:
    page = (diagnosed / "report.html").read_text(encoding="utf-8")
    assert "backlash on axis X" in re.search(r"<h1>(.*?)</h1>", page, re.S).group(1)
    value = parameters_of(document["effects"][0])[0]
    assert value["value"] in page
    assert value["interval"] in page
    for heading in ("What closes the gap", "Where it lies", "Before and after: axis X", "Gap by run", "Candidates", "What to do next"):
        assert heading in page
    sources = re.findall(r'(?:src|href)\s*=\s*"([^"]{0,30})', page)
    assert len(sources) >= 3
    assert all(source.startswith(("data:image/", "#s")) for source in sources)  # pictures in the page, and its own sections
    assert not re.search(r"https?://|@import|<script|<link", page)
    words = re.split(r"[^a-z]+", re.sub(r'base64,[^"]*', "", page).lower())
    assert not {"nan", "inf", "undefined"} & set(words)


def test_recording_reads_back_with_three_runs_and_the_stretch(diagnosed: Path) -> None:
    held = read_recording(diagnosed / "diagnosis.rrd")
    for label in ("measured", "nominal", "corrected"):
        assert any(label in path.split("/") or path.endswith(label) for path in held), (label, sorted(held))
    assert any(path.endswith("X/following_error/event_telling_stretch") for path in held)


def test_recording_has_the_residual_effect_by_effect(diagnosed: Path) -> None:
    held = read_recording(diagnosed / "diagnosis.rrd")
    steps = {path: held[path]["Scalars:scalars"] for path in sorted(held) if path.startswith(f"{STEPS}/")}
    assert [path.split("/")[-1].replace("\\", "") for path in steps] == ["00 machine file", "01 re-tuned", "02 + backlash on axis X"]
    levels = [float(np.std(rows.array)) for rows in steps.values()]
    assert levels[-1] < 0.2 * levels[0]


def test_recording_opens_on_the_telling_stretch(diagnosed: Path, document: dict[str, Any]) -> None:
    stretch = document["where"][0]["stretch"]
    (played,) = read_layout(diagnosed / "diagnosis.rrd")["/time_panel"]["TimePanelBlueprint:time_selection"].values[0]
    assert (played["min"], played["max"]) == pytest.approx((1e9 * stretch["from_s"], 1e9 * stretch["to_s"]))


def test_a_place_without_a_regressor_or_runs_is_said_without_them() -> None:
    place = {"axis": "X", "block": "mechanics", "regime": "all", "scales_with": "-", "runs": [], "share": 0.7}
    assert where_text(place) == "axis X, mechanics, all regimes, share 70 %"
    assert (
        where_text({**place, "scales_with": "sign v", "runs": ["a", "b", "c", "d"]})
        == "axis X, mechanics, all regimes, scales with sign v, share 70 % (a, b, c)"
    )
    document = {"effects": [], "verdict": "unknown", "where": [place]}
    assert verdict_sentence(document) == "Unknown: no known effect explains the gap in the mechanics of axis X."


def test_numbers_have_engineering_units() -> None:
    assert interval_text("m", 1.26e-5, 1.242e-5, 1.278e-5, EFFECTS["backlash"].size) == ("12.60 um", "12.42 to 12.78 um")
    assert interval_text("1", 1.12, 1.10, 1.14, EFFECTS["position_gain"].size) == ("+12.0 %", "+10.0 to +14.0 %")
    assert interval_text("s", 2.5e-4, 2.5e-4, 2.5e-4) == ("0.250 ms", "")
    assert interval_text("Nm/rad", 3.1e4, 0.0, 7.4e13)[1] == "not determined"
    assert interval_text("rad", *[4.85e-5] * 3)[0] == "10.0 arcsec"
    assert interval_text("1", 2e-5, 2e-5, 2e-5, EFFECTS["lead_error"].size)[0] == "20.0 um/m"
    assert effect_title({"effect": "cross_axis_coupling", "axis": "X", "from_axis": "Y"}) == "cross axis coupling on axis X from Y"


def test_a_quick_look_with_a_remaining_gap_is_not_decided() -> None:
    document = {"verdict": "unknown", "decided": False, "effects": [], "where": [], "gap": {"after": 31.0}}
    assert (
        verdict_sentence(document)
        == "Not decided: the quick look found no effect, but the gap is 31.0 times the noise; diagnose without --quick."
    )


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    code = main(["diagnose", *map(str, arguments)])
    err = capsys.readouterr().err
    assert code == 2, err
    assert err.startswith("twin: ")
    assert err.count("\n") == 1
    return err


def changed(campaign: Path, folder: Path, change: Any) -> Path:
    """A copy of the campaign's reversal run with changed signals."""
    trace = read_trace(campaign / "reversal.parquet", axes=load_machine().kinds)
    signals = change(dict(trace.signals))
    kinds = {axis: trace.kinds.get(axis, "linear") for axis, _ in signals}
    write_trace(Trace(trace.time, signals, kinds), folder / "reversal.parquet")
    (folder / "campaign.toml").write_text('machine = "mikron_ucp710"\n[[run]]\nfile = "reversal.parquet"\n', encoding="utf-8")
    return folder


def test_missing_folder(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert "no such file" in refused(capsys, tmp_path / "nowhere", "--out", tmp_path / "out")


def test_folder_without_campaign(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert "give a campaign or recordings" in refused(capsys, tmp_path, "--out", tmp_path / "out")


def test_set_points_outside_travel(capsys: pytest.CaptureFixture[str], campaign: Path, tmp_path: Path) -> None:
    folder = changed(
        campaign,
        tmp_path,
        lambda signals: {key: v + 0.5 if "position" in key[1] or key[1] == "setpoint" else v for key, v in signals.items()},
    )
    message = refused(capsys, folder, "--out", tmp_path / "out")
    assert "axis X" in message
    assert "travel" in message


def test_axis_that_the_machine_does_not_have(capsys: pytest.CaptureFixture[str], campaign: Path, tmp_path: Path) -> None:
    folder = changed(campaign, tmp_path, lambda signals: {("W" if axis == "Y" else axis, s): v for (axis, s), v in signals.items()})
    assert "unknown axis W" in refused(capsys, folder, "--out", tmp_path / "out")


def test_motion_that_does_not_follow_its_set_point(capsys: pytest.CaptureFixture[str], campaign: Path, tmp_path: Path) -> None:
    folder = changed(campaign, tmp_path, lambda signals: {key: -v if key == ("X", "position") else v for key, v in signals.items()})
    message = refused(capsys, folder, "--out", tmp_path / "out")
    assert "axis X" in message
    assert "set point" in message


def test_motor_that_does_not_follow_where_there_is_no_scale(capsys: pytest.CaptureFixture[str], campaign: Path, tmp_path: Path) -> None:
    def without_scale(signals: dict) -> dict:
        return {k: -v if k == ("X", "motor_position") else v for k, v in signals.items() if k[1] != "position"}

    message = refused(capsys, changed(campaign, tmp_path, without_scale), "--out", tmp_path / "out")
    assert "axis X" in message
    assert "set point" in message


def test_nothing_moves(capsys: pytest.CaptureFixture[str], campaign: Path, tmp_path: Path) -> None:
    folder = changed(campaign, tmp_path, lambda signals: {key: v for key, v in signals.items() if key[0] == "Y"})
    assert "no axis moves" in refused(capsys, folder, "--out", tmp_path / "out")


def test_a_signal_that_is_missing_is_noted_in_words(campaign: Path) -> None:
    machine = load_machine()
    read = read_campaign(campaign, machine)
    trace = read.runs[0].trace.select(["X", "Y"])
    kept = {key: values for key, values in trace.signals.items() if key[1] in ("setpoint", "position")}
    two = dataclasses.replace(read.runs[0], trace=dataclasses.replace(trace, signals=kept))
    notes = notes_of(dataclasses.replace(read, runs=(two,)), machine)
    assert "no velocity set point of axes X and Y: the position controller cannot be separated from the speed controller" in notes


def test_another_machine_by_name_is_noted(campaign: Path) -> None:
    machine = load_machine()
    read = read_campaign(campaign, machine)
    assert not any("names machine" in note for note in notes_of(read, machine))
    other = dataclasses.replace(read, machine_name="DMU 50")
    assert "campaign.toml names machine DMU 50, it is compared with Mikron UCP 710" in notes_of(other, machine)


def test_seed_that_is_no_number(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["diagnose", str(tmp_path), "--out", str(tmp_path / "out"), "--seed", "x"])
    assert stopped.value.code == 2
    assert "'x': give a whole number, 0 or more" in capsys.readouterr().err


def test_nothing_measured(capsys: pytest.CaptureFixture[str], campaign: Path, tmp_path: Path) -> None:
    folder = changed(campaign, tmp_path, lambda signals: {key: v for key, v in signals.items() if key[1] == "setpoint"})
    assert "position" in refused(capsys, folder, "--out", tmp_path / "out")


def test_machine_that_already_has_effects(capsys: pytest.CaptureFixture[str], campaign: Path, diagnosed: Path, tmp_path: Path) -> None:
    message = refused(capsys, campaign, "--machine", diagnosed / "machine.toml", "--out", tmp_path / "out")
    assert "effects" in message


def test_place_that_cannot_be_written(capsys: pytest.CaptureFixture[str], campaign: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    assert "--out" in refused(capsys, campaign, "--out", tmp_path / "file" / "out")


def test_a_deviation_that_rounds_to_nothing_has_no_sign() -> None:
    assert [report._signed_percent(x) for x in (-1e-6, 0.0, 0.012345, -0.2, None)] == ["0.00 %", "0.00 %", "+1.23 %", "-20.00 %", ""]


def test_a_step_that_changes_next_to_nothing_is_not_said_to_add_to_the_gap() -> None:
    steps = [
        ("machine file", 100.0),
        ("re-tuned within tolerance", 100.001),
        ("backlash on axis X", 110.0),
        ("position gain on axis Y", 1.0),
    ]
    said = [text.get_text() for text in waterfall_figure(steps).axes[0].texts]
    assert said[-3:] == ["0 %", "+21 %", "121 %"]


@pytest.mark.parametrize(("after", "bars"), [(0.91, 1), (0.6, 3)])
def test_where_nothing_is_closed_there_is_one_bar(after: float, bars: int) -> None:
    """A corrected machine beside a machine file that agrees would be the same bar again."""
    (axes,) = waterfall_figure([("machine file", 0.909), ("re-tuned within tolerance", after)]).axes
    assert len(axes.patches) == len(axes.get_xticks()) == bars


def test_contributions_that_are_too_small_are_counted_above_the_table() -> None:
    """In a row of the table their sentence would be squeezed into its first column."""
    row = {"effect": "backlash", "axis": "X", "kind": "effect", "tool_point": 1.0, "alone": 1.0, "largest": 2.0, "run": "a", "at_s": 0.0, "at_mm": [0.0],
           "position": 1.0, "position_unit": "um", "current": 0.1, "times_noise": 9.0, "probability": 0.9, "low": 0.9, "high": 1.1}  # fmt: skip
    small = {**row, "kind": "re-tuned", "tool_point": 0.004, "times_noise": 0.01}
    budget = {"rows": [row, small, small], "before": 1.0, "after": 0.1, "floor": 0.1, "unexplained": []}
    (table,) = report._budget("Budget", budget, at_tool=False).tables
    assert len(table.rows) == 1
    assert table.caption == "2 more, each below a tenth of the noise, move the tool by up to 0.00400 um: diagnosis.json."


def test_a_contribution_says_what_it_moves() -> None:
    row = {"tool_point": 0.0, "largest": 0.0, "position": 0.0, "position_unit": "um"}
    assert moves_text(row) == "does not move the tool point"
    assert moves_text({**row, "position": 3.0}) == "moves its axis by 3.00 um RMS, but not the tool point"
    assert moves_text({**row, "tool_point": 1.25, "largest": 3.4}) == "moves the tool point by 1.25 um RMS, at most 3.40 um"


def test_the_table_of_places_has_no_empty_column() -> None:
    """A single run recorded by two scales shows no level, no band and no interval."""
    place = {"axis": "Y", "block": "transmission", "share": 0.51, "regime": "all", "scales_with": "-", "runs": []}
    (table,) = report._places({"where": [place]}).tables
    assert list(table.heading) == ["axis", "block", "share", "regime"]
    assert table.rows == [("Y", "transmission", "51 %", "all")]
    (table,) = report._places({"where": [{**place, "runs": ["circle_xy"], "band_hz": [0.25, 228.4]}]}).tables
    assert list(table.heading) == ["axis", "block", "share", "regime", "band", "runs"]
    assert table.rows[0][4:] == ("0.25 to 228 Hz", "circle xy")
    assert table.words == {3, 4, 5}
