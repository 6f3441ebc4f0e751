"""The interpolator against its claims: limits, tolerance, smoothness, time optimality, long programs, error budget.

Everything here is a shortened version of devtools/measure_interpolator.py, which prints the figures at full size.
"""

import math
from pathlib import Path
import tracemalloc

import numpy as np
import pytest

from devtools import measure_interpolator as measure
from tests.builders.random_programs import check, random_program
from twin.errors import InputError
from twin.machine.machine import Machine
from twin.program import error_budget, interpolate, interpolator, lookahead, nodes, read_program
from twin.recordings.trace import Trace, joined, read_trace, written

ROOT = Path(__file__).resolve().parents[2]


def write(folder: Path, text: str) -> Path:
    path = folder / "part.mpf"
    path.write_text(text)
    return path


@pytest.mark.parametrize("decade", range(6))
def test_random_programs_keep_limits_tolerances_and_smoothness(mikron: Machine, tmp_path: Path, decade: int) -> None:
    for seed in range(1000 + 10 * decade, 1010 + 10 * decade):
        finding = check(random_program(seed), tmp_path, mikron)
        assert finding.limits <= 1.001, seed
        assert finding.block_end <= 1.0, seed
        assert finding.jump < 1e-9, seed
        assert finding.feed <= 1.01, seed


def test_straight_moves_take_the_time_of_the_closed_form(mikron: Machine, tmp_path: Path) -> None:
    planned, cycles = measure.straight_moves(mikron, tmp_path)
    assert planned < 0.01
    assert cycles <= 1.0


def test_short_paths_are_nearly_as_fast_as_the_second_planner_finds(mikron: Machine, tmp_path: Path) -> None:
    assert max(measure.short_paths(mikron, tmp_path, seeds=(4, 5, 6, 8, 10, 13))) < 1.10


def test_polylines_are_nearly_as_fast_as_toppra_without_jerk_limits(mikron: Machine, tmp_path: Path) -> None:
    pytest.importorskip("toppra", reason="toppra is in the development extra")
    assert measure.over_toppra(mikron, tmp_path, 2000, 3000.0, False)[0] < 1.10


