"""The time law where the feed changes: any ratio of two speeds, any length, against the closed form."""

import math
from pathlib import Path

from hypothesis import example, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from twin.errors import TwinError
from twin.geometry.kinematics import kinematics_of
from twin.machine.machine import Machine, load_machine
from twin.program import axis_path, blend, interpolate, interpolator, lookahead, nodes, read_program, sampling
from twin.program import elements as el


def ramp(change: float, limits: nodes.Limits) -> float:
    """Time of a change of the speed of X from and to constant speed."""
    peak = min(limits.acceleration[0], math.sqrt(change * limits.jerk[0]))
    return change / peak + peak / limits.jerk[0] if change > 0.0 else 0.0


def section_time(way: float, begin: float, end: float, most: float, limits: nodes.Limits) -> float | None:
    """Time of a way between two constant speeds at no more than `most`; None if it is too short to get from one to the other."""

    def needed(peak: float) -> float:
        return 0.5 * (begin + peak) * ramp(peak - begin, limits) + 0.5 * (end + peak) * ramp(peak - end, limits)

    low, high = max(begin, end), most
    if needed(low) > way:
        return None
    if needed(high) < way:
        low = high
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if needed(middle) < way else (low, middle)
    return ramp(low - begin, limits) + ramp(low - end, limits) + (way - needed(low)) / low


def two_section_time(ways: np.ndarray, speeds: np.ndarray, limits: nodes.Limits) -> float:
    """Time over two ways from rest to rest that passes their joint at constant speed: a motion within all limits, seldom the fastest."""

    def total(joint: float) -> float | None:
        first, second = section_time(ways[0], 0.0, joint, speeds[0], limits), section_time(ways[1], joint, 0.0, speeds[1], limits)
        return None if first is None or second is None else first + second

    low, high = 0.0, float(speeds.min())
    if (found := total(high)) is not None:
        return found
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if total(middle) is not None else (low, middle)
    found = total(low)
    assert found is not None
    return found


def planned(ways: np.ndarray, speeds: np.ndarray, machine: Machine) -> tuple[lookahead.TimeLaw, np.ndarray, blend.Spline, axis_path.Frames]:
    """The law of a straight way of X with two feeds, and the times of its nodes."""
    u = np.concatenate([[0.0], np.cumsum(ways)])
    points = np.zeros((3, 5))
    points[:, 0] = u
    none = np.zeros((2, 3))
    elements = el.Elements(u, points[:-1].copy(), np.diff(points, axis=0), none, none, np.zeros(2))
    feeds = nodes.Feeds(speeds, np.zeros(2, bool))
    spline = nodes.split_at_feeds(blend.blend(elements, np.full(3, 1e-5), np.full(3, 1e-3), np.zeros(3))[0], elements, feeds)
    frames = axis_path.frames_of(kinematics_of(machine, sites_needed=False), False)
    law = lookahead.plan(nodes.Way(spline, elements, frames, interpolator.limits_of(machine), feeds))
    return law, sampling.node_times(law.nodes, law.a, law.slope), spline, frames


def samples(law, times, spline, frames, period: float):  # type: ignore[no-untyped-def]
    """X and its speed along the path at each period."""
    count = math.ceil(times[-1] / period) + 1
    axes, u, tip, turn = np.empty((count, 5)), np.empty(count), np.empty(count), np.empty(count)
    sampling.sample(spline, frames, law, times, 1.0, 0, period, (axes, u, tip, turn))
    return axes, u, tip


