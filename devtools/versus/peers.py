"""Speed of simulation and planning beside that of other libraries, in one run: `python -m devtools.versus --peers --out DIR`.

Simulated is X of the Mikron on the set points of `twin demo`, with feedforward. The peers get the same law in continuous time as far as they
can express it:

    w* = (Kv (s(t - d) - x) + s'(t - d)) / r          T* = Kp (w* - w) + I + J_ff s''(t - d) / r        I' = Kp / Tn (w* - w)
    u = Kpi (T* / Kt - i) + U,  U' = Kpi / Tni (T* / Kt - i),  L i' = u - R i - Ke w,  M v' = Kt i / r - D v - Fc sign(v)

`solve_ivp` has all of it, python-control all but the Coulomb friction, MuJoCo in plain Python the sampled law itself. Times are processor times.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import statistics
import tempfile
import time
from typing import Any

import numpy as np

from tests.reference.cascade_reference import ReferenceSimulation
from twin.cli.demo import AXIS, paper_test
from twin.machine.machine import Machine, load_machine
from twin.program import interpolate, read_program
from twin.simulation.decoupled_plant import DecoupledPlant
from twin.simulation.nominal_motion import nominal_motion
from twin.simulation.plant_spec import commissioned_inertia
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints, setpoints_of
from twin.simulation.summary import table

REPEATS = 3
PYTHON_TICKS = 2_000
"""Ticks of the Python loop over MuJoCo; its time is scaled to the whole run."""

SMOOTH_M_PER_S = 1e-5
"""The friction of `solve_ivp` changes its sign within this speed; a jump would stop the integrator."""

CHORDS, FEED = 1_000, 3_000.0


def seconds(work: Callable[[], Any]) -> tuple[float, Any]:
    """Median processor time [s] of REPEATS calls after a first one, and the result."""
    result, times = work(), []
    for _ in range(REPEATS):
        begin = time.process_time()
        result = work()
        times.append(time.process_time() - begin)
    return statistics.median(times), result


def linear_law(machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """A (5, 5) and B (5, 3) of the axis without Coulomb friction: states x, v, I, i, U; inputs s, s', s'', delayed."""
    (axis,) = machine.axes
    loops, motor, r = axis.loops, axis.motor, axis.ratio
    inertia = (axis.moving_mass_kg or 0.0) + axis.rotor_inertia_kg_m2 / r**2
    x, v, integral, i, u_integral, s, ds, dds = np.eye(8)  # rows over states and inputs
    w = v / r
    e = (loops.position_gain_per_s * (s - x) + loops.velocity_feedforward * ds) / r - w
    kp = loops.speed_gain_nm_s_per_rad
    torque = kp * e + integral + loops.torque_feedforward * commissioned_inertia(machine)[0] / r * dds
    e_i = torque / motor.torque_constant_nm_per_a - i
    voltage = loops.current_gain_v_per_a * e_i + u_integral
    rows = np.array(
        [
            v,
            (motor.torque_constant_nm_per_a * i / r - axis.viscous_friction * v) / inertia,
            kp / loops.speed_integral_time_s * e,
            (voltage - motor.resistance_ohm * i - motor.back_emf_v_s_per_rad * w) / motor.inductance_h,
            loops.current_gain_v_per_a / loops.current_integral_time_s * e_i,
        ]
    )
    return rows[:, :5], rows[:, 5:]


