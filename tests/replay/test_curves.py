"""Contour error, decimation and events against what they must be by construction."""

from dataclasses import replace
import itertools
from pathlib import Path

import numpy as np
import pytest

from twin.compare.align import on_clock_of
from twin.geometry.tool_path import contour_of, keep_shape
from twin.machine.machine import load_machine
from twin.recordings.trace import Trace
from twin.replay.blueprint import GROUP_TITLES, _even_range
from twin.replay.curves import SET_POINT, PlotLine, axis_curves, line_width, not_recorded, torque_parts
from twin.replay.decimate import SAME_LINE, decimate, thinned
from twin.replay.events import find_events, stretches, turning_points
from twin.replay.recording import LEAST_CURVE_POINTS
from twin.replay.scene import scene_of
from twin.replay.toolpaths import PATH_TOLERANCE, bands_of, end_of_scale, kept_points, magnifications, tool_paths_of
from twin.report.colours import ERROR_BANDS

MACHINE = load_machine()


def trace_of(time: np.ndarray, **signals: np.ndarray) -> Trace:
    """A trace of axis X from keyword arguments, program columns as program_<name>."""
    named = {("program", key[8:]) if key.startswith("program_") else ("X", key): np.asarray(value, float) for key, value in signals.items()}
    return Trace(time, named, {"X": "linear"})


def circle(time: np.ndarray, radius: float, phase: float = 0.0) -> np.ndarray:
    angle = 2.0 * np.pi * time + phase
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(time)])


def test_contour_error_of_a_circle_too_large_by_5_um() -> None:
    time = np.arange(2001) * 1e-3
    contour = contour_of(time, circle(time, 0.015 + 5e-6), time, circle(time, 0.015))
    # the reference is a polygon: it lies inside its circle by at most r (pi T)^2 / 2
    assert np.allclose(contour.error, 5e-6, atol=0.015 * (np.pi * 1e-3) ** 2 / 2 + 1e-12)


def test_a_delay_along_the_path_is_not_a_contour_error() -> None:
    time = np.arange(1001) * 1e-3
    line = np.outer(0.1 * time**2, [1.0, 2.0, -1.0])
    late = np.outer(0.1 * np.maximum(time - 0.02, 0.0) ** 2, [1.0, 2.0, -1.0])
    assert contour_of(time, late, time, line).error.max() < 1e-12


def test_a_crossing_path_is_compared_with_its_own_neighbourhood() -> None:
    time = np.arange(4001) * 1e-3
    eight = np.column_stack([np.sin(np.pi * time), np.sin(2 * np.pi * time), np.zeros_like(time)]) * 0.1
    off = eight + np.array([0.0, 0.0, 3e-6])
    assert np.allclose(contour_of(time, off, time, eight).error, 3e-6, rtol=1e-9)


def test_magnified_path_moves_only_the_deviation() -> None:
    time = np.arange(1001) * 1e-3
    line = np.outer(time, [1.0, 0.0, 0.0])
    followed = line + np.array([0.0, 2e-6, 0.0])
    magnified = contour_of(time, followed, time, line).magnified(followed, 1000)
    assert np.allclose(magnified, line + np.array([0.0, 2e-3, 0.0]), atol=1e-12)


def test_omitted_path_points_lie_within_the_tolerance() -> None:
    time = np.linspace(0.0, 1.0, 5000)
    points = circle(time, 0.05) + np.column_stack([np.zeros_like(time), np.zeros_like(time), 0.01 * np.sin(40 * time)])
    keep = np.zeros(len(points), bool)
    keep_shape(points, 2e-6, keep)
    kept = points[keep]
    assert keep.sum() < len(points) / 4
    # distance of every point from the kept polyline
    left = np.maximum(np.searchsorted(np.flatnonzero(keep), np.arange(len(points)), side="right") - 1, 0).clip(0, len(kept) - 2)
    a, b = kept[left], kept[left + 1] - kept[left]
    part = np.clip(np.einsum("ni,ni->n", points - a, b) / np.einsum("ni,ni->n", b, b), 0, 1)
    assert np.linalg.norm(points - a - part[:, None] * b, axis=1).max() <= 2e-6 * (1 + 1e-9)


def test_a_busy_path_is_held_within_its_number_of_points() -> None:
    rng = np.random.default_rng(0)
    points = np.cumsum(rng.standard_normal((30_000, 3)), axis=0) * 1e-4
    assert len(kept_points(points, 2e-6, np.array([], int), 30.0, full=False)) <= 3000
    assert len(kept_points(points, 2e-6, np.array([], int), 30.0, full=True)) == 30_000


