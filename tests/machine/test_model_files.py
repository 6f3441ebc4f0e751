"""Model files from unknown sources: unsafe ones, and those that are not a tree of axes, are refused in one line with the place."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import functools
import os
from pathlib import Path
import re
import shutil
import sys
import time
import warnings

import mujoco
import pytest

from tests.builders.other_structures import MJCF, machine_text, write_slides
from tests.builders.refused import refused
from twin.errors import InputError
from twin.geometry.mesh_file import load_mesh
from twin.machine import model_file, model_limits
from twin.machine.machine import load_machine, write_machine
from twin.machine.model_file import check_mjcf, check_safe, files_of, state_of_model
from twin.machine.model_limits import compiles
from twin.machine.new import new_machine
from twin.machine.urdf import check_urdf, shown_urdf
from twin.simulation.plant_spec import build_plant, frames_of_model, load_spec

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
    "no XML": ("<mujoco><worldbody></mujoco>", "not readable XML"),
    "another root": ("<robot/>", "twin machine new"),
    "free joint": (mjcf(CARRIAGE, CARRIAGE.replace('type="slide" axis="1 0 0"', 'type="free"')), "body 'carriage' is free"),
    "freejoint element": (mjcf(CARRIAGE, '<inertial pos="0 0 0" mass="90" diaginertia="1 1 1"/><freejoint name="X"/>'), "is free"),
    "ball joint": (mjcf('name="X" type="slide" axis="1 0 0"', 'name="X" type="ball"'), "ball joint"),
    "closed loop": (
        mjcf("</worldbody>", '</worldbody><equality><connect body1="carriage" body2="arm" anchor="0 0 0"/></equality>'),
        "closes a loop of bodies",
    ),
    "tied joints": (mjcf("</worldbody>", '</worldbody><equality><joint joint1="X" joint2="Z"/></equality>'), "couples joints"),
    "negative mass": (mjcf('mass="90"', 'mass="-90"'), "mass = -90 is impossible"),
    "no mass": (mjcf('mass="90"', 'mass="0"'), "mass = 0 is impossible"),
    "mass no number": (mjcf('mass="90"', 'mass="heavy"'), "'heavy' is not a number"),
    "negative inertia": (mjcf('diaginertia="1 1 1"', 'diaginertia="1 -1 1"'), "diaginertia = -1 is impossible"),
    "mesh missing": (mjcf("<worldbody>", '<asset><mesh name="m" file="none.stl"/></asset><worldbody>'), "'none.stl': no such file"),
    "mesh elsewhere": (
        mjcf("<worldbody>", '<asset><mesh name="m" file="../../etc/x.stl"/></asset><worldbody>'),
        "leaves the folder",
    ),
    "mesh folder elsewhere": (
        mjcf('<compiler angle="radian"', '<compiler meshdir="/etc" angle="radian"').replace(
            "<worldbody>", '<asset><mesh name="m" file="hostname"/></asset><worldbody>', 1
        ),
        "leaves the folder",
    ),
    "include elsewhere": (mjcf("<worldbody>", '<include file="/etc/hostname"/><worldbody>'), "leaves the folder"),
    "include of itself": (mjcf("<worldbody>", '<include file="slides.xml"/><worldbody>'), "includes itself"),
    "plugin": (mjcf("<worldbody>", '<extension><plugin plugin="mujoco.pid"/></extension><worldbody>'), "foreign code"),
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
    with pytest.raises(InputError, match="leaves the folder"):
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
        "leaves the folder",
    ),
    "mesh missing": (
        URDF.replace('<link name="b"/>', '<link name="b"><visual><geometry><mesh filename="b.stl"/></geometry></visual></link>'),
        "'b.stl': no such file",
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


def test_the_state_of_a_model_follows_the_files_of_its_includes(tmp_path: Path) -> None:
    """Including files that an include names only since it was edited."""
    part = '<mujoco><asset><mesh name="m" file="{}.stl"/></asset></mujoco>'
    (tmp_path / "m.xml").write_text('<mujoco><include file="part.xml"/></mujoco>', encoding="utf-8")
    (tmp_path / "part.xml").write_text(part.format("a"), encoding="utf-8")
    for name in "ab":
        (tmp_path / f"{name}.stl").write_text("solid", encoding="utf-8")
    states = [state_of_model(tmp_path / "m.xml")]
    (tmp_path / "part.xml").write_text(part.format("b"), encoding="utf-8")
    states.append(state_of_model(tmp_path / "m.xml"))
    (tmp_path / "b.stl").write_text("another solid", encoding="utf-8")
    states.append(state_of_model(tmp_path / "m.xml"))
    assert len(set(states)) == 3
    assert state_of_model(tmp_path / "m.xml") == states[-1]


def test_a_model_that_changed_just_now_is_read_again_though_its_stamp_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock of a disk may be coarse: two changes within a moment have one stamp."""
    path = tmp_path / "m.xml"
    for age_ns, read_again in ((0, True), (2 * model_file.SETTLED_NS, False)):
        stamp = time.time_ns() - age_ns
        monkeypatch.setattr(model_file, "_known_states", {})
        monkeypatch.setattr(model_file, "_stamps", lambda names, stamp=stamp: ((9, stamp, stamp, 1),))
        path.write_text("<mujoco/>", encoding="utf-8")
        before = state_of_model(path)
        path.write_text("<mujoco >", encoding="utf-8")
        assert (state_of_model(path) != before) == read_again


