"""Model files of other people: what is unsafe or no tree of axes is refused in one line that says what and where."""

from __future__ import annotations

from pathlib import Path
import shutil

import pytest

from tests.builders.other_structures import MJCF, machine_text, write_slides
from twin.errors import InputError
from twin.machine.machine import load_machine, write_machine
from twin.machine.model_file import check_mjcf, check_urdf, files_of
from twin.simulation.plant_spec import build_plant

ROOT = Path(__file__).resolve().parents[2]
BOMB = '<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "&{a};&{a};&{a};&{a};&{a};&{a};&{a};&{a};">' for a, b in zip("abcdefgh", "bcdefghi")
)
CARRIAGE = '<inertial pos="0 0 0" mass="90" diaginertia="1 1 1"/>\n      <joint name="X" type="slide" axis="1 0 0"/>'


def mjcf(old: str, new: str) -> str:
    assert old in MJCF
    return MJCF.replace(old, new, 1)


BAD_MJCF = {
    "XML bomb": (BOMB + "]>" + MJCF, "a document type"),
    "external entity": (f'<!DOCTYPE m [<!ENTITY x SYSTEM "file:///etc/hostname">]>{mjcf("slides", "&x;")}', "a document type"),
    "no XML": ("<mujoco><worldbody></mujoco>", "no readable XML"),
    "another root": ("<robot/>", "twin machine new"),
    "free joint": (mjcf(CARRIAGE, CARRIAGE.replace('type="slide" axis="1 0 0"', 'type="free"')), "body 'carriage' is free"),
    "freejoint element": (mjcf(CARRIAGE, '<inertial pos="0 0 0" mass="90" diaginertia="1 1 1"/><freejoint name="X"/>'), "is free"),
    "ball joint": (mjcf('name="X" type="slide" axis="1 0 0"', 'name="X" type="ball"'), "ball joint"),
    "closed loop": (
        mjcf("</worldbody>", '</worldbody><equality><connect body1="carriage" body2="arm" anchor="0 0 0"/></equality>'),
        "closes a loop of bodies",
    ),
    "tied joints": (mjcf("</worldbody>", '</worldbody><equality><joint joint1="X" joint2="Z"/></equality>'), "ties joints together"),
    "negative mass": (mjcf('mass="90"', 'mass="-90"'), "mass = -90 is impossible"),
    "no mass": (mjcf('mass="90"', 'mass="0"'), "mass = 0 is impossible"),
    "mass no number": (mjcf('mass="90"', 'mass="heavy"'), "'heavy' is no number"),
    "negative inertia": (mjcf('diaginertia="1 1 1"', 'diaginertia="1 -1 1"'), "diaginertia = -1 is impossible"),
    "mesh missing": (mjcf("<worldbody>", '<asset><mesh name="m" file="none.stl"/></asset><worldbody>'), "no file 'none.stl'"),
    "mesh elsewhere": (
        mjcf("<worldbody>", '<asset><mesh name="m" file="../../etc/x.stl"/></asset><worldbody>'),
        "leaves the machine's folder",
    ),
    "mesh folder elsewhere": (
        mjcf('<compiler angle="radian"', '<compiler meshdir="/etc" angle="radian"').replace(
            "<worldbody>", '<asset><mesh name="m" file="hostname"/></asset><worldbody>', 1
        ),
        "leaves the machine's folder",
    ),
    "include elsewhere": (mjcf("<worldbody>", '<include file="/etc/hostname"/><worldbody>'), "leaves the machine's folder"),
    "include of itself": (mjcf("<worldbody>", '<include file="slides.xml"/><worldbody>'), "includes itself"),
    "plugin": (mjcf("<worldbody>", '<extension><plugin plugin="mujoco.pid"/></extension><worldbody>'), "code from elsewhere"),
    "two joints of a name": (mjcf('name="Z" type', 'name="X" type'), "two joints are named 'X'"),
}