def test_scale_has_round_bands_that_hold_the_errors() -> None:
    for largest in (3e-9, 1e-6, 7.9e-6, 8.1e-6, 3.3e-5, 2e-3):
        end = end_of_scale(np.full(100, largest))
        assert f"{end * 1e6 / len(ERROR_BANDS):.0e}"[0] in "125"
        assert end >= largest * (1 - 1e-9)
        assert bands_of(np.array([0.0, end * 10]), end).tolist() == [0, 7]


@pytest.mark.parametrize("shape", ["noise", "steps", "sine", "constant", "spike"])
def test_decimated_curve_keeps_ends_extremes_and_shape(shape: str) -> None:
    rng = np.random.default_rng(2)
    time = np.arange(20_001) * 1e-3
    spike = np.where(np.arange(20_001) == 7777, 1.0, 0.0)
    values = {"noise": rng.standard_normal(20_001), "steps": np.floor(time), "sine": np.sin(time), "constant": 0 * time, "spike": spike}[
        shape
    ]
    kept = thinned(time, values, 16)
    assert kept[0] == 0
    assert kept[-1] == 20_000
    assert values[kept].min() == values.min()
    assert values[kept].max() == values.max()
    if shape in ("sine", "constant", "steps", "spike"):
        assert len(kept) < 700
        assert np.abs(np.interp(time, time[kept], values[kept]) - values).max() <= (SAME_LINE + 1e-4) * (np.ptp(values) + 1e-12)


def test_budget_is_shared_and_quiet_curves_keep_their_detail() -> None:
    rng = np.random.default_rng(3)
    time = np.arange(60_000) * 1e-3
    curves = [(time, np.sin(time))] + [(time, rng.standard_normal(60_000)) for _ in range(9)]
    kept = decimate(curves, 20_000)
    assert sum(map(len, kept)) <= 20_000
    assert np.abs(np.interp(time, time[kept[0]], np.sin(time[kept[0]])) - np.sin(time)).max() < 2e-3
    for (_, values), steps in zip(curves, kept):
        assert values[steps].max() == values.max()
        assert values[steps].min() == values.min()


def test_a_short_recording_keeps_every_sample() -> None:
    """What fits the budget is not thinned: a smooth curve stays smooth however far the viewer zooms in."""
    time = np.arange(1900) * 1e-3
    curves = [(time, 0.2 * np.sin(3.0 * time + phase)) for phase in range(40)]
    assert all(len(kept) == len(time) for kept in decimate(curves, LEAST_CURVE_POINTS))


def test_reversals_at_the_turning_points_and_not_in_the_rounding() -> None:
    time = np.arange(3001) * 1e-3
    position = np.round(0.01 * np.sin(2 * np.pi * time), 9)
    turns = [e for e in find_events(MACHINE, trace_of(time, setpoint=position)) if e.kind == "reversal"]
    assert np.allclose([e.start for e in turns], [0.25, 0.75, 1.25, 1.75, 2.25, 2.75], atol=1.5e-3)
    assert "+ to -" in turns[0].text
    assert "- to +" in turns[1].text
    jitter = 1e-8 * (-1.0) ** np.arange(3001)
    assert turning_points(time * 0.01 + jitter, 1e-6) == []


def test_turning_points_alternate_and_lie_at_least_a_move_apart() -> None:
    rng, least = np.random.default_rng(1), 1.13
    for _ in range(300):
        position = np.round(np.cumsum(rng.standard_normal(60) * rng.choice([0, 1, 3], 60)), 1)
        turns = turning_points(position, least)
        for (i, before), (j, after) in itertools.pairwise(turns):
            assert i < j
            assert before == -after
            assert before * (position[i] - position[j]) >= least
    # the move from the lowest sample counts, not that from the first one
    assert turning_points(np.array([1.4, 0.7, 2.1, -2.0]), least) == [(2, 1)]


def test_a_rest_at_the_turn_reverses_when_it_leaves() -> None:
    position = np.concatenate([np.linspace(0, 1, 11), np.ones(5), np.linspace(1, 0, 11)])
    assert turning_points(position, 1e-6) == [(16, 1)]