def test_a_change_of_a_model_is_seen_even_with_the_size_and_time_of_before(tmp_path: Path) -> None:
    model = tmp_path / "m.xml"
    states = []
    for text in ("<mujoco/>", "<MUJOCO/>"):
        model.write_text(text, encoding="utf-8")
        os.utime(model, (1_000_000_000, 1_000_000_000))
        states += [state_of_model(model), state_of_model(model)]
    assert states[0] == states[1] != states[2] == states[3]


def test_a_model_made_for_something_else_runs_as_a_machine(tmp_path: Path) -> None:
    """Position servos, contacts, another integrator and masses from shapes are adapted."""
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


HOSTILE_MJCF = {
    "attaches itself": (
        '<asset><model name="m" file="m.xml"/></asset><worldbody><attach model="m" body="b" prefix="p"/></worldbody>',
        "itself",
    ),
    "replicate": ('<worldbody><replicate count="100000"><geom size="1"/></replicate></worldbody>', "the limit is 2e+04"),
    "replicate of replicate": (
        '<worldbody><replicate count="900"><replicate count="900"><geom size="1"/></replicate></replicate></worldbody>',
        "elements with all copies, the limit is",
    ),
    "height field": ('<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>', "values, the limit is"),
    "texture": ('<asset><texture name="t" type="2d" builtin="flat" width="99999" height="99999"/></asset>', "values, the limit is"),
    "memory": ('<size memory="100G"/>', "bytes of memory, the limit is"),
    "table": ('<custom><numeric name="n" size="2000000000"/></custom>', "values, the limit is"),
    "flexible": ('<worldbody><flexcomp name="f" type="grid" count="900 900 900"/></worldbody>', "the limit is"),
    "flexible of a file": ('<worldbody><flexcomp name="f" type="gmsh" file="../../x.msh"/></worldbody>', "leaves the folder"),
    "joints": (
        f"<worldbody>{'<body><joint/></body>' * 3000}</worldbody>",
        "joints, the limit is",
    ),
    "depth": (f"<worldbody>{'<body>' * 2000}{'</body>' * 2000}</worldbody>", "nested more than"),
    "not a number": ('<worldbody><body pos="nan 0 0"/></worldbody>', "NaN"),
    "builtin mesh": ('<asset><mesh name="m" builtin="torus" params="99999 99999"/></asset>', "corners, the limit is"),
}


@pytest.mark.parametrize("case", HOSTILE_MJCF)
def test_a_model_that_is_too_large(tmp_path: Path, case: str) -> None:
    text, words = HOSTILE_MJCF[case]
    (tmp_path / "m.xml").write_text(f"<mujoco>{text}</mujoco>", encoding="utf-8")
    with pytest.raises(InputError, match=words.replace("+", r"\+")) as error:
        load_spec(tmp_path / "m.xml")
    assert "\n" not in str(error.value)


def test_limits_can_be_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "m.xml").write_text('<mujoco><asset><hfield name="h" nrow="5000" ncol="5000" size="1 1 1 1"/></asset></mujoco>')
    with pytest.raises(InputError, match="--limits 2"):
        check_safe(tmp_path / "m.xml")
    monkeypatch.setenv("TWIN_LIMITS", "2")
    assert check_safe(tmp_path / "m.xml").tag == "mujoco"


