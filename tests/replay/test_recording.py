"""A recording read back holds what was run: values, one timeline, units, the engine's poses, and a layout that fits it."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import rerun as rr
from scipy.spatial.transform import Rotation

from tests.builders.recording_read import Rows, read_layout, read_recording, timelines
from twin.geometry.kinematics import kinematics_of
from twin.machine.machine import Machine, load_machine
from twin.recordings.trace import Trace
from twin.replay.names import TIMELINE
from twin.replay.recording import write_recording
from twin.replay.scene import scene_of
from twin.report.colours import axis_colour
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints
from twin.units import AXIS_UNITS

POSE_TOLERANCE = 1e-6
"""m; the viewer keeps poses in single precision."""
NANOSECOND = 1e-9
"""Times are whole nanoseconds in a recording."""


def swing(seconds: float, period: float = 1e-3) -> np.ndarray:
    """Set points (sample, axis) in which all five axes move and reverse, from rest."""
    time = np.arange(round(seconds / period) + 1) * period
    part = np.clip(time / 0.4, 0.0, 1.0)
    size = np.array([0.04, 0.03, 0.02, np.radians(12.0), np.radians(25.0)])
    return (part**3 * (10 - 15 * part + 6 * part**2))[:, None] * size * np.sin(np.outer(time, [7.0, 9.0, 8.0, 5.0, 6.0]))


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine()


@pytest.fixture(scope="module")
def run(machine: Machine) -> Trace:
    return simulate(machine, Setpoints(swing(1.6), 1e-3)).trace


@pytest.fixture(scope="module")
def file(machine: Machine, run: Trace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "run.rrd"
    write_recording(path, machine, {"simulated": run}, summary="a table\nof the run")
    return path


@pytest.fixture(scope="module")
def held(file: Path) -> dict[str, dict[str, Rows]]:
    return read_recording(file)


def curve(held: dict[str, dict[str, Rows]], path: str) -> Rows:
    return held[path]["Scalars:scalars"]


def test_one_timeline(file: Path) -> None:
    assert timelines(file) == {TIMELINE}


@pytest.mark.parametrize("axis", "XYZAC")
def test_curves_are_samples_of_the_run_in_their_units(axis: str, run: Trace, held: dict[str, dict[str, Rows]]) -> None:
    units = AXIS_UNITS[run.kinds[axis]]
    error = run.get(axis, "setpoint") - run.get(axis, "position")
    inertia = run.get(axis, "torque") - run.get(axis, "torque_friction") - run.get(axis, "torque_gravity")
    expected = {
        "position/set_point": run.get(axis, "setpoint") * units.position[1],
        "position/simulated": run.get(axis, "position") * units.position[1],
        "following_error/simulated": error * units.error[1],
        "speed/simulated": run.get(axis, "velocity") * units.speed[1],
        "current/simulated": run.get(axis, "current"),
        "torque/motor_simulated": run.get(axis, "torque"),
        "torque/inertia_simulated": inertia,
        "torque/friction_simulated": run.get(axis, "torque_friction"),
        "torque/gravity_simulated": run.get(axis, "torque_gravity"),
        "torque/feedforward_simulated": run.get(axis, "torque_feedforward"),
    }
    for name, values in expected.items():
        rows = curve(held, f"/axes/{axis}/{name}")
        index = np.rint(rows.time * 1e3).astype(int)
        assert np.abs(rows.time - run.time[index]).max() <= NANOSECOND
        assert np.array_equal(rows.array, values[index]), name
        assert rows.array.max() == values.max()
        assert rows.array.min() == values.min()


def test_names_carry_units_and_axes_their_colours(machine: Machine, held: dict[str, dict[str, Rows]]) -> None:
    for order, axis in enumerate(machine.axes):
        unit = AXIS_UNITS[axis.kind].error[0]
        lines = held[f"/axes/{axis.name}/following_error/simulated"]
        assert lines["SeriesLines:names"].values == [[f"{axis.name} following error [{unit}]"]]
        red, green, blue = axis_colour(axis.name, order)
        assert lines["SeriesLines:colors"].values == [[(red << 24) | (green << 16) | (blue << 8) | 0xFF]]
    for path, components in held.items():
        if "Scalars:scalars" in components:
            names = components.get("SeriesLines:names") or components["SeriesPoints:names"]
            assert "SeriesPoints:names" in components or names.values[0][0].endswith("]"), path


def logged_pose(held: dict[str, dict[str, Rows]], path: str, at: float) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and rotation (3, 3) of an entity in the root, from the latest transforms at a time."""
    position, turn, entity = np.zeros(3), np.eye(3), ""
    for part in path.strip("/").split("/"):
        entity += f"/{part}"
        components = held.get(entity, {})
        local = [np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])]
        for i, name in enumerate(("Transform3D:translation", "Transform3D:quaternion")):
            rows = components.get(name)
            if rows is not None:
                k = 0 if not len(rows.time) else np.searchsorted(rows.time, at + NANOSECOND, side="right") - 1
                if rows.values[k]:
                    local[i] = np.asarray(rows.values[k][0], float)
        position = position + turn @ local[0]
        turn = turn @ Rotation.from_quat(local[1]).as_matrix()
    return position, turn


