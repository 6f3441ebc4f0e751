"""The recording of a cut: machine, path and surface in one view, a tab for each level, the relief magnified, a scale with its unit."""

from pathlib import Path

import numpy as np
import pytest

from tests.builders.grooves import PART, groove_trace
from tests.builders.recording_read import Rows, read_layout, read_recording
from tests.replay.test_recording import check_layout
from twin.machine.machine import load_machine
from twin.replay.cut import LEAST_SIZE, MESH_VERTICES, write_cut
from twin.surface.levels import levels_of_trace
from twin.surface.machining import Machining, machine_part
from twin.surface.part import read_part

PART_FRAME = "/machine/cradle/table/workpiece/part_frame"


@pytest.fixture(scope="module")
def machining(tmp_path_factory: pytest.TempPathFactory) -> Machining:
    """A slow pass and one 20 um deeper, cut by set points and by positions."""
    file = tmp_path_factory.mktemp("part") / "part.toml"
    file.write_text(PART.format(z=300.0), encoding="utf-8")
    part = read_part(file)
    return machine_part(part, levels_of_trace(groove_trace(), load_machine(), part.tool, ["commanded", "followed"], "groove"))


@pytest.fixture(scope="module")
def file(machining: Machining, tmp_path_factory: pytest.TempPathFactory) -> Path:
    write_cut(path := tmp_path_factory.mktemp("cut") / "cut.rrd", load_machine(), machining)
    return path


@pytest.fixture(scope="module")
def held(file: Path) -> dict[str, dict[str, Rows]]:
    return read_recording(file)


def vertices(held: dict[str, dict[str, Rows]], path: str) -> np.ndarray:
    return np.array(held[path]["Mesh3D:vertex_positions"].values[0])


def test_each_level_has_a_surface_a_relief_and_a_path(held: dict[str, dict[str, Rows]]) -> None:
    for word in ("surface/plane/commanded", "surface/plane/followed", "relief/plane/followed", "cut_path/commanded", "cut_path/followed"):
        assert f"{PART_FRAME}/{word}" in held, word


def test_the_relief_is_the_surface_with_its_deviation_magnified(machining: Machining, file: Path, held: dict[str, dict[str, Rows]]) -> None:
    one = machining.cuts[-1].finest
    assert len(one) <= MESH_VERTICES
    path = f"{PART_FRAME}/relief/plane/followed"
    titles = [c["ViewBlueprint:display_name"].values[0][0] for c in read_layout(file).values() if "ViewBlueprint:display_name" in c]
    factor = float(next(title for title in titles if title.startswith("Surface, deviation x")).rsplit("x", 1)[1])
    assert factor > 10
    assert np.allclose(vertices(held, path), one.point + factor * one.height[:, None] * one.direction, atol=1e-7)


def test_a_small_surface_is_enlarged_beyond_the_reach_of_the_viewers_eye(machining: Machining, held: dict[str, dict[str, Rows]]) -> None:
    one = machining.cuts[-1].finest
    size = float(np.linalg.norm(np.ptp(one.point, axis=0)))
    relief = held[f"{PART_FRAME}/relief/plane/followed"]
    scale, move = (np.array(relief[f"Transform3D:{word}"].values[0][0], float) for word in ("scale", "translation"))
    assert size < LEAST_SIZE
    assert np.allclose(scale * size, LEAST_SIZE)
    middle = 0.5 * (one.point.min(axis=0) + one.point.max(axis=0))
    assert np.allclose(scale * middle + move, middle, atol=1e-6)


def test_the_scale_has_its_unit(held: dict[str, dict[str, Rows]]) -> None:
    labels = held["/legend/limits"]["Points2D:labels"].values[0]
    assert labels[-1].endswith(" um")
    assert float(labels[0]) == -float(labels[-1].removesuffix(" um").removeprefix("> "))


def test_machine_path_and_surface_share_a_view_and_levels_are_tabs(file: Path) -> None:
    assert check_layout(file) == 7  # machine, numbers, scale, and two views for each of two levels
    layout = read_layout(file)
    queries = ["\n".join(c["ViewContents:query"].values[0]) for c in layout.values() if "ViewContents:query" in c]
    assert any(
        "+ /machine/cradle/**" in query and "/cut_path/followed" in query and f"+ {PART_FRAME}/surface/plane/followed" in query
        for query in queries
    )
    names = [c["ContainerBlueprint:display_name"].values[0][0] for c in layout.values() if "ContainerBlueprint:display_name" in c]
    assert {"plane: commanded", "plane: followed"} <= set(names)


def test_the_machine_moves_along_the_cut(held: dict[str, dict[str, Rows]]) -> None:
    assert len(held["/machine/y_slide/x_slide"]["Transform3D:translation"].values) > 50
    tip = held[f"{PART_FRAME}/tool_point"]["Points3D:positions"]
    assert np.ptp(tip.array[:, 0]) == pytest.approx(24e-3, abs=1e-3)
