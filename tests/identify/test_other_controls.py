"""What is stated about controls that are not a cascade with a recorded controller is true: intervals hold the truth, and nothing else is stated.

The recordings come from a plant of a few lines: a mass with exact Coulomb and viscous friction behind a drive with a lag, at 8 steps a cycle.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
import math
from pathlib import Path
import re
from typing import Any

import numpy as np
import pytest

from tests.builders.identify_campaigns import campaign, path
from twin.cli.parser import main
from twin.control.command_law import CommandLaw
from twin.control.friction_pulse import next_pulse
from twin.diagnose.check_campaign import notes_of
from twin.effects import settings_of
from twin.effects.change import with_effects
from twin.effects.effect import find_effect
from twin.effects.readable import setting_text
from twin.errors import InputError
from twin.estimate.regression import Range
from twin.identify import first_values as first_values_of
from twin.identify import position_control, recorded_command
from twin.identify.drive_residuals import search_of
from twin.identify.first_values import first_values
from twin.identify.identify import identify
from twin.identify.parameters import reconciled
from twin.identify.position_control import NAMES, PositionControl
from twin.identify.position_law_search import Found
from twin.identify.recorded_axis import effort_balance, lags_of, strokes_of
from twin.identify.recorded_command import agree
from twin.identify.result import Parameter
from twin.machine.axis_lumps import SPEED_GAIN, AxisControl, AxisLumps
from twin.machine.lumped_file import write_lumped_machine
from twin.machine.machine import load_machine
from twin.machine.sheet import sheet
from twin.recordings.campaign import ChannelFact, MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.gap import gap_unit

CYCLE, STEPS = 1e-3, 8
MASS, COULOMB, VISCOUS = 0.8, 0.5, 1.2
KP, KD = 2200.0, 40.0
"""Gains of a PD controller [A per m, A per m/s]."""

Control = Callable[[np.ndarray, int, float, float], float]
"""Command of a cycle from the set points, its number, position and speed by differences."""


SHORT, LONG = ([0.04, -0.03, 0.06, 0.0, 0.04, 0.01], [0.1, -0.05, 0.15, 0.0, 0.12, 0.02])
"""Ends of the strokes [m]: enough for the law of a command, which each sample shows; for lags and friction, which only steady speeds show."""


def recorded(
    control: Control,
    speed_command: bool = False,
    lag: float = 3e-4,
    plant: tuple[float, float, float] = (MASS, COULOMB, VISCOUS),
    ends: Sequence[float] = SHORT,
) -> MeasuredRun:
    """Strokes at several speeds. The command is a current, or a speed that a PI drive of 2.5 ms follows. `plant`: mass, Coulomb and viscous friction."""
    mass, coulomb, viscous = plant
    s = path(ends, [0.05, 0.2, 0.3, 0.15, 0.1, 0.25], acceleration=3.0, jerk=150.0)
    x = v = current = integral = before = 0.0
    rows, dt = [], CYCLE / STEPS
    random = np.random.default_rng(3)
    for k in range(len(s)):
        at = round(x, 7)
        command = control(s, k, at, (at - before) / CYCLE)
        before = at
        rows.append((at, command, current if speed_command else command))
        for _ in range(STEPS):
            wanted = command
            if speed_command:
                integral += dt / 0.02 * (command - v)
                wanted = mass / 2.5e-3 * (command - v + integral)
            current += (1.0 - math.exp(-dt / lag)) * (wanted - current)
            free = (v + dt * current / mass) / (1.0 + dt * viscous / mass)
            v = math.copysign(max(abs(free) - dt * coulomb / mass, 0.0), free)
            x += dt * v
    t, (position, asked, effort) = np.arange(len(s)) * CYCLE, np.array(rows).T
    signals = {("X", "setpoint"): s, ("X", "position"): position, ("X", "current"): effort + 0.01 * random.standard_normal(len(s))}
    if speed_command:
        signals["X", "velocity_setpoint"] = asked
    return MeasuredRun("strokes", Trace(t, signals, {"X": "linear"}), None, 0.0)


def pd(s: np.ndarray, k: int, x: float, v: float) -> float:
    return KP * (s[k] - x) - KD * v


def proportional(s: np.ndarray, k: int, x: float, _v: float) -> float:
    return 30.0 * (s[k] - x)


def late_feedforward(s: np.ndarray, k: int, x: float, _v: float) -> float:
    return 30.0 * (s[max(k - 2, 0)] - x) + (s[max(k - 1, 0)] - s[max(k - 2, 0)]) / CYCLE


def with_pulse(s: np.ndarray, k: int, x: float, _v: float) -> float:
    """Full feedforward, and a compensation of friction of 10 ms when a motion begins."""
    slope, before = ((s[max(j, 0)] - s[max(j - 1, 0)]) / CYCLE for j in (k, k - 10))
    return 30.0 * (s[k] - x) + slope + 0.01 * (before == 0.0) * np.sign(slope)


def with_sinumerik_pulse(amplitude: float, decay: float, back: float) -> Control:
    """Full feedforward, and the block's own pulse where set point and speed set point reverse, of amplitude `back` towards lower positions."""
    state = np.zeros(3)  # pulse, direction, last step

    def control(s: np.ndarray, k: int, x: float, _v: float) -> float:
        step = s[k] - s[max(k - 1, 0)]
        output = 30.0 * (s[k] - x) + step / CYCLE
        constants = np.array([amplitude if step > 0.0 else back, math.exp(-CYCLE / decay), 0.0, 0.0, 0.0, 0.0])
        state[:] = *next_pulse(constants, state[0], state[1], step, state[2], output), step
        return float(output + state[0])

    return control


