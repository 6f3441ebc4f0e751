"""`twin replay`: what it makes of each kind of path, and one clear line for each kind of bad input."""

import argparse
import json
import os
from pathlib import Path
import shutil
import socket
import subprocess
import sys
import time as clock
import urllib.request

import numpy as np
import pytest

from tests.builders.recording_read import read_recording
from twin.cli import main
from twin.cli import replay as replay_command
from twin.cli.arguments import add_arguments
from twin.errors import InputError
from twin.geometry.body_poses import body_poses
from twin.machine.machine import load_machine
from twin.recordings.trace import Trace, write_trace
from twin.replay.motion import motion_from_trace, sweep, with_mimics
from twin.replay.recording import write_recording
from twin.replay.scene import read_scene, with_normals
from twin.replay.source import check_recording, source_of
from twin.replay.viewer import free_port
from twin.system import end_tree

ROOT = Path(__file__).resolve().parents[2]
GANTRY = ROOT / "examples" / "gantry" / "gantry.urdf"


def small_trace(scale: float = 1.0) -> Trace:
    time = np.arange(200) * 1e-3
    way = scale * 1e-3 * np.sin(10.0 * time)
    return Trace(time, {("X", "setpoint"): way, ("X", "position"): 0.999 * way, ("X", "current"): way}, {"X": "linear"})


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A folder as `twin run` writes it."""
    folder = tmp_path / "first"
    write_trace(small_trace(), folder / "trace.parquet")
    write_recording(folder / "run.rrd", load_machine(), {"simulated": small_trace()})
    return folder


def replay(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    add_arguments(parser, replay_command)
    return replay_command.carry_out(parser.parse_args(list(arguments))) or 0


def test_a_trace_becomes_a_recording(run: Path, tmp_path: Path) -> None:
    for name in ("trace.parquet", "trace.csv"):
        write_trace(small_trace(), tmp_path / "in" / name)
        assert replay(str(tmp_path / "in" / name), "--out", str(tmp_path / "out.rrd")) == 0
        assert "/axes/X/position/in" in read_recording(tmp_path / "out.rrd")


def test_two_runs_become_an_overlay_by_folder_or_trace(run: Path, tmp_path: Path) -> None:
    write_trace(small_trace(1.01), tmp_path / "second.csv")
    assert replay(str(run), str(tmp_path / "second.csv"), "--out", str(tmp_path / "both.rrd")) == 0
    held = read_recording(tmp_path / "both.rrd")
    assert "/axes/X/difference_position/second" in held
    assert "/axes/X/position/first" in held


def test_an_overlay_names_the_effects_of_its_runs(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "worn")
    effects = [{"name": "backlash", "axis": "X", "clearance": 1.5e-5}]
    (tmp_path / "worn" / "summary.json").write_text(json.dumps({"effects": effects}), encoding="utf-8")
    assert replay(str(run), str(tmp_path / "worn"), "--out", str(tmp_path / "out.rrd")) == 0
    said = str(read_recording(tmp_path / "out.rrd")["/summary"]["TextDocument:text"].values)
    assert "worn: effects backlash X" in said
    assert "first: effects" not in said


def test_two_folders_of_one_name_keep_apart(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "other" / "first")
    assert replay(str(run), str(tmp_path / "other" / "first"), "--out", str(tmp_path / "both.rrd")) == 0
    assert "/axes/X/position/first\\ \\(2\\)" in read_recording(tmp_path / "both.rrd")


@pytest.mark.parametrize("model", ["models/mikron_ucp710.xml", "models/mikron_ucp710.toml", "examples/gantry/gantry.urdf"])
def test_any_model_sweeps_through_its_ranges(model: str, tmp_path: Path) -> None:
    assert replay(str(ROOT / model), "--out", str(tmp_path / "model.rrd")) == 0
    curves = [path for path in read_recording(tmp_path / "model.rrd") if path.endswith("/position/motion")]
    assert len(curves) == (4 if model.endswith("urdf") else 5)


def test_a_sweep_reaches_both_ends_of_every_joint() -> None:
    scene = read_scene(GANTRY)
    time, joints = sweep(scene)
    for name, values in joints.items():
        low, high = scene.model.joint(name).range
        assert values.min() == pytest.approx(low, abs=1e-6)
        assert values.max() == pytest.approx(high, abs=1e-6)
        assert abs(values[0]) < 1e-12
        assert abs(values[-1]) < 1e-12
        assert np.abs(np.diff(values)).max() < 0.03 * (high - low)
    assert time[-1] == pytest.approx(16.0)


def test_urdf_poses_are_those_of_its_own_reader() -> None:
    from yourdfpy import URDF

    robot = URDF.load(str(GANTRY), load_meshes=False, build_scene_graph=True)
    scene = read_scene(GANTRY)
    rng = np.random.default_rng(0)
    for _ in range(5):
        joints = {name: rng.uniform(-0.1, 0.1, 1) for name in scene.joints}
        robot.update_cfg({name: float(value[0]) for name, value in joints.items()})
        poses = body_poses(scene.model, joints)
        for link in robot.link_map:
            pose = poses[scene.model.body(link).id]
            expected = robot.get_transform(link, "frame")
            assert np.allclose(pose.position[0], expected[:3, 3], atol=1e-9)
            assert np.allclose(pose.rotation.as_matrix(), expected[:3, :3], atol=1e-9)


def test_urdf_motion_from_the_columns_of_a_trace(tmp_path: Path) -> None:
    time = np.arange(50) * 0.01
    write_trace(
        Trace(time, {("x", "position"): 0.1 * time, ("b", "position"): time}, {"x": "linear", "b": "rotary"}), tmp_path / "move.csv"
    )
    scene = read_scene(GANTRY)
    _, joints = motion_from_trace(scene, tmp_path / "move.csv")
    assert np.allclose(joints["x"], 0.1 * time)
    assert np.allclose(joints["b"], time)
    assert replay(str(GANTRY), str(tmp_path / "move.csv"), "--out", str(tmp_path / "move.rrd")) == 0
    held = read_recording(tmp_path / "move.rrd")
    assert np.allclose(held["/machine/frame/bridge/carriage"]["Transform3D:translation"].array[-1], [0.049, 0, 0], atol=1e-6)
    assert any(path.endswith("/head/spindle") and "Mesh3D:vertex_positions" in parts for path, parts in held.items())


def test_a_joint_that_mimics_follows(tmp_path: Path) -> None:
    text = GANTRY.read_text().replace(
        '<limit lower="-1.2" upper="1.2" effort="1" velocity="1"/>', '<mimic joint="x" multiplier="2" offset="0.5"/>'
    )
    (tmp_path / "mimic.urdf").write_text(text)
    shutil.copy(GANTRY.parent / "spindle.stl", tmp_path)
    joints = with_mimics(read_scene(tmp_path / "mimic.urdf"), {"x": np.array([0.0, 0.1])})
    assert np.allclose(joints["b"], [0.5, 0.7])


def test_mesh_normals_point_outwards_and_creases_stay_sharp() -> None:
    import trimesh

    box, ball = trimesh.creation.box(), trimesh.creation.icosphere(subdivisions=3)
    mesh = with_normals(np.asarray(box.vertices), np.asarray(box.faces))
    assert len(mesh.vertices) == 24
    assert len(mesh.faces) == 12
    assert np.all(np.isclose(np.abs(mesh.vertex_normals).max(axis=1), 1.0))
    mesh = with_normals(np.asarray(ball.vertices), np.asarray(ball.faces))
    assert len(mesh.vertices) == len(ball.vertices)
    assert np.all(np.einsum("ni,ni->n", mesh.vertices, mesh.vertex_normals) > 0.99)


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line that the command prints for these arguments."""
    assert main(["replay", *map(str, arguments)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("twin: ")
    assert error.count("\n") == 1
    assert "Traceback" not in error
    return error


def test_bad_paths_have_a_line_each(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty_folder").mkdir()
    (tmp_path / "text.rrd").write_text("hello, I am no recording")
    (tmp_path / "nothing.rrd").write_bytes(b"")
    whole = (run / "run.rrd").read_bytes()
    (tmp_path / "half.rrd").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "last.rrd").write_bytes(whole[:-100])
    (tmp_path / "notes.pdf").write_text("x")
    (tmp_path / "one.csv").write_text("time [s],X.position [mm]\n0,1\n")
    (tmp_path / "none.csv").write_text("time [s],X.position [mm]\n")
    (tmp_path / "other.csv").write_text("time [s],U.position [mm]\n0,1\n0.1,2\n")
    (tmp_path / "only_current.csv").write_text("time [s],X.current [A]\n0,1\n0.1,2\n")
    expected = {
        "missing.rrd": "no such file or folder",
        "empty_folder": "neither a recording (.rrd) nor trace.parquet",
        "text.rrd": "not a recording",
        "nothing.rrd": "the recording is empty",
        "half.rrd": "truncated or damaged",
        "last.rrd": "truncated or damaged",
        "notes.pdf": "'.pdf' cannot be replayed",
        "one.csv": "only one sample",
        "none.csv": "the trace is empty",
        "other.csv": "unknown axis U",
        "only_current.csv": "no position of any axis",
    }
    for name, words in expected.items():
        assert words in refused(capsys, tmp_path / name), name


def test_bad_options_have_a_line_each(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "--at needs --screenshot" in refused(capsys, run, "--at", "1")
    assert "--size 10x10" in refused(capsys, run, "--size", "10x10")
    assert "3 paths given" in refused(capsys, run, run, run)
    assert "this ending" in refused(capsys, run, "--out", tmp_path / "a.zip")
    for path in (run, ROOT / "examples" / "campaign"):  # before a note says which run of a campaign is shown
        assert "ends in .png" in refused(capsys, path, "--screenshot", tmp_path / "a.jpg")
    assert "cannot be written" in refused(capsys, run / "trace.parquet", "--out", run / "trace.parquet" / "a.rrd")
    shutil.copy(run / "run.rrd", tmp_path / "alone.rrd")
    assert "without its trace" in refused(capsys, run, tmp_path / "alone.rrd", "--out", tmp_path / "x.rrd")


def test_the_folder_of_every_command_is_accepted_or_the_message_names_the_file_to_open(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # one recording each: a diagnosis, a cut, a comparison, the best variant of a study
    for name in ("diagnosis.rrd", "cut.rrd", "compare.rrd", "best_corner.rrd"):
        folder = tmp_path / name.removesuffix(".rrd")
        folder.mkdir()
        shutil.copy(run / "run.rrd", folder / name)
        assert source_of(folder).recording == folder / name
    # cases with a folder each: a regression, an examination
    below = tmp_path / "evidence" / "case_1"
    below.mkdir(parents=True)
    shutil.copy(run / "run.rrd", below / "overlay.rrd")
    assert source_of(tmp_path / "evidence").recording == below / "overlay.rrd"
    assert "1 recordings" in source_of(tmp_path / "evidence").note
    # a campaign, and the folder of a machine
    campaign = ROOT / "examples" / "campaign"
    assert main(["replay", str(campaign), "--out", str(tmp_path / "campaign.rrd")]) == 0
    assert "of 3 runs of the campaign is shown" in capsys.readouterr().err
    assert main(["replay", str(ROOT / "examples" / "gantry"), "--out", str(tmp_path / "gantry.rrd")]) == 0
    # programs and reports have no motion yet
    for name, words in (("x.mpf", "simulate one: twin run"), ("report.html", "open .*report.html in a browser")):
        folder = tmp_path / name.replace(".", "_")
        folder.mkdir()
        (folder / name).write_text("x")
        with pytest.raises(InputError, match=words):
            source_of(folder)


def test_a_missing_display_is_reported(run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert "no display" in refused(capsys, run)


MODELS = {
    "missing mesh in MJCF": (
        "m.xml",
        '<mujoco><asset><mesh name="a" file="gone.stl"/></asset><worldbody><geom type="mesh" mesh="a"/></worldbody></mujoco>',
        "gone.stl",
    ),
    "no MJCF": ("m.xml", "<mujoco><worldbody><geom type='blob'/></worldbody></mujoco>", "MuJoCo cannot read this model"),
    "no joint": ("m.xml", "<mujoco><worldbody><geom type='box' size='1 1 1'/></worldbody></mujoco>", "no slide or hinge"),
    "missing mesh in URDF": (
        "m.urdf",
        '<robot name="r"><link name="a"><visual><geometry><mesh filename="package://r/gone.stl"/></geometry></visual></link></robot>',
        "no mesh 'package://r/gone.stl'",
    ),
    "no URDF": ("m.urdf", "<html><body/></html>", "is not a URDF"),
    "no XML": ("m.urdf", "no xml at all", "not readable XML"),
    "joint without parent": (
        "m.urdf",
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="fixed">'
        '<parent link="ghost"/><child link="b"/></joint></robot>',
        "names link 'ghost'",
    ),
}


@pytest.mark.parametrize("fault", MODELS)
def test_bad_models_have_a_line_each(fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name, text, words = MODELS[fault]
    (tmp_path / name).write_text(text)
    assert words in refused(capsys, tmp_path / name, "--out", tmp_path / "x.rrd")


def test_damaged_mesh_of_a_urdf(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "spindle.stl").write_text("solid nonsense")
    shutil.copy(GANTRY, tmp_path / "gantry.urdf")
    assert "spindle.stl" in refused(capsys, tmp_path / "gantry.urdf", "--out", tmp_path / "x.rrd")


def test_empty_runs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no run given"):
        write_recording(tmp_path / "x.rrd", load_machine(), {})
    with pytest.raises(InputError, match="empty"):
        write_recording(tmp_path / "x.rrd", load_machine(), {"a": Trace(np.zeros(0), {("X", "position"): np.zeros(0)}, {"X": "linear"})})


def test_a_good_recording_passes(run: Path) -> None:
    assert check_recording(run / "run.rrd") == run / "run.rrd"


def test_all_kinds_of_geoms_are_drawn(tmp_path: Path) -> None:
    geoms = "".join(
        f'<geom name="{kind}" type="{kind}" size="0.1 0.2 0.3"/>' for kind in ("box", "sphere", "cylinder", "capsule", "ellipsoid")
    )
    (tmp_path / "m.xml").write_text(
        f'<mujoco><asset><hfield name="h" nrow="4" ncol="5" size="1 1 0.2 0.1"/></asset>'
        f'<worldbody><geom name="floor" type="plane" size="0 0 1"/><geom name="sheet" type="plane" size="1 1 1"/>'
        f'<geom name="ground" type="hfield" hfield="h"/>'
        f'<body><joint name="s" type="slide"/>{geoms}<geom name="hidden" type="box" size="1 1 1" group="3"/></body></worldbody></mujoco>'
    )
    scene = read_scene(tmp_path / "m.xml")
    sizes = {shape.name: np.ptp(shape.vertices, axis=0).tolist() for shape in scene.shapes}
    assert sizes == {
        name: pytest.approx(size, abs=2e-4)
        for name, size in {
            "sheet": (2.0, 2.0, 0.0), "ground": (2.0, 2.0, 0.0), "box": (0.2, 0.4, 0.6), "sphere": (0.2, 0.2, 0.2),
            "cylinder": (0.2, 0.2, 0.4), "capsule": (0.2, 0.2, 0.6), "ellipsoid": (0.2, 0.4, 0.6),
        }.items()
    }  # fmt: skip
    assert replay(str(tmp_path / "m.xml"), "--out", str(tmp_path / "m.rrd")) == 0


def test_the_web_viewer_answers_on_this_computer_only_and_ends(run: Path) -> None:
    port = free_port()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "twin", "replay", str(run), "--serve", "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    try:
        assert process.stdout is not None
        assert f"http://127.0.0.1:{port}/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A" in process.stdout.readline()
        page = b""
        for _ in range(600):
            try:
                page = urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=60.0).read()
                break
            except OSError:
                clock.sleep(0.1)
        assert b"<html" in page.lower()
        with socket.socket() as other:
            # 127.0.0.2 is this computer too, but nothing listens there unless all interfaces are open
            other.settimeout(1.0)
            assert other.connect_ex(("127.0.0.2", port)) != 0
    finally:
        if os.name == "nt":
            end_tree(process)  # no SIGTERM there: a terminated process cleans nothing up
        else:
            process.terminate()
            assert process.wait(60.0) == 128 + 15  # SIGTERM; a loaded computer takes its time
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0


def test_a_port_in_use_is_reported(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert "cannot be used" in refused(capsys, run, "--serve", "--port", str(taken.getsockname()[1]))


@pytest.mark.parametrize("runs", ["run = 5", 'run = ["a"]'])
def test_a_campaign_whose_runs_are_no_tables_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], runs: str) -> None:
    (tmp_path / "campaign.toml").write_text(runs + "\n", encoding="utf-8")
    assert main(["replay", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "defect" not in error
    assert error.count("\n") == 1
