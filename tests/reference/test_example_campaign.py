"""The accuracy table of README.md and docs/results.md, on the recorded campaign that ships in the tree."""

from pathlib import Path
import re

import pytest

from tests.conftest import ROOT
from twin.machine.machine import Machine
from twin.simulation.campaign_gap import CampaignGap, gap

ROW = re.compile(r"^\| ([XYZAC]) \| ([\d.]+) (um|arcsec) \| ([\d.]+) \3 \| ([\d.]+) A \| ([\d.]+) A \|$", re.M)
LIMITS = {"um": 0.1, "arcsec": 0.25, "A": 0.06}
"""Largest RMS gap that agrees within noise."""


@pytest.fixture(scope="module")
def found(mikron: Machine) -> CampaignGap:
    return gap(ROOT / "examples" / "campaign", mikron)


def test_every_axis_agrees_within_noise(found: CampaignGap) -> None:
    assert found.verdict == "X, Y, Z, A and C as they should be"
    for row in found.rows():
        if row.signal in ("position", "current"):
            assert row.gap.rms < LIMITS[row.gap.unit], row


@pytest.mark.parametrize("page", ["README.md", "docs/results.md"])
def test_the_documented_table_equals_the_output_of_the_command(found: CampaignGap, page: str) -> None:
    rows = ROW.findall(Path(ROOT / page).read_text(encoding="utf-8"))
    assert [row[0] for row in rows] == ["X", "Y", "Z", "A", "C"]
    for axis, position, _unit, position_noise, current, current_noise in rows:
        for signal, rms, noise in (("position", position, position_noise), ("current", current, current_noise)):
            worst = max((run[axis][signal] for run in found.runs.values()), key=lambda g: g.rms)
            assert float(rms) == pytest.approx(worst.rms, abs=0.002), f"{axis} {signal}"
            assert float(noise) == pytest.approx(worst.noise, abs=0.002), f"{axis} {signal}"
