"""examples/unlisted_law: an unlisted drag of the second plant is found as a law."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.builders.script import carried_out


@pytest.mark.slow
def test_the_example_finds_the_law_and_closes_the_gap(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    carried_out("examples/unlisted_law/run.py", "--out", tmp_path)
    said = capsys.readouterr().out
    document = json.loads((tmp_path / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
    assert document["verdict"] == "law"
    law = document["laws"][0]
    assert (law["axis"], law["block"], law["output"], law["variables"]) == ("Y", "mechanics", "friction", ["speed"])
    assert document["gap"]["after"] < 1.5
    assert "looks like: drag that grows with speed" in said
    assert "windage" in said
