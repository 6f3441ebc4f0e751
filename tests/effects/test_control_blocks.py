"""Effects of the blocks that a control lists: their strengths in simulation, machine file and remedy; blocks of a user's file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.builders.one_axis import there_and_back
from twin.control.library import BLOCKS
from twin.effects import EFFECTS, parse_setting, with_effects
from twin.effects.user_files import effects_of
from twin.machine.loops import loops_of, margins_of
from twin.machine.machine import Machine, load_machine, write_machine
from twin.remedy.advice import SET_BACK
from twin.remedy.change import Change
from twin.remedy.control_data import entries_of
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

PULSE = {"friction_pulse": {"amplitude_m_per_min": 0.015, "decay_time_s": 0.015}}
PID = {"pid": {"acceleration_feedforward_s": 1e-3, "integral_gain_per_s2": 20.0, "largest_output_m_per_s": 0.4}}
OWN = """
from twin.control.block import Block, listed_number, register
from twin.control.number import Key
from twin.simulation.loop_terms import SPEED, X_SPEED_SETPOINT, arrays, term

@term
def added(parameters, state, signals, axis):
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_SPEED_SETPOINT] += p[0]

register(Block("creep", (listed_number("speed", "speed_m_per_min", "speed_rev_per_min", Key(-1.0, 1.0)),), SPEED, added,
               lambda values, _cycles, _gain: [values["speed"]], strengths=(("speed",),)))
"""


def listing(machine: Machine, blocks: dict[str, dict[str, float]]) -> Machine:
    return machine.with_axes(["X"]).with_values({"axis.X.block": blocks})


def moved(machine: Machine) -> np.ndarray:
    """Position of X on a way there and back."""
    return simulate(machine, Setpoints(there_and_back(0.01, 0.05)[:, None], 1e-3)).trace.get("X", "position")


@pytest.mark.parametrize(
    ("blocks", "effect", "without"),
    [
        (PULSE, "friction_pulse", {}),
        (PID, "pid_integral", {"pid": {k: v for k, v in PID["pid"].items() if k != "integral_gain_per_s2"}}),
        ({"set_point_lag": {"time_constant_s": 0.004}}, "set_point_lag", {}),
        ({"speed_set_point_lag": {"time_constant_s": 0.002}}, "speed_set_point_lag", {}),
    ],
)
def test_a_strength_of_0_is_a_control_without_the_block(mikron: Machine, blocks, effect: str, without) -> None:
    machine = listing(mikron, blocks)
    lost = with_effects(machine, [{"name": effect, "axis": "X", "factor": 0.0}])
    assert np.abs(moved(lost) - moved(listing(mikron, without))).max() < 1e-12
    assert np.abs(moved(lost) - moved(machine)).max() > 1e-8


def test_the_margins_of_a_control_without_its_lag(mikron: Machine) -> None:
    plain, lagged = mikron.with_axes(["X"]), listing(mikron, {"speed_set_point_lag": {"time_constant_s": 0.002}})
    lost = lagged.with_axis("X", **{"block.speed_set_point_lag.time_constant": 0.0})
    margins = [[margins_of(loop).phase for loop in loops_of(m, m.axis("X"))] for m in (plain, lost, lagged)]
    assert margins[1] == pytest.approx(margins[0], abs=1e-6)
    assert margins[2] != pytest.approx(margins[0], abs=1.0)


def test_an_axis_has_the_effects_of_the_numbers_that_its_file_gives(mikron: Machine, tmp_path: Path) -> None:
    machine = listing(mikron, PID)
    able = {name for name, effect in EFFECTS.items() if effect.block_of_control and effect.axes(machine)}
    assert able == {"pid_integral", "pid_feedforward_2"}
    setting = parse_setting("pid_integral:X:factor=0.5", machine)
    assert setting.paths(machine) == ["axis.X.block.pid.integral_gain_per_s2"]
    write_machine(with_effects(machine, [setting]), tmp_path / "machine.toml")
    assert [dict(e) for e in load_machine(tmp_path / "machine.toml").effects] == [setting.table()]
    assert not any(effect.axes(mikron) for effect in EFFECTS.values() if effect.block_of_control)


def test_the_remedy_enters_what_the_file_lists_and_says_what_the_control_holds(mikron: Machine) -> None:
    machine = listing(mikron, PULSE)
    change = Change("X", SET_BACK, parse_setting("friction_pulse:X:factor=0.5", machine))
    entered = {entry.name.split()[0]: entry for entry in entries_of(change, machine, "sinumerik").entries}
    assert (entered["MD32520"].value, entered["MD32520"].old) == (pytest.approx(15.0), pytest.approx(7.5))
    assert "MD32540" not in entered  # the decay is right
    area = entries_of(change, machine, "heidenhain").entries[0]
    assert area.old is not None
    assert math.isclose(area.value, 2.0 * area.old)


def test_a_block_of_a_users_file_is_an_effect_too(mikron: Machine, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    with effects_of([tmp_path / "own.py"]):
        machine = listing(mikron, {"creep": {"speed_m_per_min": 0.06}})
        ahead = moved(machine) - moved(mikron.with_axes(["X"]))
        assert ahead[-1] == pytest.approx(1e-3 / machine.axis("X").loops.position_gain_per_s, rel=0.01)
        lost = with_effects(machine, [{"name": "creep", "axis": "X", "factor": 0.0}])
        assert np.abs(moved(lost) - moved(mikron.with_axes(["X"]))).max() < 1e-12
    assert "creep" not in BLOCKS
    assert "creep" not in EFFECTS
