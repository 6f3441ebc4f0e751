"""ISO 230-2 compared with closed forms and with published results of two measured axes."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from tests.conftest import ROOT, SHARED
from twin.cli import main
from twin.errors import InputError
from twin.iso230.positioning import Readings, positioning
from twin.iso230.readings import positions_of_trace, read_positions
from twin.recordings.trace import Trace

EXAMPLE = ROOT / "examples" / "iso230" / "positions.csv"
PRINTED = {
    1: {"B": 1.22e-5, "M": 2.77e-5, "A": 8.881e-5, "R_forward": 6.29e-5, "R_backward": 5.033e-5, "E_forward": 3.3e-5,
        "E_backward": 2.46e-5, "A_forward": 8.881e-5, "A_backward": 6.428e-5},
    2: {"B": 0.04346, "M": 0.04809, "A": 0.20476, "R": 0.20476, "R_forward": 0.20476, "R_backward": 0.0183, "E_forward": 0.04612,
        "E_backward": 0.07477, "A_forward": 0.20476, "A_backward": 0.08927},
}  # fmt: skip
"""Results in the reports of the two axes [mm], with exchanged directions: the reports call backward what the tables call forward."""
WRONG = {1: {"R": (6.29e-5, 6.882e-5), "E": (2.46e-5, 3.68e-5)}, 2: {"E": (0.06514, 0.07477)}}
"""Printed values that contradict the standard, and correct ones: R without the reversal term, E below that of one direction."""


def test_closed_form() -> None:
    """Deviation 10 (t / 400)^2 -+ 2 um, scatter (-1 .. 1) (1 + i / 4) um: s = sqrt(0.625) (1 + i / 4)."""
    numbers = positioning(read_positions(EXAMPLE)[0]).numbers
    s = math.sqrt(0.625) * 1e-6
    assert numbers["B"] == pytest.approx(4e-6, abs=1e-12)
    assert numbers["M"] == pytest.approx(10e-6, abs=1e-12)
    assert numbers["E"] == pytest.approx(14e-6, abs=1e-12)
    assert numbers["E_forward"] == pytest.approx(10e-6, abs=1e-12)
    assert numbers["R_forward"] == pytest.approx(4 * 2 * s, rel=1e-9)
    assert numbers["R"] == pytest.approx(4 * 2 * s + 4e-6, rel=1e-9)
    assert numbers["A"] == pytest.approx(12e-6 + 2 * 2 * s - (-2e-6 - 2 * s), rel=1e-9)
    assert numbers["A_forward"] == pytest.approx(8e-6 + 2 * 2 * s - (-2e-6 - 2 * s), rel=1e-9)


@pytest.mark.parametrize("axis", [1, 2])
def test_published_table(axis: int) -> None:
    file = SHARED / "iso230" / f"axis_{axis}.csv"
    file = file if file.is_file() else SHARED / "data" / "iso230" / f"axis_{axis}.csv"
    if not file.is_file():
        pytest.skip("no ../shared/data/iso230 beside this repository")
    numbers = positioning(read_positions(file)[0]).numbers
    for name, printed in PRINTED[axis].items():
        assert numbers[name] * 1e3 == pytest.approx(printed, rel=1e-3), name
    for name, (printed, standard) in WRONG[axis].items():
        assert numbers[name] * 1e3 == pytest.approx(standard, rel=1e-3), name
        # the printed value is impossible: the range of both directions cannot be below that of one
        lowest = max(numbers[f"{name}_forward"], numbers[f"{name}_backward"]) * 1e3
        assert printed < lowest * (1.0 + 1e-3)


def test_standstills_of_a_run() -> None:
    """Two positions, three cycles, approached from both sides; the scale reads 3 um less from below."""
    stops = [0.0, *([0.1, 0.2, 0.3, 0.2, 0.1, 0.0] * 3)]
    setpoint, position = [np.zeros(500)], [np.zeros(500)]
    for before, after in itertools.pairwise(stops):
        way = np.concatenate([np.linspace(before, after, 201)[1:], np.full(500, after)])
        setpoint.append(way)
        position.append(way - (3e-6 if after > before else 0.0))
    s, x = np.concatenate(setpoint), np.concatenate(position)
    trace = Trace(np.arange(len(s)) * 1e-3, {("X", "setpoint"): s, ("X", "position"): x}, {"X": "linear"})
    readings = positions_of_trace(trace, "X", "run")
    np.testing.assert_allclose(readings.target, [0.1, 0.2], atol=1e-9)
    assert readings.forward.shape == readings.backward.shape == (2, 3)
    numbers = positioning(readings).numbers
    assert numbers["B"] == pytest.approx(3e-6, abs=1e-10)
    assert numbers["R"] == pytest.approx(3e-6, abs=1e-9)


def test_command_writes_the_numbers(tmp_path: Path) -> None:
    assert main(["iso", "230-2", str(EXAMPLE), "--json", str(tmp_path / "iso.json")]) == 0
    document = json.loads((tmp_path / "iso.json").read_text())
    jsonschema.validate(document, json.loads((ROOT / "twin" / "report" / "schemas" / "iso230.json").read_text()))
    assert document["unit"] == "mm"
    assert document["B"] == pytest.approx(0.004)
    assert (tmp_path / "iso.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("direction,position,cycle,target_mm,measured_mm\nup,1,1,0,0\n", "line 2: direction 'up'; write forward or backward"),
        ("direction,position,cycle,target_mm,measured_mm\nforward,1,1,0,x\n", "line 2: measured_mm holds 'x'"),
        ("direction,position,cycle,target_mm,measured_mm\n", "the table is empty"),
        ("direction,position,cycle,target_mm,measured_mm\nforward,1,1,0,0\n", "not every target has a backward reading"),
        ("direction,position,cycle,goal,measured_mm\nforward,1,1,0,0\n", "no column 'target_mm'"),
    ],
)
def test_bad_tables(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "table.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=says):
        positioning(read_positions(tmp_path / "table.csv")[0])


def test_one_cycle_has_no_spread() -> None:
    with pytest.raises(InputError, match="one cycle"):
        positioning(Readings(np.arange(3.0), np.zeros((3, 1)), np.zeros((3, 2))))
