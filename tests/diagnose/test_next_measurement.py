"""Proposed moves stay within travel and limits, return to their start, and excite what they are meant to."""

from dataclasses import replace
import math

import numpy as np
import pytest

from tests.builders.diagnosis_state import found_of, group_of
from twin.diagnose.next_measurement import KINDS, move_of, propose, propose_for
from twin.machine.machine import load_machine
from twin.simulation.setpoint_limits import limit_warnings
from twin.simulation.setpoints import setpoints_of

MACHINE = load_machine()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("axis", ["X", "C"])
def test_a_proposed_move_can_be_run(kind: str, axis: str) -> None:
    own = MACHINE.axis(axis)
    trace = move_of(kind, [own])
    q = trace.get(axis, "setpoint")
    low, high = own.travel
    assert (q.min() > low and q.max() < high) or not math.isfinite(low)
    assert 1.0 < trace.time[-1] < 120.0
    warnings = limit_warnings(setpoints_of(trace, MACHINE.with_axes([axis])), MACHINE.with_axes([axis]))
    assert all("jerk" in w for w in warnings) if kind == "chirp" else not warnings


def test_each_move_excites_its_quantity() -> None:
    axis = MACHINE.axis("X")
    q = {kind: move_of(kind, [axis]).get("X", "setpoint") for kind in KINDS}
    speed = {kind: np.diff(values) / 1e-3 for kind, values in q.items()}
    turns = np.flatnonzero(np.diff(np.sign(speed["micro-reversals"][np.abs(speed["micro-reversals"]) > 1e-9])))
    assert len(turns) >= 20
    steady = np.abs(speed["constant speeds"][np.abs(np.diff(speed["constant speeds"], append=0.0)) < 1e-9])
    assert len(set(np.round(steady[steady > 1e-6], 4))) >= 6
    spectrum = np.abs(np.fft.rfft(np.diff(speed["chirp"]) * np.hanning(len(speed["chirp"]) - 1)))
    hz = np.fft.rfftfreq(len(speed["chirp"]) - 1, 1e-3)
    assert spectrum[(hz > 5.0) & (hz < 75.0)].min() > 3.0 * spectrum[hz > 150.0].max()
    # jerk-limited move: d = 2 j (a / j)^3, unless the acceleration or speed limit is reached
    reach = np.ptp(q["accelerations"])
    most = min(axis.max_acceleration, (axis.max_velocity * axis.max_jerk) ** 0.5, (reach * axis.max_jerk**2 / 2.0) ** (1 / 3))
    assert reach == pytest.approx(0.35 * (axis.travel[1] - axis.travel[0]))
    assert np.abs(np.diff(speed["accelerations"]) / 1e-3).max() > 0.97 * most
    still = np.abs(speed["rest"]) < 1e-9
    assert still.sum() * 1e-3 > 30.0


def test_several_axes_wait_for_the_longest() -> None:
    trace = move_of("accelerations", [MACHINE.axis("X"), MACHINE.axis("C")])
    assert set(trace.axes) == {"X", "C"}
    assert len(trace.get("X", "setpoint")) == len(trace.get("C", "setpoint")) == len(trace.time)


def test_a_gap_without_an_effect_asks_for_the_move_that_shows_what_these_runs_do_not() -> None:
    blind = replace(
        found_of(group_of([np.full(50, 2.0)], "X")), not_visible={("current_limit", "X", None): math.inf, ("backlash", "X", None): 8.0}
    )
    text = propose_for(MACHINE, [blind], "X", 3.5).text
    assert text.startswith("axis X: micro-reversals (3.5 times the noise remains there, and these runs would not show backlash)")
    seen = replace(blind, not_visible={})
    assert propose_for(MACHINE, [seen], "X", 3.5).text.startswith(
        "axis X: constant speeds (3.5 times the noise remains there, and no known"
    )


def test_an_unexplained_residual_is_measured_on_the_axis_that_has_it() -> None:
    """C leaves more, but within what its noise allows."""
    unexplained, allowed = (found_of(group_of([np.full(50, level)], axis)) for axis, level in (("X", 2.0), ("C", 3.0)))
    assert propose(MACHINE, [replace(unexplained, unknown=True), allowed], "unknown", set()).text.startswith("axis X")
    assert propose(MACHINE, [unexplained, allowed], "unknown", set()).text.startswith("axis C")