def test_logged_poses_are_the_engines_at_random_times(machine: Machine, run: Trace, held: dict[str, dict[str, Rows]]) -> None:
    scene = scene_of(machine)
    model = mujoco.MjModel.from_xml_path(str(machine.model_path))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    times = held[scene.body_paths[model.body("x_slide").id]]["Transform3D:translation"].time
    for at in rng.choice(times, 12, replace=False):
        sample = round(at * 1e3)
        for axis in "XYZAC":
            data.joint(axis).qpos[0] = run.get(axis, "position")[sample]
        mujoco.mj_kinematics(model, data)
        for body in range(1, model.nbody):
            position, turn = logged_pose(held, scene.body_paths[body], at)
            assert np.abs(position - data.xpos[body]).max() < POSE_TOLERANCE
            # a point a metre away from the body's origin
            assert np.abs(turn - data.xmat[body].reshape(3, 3)).max() < POSE_TOLERANCE


def test_every_drawn_geom_is_an_entity_below_its_body(machine: Machine, held: dict[str, dict[str, Rows]]) -> None:
    model = mujoco.MjModel.from_xml_path(str(machine.model_path))
    drawn = [
        path
        for path, c in held.items()
        if path.startswith("/machine") and any(n.startswith(("Boxes3D", "Cylinders3D", "Capsules3D", "Mesh3D")) for n in c)
    ]
    assert len(drawn) == sum(group <= 2 for group in model.geom_group)
    assert "/machine/y_slide/x_slide/z_slide/tool" in drawn
    assert "/machine/cradle/table/workpiece/part" in drawn


def strips(held: dict[str, dict[str, Rows]], path: str) -> np.ndarray:
    return np.array([point for row in held[path]["LineStrips3D:strips"].values for strip in row for point in strip])


def test_followed_path_is_the_tool_point_in_the_part_frame(machine: Machine, run: Trace, held: dict[str, dict[str, Rows]]) -> None:
    axes = np.column_stack([run.get(axis, "position") for axis in "XYZAC"])
    tip, _ = kinematics_of(machine).forward(axes)
    root = "/machine/cradle/table/workpiece/part_frame/path_x1"
    points = strips(held, f"{root}/followed/simulated")
    apart = np.array([np.abs(tip - point).max(axis=1).min() for point in points])
    assert apart.max() < POSE_TOLERANCE
    # it grows: each piece comes when the tool has been there
    rows = held[f"{root}/followed/simulated"]["LineStrips3D:strips"]
    for at, row in zip(rows.time, rows.values):
        assert np.abs(np.array(row[-1][-1]) - tip[round(at * 1e3)]).max() < POSE_TOLERANCE
    assert np.all(np.diff(rows.time) >= 0.0)
    assert rows.time[-1] == pytest.approx(run.time[-1])