def test_limits_sticking_and_blocks_have_their_times() -> None:
    time = np.arange(2001) * 1e-3
    axis = MACHINE.axis("X")
    setpoint = 0.01 * time
    position = np.where(time < 0.5, setpoint, np.where(time < 0.6, 0.005, setpoint))
    current = np.where((time > 1.0) & (time < 1.05), -axis.motor.peak_current_a, 3.0)
    velocity = np.where((time > 1.5) & (time < 1.52), axis.max_velocity, 0.01)
    block = np.floor(time / 0.7) * 10 + 10
    events = find_events(
        MACHINE, trace_of(time, setpoint=setpoint, position=position, current=current, velocity=velocity, program_block=block)
    )
    spans = {e.kind: (e.start, e.end) for e in events if e.kind not in ("block",)}
    assert spans["current limit"] == pytest.approx((1.001, 1.049), abs=1e-9)
    assert spans["speed limit"] == pytest.approx((1.501, 1.519), abs=1e-9)
    assert spans["sticking"] == pytest.approx((0.5, 0.6), abs=4e-3)
    assert [(e.text, round(e.start, 3)) for e in events if e.kind == "block"] == [("block 20", 0.7), ("block 30", 1.4)]


def test_a_standing_axis_does_not_stick() -> None:
    time = np.arange(1001) * 1e-3
    noise = 5e-8 * np.random.default_rng(0).standard_normal(1001)
    assert find_events(MACHINE, trace_of(time, setpoint=0 * time, position=noise)) == []


def test_stretches_shorter_than_two_milliseconds_are_noise() -> None:
    time = np.arange(10) * 1e-3
    holds = np.array([0, 1, 0, 1, 1, 1, 0, 0, 1, 1], bool)
    assert stretches(time, holds) == [(0.003, 0.005)]


def test_torque_splits_without_a_rest() -> None:
    rng = np.random.default_rng(4)
    time = np.arange(100) * 1e-3
    given = {name: rng.standard_normal(100) for name in ("torque", "torque_friction", "torque_gravity", "torque_feedforward")}
    parts = torque_parts(trace_of(time, **given), MACHINE.axis("X"))
    assert np.allclose(parts["inertia"] + parts["friction"] + parts["gravity"], parts["motor"])
    measured = torque_parts(trace_of(time, current=given["torque"]), MACHINE.axis("X"))
    assert list(measured) == ["motor"]
    assert np.allclose(measured["motor"], 1.4 * given["torque"])


def test_a_current_far_from_its_limit_is_not_squeezed_by_it() -> None:
    time = np.arange(100) * 1e-3
    limit = MACHINE.axis("X").motor.peak_current_a
    for share, lines in ((0.1, 0), (0.9, 2)):
        curves = axis_curves(MACHINE, {"run": trace_of(time, position=time, current=share * limit * np.cos(time))})
        drawn = [curve.values for curve in curves if "limit" in curve.path]
        assert len(drawn) == lines
        assert all(np.all(np.abs(values) == limit) for values in drawn)


def test_runs_differ_by_colour_and_width() -> None:
    time = np.arange(100) * 1e-3
    trace = trace_of(time, setpoint=time, position=time, current=time)
    curves = axis_curves(MACHINE, {"measured": trace, "nominal": trace, "corrected": trace})
    positions = [c for c in curves if c.path.startswith("/axes/X/position/") and c.key != SET_POINT]
    assert [c.key for c in positions] == ["measured", "nominal", "corrected"]
    assert len({c.colour for c in positions}) == 3
    assert [c.run for c in positions] == [0, 1, 2]
    assert line_width(0, True) > 2.0 * line_width(1, True) > 2.0 * line_width(2, True)  # each is seen beside the ones upon it


@pytest.mark.parametrize("values", [[-9.3, 8.1], [0.0, 0.004], [-250.0, 250.0], [1.99, 2.01]])
def test_a_plot_ends_at_even_numbers(values: list[float]) -> None:
    """At least two multiples of the power of ten below its span are in view; without them the viewer labels 0 alone."""
    axis = _even_range([PlotLine("/axes/X/torque/a", "", (0, 0, 0), np.arange(2.0), np.array(values))])
    low, high = (float(v) for v in axis.range.as_arrow_array().to_pylist()[0])
    step = 10.0 ** np.floor(np.log10(np.ptp(values)))
    assert low < min(values)
    assert max(values) < high
    assert np.floor(high / step) - np.ceil(low / step) >= 1


def test_a_magnified_path_keeps_its_shape() -> None:
    """1.9 s at 1 kHz of a deviation of 10 um, magnified 100 times: a point for each bend, no polygon of 60."""
    t = np.linspace(0.0, 1.9, 1900)
    points = np.column_stack([0.1 * t, 1e-3 * np.sin(60.0 * t), np.zeros_like(t)])
    assert len(kept_points(points, PATH_TOLERANCE, np.array([], int), 1.9, False)) > 300


