"""Reference implementation: the control law in plain numpy, and a Python loop over `mujoco.mj_step`.

Implemented from the law (docs/theory.md), not from the compiled kernels; slow, for tests and for the benchmark. All arrays
are (axis,) in the machine's order; `r` is axis units per motor radian.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from twin.machine.machine import Machine
from twin.simulation.plant_spec import build_plant, home_inertia_at_motor
from twin.simulation.setpoints import Setpoints

CHANNELS = ("position", "velocity", "velocity_setpoint", "current", "current_setpoint", "voltage", "drive_velocity_setpoint")

BEFORE_CYCLES = 4
"""Position cycles at the first set point before the start, for delayed set points."""


@dataclass
class ReferenceCascade:
    """All drives of a machine; the attributes are the symbols of the law."""

    machine: Machine
    held_torque: np.ndarray  # Nm at the motor, what the integrators carry at rest
    w_NC: np.ndarray = field(init=False)  # speed set point as the NC computes it, rad/s
    T_NC: np.ndarray = field(init=False)  # torque feedforward as the NC computes it, Nm
    w_star: np.ndarray = field(init=False)  # speed set point active in the drive, rad/s
    T_ff: np.ndarray = field(init=False)  # torque feedforward active in the drive, Nm
    sent: list[np.ndarray] = field(init=False)  # (w_NC, T_NC, x) at the speed cycles so far
    I: np.ndarray = field(init=False)  # noqa: E741  integrator of the speed loop, Nm
    i_star: np.ndarray = field(init=False)  # current set point, A
    I_i: np.ndarray = field(init=False)  # integrator of the current loop, V
    u: np.ndarray = field(init=False)  # voltage, V
    i: np.ndarray = field(init=False)  # current, A; without current loop the command
    w_seen: np.ndarray = field(init=False)  # speed that the speed controller sees, rad/s
    q_seen: list[np.ndarray] = field(init=False)  # motor encoder at the speed cycles so far, axis units

    def __post_init__(self) -> None:
        axes, loops = self.machine.axes, [axis.loops for axis in self.machine.axes]
        motors = [axis.motor for axis in axes]

        def column(values: list[float | None]) -> np.ndarray:
            return np.array(values, float)

        self.r = column([axis.ratio for axis in axes])
        self.Kv = column([p.position_gain_per_s for p in loops])
        self.Kp = column([p.speed_gain_nm_s_per_rad for p in loops])
        self.Tn = column([p.speed_integral_time_s for p in loops])
        self.Kpi = column([p.current_gain_v_per_a for p in loops])
        self.Tni = column([p.current_integral_time_s for p in loops])
        self.R = column([m.resistance_ohm for m in motors])
        self.L = column([m.inductance_h for m in motors])
        self.Ke = column([m.back_emf_v_s_per_rad for m in motors])
        self.Kt = column([m.torque_constant_nm_per_a for m in motors])
        self.control_Kt = column([axis.commissioned_torque_constant for axis in axes])
        self.i_peak = column([m.peak_current_a for m in motors])
        self.u_bus = column([m.bus_limit_v for m in motors])
        self.has_loop = np.array([axis.structure == "P/PI/PI" for axis in axes])
        self.n = [p.speed_mean_cycles for p in loops]
        self.Td = column([p.dsc_delay_s for p in loops])
        self.T_i = column([p.actuator_lag_s for p in loops])
        self.T_w = column([p.speed_filter_time_s for p in loops])
        self.T_r = column([p.speed_reference_time_s for p in loops])
        # at rest: the motors hold the axes
        self.i = self.held_torque / self.Kt
        self.i_star = self.i.copy()
        self.I = np.where(np.isfinite(self.Tn), self.i * self.control_Kt, 0.0)
        self.w_r = np.zeros(len(axes))
        self.w_seen, self.q_seen = np.zeros(len(axes)), []
        self.I_i = self.R * self.i
        self.u = self.R * self.i
        self.w_star, self.T_ff = np.zeros(len(axes)), np.zeros(len(axes))
        self.w_NC, self.T_NC, self.sent = self.w_star, self.T_ff, []

    def position_cycle(self, s: np.ndarray, velocity: np.ndarray, torque: np.ndarray, x: np.ndarray) -> None:
        """w* = (Kv (s - x) + feedforward) / r."""
        self.w_NC = (self.Kv * (s - x) + velocity) / self.r
        self.T_NC = torque

    def drive(self, x: np.ndarray) -> None:
        """w*(T) = w_NC(T - Td) - Kv (x(T) - x(T - Td)) / r and T_ff(T) = T_NC(T - Td), linear between speed cycles.

        Td = 0 is w* = w_NC: the NC closes the loop.
        """
        Ts = self.machine.speed_cycle
        self.sent.append(np.array([self.w_NC, self.T_NC, x]))
        now = len(self.sent) - 1
        cycles = np.arange(max(0, now - int(self.Td.max() / Ts) - 2), now + 1)
        w, T, earlier = (
            np.array([np.interp(now - d / Ts, cycles, [self.sent[c][row, a] for c in cycles]) for a, d in enumerate(self.Td)])
            for row in range(3)
        )
        self.w_star = w - self.Kv * (x - earlier) / self.r
        self.T_ff = T

    def speed_cycle(self, w: np.ndarray, q: np.ndarray) -> None:
        """T* = Kp e + I + T_ff; i* limited; the integrator holds at the limit (anti-windup).

        w as measured, or (q(k) - q(k-n)) / (n Ts); optionally filtered by a first-order lag.
        """
        Ts = self.machine.speed_cycle
        self.q_seen.append(q)
        w = w.copy()
        for a, n in enumerate(self.n):
            if n:
                w[a] = (q[a] - self.q_seen[max(len(self.q_seen) - 1 - n, 0)][a]) / (n * Ts) / self.r[a]
        lagged = self.T_w > 0.0
        share = 1.0 - np.exp(-Ts / np.where(lagged, self.T_w, 1.0))
        self.w_seen = np.where(lagged, self.w_seen + share * (w - self.w_seen), w)
        e = self.w_star - self.w_seen
        modelled = self.T_r > 0.0
        share = 1.0 - np.exp(-Ts / np.where(modelled, self.T_r, 1.0))
        self.w_r = np.where(modelled, self.w_r + share * (self.w_star - self.w_r), self.w_star)
        unlimited = (self.Kp * e + self.I + self.T_ff) / self.control_Kt
        self.i_star = np.clip(unlimited, -self.i_peak, self.i_peak)
        free = np.abs(unlimited) <= self.i_peak
        self.I = np.where(free, self.I + self.Kp * self.machine.speed_cycle / self.Tn * (self.w_r - self.w_seen), self.I)

    def current_cycle(self) -> None:
        """u = Kpi e + I_i; u limited; the integrator holds at the limit (anti-windup). Without current loop and lag i = i*."""
        self.i = np.where(self.has_loop | (self.T_i > 0.0), self.i, self.i_star)
        e = self.i_star - self.i
        unlimited = self.Kpi * e + self.I_i
        self.u = np.clip(unlimited, -self.u_bus, self.u_bus)
        free = np.abs(unlimited) <= self.u_bus
        self.I_i = np.where(free, self.I_i + self.Kpi * self.machine.current_cycle / self.Tni * e, self.I_i)

    def winding(self, w: np.ndarray, h: float) -> np.ndarray:
        """L di/dt = u - R i - Ke w over h at constant u and w, T di/dt = i* - i without a current loop; returns the mean current, which gives the torque."""
        steady = np.where(self.has_loop, (self.u - self.Ke * w) / self.R, self.i_star)
        rate = np.where(self.has_loop, self.R / self.L, 1.0 / np.where(self.T_i > 0.0, self.T_i, np.inf))
        before = self.i
        after = steady + (before - steady) * np.exp(-rate * h)
        follows = self.has_loop | (self.T_i > 0.0)
        self.i = np.where(follows, after, before)
        return np.where(follows, steady + (before - after) / np.where(follows, rate * h, 1.0), before)


def commands(machine: Machine, setpoints: Setpoints, cycles: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Delayed set point, velocity feedforward and torque feedforward, each (cycle, axis), from one spline over all samples."""
    tp = machine.position_cycle
    t = np.arange(cycles) * tp
    samples = np.arange(len(setpoints.position)) * setpoints.period
    out = np.zeros((3, cycles, len(machine.axes)))
    home = home_inertia_at_motor(machine)
    for a, axis in enumerate(machine.axes):
        spline = CubicSpline(samples, setpoints.position[:, a], bc_type="natural")

        def s(times: np.ndarray, spline: CubicSpline = spline) -> np.ndarray:
            if machine.setpoint_interpolation == "linear":  # between NC samples at position cycles
                grid = np.arange(-BEFORE_CYCLES, cycles) * tp
                return np.interp(times, grid, spline(np.clip(grid, samples[0], samples[-1])))
            return np.asarray(spline(np.clip(times, samples[0], samples[-1])))

        p = axis.loops
        now, before, earlier = (s(t - p.feedforward_delay_s - back * tp) for back in range(3))
        inertia = home[a] if axis.commissioned_inertia is None else axis.commissioned_inertia
        out[0, :, a] = s(t - p.position_delay_s)
        out[1, :, a] = p.velocity_feedforward * (now - before) / tp
        out[2, :, a] = (p.torque_feedforward + p.drive_torque_feedforward) * inertia * (now - 2.0 * before + earlier) / tp**2 / axis.ratio
    return out[0], out[1], out[2]