def test_magnified_path_has_the_contour_error_times_its_factor(held: dict[str, dict[str, Rows]]) -> None:
    largest = curve(held, "/contour_error/simulated").array.max() * 1e-6
    root = "/machine/cradle/table/workpiece/part_frame"
    reference = strips(held, f"{root}/path_x1000/programmed")
    start, step = reference[:-1], np.diff(reference, axis=0)
    length = np.maximum(np.einsum("ni,ni->n", step, step), 1e-30)
    points = strips(held, f"{root}/path_x1000/followed/simulated")
    part = np.clip(np.einsum("pni,ni->pn", points[:, None] - start, step) / length, 0.0, 1.0)
    distance = np.linalg.norm(points[:, None] - start - part[..., None] * step, axis=2).min(axis=1)
    # a magnified deviation may come nearer to another part of the path, never farther than its own
    assert 0.5 * 1000 * largest < distance.max() < 1.02 * 1000 * largest + 1e-4


def test_the_layout_refers_only_to_existing_entities(file: Path) -> None:
    assert check_layout(file) > 25


def check_layout(file: Path) -> int:
    """Every entity that the layout names is in the recording; returns the number of views."""
    there = set()
    for path in read_recording(file):
        parts = path.strip("/").split("/")
        there |= {"/" + "/".join(parts[:i]) for i in range(1, len(parts) + 1)}
    views, referred = 0, set()
    for path, components in read_layout(file).items():
        origin = components.get("ViewBlueprint:space_origin")
        if origin:
            views += 1
            referred.add(origin.values[0][0])
        query = components.get("ViewContents:query")
        if query:
            lines = "\n".join(query.values[0]).splitlines()
            referred |= {line.strip("+- ").removesuffix("/**") for line in lines if "$origin" not in line}
        if "/overrides/" in path:
            referred.add("/" + path.split("/overrides/")[1].removesuffix("/visualizers"))
    assert referred <= there, referred - there
    return views


def test_the_summary_names_program_and_machine(held: dict[str, dict[str, Rows]]) -> None:
    text = held["/summary"]["TextDocument:text"].values[0][0]
    assert "Mikron UCP 710" in text
    assert "Contour error" in text
    assert "a table\nof the run" in text
    assert "| X |" in text
    assert "arcsec" in text


def test_events_are_listed_and_marked(held: dict[str, dict[str, Rows]]) -> None:
    texts = [row[0] for row in held["/events"]["TextLog:text"].values]
    assert any(text.startswith("reversal: X reverses at") for text in texts)
    marks = held["/axes/X/following_error/event_reversal"]
    assert len(marks["Scalars:scalars"].time) == sum(text.startswith("reversal: X") for text in texts)


def test_full_keeps_every_sample(machine: Machine, run: Trace, tmp_path: Path) -> None:
    write_recording(tmp_path / "full.rrd", machine, {"simulated": run}, full=True)
    held = read_recording(tmp_path / "full.rrd")
    assert np.array_equal(curve(held, "/axes/A/current/simulated").array, run.get("A", "current"))
    # a body that rests is logged where it comes to rest and where it leaves
    assert len(held["/machine/y_slide"]["Transform3D:translation"].time) > 0.98 * len(run.time)


def test_two_runs_are_overlaid_with_their_difference(machine: Machine, run: Trace, tmp_path: Path) -> None:
    other = simulate(machine.with_feedforward("off"), Setpoints(swing(1.6), 1e-3), sample_period=2e-3).trace
    write_recording(tmp_path / "two.rrd", machine, {"before": run, "after": other}, full=True)
    held = read_recording(tmp_path / "two.rrd")
    rows = curve(held, "/axes/X/difference_position/after")
    expected = (other.get("X", "position") - run.get("X", "position")[::2]) * 1e6
    assert np.allclose(rows.array[::2], expected, atol=1e-6)
    assert held["/axes/X/position/after"]["SeriesLines:names"].values == [["X position, after [mm]"]]
    assert "/machine/cradle/table/workpiece/part_frame/path_x1/followed/after" in held
    assert check_layout(tmp_path / "two.rrd") > 35
    assert "both runs have the same set points" in held["/summary"]["TextDocument:text"].values[0][0]


