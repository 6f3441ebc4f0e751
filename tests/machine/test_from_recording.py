"""A machine made from a recording alone has the numbers of the recorded machine, referred to the axis."""

from dataclasses import replace
from pathlib import Path
import re

import numpy as np
import pytest

from tests.builders.identify_campaigns import path
from tests.builders.other_structures import slides
from twin.cli import main
from twin.effects import EFFECTS
from twin.effects.change import total_inertia
from twin.errors import InputError
from twin.geometry.scurve import moves_in_turn
from twin.identify.first_values import first_values
from twin.identify.from_recording import machine_from_recording, runs_with_most_travel
from twin.machine.axis_lumps import AxisControl, AxisLumps, Mechanics
from twin.machine.holding import holding_of
from twin.machine.lumped_file import write_lumped_machine
from twin.machine.machine import Machine, load_machine, write_machine
from twin.recordings.campaign import MeasuredRun, read_campaign
from twin.recordings.trace import Trace, write_trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

ROOT = Path(__file__).resolve().parents[2]
LAB_AXIS = ROOT / "examples" / "lab_axis" / "axis.toml"


def recorded(folder: Path, machine: Machine, seconds: float = 3.0) -> Path:
    """A campaign of one run: strokes of one axis, simulated without noise."""
    t = np.arange(round(seconds / machine.sample_period)) * machine.sample_period
    way = 0.05 * (1.0 - np.cos(2.0 * np.pi * t / seconds * 2.0)) + 0.01 * np.sin(2.0 * np.pi * 3.1 * t) * np.minimum(t, 1.0)
    way = way * np.clip(t / 0.3, 0.0, 1.0) ** 3
    run = simulate(machine, Setpoints(way[:, None], machine.sample_period))
    trace = Trace(run.without_noise.time, dict(run.without_noise.signals), machine.kinds)
    write_trace(trace, folder / "strokes.parquet")
    (folder / "campaign.toml").write_text('[[run]]\nfile = "strokes.parquet"\nfeedforward = "off"\n', encoding="utf-8")
    return folder