OF_PID = {"integral_gain_per_s2": 120.0, "acceleration_feedforward_s": 8e-4, "dead_band_m": 5e-6}
LATE = ("position_delay_s", "feedforward_delay_s")


def linuxcnc(
    dead_band: float = 5e-6,
    acceleration: float = 8e-4,
    speed: float = 1.0,
    derivative: float = 0.0,
    jerk: float = 0.0,
    position: float = 0.0,
) -> Control:
    total, before = [0.0], [0.0]

    def pid(s: np.ndarray, k: int, x: float, _v: float) -> float:
        error = np.sign(s[k] - x) * max(abs(s[k] - x) - dead_band, 0.0)
        total[0] += CYCLE * error
        slopes = [(s[max(j, 0)] - s[max(j - 1, 0)]) / CYCLE for j in (k - 2, k - 1, k)]
        last, curvature = np.diff(slopes) / CYCLE
        change, before[0] = (error - before[0]) / CYCLE, error
        further = derivative * change + jerk * (curvature - last) / CYCLE + position * s[k]
        return 60.0 * error + 120.0 * total[0] + speed * slopes[2] + acceleration * curvature + further

    return pid


def test_a_lag_is_neither_friction_nor_the_first_terms_of_a_series() -> None:
    """PD: the error is (Kd + Fv) / Kp times the speed, and Coulomb friction over Kp. P with a fast drive: 1/Kv, though the moves are as short as it."""
    for control, speed_command, lag in ((pd, False, (KD + VISCOUS) / KP), (proportional, True, 1.0 / 30.0)):
        run = recorded(control, speed_command, ends=LONG)
        rows = strokes_of([run], "X")
        assert rows is not None
        found = lags_of([run], "X", rows)[0][""]
        assert found.value == pytest.approx(lag, rel=2e-3)
        assert abs(found.value - lag) < found.half < 0.02 * lag


def test_intervals_cover_the_laws_that_a_recording_does_not_tell_apart() -> None:
    """The current acts on within a sample and the filter mixes motion with reversal: neither is in the law, and the intervals still hold the truth."""
    for control, speed_command, lag in ((proportional, True, 3e-4), (proportional, True, 8e-4), (pd, False, 3e-4), (pd, False, 8e-4)):
        run = recorded(control, speed_command, lag, ends=LONG)
        rows = strokes_of([run], "X")
        assert rows is not None
        found = effort_balance([run], "X", "current", rows, "linear")
        assert found is not None
        for value, true in ((found[0].coulomb, COULOMB), (found[0].viscous, VISCOUS)):
            assert value is not None
            assert abs(value.value - true) < value.half < 0.05 * true


def test_the_pulse_of_a_friction_compensation_is_measured() -> None:
    """Without the pulses the law has a delay of 4 ms and a feedforward of 1.12. A record does not show the direction before its first motion."""
    law = first_values([recorded(with_sinumerik_pulse(2e-3, 0.018, 2e-3), speed_command=True, ends=LONG)], ["X"])[0].law
    for key, true in (("amplitude_m_per_min", 0.12), ("decay_time_s", 0.018)):
        value, half = law.blocks[f"friction_pulse.{key}"]
        assert abs(value - true) < half < 0.02 * true, key
    assert abs(law["position_gain_per_s"] - 30.0) <= law.half["position_gain_per_s"]
    uneven = first_values([recorded(with_sinumerik_pulse(2e-3, 0.018, 1.5e-3), speed_command=True, ends=LONG)], ["X"])[0].law
    assert len(uneven.blocks) == 2
    assert all(math.isinf(half) for _, half in uneven.blocks.values())  # near the block, but of two sizes: no number of it is measured
    assert first_values([recorded(with_pulse, speed_command=True, ends=LONG)], ["X"])[0].law.blocks == {}  # a rectangle