def simulations(machine: Machine, setpoints: Setpoints) -> dict[str, dict[str, float]]:
    """Time [s] of each simulation of the run, and its largest difference of the position from the twin in MuJoCo [um]."""
    from scipy.integrate import solve_ivp

    (axis,) = machine.axes
    spent, run = seconds(lambda: simulate(machine, setpoints))
    t = run.trace.time
    position = run.trace.get(axis.name, "position")
    rows = {"the twin, MuJoCo": (spent, 0.0)}
    motion = nominal_motion(machine, setpoints)
    spent, other = seconds(lambda: simulate(machine, setpoints, plant_of=lambda change: DecoupledPlant(change, motion)))
    rows["the twin, decoupled plant"] = (spent, off(other.trace.get(axis.name, "position"), position))

    def in_python() -> None:
        ReferenceSimulation(machine, Setpoints(setpoints.position, setpoints.period), 2 * PYTHON_TICKS).run(0, PYTHON_TICKS)

    spent, _ = seconds(in_python)
    rows["MuJoCo in plain Python"] = (spent * setpoints.duration / (PYTHON_TICKS * machine.base_tick), float("nan"))

    a, b = linear_law(machine)
    delay = axis.loops.set_point_delay_s
    s = setpoints.at(t - delay)[:, 0]
    ds = np.gradient(s, t)
    inputs = np.column_stack([s, ds, np.gradient(ds, t)])
    start = np.array([s[0], 0.0, 0.0, 0.0, 0.0])
    inertia = (axis.moving_mass_kg or 0.0) + axis.rotor_inertia_kg_m2 / axis.ratio**2

    def slope(at: float, state: np.ndarray) -> np.ndarray:
        row = at / setpoints.period
        k = min(int(row), len(t) - 2)
        now = inputs[k] + (row - k) * (inputs[k + 1] - inputs[k])
        rate = a @ state + b @ now
        rate[1] -= axis.coulomb_friction * np.tanh(state[1] / SMOOTH_M_PER_S) / inertia
        return rate

    spent, solved = seconds(lambda: solve_ivp(slope, (t[0], t[-1]), start, method="LSODA", t_eval=t, rtol=1e-6, atol=1e-9))
    rows["solve_ivp (LSODA)"] = (spent, off(solved.y[0], position))
    try:
        import control
    except ImportError:
        return {name: {"seconds": s, "off_um": d} for name, (s, d) in rows.items()}
    system = control.ss(a, b, np.eye(5), np.zeros((5, 3)))
    spent, answer = seconds(lambda: control.forced_response(system, t, inputs.T, start))
    rows["python-control (no friction)"] = (spent, off(answer.outputs[0], position))
    return {name: {"seconds": s, "off_um": d} for name, (s, d) in rows.items()}


def off(position: np.ndarray, reference: np.ndarray) -> float:
    """Largest difference [um]."""
    return float(np.abs(position - reference).max() * 1e6)


def planning() -> dict[str, float]:
    """A polyline of CHORDS: time of the path over that of toppra, which has no jerk limit, and processor times of both [s]."""
    from devtools.measure_interpolator import cam_polyline, over_toppra, written

    machine = load_machine()
    with tempfile.TemporaryDirectory() as folder:
        program = read_program(written(Path(folder), cam_polyline(CHORDS, FEED, False)), machine)
        ours, _ = seconds(lambda: interpolate(program, machine))
        begin = time.process_time()
        ratio, _ = over_toppra(machine, Path(folder), CHORDS, FEED, False)
        both = time.process_time() - begin
    return {"path_time_ratio": ratio, "twin_seconds": ours, "toppra_seconds": both - ours}


def peers() -> dict[str, Any]:
    """All measurements; planning only where toppra is installed."""
    import importlib.util

    machine = load_machine().with_axes([AXIS])
    setpoints = setpoints_of(paper_test(machine), machine)
    found: dict[str, Any] = {"run_s": setpoints.duration, "simulation": simulations(machine, setpoints)}
    if importlib.util.find_spec("toppra"):
        found["planning"] = planning()
    return found


def peers_text(measured: dict[str, Any]) -> str:
    """The measurements as tables."""
    base = measured["simulation"]["the twin, MuJoCo"]["seconds"]
    rows = [
        [name, f"{1e3 * r['seconds']:.1f} ms", f"{r['seconds'] / base:.2f}", "" if np.isnan(r["off_um"]) else f"{r['off_um']:.2f} um"]
        for name, r in measured["simulation"].items()
    ]
    text = f"{measured['run_s']:.2f} s of one axis\n" + table(
        ["simulation", "processor time", "over the twin", "largest difference"], rows, left=1
    )
    if "planning" not in measured:
        return text + "\nplanning: toppra is not installed"
    p = measured["planning"]
    return (
        f"{text}\n\n{CHORDS} chords: time of the path over toppra without jerk limit {p['path_time_ratio']:.3f}; "
        f"processor time {p['twin_seconds']:.2f} s, toppra {p['toppra_seconds']:.2f} s"
    )