MACHINE = load_machine()
decades = st.floats(-6.0, 0.0)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(decades, decades, st.floats(-2.0, 0.0), st.floats(0.0, 6.0), st.booleans())
@example(0.0, -2.7557314351390663e-07, 0.0, 1.0, False)  # a break of the spline 0.3 um before the change of feed: 0.7 % slower
def test_two_feeds_take_the_time_of_the_closed_form(first: float, second: float, fast: float, ratio: float, slow_first: bool) -> None:
    """Ways from 1 um to 1 m, speeds up to 1e6 apart: not slower than the closed form by 0.5 %, and within all limits."""
    limits = interpolator.limits_of(MACHINE)
    ways = 10.0 ** np.array([first, second])
    speeds = limits.speed[0] * 10.0 ** np.array([fast, fast - ratio])
    if slow_first:
        speeds = speeds[::-1].copy()
    law, times, spline, frames = planned(ways, speeds, MACHINE)
    closed = two_section_time(ways, speeds, limits)
    assert times[-1] < 1.005 * closed
    run_up = speeds * np.maximum(np.sqrt(speeds / limits.jerk[0]), 0.5 * speeds / limits.acceleration[0])
    if (ways > 1000.0 * run_up).all():
        assert times[-1] > 0.995 * closed
    if times[-1] < 1000.0:
        axes, u, tip = samples(law, times, spline, frames, MACHINE.position_cycle)
        assert interpolator._excess(np.zeros(5), [axes], MACHINE.position_cycle, limits) <= 1.0 + interpolator.WORTH_PLANNING
        assert axes[-1, 0] == pytest.approx(ways.sum(), rel=1e-12)
        assert (tip <= 1.0001 * speeds[np.minimum(np.searchsorted(np.cumsum(ways), u, side="right"), 1)]).all()


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.floats(-12.0, 0.0), st.floats(-12.0, 0.0), st.floats(-14.0, 6.0), st.floats(-6.0, 0.0))
def test_the_time_of_an_interval_ends_on_its_node(start: float, end: float, middle: float, way: float) -> None:
    """A quadratic a(u) with any positive Bernstein coefficients: the closed form of the motion is at the node after the interval's time."""
    a0, a1, h = 10.0**start, 10.0**end, 10.0**way
    b = math.sqrt(a0 * a1) * 10.0**middle
    x0, x1, y0, y1 = math.sqrt(a0), math.sqrt(a1), (b - a0) / h, (a1 - b) / h
    time = sampling._interval_time(x0, x1, y0, y1, h)
    # from the slower end, as the samples are taken
    moved, speed = sampling._moved(*((x0, y0) if x0 < x1 else (x1, -y1)), (y1 - y0) / h, time)
    assert moved == pytest.approx(h, rel=1e-9)
    assert speed == pytest.approx(max(x0, x1), rel=1e-9)


def at(folder: Path, text: str, name: str = "part.ngc"):  # type: ignore[no-untyped-def]
    path = folder / name
    path.write_text(text)
    return read_program(path, MACHINE)


@pytest.mark.parametrize("feed", [3.0, 30.0, 150.0])
@pytest.mark.parametrize(("axis", "way"), [("X", 7.0), ("Z", 15.0)])
def test_an_approach_runs_into_its_slow_feed_without_a_stop(tmp_path: Path, axis: str, way: float, feed: float) -> None:
    """Regression: the position jumped at a node, so that the move was slowed for hours or refused."""
    program = at(tmp_path, f"G21 G90\nG0 X0 Y0 Z0\nG0 {axis}100\nG1 {axis}{100.0 + way} F{feed}\nM2\n")
    trace = interpolate(program, MACHINE)
    cut = trace.get("program", "line") == 4
    speed = trace.get("program", "path_speed")[cut]
    assert cut.sum() * trace.period == pytest.approx(60.0 * way / feed, rel=5e-3, abs=0.2)
    assert np.median(speed) == pytest.approx(feed / 60e3, rel=1e-3)


@pytest.mark.parametrize("seconds", [6.0, 12.0])
@pytest.mark.parametrize(("ending", "way"), [("ngc", "Z0.0002"), ("ngc", "Z0.01"), ("mpf", "X-0.0005"), ("nc", "Y0.003")])
def test_a_block_in_inverse_time_takes_its_time_however_small_its_linear_way(tmp_path: Path, ending: str, way: str, seconds: float) -> None:
    """Regression: the estimate of the length divided the whole way, also that of C, by the feed of the linear axes."""
    f = 60.0 / seconds
    program = at(tmp_path, f"G90\nG0 X0 Y0 Z0 C0\nG93 G1 C170 F{f}\n{way} C340 F{f}\nM30\n", f"part.{ending}")
    trace = interpolate(program, MACHINE)
    assert trace.time[-1] == pytest.approx(2.0 * seconds, abs=0.4)
    speed = np.degrees(np.gradient(trace.get("C", "setpoint"), trace.period))
    assert np.median(speed) == pytest.approx(170.0 / seconds, rel=2e-3)


def test_a_jump_of_the_set_points_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Slowing does not make a jump smaller: the search for a slower motion ends with one line."""
    plain = sampling.sample

    def jumping(*given: object) -> None:
        plain(*given)
        axes = given[7][0]  # type: ignore[index]
        axes[len(axes) // 2 :, 0] += 1e-6

    monkeypatch.setattr(sampling, "sample", jumping)
    with pytest.raises(TwinError, match=r"line 3: the set points of the moves to line 4 exceed a limit .* report this program"):
        interpolate(at(tmp_path, "G21 G90\nG0 X0 Y0 Z0\nG1 X5 F1000\nX9\nM2\n"), MACHINE)