def test_a_current_behind_an_inner_loop_shows_no_law_of_the_command() -> None:
    """It nearly follows a PI law of the position, with another gain and delay. What such a law leaves lasts longer than a cycle."""
    for lag in (3e-4, 1e-3):
        run = recorded(proportional, True, lag)
        law = first_values([run], ["X"])[0].law
        assert (law.measured, law.direct) == (True, False)
        assert abs(law["position_gain_per_s"] - 30.0) <= law.half["position_gain_per_s"] < 0.01
        signals = {key: values for key, values in run.trace.signals.items() if key[1] != "velocity_setpoint"}
        hidden = replace(run, trace=Trace(run.trace.time, signals, {"X": "linear"}))
        assert not first_values([hidden], ["X"])[0].law.measured


def test_a_control_that_computes_between_the_samples_has_its_own_cycle_and_no_delays() -> None:
    """At the recorded cycle a delay of milliseconds and a larger feedforward would stand for the slope of its own cycle."""

    def feedforward(s: np.ndarray, k: int, x: float, _v: float) -> float:
        return 40.0 * (s[k] - x) + (s[k] - s[max(k - 1, 0)]) / CYCLE

    run = recorded(feedforward, speed_command=True)
    one = first_values([replace(run, trace=run.trace.decimated(2))], ["X"])[0]
    law = one.law
    assert one.held == 0.5
    assert law["position_gain_per_s"] == pytest.approx(40.0, rel=1e-3)
    assert law["velocity_feedforward"] - law["position_gain_per_s"] * law["position_delay_s"] == pytest.approx(1.0, abs=1e-3)
    assert law["feedforward_delay_s"] <= law.half["feedforward_delay_s"] < 0.2 * CYCLE


def holds_what_it_states(file: Path, lumps: list[AxisLumps], true: dict[str, float]) -> None:
    """Each number that the machine file calls measured is a true one, within its interval; the gain is among them."""
    write_lumped_machine(file, lumps, "strokes")
    stated = re.findall(r"^(\w+) = (\S+) +# measured, 95 % \+- (\S+)$", file.read_text(encoding="utf-8"), re.MULTILINE)
    assert {"position_gain_per_s"} <= {key for key, _, _ in stated} <= true.keys()
    for key, value, half in stated:
        assert abs(float(value) - true[key]) <= 1.05 * float(half), key  # the half interval has two digits


@pytest.mark.parametrize("seed", range(8))
def test_what_a_machine_file_calls_measured_is_true(seed: int, tmp_path: Path) -> None:
    """Drawn axes: P and P with feedforward with a speed command, PD with and without feedforward with a current."""
    random = np.random.default_rng(seed)
    plant = (random.uniform(0.4, 1.6), random.uniform(0.1, 1.0), random.uniform(0.3, 4.0))
    kv, weight, bandwidth = random.uniform(15.0, 60.0), random.uniform(0.6, 1.0), random.uniform(30.0, 70.0)
    late, fed = int(random.integers(0, 4)), int(random.integers(0, 3))
    kp, kd = bandwidth**2 * plant[0], 2.0 * bandwidth * plant[0]

    def ahead(s: np.ndarray, k: int) -> float:
        return float(s[max(k, 0)] - s[max(k - 1, 0)]) / CYCLE

    def with_pd(feedforward: float) -> Control:
        return lambda s, k, x, v: kp * (s[k] - x) + kd * (feedforward * ahead(s, k) - v)

    def with_p(feedforward: float) -> Control:
        return lambda s, k, x, _v: kv * (s[max(k - late, 0)] - x) + feedforward * ahead(s, k - fed)

    of_p = {"position_gain_per_s": kv, "position_delay_s": late * CYCLE}
    of_pd = {"position_gain_per_s": kp / kd, "speed_gain_a_s_per_m": kd}
    control, speed_command, true = [
        (with_p(0.0), True, {**of_p, "velocity_feedforward": 0.0}),
        (with_p(weight), True, {**of_p, "velocity_feedforward": weight, "feedforward_delay_s": fed * CYCLE}),
        (with_pd(0.0), False, {**of_pd, "velocity_feedforward": 0.0}),
        (with_pd(weight), False, {**of_pd, "velocity_feedforward": weight}),
    ][seed % 4]
    run = recorded(control, speed_command, float(random.choice([1e-4, 3e-4, 1e-3])), plant)
    holds_what_it_states(tmp_path / "m.toml", first_values([run], ["X"]), true)


def with_signals(run: MeasuredRun, **changed: np.ndarray) -> MeasuredRun:
    """The run with other values of some signals."""
    signals = {**run.trace.signals, **{("X", name): values for name, values in changed.items()}}
    return replace(run, trace=Trace(run.trace.time, signals, run.trace.kinds))


def a_sample_later(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values[:1], values[:-1]])


def comments(lumps: list[AxisLumps], path: Path) -> dict[str, str]:
    """Key of a machine file -> the comment after its number."""
    write_lumped_machine(path, lumps, "strokes")
    lines = [line.partition(" = ") for line in path.read_text(encoding="utf-8").splitlines()]
    return {key: value.partition("# ")[2] for key, _, value in lines}


