"""The developers' tools name only what exists in the package; most of them run too long for a test."""

from __future__ import annotations

import ast
from collections.abc import Callable
import importlib
import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest

from devtools import sensitivity
from devtools.watched import watched
from tests.conftest import ROOT
from twin.diagnose.settings import T, Thresholds


@pytest.mark.parametrize("file", sorted((ROOT / "devtools").glob("*.py")), ids=lambda file: file.stem)
def test_imported_names_exist(file: Path) -> None:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "twin":
            module = importlib.import_module(node.module)
            missing = [
                a.name for a in node.names if not hasattr(module, a.name) and not importlib.util.find_spec(f"{node.module}.{a.name}")
            ]
            assert not missing, f"{file.name}: {node.module} has no {', '.join(missing)}"


def watched_moves(calculation: Callable[[Thresholds], object]) -> tuple[set[str], Thresholds]:
    """The thresholds whose moves to 2/3 stay open after a calculation, and the watched thresholds."""
    moves = {(name, 2.0 / 3.0): getattr(T, name) * 2.0 / 3.0 for name in ("evidence", "price", "break_away_s")}
    thresholds, watch = watched(T, moves)
    calculation(thresholds)
    return {name for name, _ in watch.open}, thresholds


@pytest.mark.parametrize(
    ("calculation", "expected"),
    [
        (lambda t: t.evidence > 100.0, set()),  # 14 and 9.33 are both below
        (lambda t: t.evidence > 10.0, {"evidence"}),
        (lambda t: np.arange(20.0) < t.evidence, {"evidence"}),
        (lambda t: np.zeros(20) < t.evidence, set()),
        (lambda t: max(10.0, t.evidence + 2.0 * t.price) > 17.0, {"evidence", "price"}),
        (lambda t: max(50.0, t.evidence) * 2.0 > 17.0, set()),  # the limit does not bind
        (lambda t: np.sqrt(t.evidence), set()),  # never compared
        (lambda t: math.sqrt(t.evidence), {"evidence"}),  # leaves the calculation
        (lambda t: np.ones(3) * t.evidence, {"evidence"}),
        (lambda t: range(round(t.break_away_s / 0.01)), {"break_away_s"}),
        (lambda t: range(round(t.break_away_s / 10.0)), set()),  # 0 steps either way
        (lambda t: f"{t.price}", {"price"}),
        (lambda t: isinstance(t.price, float) and {}.get(t.evidence), {"evidence"}),
    ],
)
def test_watched_thresholds_note_the_moves_that_can_change_a_result(
    calculation: Callable[[Thresholds], object], expected: set[str]
) -> None:
    assert watched_moves(calculation)[0] == expected


def test_watched_thresholds_calculate_as_plain_ones() -> None:
    _, thresholds = watched_moves(lambda t: None)
    assert float(3.0 - thresholds.evidence / 2.0 + thresholds.price**2) == 3.0 - T.evidence / 2.0 + T.price**2
    assert np.float64(2.0) < thresholds.evidence
    assert not thresholds.evidence <= np.float64(2.0)
    assert isinstance(thresholds.price, float)
    assert not isinstance(thresholds.price, int)


def test_a_group_of_moves_is_halved_until_the_changing_ones_are_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Thresholds] = []

    def answer(folder: Path, thresholds: Thresholds, quick: bool = False) -> dict[str, object]:
        asked.append(thresholds)
        return {"verdict": "none" if thresholds.price > 2.5 else "effect", "sizes": {"backlash X": 1e-6}, "after": 1.0, "places": []}

    monkeypatch.setattr(sensitivity, "answer_of", answer)
    names = ["evidence", "price", "temperature", "remaining", "echo"]
    kept = {"usual": {"answer": answer(tmp_path, T), "open": [[n, f] for n in names for f in sensitivity.FACTORS], "moves": {}}}
    answers = sensitivity.Answers(tmp_path, kept, until=math.inf)
    made = sensitivity.measured(answers, ["usual"], only=None)
    assert {move for (_, move), found in made.items() if found} == {("price", 4.0 / 3.0)}
    assert len(made) == 2 * len(names)
    before = len(asked)
    assert sensitivity.measured(answers, ["usual"], only=None) == made
    assert len(asked) == before
    assert json.loads((tmp_path / "answers.json").read_text(encoding="utf-8"))["usual"]["moves"]
    stopped = sensitivity.Answers(tmp_path, {"usual": {**kept["usual"], "moves": {}}}, until=-math.inf)
    assert sensitivity.measured(stopped, ["usual"], only=None) == {}


@pytest.mark.parametrize(
    ("other", "found"),
    [
        ({"sizes": {"backlash X": 1.01e-6}, "after": 1.03}, []),
        ({"sizes": {"backlash X": 1.03e-6}}, ["backlash X +3.0%"]),
        ({"sizes": {}}, ["names nothing"]),
        ({"after": 1.2}, ["gap 1.00 -> 1.20"]),
        ({"verdict": "unknown"}, ["effect -> unknown"]),
        ({"places": ["X transmission all -"]}, ["places X transmission all -"]),
    ],
)
def test_what_counts_as_a_change_of_an_answer(other: dict[str, object], found: list[str]) -> None:
    before = {"verdict": "effect", "sizes": {"backlash X": 1e-6}, "after": 1.0, "places": ["X transmission reversal -"]}
    assert sensitivity.changes(before, {**before, **other}) == found
