"""Part files: every shape is read, and each error is one line with file, table, key and remedy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin.errors import InputError
from twin.surface.part import read_part
from twin.surface.shapes import MeshSurface

TOOL = '[tool]\nkind = "ball"\ndiameter_mm = 1\n'
OUTLINE = '[tool]\nkind = "revolution"\nprofile_mm = [[0, 0], [1, 1], [1, 5]]\n'
PROFILE = '[[surface]]\nkind = "profile"\nplane = "xz"\nstart_mm = [0, 0]\nsegments = [{ length_mm = 5 }]\nacross_mm = [0, 20]\n'
PLANE = '[[surface]]\nkind = "plane"\nalong_mm = [0, 20]\nacross_mm = [-1, 1]\n'
SPHERE = '[[surface]]\nkind = "sphere"\ncentre_mm = [0, 0, 0]\nradius_mm = 10\nazimuth_deg = [0, 90]\npolar_deg = [10, 60]\n'
MESH = '[[surface]]\nkind = "mesh"\nfile = "part.stl"\n'
ACROSS = "across_mm = [-1, 1]"
LINE = "{ length_mm = 5 }"

FAULTS = {
    "no plane": (TOOL + PROFILE, 'plane = "xz"', "", r"\[\[surface\]\] 1: 'plane' is missing; add it"),
    "unknown plane": (TOOL + PROFILE, '"xz"', '"zx"', "plane = 'zx'; use one of xz, xy, yz"),
    "short start": (TOOL + PROFILE, "[0, 0]", "[0]", r"start_mm = \[0\]; give a list of 2 numbers"),
    "heading of text": (TOOL + PROFILE, 'plane = "xz"', 'plane = "xz"\nheading_deg = "a"', "heading_deg = 'a'; give a number"),
    "no segments": (TOOL + PROFILE, f"segments = [{LINE}]", "", "'segments' is missing; add it"),
    "segments no list": (TOOL + PROFILE, f"[{LINE}]", "5", "segments = 5; write \\[\\[segments"),
    "segments empty": (TOOL + PROFILE, f"[{LINE}]", "[]", "none has a length"),
    "corners only": (TOOL + PROFILE, LINE, "{ turn_deg = 90 }", "none has a length"),
    "segment of text": (TOOL + PROFILE, LINE, '"x"', "segments 1: 'x' is not a table"),
    "segment's key": (TOOL + PROFILE, LINE, "{ lenght_mm = 5 }", "segments 1: unknown key 'lenght_mm'; did you mean 'length_mm'"),
    "segment backwards": (TOOL + PROFILE, LINE, "{ length_mm = -5 }", "segments 1: length_mm = -5; give a number above 0"),
    "line and arc": (
        TOOL + PROFILE,
        LINE,
        "{ length_mm = 5, turn_deg = 3 }",
        "give length_mm for a line, radius_mm and turn_deg for an arc",
    ),
    "arc without turn": (TOOL + PROFILE, LINE, "{ radius_mm = 5 }", "give length_mm for a line, radius_mm and turn_deg for an arc"),
    "radius below 0": (TOOL + PROFILE, LINE, "{ radius_mm = -5, turn_deg = 9 }", "radius_mm = -5; give 0 or more"),
    "one limit": (TOOL + PLANE, ACROSS, "across_mm = [0]", r"across_mm = \[0\]; give a list of 2 numbers"),
    "limits of text": (TOOL + PLANE, ACROSS, 'across_mm = "20"', "across_mm = '20'; give a list of 2 numbers"),
    "limits of texts": (TOOL + PLANE, ACROSS, 'across_mm = ["0", "2"]', "give a list of 2 numbers"),
    "limits reversed": (TOOL + PLANE, "[0, 20]", "[20, 0]", r"along_mm = \[20.0, 0.0\]: the first number must be less than the second"),
    "no direction": (TOOL + PLANE, ACROSS, f"{ACROSS}\nu_direction = [0, 0, 0]", "u_direction = .* span no plane; give two directions"),
    "one direction": (TOOL + PLANE, ACROSS, f"{ACROSS}\nu_direction = [0, 2, 0]", "v_direction = .* span no plane; give two directions"),
    "origin of text": (TOOL + PLANE, ACROSS, f'{ACROSS}\norigin_mm = "a"', "origin_mm = 'a'; give a list of 3 numbers"),
    "zone of texts": (TOOL + PLANE, ACROSS, f'{ACROSS}\nzone_along_mm = ["1", "2"]', "zone_along_mm = .*; give a list of 2 numbers"),
    "no centre": (TOOL + SPHERE, "centre_mm = [0, 0, 0]", "", "'centre_mm' is missing; add it"),
    "flat centre": (TOOL + SPHERE, "centre_mm = [0, 0, 0]", "centre_mm = [0, 0]", "give a list of 3 numbers"),
    "sphere inside out": (TOOL + SPHERE, "radius_mm = 10", "radius_mm = -10", "radius_mm = -10; give a number above 0"),
    "polar reversed": (TOOL + SPHERE, "[10, 60]", "[60, 10]", "polar_deg = .* the first number must be less than the second"),
    "polar over the pole": (TOOL + SPHERE, "[10, 60]", "[-60, 60]", "polar_deg = .* give angles from 0"),
    "polar of text": (TOOL + SPHERE, "[10, 60]", '"ab"', "polar_deg = 'ab'; give a list of 2 numbers"),
    "no file": (TOOL + MESH, 'file = "part.stl"', "", "'file' is missing; add it"),
    "file is a number": (TOOL + MESH, '"part.stl"', "5", "file = 5; write it in quotes"),
    "file is not there": (TOOL + MESH, "part.stl", "prat.stl", "file: 'prat.stl': no such file"),
    "unit is a number": (TOOL + MESH, '"part.stl"', '"part.stl"\nunit = 5', "unit = 5; write it in quotes"),
    "stock is not there": (TOOL + PLANE, "[tool]", '[stock]\nmesh = "none.stl"\n[tool]', r"\[stock\]: mesh: 'none.stl': no such file"),
    "rotation of text": (
        TOOL + PLANE,
        "[tool]",
        '[placement]\nrotation_deg = "a"\n[tool]',
        r"\[placement\]: rotation_deg = 'a'; give a number",
    ),
    "notes no list": (TOOL + PLANE, "[tool]", "notes = 5\n[tool]", "notes = 5; write notes ="),
    "tool no table": (TOOL + PLANE, TOOL, "tool = 5\n", r"\[tool\]: kind is missing; known are: ball"),
    "outline of halves": (
        OUTLINE + PLANE,
        "[[0, 0], [1, 1], [1, 5]]",
        "[[1], [2]]",
        r"\[tool\]: profile_mm = \[\[1\], \[2\]\]; give a list of \[radius, height\]",
    ),
    "outline of text": (OUTLINE + PLANE, "[[0, 0], [1, 1], [1, 5]]", '"12"', "profile_mm = '12'; give a list of"),
    "outline of texts": (OUTLINE + PLANE, "[1, 1]", '["1", "1"]', "profile_mm = .*; give a list of"),
    "outline without end": (OUTLINE + PLANE, "[1, 1]", "[1, nan]", "profile_mm = .*; give a list of"),
    "arc over nothing": (
        OUTLINE + PLANE,
        "[1, 1]",
        "[0, 0, 2]",
        r"\[tool\]: .* arc of radius 2 mm does not reach over 0 mm; give it two different ends",
    ),
    "outline that falls": (OUTLINE + PLANE, "[1, 5]", "[1, 0.5]", r"\[tool\]: .* non-decreasing heights"),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a mesh that a part can name."""
    import trimesh

    trimesh.creation.box((20.0, 20.0, 20.0)).export(tmp_path / "part.stl")
    return tmp_path