@pytest.mark.parametrize("plant", [(0.4, 0.3, 3.0), (0.6, 0.2, 4.0)])
def test_an_effort_that_acts_later_than_its_sample_gives_the_mass(plant: tuple[float, float, float]) -> None:
    """Held over a cycle and behind the lag of the drive it is late by T: unaligned, the samples give m + b T."""
    mechanics = first_values([recorded(pd, lag=1e-3, plant=plant)], ["X"])[0].mechanics
    assert mechanics is not None
    assert mechanics.between is None
    assert abs(mechanics.inertia / plant[0] - 1.0) < mechanics.half["inertia"] < 0.01


def test_bounds_hold_a_mass_behind_a_speed_controller(tmp_path: Path) -> None:
    """The drive of 2.5 ms moves the current between its samples: they are the mean of no cycle."""
    for cycles in (1, 2, 4):
        run = recorded(proportional, speed_command=True)
        said = comments(first_values([replace(run, trace=run.trace.decimated(cycles))], ["X"]), tmp_path / "m.toml")["moving_mass_kg"]
        low, high = map(float, re.search(r"^bounded: .* between (\S+) and (\S+) by", said).groups())  # type: ignore[union-attr]
        assert low < MASS < high


def test_a_bound_of_a_mass_holds_between_the_samples_too(tmp_path: Path) -> None:
    """Accelerations within the scatter give a bound only; that of samples is no bound of the mass."""
    (one,) = first_values([recorded(proportional, speed_command=True)], ["X"])
    assert one.mechanics is not None
    assert one.mechanics.between is not None
    bounded = replace(one, mechanics=replace(one.mechanics, inertia=0.25 * MASS, largest_inertia=0.7 * MASS))
    said = comments([bounded], tmp_path / "m.toml")["moving_mass_kg"]
    assert float(re.search(r"^bounded: below (\S+) ", said)[1]) == pytest.approx(0.7 * MASS * one.mechanics.between[1], rel=0.01)  # type: ignore[index]
    for_ten_a_second = replace(bounded.mechanics, between=(0.01, 1e40))  # type: ignore[type-var]
    assert "below" not in comments([replace(bounded, mechanics=for_ten_a_second)], tmp_path / "slow.toml")["moving_mass_kg"]


def test_a_position_that_is_recorded_late_or_early_gives_the_gain_of_the_control() -> None:
    """Late, it would pass for a lower gain and another delay, each with an interval of a millionth."""
    run = recorded(proportional, speed_command=True)
    x = run.trace.get("X", "position")
    for position, said in ((a_sample_later(x), "1 ms late"), (np.append(x[1:], x[-1]), "1 ms early")):
        law = first_values([with_signals(run, position=position)], ["X"])[0].law
        assert abs(law["position_gain_per_s"] - 30.0) <= law.half["position_gain_per_s"] < 0.1
        assert said in law.more


def test_a_time_that_may_be_zero_is_not_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    """A position was called 0.00002 ms early."""
    fitted = position_control.at_another_time

    def shorter(*of: Any) -> Found | None:
        found = fitted(*of)
        return found and replace(found, x=found.x * [1.0, 1.0, 1.0, 1.0, 1e-5])

    run = recorded(proportional, speed_command=True, ends=LONG)
    run = with_signals(run, position=a_sample_later(run.trace.get("X", "position")))
    monkeypatch.setattr(position_control, "at_another_time", shorter)
    assert first_values([run], ["X"])[0].law.more == ""


def test_a_command_that_is_recorded_a_cycle_late_gives_its_own_gains() -> None:
    """As the actual current, which is that of the last cycle. Read as a law of the present position, its gains would be false by Kv Ts."""
    for shifted in ("current", "position"):
        run = recorded(pd)
        law = first_values([with_signals(run, **{shifted: a_sample_later(run.trace.get("X", shifted))})], ["X"])[0].law
        assert abs(law["position_gain_per_s"] - KP / KD) <= law.half["position_gain_per_s"] < 0.01 * law["position_gain_per_s"]
        assert abs(law.speed_gain - KD) <= law.half[SPEED_GAIN] < 0.01 * law.speed_gain


def test_with_full_feedforward_gain_and_integral_time_can_be_exchanged(tmp_path: Path) -> None:
    total = [0.0]

    def pi(s: np.ndarray, k: int, x: float, v: float) -> float:
        left = 40.0 * (s[k] - x) + (s[k] - s[max(k - 1, 0)]) / CYCLE - v
        total[0] += CYCLE * left
        return KD * (left + 12.0 * (total[0] - CYCLE * left))

    run = recorded(pi)
    run = with_signals(run, current=np.round(run.trace.get("X", "current"), 3))
    said = comments(first_values([run], ["X"]), tmp_path / "m.toml")
    assert said["position_gain_per_s"].startswith("bounded")
    assert said["speed_integral_time_s"].startswith("bounded")


