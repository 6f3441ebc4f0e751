"""Suites, golden results and verdicts of `twin regress`: bad input and machine-readable output."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
from textwrap import dedent
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.builders.other_structures import write_slides
from tests.builders.refused import refused
from tests.builders.small_machine import write_small_machine
from tests.conftest import ROOT
from twin.cli import main
from twin.cli.regress import _is_smaller
from twin.effects import EFFECTS
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.regress import run_suite
from twin.regress.compare import Check, compare
from twin.regress.golden import Feature, Golden, Outcome, read_golden
from twin.regress.runners import machine_of, run_case
from twin.regress.suite import COMPARED, SIGNAL_UNITS, Case, read_suite
from twin.simulation.gap import gap_unit

HERE = Path(__file__).resolve().parents[2]
SHIPPED = read_suite(HERE / "examples/regression")
TOLERANCES = "".join(
    f'[tolerance.{signal}]\nrms = 0.005\nmax = 0.05\nunit = "{unit}"\nreason = "a tenth of the noise"\n'
    for signal, unit in zip(COMPARED, ("um, arcsec", "um, arcsec", "mm/s, deg/s", "A"))
) + (
    '[tolerance.summary]\nrelative = 1e-3\nabsolute = 1e-3\nreason = "a thousandth"\n'
    '[tolerance.events]\ntime_s = 0.002\nreason = "one position cycle"\n'
)
CASE = 'kind = "run"\nname = "u_move"\nmachine = "small.toml"\naxes = ["U"]\nmoves.U = { distances_mm = [10.0, -10.0], speed_mm_per_s = 100.0 }\n'


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    """A suite of one case with its golden result."""
    write_small_machine(tmp_path)
    (tmp_path / "suite").mkdir()
    for file in ("small.toml", "small.xml"):
        (tmp_path / file).rename(tmp_path / "suite" / file)
    folder = tmp_path / "suite" / "cases"
    folder.mkdir()
    (folder / "moves.toml").write_text(CASE.replace('"small.toml"', '"../small.toml"') + TOLERANCES)
    assert regress(folder, tmp_path, "--update", "--reason", "first results") == 0
    return folder


def regress(folder: Path, out: Path, *more: str) -> int:
    update = [] if "--update" in more else ["--out", str(out / "out")]
    return main(["regress", str(folder), "--jobs", "1", *update, *more])


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


def one_line(capsys: pytest.CaptureFixture[str], *words: str) -> None:
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1, told
    for word in ("twin:", *words):
        assert word in told[0]


def test_a_machine_that_did_not_change_passes(suite: Path, tmp_path: Path) -> None:
    assert regress(suite, tmp_path) == 0
    assert json.loads((tmp_path / "out" / "regress.json").read_text())["verdict"] == "passed"
    assert not (tmp_path / "out" / "u_move").exists()


def moved(golden: Golden, case: Case) -> Golden:
    """Golden results that differ in one sample of a signal, in one number or word, or in one event."""
    trace, features = golden.trace, {}
    if trace is not None:
        machine, signals = machine_of(case), dict(trace.signals)
        for axis, signal in ((a, s) for a in trace.axes for s in case.compared):
            to_si = {"A": 1.0, "mm/s, deg/s": 1e-3, "um, arcsec": 1e-6}[case.tolerance[signal]["unit"]]
            if machine.axis(axis).kind == "rotary":
                to_si = {1.0: 1.0, 1e-3: np.pi / 180.0, 1e-6: np.pi / 180.0 / 3600.0}[to_si]
            values = signals[axis, signal].copy()
            values[len(values) // 2] += 1.01 * to_si * case.tolerance[signal]["max"]
            signals[axis, signal] = values
        trace = Trace(trace.time, signals, trace.kinds)
    kept = {(e.kind, e.axis): e for e in golden.events}
    for name, feature in golden.features.items():
        if isinstance(feature.value, str):
            features[name] = replace(feature, value=feature.value + "?")
        elif case.kind == "campaign":
            share = case.tolerance["gap"]
            features[name] = replace(
                feature, value=(feature.value - 1.01 * share["above_noise"] * feature.noise) / (1.0 + 1.01 * share["growth"])
            )
        else:
            share = case.tolerance["parameters" if case.kind in ("identify", "diagnose") else "summary"]
            allowed = share.get("absolute", 0.0) + share["relative"] * abs(feature.value) + share.get("of_interval", 0.0) * feature.noise
            features[name] = replace(feature, value=feature.value + 1.2 * allowed)
    return replace(golden, trace=trace, features=features, events=tuple(e for e in golden.events if e not in kept.values()))


@pytest.mark.parametrize("case", SHIPPED, ids=lambda case: case.name)
def test_every_kept_number_is_guarded(case: Case) -> None:
    """A result passes against itself; each signal, number, word and event fails when moved just beyond its tolerance."""
    golden = read_golden(case)
    now = Outcome(golden.features, golden.trace, golden.events, machine_of(case))
    same, checks = compare(case, golden, now), compare(case, moved(golden, case), now)
    assert all(check.ok for check in same)
    assert {c.quantity for c in same} or case.kind == "campaign"
    passed = {check.quantity for check in checks if check.ok}
    assert passed <= {"duration"} | {c.quantity for c in same if c.quantity.endswith("RMS")}


def alone(golden: Golden, case: Case) -> Iterator[tuple[str, Outcome]]:
    """Outcomes that differ in one respect, with the ending of the check that must fail."""
    machine, trace = machine_of(case), golden.trace
    assert trace is not None

    def outcome(now: Trace, events: tuple) -> Outcome:
        return Outcome(golden.features, now, events, machine)

    short = trace.samples(slice(-1))
    yield "duration", outcome(short, golden.events)
    axis, signal = next((a, s) for a in trace.axes for s in case.compared if trace.has(a, s))
    share = case.tolerance[signal]
    if share["rms"] < share["max"]:
        offset = np.sqrt(share["rms"] * share["max"]) / gap_unit(machine.axis(axis), signal)[1]
        signals = {**trace.signals, (axis, signal): trace.get(axis, signal) + offset}
        yield " RMS", outcome(Trace(trace.time, signals, trace.kinds), golden.events)
    if golden.events:
        late = tuple(replace(e, start=e.start + 1.01 * case.tolerance["events"]["time_s"]) for e in golden.events)
        yield " time", outcome(trace, late)
    blocks = [e.text for e in golden.events if e.kind == "block"]
    if len(set(blocks)) > 1:
        turned = iter(blocks[::-1])
        yield "order of blocks", outcome(trace, tuple(replace(e, text=next(turned)) if e.kind == "block" else e for e in golden.events))


def test_each_kind_of_check_can_fail_by_itself() -> None:
    shown = set()
    for case in SHIPPED:
        golden = read_golden(case)
        if golden.trace is not None:
            for ending, now in alone(golden, case):
                failed = [check.quantity for check in compare(case, golden, now) if not check.ok]
                assert failed, (case.name, ending)
                assert all(quantity.endswith(ending) for quantity in failed), (case.name, failed)
                shown.add(ending)
    assert shown == {"duration", " RMS", " time", "order of blocks"}


def test_every_effect_has_a_case_in_which_it_shows() -> None:
    cases = [case for case in SHIPPED if case.file.name == "effects.toml"]
    assert sorted(case.name for case in cases) == sorted(n for n, effect in EFFECTS.items() if not effect.block_of_control)
    without: dict[str, Outcome] = {}
    for case in cases:
        assert [effect["name"] for effect in case.table["effects"]] == [case.name]
        plain = Case(case.name, case.kind, case.file, {k: v for k, v in case.table.items() if k != "effects"})
        key = json.dumps([case.table["axes"], case.table["moves"]])
        if key not in without:
            without[key] = run_case(plain)
        assert any(not check.ok and not check.quantity.endswith("events") for check in compare(case, read_golden(case), without[key]))


def test_the_suite_holds_every_capability() -> None:
    assert {case.kind for case in SHIPPED} == {"run", "cut", "campaign", "identify", "diagnose", "study"}
    assert sum(case.name.startswith("program_") for case in SHIPPED) == 3


@pytest.mark.parametrize(
    ("old", "new", "block"),
    [
        ("position_gain_per_s = 30.0", "position_gain_per_s = 30.3", "position controller"),
        ("velocity_feedforward = 1.0", "velocity_feedforward = 0.99", "position controller"),
        ("speed_gain_nm_s_per_rad = 0.1", "speed_gain_nm_s_per_rad = 0.102", "speed controller"),
        ("speed_integral_time_s = 0.010", "speed_integral_time_s = 0.0105", "speed controller"),
        ("current_gain_v_per_a = 6.0", "current_gain_v_per_a = 5.0", "current loop"),
        ("coulomb_friction_nm = 0.1", "coulomb_friction_nm = 0.102", "mechanics"),
        ("2.0e-4", "2.02e-4", "mechanics"),
    ],
)
def test_a_change_is_found_and_named(suite: Path, tmp_path: Path, old: str, new: str, block: str) -> None:
    edit(suite.parent / "small.toml", old, new)
    assert regress(suite, tmp_path) == 1
    case = json.loads((tmp_path / "out" / "regress.json").read_text())["cases"][0]
    assert (case["status"], case["place"]["axis"], case["place"]["block"]) == ("failed", "U", block)
    assert case["place"]["since_s"] is None or 0.0 <= case["place"]["since_s"] < 0.5


def test_a_failure_leaves_its_evidence(suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edit(suite.parent / "small.toml", "coulomb_friction_nm = 0.1", "coulomb_friction_nm = 0.13")
    assert regress(suite, tmp_path) == 1
    folder = tmp_path / "out" / "u_move"
    for name in ("golden.parquet", "new.parquet", "plot.png", "overlay.rrd", "checks.json", "sentence.txt"):
        assert (folder / name).stat().st_size > 0
    sentence = (folder / "sentence.txt").read_text().strip()
    assert sentence.startswith("axis U differs from 0.")
    assert "first changed block: mechanics" in sentence
    assert sentence in capsys.readouterr().out


def test_a_case_that_breaks_is_a_verdict(suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(case: Case) -> Outcome:
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(run_suite, "run_case", broken)
    assert regress(suite, tmp_path) == 1
    case = json.loads((tmp_path / "out" / "regress.json").read_text())["cases"][0]
    assert case["status"] == "error"
    assert case["text"].startswith("cannot run: ZeroDivisionError: division by zero in test_suite.py, line")
    assert ElementTree.parse(tmp_path / "out" / "junit.xml").find("./testsuite/testcase/error") is not None


def test_values_that_are_not_numbers_are_kept_as_text(suite: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = read_suite(suite)[0]
    monkeypatch.setattr("twin.regress.runners._RUNNERS", {"run": lambda case, machine: Outcome({"mean": Feature(float("nan"), "um")})})
    assert run_case(case).features["mean"].value == "nan"


def test_the_workflow_reports_failed_cases(suite: Path, tmp_path: Path) -> None:
    """The summary in the workflow file reads what the command writes, and the command's arguments are those that it has."""
    text = (HERE / ".github/workflows/regress.yml").read_text()
    assert "python -m twin regress examples/regression --out out/regress" in text
    edit(suite.parent / "small.toml", "coulomb_friction_nm = 0.1", "coulomb_friction_nm = 0.13")
    assert regress(suite, tmp_path) == 1
    (tmp_path / "out" / "regress").mkdir()
    (tmp_path / "out" / "regress.json").rename(tmp_path / "out" / "regress" / "regress.json")
    script = dedent(text[text.index("import json, pathlib") - 10 : text.index("          PY\n")])
    ran = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, env=os.environ, capture_output=True, text=True, check=True)
    assert "## Regression runs: failed" in ran.stdout
    assert "- **u_move** failed: axis U differs" in ran.stdout


