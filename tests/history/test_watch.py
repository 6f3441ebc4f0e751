"""`twin watch` on recordings of the second plant: an alarm with its cause, nothing judged twice, nothing lost, faults of the folder in one line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
import json
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from devtools.histories import Fault, draw_history, machine_tables, program, write_week
from tests.conftest import ROOT
from twin import load_machine
from twin.cli.parser import main
from twin.desk.entries import entries_in
from twin.errors import InputError
from twin.history import watch as room
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
    return folder


@pytest.fixture(scope="module")
def watched(weeks: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    out = tmp_path_factory.mktemp("results") / "history"
    return out, main(["watch", str(weeks), "--out", str(out)])


def test_a_backlash_raises_the_alarm_with_cause_onset_and_size(watched: tuple[Path, int]) -> None:
    out, code = watched
    document = json.loads((out / "history.json").read_text())
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
    assert first["changes"] == second["changes"]
    assert any("counts once" in note for note in second["notes"])


def test_an_unreadable_campaign_is_named_and_the_others_are_judged(
    watched: tuple[Path, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = shutil.copytree(watched[0], tmp_path / "history")
    bad = tmp_path / "weeks" / "2026-06-01"
    bad.mkdir(parents=True)
    (bad / "campaign.toml").write_text('machine = "mikron_ucp710"\n[[run]]\nfile = "gone.parquet"\n')
    assert main(["watch", str(bad.parent), "--out", str(out)]) in (1, 2)
    said = capsys.readouterr()
    assert "gone.parquet" in said.out + said.err
    assert "Traceback" not in said.err


def test_another_machine_is_refused(watched: tuple[Path, int], tmp_path: Path) -> None:
    out = shutil.copytree(watched[0], tmp_path / "history")
    other = load_machine().with_values({"axis.X.loops.position_gain_per_s": 60.0})
    with pytest.raises(InputError, match="another machine"):
        Store(out, room.reference_of(other))


def test_the_desk_lists_it(watched: tuple[Path, int]) -> None:
    (entry,) = [e for e in entries_in(watched[0].parent) if e.kind == "history"]
    assert "backlash on axis X" in entry.summary
    assert entry.report == "history/report.html"


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ([], "holds no campaign"),
        (["a.csv"], None),
        (["2026-01-05.csv", "b.csv"], "has no day"),
        (["2026-13-40.csv", "2026-01-05.csv"], "has no day"),
    ],
)
def test_days(tmp_path: Path, names: list[str], said: str | None) -> None:
    for name in names:
        (tmp_path / name).write_text(name)
    if said is None:
        dated, notes = dated_campaigns(tmp_path)
        assert len(dated) == len(names)
        assert "no campaign has a day" in notes[0]
    else:
        with pytest.raises(InputError, match=said):
            dated_campaigns(tmp_path)


CHILD = """
import sys, pathlib, dataclasses
from twin import load_machine
from twin.history.store import Store
from twin.history.watch import reference_of
source, out = map(pathlib.Path, sys.argv[1:])
reference = reference_of(load_machine())
rows = Store(source, reference).rows()
print("ready", flush=True)
store = Store(out, reference)
for i in range(400):
    row = rows[i % len(rows)]
    digest = f"{i:03d}"
    if digest not in store.digests():
        store.put(dataclasses.replace(row, digest=digest, name=digest))
print("done", flush=True)
"""


def children(source: Path, out: Path) -> Iterator[subprocess.Popen[str]]:
    while True:
        yield subprocess.Popen(
            [sys.executable, "-c", CHILD, str(source), str(out)], cwd=ROOT, stdout=subprocess.PIPE, text=True, start_new_session=True
        )


def test_killed_at_any_time_it_loses_nothing(watched: tuple[Path, int], tmp_path: Path) -> None:
    rng, counts = np.random.default_rng(0), []
    source = shutil.copytree(watched[0], tmp_path / "source")
    for kill, child in enumerate(children(source, tmp_path / "out")):
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        if kill < 4:
            time.sleep(rng.uniform(0.02, 0.3))
            child.send_signal(signal.SIGKILL)
            child.wait()
        else:
            assert child.communicate()[0] == "done\n"
        store = Store(tmp_path / "out", room.reference_of(load_machine()))
        counts.append(len(store.digests()))
        rows = store.rows()
        store.close()
        assert len({row.digest for row in rows}) == len(rows)
        assert all(len(row.projections) == 4 for row in rows)
        if kill == 4:
            break
    assert counts == sorted(counts)
    assert counts[-1] == 400