def test_both_laws_agree_only_in_each_number() -> None:
    numbers = {"position_gain_per_s": 40.0, "velocity_feedforward": 0.9}
    one = AxisControl(numbers, half={"position_gain_per_s": 0.1, "velocity_feedforward": 1e-3, "position_delay_s": 1e-6})
    assert agree(one, replace(one, loops={**numbers, "position_gain_per_s": 40.1}))
    assert not agree(one, replace(one, loops={**numbers, "position_delay_s": 2.5e-3, "velocity_feedforward": 1.0}))  # of the same sum
    assert not agree(one, replace(one, loops={**numbers, "position_gain_per_s": 40.3}))


def test_a_number_of_a_channel_without_a_scale_is_not_called_measured(tmp_path: Path) -> None:
    """A current in percent of the rated one, positions in increments: what needs no unit is measured, the rest is unscaled."""
    run = recorded(pd)
    of_current = ("moving_mass_kg", "coulomb_friction_n", "viscous_friction_n_s_per_m", "speed_gain_a_s_per_m")
    for signal, unit, of_unit in (("current", "%", of_current), ("position", "inc", (*of_current, "linear_scale_noise_m"))):
        fact = {("X", signal): ChannelFact(axis="X", signal=signal, stated_unit=unit)}
        said = comments(first_values([replace(run, facts=fact)], ["X"]), tmp_path / "m.toml")
        assert {key for key, text in said.items() if text.startswith(f"unscaled: no scale of {signal} in [{unit}]")} == set(of_unit)
        assert said["position_gain_per_s"].startswith("measured")


