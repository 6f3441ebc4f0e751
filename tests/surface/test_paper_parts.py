"""The paper's three parts in examples/parts: each can be cut at every level."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import pytest

from examples.parts.paper_parts import PARTS, Dome
from tests.conftest import ROOT
from twin.cli import cut
from twin.cli.arguments import add_arguments
from twin.machine.machine import Machine, load_machine
from twin.program import read_program

SHIPPED = ROOT / "examples" / "parts"


@pytest.mark.parametrize("name", list(PARTS))
def test_the_examples_equal_the_output_of_the_generator(name: str) -> None:
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
    """cut.json of `twin cut` on an example, on the machine with the paper's assumptions, with coarse zones."""
    parser = argparse.ArgumentParser()
    add_arguments(parser, cut)
    files = [str(SHIPPED / f"{name}.mpf"), "--part", str(SHIPPED / f"{name}.toml"), "--out", str(folder), "--zone-um", "100", "--no-files"]
    machine = ["--machine", str(ROOT / "models" / "mikron_ucp710_paper.toml")]
    cut.carry_out(parser.parse_args([*files, *machine]))
    return json.loads((folder / "cut.json").read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "paper"),
    [("part1_tangent_planes", {"fast": 20.0}), ("part2_vertical_corner", {"fast": 30.0, "slow": 5.0}), ("part3_dome", {})],
)
def test_every_part_is_cut_at_every_level(tmp_path: Path, name: str, paper: dict[str, float]) -> None:
    """Programmed, commanded, followed with and without feedforward; the marks are the paper's within 10 %, the rotary axes within 0.0005 degrees."""
    cuts = {(c["level"], c["feedforward"]): c for c in cut_as_it_ships(name, tmp_path)["cuts"]}
    assert set(cuts) == {("programmed", ""), ("commanded", ""), ("followed", "velocity+torque"), ("followed", "off")}
    assert all(c["untouched"] < c["rays"] for c in cuts.values())
    for speed, depth in paper.items():
        assert -cuts["followed", "off"][f"against_programmed_{speed}_um"]["min"] == pytest.approx(depth, rel=0.10)
    if name == "part3_dome":
        errors = cuts["followed", "velocity+torque"]["errors"]
        assert max(errors[f"{axis}_deviation_rms_deg"] for axis in ("A", "C")) < 0.0005


def test_the_variant_changes_only_the_named_dimensions(mikron: Machine) -> None:
    """The file differs from the nominal one only in gain and feedforward of every axis, jerk of Z, and name."""
    variant = load_machine(ROOT / "models" / "mikron_ucp710_paper.toml")

    def flat(table: Any, path: str = "") -> dict[str, Any]:
        if not isinstance(table, dict):
            return {path: table}
        return {k: v for key, value in table.items() for k, v in flat(value, f"{path}.{key}" if path else key).items()}

    ours, theirs = flat(variant.document), flat(mikron.document)
    changed = {key for key in ours | theirs if ours.get(key) != theirs.get(key)}
    loops = {f"axis.{a}.loops.{k}" for a in "XYZAC" for k in ("position_gain_per_s", "velocity_feedforward", "torque_feedforward")}
    assert changed == {"name", "axis.Z.max_jerk_m_per_s3", *loops}
    assert variant.model_path == mikron.model_path
