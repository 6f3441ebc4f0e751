"""Tolerances of the comparison with a golden result."""

from __future__ import annotations

from pathlib import Path

import pytest

from twin.regress.compare import compare
from twin.regress.golden import Feature, Golden, Outcome
from twin.regress.suite import Case


@pytest.mark.parametrize(("gap", "ok"), [(0.5, True), (1.065, True), (1.08, False)])
def test_a_gap_may_grow_by_its_share_and_a_share_of_the_noise(tmp_path: Path, gap: float, ok: bool) -> None:
    """growth 0.02 of a gap of 1 and above_noise 0.05 of a noise of 1: up to 1.07."""
    table = {"tolerance": {"gap": {"growth": 0.02, "above_noise": 0.05, "reason": "a test"}}}
    case = Case("spring", "campaign", tmp_path / "suite.toml", table)
    golden = Golden({"X.position gap in run": Feature(1.0, "um", "X", "", 1.0)}, None, (), {}, "")
    (check,) = compare(case, golden, Outcome({"X.position gap in run": Feature(gap, "um", "X", "", 1.0)}))
    assert check.ok == ok
