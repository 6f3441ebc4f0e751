"""Facts of an axis: planted numbers lie in their intervals, and what the motion cannot separate is not separated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.builders.strokes import Planted, strokes
from twin.diagnose.first.axis_facts import AxisFacts, facts_of
from twin.diagnose.first.card import card_of, card_text
from twin.identify.recorded_axis import slopes_of
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace


def facts(planted: Planted, seed: int) -> AxisFacts:
    found = facts_of([strokes(planted, seed)], "X")
    assert found is not None
    return found


def test_planted_numbers_lie_in_their_intervals() -> None:
    planted = Planted()
    held = []
    for seed in range(12):
        one = facts(planted, seed)
        f = one.friction
        assert f is not None
        assert f.coulomb is not None
        assert f.viscous is not None
        assert f.constant is not None
        assert one.transmission is not None
        assert one.transmission.lost is not None
        assert one.lags["off"].value == pytest.approx(planted.lag, abs=3e-5)
        assert one.noise == pytest.approx(planted.position_noise, rel=0.3)
        for value, true in (
            (f.coulomb, planted.coulomb),
            (f.viscous, planted.viscous),
            (f.constant, planted.constant),
            (one.transmission.lost, planted.lost),
        ):
            # starts and stops are smoothed by the band: 2 % of systematic error beside the interval
            held.append(abs(value.value - true) < value.half + 0.02 * true)
            assert value.half < 0.2 * true
    assert np.mean(held) > 0.9


def test_one_speed_gives_the_sum_of_frictions_only() -> None:
    one = facts(Planted(speeds=(0.05,)), 1)
    f = one.friction
    assert f is not None
    assert f.coulomb is None
    assert f.viscous is None
    assert one.one_speed
    assert f.at_speed.value == pytest.approx(1.5 + 4.0 * 0.05, rel=0.02)


def test_one_direction_gives_friction_and_weight_as_one_number() -> None:
    one = facts(Planted(both_ways=False), 1)
    assert one.strokes[1] == 0
    assert one.friction is not None
    assert one.friction.coulomb is None
    assert one.friction.constant is None
    # Coulomb friction and constant force are one number
    at = one.friction.speed
    assert one.friction.at_speed.value == pytest.approx(1.5 + 0.3 + 4.0 * at, rel=0.02)


def test_an_axis_without_friction_has_an_inertia() -> None:
    """As on an air bearing: the effort follows the acceleration alone."""
    planted = Planted(coulomb=0.0, viscous=0.0, constant=0.0)
    one = facts(planted, 6)
    assert one.friction is not None
    assert not one.friction.at_speed.known
    assert one.friction.inertia.value == pytest.approx(planted.inertia, rel=0.05)
    run = strokes(planted, 6)
    turned = {**run.trace.signals, ("X", "current"): -run.trace.get("X", "current")}
    against = facts_of([replace(run, trace=replace(run.trace, signals=turned))], "X")
    assert against is not None
    assert against.friction is not None
    assert against.friction.against
    text = card_text(card_of([run]))
    assert "below" in next(line for line in text.splitlines() if line.startswith("  friction"))
    assert "Coulomb" not in text
    volts = replace(one, friction=replace(one.friction, effort="voltage"))
    assert "any back EMF included" in card_text(replace(card_of([run]), facts=(volts,)))
    assert "starts" not in text


def test_noise_of_a_slow_motion_is_no_stroke_back() -> None:
    """A potentiometer in slow motion one way, and counts that flicker at rest: the signs of its speed change, its direction does not."""
    random = np.random.default_rng(7)
    time = np.arange(1600) * 3.4e-3
    position = 1e-3 * np.clip(time - 0.5, 0.0, 2.0) + 2e-5 * random.standard_normal(len(time))
    noisy = Trace(time, {("X", "position"): position}, {"X": "linear"})
    one = facts_of([MeasuredRun("slow", noisy, None, 0.0)], "X")
    assert one is not None
    assert one.strokes[1] == 0


def test_a_record_that_ends_in_motion_has_the_speed_and_acceleration_of_this_motion() -> None:
    time = np.arange(400) * 1e-3
    since = np.clip(time - 0.2, 0.0, None)
    position = np.where(since < 0.065, 0.5 * since**2, 0.065 * since - 0.5 * 0.065**2)
    speed, acceleration = slopes_of(position, 1e-3)
    assert np.abs(speed).max() == pytest.approx(0.065, rel=0.01)
    assert np.abs(acceleration).max() < 1.05


def test_a_force_of_the_opposite_sign_is_turned_and_said() -> None:
    run = strokes(Planted(), 2)
    signals = {**run.trace.signals, ("X", "current"): -run.trace.get("X", "current")}
    turned = facts_of([replace(run, trace=replace(run.trace, signals=signals))], "X")
    straight = facts_of([run], "X")
    assert turned is not None
    assert turned.friction is not None
    assert turned.friction.against
    assert straight is not None
    assert straight.friction is not None
    assert not straight.friction.against
    assert turned.friction.at_speed == pytest.approx(straight.friction.at_speed)


def test_a_vibration_is_found_with_its_size_and_none_is_not() -> None:
    one = facts(Planted(line=(32.0, 5e-7)), 3)
    assert one.vibration is not None
    assert one.vibration.frequency == pytest.approx(32.0, abs=1.0)
    assert one.vibration.amplitude == pytest.approx(5e-7, rel=0.2)
    assert [facts(Planted(), seed).vibration for seed in range(12)] == [None] * 12


def test_an_axis_at_rest_says_nothing() -> None:
    run = strokes(Planted(), 4)
    still = {key: np.random.default_rng(1).normal(0.0, 1e-7, len(values)) for key, values in run.trace.signals.items()}
    one = facts_of([replace(run, trace=replace(run.trace, signals=still))], "X")
    assert one is not None
    assert one.rows is None
    assert one.friction is None
    assert one.lags == {}


def test_an_unsigned_current_gives_no_friction() -> None:
    from twin.recordings.campaign import ChannelFact

    run: MeasuredRun = replace(strokes(Planted(), 5), facts={("X", "current"): ChannelFact(axis="X", signal="current", unsigned=True)})
    one = facts_of([run], "X")
    assert one is not None
    assert one.friction is None
