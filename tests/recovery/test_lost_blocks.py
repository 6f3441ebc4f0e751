"""Compensations that the file of a machine lists and its control lost, or holds with another size: named from a record, with their size."""

from __future__ import annotations

from dataclasses import replace
import math
from typing import Any

import pytest

from tests.builders.identify_campaigns import campaign, usual_runs
from twin import diagnose
from twin.diagnose import recorded_control
from twin.effects import with_effects
from twin.identify.axis_run import axis_run
from twin.identify.position_control import PositionControl, fit_position_control
from twin.machine.machine import Machine

AT_ONCE = {"axis.X.loops.position_delay_s": 0.0, "axis.X.loops.feedforward_delay_s": 0.0}
TABLE = {"slope_ppm": 30.0, "origin_m": 0.0, "sine_m": 3e-6, "cosine_m": 0.0, "wavelength_m": 0.01}
LISTED: dict[str, dict[str, Any]] = {
    "compensated": {
        "friction_pulse": {"amplitude_m_per_min": 0.015, "decay_time_s": 0.015},
        "backlash_value": {"width_m": 1e-5, "cycles": 4},
        "position_correction": TABLE,
        "set_point_lag": {"time_constant_s": 0.004},
    },
    "pid": {"pid": {"acceleration_feedforward_s": 1e-3, "integral_gain_per_s2": 20.0, "dead_band_m": 1e-6}},
}


@pytest.fixture(scope="module")
def machines(mikron: Machine) -> dict[str, Machine]:
    one = mikron.with_axes(["X"])
    return {
        name: (one.with_values(AT_ONCE) if name == "pid" else one).with_values({"axis.X.block": blocks}) for name, blocks in LISTED.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "planted"),
    [
        ("compensated", {}),
        ("compensated", {"friction_pulse": 0.0, "coulomb_friction": 1.4}),
        ("compensated", {"backlash_value": 0.5, "position_correction": 0.0}),
        ("pid", {"velocity_feedforward": 0.0, "pid_feedforward_2": 0.0}),
        ("pid", {"pid_integral": 0.5}),
        ("pid", {"pid_dead_band": 2.0}),
    ],
)
def test_what_a_control_lost_is_named_with_its_size(machines: dict[str, Machine], name: str, planted: dict[str, float]) -> None:
    nominal = machines[name]
    real = with_effects(nominal, [{"name": effect, "axis": "X", "factor": factor} for effect, factor in planted.items()])
    found = diagnose(campaign(usual_runs(real, short=True)), nominal).document()
    named = {e["effect"]: e["parameters"]["factor"] for e in found["effects"]}
    assert named.keys() == planted.keys()
    assert not found["laws"]
    for effect, factor in planted.items():
        assert named[effect]["low"] - 1e-9 <= factor <= named[effect]["high"] + 1e-9, effect
        assert named[effect]["high"] - named[effect]["low"] < 0.3, effect


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "number"),
    [("friction_pulse", "friction_pulse.amplitude_m_per_min = 0.015 "), ("pid", "pid.integral_gain_per_s2 = 20 ")],
)
def test_a_block_that_the_file_does_not_list_is_read_from_the_speed_set_point(machines: dict[str, Machine], name: str, number: str) -> None:
    """No effect explains it, and the note gives its numbers as `identify` writes them."""
    plain = machines["pid" if name == "pid" else "compensated"].with_values({"axis.X.block": {}})
    real = plain.with_values({"axis.X.block": {name: LISTED["pid" if name == "pid" else "compensated"][name]}})
    found = diagnose(campaign(usual_runs(real, short=True)), plain).document()
    assert found["verdict"] == "unknown"
    assert any(number in note and "the machine file does not list" in note for note in found["notes"])


def test_a_number_that_no_record_determines_is_not_said(mikron: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = mikron.with_axes(["X"])
    runs = usual_runs(machine, short=True)[:1]
    law = fit_position_control(machine.axes[0], [one for run in runs if (one := axis_run(machine, machine.axes[0], run))])
    assert isinstance(law, PositionControl)
    for half in (1e-4, math.inf):
        said = replace(law, blocks={"friction_pulse.amplitude_m_per_min": (0.01, half)})
        monkeypatch.setattr(recorded_control, "fit_position_control", lambda *_, said=said, **__: said)
        notes = recorded_control.unlisted_blocks(machine, runs, ["X"])
        assert len(notes) == math.isfinite(half)