def test_the_forces_of_a_lumped_axis_have_the_unit_of_its_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Printed in N and kg, friction in percent of a rated current would be a number of another machine."""
    run, file = recorded(pd), tmp_path / "m.toml"
    fact = {("X", "current"): ChannelFact(axis="X", signal="current", stated_unit="%")}
    for facts, unit in (({}, "A"), (fact, "% current")):
        write_lumped_machine(file, first_values([replace(run, facts=facts)], ["X"]), "strokes")
        machine = load_machine(file)
        axis = machine.axis("X")
        assert axis.force_unit == axis.effort_unit == gap_unit(axis, "current")[0] == unit
        units = [find_effect(name, "a test").size.unit(axis) for name in ("constant_force", "inertia", "transmission_compliance")]
        assert units == [unit, f"{unit} s2/m", f"{unit}/m"]
        pushed = with_effects(machine, [{"name": "constant_force", "axis": "X", "force": 2.0}])
        setting = setting_text(settings_of(pushed)[0], machine)
        assert setting == f"constant force X (force 2.00 {unit})"
        assert main(["machine", "show", str(file)]) == 0
        assert f" {unit}" in capsys.readouterr().out
    file.write_text(file.read_text(encoding="utf-8").replace('force_unit = "% current"', "force_unit = 5"), encoding="utf-8")
    with pytest.raises(InputError, match="force_unit = 5; give the unit"):
        load_machine(file)


def test_no_delay_smooths_the_rounding_of_the_set_points() -> None:
    """The mean of two set points halves the noise of a feedforward, and a delay of the position takes that up: 0.71 ms and a weight of 0.72."""
    run = recorded(lambda s, k, x, _v: 30.0 * (s[k] - x) + 0.7 * (s[k] - s[max(k - 1, 0)]) / CYCLE, speed_command=True)
    law = first_values([with_signals(run, setpoint=np.round(run.trace.get("X", "setpoint"), 6))], ["X"])[0].law
    assert (law["position_gain_per_s"], law["velocity_feedforward"]) == (pytest.approx(30.0, rel=2e-3), pytest.approx(0.7, rel=2e-3))
    assert law["position_delay_s"] == law["feedforward_delay_s"] == 0.0
    pulses = recorded(with_pulse, speed_command=True)  # cycles that follow no law
    law = first_values([with_signals(pulses, setpoint=np.round(pulses.trace.get("X", "setpoint"), 6))], ["X"])[0].law
    assert (law["position_gain_per_s"], law["velocity_feedforward"], law["position_delay_s"]) == (
        pytest.approx(30.0, rel=3e-3),
        pytest.approx(1.0, rel=1e-3),
        0.0,
    )
    late = recorded(late_feedforward, speed_command=True)
    law = first_values([with_signals(late, setpoint=np.round(late.trace.get("X", "setpoint"), 6))], ["X"])[0].law
    for key, value, true in (
        ("position_gain_per_s", law["position_gain_per_s"], 30.0),
        ("velocity_feedforward", law["velocity_feedforward"], 1.0),
        ("position_delay_s", law["position_delay_s"], 2e-3),
    ):
        assert abs(value - true) < law.half[key], f"{key}: {value:.4g}, as if measured to {law.half[key]:.2g}"


def test_numbers_that_no_machine_file_holds_are_not_tried() -> None:
    """The nearest law of a command that follows none may be any: one with a feedforward of 5.7 ended `machine new`."""
    assert search_of("velocity_feedforward").bounds[1] == pytest.approx(math.log(2.0))
    assert search_of("position_delay_s").decoded(search_of("position_delay_s").bounds[1]) == pytest.approx(1.0)
    law = CommandLaw(30.0, 2.0, math.inf, 1.0, 0.0, 1, 0.01)
    assert recorded_command._possible(law) is law
    assert recorded_command._possible(replace(law, velocity_feedforward=5.7)) is None
    assert recorded_command._possible(None) is None


def test_numbers_that_fit_only_together_stay_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """A delay of 3 ms of the set point, 0 of the feedforward: the delay of the one was given to the other, too, and the axis was 36 um from its recording."""
    values = dict(zip(NAMES, (60.0, 1.18, 3e-3, 1e-5)))
    found = PositionControl(values, {**dict.fromkeys(NAMES[1:], math.inf), NAMES[0]: 0.2}, 1.0, 1e-6)
    monkeypatch.setattr(first_values_of, "fit_position_control", lambda *_, **__: found)
    law = first_values([recorded(proportional, speed_command=True)], ["X"])[0].law
    assert (law["velocity_feedforward"], law["position_delay_s"], law["feedforward_delay_s"]) == (1.18, 3e-3, 1e-5)


def test_a_law_of_the_command_has_intervals() -> None:
    law = first_values([recorded(pd)], ["X"])[0].law
    assert law.direct
    assert abs(law["position_gain_per_s"] - KP / KD) < law.half["position_gain_per_s"] < 0.01 * law["position_gain_per_s"]
    assert abs(law.speed_gain - KD) < law.half[SPEED_GAIN] < 0.01 * law.speed_gain
    assert "position_delay_s" not in law.half  # it has none


def lagging_control(weight: float) -> Control:
    """A lag of the set points of 5 ms before the position controller and its feedforward."""
    behind = [0.0, 0.0]

    def lagging(s: np.ndarray, k: int, x: float, _v: float) -> float:
        behind[:] = [behind[0] + (1.0 - math.exp(-CYCLE / 5e-3)) * (s[k] - behind[0]), behind[0]]
        return 30.0 * (behind[0] - x) + weight * (behind[0] - behind[1]) / CYCLE

    return lagging


@pytest.mark.parametrize("weight", [0.0, 0.9])
def test_a_lag_of_the_set_points_is_no_delay(tmp_path: Path, weight: float) -> None:
    """Without it the delay takes most of it, and gain and feedforward what the delay leaves: each false, with an interval of a thousandth."""
    lumps = first_values([recorded(lagging_control(weight), speed_command=True)], ["X"])
    law = lumps[0].law
    time, half = law.blocks["set_point_lag.time_constant_s"]
    assert abs(law["position_gain_per_s"] - 30.0) <= law.half["position_gain_per_s"] < 0.3
    assert abs(time - 5e-3) <= half < 5e-4
    said = comments(lumps, tmp_path / "m.toml")
    assert said["time_constant_s"].startswith("measured, 95 % +- ")
    assert load_machine(tmp_path / "m.toml").axis("X").name == "X"


def test_a_lag_that_no_recording_determines_is_not_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a law with another lag fits as well, a control without any may have made the recording."""
    fitted = position_control.behind_set_point_lag

    def undetermined(*of: Any) -> Found:
        found = fitted(*of)
        assert found is not None
        assert found.x[4] == pytest.approx(5e-3, rel=0.1)
        return replace(found, others=[*found.others, found.x * [1.0, 1.0, 1.0, 1.0, 0.0]])

    monkeypatch.setattr(position_control, "behind_set_point_lag", undetermined)
    law = first_values([recorded(lagging_control(0.9), speed_command=True, ends=LONG)], ["X"])[0].law
    assert law.blocks == {}
    assert "lag of its set points" not in law.more


def test_a_pid_gives_its_own_numbers(tmp_path: Path) -> None:
    """An integral part, a dead band and a feedforward of the acceleration are no delay and no larger feedforward of the speed, on another plant too."""
    lumps = first_values([recorded(linuxcnc(), speed_command=True, lag=1e-3, plant=(1.4, 0.8, 3.5))], ["X"])
    law = lumps[0].law
    assert law["position_gain_per_s"] == pytest.approx(60.0, abs=law.half["position_gain_per_s"] + 0.01)
    assert law["velocity_feedforward"] == pytest.approx(1.0, abs=1e-4)
    assert (law["position_delay_s"], law["feedforward_delay_s"]) == (0.0, 0.0)
    for key, true in OF_PID.items():
        assert abs(law.blocks[f"pid.{key}"][0] - true) < law.blocks[f"pid.{key}"][1] < 0.01 * true
    numbers = {"position_gain_per_s": 60.0, "velocity_feedforward": 1.0, **dict.fromkeys(LATE, 0.0), **OF_PID}
    holds_what_it_states(tmp_path / "m.toml", lumps, numbers)
    values = load_machine(tmp_path / "m.toml").axis("X").blocks[0].values
    assert values["integral"] == pytest.approx(law.blocks["pid.integral_gain_per_s2"][0], rel=1e-6)


