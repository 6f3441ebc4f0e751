"""examples/unlisted_law: an unlisted drag of the second plant is found as a law."""

from __future__ import annotations

import json
from pathlib import Path
import subprocess
import sys

import pytest

from tests.conftest import ROOT


@pytest.mark.slow
def test_the_example_finds_the_law_and_closes_the_gap(tmp_path: Path):
    command = [sys.executable, str(ROOT / "examples" / "unlisted_law" / "run.py"), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    document = json.loads((tmp_path / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
    assert document["verdict"] == "law"
    law = document["laws"][0]
    assert (law["axis"], law["block"], law["output"], law["variables"]) == ("Y", "mechanics", "friction", ["speed"])
    assert document["gap"]["after"] < 1.5
    assert "looks like: drag that grows with speed" in done.stdout
    assert "windage" in done.stdout
