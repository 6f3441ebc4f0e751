"""Shared by all tests: the Mikron, set points that move every axis, and the recorded data beside the repository."""

from __future__ import annotations

import gc
import os

# before numpy is imported, and inherited by child processes: BLAS threads waiting for each other took more than half of the processor time
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from pathlib import Path
import sys

import numpy as np
import pytest

from twin.machine.machine import Machine, load_machine
from twin.simulation.setpoints import Setpoints
from twin.system import return_memory

ROOT = Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"


LONG = (
    "recovery", "diagnose", "exam", "identify", "surface", "reference", "recordings",
    "test_example_scripts.py", "test_system.py", "test_versus.py",
)  # fmt: skip
"""Folders with the longest files, and such files, which start first so that both processes end at about the same time."""


NOT_ON_WINDOWS = {
    "test_fuzz.py": "a process of the fuzzer is killed by a signal and has limits",
    "test_names_outside_the_folder_or_of_no_file_are_refused": "links need rights there",
    "test_names_inside_the_folder_are_found": "links need rights there",
    "test_nothing_outside_is_served": "links and pipes",
    "test_a_link_that_leads_nowhere_and_a_hidden_file_are_left_out": "links need rights there",
    "test_an_example_is_found_outside_the_checkout": "links need rights there",
    "test_examples_run": "links need rights there",
    "test_ctrl_c_ends_the_desk_and_sigterm_stops_it": "signals",
    "test_the_desk_in_a_real_browser": "the browser is driven through pipes with fixed numbers",
    "test_a_killed_worker_loses_nothing": "signals",
    "test_a_model_that_crashes_the_engine_is_refused": "signals",
    "test_names_cannot_steer_the_terminal": "no name of a file holds control characters there",
    "test_a_change_of_a_model_is_seen_even_with_the_size_and_time_of_before": "a file has no time of change there that only the system sets",
    "test_without_a_folder_to_write_it_runs_and_says_so_once": "numba asks the registry for the user's folder, so that a test cannot take it away",
    "test_a_file_in_use_is_noticed": "plays Windows where it is not",
}
"""Tests, or files of tests, that need what Windows lacks, and why. `tests/test_faults.py` says so itself."""
ONLY_ON_LINUX = {
    "test_a_large_page_is_not_held_in_memory": "reads the memory of a process in /proc",
    "test_names_of_any_bytes_and_a_terminal_of_ascii": "names that are no text",
    "test_a_worker_ends_with_its_parent": "looks for a process in /proc",
    "test_a_worker_whose_parent_is_gone_before_it_looks_ends_too": "looks for a process in /proc",
}


def pytest_configure() -> None:
    """Memory as in a command: cycles are looked for seldom, which took a twentieth of the processor time, and arrays keep their pages."""
    gc.set_threshold(20_000)
    return_memory()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long folders and files first; the order within a folder stays. What this system lacks is skipped."""
    lacking = {**(NOT_ON_WINDOWS if os.name == "nt" else {}), **({} if sys.platform.startswith("linux") else ONLY_ON_LINUX)}
    for item in items:
        name = getattr(item, "originalname", item.name)
        if (reason := lacking.get(name) or lacking.get(item.path.name)) is not None:
            item.add_marker(pytest.mark.skip(reason=reason))
    items.sort(key=lambda item: next((i for i, name in enumerate(LONG) if name in item.path.parts), len(LONG)))


def pytest_collection_finish() -> None:
    """The modules and items of all tests stay: the garbage collector need not look through them again and again."""
    gc.freeze()


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