def test_a_pid_far_from_every_other_law_is_one(tmp_path: Path) -> None:
    """A large feedforward of the acceleration, which acts on in a run whose feedforward of the speed is off. The nearest law without it leaves too much."""
    runs = [
        replace(recorded(linuxcnc(acceleration=6e-3, speed=on), speed_command=True), name=name, feedforward=word)
        for name, word, on in (("on", "velocity", 1.0), ("off", "off", 0.0))
    ]
    law = first_values(runs, ["X"])[0].law
    assert law["position_gain_per_s"] == pytest.approx(60.0, abs=law.half["position_gain_per_s"] + 0.01)
    for key, true in {**OF_PID, "acceleration_feedforward_s": 6e-3}.items():
        assert abs(law.blocks[f"pid.{key}"][0] - true) < law.blocks[f"pid.{key}"][1] < 0.01 * true


@pytest.mark.parametrize(
    ("key", "part", "true"),
    [
        ("derivative_gain", {"derivative": 0.02}, 0.02),
        ("jerk_feedforward_s2", {"jerk": 5e-6}, 5e-6),
        ("position_feedforward_per_s", {"position": 0.2}, 0.2),
    ],
)
def test_every_part_of_a_pid_is_found(key: str, part: dict[str, float], true: float) -> None:
    """A derivative was less gain and a negative delay, with narrow intervals; a feedforward of the jerk a lag of the set points."""
    law = first_values([recorded(linuxcnc(**part), speed_command=True)], ["X"])[0].law
    assert law["position_gain_per_s"] == pytest.approx(60.0, abs=law.half["position_gain_per_s"] + 0.01)
    assert (law["position_delay_s"], law["feedforward_delay_s"]) == (0.0, 0.0)
    for name, value in {**OF_PID, key: true}.items():
        assert abs(law.blocks[f"pid.{name}"][0] - value) < law.blocks[f"pid.{name}"][1] < 0.02 * value


def test_a_rounded_record_of_a_pid_gives_its_own_numbers() -> None:
    """To 1e-6 mm, as LinuxCNC prints it. The curvature of rounded set points is noise: without its covariance it leaves more than rounding seems to make."""

    def rounded(run: MeasuredRun, name: str, feedforward: str) -> MeasuredRun:
        signals = {key: values if key[1] == "current" else np.round(values, 9) for key, values in run.trace.signals.items()}
        return replace(run, name=name, feedforward=feedforward, trace=Trace(run.trace.time, signals, run.trace.kinds))

    runs = [
        rounded(recorded(linuxcnc(derivative=0.02, acceleration=6e-3, speed=on), speed_command=True), name, word)
        for name, word, on in (("on", "velocity", 1.0), ("off", "off", 0.0))
    ]
    law = first_values(runs, ["X"])[0].law
    assert law["position_gain_per_s"] == pytest.approx(60.0, abs=law.half["position_gain_per_s"] + 0.01)
    assert set(law.blocks) == {f"pid.{name}" for name in (*OF_PID, "derivative_gain")}
    for name, value in {**OF_PID, "derivative_gain": 0.02, "acceleration_feedforward_s": 6e-3}.items():
        assert abs(law.blocks[f"pid.{name}"][0] - value) < law.blocks[f"pid.{name}"][1] < 0.02 * value