def test_a_model_that_crashes_the_engine_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The trial in a separate process detects crashes and excessive memory."""
    shutil.copy(ROOT / "examples" / "gantry" / "spindle.stl", tmp_path / "a.stl")
    (tmp_path / "m.xml").write_text(
        '<mujoco><asset><mesh name="m" file="a.stl"/></asset><worldbody><geom type="mesh" mesh="m"/></worldbody></mujoco>'
    )
    root = check_safe(tmp_path / "m.xml")
    compiles(tmp_path / "m.xml", root)
    monkeypatch.setattr(model_limits, "TRIAL", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    with pytest.raises(InputError, match="the engine crashes on this model"):
        compiles(tmp_path / "m.xml", root)
    monkeypatch.setattr(model_limits, "TRIAL", "import sys; sys.exit(3)")
    with pytest.raises(InputError, match="needs more than 6 GB"):
        compiles(tmp_path / "m.xml", root)


def test_a_joint_without_inertia_is_named_and_no_log_file_remains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """MuJoCo would write a warning to standard error and into a file in the current folder."""
    joints = '<joint name="A" type="hinge" axis="0 0 1"/><joint name="B" type="hinge" axis="0 0 1"/>'
    (tmp_path / "m.xml").write_text(
        f'<mujoco><worldbody><body name="plate"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{joints}</body></worldbody></mujoco>'
    )
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="joint 'A' of body 'plate' moves no inertia"):
        new_machine(Path("m.xml"), tmp_path / "out" / "m.toml")
    assert [p.name for p in tmp_path.iterdir()] == ["m.xml"]
    assert capfd.readouterr().err == ""


def test_a_replay_of_a_model_with_hardly_any_inertia_prints_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """MuJoCo warns on standard error while it compiles; `replay` does not simulate."""
    (tmp_path / "m.xml").write_text(NO_INERTIA)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "a joint has no name" in refused(capsys, "replay", str(tmp_path / "m.xml"), "--out", str(tmp_path / "m.rrd"))


def test_frames_of_an_axis_without_a_joint(tmp_path: Path) -> None:
    """`identify` needs only the frames and builds no plant."""
    machine = write_slides(tmp_path)
    (tmp_path / "slides.xml").write_text(MJCF.replace('name="X"', 'name="0"', 1), encoding="utf-8")
    with pytest.raises(InputError, match="axis X has no joint in slides"):
        frames_of_model(load_machine(machine))


NO_INERTIA = """<mujoco><compiler inertiafromgeom="false"/><worldbody><body name="a">
  <inertial pos="0 0 0" mass="40" diaginertia="1 1 1"/><joint name="U" type="slide" axis="1 0 0"/>
  <body name="b"><inertial pos="0 0 0" mass="10" diaginertia="0.1 0.1 0.2"/><joint/><joint name="V" axis="0 0 1"/></body>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize("coordinate", [1e30, 5e9])
