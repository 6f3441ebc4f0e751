"""A machine made from a recording alone has the numbers of the recorded machine, referred to the axis."""

from pathlib import Path

import numpy as np
import pytest

from twin.cli import main
from twin.effects.change import total_inertia
from twin.machine.holding import holding_of
from twin.machine.lumped_file import Tuning, write_lumped_machine
from twin.machine.lumps import AxisLumps, Law, Mechanics, lumps_of
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import read_campaign
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
    law = lumps_of(read_campaign(tmp_path).runs, "X").law
    assert law.gain == pytest.approx(kv, rel=1e-3)
    assert law.delay == pytest.approx(3e-3, abs=5e-5)
    assert law.dsc_delay == pytest.approx(td + 1e-3, abs=1.2e-3)  # holding the command for a cycle adds half a cycle of delay


def test_gravity_turns_with_a_rotary_axis(tmp_path: Path) -> None:
    """The model of a rotary axis has the identified inertia, and gravity of 4 cos q - 3 sin q."""
    law = Law(50.0, 0.0, 0.0, 0.0, lag=2e-3)
    mechanics = Mechanics("torque", 2.0, 1.0, 0.5, 0.0, (4.0, -3.0), 0.95, 40.0)
    lumps = AxisLumps("C", "rotary", "motor", (-1.0, 1.0), 2.0, 5.0, 2e-3, law, mechanics, 1e-7, 0.0)
    write_lumped_machine(tmp_path / "m.toml", [lumps], {"C": Tuning(2e-3, 0.02, 0.0)}, "test")
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
