"""Two designs in one recording: a pane each with its own machine, on one clock, one scale and one magnification."""

from pathlib import Path

import numpy as np
import pytest

from tests.builders.recording_read import Rows, read_layout, read_recording
from tests.replay.test_recording import check_layout
from twin.errors import InputError
from twin.geometry.kinematics import kinematics_of
from twin.geometry.scurve import moves_in_turn
from twin.geometry.tool_path import contour_error, tool_path_of
from twin.machine.machine import Machine, load_machine
from twin.recordings.trace import Trace
from twin.replay.side_by_side import ROOTS, most_different_axis, write_side_by_side
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

FACTOR = 100


@pytest.fixture(scope="module")
def designs() -> dict[str, tuple[Machine, Trace]]:
    """The Mikron, and one with a softer Y and another place of the C axis, on the same set points of X, Y, A and C."""
    position = np.zeros((1201, 5))
    for axis, distance in ((0, 0.03), (1, 0.02), (3, 0.2), (4, 0.3)):
        _, way = moves_in_turn(0.0, [distance, -distance], 0.2, 2.0, 50.0, 0.06, 1e-3)
        position[:, axis] = np.pad(way, (0, 1201 - len(way)), mode="edge") if len(way) < 1201 else way[:1201]
    nominal = load_machine()
    gain = 0.2 * nominal.axis("Y").loops.speed_gain_nm_s_per_rad
    other = nominal.with_values({"axis.Y.loops.speed_gain_nm_s_per_rad": gain, "geometry.a_axis_to_c_axis_y_m": 0.1})
    return {
        name: (machine, simulate(machine, Setpoints(position, 1e-3)).trace) for name, machine in (("as it is", nominal), ("soft", other))
    }


@pytest.fixture(scope="module")
def file(designs: dict[str, tuple[Machine, Trace]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("side") / "compare.rrd"
    write_side_by_side(path, designs, summary="design  A  B")
    return path


@pytest.fixture(scope="module")
def held(file: Path) -> dict[str, dict[str, Rows]]:
    return read_recording(file)


def followed(held: dict[str, dict[str, Rows]], root: str, factor: int) -> list[str]:
    return [path for path in held if path.startswith(root) and f"/path_x{factor}/followed/" in path]


def test_each_pane_has_its_own_machine_and_path(held: dict[str, dict[str, Rows]], file: Path) -> None:
    assert check_layout(file) > 20  # every entity that it names is there
    views = {
        str(rows["ViewBlueprint:display_name"].array[0]) for rows in read_layout(file).values() if "ViewBlueprint:display_name" in rows
    }
    for root, label in zip(ROOTS, ("as it is", "soft")):
        assert followed(held, root, 1)
        assert any(path.startswith(f"{root}/") and "Transform3D:quaternion" in rows for path, rows in held.items())
        assert {f"{label}: machine", f"{label}: tool path, deviation x{FACTOR}"} <= views


def test_both_panes_have_one_scale_and_their_own_error(held: dict[str, dict[str, Rows]], designs: dict[str, tuple[Machine, Trace]]) -> None:
    """Each run against its own set points on its own kinematics; the legend holds the larger error."""
    largest = []
    for label, (machine, trace) in designs.items():
        kinematics = kinematics_of(machine)
        paths = [tool_path_of(trace, signal, machine, kinematics=kinematics) for signal in ("position", "setpoint")]
        largest.append(float(contour_error(*paths).error.max()) * 1e6)
        (curve,) = [rows for path, rows in held.items() if path.startswith("/contour_error/") and path.endswith(label.replace(" ", "\\ "))]
        assert np.max(curve["Scalars:scalars"].values) == pytest.approx(largest[-1], rel=0.02)
    assert largest[1] > 2.0 * largest[0]
    end = float(held["/legend/limits"]["Points2D:labels"].values[0][-1].removesuffix(" um").removeprefix("> "))
    assert 0.9 * largest[1] <= end <= 3.0 * largest[1]
    factors = [{path.split("/path_x")[1].split("/")[0] for path in held if path.startswith(root) and "/path_x" in path} for root in ROOTS]
    assert factors[0] == factors[1] != {"1"}


def test_the_axis_that_differs_most_is_shown_first(designs: dict[str, tuple[Machine, Trace]]) -> None:
    (machine, first), (_, second) = designs.values()
    assert most_different_axis(machine, first, second) == "Y"


def test_only_two_designs_with_the_same_axes(designs: dict[str, tuple[Machine, Trace]], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="1 designs given; give two"):
        write_side_by_side(tmp_path / "one.rrd", dict(list(designs.items())[:1]))
