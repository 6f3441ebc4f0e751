"""Shared by all tests: the Mikron, set points that move every axis, and the recorded data beside the repository."""

from __future__ import annotations

import os

# before numpy is imported, and inherited by child processes: BLAS threads waiting for each other took more than half of the processor time
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from pathlib import Path

import numpy as np
import pytest

from twin.machine.machine import Machine, load_machine
from twin.simulation.setpoints import Setpoints

ROOT = Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"


LONG_ROOMS = ("recovery", "diagnose", "exam", "identify", "surface", "reference", "recordings")
"""Folders with the longest files, which start first so that both processes end at about the same time."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long folders first; the order within a folder stays."""
    items.sort(key=lambda item: next((i for i, room in enumerate(LONG_ROOMS) if room in item.path.parts), len(LONG_ROOMS)))


@pytest.fixture(scope="session")
def mikron() -> Machine:
    """The machine that ships with the package."""
    return load_machine()


@pytest.fixture(scope="session")
def nominal_campaign() -> Path:
    """Runs recorded on a nominal machine; skips the test if they are missing."""
    folder = SHARED / "campaigns" / "nominal"
    if not folder.is_dir():
        pytest.skip("no recorded campaign: ../shared/campaigns/nominal is not beside this repository")
    return folder


def swings(machine: Machine, seconds: float, period: float = 1e-3) -> Setpoints:
    """Every axis oscillates from rest about the middle of its travel, each at its own frequency."""
    t = np.arange(round(seconds / period) + 1) * period
    columns = []
    for a, axis in enumerate(machine.axes):
        low, high = axis.travel
        middle = 0.0 if np.isinf(low) else np.clip(0.0, low + 0.3 * (high - low), high - 0.3 * (high - low))
        amplitude = 0.01 if axis.kind == "linear" else 0.1
        columns.append(middle + amplitude * np.sin(2 * np.pi * (0.8 + 0.1 * a) * t) ** 3)
    return Setpoints(np.column_stack(columns), period)