def test_a_drive_with_a_voltage_command_is_identified(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = load_machine(LAB_AXIS)
    folder = recorded(tmp_path / "campaign", machine)
    out = tmp_path / "machine" / "made.toml"
    assert main(["machine", "new", "--from-recording", str(folder), "--out", str(out)]) == 0
    assert "of the following error" in capsys.readouterr().out
    made = load_machine(out).axes[0]
    true = machine.axes[0]
    assert made.structure == "P/P"
    assert made.loops.speed_mean_cycles == true.loops.speed_mean_cycles == 4
    assert made.loops.position_gain_per_s == pytest.approx(true.loops.position_gain_per_s, rel=0.01)
    # the lumped parameters are mass and friction over 18 N/V
    assert made.moving_mass_kg == pytest.approx(12.0 / 18.0, rel=0.03)
    assert made.coulomb_friction == pytest.approx(6.0 / 18.0, rel=0.1)
    text = out.read_text(encoding="utf-8")
    assert "lump" in text
    assert "assumed" in text
    # the machine reproduces its recording
    assert main(["gap", str(folder), "--machine", str(out), "--json", str(tmp_path / "gap.json")]) == 0


@pytest.mark.parametrize("both", [True, False])
def test_two_encoders_show_a_drive_train(tmp_path: Path, both: bool) -> None:
    """Play and a spring act between a motor and a load: a machine of one mass had neither, and 8 um of play between two recordings had no name."""
    folder = recorded(tmp_path, load_machine(LAB_AXIS))
    if both:
        trace = read_campaign(folder).runs[0].trace
        apart = 5e-6 * np.sign(np.gradient(trace.get("X", "position")))
        write_trace(
            replace(trace, signals={**trace.signals, ("X", "motor_position"): trace.get("X", "position") + apart}),
            folder / "strokes.parquet",
        )
    machine_from_recording(folder, tmp_path / "made.toml")
    made = load_machine(tmp_path / "made.toml")
    (axis,) = made.axes
    assert EFFECTS["backlash"].can_have(made, axis) is both
    assert total_inertia(made, axis) == pytest.approx(12.0 / 18.0, rel=0.03)
    share = "assumed: 50% of the mass are at the motor"
    assert (share in (tmp_path / "made.toml").read_text(encoding="utf-8")) is both


def test_the_loop_closed_in_the_drive_is_found(tmp_path: Path) -> None:
    """Gain, delay and Td of a position loop in the drive are identified from its signals."""
    t = np.arange(4000) * 2e-3
    s = 0.1 * np.sin(1.3 * t) + 0.02 * np.sin(7.0 * t)

    # a drive without lag follows its set point: v(t) = w*(t - Td) - Kv (x(t) - x(t - Td)), in steps of 0.05 ms
    kv, td, fine = 40.0, 4e-3, 5e-5
    n, every, late = round(t[-1] / fine) + 1, round(2e-3 / fine), round(td / fine)
    times = np.arange(n) * fine
    fed = np.interp(times, t, np.gradient(s, t))
    wanted = np.interp(times - 3e-3, t, s)
    x, command = np.zeros(n), np.zeros(n)
    held = 0.0
    for k in range(1, n):
        if (k - 1) % every == 0:
            held = kv * (wanted[k - 1] - x[k - 1]) + fed[k - 1]
        command[k - 1] = held
        old = max(k - 1 - late, 0)
        x[k] = x[k - 1] + fine * (command[old] - kv * (x[k - 1] - x[old]))
    rows = np.arange(len(t) - 1) * every  # the last command is not computed
    signals = {
        ("X", "setpoint"): s[:-1],
        ("X", "position"): x[rows],
        ("X", "velocity_setpoint"): command[rows],
        ("X", "velocity_feedforward"): fed[rows],
    }
    write_trace(Trace(t[:-1], signals, {"X": "linear"}), tmp_path / "run.parquet")
    (tmp_path / "campaign.toml").write_text('[[run]]\nfile = "run.parquet"\nfeedforward = "velocity"\n', encoding="utf-8")
    law = first_values(read_campaign(tmp_path).runs, ["X"])[0].law
    assert law["position_gain_per_s"] == pytest.approx(kv, rel=1e-3)
    assert law["position_delay_s"] == pytest.approx(3e-3, abs=5e-5)
    assert law["dsc_delay_s"] == pytest.approx(td + 1e-3, abs=1.2e-3)  # holding the command for a cycle adds half a cycle of delay


def test_a_single_short_move_shows_a_loop_closed_in_the_drive(tmp_path: Path) -> None:
    """Nothing of such a move can be held out: a part of it would not show the delay."""
    for name in ("slides", "campaign"):
        (tmp_path / name).mkdir()
    changed = {"loops.dsc_delay_s": 0.0052, "loops.speed_filter_time_s": 0.0}
    machine = slides(tmp_path / "slides", "Z", (250, 2000)).with_values({f"axis.Z.{k}": v for k, v in changed.items()})
    _, move = moves_in_turn(0.0, [0.0045], 0.03, 0.5, 15.0, 0.2, 2e-3)
    way = np.concatenate([np.zeros(250), move, np.full(200, move[-1])])
    run = simulate(machine, Setpoints(way[:, None], 2e-3), sample_period=2e-3, noise_seed=1)
    recorded_too = ("setpoint", "position", "velocity_setpoint", "current")
    trace = Trace(run.trace.time, {k: v for k, v in run.trace.signals.items() if k[1] in recorded_too}, machine.kinds)
    write_trace(trace, tmp_path / "campaign" / "move.parquet")
    text = '[[run]]\nfile = "move.parquet"\nfeedforward = "velocity"\n'
    (tmp_path / "campaign" / "campaign.toml").write_text(text, encoding="utf-8")
    made = machine_from_recording(tmp_path / "campaign", tmp_path / "made.toml")
    assert load_machine(tmp_path / "made.toml").axis("Z").loops.dsc_delay_s == pytest.approx(0.0052, rel=0.01)
    assert made.followed["Z"].gap < 0.005 * made.followed["Z"].following


@pytest.mark.parametrize("followed", [True, False])
def test_a_gain_is_measured_only_if_the_speed_set_point_follows_its_law(followed: bool) -> None:
    """v* = Kv (s - x) + ds/dt is a position controller; a speed with a tenth of something else in it is not known to be one."""
    t = np.arange(3000) * 2e-3
    s = 0.1 * np.sin(1.3 * t) + 0.02 * np.sin(7.0 * t)
    x = np.interp(t - 4e-3, t, s) + 1e-3 * np.sin(30.0 * t)  # what disturbs the axis, so that its error is not that of a pure delay
    given = 40.0 * (s - x) + np.gradient(s, 2e-3) + (0.0 if followed else 0.02) * np.sin(11.0 * t)
    signals = {("X", "setpoint"): s, ("X", "position"): x, ("X", "velocity_setpoint"): given}
    law = first_values([MeasuredRun("run", Trace(t, signals, {"X": "linear"}), "velocity", 0.0)], ["X"])[0].law
    assert law.measured == followed
    assert not followed or law["position_gain_per_s"] == pytest.approx(40.0, rel=0.01)


@pytest.mark.parametrize("time", [0.0, 3e-3])
def test_a_speed_set_point_that_is_recorded_behind_a_filter_gives_the_gain_of_its_controller(time: float) -> None:
    """w* = 30 (s - x) with x behind a speed loop of 4 ms; a drive that filters what it records of w* with 3 ms."""
    period, every, fine = 1e-3, 8, 1.25e-4
    s = path([0.01, 0.0, 0.03, -0.03], [0.03, 0.06, 0.1, 0.3], jerk=60.0)
    x = v = given = seen = 0.0
    rows = []
    for k in range(every * len(s)):
        given = given if k % every else 30.0 * (s[k // every] - round(x, 8))
        seen += (1.0 - np.exp(-fine / time) if time else 1.0) * (given - seen)
        rows += [] if k % every else [(s[k // every], x, seen)]
        v += fine / 4e-3 * (given - v)
        x += fine * v
    columns = [np.round(column, digits) for column, digits in zip(np.array(rows).T, (9, 8, 7))]
    signals = dict(zip((("X", "setpoint"), ("X", "position"), ("X", "velocity_setpoint")), columns))
    law = first_values([MeasuredRun("run", Trace(np.arange(len(s)) * period, signals, {"X": "linear"}), None, 0.0)], ["X"])[0].law
    assert abs(law["position_gain_per_s"] - 30.0) < min(law.half["position_gain_per_s"], 0.5)
    assert law.blocks.keys() == ({"speed_record_lag.time_constant_s"} if time else set())
    assert all(abs(found - time) < max(half, 1e-5) for found, half in law.blocks.values())


@pytest.mark.parametrize("kind", ["coarse", "slow one way"])
def test_what_is_written_is_accepted_by_every_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str) -> None:
    """A current that the motion does not explain gives no mass; limits of speed, acceleration and command fit each other."""
    random = np.random.default_rng(7)
    period = 0.1007463 if kind == "coarse" else 2e-3
    t = np.arange(270 if kind == "coarse" else 3000) * period
    s = 0.2 * np.sin(0.8 * t) if kind == "coarse" else 0.03 * t + 8e-3 * np.sin(3.0 * t)
    x = np.interp(t - 0.02, t, s)
    v = np.gradient(x, period)
    current = random.standard_normal(len(t)) if kind == "coarse" else 2.0 + 60.0 * v + 0.01 * random.standard_normal(len(t))
    quantity = "rotary" if kind == "coarse" else "linear"
    write_trace(
        Trace(t, {("X", "setpoint"): s, ("X", "position"): x, ("X", "current"): current}, {"X": quantity}), tmp_path / "run.parquet"
    )
    (tmp_path / "campaign.toml").write_text('[[run]]\nfile = "run.parquet"\n', encoding="utf-8")
    out = tmp_path / "m.toml"
    made = machine_from_recording(tmp_path, out, identified=False).lumps[0]
    assert (made.mechanics is None) == (kind == "coarse")
    if made.mechanics is None:  # of the size that the recorded current allows, a tenth of it in the model
        torque = load_machine(out).axis("X").rotor_inertia_kg_m2 * made.acceleration
        assert torque == pytest.approx(0.45 * np.abs(current).max(), rel=1e-3)
    assert made.mechanics is None or (
        made.mechanics.one_way and "its sum with the constant force is known" in out.read_text(encoding="utf-8")
    )
    assert main(["machine", "check", str(out)]) == 0
    assert "impossible" not in capsys.readouterr().out
    assert main(["gap", str(tmp_path), "--machine", str(out), "--json", str(tmp_path / "gap.json")]) in (0, 1)


def test_gravity_turns_with_a_rotary_axis(tmp_path: Path) -> None:
    """The model of a rotary axis has the identified inertia, and gravity of 4 cos q - 3 sin q."""
    law = AxisControl({"position_gain_per_s": 50.0, "velocity_feedforward": 0.0}, lag=2e-3)
    mechanics = Mechanics("torque", 2.0, 1.0, 0.5, 0.0, (4.0, -3.0), 40.0)
    lumps = AxisLumps("C", "rotary", "motor", (-1.0, 1.0), 2.0, 5.0, 2e-3, law, mechanics, 1e-7, 0.0)
    write_lumped_machine(tmp_path / "m.toml", [lumps], "test")
    machine = load_machine(tmp_path / "m.toml")
    holding = holding_of(machine)
    q = holding.angles[:, 0]
    assert holding.forces[:, 0] == pytest.approx(4.0 * np.cos(q) - 3.0 * np.sin(q), abs=1e-6)
    assert total_inertia(machine, machine.axis("C")) == pytest.approx(2.0, rel=1e-6)


def test_no_file_is_overwritten_and_a_source_is_required(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "m.toml"
    assert main(["machine", "new", "--out", str(out)]) == 2
    assert "give a MODEL, or --from-recording" in capsys.readouterr().err
    out.write_text("", encoding="utf-8")
    (tmp_path / "c").mkdir()
    assert main(["machine", "new", "--from-recording", str(tmp_path / "c"), "--out", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_the_weight_over_the_travel_follows_the_travel(mikron: Machine) -> None:
    holding_of(mikron)
    narrow = holding_of(mikron.with_values({"axis.A.travel_deg": [-5.0, 5.0]}))
    assert np.abs(narrow.angles[:, narrow.rotary.index("A")]).max() == pytest.approx(np.radians(5.0))


def test_a_short_run_does_not_hide_the_long_ones() -> None:
    def run(name: str, count: int, reach: float) -> MeasuredRun:
        time = np.arange(count) * 2e-3
        return MeasuredRun(name, Trace(time, {("X", "setpoint"): reach * np.sin(5.0 * time)}, {"X": "linear"}), None, 0.0)

    assert [r.name for r in runs_with_most_travel([run("short", 30, 1.0), run("long", 5000, 0.1)], ["X"])] == ["long"]


def test_a_machine_file_with_a_byte_order_mark_is_checked_and_written_again(tmp_path: Path, mikron: Machine) -> None:
    assert mikron.path is not None
    for file in mikron.path.parent.iterdir():
        if file.suffix in (".toml", ".xml"):
            (tmp_path / file.name).write_bytes(file.read_bytes())
    marked = tmp_path / mikron.path.name
    marked.write_bytes(b"\xef\xbb\xbf" + marked.read_bytes())
    machine = load_machine(marked)
    assert main(["machine", "check", str(marked)]) == 0
    write_machine(machine.with_axis("X", position_gain_per_s=60.0), tmp_path / "again.toml")
    assert load_machine(tmp_path / "again.toml").axis("X").loops.position_gain_per_s == 60.0


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("name =", "body = 3\nname =", "'body' must hold one table for each body"),
        ("name =", "geometry = 1\nname =", "[geometry]: must be a table"),
        ("name =", "driven_axes = []\nname =", "driven_axes = []"),
    ],
)
def test_a_value_in_place_of_a_table_is_refused(tmp_path: Path, mikron: Machine, old: str, new: str, said: str) -> None:
    assert mikron.path is not None
    text = re.sub(r"(?ms)^\[(body|geometry)[^\n]*\n(?:(?!^\[).)*", "", mikron.path.read_text(encoding="utf-8"))
    file = tmp_path / "m.toml"
    file.write_text(text.replace(old, new, 1), encoding="utf-8")
    (tmp_path / mikron.model_path.name).write_bytes(mikron.model_path.read_bytes())
    with pytest.raises(InputError, match=re.escape(said)):
        load_machine(file)


def test_names_of_joints_are_quoted(tmp_path: Path) -> None:
    model = tmp_path / "slide.xml"
    model.write_text(
        '<mujoco><worldbody><body><joint name="robot/X" type="slide" axis="1 0 0" range="0 1"/><geom size="0.1" mass="5"/></body></worldbody></mujoco>',
        encoding="utf-8",
    )
    assert main(["machine", "new", str(model), "--out", str(tmp_path / "new.toml")]) == 0
    assert load_machine(tmp_path / "new.toml").axis_names == ("robot/X",)
