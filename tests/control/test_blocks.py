"""Blocks that a machine file lists: read, checked, written and simulated; each law against its own statement."""

import ast
import dataclasses
import math
from pathlib import Path
import re

import numpy as np
import pytest

from examples.real.sinumerik.run import pulse_in
from tests.builders.one_axis import steady, swing
from twin.control.friction_pulse import FRICTION_PULSE, next_pulse
from twin.control.library import BLOCKS
from twin.control.structures import NUMBERS, Loops
from twin.errors import InputError
from twin.machine.loops import loops_of
from twin.machine.machine import Machine, load_machine, write_machine
from twin.machine.sheet import sheet
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

PULSE = {"amplitude_m_per_min": 0.12, "decay_time_s": 0.015}


@pytest.fixture(scope="module")
def machine(mikron: Machine) -> Machine:
    return mikron.with_axes(["X"])


def speed_set_point(machine: Machine, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speed set point and position of X at the position cycles."""
    trace = simulate(machine, Setpoints(position[:, None], 1e-3), sample_period=machine.position_cycle).trace
    return trace.get("X", "velocity_setpoint"), trace.get("X", "position")


def stated_pulses(
    setpoint: np.ndarray, output: np.ndarray, amplitude: float, decay: float, low: float = 0.0, knees: tuple[float, ...] = ()
) -> np.ndarray:
    """The law in plain words: a pulse whenever command and set point go one way that is not the last one; it decays by a factor a cycle.

    With knees a1, a2, a3 its amplitude rises up to a1 and falls to `low` between a2 and a3, by the change of the step of the set point."""
    out, direction, pulse = np.zeros(len(setpoint)), 0, 0.0
    change = np.abs(np.diff(setpoint, 2, prepend=[setpoint[0]] * 2))
    size = np.interp(change, [0.0, *knees], [0.0, amplitude, amplitude, low]) if knees else np.full(len(setpoint), amplitude)
    for k in range(1, len(setpoint)):
        pulse *= decay
        way = int(np.sign(round(setpoint[k] - setpoint[k - 1], 11)))
        if way and way == np.sign(output[k]) and way != direction:
            direction, pulse = way, size[k] * way
        out[k] = pulse
    return out


def pulses(machine: Machine, values: dict[str, float], setpoint: np.ndarray, output: np.ndarray) -> np.ndarray:
    """The pulses of the block from the set point and the speed set point without them, one sample a position cycle."""
    p, out, pulse, direction = np.array(FRICTION_PULSE.constants(values, machine, 1.0)), np.zeros(len(setpoint)), 0.0, 0.0
    steps = np.diff(setpoint, prepend=setpoint[0])
    for k in range(1, len(setpoint)):
        pulse, direction = next_pulse(p, pulse, direction, steps[k], steps[k - 1], output[k])
        out[k] = pulse
    return out


def test_a_pulse_follows_its_law_and_decays_with_its_time(machine: Machine) -> None:
    random = np.random.default_rng(4)
    setpoint = np.cumsum(np.round(1e-6 * random.standard_normal(400).cumsum(), 7))
    output = np.gradient(setpoint, 2e-3) + 1e-4 * random.standard_normal(400)
    found = pulses(machine, {"amplitude": 2e-3, "decay_time": 0.015}, setpoint, output)
    assert found == pytest.approx(stated_pulses(setpoint, output, 2e-3, math.exp(-2.0 / 15.0)), abs=1e-15)
    assert np.count_nonzero(np.abs(found) == 2e-3) > 3
    # the same numbers from the pulses alone, also with rounding
    read = pulse_in(np.round(found, 9), 2e-3)
    assert read == pytest.approx({"amplitude": 2e-3, "decay_time": 0.015}, rel=1e-3)
    assert pulse_in(np.zeros(10), 2e-3) is None
    assert pulse_in(random.standard_normal(400), 2e-3) is None
    knees = {f"acceleration_{i}": a for i, a in ((1, 0.1), (2, 0.3), (3, 0.9))}
    found = pulses(machine, {"amplitude": 2e-3, "decay_time": 0.015, "amplitude_low": 5e-4, **knees}, setpoint, output)
    stated = stated_pulses(setpoint, output, 2e-3, math.exp(-2.0 / 15.0), 5e-4, tuple(4e-6 * a for a in knees.values()))
    assert found == pytest.approx(stated, abs=1e-15)
    assert len(np.unique(np.round(np.abs(found), 9))) > 20


@pytest.mark.parametrize("closed_in_drive", [False, True])
def test_the_simulated_pulse_is_that_of_the_recorded_signals(machine: Machine, closed_in_drive: bool) -> None:
    """A pulse begins with the set point of the feedforward, not with the later one of the position controller."""
    base = machine.with_feedforward("velocity").with_values({"axis.X.loops.position_delay_s": 0.01})
    base = base.with_values({"axis.X.loops.dsc_delay_s": 0.004}) if closed_in_drive else base
    with_pulse = base.with_values({f"axis.X.block.friction_pulse.{key}": value for key, value in PULSE.items()})
    path = swing(0.02, 1.5, 1.6)
    command, position = speed_set_point(with_pulse, path)
    loops, tp = base.axis("X").loops, base.position_cycle
    at, cycles = Setpoints(path[:, None], 1e-3).at, np.arange(len(command)) * tp
    setpoint, fed = (at(cycles - late)[:, 0] for late in (loops.position_delay_s, loops.feedforward_delay_s))
    without = loops.position_gain_per_s * (setpoint - position) + np.diff(fed, prepend=fed[0]) / tp
    assert command - without == pytest.approx(stated_pulses(fed, without, 0.002, math.exp(-tp / 0.015)), abs=3e-6)
    # it does what it is for: less following error after a reversal
    plain, _ = speed_set_point(base, path)
    assert not np.allclose(command, plain, atol=1e-4)


@pytest.mark.parametrize(("name", "numbers", "late_s"), [
    ("set_point_lag", {"time_constant_s": 0.02}, 2e-3 / math.expm1(0.1)), ("set_point_average", {"length_s": 0.021}, 2e-3 * 50.0 / 10.5),
])  # fmt: skip
def test_a_set_point_filter_delays_position_and_feedforward_alike(
    machine: Machine, name: str, numbers: dict[str, float], late_s: float
) -> None:
    base = machine.with_feedforward("velocity")
    filtered = base.with_values({f"axis.X.block.{name}.{key}": value for key, value in numbers.items()})
    path = steady(0.05, 0.9)
    (_, x), (_, y) = speed_set_point(base, path), speed_set_point(filtered, path)
    # at steady speed a filter is a delay by the mean age of its weights; the following error itself does not grow
    assert (x - y)[-50:] == pytest.approx(0.05 * late_s, abs=2e-8)
    assert BLOCKS[name].kernel(dict(zip((n.name for n in BLOCKS[name].numbers), numbers.values())), machine).sum() == pytest.approx(1.0)  # type: ignore[misc]


@pytest.mark.parametrize("name", ["speed_set_point_lag", "speed_record_lag"])
def test_the_speed_set_point_is_recorded_behind_its_lag(machine: Machine, name: str) -> None:
    base = machine.with_feedforward("off").with_values({"axis.X.loops.position_delay_s": 0.0})
    lagging, time = base.with_values({f"axis.X.block.{name}.time_constant_s": 0.004}), 0.004
    path, gain = swing(0.02, 1.5, 1.6), base.axis("X").loops.position_gain_per_s
    (_, x), (seen, y) = speed_set_point(base, path), speed_set_point(lagging, path)
    stated, value = [], 0.0
    for given in gain * (path[:: round(base.position_cycle / 1e-3)][: len(y)] - y):
        cycle = []
        for _ in range(round(base.position_cycle / base.speed_cycle)):
            value += (1.0 - math.exp(-base.speed_cycle / time)) * (given - value)
            cycle.append(value)
        stated.append(cycle[0])
    assert seen == pytest.approx(np.array(stated), abs=1e-6)
    # in the loop it is a lag more; in the record alone it moves nothing
    frequency = np.array([3.0, 10.0])
    inside, plain = (loops_of(m, m.axis("X"))[-1].open_response(frequency) for m in (lagging, base))
    lag = 1.0 / (1.0 + 2j * np.pi * frequency * time)
    assert np.array_equal(x, y) == (name == "speed_record_lag")
    assert inside / plain == pytest.approx(lag if name == "speed_set_point_lag" else np.ones(2), abs=0.02)


def test_a_machine_file_keeps_its_blocks(machine: Machine, tmp_path: Path) -> None:
    changed = machine.with_values({"axis.X.block": {"friction_pulse": PULSE}}).with_values(
        {"axis.X.block.set_point_average.length_s": 0.004}
    )
    write_machine(changed, tmp_path / "m.toml")
    read = load_machine(tmp_path / "m.toml")
    assert [listed.block.name for listed in read.axis("X").blocks] == ["set_point_average", "friction_pulse"]
    assert read.axis("X").blocks[1].values == pytest.approx({"amplitude": 0.002, "decay_time": 0.015})
    assert "friction_pulse 0.12 m/min, 0.015 s" in sheet(read)


@pytest.mark.parametrize(("path", "value", "said"), [
    ("axis.X.block.friction_pulse.decay_time_s", 0.01, "'amplitude_m_per_min' is missing"),
    ("axis.X.block.friction_puls.decay_time_s", 0.01, "no block 'friction_puls'; did you mean"),
    ("axis.X.block", {"friction_puls": {}}, "no block 'friction_puls'; did you mean"),
    ("axis.X.block", {"friction_pulse": {**PULSE, "decay_s": 1.0}}, "unknown key 'decay_s'"),
    ("axis.X.block", {"friction_pulse": {**PULSE, "decay_time_s": -1.0}}, "impossible"),
    ("axis.X.block", {"friction_pulse": {**PULSE, "decay_time_s": "x"}}, "expected a number"),
    ("axis.X.block", [PULSE], "must hold one table for each block"),
])  # fmt: skip
def test_a_wrong_block_is_refused(machine: Machine, path: str, value: object, said: str) -> None:
    with pytest.raises(InputError, match=said.replace(".", r"\.")):
        machine.with_values({path: value})


PACKAGE = Path(__file__).resolve().parents[2] / "twin"
OUTSIDE = {f.relative_to(PACKAGE).as_posix(): f.read_text(encoding="utf-8") for f in PACKAGE.rglob("*.py")}
OUTSIDE = {name: text for name, text in OUTSIDE.items() if not name.startswith(("control/", "exam/"))}
"""The package without the blocks themselves, and without the judge, which has its own equations."""

ASKS = {
    r"has_current_loop|has_speed_integral|is(inf|finite)\([\w.]*integral_time|\bstructure\s*[!=]=|structure\s+(not\s+)?in\b|STRUCTURES\[(0|\")|\"P/P": {
        "machine/new.py",  # checks the name that a user gives
    },
    r"import .*\b(SERVO|IDEAL)\b|has\((INTEGRAL|\"speed_integral)": {"effects/effect.py", "remedy/tune_change.py", "remedy/tune_report.py"},  # a number that they change or show
    r"speed_mean_cycles": set(),
    r"\beffort\s*[!=]=": {"machine/lumped_file.py", "replay/curves.py", "simulation/effect_picture.py"},
}  # fmt: skip
"""What asks what the control of an axis consists of, and the files that do. A file that is no longer needed here must go."""

ANSWERS = {
    "winding", "cycle", "commands", "command_in",
    "has", "searched", "for_plant", "set_point_delay_s", "acceleration_weight", "one_law", "within_law", "beyond_start", "sag",
}  # fmt: skip
"""What other rooms ask an actuator or loops beside their numbers: each name says the question, none a kind of structure."""


def test_other_rooms_ask_for_answers_only() -> None:
    asked = {name for text in OUTSIDE.values() for name in re.findall(r"\.actuator\.(\w+)|\bloops\.(\w+)", text) for name in name if name}
    assert asked - set(NUMBERS) - {*dir(dict), *dir(list)} == ANSWERS


SIGNALS = {"velocity_feedforward", "torque_feedforward"}  # recorded under the name of their weight


@pytest.mark.parametrize("asks", ASKS)
def test_other_rooms_ask_the_blocks(asks: str) -> None:
    """Other rooms ask the blocks of an axis and know no structure by name; a new structure then touches one file."""
    assert {name for name, text in OUTSIDE.items() if re.search(asks, text)} == ASKS[asks]


def named_in(node: ast.AST) -> set[str]:
    """The numbers of blocks that a list, tuple, set or table names."""
    items = node.elts if isinstance(node, ast.Tuple | ast.List | ast.Set) else node.keys if isinstance(node, ast.Dict) else []
    return {item.value for item in items if isinstance(item, ast.Constant) and item.value in NUMBERS}


def test_the_numbers_of_a_block_are_listed_in_its_file_only() -> None:
    """What is free, how it is searched, named and held by controls: `control.number.Parameter` says it, so no other room keeps a table."""
    tables = {
        name for name, text in OUTSIDE.items() if any(len(named_in(n)) > 2 and named_in(n) - SIGNALS for n in ast.walk(ast.parse(text)))
    }
    assert tables == {
        "identify/first_values.py",  # which numbers of a position controller a delay of the recording leaves open
        "identify/recorded_command.py",  # the numbers of its law that a recorded command shows, too
        "machine/lumped_file.py",  # numbers from a recording
        "machine/new.py",  # numbers that it assumes
    }


def test_a_number_that_a_block_declares_is_all_that_other_rooms_need() -> None:
    """Each number of a block is typed, has a key and bounds; what a fit moves goes there and back, also at its bounds."""
    assert {f.name for f in dataclasses.fields(Loops)} == set(NUMBERS)
    for p in NUMBERS.values():
        for value in (0.3, p.bounds.high) if p.search and math.isfinite(p.bounds.high) else (0.3,):
            if p.search:
                assert p.search.decoded(p.search.coded(value)) == pytest.approx(value)
        assert p.shown is None or p.text(load_machine().axes[0].loops)
