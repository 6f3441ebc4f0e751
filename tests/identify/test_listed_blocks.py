"""Blocks that a machine file lists and the recorded control does not have: said, and no number of the law is stated beside a false one."""

from __future__ import annotations

from typing import Any

import pytest

from tests.builders.identify_campaigns import campaign, usual_runs
from twin.effects import with_effects
from twin.identify.identify import identify
from twin.machine.machine import Machine

PULSE = {"friction_pulse": {"amplitude_m_per_min": 0.015, "decay_time_s": 0.015}}
AT_ONCE = {"axis.X.loops.position_delay_s": 0.0, "axis.X.loops.feedforward_delay_s": 0.0}
PID = {"pid": {"acceleration_feedforward_s": 1e-3, "integral_gain_per_s2": 20.0}}
TABLE = {"slope_ppm": 30.0, "origin_m": 0.0, "sine_m": 3e-6, "cosine_m": 0.0, "wavelength_m": 0.01}
SET_POINTS: dict[str, dict[str, Any]] = {
    "backlash_value": {"width_m": 1e-5, "cycles": 4},
    "position_correction": TABLE,
    "set_point_lag": {"time_constant_s": 0.004},
}


LAGS = {"speed_set_point_lag": {"time_constant_s": 0.002}}


def said_of(machine: Machine, blocks: dict[str, Any], lost: dict[str, float]) -> tuple[list[str], bool]:
    """Findings about the file of a machine that lists blocks, from a record with some of them lost, and whether it states a position gain."""
    nominal = machine.with_axes(["X"]).with_values({"axis.X.block": blocks} | (AT_ONCE if "pid" in blocks else {}))
    real = with_effects(nominal, [{"name": name, "axis": "X", "factor": factor} for name, factor in lost.items()])
    result = identify(campaign(usual_runs(real, short=True)), nominal, refine=False, gaps=False)
    return [f.text for f in result.findings if "the file lists" in f.text], "X" in result.direct.position


@pytest.mark.parametrize("name", SET_POINTS)
def test_a_false_block_of_the_set_points_leaves_no_gain(mikron: Machine, name: str) -> None:
    (said,), stated = said_of(mikron, {name: SET_POINTS[name]}, {name: 0.0})
    assert f"the file lists {name.replace('_', ' ')}, but without it the law leaves" in said
    assert not stated


@pytest.mark.parametrize(
    ("blocks", "lost", "part"),
    [(PULSE, "friction_pulse", "amplitude"), (PID, "pid_feedforward_2", "feedforward 2"), (PID, "pid_integral", "integral")],
)
def test_a_part_of_the_output_that_is_not_there_is_said(mikron: Machine, blocks: dict[str, Any], lost: str, part: str) -> None:
    (said,), stated = said_of(mikron, blocks, {lost: 0.0})
    assert f"({part}); the recorded speed set point has none" in said
    assert stated


@pytest.mark.parametrize("blocks", [PULSE, PID, *({name: block} for name, block in SET_POINTS.items())])
def test_a_block_that_the_control_has_is_not_doubted(mikron: Machine, blocks: dict[str, Any]) -> None:
    said, stated = said_of(mikron, blocks, {})
    assert not said
    assert stated


def test_pulses_tables_and_two_lags_at_once_are_those_of_the_file(mikron: Machine) -> None:
    """The lag of the speed set point bends the pulses: fitted one without the other, it was 1.83 ms +- 0.01 ms, and the file was refused."""
    blocks = {**PULSE, **SET_POINTS, **LAGS}
    machine = mikron.with_axes(["X"]).with_values({"axis.X.block": blocks})
    result = identify(campaign(usual_runs(machine, short=True)), machine, refine=False, gaps=False)
    assert not result.refused
    assert not [f.text for f in result.findings if "the file lists" in f.text]
    found, loops = result.direct.position["X"], machine.axis("X").loops
    for key, half in found.half.items():
        assert abs(found.values[key] - getattr(loops, key)) <= half < 1e-3 * max(loops.position_gain_per_s, 1.0)
    stated = {f"{name}.{key}": number for name in (*PULSE, *LAGS) for key, number in blocks[name].items()}
    assert found.blocks.keys() == stated.keys()
    for key, (value, half) in found.blocks.items():
        assert abs(value - stated[key]) <= half < 1e-3 * stated[key], key