def test_missing_signals_of_a_measured_trace_are_named() -> None:
    time = np.arange(10) * 1e-3
    trace = trace_of(time, setpoint=time, position=time, current=time)
    assert not_recorded(trace, MACHINE) == ["X: speed, speed set point, torque of friction, torque of gravity, torque of feedforward"]


def test_every_curve_has_its_own_entity_and_a_name_with_a_unit() -> None:
    time = np.arange(100) * 1e-3
    trace = trace_of(time, setpoint=time, position=time, velocity=time, velocity_setpoint=time, current=time, torque=time)
    later = replace(trace, signals={key: values + 1e-6 for key, values in trace.signals.items()})
    curves = axis_curves(MACHINE, {"before": trace, "after": later})
    assert len({curve.path for curve in curves}) == len(curves)
    for curve in curves:
        assert curve.name.startswith("X ")
        assert curve.name.endswith(("[mm]", "[um]", "[mm/s]", "[A]", "[Nm]"))
    difference = next(c for c in curves if "difference_position" in c.path)
    assert difference.name == "X position, after - before [um]"
    assert np.allclose(difference.values, 1.0)


def test_invisible_deviations_are_not_magnified() -> None:
    assert magnifications(6e-9, 0.1) == (1,)  # 0.006 um: rounding
    assert magnifications(10e-6, 0.1) == (1, 100, 1000)
    assert magnifications(10e-6, 0.01) == (1, 10, 100)
    assert magnifications(1e-3, 0.1) == (1, 10)


def test_a_machine_without_named_tool_has_a_path() -> None:
    """The gantry's model names neither tool nor workpiece."""
    machine = load_machine(Path(__file__).resolve().parents[2] / "examples" / "gantry" / "gantry.toml")
    time = np.arange(200) * 1e-3
    asked = {(axis, s): 0.05 * np.sin(k * time) for k, axis in ((5, "x"), (7, "y")) for s in ("setpoint", "position")}
    paths = tool_paths_of(scene_of(machine), machine, {"run": Trace(time, asked, machine.kinds)})
    assert paths is not None
    assert np.allclose(np.ptp(paths.followed["run"][:, :2], axis=0), [np.ptp(asked["x", "position"]), np.ptp(asked["y", "position"])])


def test_titles_of_tabs_fit() -> None:
    """The viewer cuts longer ones off where a column holds several plots as tabs."""
    for group, title in GROUP_TITLES.items():
        assert len(title) <= (12 if group in ("error_without_delay", "following_error", "position") else 14)


@pytest.mark.parametrize("shift", [0.0, 0.35, -0.2513])
def test_a_second_run_is_laid_onto_the_set_points_of_the_first(shift: float) -> None:
    time = np.arange(2000) * 1e-3

    def asked(t: np.ndarray) -> np.ndarray:
        return 0.01 * np.sin(4.0 * np.clip(t - 0.6, 0.0, 1.0)) ** 2

    first = trace_of(time, setpoint=asked(time), position=asked(time - 0.002))
    second = trace_of(time, setpoint=asked(time + shift), position=asked(time + shift - 0.003))
    shifted, found = on_clock_of(first, second)
    assert found == pytest.approx(shift, abs=2e-6)
    assert np.allclose(shifted.get("X", "setpoint"), asked(shifted.time), atol=1e-7)


def test_other_motions_and_runs_without_set_points_stay_where_they_are() -> None:
    time = np.arange(2000) * 1e-3
    first = trace_of(time, setpoint=np.sin(5.0 * time), position=time)
    for other in (trace_of(time, setpoint=np.sin(9.0 * time) ** 3, position=time), trace_of(time, position=time)):
        assert on_clock_of(first, other) == (other, 0.0)


def test_a_run_with_its_own_set_points_is_compared_with_them() -> None:
    """Two variants of a study on different paths: the second one follows its own, not the first one's."""
    time = np.arange(200) * 1e-3
    scene = scene_of(MACHINE)

    def run(length: float) -> Trace:
        asked = length * np.sin(np.linspace(0.0, np.pi, len(time)))
        return Trace(time, {("X", "setpoint"): asked, ("X", "position"): asked, ("Y", "position"): np.full(len(time), 1e-6)}, MACHINE.kinds)

    paths = tool_paths_of(scene, MACHINE, {"a": run(0.01), "b": run(0.2)})
    assert paths is not None
    assert max(contour.error.max() for contour in paths.contours.values()) < 2e-6
