"""`twin cut` from a trace to files, and its messages for bad input."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import re

import numpy as np
import pytest

from tests.builders.grooves import PART, groove_trace
from twin.cli import cut
from twin.cli.arguments import add_arguments
from twin.errors import InputError
from twin.recordings.trace import Trace, read_trace, write_trace
from twin.surface.mesh import read_mesh
from twin.surface.part import part_from_document, read_part


def groove(folder: Path, *, jump: float = 0.0, z: float = 300.0) -> list[str]:
    """Arguments that cut the groove: its trace and a part file at its height."""
    write_trace(groove_trace(jump), folder / "trace.parquet")
    (folder / "part.toml").write_text(PART.format(z=z), encoding="utf-8")
    return [str(folder), "--part", str(folder / "part.toml"), "--out", str(folder / "out")]


def run(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser()
    add_arguments(parser, cut)
    return cut.carry_out(parser.parse_args(arguments)) or 0


def test_cut_writes_everything(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(groove(tmp_path)) == 0
    result = json.loads((tmp_path / "out" / "cut.json").read_text())
    followed = next(c for c in result["cuts"] if c["level"] == "followed")
    assert followed["deviation_um"]["min"] == pytest.approx(-20.0, abs=0.1)
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert {
        "plane_followed.png",
        "plane_followed.ply",
        "plane_followed.stl",
        "plane_followed.npz",
        "plane_followed.csv",
        "plane_levels.png",
        "cut.rrd",
    } <= names
    stored = np.load(tmp_path / "out" / "plane_followed.npz")
    assert stored["height"].shape == (len(stored["v"]), len(stored["u"]))
    assert stored["height"].min() == pytest.approx(-20e-6, abs=1e-7)
    import trimesh

    mesh = trimesh.load(tmp_path / "out" / "plane_followed.ply", process=False)
    assert mesh.vertices[:, 2].min() == pytest.approx(300.0 - 0.020, abs=1e-3)
    assert len(np.unique(mesh.visual.vertex_colors, axis=0)) > 10
    said = capsys.readouterr().out
    assert re.search(r"^followed.*: contour [\d.]+ um, orientation \d[\d.]* arcsec", said, re.M)
    assert "-0.00" not in said


def test_path_that_never_touches(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"never touches it.*check \[placement\]"):
        run(groove(tmp_path, z=250.0))


def test_poses_with_a_gap(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"jumps by 80 mm between two samples at 1\.499 s"):
        run(groove(tmp_path, jump=0.08))


def test_bad_words(tmp_path: Path) -> None:
    arguments = groove(tmp_path)
    with pytest.raises(InputError, match="did you mean 'followed'"):
        run([*arguments, "--level", "folowed"])
    with pytest.raises(InputError, match="feedforward"):
        run([*arguments, "--feedforward", "on"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"no trace\.parquet"):
        run([str(tmp_path / "empty"), *arguments[1:]])
    with pytest.raises(InputError, match="no programmed path, this trace holds the commanded and the followed one; give --level commanded"):
        run([*arguments, "--level", "programmed"])


def test_a_trace_without_positions_has_no_followed_path(tmp_path: Path) -> None:
    arguments = groove(tmp_path)
    trace = read_trace(tmp_path / "trace.parquet")
    signals = {key: values for key, values in trace.signals.items() if key[1] == "setpoint"}
    write_trace(Trace(trace.time, signals, trace.kinds), tmp_path / "trace.parquet")
    with pytest.raises(InputError, match="no followed path, this trace holds the commanded one; give --level commanded"):
        run([*arguments, "--level", "followed"])


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[tool]", "[tol]", "unknown key 'tol'; did you mean 'tool'"),
        ('kind = "plane"', 'kind = "plain"', "did you mean 'plane'"),
        ("spacing_mm = 0.2", "spacing = 0.2", "unknown key 'spacing'; did you mean 'spacing_mm'"),
        ("diameter_mm = 10", "diameter_mm = 1000\ncutting_length_mm = 600", "larger than the part.*check the units"),
        ("across_mm = [-1, 1]", "", "'?across_mm'? is missing"),
        ("zone_um = 50", "zone_um = 50\nzone_along_mm = [3, 1]", "must be less than the second"),
        ("allowance_mm = 0.05", "allowance_mm = 'thick'", "allowance_mm = 'thick'; give a number"),
        ("[tool]", "[tool", "not a valid TOML"),
    ],
)
def test_bad_part_files(tmp_path: Path, old: str, new: str, says: str) -> None:
    file = tmp_path / "part.toml"
    file.write_text(PART.format(z=300).replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=says):
        read_part(file)


def test_too_many_rays(tmp_path: Path) -> None:
    file = tmp_path / "part.toml"
    file.write_text(PART.format(z=300).replace("spacing_mm = 0.2", "spacing_mm = 0.001"), encoding="utf-8")
    part = read_part(file)
    with pytest.raises(InputError, match="rays at 1 um"):
        part.surfaces[0].rays(part.placed, part.allowance)


def test_meshes_are_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import trimesh

    box = trimesh.creation.box((40.0, 30.0, 20.0))
    box.export(tmp_path / "box.stl")
    mesh, said = read_mesh(tmp_path / "box.stl", None, closed=True)
    assert "unit guessed as mm" in said
    assert np.ptp(mesh.vertices, axis=0).max() == pytest.approx(0.04)
    in_metres = trimesh.creation.box((0.04, 0.03, 0.02))
    in_metres.export(tmp_path / "metres.stl")
    assert "unit guessed as m (" in read_mesh(tmp_path / "metres.stl", None, closed=True)[1]
    open_box = trimesh.Trimesh(box.vertices, box.faces[1:])
    open_box.export(tmp_path / "open.ply")
    with pytest.raises(InputError, match=r"not watertight .3 open edges."):
        read_mesh(tmp_path / "open.ply", "mm", closed=True)
    assert "not watertight" in read_mesh(tmp_path / "open.ply", "mm", closed=False)[1]
    trimesh.creation.box((4e7, 1.0, 1.0)).export(tmp_path / "huge.obj")
    with pytest.raises(InputError, match="is not plausible in any of"):
        read_mesh(tmp_path / "huge.obj", None, closed=True)
    (tmp_path / "rubbish.stl").write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match=r"rubbish\.stl"):
        read_mesh(tmp_path / "rubbish.stl", None, closed=True)
    with pytest.raises(InputError, match="give one of"):
        read_mesh(tmp_path / "part.step", None, closed=True)


def test_mesh_as_nominal_part_and_as_stock(tmp_path: Path) -> None:
    import trimesh

    arguments = groove(tmp_path)
    corners = np.array([[-10, -1, 0], [10, -1, 0], [10, 1, 0], [-10, 1, 0]], float)
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]).export(tmp_path / "nominal.stl")
    trimesh.creation.box(bounds=[[-11, -2, -6], [11, 2, 0.04]]).export(tmp_path / "stock.stl")
    text = PART.format(z=300)
    text = text.replace("allowance_mm = 0.05", 'mesh = "stock.stl"\nunit = "mm"')
    text = (
        text[: text.index("[[surface]]")]
        + '[[surface]]\nname = "part"\nkind = "mesh"\nfile = "nominal.stl"\nunit = "mm"\nspacing_mm = 0.5\n'
    )
    (tmp_path / "part.toml").write_text(text, encoding="utf-8")
    assert run(arguments) == 0
    result = json.loads((tmp_path / "out" / "cut.json").read_text())
    assert result["cuts"][-1]["deviation_um"]["min"] == pytest.approx(-20.0, abs=0.1)
    assert result["cuts"][-1]["deviation_um"]["max"] < 100.0


def test_missing_values_of_a_mark_on_a_mesh_are_null(tmp_path: Path) -> None:
    """The commanded path against the programmed one on a mesh: no width, length or place along u and v, and cut.json is JSON."""
    import trimesh

    corners = np.array([[-3, -0.2, 0], [3, -0.2, 0], [3, 0.2, 0], [-3, 0.2, 0]], float)
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]).export(tmp_path / "nominal.stl")
    text = PART.format(z=300)[: PART.format(z=300).index("[[surface]]")]
    text += '[[surface]]\nname = "part"\nkind = "mesh"\nfile = "nominal.stl"\nunit = "mm"\nspacing_mm = 0.2\n'
    (tmp_path / "part.toml").write_text(text, encoding="utf-8")
    (tmp_path / "line.mpf").write_text("G17 G71 G90 G94\nG0 X-5 Y0 Z0 A0 C0\nG1 X5 F2000\nM30\n", encoding="utf-8")
    levels = ["--level", "programmed", "--level", "commanded", "--no-files"]
    arguments = [str(tmp_path / "line.mpf"), "--part", str(tmp_path / "part.toml"), "--out", str(tmp_path / "out")]
    assert run([*arguments, *levels]) == 0
    written = (tmp_path / "out" / "cut.json").read_text(encoding="utf-8")
    result = json.loads(written, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    mark = result["cuts"][1]["mark"]
    assert [mark[key] for key in ("width_mm", "length_mm", "u_mm", "v_mm")] == [None] * 4
    assert mark["depth_um"] == pytest.approx(0.0, abs=0.1)


def test_part_needs_surfaces(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'surface' is missing; write \[\[surface\]\]"):
        part_from_document({"tool": {"kind": "ball", "diameter_mm": 10}}, tmp_path, "part.toml")
