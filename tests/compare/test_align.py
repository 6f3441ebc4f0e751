"""Comparisons: recordings that begin at different times, feeds that differ, motions that are not the same."""

import numpy as np
import pytest

from twin.compare.align import PATH, TIME, aligned
from twin.compare.compare import compare, differing_numbers
from twin.effects import with_effects
from twin.errors import InputError
from twin.machine.machine import Machine
from twin.recordings.trace import Trace

T = np.arange(0.0, 2.0, 1e-3)


def stroke(start: float = 0.3, seconds: float = 1.0, lag: float = 0.0, length: float = 0.05) -> Trace:
    """A smooth stroke of X that begins at `start` and follows `lag` metres behind."""
    u = np.clip((T - start) / seconds, 0.0, 1.0)
    asked = length * (u - np.sin(2 * np.pi * u) / (2 * np.pi))
    return Trace(T, {("X", "setpoint"): asked, ("X", "position"): asked - lag}, {"X": "linear"})


@pytest.mark.parametrize(("other", "by"), [(stroke(), TIME), (stroke(start=0.4567), TIME), (stroke(seconds=0.7), PATH)])
def test_equal_motions_do_not_differ(other: Trace, by: str, mikron: Machine) -> None:
    first, second, how = aligned(stroke(), other)
    assert how == by
    np.testing.assert_allclose(first.get("X", "setpoint"), second.get("X", "setpoint"), rtol=0, atol=2e-6)
    assert compare(stroke(), other, mikron).differences[0].max < 2.0  # um


def test_a_lag_is_found_though_the_recording_begins_later(mikron: Machine) -> None:
    found = compare(stroke(), stroke(start=0.5, lag=7e-6), mikron)
    assert found.differences[0].max == pytest.approx(7.0, abs=0.6)
    assert found.differences[0].rms == pytest.approx(7.0, abs=0.1)
    assert "differ on" in found.verdict


def test_rounding_is_no_difference(mikron: Machine) -> None:
    found = compare(stroke(), stroke(lag=3e-17), mikron)
    assert found.differing == ()
    assert "move alike" in found.verdict
    assert compare(stroke(), stroke(lag=3e-9), mikron).differing == ("X",)


def test_other_motion_is_refused(mikron: Machine) -> None:
    with pytest.raises(InputError, match="not the same motion"):
        compare(stroke(), stroke(length=0.06), mikron)
    other = stroke()
    other = Trace(T, {("Y", s): values for (_, s), values in other.signals.items()}, {"Y": "linear"})
    with pytest.raises(InputError, match="no axis has set points in both"):
        compare(stroke(), other, mikron)


def test_machines(mikron: Machine) -> None:
    assert differing_numbers(mikron, mikron) == []
    path = "axis.X.loops.position_gain_per_s"
    (number,) = differing_numbers(mikron, mikron.with_values({path: 99.0}))
    assert (number.path, number.second) == (path, 99.0)


def test_couplings_to_several_axes_are_compared(mikron: Machine) -> None:
    def coupled(of_y: float) -> Machine:
        sizes = {"Y": of_y, "Z": 60.0}
        return with_effects(mikron, [{"name": "cross_axis_coupling", "axis": "X", "from_axis": a, "mass": k} for a, k in sizes.items()])

    (number,) = differing_numbers(coupled(40.0), coupled(90.0))
    assert (number.first, number.second) == (40.0, 90.0)
