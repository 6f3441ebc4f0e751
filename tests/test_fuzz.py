"""A seeded part of `scripts/fuzz`, and tests that its loop detects every class of fault."""

from __future__ import annotations

import mmap
import os
from pathlib import Path
import random
import signal
import sys
import time

import pytest

from devtools import fuzz_files, fuzz_folders, fuzz_loop, fuzz_samples
from devtools.fuzz_loop import called, fuzz, one_case

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the watch on time and memory is that of Unix")


def test_no_corrupted_file_and_no_option_is_a_fault() -> None:
    """For more cases: scripts/fuzz --cases 20000."""
    said: list[str] = []
    tally = fuzz(fuzz_files.all_kinds(), 2 * len(fuzz_files.all_kinds()), 5000, said.append)
    assert tally.faults == []
    assert tally.total == 2 * len(fuzz_files.all_kinds())


@pytest.mark.parametrize("kind", [k for k in fuzz_samples.samples() if k not in ("part", "map")])
def test_an_uncorrupted_sample_is_valid(kind: str, tmp_path: Path) -> None:
    """Otherwise every case would be the same refusal."""
    fuzz_files.laid(fuzz_samples.samples()[kind], tmp_path)
    commands = dict.fromkeys(fuzz_files.commands(kind, tmp_path, random.Random(i)) for i in range(20))
    cheap = [c for c in commands if (c[0], c[-1]) != ("plan", "1") and "--plan" not in c]
    said = [called(command) for command in cheap]
    assert [fault for _, fault in said if fault] == []
    assert 0 in [code for code, _ in said]


FORMER_FAULTS = [
    ("study", 742159), ("suite", 743452), ("positions", 740768), ("model_new", 741066), ("model", 743275), ("urdf", 740200), ("model_new", 742817),
    ("study_folder", 11), ("study_folder", 32000072), ("golden", 3), ("exam", 7), ("iso", 33002978), ("plan", 33008920), ("identify", 2), ("machine", 9102514), ("sinumerik", 9102713), ("model", 9300075),
    ("height", 62000021), ("height", 62000693), ("events", 65000278), ("study_cells", 48), ("study_cells", 1193), ("mikron", 91003667), ("table", 91014843),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "seed"), FORMER_FAULTS)
def test_a_former_fault_is_refused(kind: str, seed: int) -> None:
    assert one_case({**fuzz_files.all_kinds(), **fuzz_folders.all_kinds()}[kind], seed) == ""


@pytest.mark.parametrize(
    ("kind", "file", "line", "value"),
    [
        ("map", "map.toml", 15, "-1"),
        ("map", "map.toml", 33, "{}"),
        ("machine", "small.toml", 15, "[1, 2]"),
        ("part", "part.toml", 2, "1e-9"),
    ],
)
def test_a_value_that_was_a_fault_is_refused(kind: str, file: str, line: int, value: str, tmp_path: Path) -> None:
    assert fuzz_files.value_at(kind, file, line, value, random.Random(0), tmp_path) == ""


def ends(seed: int, _: Path) -> str:
    if seed == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return ""


def test_a_crash_is_one_fault_and_the_loop_continues() -> None:
    tally = fuzz({"ends": ends}, 4, 0, lambda _: None)
    assert tally.total == 4
    assert tally.faults == ["seed 1 (ends): the process ended with -9"]


def test_the_loop_detects_time_memory_stray_files_and_tracebacks(monkeypatch: pytest.MonkeyPatch) -> None:
    def fills(_: int, __: Path) -> str:
        # Memory of its own: the heap of the parent may hold a free block of this size whose pages count already.
        with mmap.mmap(-1, 400_000_000) as memory:
            memory[::4096] = bytes(len(range(0, len(memory), 4096)))
        return ""

    def strays(_: int, __: Path) -> str:
        Path("stray.txt").write_text("x")
        return ""

    def waits(_: int, __: Path) -> str:
        time.sleep(30.0)
        return ""

    assert "takes longer" in one_case(waits, 0, seconds=0.05)
    assert "wrote outside its folder: stray.txt" in one_case(strays, 0)
    monkeypatch.setattr(fuzz_loop, "BYTES", 100_000_000)
    monkeypatch.setattr(fuzz_loop, "_PEAK_LOADED", 0)
    assert "GB" in fuzz({"fills": fills}, 1, 0, lambda _: None).faults[0]

    def breaks(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("twin.cli.effects.carry_out", breaks)
    assert "ZeroDivisionError" in called(("effects",))[1]
