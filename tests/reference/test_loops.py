"""Margins of the loops against python-control: the same loops built there from transfer functions, and its own margins."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.builders.other_structures import slides
from twin.control.linear import Loop
from twin.effects import with_effects
from twin.machine.loops import first_mode, loops_of, margins_of
from twin.machine.machine import Axis, Machine
from twin.simulation.plant_spec import home_inertia_at_motor

control = pytest.importorskip("control")
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning", "ignore::FutureWarning")


def pi(gain: float, integral_time: float, period: float):  # type: ignore[no-untyped-def]
    """gain (1 + T/Tn / (z - 1))."""
    if math.isinf(integral_time):
        return control.tf([gain], [1.0], period)
    return control.tf([gain, gain * (period / integral_time - 1.0)], [1.0, -1.0], period)


def textbook(machine: Machine, axis: Axis) -> dict[str, object]:
    """Current and speed loop of an axis whose cycles are equal, in transfer functions of s and z."""
    m, loops, period = axis.motor, axis.loops, machine.speed_cycle
    inertia = home_inertia_at_motor(machine)[machine.axis_names.index(axis.name)]
    rotor = control.tf([1.0], [inertia, axis.viscous_friction_nm_s_per_rad])
    winding = control.tf([1.0], [m.inductance_h, m.resistance_ohm])
    current = control.minreal(control.feedback(winding, m.torque_constant_nm_per_a * rotor * m.back_emf_v_s_per_rad), verbose=False)
    current_loop = pi(loops.current_gain_v_per_a, loops.current_integral_time_s, period) * control.sample_system(current, period, "zoh")
    # voltage to current and speed together, closed by the current controller
    plant = control.ss(
        [
            [-m.resistance_ohm / m.inductance_h, -m.back_emf_v_s_per_rad / m.inductance_h],
            [m.torque_constant_nm_per_a / inertia, -axis.viscous_friction_nm_s_per_rad / inertia],
        ],
        [[1.0 / m.inductance_h], [0.0]],
        np.eye(2),
        np.zeros((2, 1)),
    )
    sampled = control.sample_system(plant, period, "zoh")
    controller = control.ss(pi(loops.current_gain_v_per_a, loops.current_integral_time_s, period))
    forward = control.series(controller, sampled)
    closed = control.feedback(forward, control.ss([], [], [], [[1.0, 0.0]], period))
    speed = control.ss(closed.A, closed.B, closed.C[1:], 0.0, period)
    told = axis.commissioned_torque_constant
    speed_loop = control.series(speed, control.ss(pi(loops.speed_gain_nm_s_per_rad / told, loops.speed_integral_time_s, period)))
    return {"current": current_loop, "speed": speed_loop}


def of_control(system: object) -> tuple[float, float, float, float]:
    """(gain margin, its Hz, phase margin, its Hz): the smallest that python-control finds, without slow artefacts near z = 1."""
    gains, phases, _, at_gain, at_phase, _ = control.stability_margins(system, returnall=True)
    gain = min(((g, w) for g, w in zip(gains, at_gain) if w > 1.0), key=lambda x: abs(math.log(x[0])), default=(math.inf, math.inf))
    phase = min(((p, w) for p, w in zip(phases, at_phase) if w > 0.5), key=lambda x: abs(x[0]), default=(math.inf, math.inf))
    return gain[0], gain[1] / (2 * math.pi), phase[0], phase[1] / (2 * math.pi)


def agree(loop: Loop, system: object) -> None:
    found = margins_of(loop)
    gain, at_gain, phase, at_phase = of_control(system)
    assert found.phase == pytest.approx(phase, rel=0.01)
    assert found.crossover == pytest.approx(at_phase, rel=0.01)
    if math.isfinite(gain):
        assert found.gain == pytest.approx(gain, rel=0.01)
        assert found.phase_crossing == pytest.approx(at_gain, rel=0.01)
    else:  # it does not count half the sampling rate, where L is real
        assert found.phase_crossing == pytest.approx(0.5 / loop.period)


@pytest.mark.parametrize("name", "XYZAC")
def test_current_and_speed_loop(mikron: Machine, name: str) -> None:
    axis = mikron.axis(name)
    expected = textbook(mikron, axis)
    for loop in loops_of(mikron, axis)[:2]:
        agree(loop, expected[loop.name])


@pytest.mark.parametrize("name", "XA")
def test_position_loop(mikron: Machine, name: str) -> None:
    """The closed speed loop of python-control with an integrator behind it, stepped 16 times under a held set point."""
    axis = mikron.axis(name)
    speed = textbook(mikron, axis)["speed"]
    inner = control.feedback(speed, 1)
    n, cycles = inner.nstates, round(mikron.position_cycle / mikron.speed_cycle)
    # the angle grows by the mean of the speed over the cycle: trapezoid of two samples, within 1 % below 200 Hz
    a = np.block([[inner.A, np.zeros((n, 1))], [0.5 * mikron.speed_cycle * inner.C @ (inner.A + np.eye(n)), np.ones((1, 1))]])
    b = np.vstack([inner.B, 0.5 * mikron.speed_cycle * inner.C @ inner.B])
    held = sum(np.linalg.matrix_power(a, j) @ b for j in range(cycles))
    c = np.append(np.zeros(n), axis.loops.position_gain_per_s)[None]
    agree(loops_of(mikron, axis)[2], control.ss(np.linalg.matrix_power(a, cycles), held, c, 0.0, mikron.position_cycle))


def test_p_p_on_a_voltage_with_a_differentiated_position(tmp_path: Path) -> None:
    """kv and kp around K / (M s + b): speed (1 - z^-2) / (2 T) of the position."""
    machine = slides(tmp_path, "X", (1000, 1000))
    axis, period = machine.axes[0], 1e-3
    position = control.sample_system(control.tf([35.0], [95.0, 200.0, 0.0]), period, "zoh")
    difference = control.tf([1.0, 0.0, -1.0], [2.0 * period, 0.0, 0.0], period)
    speed_loop = control.minreal(243.0 * position * difference, verbose=False)
    position_loop = control.minreal(160.0 * 243.0 * position / (1.0 + 243.0 * position * difference), verbose=False)
    for loop, system in zip(loops_of(machine, axis), (speed_loop, position_loop)):
        agree(loop, system)


def test_pi_on_an_actuator_with_a_lag(tmp_path: Path) -> None:
    """Kp (1 + T/Tn / (z - 1)) around 1 / (T_i s + 1) in series with Kt / (J s + b)."""
    lag = 6e-4
    machine = slides(tmp_path, "Z", (500, 500)).with_values({"axis.Z.loops.actuator_lag_s": lag, "axis.Z.loops.speed_filter_time_s": 0.0})
    axis, period = machine.axes[0], 5e-4
    inertia = float(home_inertia_at_motor(machine)[0])
    plant = control.tf([1.0], [lag, 1.0]) * control.tf([1.0], [inertia, axis.viscous_friction_nm_s_per_rad])
    controller = pi(axis.loops.speed_gain_nm_s_per_rad, axis.loops.speed_integral_time_s, period)
    agree(loops_of(machine, axis)[0], controller * control.sample_system(plant, period, "zoh"))


def test_speed_filter_and_scale_behind_a_spring(mikron: Machine) -> None:
    """A spring shows as a notch of the speed loop at the first mode; a filter of the speed costs the phase of a lag."""
    effect = {"name": "transmission_compliance", "axis": "X", "stiffness": 7e7, "damping": 0.0}
    machine = with_effects(mikron.with_axes(["X"]), [effect])
    mode = first_mode(machine, machine.axis("X"))
    assert mode == pytest.approx(math.sqrt(7e7 / 700.0) / (2 * math.pi), rel=1e-6)
    speed = loops_of(machine, machine.axis("X"))[1]
    near = np.linspace(0.8, 1.25, 4001) * mode
    assert near[np.argmin(np.abs(speed.open_response(near)))] == pytest.approx(mode, rel=0.02)
    lagged = mikron.with_axis("X", speed_filter_time_s=1e-3)
    f = np.array([20.0, 60.0, 150.0])
    ratio = loops_of(lagged, lagged.axis("X"))[1].open_response(f) / loops_of(mikron, mikron.axis("X"))[1].open_response(f)
    # (1 - p) / (1 - p / z): the lag as the control has it
    pole, z = math.exp(-125e-6 / 1e-3), np.exp(2j * np.pi * f * 125e-6)
    np.testing.assert_allclose(ratio, (1.0 - pole) / (1.0 - pole / z), rtol=1e-6)


def test_closed_loop_response_of_the_simulated_axis(mikron: Machine) -> None:
    """The simulated response to a sinusoidal set point equals that of the closed position loop: amplitude and phase at 5 Hz."""
    from tests.builders.one_axis import swing
    from twin.simulation.run import simulate
    from twin.simulation.setpoints import Setpoints

    machine = with_effects(mikron.with_axes(["X"]), [{"name": "coulomb_friction", "axis": "X", "factor": 0.0}])
    machine = machine.with_feedforward("off").with_axis("X", position_delay_s=0.0)
    f, period = 5.0, 1e-3
    position = swing(2e-3, f, 2.4)
    trace = simulate(machine, Setpoints(position[:, None], period)).trace
    last = slice(-round(5 / f / period) - 1, -1)
    turn = np.exp(-2j * np.pi * f * trace.time[last])
    measured = np.sum(trace.get("X", "position")[last] * turn) / np.sum(position[last] * turn)
    loop = loops_of(machine, machine.axis("X"))[2]
    # the position goes on in time between the cycles: the closed loop at the samples, as seen at the cycles' beginnings
    expected = loop.closed_response(np.array([f]))[0]
    assert abs(measured) == pytest.approx(abs(expected), rel=0.01)
    assert math.degrees(np.angle(measured / expected)) == pytest.approx(0.0, abs=1.0)


def test_unstable_gains_are_detected(mikron: Machine) -> None:
    for factor, stable in ((1.0, True), (margins_of(loops_of(mikron, mikron.axis("X"))[2]).gain * 1.02, False)):
        machine = mikron.with_axis("X", position_gain_per_s=50.0 * factor)
        assert margins_of(loops_of(machine, machine.axis("X"))[2]).stable is stable