def test_windows_join_to_the_same_law(mikron: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = read_program(write(tmp_path, measure.long_program(6000)), mikron)
    whole = interpolate(program, mikron)
    monkeypatch.setattr(lookahead, "WINDOW", 1500)
    parts = interpolate(program, mikron)
    assert abs(whole.time[-1] - parts.time[-1]) < 5e-3 * whole.time[-1]
    limits = interpolator.limits_of(mikron)
    for order, limit in enumerate(limits, 1):
        over = np.abs(np.diff(parts.matrix("setpoint"), order, axis=0)).max(axis=0) / parts.period**order / limit
        assert over.max() <= 1.001


def over_limits(trace: Trace, machine: Machine) -> float:
    """Greatest difference of the set points over its limit, at rest before and behind."""
    axes = np.pad(trace.matrix("setpoint", machine.axis_names), ((3, 3), (0, 0)), mode="edge")
    limits = interpolator.limits_of(machine)
    return max(
        float((np.abs(np.diff(axes, order, axis=0)).max(axis=0) / trace.period**order / limit).max())
        for order, limit in enumerate(limits, 1)
    )


@pytest.mark.parametrize("factor", [1e2, 1e3, 1e4, 1e5])
def test_set_points_keep_the_limits_for_any_planned_law(
    mikron: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, factor: float
) -> None:
    plain = lookahead.plan

    def for_a_faster_machine(way, *_given, **_named):  # type: ignore[no-untyped-def]
        return plain(way._replace(limits=nodes.Limits(*(factor * limit for limit in way.limits))))

    monkeypatch.setattr(lookahead, "plan", for_a_faster_machine)
    trace = interpolate(read_program(write(tmp_path, "G1 X0.3 F20000\nX0\n"), mikron), mikron)
    assert over_limits(trace, mikron) <= 1.0003


def slow_turning(rows: int, blocks: int) -> str:
    """Short five-axis blocks at a slow feed with a changing tool axis, and rapids between the rows, which need long run-ups."""
    out = ["TRAORI", "CYCLE832(0.01,3)"]
    k = np.arange(blocks)
    for row in range(rows):
        x = (0.25 * k - 20.0) * (-1) ** row
        i, j = 0.15 * np.sin(0.13 * k + row) + 0.02 * np.cos(1.1 * k), 0.15 * np.cos(0.11 * k) - 0.2
        lines = [f"X{a:.4f} Y{3 * row} Z{140.0 + 0.5 * math.sin(0.2 * a):.4f} A3={b:.6f} B3={c:.6f} C3=1" for a, b, c in zip(x, i, j)]
        out += ["G0 " + lines[0], "G1 F200", *lines[1:], "G0 Z190", f"X{-x[-1]:.3f}"]
    return "\n".join(out)


def test_the_time_of_slow_five_axis_blocks_between_rapids_does_not_depend_on_the_window(
    mikron: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: windows short of their optimum disagreed at their joints, which raised the jerk above the limit and slowed all moves."""
    program = read_program(write(tmp_path, slow_turning(3, 60)), mikron)
    seconds = []
    for window in (lookahead.WINDOW, 4000, 1500):
        monkeypatch.setattr(lookahead, "WINDOW", window)
        trace = interpolate(program, mikron)
        assert over_limits(trace, mikron) <= 1.0003, window
        seconds.append(trace.time[-1])
    assert max(seconds) < 1.002 * min(seconds), seconds


def test_slow_moves_use_no_more_nodes_per_set_point_than_fast_ones(
    mikron: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # each move turns the tool axis, so the path of the axes is curved throughout although only the feed limits the speed
    counts: list[int] = []
    plain = lookahead.grid

    def counted(*given: object) -> tuple[np.ndarray, ...]:
        found = plain(*given)
        counts.append(len(found[0]))
        return found

    monkeypatch.setattr(lookahead, "grid", counted)
    cost = []
    for feed in (2000, 200, 20):
        counts.clear()
        moves = "X30 Y20 A3=0.1 B3=0.1 C3=1\nX0 Y0 A3=0.1 B3=-0.1 C3=1\nX10 A3=0 B3=0 C3=1\n"
        text = f"TRAORI\nCYCLE832(0.01,3)\nG0 X0 Y0 Z60 A3=0 B3=0 C3=1\nG1 F{feed}\n{moves}"
        count = len(interpolate(read_program(write(tmp_path, text), mikron), mikron).time)
        cost.append(sum(counts) / count)
    assert cost[0] < 2.0
    assert cost[1] < 0.5 * cost[0]
    assert cost[2] < 0.1 * cost[0]


def test_an_acceleration_above_its_limit_between_two_nodes_is_corrected_locally(mikron: Machine, tmp_path: Path) -> None:
    head = "TRAORI\nCYCLE832(0.01,_ORI_FINISH,1)\nG0 X0 Y0 Z60 A0 C0\nG642 CTOL=0.01\n"
    moves = (
        "G1 X2.637 Y4.392 Z60.529 A=-5.234 C=10.611 F200\n"
        "X4.522 Y4.265 Z59.162 A=-0.670 C=25.331 F100\n"
        "X-3.141 Y4.925 Z63.599 A=-7.033 C=-10.038 F300\n"
    )
    program = read_program(write(tmp_path, head + moves), mikron)
    seconds = interpolate(program, mikron).time[-1] - interpolator.REST
    # C comes 10 % above its acceleration there: the whole motion would be 1.048 times as long
    assert seconds < 1.01 * measure.planned_time(program, mikron)


def test_polyline_of_a_circle_runs_like_the_circle(mikron: Machine, tmp_path: Path) -> None:
    """0.05 mm chords with the program's own rounding: the feed drops by little against the arc."""
    angle = np.arange(0.0, 2 * math.pi, 0.05 / 20.0)
    blocks = [f"X{20 * math.cos(a):.3f} Y{20 * math.sin(a):.3f}" for a in angle]
    chords = interpolate(read_program(write(tmp_path, "\n".join(["G642", "G0 " + blocks[0], "G1 F3000", *blocks[1:]])), mikron), mikron)
    arc = interpolate(read_program(write(tmp_path, "G642\nG0 X20 Y0\nG3 X20 Y0 I-20 J0 F3000"), mikron), mikron)
    assert measure.moving_time(chords) < 1.05 * measure.moving_time(arc)
    speed = chords.get("program", "path_speed")
    middle = speed[len(speed) // 4 : len(speed) // 2]
    assert middle.min() > 0.9 * middle.max()


def test_an_arc_keeps_its_radius(mikron: Machine, tmp_path: Path) -> None:
    trace = interpolate(read_program(write(tmp_path, "G60\nG0 X20 Y0\nG3 X20 Y0 I-20 J0 F3000"), mikron), mikron)
    radius = np.linalg.norm(trace.matrix("setpoint", ("X", "Y")), axis=1)
    assert np.abs(radius - 0.02).max() < 1e-7


def test_feed_is_reached_and_blocks_are_named(mikron: Machine, tmp_path: Path) -> None:
    trace = interpolate(read_program(write(tmp_path, "N10 G60\nN20 G1 X50 F1000\nN30 X100 F3000\n"), mikron), mikron)
    block, speed = trace.get("program", "block"), trace.get("program", "path_speed")
    assert speed[block == 20].max() == pytest.approx(1 / 60, rel=2e-3)
    assert speed[block == 30].max() == pytest.approx(3 / 60, rel=2e-3)
    assert trace.get("program", "path_length")[-1] == pytest.approx(0.1, rel=1e-3)
    assert np.all(np.diff(block) >= 0)


def test_exact_stop_stops_on_the_point(mikron: Machine, tmp_path: Path) -> None:
    trace = interpolate(read_program(write(tmp_path, "G60\nG1 X10 F6000\nG1 Y10\n"), mikron), mikron)
    corner = np.abs(trace.matrix("setpoint", ("X", "Y")) - [0.01, 0.0]).max(axis=1)
    assert (corner < 1e-12).sum() >= 0.06 / trace.period  # G601 waits


def test_brisk_is_faster_than_soft(mikron: Machine, tmp_path: Path) -> None:
    soft, brisk = (
        interpolate(read_program(write(tmp_path, f"G603 {mode}\nG1 X50 F10000\n"), mikron), mikron) for mode in ("SOFT", "BRISK")
    )
    assert brisk.time[-1] < 0.8 * soft.time[-1]
    assert np.abs(np.diff(brisk.get("X", "setpoint"), 2)).max() / brisk.period**2 <= mikron.axis("X").max_acceleration * 1.001


def test_set_points_written_in_blocks_equal_those_of_the_whole(mikron: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "G1 X20 Y5 F3000\nG4 F0.7\nG60 X0\nX1\nX2\nG64 X30 Y20\nX0 Y0\n"
    program = read_program(write(tmp_path, text), mikron)
    whole = interpolate(program, mikron)
    monkeypatch.setattr(interpolator, "BLOCK", 101)
    blocks = list(interpolator.set_point_blocks(program, mikron))
    assert len(blocks) > 5
    assert max(len(block.time) for block in blocks) <= 2 * 101
    parts = joined(blocks)
    assert np.array_equal(parts.time, whole.time)
    for key, values in whole.signals.items():
        assert np.array_equal(parts.signals[key], values), key


def test_hours_of_set_points_need_the_memory_of_one_block(mikron: Machine, tmp_path: Path) -> None:
    program = read_program(write(tmp_path, "G1 X50 F1\nG4 F3600\n"), mikron)
    tracemalloc.start()
    count = sum(len(block.time) for block in written(interpolator.set_point_blocks(program, mikron), tmp_path / "long.parquet"))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count * mikron.position_cycle > 6000.0
    assert most < 200e6  # all at once are 800 MB
    assert len(read_trace(tmp_path / "long.parquet", axes=mikron.kinds).time) == count


def test_a_great_circle_beyond_the_travel_of_a_is_refused(mikron: Machine, tmp_path: Path) -> None:
    """A ends at +30 deg: A and C must pass over the pole instead of switching to their other solution during the cut."""
    path = tmp_path / "swing.mpf"
    text = "TRAORI\nORIWKS\nG0 X0 Y0 Z150 A3={} B3={} C3=0.9\nG1 X0 Y40 A3={} B3={} C3=0.8 F1000\n"
    path.write_text(text.format(0.3, 0.2, 0.5, 0.0))
    with pytest.raises(InputError, match=r"line 4: on the way the tool axis asks for more than the travel of A"):
        interpolate(read_program(path, mikron), mikron)
    path.write_text(text.format(0.0, -0.2, 0.0, 0.3))
    angle = np.degrees(interpolate(read_program(path, mikron), mikron).get("A", "setpoint"))
    assert angle.min() < -12.0
    assert angle.max() > 20.0


def test_great_circle_keeps_the_tool_axis_in_its_plane(mikron: Machine, tmp_path: Path) -> None:
    text = "TRAORI\n{}\nG0 X0 Y0 Z200 A3=0.4 B3=-0.3 C3=1\nG1 X5 A3=-0.4 B3=-0.3 C3=1 F1000\n"
    off = {}
    for mode in ("ORIWKS", "ORIMKS"):
        program = read_program(write(tmp_path, text.format(mode)), mikron)
        axes = interpolate(program, mikron).matrix("setpoint", mikron.axis_names)
        direction = program.kinematics.forward(axes)[1]
        normal = np.cross(direction[0], direction[-1])
        off[mode] = np.abs(direction @ normal).max() / np.linalg.norm(normal)
        tip = program.kinematics.forward(axes)[0]
        assert np.abs(tip[:, 1:] - [0.0, 0.2]).max() < 1e-9  # the tip goes straight in any case
    assert off["ORIWKS"] < 2e-3 < off["ORIMKS"]


def test_the_error_budget_assigns_errors_to_their_level(mikron: Machine, tmp_path: Path) -> None:
    """Perfect following gives level 1 errors only; a lateral offset of 50 um is a level 2 error."""
    program = read_program(write(tmp_path, "G642 CTOL=0.01\nG1 X20 F3000\nY20\n"), mikron)
    setpoints = interpolate(program, mikron)
    perfect = Trace(setpoints.time, {(a, "position"): setpoints.get(a, "setpoint") for a in mikron.axis_names}, mikron.kinds)
    budget = error_budget(program, setpoints, perfect, mikron)
    assert 5e-6 < budget.rounding.max() <= 10e-6
    assert np.allclose(budget.contour, budget.rounding, atol=1e-9)
    assert budget.drives.max() < 1e-9
    # late by 10 ms: a following error along the path, hardly a contour error on the straight
    late = {(a, "position"): np.interp(setpoints.time - 0.01, setpoints.time, setpoints.get(a, "setpoint")) for a in mikron.axis_names}
    budget = error_budget(program, setpoints, Trace(setpoints.time, late, mikron.kinds), mikron)
    straight = (budget.path_length > 5e-3) & (budget.path_length < 15e-3)
    assert budget.following[straight].max() > 3e-4
    assert budget.contour[straight].max() < 1e-9
    aside = {**perfect.signals, ("Z", "position"): setpoints.get("Z", "setpoint") + 50e-6}
    budget = error_budget(program, setpoints, Trace(setpoints.time, aside, mikron.kinds), mikron)
    assert np.allclose(budget.drives, 50e-6, atol=1e-9)
    assert "rounding" in budget.table()


def test_the_examples_run(mikron: Machine) -> None:
    for name in ("two_planes.mpf", "vertical_corner.mpf", "five_axis.mpf", "pocket_edge.apt"):
        trace = interpolate(read_program(ROOT / "examples" / name, mikron), mikron)
        assert trace.time[-1] > 1.0