OTHER = """kind = "run"
machine = "slides.toml"
compare = ["setpoint", "position", "velocity", "current", "voltage", "torque"]
moves.X = { distances_mm = [4.0, -4.0], speed_mm_per_s = 20.0 }
moves.Z = { distances_mm = [10.0, -10.0], speed_mm_per_s = 100.0 }
moves.B = { distances_deg = [10.0, -10.0], speed_deg_per_s = 40.0 }
"""


@pytest.mark.slow
def test_other_control_structures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """P/P on a voltage, P/PI on a current, P/P on a torque: the command is compared, and the changed block is named."""
    write_slides(tmp_path)
    folder = tmp_path / "suite"
    folder.mkdir()
    tolerances = TOLERANCES + "".join(
        f'[tolerance.{signal}]\nrms = 1e-4\nmax = 1e-3\nunit = "{unit}"\nreason = "a thousandth"\n'
        for signal, unit in (("voltage", "V"), ("torque", "Nm"))
    )
    good = OTHER.replace('"slides', '"../slides') + tolerances
    (folder / "moves.toml").write_text("\n".join(line for line in good.splitlines() if not line.startswith("compare")))
    capsys.readouterr()
    assert regress(folder, tmp_path, "--update", "--reason", "first results") == 2
    one_line(capsys, "axis X commands a voltage", 'compare = ["setpoint", "position", "velocity", "voltage"]')
    (folder / "moves.toml").write_text(good)
    assert regress(folder, tmp_path, "--update", "--reason", "first results") == 0
    assert regress(folder, tmp_path) == 0
    plain = (tmp_path / "slides.toml").read_text()
    for old, new, axis, block in (
        ("position_gain_per_s = 160.0", "position_gain_per_s = 161.0", "X", "position controller"),
        ("speed_gain_v_s_per_m = 243.0", "speed_gain_v_s_per_m = 245.0", "X", "speed controller"),
        ("coulomb_friction_n = 20.0", "coulomb_friction_n = 20.4", "X", "mechanics"),
        ("gravity_m_per_s2 = 9.81", "gravity_m_per_s2 = 9.9", "Z", "mechanics"),
        ("speed_integral_time_s = 0.02", "speed_integral_time_s = 0.0205", "Z", "speed controller"),
        ("torque_constant_nm_per_a = 0.5", "torque_constant_nm_per_a = 0.505", "Z", "speed controller"),
        ("speed_gain_nm_s_per_rad = 0.04", "speed_gain_nm_s_per_rad = 0.0404", "B", "speed controller"),
    ):
        (tmp_path / "slides.toml").write_text(plain.replace(old, new))
        assert regress(folder, tmp_path, "--no-evidence") == 1
        place = json.loads((tmp_path / "out" / "regress.json").read_text())["cases"][0]["place"]
        assert (place["axis"], place["block"]) == (axis, block), (new, place)