def test_a_difference_of_set_points_is_reported(machine: Machine, run: Trace, tmp_path: Path) -> None:
    moved = Trace(run.time, {k: v + (1e-4 if k == ("Y", "setpoint") else 0.0) for k, v in run.signals.items()}, run.kinds)
    write_recording(tmp_path / "two.rrd", machine, {"a": run, "b": moved})
    assert "set points differ by up to 100 um (Y" in read_recording(tmp_path / "two.rrd")["/summary"]["TextDocument:text"].values[0][0]


def test_one_axis_measured_by_one_encoder_is_shown(machine: Machine, tmp_path: Path) -> None:
    time = np.arange(500) * 1e-3
    trace = Trace(time, {("X", "position"): 0.01 * np.sin(time), ("X", "current"): time}, {"X": "linear"})
    write_recording(tmp_path / "x.rrd", machine, {"measured": trace})
    held = read_recording(tmp_path / "x.rrd")
    assert check_layout(tmp_path / "x.rrd") > 5
    assert "/axes/X/position/measured" in held
    assert "/axes/X/following_error/measured" not in held
    assert "Not recorded: X: set point" in held["/summary"]["TextDocument:text"].values[0][0]


def minute(noise: float = 1.0) -> Trace:
    """A minute of five axes at 1 kHz that are never still, with the noise of the measuring systems on every signal."""
    rng = np.random.default_rng(0)
    setpoint = swing(60.0)
    time = np.arange(len(setpoint)) * 1e-3
    kinds = dict(zip("XYZAC", ("linear", "linear", "linear", "rotary", "rotary")))
    signals = {}
    for a, axis in enumerate("XYZAC"):
        speed = np.gradient(setpoint[:, a], time)
        signals[axis, "setpoint"] = setpoint[:, a]
        for name, values, scatter in (
            ("position", setpoint[:, a] - 2e-3 * speed, 5e-8),
            ("motor_position", setpoint[:, a] - 2e-3 * speed, 1e-8),
            ("velocity", speed, 2e-5),
            ("velocity_setpoint", speed, 2e-5),
            ("current", 3.0 * np.sign(speed), 0.04),
            ("torque", 4.0 * np.sign(speed), 0.05),
            ("torque_friction", 2.0 * np.sign(speed), 0.01),
            ("torque_gravity", 0.5 * np.cos(time), 0.01),
            ("torque_feedforward", np.gradient(speed, time), 0.01),
        ):
            signals[axis, name] = values + noise * scatter * rng.standard_normal(len(time))
    return Trace(time, signals, kinds)


def test_a_minute_of_five_axes_is_a_few_hundred_messages_and_five_megabytes(
    machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a recording costs is messages and rows: a message for each sample took 300 times as long. Counted, since seconds depend on the load."""
    messages, rows = [0], [0]
    send_columns, log = rr.RecordingStream.send_columns, rr.RecordingStream.log

    def counted_columns(self: rr.RecordingStream, path: str, indexes: list[rr.TimeColumn], columns: Any) -> None:
        messages[0] += 1
        rows[0] += len(indexes[0].times)
        send_columns(self, path, indexes, columns)

    def counted_log(self: rr.RecordingStream, *args: Any, **options: Any) -> None:
        messages[0] += 1
        rows[0] += 1
        log(self, *args, **options)

    monkeypatch.setattr(rr.RecordingStream, "send_columns", counted_columns)
    monkeypatch.setattr(rr.RecordingStream, "log", counted_log)
    trace = minute()
    write_recording(tmp_path / "minute.rrd", machine, {"simulated": trace})
    size = (tmp_path / "minute.rrd").stat().st_size
    print(f"\na minute of five axes at 1 kHz: {messages[0]} messages, {rows[0]} rows, {size / 1e6:.2f} MB")
    assert messages[0] < 500  # 373 as it is; a message for each sample would be 3 millions
    assert rows[0] < 300_000
    assert size < 5e6
    write_recording(tmp_path / "two.rrd", machine, {"before": trace, "after": minute(1.5)})
    assert (tmp_path / "two.rrd").stat().st_size < 5e6
