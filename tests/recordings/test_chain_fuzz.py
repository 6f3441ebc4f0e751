"""A seeded part of `scripts/fuzz --only chain`: damaged recordings up to an identified machine, without traceback or wrong result."""

from dataclasses import replace
from pathlib import Path

import pytest

from devtools import fuzz_claims
from devtools.fuzz_claims import MUTILATIONS, READ, Base, Tally, claims, claims_of, pages, wrong_claims
from devtools.fuzz_recordings import Recording, chain, impossible_numbers, real, write_csv
from tests.conftest import SHARED


def test_mutilated_recordings_of_a_known_axis(tmp_path: Path) -> None:
    results = [chain(seed, tmp_path / str(seed), [], no_refine=True) for seed in range(100, 110)]
    assert [fault for _, fault in results if fault] == []
    reached = {step for step, _ in results}
    assert {"nothing", "gap"} <= reached  # some are refused, some are identified


def test_a_piece_of_a_smooth_move_claims_no_gain(tmp_path: Path) -> None:
    assert chain(110, tmp_path, [], no_refine=True)[1] == ""


@pytest.mark.slow
def test_mutilated_recordings_of_real_machines(tmp_path: Path) -> None:
    recordings = real(SHARED / "data")
    if not recordings:
        pytest.skip("no recordings of real machines: ../shared/data is not beside this repository")
    results = [chain(seed, tmp_path / str(seed), recordings) for seed in range(200, 212)]  # for more run: scripts/fuzz --only chain
    assert [fault for _, fault in results if fault] == []
    reached = {step for step, _ in results}
    assert {"nothing", "gap"} <= reached


def test_an_impossible_number_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text('{"parameters": [{"name": "inertia", "value": -1.0}]}', encoding="utf-8")
    assert "inertia" in impossible_numbers(tmp_path / "m.toml", tmp_path / "n.toml", tmp_path / "result.json")


def test_a_claim_of_neither_page_nor_mutilation_is_wrong(tmp_path: Path) -> None:
    document = {
        "verdict": "law",
        "effects": [{"effect": e, "axis": "X", "probability": p} for e, p in (("backlash", 0.95), ("inertia", 0.95), ("lead_error", 0.8))],
        "laws": [{"axis": "X", "block": "mechanics", "variables": [variable], "probability": 0.5} for variable in ("speed", "time")],
    }
    base = Base(Recording("emps", {}, write_csv, {}), None, frozenset({("law of mechanics over speed", "X")}), (2, 3))
    found = claims_of(document)
    laws = [("law of mechanics over speed", "X"), ("law of mechanics over time", "X")]
    assert found == [("backlash", "X"), ("inertia", "X"), *laws]
    scaled, gap = MUTILATIONS[0], next(m for m in MUTILATIONS if m.apply.__name__ == "gap")
    assert wrong_claims(found, base, scaled.effects["effort"]) == ["backlash on X", "law of mechanics over time on X"]
    assert wrong_claims(found, base, gap.effects.get("effort", frozenset())) == [
        "backlash on X",
        "inertia on X",
        "law of mechanics over time on X",
    ]
    assert not {"cells_bad", "repeated"} & {m.apply.__name__ for m in READ}


@pytest.mark.slow
def test_mutilated_recordings_of_a_measured_axis_make_no_wrong_claim(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For more: python -m devtools.fuzz_claims."""
    bases = [replace(base, of_page=1.0) for base in pages(SHARED / "data", tmp_path) if base.recording.name == "emps"]
    if not bases:
        pytest.skip("no recordings of real machines: ../shared/data is not beside this repository")
    tally = Tally()
    for seed in SEEDS:
        (tmp_path / str(seed)).mkdir()
        assert claims(seed, tmp_path / str(seed), bases, tally) == ""
    assert tally.reached["diagnosed"] >= 2
    # the judge does not overlook an effect that the page does not name
    monkeypatch.setattr(fuzz_claims, "SURE", 0.0)
    monkeypatch.setattr(fuzz_claims, "called", lambda _: (0, ""))  # the diagnosis of this case is there
    fault = claims(SEEDS[0], tmp_path / str(SEEDS[0]), [replace(bases[0], claims=frozenset())], tally)
    assert "claims" in fault
    assert " on X" in fault


SEEDS = (10, 16, 17)
"""Cases of the measured axis; the first one is diagnosed and names an effect."""
