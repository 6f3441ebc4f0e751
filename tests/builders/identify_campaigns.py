"""Small campaigns of one axis for the tests of the identification: simulated with noise, with faults put in by hand."""

from __future__ import annotations

from collections.abc import Sequence
import copy
from dataclasses import replace
from pathlib import Path

import numpy as np

from twin.geometry.scurve import jerk_limited_move, sample_times, time_of_move
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

PERIOD = 1e-3


def move(distance: float, speed: float, acceleration: float, jerk: float, period: float) -> np.ndarray:
    """Jerk-limited rest-to-rest move from 0 (sample,)."""
    lasts = time_of_move(distance, speed, acceleration, jerk)
    return jerk_limited_move(distance, speed, acceleration, jerk, sample_times(lasts, period))


def path(
    targets: Sequence[float], speeds: Sequence[float], acceleration: float = 2.0, jerk: float = 5.0, dwell: float = 0.12
) -> np.ndarray:
    """Rest-to-rest moves from 0 with dwells (sample,) [m]."""
    at, parts = 0.0, [np.zeros(round(dwell / PERIOD))]
    for target, speed in zip(targets, speeds):
        parts += [at + move(target - at, speed, acceleration, jerk, PERIOD)[1:], np.full(round(dwell / PERIOD), target)]
        at = target
    return np.concatenate(parts)


LADDER = path([0.02, -0.02, 0.05, -0.05, 0.12, -0.12, 0.2, -0.2, 0.0], [0.02, 0.02, 0.06, 0.06, 0.15, 0.15, 0.3, 0.3, 0.3])
QUICK = path([0.1, -0.1, 0.1, -0.1, 0.0], [0.3] * 5)
SHORT_LADDER = path(
    [0.01, -0.01, 0.03, -0.03, 0.07, -0.07, 0.12, -0.12, 0.0], [0.02, 0.02, 0.06, 0.06, 0.15, 0.15, 0.3, 0.3, 0.3], dwell=0.08
)
SHORT_QUICK = path([0.08, -0.08, 0.08, 0.0], [0.3] * 4)
ONE_WAY = path([0.05, 0.2, 0.34], [0.05, 0.15, 0.25])


def recorded(machine: Machine, name: str, points: np.ndarray, feedforward: str, seed: int) -> MeasuredRun:
    """One run of the first axis, as a control would record it: with noise, only the signals that a control has."""
    column = np.zeros((len(points), len(machine.axes)))
    column[:, 0] = points
    trace = simulate(machine.with_feedforward(feedforward), Setpoints(column, PERIOD), noise_seed=seed).trace
    kept = ("setpoint", "position", "motor_position", "velocity", "velocity_setpoint", "current")
    signals = {k: v for k, v in trace.signals.items() if k[1] in kept}
    return MeasuredRun(name, Trace(trace.time, signals, trace.kinds), feedforward, 0.0)


def campaign(runs: Sequence[MeasuredRun]) -> Campaign:
    return Campaign(Path("campaign"), "test", tuple(runs))


def usual_runs(machine: Machine, seed: int = 0, *, short: bool = False) -> list[MeasuredRun]:
    """Constant speeds, and accelerations with and without feedforward; `short` is two thirds of the time, for faults that any record shows."""
    ladder, quick = (SHORT_LADDER, SHORT_QUICK) if short else (LADDER, QUICK)
    return [
        recorded(machine, "speeds", ladder, "velocity", seed),
        recorded(machine, "quick_off", quick, "off", seed + 1),
        recorded(machine, "quick", quick, "velocity+torque", seed + 2),
    ]


def with_signal(run: MeasuredRun, axis: str, signal: str, values: np.ndarray | None) -> MeasuredRun:
    """The run with one signal replaced, or without it."""
    signals = {k: v for k, v in run.trace.signals.items() if k != (axis, signal)}
    if values is not None:
        signals[axis, signal] = values
    return replace(run, trace=Trace(run.trace.time, signals, run.trace.kinds))


def on_a_linear_motor(machine: Machine, name: str = "X") -> Machine:
    """The machine with the same moving axis on a linear motor: no screw, no rotor, and no commissioned mass in the file."""
    old = machine.axis(name)
    table = copy.deepcopy(machine.document["axis"][name])
    r, motor, loops = old.ratio, old.motor, table["loops"]
    mass = (old.moving_mass_kg or 0.0) + old.reflected_inertia
    for key in (
        "screw_lead_m_per_rev",
        "rotor_and_screw_inertia_kg_m2",
        "coulomb_friction_nm",
        "viscous_friction_nm_s_per_rad",
        "commissioned",
    ):
        del table[key]
    del loops["speed_gain_nm_s_per_rad"]
    table |= {"drive": "direct", "moving_mass_kg": mass}
    table |= {"coulomb_friction_n": old.coulomb_friction, "viscous_friction_n_s_per_m": old.viscous_friction}
    table["motor"] = {
        "force_constant_n_per_a": motor.torque_constant_nm_per_a / r, "back_emf_v_s_per_m": motor.back_emf_v_s_per_rad / r,
        "resistance_ohm": motor.resistance_ohm, "inductance_h": motor.inductance_h, "peak_current_a": motor.peak_current_a,
        "bus_limit_v": motor.bus_limit_v,
    }  # fmt: skip
    loops["speed_gain_n_s_per_m"] = old.loops.speed_gain_nm_s_per_rad / r**2
    document = {**machine.document, "axis": {**machine.document["axis"], name: table}}
    return Machine(document, machine.model_path, machine.path)