class ReferenceSimulation:
    """A machine without effects and noise, one Python call per tick; state of the engine in `plant.data`."""

    def __init__(self, machine: Machine, setpoints: Setpoints, ticks: int) -> None:
        self.machine = machine
        self.plant = build_plant(machine)
        self.h = machine.base_tick
        self.every = [round(cycle / self.h) for cycle in (machine.position_cycle, machine.speed_cycle, machine.current_cycle)]
        self.command = commands(machine, setpoints, -(-ticks // self.every[0]))
        data = self.plant.data
        data.qpos[self.plant.load_position] = setpoints.position[0]
        mujoco.mj_forward(self.plant.model, data)
        ratio = np.array([axis.ratio for axis in machine.axes])
        self.cascade = c = ReferenceCascade(machine, data.qfrc_bias[self.plant.load_dof] * ratio)
        # a P speed controller holds with a following error
        sag = np.where(np.isfinite(c.Tn), 0.0, c.held_torque * ratio / (c.Kp * c.Kv))
        data.qpos[self.plant.load_position] -= sag
        self.record = np.zeros((ticks, len(machine.axes), len(CHANNELS)))

    def run(self, first: int, ticks: int) -> None:
        """Advance by `ticks` ticks and record each."""
        plant, c, h = self.plant, self.cascade, self.h
        model, data = plant.model, plant.data
        position_every, speed_every, current_every = self.every
        for k in range(first, first + ticks):
            v = data.qvel[plant.load_dof]
            x = data.qpos[plant.load_position] - 0.5 * h * v  # MuJoCo's positions lead by half a step
            w = v / c.r
            if k % position_every == 0:
                cycle = k // position_every
                c.position_cycle(self.command[0][cycle], self.command[1][cycle], self.command[2][cycle], x)
            if k % speed_every == 0:
                c.drive(x)
                c.speed_cycle(w, x)
            if k % current_every == 0:
                c.current_cycle()
            for channel, values in enumerate((x, v, c.w_NC * c.r, c.i, c.i_star, c.u, c.w_star * c.r)):
                self.record[k, :, channel] = values
            data.ctrl[plant.actuator] = c.Kt * c.winding(w, h)
            mujoco.mj_step(model, data)


def simulate_reference(machine: Machine, setpoints: Setpoints, ticks: int) -> np.ndarray:
    """Record (tick, axis, channel) of CHANNELS, SI, from rest at the first set point."""
    simulation = ReferenceSimulation(machine, setpoints, ticks)
    simulation.run(0, ticks)
    return simulation.record