@pytest.mark.parametrize("text", [TOOL + PROFILE, TOOL + PLANE, TOOL + SPHERE, TOOL + MESH, OUTLINE + PLANE])
def test_each_shape_has_rays_along_unit_normals(folder: Path, text: str) -> None:
    (folder / "part.toml").write_text(text, encoding="utf-8")
    part = read_part(folder / "part.toml")
    rays = part.surfaces[0].rays(part.placed, part.allowance)
    assert len(rays) > 50
    np.testing.assert_allclose(np.linalg.norm(rays.direction, axis=1), 1.0, atol=1e-9)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_part_file_gives_one_line(folder: Path, fault: str) -> None:
    right, old, new, says = FAULTS[fault]
    text = right.replace(old, new)
    assert text != right
    (folder / "part.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=says) as told:
        read_part(folder / "part.toml")
    assert str(told.value).startswith(str(folder / "part.toml"))
    assert "\n" not in str(told.value)


def test_meshes_of_a_part_can_lie_elsewhere(folder: Path) -> None:
    (folder / "part.toml").write_text('[stock]\nmesh = "part.stl"\n' + TOOL + MESH + PLANE, encoding="utf-8")
    part = read_part(folder / "part.toml")
    assert part.files == (folder / "part.stl",)
    moved = part.with_files({folder / "part.stl": Path("/elsewhere/1.stl")})
    assert moved.files == (Path("/elsewhere/1.stl"),)
    assert moved.stock == (Path("/elsewhere/1.stl"), None)
    assert isinstance(moved.surfaces[0], MeshSurface)
    assert moved.surfaces[0].file == str(Path("/elsewhere/1.stl"))
    assert moved.surfaces[1] == part.surfaces[1]


def test_two_surfaces_of_one_name_are_refused(tmp_path: Path) -> None:
    (tmp_path / "part.toml").write_text(TOOL + PLANE + 'name = "wall"\n' + PLANE + 'name = "wall"\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"two of \[\[surface\]\] have the name 'wall'"):
        read_part(tmp_path / "part.toml")