@pytest.mark.parametrize("case", BAD_MJCF)
def test_bad_mjcf(tmp_path: Path, case: str) -> None:
    text, message = BAD_MJCF[case]
    file = write_slides(tmp_path, machine_text("X"))
    (tmp_path / "slides.xml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message.replace("'", ".")) as error:
        load_machine(file)
    assert "slides.xml" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_moving_body_without_mass(tmp_path: Path) -> None:
    file = write_slides(tmp_path, machine_text("XB"))
    (tmp_path / "slides.xml").write_text(mjcf('<inertial pos="0 0 0" mass="5" diaginertia="0.1 0.1 0.2"/>', ""), encoding="utf-8")
    with pytest.raises(InputError, match="mass and inertia of moving bodies"):
        build_plant(load_machine(file))


def test_kind_and_joint_disagree(tmp_path: Path) -> None:
    file = write_slides(tmp_path, machine_text("XZB"))
    (tmp_path / "slides.xml").write_text(mjcf('name="B" type="hinge"', 'name="B" type="slide"'), encoding="utf-8")
    with pytest.raises(InputError, match=r"axis B is rotary, its joint in slides\.xml is a slide"):
        build_plant(load_machine(file))


def test_model_outside_the_folder(tmp_path: Path) -> None:
    (tmp_path / "inside").mkdir()
    file = write_slides(tmp_path, machine_text("X").replace("slides.xml", "../slides.xml"))
    shutil.move(file, tmp_path / "inside" / "m.toml")
    with pytest.raises(InputError, match="leaves the machine's folder"):
        load_machine(tmp_path / "inside" / "m.toml")


URDF = """<robot name="r"><link name="bed"/>
<link name="a"><inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link><link name="b"/>
<joint name="x" type="prismatic"><parent link="bed"/><child link="a"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="y" type="fixed"><parent link="a"/><child link="b"/></joint></robot>"""
BAD_URDF = {
    "XML bomb": (BOMB + "]>" + URDF, "a document type"),
    "floating": (URDF.replace('"prismatic"', '"floating"'), "joint 'x' is floating"),
    "circle": (URDF.replace('parent link="bed"', 'parent link="b"'), "form a circle"),
    "two parents": (
        URDF.replace('type="fixed"><parent link="a"/><child link="b"/>', 'type="fixed"><parent link="b"/><child link="a"/>'),
        "two joints",
    ),
    "link missing": (URDF.replace('parent link="bed"', 'parent link="bad"'), "link 'bad', which does not exist"),
    "negative mass": (URDF.replace('mass value="2"', 'mass value="-2"'), "mass = -2 is impossible"),
    "mimic": (URDF.replace('<axis xyz="1 0 0"/>', '<axis xyz="1 0 0"/><mimic joint="y"/>'), "mimic"),
    "mesh elsewhere": (
        URDF.replace('<link name="b"/>', '<link name="b"><visual><geometry><mesh filename="../b.stl"/></geometry></visual></link>'),
        "leaves the machine's folder",
    ),
    "mesh missing": (
        URDF.replace('<link name="b"/>', '<link name="b"><visual><geometry><mesh filename="b.stl"/></geometry></visual></link>'),
        "no file 'b.stl'",
    ),
}


@pytest.mark.parametrize("case", BAD_URDF)
def test_bad_urdf(tmp_path: Path, case: str) -> None:
    text, message = BAD_URDF[case]
    (tmp_path / "r.urdf").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message.replace("'", ".")) as error:
        check_urdf(tmp_path / "r.urdf")
    assert "\n" not in str(error.value)


def test_good_files_pass() -> None:
    for name in ("mikron_ucp710.xml", "scene.xml"):
        assert check_mjcf(ROOT / "models" / name).tag == "mujoco"
    assert files_of(ROOT / "models" / "scene.xml") == [Path("mikron_ucp710.xml")]
    assert check_urdf(ROOT / "examples" / "gantry" / "gantry.urdf").tag == "robot"


def test_meshes_and_includes_are_copied_with_a_machine(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    shutil.copy(ROOT / "examples" / "gantry" / "spindle.stl", tmp_path / "meshes" / "plate.stl")
    file = write_slides(tmp_path, machine_text("X"))
    text = mjcf("<worldbody>", '<asset><mesh name="m" file="plate.stl" scale="1e-3 1e-3 1e-3"/></asset><worldbody>')
    text = text.replace('<compiler angle="radian"', '<compiler meshdir="meshes" angle="radian"')
    (tmp_path / "slides.xml").write_text(text.replace(CARRIAGE, CARRIAGE + '<geom type="mesh" mesh="m"/>'), encoding="utf-8")
    write_machine(load_machine(file), tmp_path / "copy" / "m.toml")
    assert (tmp_path / "copy" / "meshes" / "plate.stl").is_file()
    build_plant(load_machine(tmp_path / "copy" / "m.toml"))


def test_a_model_made_for_something_else_runs_as_a_machine(tmp_path: Path) -> None:
    """Position servos, contacts, another integrator and masses from shapes are brought to what the twin needs."""
    text = mjcf('<option integrator="Euler" solver="PGS" tolerance="1e-12"/>', '<option integrator="implicitfast" solver="Newton"/>')
    text = text.replace('    <joint solreffriction="0.0005 1" solimpfriction="0.9999 0.9999 0.001"/>\n', "").replace(
        'inertiafromgeom="false"', ""
    )
    text = text.replace('<inertial pos="0 0 0" mass="90" diaginertia="1 1 1"/>', '<geom type="box" size="0.1 0.2 0.1" density="5000"/>')
    text = text.replace("</worldbody>", '</worldbody><actuator><position name="servo" joint="X" kp="1000"/></actuator>')
    file = write_slides(tmp_path, machine_text("X"))
    expected = build_plant(load_machine(file)).model
    (tmp_path / "slides.xml").write_text(text, encoding="utf-8")
    model = build_plant(load_machine(file)).model
    assert model.nu == 1
    assert model.actuator_biastype[0] == 0
    for name in ("body_mass", "dof_solref", "dof_solimp"):
        assert getattr(model, name)[-1] == pytest.approx(getattr(expected, name)[-1]), name
    for name in ("integrator", "solver", "tolerance", "disableflags"):
        assert getattr(model.opt, name) == getattr(expected.opt, name), name