def test_junit_output_has_the_common_form(suite: Path, tmp_path: Path) -> None:
    """Elements, attributes, order and counts as in the schema that Jenkins, GitLab and GitHub actions share."""
    edit(suite / "moves.toml", 'name = "u_move"\n', "")
    with (suite / "moves.toml").open("a") as file:
        file.write('[[case]]\nname = "u_move"\n[[case]]\nname = "second"\n')
    (suite / "measured.toml").write_text(
        'kind = "campaign"\nname = "away"\ncampaign = "nowhere"\nmachine = "../small.toml"\n'
        '[tolerance.gap]\ngrowth = 0.1\nabove_noise = 0.1\nreason = "a tenth"\n'
    )
    golden = suite / "golden" / "u_move.json"
    (suite / "golden" / "second.json").write_text(golden.read_text())
    (suite / "golden" / "second.parquet").write_bytes((suite / "golden" / "u_move.parquet").read_bytes())
    (suite / "golden" / "away.json").write_text("{}")
    edit(suite.parent / "small.toml", "coulomb_friction_nm = 0.1", "coulomb_friction_nm = 0.13")
    document = json.loads(golden.read_text())
    cases = {case.name: case for case in read_suite(suite)}
    for name in ("u_move", "second", "away"):
        file = suite / "golden" / f"{name}.json"
        features = {} if name == "away" else document["features"]
        file.write_text(json.dumps({**document, "case": cases[name].digest(), "trace": name != "away", "features": features}))
    assert regress(suite, tmp_path, "--junit", str(tmp_path / "junit.xml")) == 1
    root = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert root.tag == "testsuites"
    assert set(root.attrib) <= {"name", "time", "tests", "failures", "errors"}
    (one,) = root
    assert one.tag == "testsuite"
    assert {"name", "tests", "failures", "errors", "skipped", "time", "timestamp"} == set(one.attrib)
    assert [child.tag for child in one] == ["properties", "testcase", "testcase", "testcase"]
    assert all(set(p.attrib) == {"name", "value"} for p in one.find("properties") or ())
    found = one.findall("testcase")
    assert all({"name", "classname", "time"} == set(case.attrib) and float(case.attrib["time"]) >= 0 for case in found)
    allowed = {"skipped": {"message"}, "failure": {"message", "type"}, "error": {"message", "type"}, "system-out": set()}
    for case in found:
        assert all(set(child.attrib) == allowed[child.tag] for child in case)
    by_name = {case.attrib["name"]: [child.tag for child in case] for case in found}
    assert by_name == {"away": ["skipped"], "u_move": ["failure"], "second": ["failure"]}
    assert [one.attrib[key] for key in ("tests", "failures", "errors", "skipped")] == ["3", "2", "0", "1"]