def test_what_only_a_combination_determines_is_bounded_and_marked_everywhere(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """Gain times delay acts like less feedforward if both are delayed by neighbouring cycles: of the two only the difference is known."""
    lumps = first_values([recorded(late_feedforward, speed_command=True)], ["X"])
    law = lumps[0].law
    assert law["velocity_feedforward"] - law["position_gain_per_s"] * law["position_delay_s"] == pytest.approx(1.0 - 30.0 * 2e-3, abs=1e-3)
    write_lumped_machine(tmp_path / "m.toml", lumps, "strokes")
    lines = {line.split(" = ")[0]: line.partition("# ")[2] for line in (tmp_path / "m.toml").read_text(encoding="utf-8").splitlines()}
    assert lines["position_gain_per_s"].startswith("measured, 95 % +-")
    for name in ("velocity_feedforward", "position_delay_s"):
        assert lines[name].startswith("bounded")
    assert lines["moving_mass_kg"].startswith("bounded")  # what the current does between its samples is not recorded
    said = next(line for line in sheet(load_machine(tmp_path / "m.toml")).splitlines() if line.startswith("bounded, not measured"))
    assert {"loops.velocity_feedforward", "loops.position_delay_s", "moving_mass_kg"} <= set(said.split(": ")[2].split(", "))


def test_a_diagnosis_with_a_tried_controller_leads_to_an_earlier_recording(tmp_path: Path) -> None:
    """What the file lacks is in every recording of the machine; a comparison of two of them is free of it."""
    run = recorded(proportional)
    write_lumped_machine(tmp_path / "m.toml", first_values([run], ["X"]), "strokes")
    machine = load_machine(tmp_path / "m.toml")
    assert any("--since EARLIER" in note for note in notes_of(campaign([run]), machine))
    known = (tmp_path / "m.toml").read_text(encoding="utf-8")
    (tmp_path / "m.toml").write_text(re.sub(r" +# .*", "", known), encoding="utf-8")
    assert not any("--since" in note for note in notes_of(campaign([run]), load_machine(tmp_path / "m.toml")))


def test_an_assumed_controller_decides_no_number(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A control that nobody recorded: mass and friction come from command and motion alone, and no channel is called late within a cycle."""
    run = recorded(proportional, speed_command=True)
    run = replace(run, trace=replace(run.trace, signals={k: v for k, v in run.trace.signals.items() if k[1] != "velocity_setpoint"}))
    write_lumped_machine(tmp_path / "m.toml", first_values([run], ["X"]), "strokes")
    found = identify(campaign([run]), load_machine(tmp_path / "m.toml"), gaps=False)
    assert all(p.refined is None for p in found.parameters)
    for name, true in (("coulomb_friction", COULOMB), ("viscous_friction", VISCOUS)):
        estimate = found.parameter("X", name).estimate
        assert estimate.value == pytest.approx(true, abs=estimate.half + 0.02 * true)
    assert not any("late" in str(f) for f in found.findings)


@pytest.mark.parametrize("fitted", [False, True], ids=["tried control", "recorded control"])
@pytest.mark.parametrize(("weight", "rest"), [(0.0, -COULOMB), (0.0, 0.0), (2.0, -COULOMB)])
def test_one_direction_does_not_count_friction_twice(tmp_path: Path, weight: float, rest: float, fitted: bool) -> None:
    """Moved one way, Coulomb friction and a constant force are one number: it stands in the file once, before and after the identification. What the axis
    takes at rest along the motion is given as force."""
    run = recorded(proportional, speed_command=True, ends=LONG)
    up = run.trace.get("X", "setpoint")[:2200]
    assert np.all(np.diff(up) >= 0.0)
    signals = {k: v[: len(up)] for k, v in run.trace.signals.items() if fitted or k[1] != "velocity_setpoint"}
    signals["X", "current"] = weight + np.where(up > up[0], signals["X", "current"], rest)
    run = replace(run, trace=Trace(run.trace.time[: len(up)], signals, run.trace.kinds))
    write_lumped_machine(tmp_path / "m.toml", first_values([run], ["X"]), "strokes")
    first = load_machine(tmp_path / "m.toml")
    found = identify(campaign([run]), first, gaps=fitted, hold_out=False)
    assert not fitted or found.stage_of == {"X": "refined"}
    assert first.axis("X").constant_force == pytest.approx(max(weight + rest, 0.0), abs=0.1)
    for axis in (first.axis("X"), found.machine.axis("X")):
        assert axis.coulomb_friction + axis.constant_force == pytest.approx(COULOMB + weight, abs=0.1)


def test_two_routes_that_exclude_each_other_leave_an_interval_for_both() -> None:
    def one(name: str, value: Range, refined: Range | None) -> Parameter:
        return Parameter("X", name, "kg", 1.0, value, value, True, 1.0, False, "", refined)

    regression, fit, own = Range(1.2, 1.19, 1.21), Range(0.9, 0.88, 0.92), Range(300.0, 280.0, 320.0)
    kept, (said,) = reconciled(
        [one("inertia", regression, fit), one("speed_gain_nm_s_per_rad", own, own), one("coulomb_friction", own, None)]
    )
    assert [(p.name, p.refined) for p in kept] == [("inertia", Range(1.2, 0.88, 1.21)), ("coulomb_friction", None)]
    assert "exclude each other in inertia" in said.text
    assert reconciled([one("inertia", regression, Range(1.2, 1.18, 1.2))])[1] == []
    # samples that miss what the control does between them give no inertia by regression
    assert reconciled([one("inertia", regression, fit)], ["X"]) == ([one("inertia", regression, fit)], [])


def test_a_written_interval_is_no_narrower_than_its_number(tmp_path: Path) -> None:
    """With full feedforward gain and integral time exchange, and the speed gain is known within their difference: 2.247 is not 2.2."""
    (one,) = first_values([recorded(pd)], ["X"])
    lumps = [replace(one, law=replace(one.law, half={**one.law.half, SPEED_GAIN: 2.247}))]
    assert comments(lumps, tmp_path / "m.toml")["speed_gain_a_s_per_m"].endswith("+- 2.3")
