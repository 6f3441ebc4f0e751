"""Strokes at one speed: the sum of Coulomb and viscous friction is known, nothing beyond the recording is written, and encoders that agree are not late."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.builders.identify_campaigns import campaign, path
from twin.identify.first_values import first_values
from twin.identify.from_recording import Reproduction, machine_from_recording, reproduction_text
from twin.identify.identify import identify
from twin.identify.recording import prepare_recording
from twin.identify.write import machine_comments
from twin.machine.commented import MEASURED, TRIED
from twin.machine.lumped_file import write_lumped_machine
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace, write_trace
from twin.simulation.plant_spec import with_commissioned_inertia

SPEED, COULOMB, VISCOUS, MASS = 0.0168, 2.4, 60.0, 1.5
SUM = COULOMB + VISCOUS * SPEED
PERIOD = 2e-3


def strokes(late_s: float = 0.0, speeds: tuple[float, ...] = (SPEED,)) -> MeasuredRun:
    """Strokes of 60 mm that lag by 11 ms; a start takes a peak; the encoders differ by a play of 4 um, a ripple and noise; the motor's is late."""
    s = np.concatenate([path([0.06, 0.0], [v, v], acceleration=0.9, jerk=60.0, dwell=0.6) for v in speeds])[::2]
    t = np.arange(len(s)) * PERIOD
    random = np.random.default_rng(5)
    x = np.interp(t - 0.011, t, s)
    # a ripple of the screw: speed and difference of the encoders swing together, by 3 % and 2 um, as a lateness of 4 ms would make them
    swing = np.cos(4.0 * np.pi * t)
    x = np.cumsum(np.diff(x, prepend=0.0) * (1.0 + 0.03 * swing))
    ripple = 2e-6 * swing * np.sign(np.round(np.gradient(x, PERIOD), 6))
    v, a = np.gradient(x, PERIOD), np.gradient(np.gradient(x, PERIOD), PERIOD)
    force = MASS * a + COULOMB * np.sign(np.round(v, 6)) + VISCOUS * v + 3.0 * np.sign(v) * (np.abs(a) > 0.2)
    motor = np.interp(t - late_s, t, x + ripple + 2e-6 * np.sign(np.round(v, 6)))
    noise = random.standard_normal((3, len(t)))
    signals = {
        ("X", "setpoint"): s, ("X", "position"): np.round(x + 3e-7 * noise[0], 7), ("X", "motor_position"): motor + 3e-7 * noise[1],
        ("X", "current"): force + 0.05 * noise[2],
    }  # fmt: skip
    return MeasuredRun("strokes", Trace(t, signals, {"X": "linear"}), None, 0.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    folder = tmp_path_factory.mktemp("one_speed")
    write_trace(strokes().trace, folder / "strokes.parquet")
    (folder / "campaign.toml").write_text('[[run]]\nfile = "strokes.parquet"\n', encoding="utf-8")
    out = Path(folder / "made.toml")
    machine_from_recording(folder, out, identified=False)
    assert "with the viscous friction at" in out.read_text(encoding="utf-8")
    return load_machine(out)


def test_one_speed_gives_the_sum_of_the_frictions(made: Machine) -> None:
    axis = made.axis("X")
    assert axis.coulomb_friction + SPEED * axis.viscous_friction == pytest.approx(SUM, rel=0.05)
    found = identify(campaign([strokes()]), made, gaps=False)
    refined = found.machine.axis("X")
    assert refined.coulomb_friction + SPEED * refined.viscous_friction == pytest.approx(SUM, rel=0.05)
    assert found.machine.axis("X").moving_mass_kg == axis.moving_mass_kg
    assert any("too narrow a range of speeds" in str(f) for f in found.findings)
    comments = machine_comments(found)
    grades = [text for path, text in comments.items() if path.endswith(("coulomb_friction_n", "viscous_friction_n_s_per_m"))]
    assert grades
    assert all(text.startswith("bounded") and "sum of both frictions" in text for text in grades), comments


def test_the_sum_has_an_interval() -> None:
    """Regression: of a robot joint that another one's weight loads, 5.5 Nm stood without an interval (true 2.7; the interval of the sum is 3.5)."""
    found = first_values([strokes()], ["X"])[0].mechanics
    assert found is not None
    assert found.steady_speed is not None
    assert abs(found.coulomb - SUM) <= found.half["coulomb"] < 0.1 * SUM


def test_a_limit_of_the_command_is_in_the_file_and_bounds_what_is_permitted(tmp_path: Path) -> None:
    one = first_values([strokes(speeds=(0.01, 0.02, 0.05, 0.1))], ["X"])[0]
    assert one.mechanics is not None
    file = tmp_path / "machine.toml"
    write_lumped_machine(file, [replace(one, mechanics=replace(one.mechanics, limited=True, peak=15.0))], "strokes")
    axis = load_machine(file).axis("X")
    assert axis.motor.peak_current_a == 15.0
    assert "peak_current_a = 15.0" in (text := file.read_text(encoding="utf-8"))
    assert "measured: the command stands there" in text
    m = one.mechanics
    taken = m.inertia * axis.max_acceleration + m.coulomb + m.viscous * axis.max_velocity + abs(m.constant)
    assert taken == pytest.approx(15.0 / 1.5, rel=1e-3)


@pytest.mark.parametrize(("origin", "said"), [(MEASURED, "other forces"), (TRIED, "assumed numbers of its control")])
def test_what_does_not_hold_of_a_machine_that_follows_no_better_than_the_set_point(origin: str, said: str) -> None:
    one = first_values([strokes()], ["X"])[0]
    one = replace(one, law=replace(one.law, origin=origin))
    assert said in reproduction_text(one, Reproduction(2e-4, 1e-4))
    assert "no better" not in reproduction_text(one, Reproduction(1e-5, 1e-4))


def test_several_speeds_separate_them() -> None:
    found = first_values([strokes(speeds=(0.01, 0.02, 0.05, 0.1))], ["X"])[0].mechanics
    assert found is not None
    assert found.steady_speed is None
    assert found.viscous == pytest.approx(VISCOUS, rel=0.15)


@pytest.mark.parametrize("late_s", [0.0, 4e-3])
def test_encoders_that_agree_are_not_late(made: Machine, late_s: float) -> None:
    # at one speed a play of the opposite sign looks like lateness; a real one shows at several speeds
    run = replace(strokes(late_s, (0.01, 0.02, 0.05, 0.1) if late_s else (SPEED,)), feedforward="off")
    recording = prepare_recording(with_commissioned_inertia(made), campaign([run, replace(run, name="again")]))
    said = " ".join(str(f) for f in recording.findings)
    assert len(recording.runs) == 1
    assert "equals run strokes sample for sample" in said
    assert ("motor_position was recorded" in said) == (late_s > 0.0)
    assert "current was recorded" not in said


@pytest.mark.parametrize("weight", [0.0, 4.0])
def test_one_way_gives_a_sum_and_no_force_that_is_not_there(weight: float) -> None:
    """An axis that moves one way between two rests: friction and a constant force are one number, and the force is what the axis takes at rest."""
    s = np.concatenate([np.zeros(600), path([0.06], [SPEED], acceleration=0.9, jerk=60.0, dwell=0.6)])[::2]
    t, random = np.arange(len(s)) * PERIOD, np.random.default_rng(7)
    x = np.interp(t - 0.011, t, s)
    v, a = np.gradient(x, PERIOD), np.gradient(np.gradient(x, PERIOD), PERIOD)
    force = MASS * a + COULOMB * np.sign(np.round(v, 6)) + VISCOUS * v + weight
    signals = {("X", "setpoint"): s, ("X", "position"): x, ("X", "current"): force + 0.05 * random.standard_normal(len(t))}
    found = first_values([MeasuredRun("one way", Trace(t, signals, {"X": "linear"}), None, 0.0)], ["X"])[0]
    assert found.mechanics is not None
    assert found.mechanics.constant == pytest.approx(weight, abs=0.05)
    assert found.mechanics.coulomb == pytest.approx(SUM, rel=0.05)
    assert found.mechanics.steady_speed == pytest.approx(SPEED, rel=0.02)
    assert any("only the sum of friction and constant current is known" in note for note in found.notes)
