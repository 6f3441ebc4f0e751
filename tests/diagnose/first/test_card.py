"""The card: odd strokes are named, even ones are not, and its text and JSON say the same."""

from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path
import re
from unittest.mock import Mock

import jsonschema
import pytest

from tests.builders.refused import refused
from tests.builders.strokes import Planted, strokes
from twin.cli import main
from twin.diagnose.first.axis_facts import facts_of
from twin.diagnose.first.card import card_of, card_text, write_card
from twin.diagnose.first.odd import Odd, oddities
from twin.diagnose.first.people import shown
from twin.errors import InputError
from twin.estimate.regression import Range
from twin.recordings.trace import write_trace
from twin.units import ARCSEC

SCHEMA = Path(__file__).resolve().parents[3] / "twin" / "report" / "schemas" / "card.json"


def odd(planted: Planted, seed: int) -> list[Odd]:
    found = facts_of([strokes(planted, seed)], "X")
    assert found is not None
    return oddities([found])


def test_an_odd_stroke_is_named_and_even_ones_are_not() -> None:
    named = [o for o in odd(Planted(odd_stroke=(4, 0.5)), 1) if o.kind == "stroke"]
    assert len(named) == 1
    words = named[0].sentence.split()
    assert float(words[words.index("about") + 1]) == pytest.approx(0.5, rel=0.2)
    assert "more current" in named[0].sentence
    quiet = [o for seed in range(12) for o in odd(Planted(constant=0.0, lost=0.0), seed)]
    assert quiet == []


def test_lost_motion_and_weight_are_odd() -> None:
    kinds = {o.kind for o in odd(Planted(), 1)}
    assert kinds == {"direction", "transmission"}


def test_text_and_json_of_the_card(tmp_path: Path) -> None:
    card = card_of([strokes(Planted(speeds=(0.05,)), 1)])
    text = card_text(card)
    assert "at 50.0 mm/s" in text
    friction, half = next(line.split()[1:4:2] for line in text.splitlines() if line.startswith("  friction"))
    assert float(friction) == pytest.approx(1.7, abs=float(half))
    assert "do not separate Coulomb from viscous" in text
    assert max(len(line) for line in text.splitlines()) <= 140
    write_card(card, tmp_path / "card.json")
    document = json.loads((tmp_path / "card.json").read_text())
    jsonschema.validate(document, json.loads(SCHEMA.read_text()))
    assert document["axes"]["X"]["friction"]["at_speed"]["value"] == pytest.approx(1.7, rel=0.02)


@pytest.mark.parametrize(("half", "shown"), [(1e-3, "12.7 +- 1.0 ms"), (0.02, "below 32.7 ms"), (200.0, "not determined")])
def test_a_lag_that_may_be_anything_is_not_given(half: float, shown: str) -> None:
    """At one speed in one direction a lag and a constant of the position are one number."""
    card = card_of([strokes(Planted(), 1)])
    text = card_text(replace(card, facts=(replace(card.facts[0], lags={"": Range.around(0.0127, half)}),)))
    assert any(line.split(maxsplit=1) == ["lag", shown] for line in text.splitlines())


def test_large_angles_and_lengths_are_no_fine_units() -> None:
    """A servo whose record scatters by a degree had '2214 arcsec' of noise."""
    angle, length = shown("error", "rotary"), shown("error")
    assert [angle.text(size * ARCSEC) for size in (-999.0, 2214.0)] == ["-999 arcsec", "0.615 deg"]
    assert [length.text(size) for size in (5e-6, 5.5e-3)] == ["5.00 um", "5.50 mm"]
    assert angle.interval(7200.0 * ARCSEC, 360.0 * ARCSEC) == "2.00 +- 0.10 deg"
    assert shown("current").text(2000.0) == "2000 A"


@pytest.mark.slow
def test_raw_files_in_one_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    run = strokes(Planted(speeds=(0.1, 0.2), lost=0.0), 1, period=2e-3)
    write_trace(run.trace, tmp_path / "strokes.csv")
    arguments = ["diagnose", str(tmp_path / "strokes.csv"), "--out", str(tmp_path / "out"), "--quick"]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert "axis X: 59.8 mm up to 200 mm/s" in said
    assert (tmp_path / "out" / "machine_from_recording.toml").exists()
    for name in ("card.json", "card.html", "card.png", "diagnosis.json"):
        assert (tmp_path / "out" / name).exists()
    verdict = next(line for line in said.splitlines() if line.startswith(("No effect", "Unknown", "Not decided", "The gap")))
    assert f'<p class="lead">{verdict}' in (tmp_path / "out" / "card.html").read_text()  # what a reader asks first
    (proposed,) = re.findall("next measurement: (.*?)[;\n]", said)
    assert proposed in (tmp_path / "out" / "card.html").read_text().partition("Diagnosis and next measurement</h2>")[2]
    # the same command continues from what stands there; an edited map begins anew; the diagnosis itself is the same
    monkeypatch.setattr("twin.diagnose.diagnose", Mock(side_effect=InputError("enough seen")))
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert "campaign used as it stands" in said
    assert "no diagnosis: enough seen" in said
    map_file = tmp_path / "out" / "campaign" / "map.toml"
    map_file.write_text(map_file.read_text() + '\n[[run]]\nfile = "strokes.csv"\nto_s = 4.0\n')
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert "used as it stands" not in said
    assert json.loads((tmp_path / "out" / "card.json").read_text())["axes"]["X"]["duration_s"] < 4.1


def test_a_simulated_run_is_no_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "summary.json").write_text("{}")
    write_trace(strokes(Planted(), 1).trace, tmp_path / "trace.parquet")
    assert "'twin compare'" in refused(capsys, "diagnose", str(tmp_path), "--out", str(tmp_path / "out"))
