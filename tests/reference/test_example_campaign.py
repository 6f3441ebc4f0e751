"""The recorded campaign that ships in the tree: every axis agrees within noise."""

from tests.conftest import ROOT
from twin.machine.machine import Machine
from twin.simulation.campaign_gap import gap

LIMITS = {"um": 0.1, "arcsec": 0.25, "A": 0.06}
"""Largest RMS gap that agrees within noise."""


def test_every_axis_agrees_within_noise(mikron: Machine) -> None:
    found = gap(ROOT / "examples" / "campaign", mikron)
    assert found.verdict == "X, Y, Z, A and C as they should be"
    for row in found.rows():
        if row.signal in ("position", "current"):
            assert row.gap.rms < LIMITS[row.gap.unit], row
