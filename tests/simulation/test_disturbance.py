"""Known forces: the drive reacts to an external load on the mechanics; an injected command is part of the command of the drive."""

from pathlib import Path

import numpy as np
import pytest

from tests.builders.one_axis import MACHINE, axis_of, total_inertia
from twin.effects import with_effects
from twin.errors import InputError
from twin.machine.machine import Machine, load_machine
from twin.recordings.trace import Trace, read_trace, write_trace
from twin.simulation.decoupled_plant import DecoupledPlant, Motion
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints, setpoints_of

LAB_AXIS = load_machine(Path(__file__).resolve().parents[2] / "examples" / "lab_axis" / "axis.toml")
TIME = np.arange(800) * 1e-3
PULSE = np.where((TIME > 0.2) & (TIME < 0.4), 1.0, 0.0)


def at_rest(signal: str | None, values: np.ndarray, machine: Machine = LAB_AXIS, axis: str = "X") -> Trace:
    """An axis at standstill under a known force."""
    kind = machine.axis(axis).kind
    signals = {(axis, "setpoint"): np.zeros_like(TIME)} | ({(axis, signal): values} if signal else {})
    return simulate(machine, setpoints_of(Trace(TIME, signals, {axis: kind}), machine), sample_period=1e-3).without_noise


def test_the_drive_compensates_an_external_load_and_executes_an_injected_command() -> None:
    load, voltage = at_rest("disturbance_force", 36.0 * PULSE), at_rest("injected_voltage", 2.0 * PULSE)
    none, force = at_rest(None, PULSE), at_rest("injected_force", 36.0 * PULSE)
    assert np.abs(none.get("X", "position")).max() < 1e-9
    # 18 N/V: all three exert the same force; the position loop holds: x = (F - friction) / (18 N/V * 100 V s/m * 25 1/s)
    held = (36.0 - 6.0) / (18.0 * 100.0 * 25.0)
    for pushed in (load, voltage, force):
        assert pushed.get("X", "position")[399] == pytest.approx(held, rel=0.05)
    assert np.abs(force.get("X", "voltage") - voltage.get("X", "voltage")).max() < 1e-9
    # the drive compensates the load except for friction; of an injected command, only the friction remains as command
    assert load.get("X", "voltage")[399] == pytest.approx(-(36.0 - 6.0) / 18.0, rel=0.05)
    assert voltage.get("X", "voltage")[399] == pytest.approx(6.0 / 18.0, rel=0.3)


def test_a_drive_with_an_integrator_carries_the_load_and_the_axis_stays() -> None:
    machine = with_effects(MACHINE.with_axes(["X"]), [{"name": "coulomb_friction", "axis": "X", "factor": 0.0}])
    axis = axis_of("X")
    trace = at_rest("disturbance_force", 500.0 * (TIME > 0.1), machine)
    assert trace.get("X", "current")[-1] == pytest.approx(-500.0 * axis.ratio / axis.motor.torque_constant_nm_per_a, rel=0.02)
    assert abs(trace.get("X", "position")[-1]) < 2e-7
    assert np.abs(trace.get("X", "position")).max() > 1e-6  # it yields at first
    # the integrators carry a load that acts from the start
    steady = at_rest("disturbance_force", np.full(len(TIME), 500.0), machine)
    assert np.ptp(steady.get("X", "position")) < 1e-9
    assert steady.get("X", "current")[0] == pytest.approx(-500.0 * axis.ratio / axis.motor.torque_constant_nm_per_a, rel=1e-9)


def test_a_force_on_the_carriage_deflects_the_drive_train_and_a_torque_on_the_shaft_does_not() -> None:
    axis = axis_of("X")
    soft = {"name": "transmission_compliance", "axis": "X", "stiffness": 1e8}
    machine = with_effects(MACHINE.with_axes(["X"]), [soft, {"name": "coulomb_friction", "axis": "X", "factor": 0.0}])
    on_load = at_rest("disturbance_force", 500.0 * (TIME > 0.1), machine)
    on_motor = at_rest("disturbance_torque", 500.0 * axis.ratio * (TIME > 0.1), machine)
    bent = [(t.get("X", "motor_position") - t.get("X", "load_position"))[-1] for t in (on_load, on_motor)]
    assert bent[0] == pytest.approx(-500.0 / 1e8, rel=0.02)
    assert abs(bent[1]) < 2e-8
    assert on_motor.get("X", "current")[-1] == pytest.approx(on_load.get("X", "current")[-1], rel=0.02)


def test_a_short_push_keeps_its_impulse_and_both_plants_agree() -> None:
    """A force pulse of one sample between two position cycles keeps its impulse."""
    push = np.zeros((800, 1, 2))
    push[301, 0, 0] = 1000.0
    points = Setpoints(np.zeros((800, 1)), 1e-3, external_force=push)
    assert points.external_force_at(0, 400, 2e-3).sum() * 2e-3 == pytest.approx(1.0)
    machine = MACHINE.with_axes(["Y"])
    motion = Motion(*(np.zeros((800, 1)) for _ in range(3)), 1e-3)
    both = [simulate(machine, points, plant_of=plant).without_noise for plant in (None, lambda change: DecoupledPlant(change, motion))]
    assert np.abs(both[0].get("Y", "position") - both[1].get("Y", "position")).max() < 1e-8
    free = with_effects(machine, [{"name": "coulomb_friction", "axis": "Y", "factor": 0.0}])
    speed = simulate(free, points, sample_period=125e-6).without_noise.get("Y", "velocity")
    assert 0.6 < speed.max() * total_inertia("Y") < 1.0  # the loop compensates a part within 2 ms


def test_a_torque_turns_a_rotary_axis() -> None:
    machine = MACHINE.with_axes(["C"])
    trace = at_rest("disturbance_torque", 20.0 * (TIME > 0.1), machine, "C")
    axis = machine.axis("C")
    carried = -trace.get("C", "current")[-1] * axis.motor.torque_constant_nm_per_a / axis.ratio
    assert carried == pytest.approx(20.0, abs=axis.coulomb_friction + 0.5)
    assert carried > 0.0


@pytest.mark.parametrize(
    ("signal", "machine", "axis", "words"),
    [
        ("injected_current", LAB_AXIS, "X", "its drive takes V"),
        ("disturbance_force", MACHINE.with_axes(["C"]), "C", "in N is not a torque"),
        ("injected_force", MACHINE.with_axes(["C"]), "C", "in N is not a torque"),
    ],
)
def test_a_unit_that_the_axis_cannot_use_is_refused(signal: str, machine: Machine, axis: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        at_rest(signal, PULSE, machine, axis)


def test_units_distinguish_load_and_command_in_a_file(tmp_path: Path) -> None:
    signals = {("X", name): PULSE for name in ("setpoint", "disturbance_force", "injected_voltage", "injected_torque")}
    write_trace(Trace(TIME, signals, {"X": "linear"}), tmp_path / "run.csv")
    head = (tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()[0]
    assert all(name in head for name in ("X.disturbance [N]", "X.injected_command [V]", "X.injected_command [Nm]"))
    read = read_trace(tmp_path / "run.csv")
    assert set(read.loads("X")) == {"N"}
    assert set(read.injections("X")) == {"V", "Nm"}
    # a disturbance in V is an injected command
    (tmp_path / "old.csv").write_text("time [s],X.setpoint [mm],X.disturbance [V]\n0,0,0\n0.001,0,1\n", encoding="utf-8")
    assert set(read_trace(tmp_path / "old.csv").injections("X")) == {"V"}
