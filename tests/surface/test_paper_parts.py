"""The paper's three parts as they ship: every one can be cut, at every level."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT
from twin.cli import cut
from twin.machine.machine import Machine
from twin.program import read_program
from twin.surface.paper_parts import PARTS, Dome

SHIPPED = ROOT / "examples" / "parts"


@pytest.mark.parametrize("name", list(PARTS))
def test_examples_are_what_the_generator_writes(name: str) -> None:
    assert (SHIPPED / f"{name}.mpf").read_text(encoding="utf-8") == PARTS[name].program()
    assert (SHIPPED / f"{name}.toml").read_text(encoding="utf-8") == PARTS[name].part()


def test_every_pass_of_the_dome_stays_on_the_side_that_it_is_approached_on(mikron: Machine, tmp_path: Path) -> None:
    """A and C of the approach blocks are those of the pose; the whole fast pass then lies within A's travel."""
    (tmp_path / "dome.mpf").write_text(Dome(passes=2).program(), encoding="utf-8")
    program = read_program(tmp_path / "dome.mpf", mikron)
    assert program.moves.target[:, 3].max() < 0.0
    # down to the first pose of a pass A and C stay as the approach named them
    down = [i for i in range(1, len(program.moves.target)) if program.moves.target[i - 1, 2] > 0.2 > program.moves.target[i, 2]]
    assert len(down) >= 2
    for i in down:
        assert abs(program.moves.target[i, 3:] - program.starts()[i, 3:]).max() < 1e-6


def cut_as_it_ships(name: str, folder: Path) -> dict[str, Any]:
    """cut.json of `twin cut` on an example, with coarse zones."""
    parser = argparse.ArgumentParser()
    cut.add_arguments(parser)
    files = [str(SHIPPED / f"{name}.mpf"), "--part", str(SHIPPED / f"{name}.toml"), "--out", str(folder), "--zone-um", "100", "--no-files"]
    assert cut.carry_out(parser.parse_args(files)) == 0
    return json.loads((folder / "cut.json").read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "mark_um"), [("part1_tangent_planes", 50.0), ("part2_vertical_corner", 43.0), ("part3_dome", 6.8)])
def test_every_part_is_cut_at_every_level(tmp_path: Path, name: str, mark_um: float) -> None:
    """Programmed, commanded, followed with and without feedforward; without it the fast pass cuts as deep as docs/surface.md says."""
    cuts = {(c["level"], c["feedforward"]): c for c in cut_as_it_ships(name, tmp_path)["cuts"]}
    assert set(cuts) == {("programmed", ""), ("commanded", ""), ("followed", "velocity+torque"), ("followed", "off")}
    assert all(c["untouched"] < c["rays"] for c in cuts.values())
    assert -cuts["followed", "off"]["against_programmed_fast_um"]["min"] == pytest.approx(mark_um, rel=0.04)
    errors = cuts["followed", "velocity+torque"]["errors"]
    if name == "part3_dome":
        assert max(errors[f"{axis}_deviation_rms_deg"] for axis in ("A", "C")) < 0.0005
