"""A record without a set point: the path is the recorded motion itself, so only the force along it is compared and no controller is judged."""

from types import SimpleNamespace

import pytest

from tests.builders.identify_campaigns import SHORT_QUICK, campaign, recorded, with_signal
from twin.diagnose.check_campaign import check_campaign, notes_of
from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.observe import observe
from twin.diagnose.plausible import is_ruled_out
from twin.diagnose.starts import start_at
from twin.diagnose.view import view_of
from twin.effects import EFFECTS
from twin.errors import InputError
from twin.machine.machine import Machine
from twin.simulation.gap import compared_signals


def test_along_its_own_path_an_axis_shows_its_force_and_nothing_of_its_controllers(mikron: Machine) -> None:
    machine = mikron.with_axes(["X"])
    run = recorded(machine, "quick", SHORT_QUICK[:1500], "velocity", 3)
    shown = run.trace
    own = with_signal(run, "X", "setpoint", shown.get("X", "position") + 1e-3)  # the zero of a path is free
    for name in ("velocity_setpoint", "motor_position"):
        own = with_signal(own, "X", name, None)
    assert not shown.follows_itself("X")
    assert compared_signals(shown, machine.axis("X")) == ["position", "motor_position", "velocity", "current"]
    assert compared_signals(own.trace, machine.axis("X")) == ["current"]
    assert any("the recorded motion itself" in note for note in notes_of(campaign([own]), machine))
    group = observe([view_of(machine, own)], ("X",))
    assert [c.name for c in group.channels] == ["current"]
    ruled_out = {
        name
        for name in ("position_gain", "speed_gain", "coulomb_friction")
        if is_ruled_out(group, start_at(EFFECTS[name], machine, machine.axis("X"), None, {}))
    }
    assert ruled_out == {"position_gain", "speed_gain"}
    check_campaign(campaign([own]), machine)
    with pytest.raises(InputError, match="nothing to compare: the set points are the recorded motion itself"):
        check_campaign(campaign([with_signal(own, "X", "current", None)]), machine)


def test_a_force_along_the_recorded_path_is_a_finding_behind_an_assumed_controller(
    mikron: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twin.diagnose.diagnosis.guessed_values", lambda _machine: {"axis.X.loops.position_gain_per_s": "assumed"})
    setting = start_at(EFFECTS["coulomb_friction"], mikron, mikron.axis("X"), None, {"factor": 1.4}).settings[0]
    for own_path, calibrated in ((frozenset("X"), 0), (frozenset(), 1)):
        state = SimpleNamespace(group=SimpleNamespace(has=lambda axis, name: False, on_own_path=own_path))
        found = Diagnosis.calibrated.func(SimpleNamespace(machine=mikron, named=[(setting, state, 0.9)]))  # type: ignore[attr-defined]
        assert len(found) == calibrated
