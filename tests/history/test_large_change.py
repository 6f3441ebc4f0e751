"""A change far above noise is judged beside the twin's own error, causes that share a change enter together, and a record without set points is compared."""

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.builders.identify_campaigns import SHORT_QUICK, campaign, with_signal
from tests.builders.identify_campaigns import recorded as recorded_moves
from tests.machine.test_from_recording import LAB_AXIS, recorded
from twin.effects.change import add_effects
from twin.history.columns import directions_of
from twin.history.contrast import Contrast
from twin.history.since import Differences, _searched, differences
from twin.identify.from_recording import machine_from_recording
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import Campaign, read_campaign
from twin.recordings.trace import write_trace


def compared(tmp_path: Path, effects: Sequence[str], twin: Machine) -> Differences:
    """What a twin says of a recording of the lab axis with effects since one without."""
    machine, campaigns = load_machine(LAB_AXIS), []
    for name, more in (("then", []), ("now", effects)):
        (tmp_path / name).mkdir()
        campaigns.append(read_campaign(recorded(tmp_path / name, add_effects(machine, *more), 1.0), machine))
    ((found,), _) = differences(campaigns[1], campaigns[:1], twin, map, lambda _: None)
    return found


def test_a_change_far_above_noise_is_named_by_a_twin_that_errs(tmp_path: Path) -> None:
    """A gain that falls by 30 % moves an axis by 50 000 times its noise; the gain of the twin is 3 % off."""
    twin = add_effects(load_machine(LAB_AXIS), "position_gain:X:factor=1.03")
    found = compared(tmp_path, ["position_gain:X:factor=0.7"], twin)
    (one,) = found.found
    assert one.cause[0] == "position_gain"
    assert 1.0 + one.size * one.direction.unit == pytest.approx(0.7, abs=0.02)
    assert not found.is_unexplained


def test_friction_that_winds_up_an_unknown_spring_is_no_drift(tmp_path: Path, mikron: Machine) -> None:
    """The twin made from the recording is rigid. What it errs between the encoders was taken for a drift and a lead error; the current shows the friction."""
    machine = add_effects(mikron.with_axes(["X"]), "transmission_compliance:X:stiffness=1e8", "presliding:X:stiffness=5e7")
    runs = [
        with_signal(recorded_moves(add_effects(machine, *effects), "quick", SHORT_QUICK, "off", seed), "X", "velocity_setpoint", None)
        for seed, effects in ((3, ()), (4, ("coulomb_friction:X:factor=1.4",)))
    ]
    write_trace(runs[0].trace, tmp_path / "quick.parquet")
    (tmp_path / "campaign.toml").write_text('[[run]]\nfile = "quick.parquet"\nfeedforward = "off"\n')
    machine_from_recording(tmp_path, tmp_path / "made.toml")
    ((found,), _) = differences(campaign(runs[1:]), [campaign(runs[:1])], load_machine(tmp_path / "made.toml"), map, lambda _: None)
    assert {one.cause[0]: one.size * one.direction.unit for one in found.found} == pytest.approx({"coulomb_friction": 0.4}, abs=0.03)


@pytest.mark.parametrize("lag", ["", "speed_record_lag", "speed_set_point_lag"])
def test_a_recorded_speed_set_point_shows_how_large_a_change_of_the_gain_is(mikron: Machine, lag: str) -> None:
    """Its controller was simulated at the position of the healthy axis: 3 % of the change had no name. A lag of the record is known."""
    machine = mikron.with_axes(["X"])
    machine = machine.with_values({f"axis.X.block.{lag}.time_constant_s": 3e-3}) if lag else machine
    then, now = (
        campaign([recorded_moves(add_effects(machine, *effects), "quick", SHORT_QUICK[:1500], "off", seed)])
        for seed, effects in ((3, ()), (4, ("position_gain:X:factor=0.7",)))
    )
    ((found,), _) = differences(now, [then], machine, map, lambda _: None)
    assert {one.cause[0]: 1.0 + one.size * one.direction.unit for one in found.found} == pytest.approx({"position_gain": 0.7}, abs=0.02)
    assert not found.is_unexplained


def test_two_causes_of_one_change_are_both_named(tmp_path: Path) -> None:
    """Each alone leaves a change that is large beside what it explains."""
    found = compared(tmp_path, ["coulomb_friction:X:factor=1.4", "viscous_friction:X:factor=1.4"], load_machine(LAB_AXIS))
    sizes = {one.cause[0]: 1.0 + one.size * one.direction.unit for one in found.found}
    assert sizes == pytest.approx({"coulomb_friction": 1.4, "viscous_friction": 1.4}, abs=0.03)


def test_a_record_without_set_points_shows_friction_and_no_controller(mikron: Machine) -> None:
    machine = mikron.with_axes(["X"])

    def along_itself(*effects: str) -> Campaign:
        run = recorded_moves(add_effects(machine, *effects), "quick", SHORT_QUICK[:1500], "velocity", 3)
        run = with_signal(run, "X", "setpoint", run.trace.get("X", "position"))
        for name in ("velocity_setpoint", "motor_position"):
            run = with_signal(run, "X", name, None)
        return campaign([run])

    ((found,), _) = differences(along_itself("coulomb_friction:X:factor=1.4"), [along_itself()], machine, map, lambda _: None)
    assert [one.cause[0] for one in found.found] == ["coulomb_friction"]
    assert {("position_gain", "X", ""), ("speed_gain", "X", "")} <= set(found.not_seen)


def test_a_size_is_that_of_the_simulation_where_slopes_explain_hardly_more(mikron: Machine) -> None:
    """A response grows faster than its size; the twin errs a little beside it, so the slope of a small change explains a large one 2 nat better."""
    directions = directions_of(mikron, ("X",))
    k = next(k for k, d in enumerate(directions) if d.cause[0] == "position_gain")
    gram = 1e6 * np.eye(len(directions))

    def rights_of(changes: list) -> dict[str, np.ndarray]:
        theta = np.array([sum(theta for d, theta in changes if d is one) for one in directions])
        theta[k] *= 1.0 + 0.06 * abs(theta[k])
        return {"X position": gram @ (theta + 0.004 * abs(theta[k]) * (np.arange(len(directions)) == k + 1))}

    moved = gram[k] * 2.0 * 1.12
    runs = [("run", SimpleNamespace(rights_of=rights_of))]
    contrast = Contrast(directions, runs, [gram[None]], [moved[None]], ["X position"], np.full(len(directions), 1e-6), 1.0, [])  # type: ignore[arg-type]
    (one,) = _searched(contrast, ("X",)).found
    assert one.cause[0] == "position_gain"
    assert one.size == pytest.approx(2.0, rel=0.03)