def test_update_shows_old_and_new_and_keeps_the_reason(suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert regress(suite, tmp_path, "--update", "--reason", "no change") == 0
    assert "no difference from the golden results" in capsys.readouterr().out
    edit(suite.parent / "small.toml", "position_gain_per_s = 30.0", "position_gain_per_s = 33.0")
    before = (suite / "golden" / "u_move.json").read_text()
    assert regress(suite, tmp_path, "--update") == 2  # no terminal to ask at
    one_line(capsys, "--reason")
    assert (suite / "golden" / "u_move.json").read_text() == before
    assert regress(suite, tmp_path, "--update", "--reason", "position gain set to 33 1/s at commissioning") == 0
    told = capsys.readouterr().out
    for word in ("old", "new", "difference", "U.position max", "U.following_error_max"):
        assert word in told
    history = json.loads((suite / "golden" / "u_move.json").read_text())["history"]
    assert [entry["reason"] for entry in history] == ["first results", "position gain set to 33 1/s at commissioning"]
    assert {"twin", "mujoco", "numba", "numpy"} <= set(history[-1]["versions"])
    assert regress(suite, tmp_path) == 0


def test_update_of_a_changed_case_shows_the_old_values(suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edit(suite / "moves.toml", "speed_mm_per_s = 100.0", "speed_mm_per_s = 90.0")
    assert regress(suite, tmp_path, "--update", "--reason", "slower, as the machine is run now") == 0
    told = capsys.readouterr().out
    assert "U.speed_max" in told
    assert "(new case)" not in told.split("slower")[0].split("first results")[-1]
    assert regress(suite, tmp_path) == 0


def test_a_simulation_that_stops_fails_with_its_axis(suite: Path, tmp_path: Path) -> None:
    edit(suite.parent / "small.toml", "speed_gain_nm_s_per_rad = 0.1", "speed_gain_nm_s_per_rad = 40.0")
    assert regress(suite, tmp_path) == 1
    case = json.loads((tmp_path / "out" / "regress.json").read_text())["cases"][0]
    assert case["place"]["axis"] == "U"
    assert "simulation aborted" in case["text"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[tolerance.current]", "[tolerance.torque_gravity]", ("tolerance of 'current' is missing", "[tolerance.current]")),
        ('reason = "a tenth of the noise"\n', "", ("[tolerance.setpoint]", "'reason' is missing")),
        ("rms = 0.005", "rms = -1", ("rms = -1", "0 or more")),
        ('unit = "um, arcsec"', 'unit = "mm"', ("unit = 'mm'", "um, arcsec")),
        ('kind = "run"', 'kind = "runn"', ("kind = 'runn'", "did you mean 'run'?")),
        ('kind = "run"\n', "", ("'kind' is missing", "known are: campaign,")),
        ('kind = "run"', 'kind = "run', ("not a valid TOML file",)),
        ('kind = "run"', 'kind = ["run"]', ("kind = ['run']", "did you mean 'run'?")),
        ("distances_mm", "distance_mm", ("unknown key 'distance_mm'", "did you mean 'distances_mm'?")),
        ("moves.U", "moves.V", ("[moves.V]", "no such axis")),
        ('machine = "../small.toml"', 'machine = "../smal.toml"', ("no such file", "smal.toml")),
        ("moves.U", "feedforward = 'on'\nmoves.U", ("feedforward = 'on'",)),
        ("moves.U", "input = 'x.csv'\nmoves.U", ("give one of input, moves", "input and moves are given")),
        ("moves.U", "values = 3\nmoves.U", ("values = 3", "give paths and numbers")),
        ("moves.U", "spec = 'a.toml'\nmoves.U", ("unknown key 'spec' for kind run",)),
        ('axes = ["U"]', 'axes = "U"', ("axes = 'U'", "give a list of axes")),
        ("[tolerance.summary]", "[tolerance]\nposition = 3\n[tolerance.summary]", ("not a valid TOML file",)),
        ("u_move", "other_move", ("no golden result", "other_move.json", "--update")),
        ("10.0, -10.0", "12.0, -10.0", ("has changed since its golden result", "--update")),
    ],
)
def test_bad_suites_end_with_one_line(
    suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, words: tuple[str, ...]
) -> None:
    edit(suite / "moves.toml", old, new)
    capsys.readouterr()
    # errors that appear only when the case runs are reported on --update
    update = ["--update", "--reason", "another case"] if new in ("distance_mm", "moves.V") else []
    assert regress(suite, tmp_path, *update) == 2
    one_line(capsys, *words)


def test_a_campaign_is_no_suite(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its campaign.toml was read as a case of kind None."""
    folder = ROOT / "examples" / "campaign"
    assert regress(folder, tmp_path) == 2
    one_line(capsys, "is a campaign, not a suite", f"twin gap {folder}")


def test_golden_results_that_cannot_be_used(suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    golden = suite / "golden" / "u_move.json"
    good = golden.read_text()
    edit(golden, '"format": 1', '"format": 0')
    assert regress(suite, tmp_path) == 2
    one_line(capsys, "format 0", "reads format 1", "--update --reason")
    golden.write_text(good[:200])
    assert regress(suite, tmp_path) == 2
    one_line(capsys, "not a golden result")
    golden.write_text(good)
    (suite / "golden" / "u_move.parquet").write_bytes(b"PAR1")
    assert regress(suite, tmp_path) == 2
    one_line(capsys, "not a readable Parquet file", "restore it", "--update --reason")
    (suite / "golden" / "u_move.parquet").unlink()
    assert regress(suite, tmp_path) == 2
    one_line(capsys, "golden trace", "is missing")


def test_update_lists_skipped_cases(suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (suite / "measured.toml").write_text(
        'kind = "campaign"\nname = "spring"\ncampaign = "not_here"\n[tolerance.gap]\ngrowth = 0.1\nabove_noise = 0.1\nreason = "another draw"\n'
    )
    capsys.readouterr()
    assert regress(suite, tmp_path, "--update", "--reason", "a measured campaign") == 0
    assert "skipped, golden result unchanged: spring: campaign not_here is not here" in capsys.readouterr().out


def test_a_golden_result_of_another_version_is_reported(suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = json.loads((suite / "golden" / "u_move.json").read_text())
    document["versions"]["mujoco"] = "3.9.9"
    (suite / "golden" / "u_move.json").write_text(json.dumps(document))
    assert regress(suite, tmp_path) == 0
    told = capsys.readouterr().out
    assert "mujoco 3.9.9 -> " in told
    assert "--update --reason" in told


def test_the_suites_of_the_page_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The suite in docs/regression.md is valid, makes its golden results and passes."""
    blocks = re.findall(r"```toml\n(.*?)```", (HERE / "docs/regression.md").read_text(), re.DOTALL)
    assert len(blocks) == 2
    for name in ("mikron_ucp710.toml", "mikron_ucp710.xml"):
        shutil.copy(HERE / "models" / name, tmp_path / name.replace("mikron_ucp710.toml", "my_machine.toml"))
    folder = tmp_path / "my_suite"
    folder.mkdir()
    for name, block in zip(("moves", "measured"), blocks):
        (folder / f"{name}.toml").write_text(block)
    assert regress(folder, tmp_path, "--update", "--reason", "first golden results") == 0
    assert regress(folder, tmp_path, "--only", "x_*") == 0
    assert "2 passed" in capsys.readouterr().out


def test_usage(suite: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, word in (
        (["--jobs", "0"], "--jobs: '0': give a whole number, 1 or more"),
        (["--only", "nothing"], "no such case"),
        (["--reason", "because"], "--reason needs --update"),
    ):
        capsys.readouterr()
        assert word in refused(capsys, "regress", str(suite), *arguments)
    assert main(["regress", str(tmp_path / "nowhere")]) == 2
    one_line(capsys, "no such suite")
    assert main(["regress", str(suite), "--list"]) == 0
    assert "u_move" in capsys.readouterr().out


def test_every_signal_that_a_suite_may_compare_has_a_unit(mikron: Machine) -> None:
    assert all(gap_unit(mikron.axis("X"), signal)[0] in units for signal, units in SIGNAL_UNITS.items())


def test_a_gap_that_became_smaller_is_a_result_to_store() -> None:
    check = Check("gap of position", "X", "um", 0.0, 0.5, golden=5.0, now=4.0)
    assert _is_smaller(check)
    assert not _is_smaller(replace(check, now=5.0))
    assert not _is_smaller(replace(check, now=6.0))