def test_a_mesh_beyond_any_machine(tmp_path: Path, coordinate: float) -> None:
    """Integers of the mesh library would overflow and print a warning."""
    corners = f"vertex 0 0 0\nvertex 1 0 0\nvertex 0 {coordinate:g} 0"
    (tmp_path / "a.stl").write_text(f"solid a\nfacet normal 0 0 1\nouter loop\n{corners}\nendloop\nendfacet\nendsolid a\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=re.escape(f"lies at {coordinate:.3g}, the limit is")):
            load_mesh(tmp_path / "a.stl", process=True)


@pytest.mark.parametrize("encoding", ["utf-7", "utf-16", "ebcdic-cp-be", "bogus"])
def test_an_encoding_that_parsers_read_differently(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "m.xml").write_text(f'<?xml version="1.0" encoding="{encoding}"?><mujoco/>')
    with pytest.raises(InputError, match="not written in UTF-8"):
        check_safe(tmp_path / "m.xml")


PACKAGE = '<robot name="r"><link name="a"><visual><geometry><mesh filename="package://{}"/></geometry></visual></link></robot>'


@pytest.mark.parametrize(
    "name", ["../secret.stl", "robot/../../secret.stl", "../../secret.stl", "robot/../../../secret.stl", ".ssh/secret.stl"]
)
def test_mesh_paths_cannot_leave_their_package(tmp_path: Path, name: str) -> None:
    """Files above the package are not read, even with the requested name."""
    home = tmp_path / "robot" / "urdf"
    home.mkdir(parents=True)
    for place in (tmp_path, tmp_path / ".ssh", tmp_path / "robot"):
        place.mkdir(exist_ok=True)
    for place in (tmp_path, tmp_path / ".ssh"):
        shutil.copy(ROOT / "examples" / "gantry" / "spindle.stl", place / "secret.stl")
    (home / "r.urdf").write_text(PACKAGE.format(name))
    with pytest.raises(InputError, match=r"leaves the folder|names no package|no mesh"):
        shown_urdf(home / "r.urdf")


def test_meshes_of_a_package_are_found(tmp_path: Path) -> None:
    home = tmp_path / "robot" / "urdf"
    home.mkdir(parents=True)
    (tmp_path / "robot" / "meshes").mkdir()
    shutil.copy(ROOT / "examples" / "gantry" / "spindle.stl", tmp_path / "robot" / "meshes" / "s.stl")
    (home / "r.urdf").write_text(PACKAGE.format("robot/meshes/s.stl"))
    assert shown_urdf(home / "r.urdf")[0].ngeom == 1


def test_a_mesh_opens_no_other_file(tmp_path: Path) -> None:
    """An OBJ names materials, which name pictures; none of them is opened."""
    (tmp_path / "m.obj").write_text("mtllib ../secret.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    assert len(load_mesh(tmp_path / "m.obj", process=False).faces) == 1
    (tmp_path / "m.dae").write_text('<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/hostname">]><COLLADA>&x;</COLLADA>')
    with pytest.raises(InputError, match="not a readable mesh"):
        load_mesh(tmp_path / "m.dae", process=False)


WRONG_URDF = {
    "two components": (URDF.replace('xyz="1 0 0"', 'xyz="1 0"'), "has 2 numbers; give 3"),
    "axis nowhere": (URDF.replace('xyz="1 0 0"', 'xyz="0 0 0"'), "points nowhere"),
    "NaN": (URDF.replace('xyz="1 0 0"', 'xyz="nan 0 0"'), "NaN"),
    "huge": (URDF.replace('upper="1"', 'upper="1e300"'), "impossible; give finite numbers"),
    "no name": (URDF.replace('<link name="b"/>', "<link/>"), "link 3 has no name"),
    "name twice": (URDF.replace('<link name="b"/>', '<link name="a"/>'), "two of <link> are named 'a'"),
    "no type": (URDF.replace('name="x" type="prismatic"', 'name="x"'), "joint 'x': type = ''"),
    "follows nothing": (URDF.replace('<axis xyz="1 0 0"/>', '<axis xyz="1 0 0"/><mimic joint="z"/>'), "follows joint 'z'"),
}


@pytest.mark.parametrize("case", WRONG_URDF)
def test_a_urdf_that_every_reader_refuses(tmp_path: Path, case: str) -> None:
    text, words = WRONG_URDF[case]
    assert text != URDF
    (tmp_path / "r.urdf").write_text(text, encoding="utf-8")
    for read in (check_urdf, shown_urdf):
        with pytest.raises(InputError, match=words):
            read(tmp_path / "r.urdf")


def test_threads_that_compile_together_print_no_warning(request: pytest.FixtureRequest) -> None:
    """The filter of warnings belongs to the process."""
    light, heavy = (f'<inertial pos="0 0 0" mass="{m}" diaginertia="{m} {m} {m}"/><joint type="slide"/>' for m in (1e-14, 1e3))
    singular = f"<mujoco><worldbody><body>{light}<body>{heavy}</body></body></worldbody></mujoco>"
    request.addfinalizer(functools.partial(sys.setswitchinterval, sys.getswitchinterval()))
    sys.setswitchinterval(1e-6)

    def compiled(_: int) -> None:
        model_limits.compiled_spec(mujoco.MjSpec.from_string(singular), "singular")

    with warnings.catch_warnings(record=True) as printed, ThreadPoolExecutor(8) as pool:
        warnings.simplefilter("always")
        list(pool.map(compiled, range(200)))
    assert printed == []
