"""`twin watch` on recordings of the second plant: an alarm with its cause, nothing judged twice, nothing lost, faults of the folder in one line."""

from __future__ import annotations

from dataclasses import replace
import json
import math
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

import jsonschema
import pytest

from devtools.histories import Fault, draw_history, machine_tables, program, write_week
from tests.builders.refused import refused
from tests.conftest import ROOT
from twin import load_machine
from twin.cli.parser import main
from twin.desk.entries import entries_in
from twin.errors import InputError
from twin.history import watch as room
from twin.history.change import Forecast
from twin.history.dated import dated_campaigns
from twin.history.store import Store

WEEKS, ONSET = 11, 8


@pytest.fixture(scope="module")
def weeks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weekly recordings of three seconds; backlash on X from week 8 on."""
    folder = tmp_path_factory.mktemp("weeks")
    backlash = {"name": "backlash", "axis": "X", "clearance": 12e-6}
    history = replace(draw_history(3, WEEKS, faulty=False), fault=Fault(backlash, ONSET, 0))
    for week in range(WEEKS):
        write_week(history, week, folder, run=program(machine_tables(), 3.0))
    write_week(replace(history, seed=4), 0, folder.parent / "another", run=program(machine_tables(), 3.0)).rename(folder.parent / "spare")
    return folder


@pytest.fixture(scope="module")
def watched(weeks: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    out = tmp_path_factory.mktemp("results") / "history"
    return out, main(["watch", str(weeks), "--out", str(out)])


def test_a_backlash_raises_the_alarm_with_cause_onset_and_size(watched: tuple[Path, int]) -> None:
    out, code = watched
    document = json.loads((out / "history.json").read_text())
    jsonschema.validate(document, json.loads((ROOT / "twin" / "report" / "schemas" / "history.json").read_text()))
    assert code == 1
    assert document["alarm"]
    (change,) = document["changes"]
    assert (change["effect"], change["axis"]) == ("backlash", "X")
    assert change["onset"][:10] == document["campaigns"][ONSET]["name"]
    assert change["parameters"]["clearance"]["value"] == pytest.approx(12e-6, rel=0.15)
    assert "backlash on axis X" in change["sentence"]
    assert "um more" in change["sentence"]
    page = (out / "report.html").read_text()
    assert "backlash" in page
    assert page.count("<svg") >= 1


def test_nothing_is_judged_twice(watched: tuple[Path, int], weeks: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    out = shutil.copytree(watched[0], tmp_path / "history")
    folder = shutil.copytree(weeks, tmp_path / "weeks")
    shutil.copytree(weeks / "2026-01-12", folder / "2026-01-12_again")
    monkeypatch.setattr(room, "row_of", lambda *_: pytest.fail("judged again"))
    assert main(["watch", str(folder), "--out", str(out)]) == 1
    first, second = (json.loads((place / "history.json").read_text()) for place in (watched[0], out))
    assert first["campaigns"] == second["campaigns"]
    for one, other in zip(first["changes"], second["changes"], strict=True):
        assert [one[key] for key in ("sentence", "onset", "alarm", "ambiguous_with")] == [
            other[key] for key in ("sentence", "onset", "alarm", "ambiguous_with")
        ]
        assert one["usual_sizes"] == pytest.approx(other["usual_sizes"], rel=1e-6)  # its slopes are simulated anew
    assert any("counts once" in note for note in second["notes"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--limit", "backlash:X:clearance=10um"], "beyond the given limit"),
        (["--limit", "backlash:X:clearance=0.1mm"], "since 2026-03-02$"),
        (["--tolerance-um", "4"], "beyond 4 um at the tool point"),
        (["--tolerance-um", "40"], "since 2026-03-02$"),
    ],
)
def test_a_limit_is_a_size_or_a_tolerance_of_the_part(
    watched: tuple[Path, int], weeks: Path, tmp_path: Path, options: list[str], said: str
) -> None:
    """A play of 12 um displaces the tool by half of it to either side, and by a little more where the scale overshoots."""
    out = shutil.copytree(watched[0], tmp_path / "history")
    assert main(["watch", str(weeks), "--out", str(out), *options]) == 1
    (change,) = json.loads((out / "history.json").read_text())["changes"]
    assert re.search(said, change["sentence"]), change["sentence"]


def test_a_forecast_says_how_sure_it_is(watched: tuple[Path, int], weeks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = shutil.copytree(watched[0], tmp_path / "history")
    monkeypatch.setattr("twin.history.judge.forecast", lambda *_: Forecast(100.0, 90.0, math.inf))
    assert main(["watch", str(weeks), "--out", str(out)]) == 1
    (change,) = json.loads((out / "history.json").read_text())["changes"]
    assert change["sentence"].endswith("is reached on 2026-04-15 (2026-04-05 to never)")


def test_bad_campaigns_are_named_and_the_others_judged_and_once_mended_they_count_once(
    watched: tuple[Path, int], weeks: Path, tmp_path: Path
) -> None:
    """Each kind of bad campaign: its file is missing, damaged, or of another machine, its campaign.toml is no TOML, has no day or a wrong one."""
    out, folder = shutil.copytree(watched[0], tmp_path / "history"), shutil.copytree(weeks, tmp_path / "weeks")
    listed = 'machine = "mikron_ucp710"\n[[run]]\nfile = "production.parquet"\nfeedforward = "velocity+torque"\n'
    bad = {
        "2025-06-01": (listed, None),
        "2026-06-01": (listed, b"PAR1 cut off"),
        "2026-06-02": ("[[run", b""),
        "2026-06-03": ("recorded = 'May'\n" + listed, b""),
        "june": (listed, b""),
        "2026-06-04": (listed.replace("production", "../production"), b""),
    }
    for name, (text, data) in bad.items():
        (folder / name).mkdir()
        (folder / name / "campaign.toml").write_text(text)
        if data is not None:
            (folder / name / "production.parquet").write_bytes(data)
    (folder / "2026-06-05.csv").write_text("time [s],Q.setpoint [mm]\n0,1\n0.1,2\n")
    before = json.loads((out / "history.json").read_text())
    assert main(["watch", str(folder), "--out", str(out)]) == 1
    document = json.loads((out / "history.json").read_text())
    left_out = [note for note in document["notes"] if note.startswith("left out: ")]
    assert len(left_out) == 7
    assert all(any(name in note for note in left_out) for name in [*bad, "2026-06-05.csv"])
    assert "production.parquet" in (out / "report.html").read_text()
    assert [c["name"] for c in document["campaigns"]] == [c["name"] for c in before["campaigns"]]
    assert [c["sentence"] for c in document["changes"]] == [c["sentence"] for c in before["changes"]]
    shutil.copy(weeks.parent / "spare" / "production.parquet", folder / "2025-06-01")
    for _ in range(2):
        assert main(["watch", str(folder), "--out", str(out)]) == 1
        document = json.loads((out / "history.json").read_text())
        assert [c["name"] for c in document["campaigns"]] == ["2025-06-01", *(c["name"] for c in before["campaigns"])]


def test_another_machine_is_refused(watched: tuple[Path, int], tmp_path: Path) -> None:
    out = shutil.copytree(watched[0], tmp_path / "history")
    other = load_machine().with_values({"axis.X.loops.position_gain_per_s": 60.0})
    with pytest.raises(InputError, match="another machine"):
        Store(out, room.reference_of(other))


def test_the_desk_lists_it(watched: tuple[Path, int]) -> None:
    (entry,) = [e for e in entries_in(watched[0].parent) if e.kind == "history"]
    assert "Backlash on axis X" in entry.summary
    assert entry.report == "history/report.html"


@pytest.mark.parametrize(
    ("names", "wrong"),
    [(["a.csv"], []), (["2026-01-05.csv", "b.csv"], ["b.csv"]), (["2026-13-40.csv", "2026-01-05.csv"], ["2026-13-40.csv"])],
)
def test_days(tmp_path: Path, names: list[str], wrong: list[str]) -> None:
    for name in names:
        (tmp_path / name).write_text(name)
    dated, left_out, notes = dated_campaigns(tmp_path)
    assert {one.name for one in dated} | {*left_out} == {*names}
    assert list(left_out) == wrong
    assert all("has no day" in why for why in left_out.values())
    assert bool(wrong) or "no campaign has a day" in notes[0]


def test_an_empty_or_missing_folder_is_refused_and_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    for name, said in (("empty", "holds no campaign"), ("missing", "no such folder")):
        assert said in refused(capsys, "watch", str(tmp_path / name), "--out", str(tmp_path / "history" / name))
    assert not (tmp_path / "history").exists()


KILLER = """
import dataclasses, os, pathlib, random, signal, sys, time
from twin import load_machine
from twin.history.store import Store
from twin.history.watch import reference_of
source, out, kills = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), int(sys.argv[3])
reference = reference_of(load_machine())
store = Store(source, reference)
rows = store.rows()
store.close()
random.seed(0)
for kill in range(kills + 1):
    seen, told = os.pipe()
    child = os.fork()
    if child == 0:
        store = Store(out, reference)
        known = {row.digest for row in store.rows()}
        for i in range(300):
            digest = f"{i:03d}"
            if digest not in known:
                store.put(dataclasses.replace(rows[i % len(rows)], digest=digest, name=digest))
                os.write(told, b".")
        os._exit(0)
    os.close(told)  # a child that fails ends the reading below
    if kill < kills:
        for _ in range(random.randrange(1, 14)):  # it has stored so many, and is somewhere in the next one
            os.read(seen, 1)
        time.sleep(random.uniform(0.0, 0.003))
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    store = Store(out, reference)
    kept = store.rows()
    store.close()
    whole = all(len(row.projections) == len(rows[0].projections) for row in kept)
    print(len(kept), len({row.digest for row in kept}), whole, flush=True)
"""
"""Judges 300 campaigns in children that are killed, and prints after each how many rows and digests stand, and whether all are whole."""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills children that it forks")
def test_killed_at_any_time_it_loses_nothing(watched: tuple[Path, int], tmp_path: Path) -> None:
    source = shutil.copytree(watched[0], tmp_path / "source")
    command = [sys.executable, "-c", KILLER, str(source), str(tmp_path / "out"), "20"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=300)
    said = [line.split() for line in done.stdout.splitlines()]
    counts = [int(rows) for rows, _, _ in said]
    assert len(said) == 21
    assert counts == sorted(counts)
    assert counts[-1] == 300
    assert counts[0] < 300  # the first was really killed
    assert all(rows == digests and whole == "True" for rows, digests, whole in said)
