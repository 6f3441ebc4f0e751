"""The second plant: a five-axis machine with its control, without MuJoCo and with another integrator than the twin.

    s = settings_of(machine, factors); effects and richness change s; run(s, set_points) -> Trace

A tick (125 us): measure -> position controller (every 2 ms) -> speed and current controller -> record -> RK4 to the next tick.
The control uses the same noisy, rounded samples that are recorded: the scale at position cycles, motor speed and current at every
tick. Only this choice reproduces the statistics of the recorded campaigns. A run starts at rest with the encoder that closes the position
loop (the scale, or the motor encoder) at the set point; the
integrators hold gravity, unbalance and constant force, but no friction.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from .compensation import Compensation, compensation_at_rest, compensation_of
from .compiled import compiled
from .control import W_SENT, Control, control_at_rest, control_of, current_cycle, drive_cycle, position_cycle
from .measurement import Sensors, sensors_of
from .mechanics import (
    CURRENT,
    DEAD_TIME_A,
    ELASTIC,
    HALF_GAP,
    HARDENING,
    QM,
    RATIO,
    SATURATION,
    SOFT,
    STATES,
    STEADY_FORCE,
    STIFFNESS,
    VM,
    F,
    Q,
    V,
    advance,
    ahead,
    motor_position,
    motor_speed,
)
from .parameters import AXES, Settings, load_of, pair_of
from .tilting_pair import holding_torque

SUBSTEPS = 8  # RK4 steps per 125 us tick; errors at 450 Hz contacts and 250 Hz modes stay far below a nanometre
RING = 256  # length of the current history in ticks: 32 ms
CONTACT_HZ, CONTACT_DAMPING_RATIO = 450.0, 0.3  # effects.md, default of backlash


class PlantError(RuntimeError):
    """A run or case that cannot be simulated."""


@dataclass(frozen=True)
class Trace:
    """One run, SI, arrays [sample, axis] in order X Y Z A C; `load` and `true_current` are free of noise."""

    time: np.ndarray
    setpoint: np.ndarray
    position: np.ndarray
    motor_position: np.ndarray
    velocity: np.ndarray
    velocity_setpoint: np.ndarray
    current: np.ndarray
    load: np.ndarray
    true_current: np.ndarray


def mechanics_of(s: Settings) -> tuple[np.ndarray, np.ndarray]:
    """(table [row, axis], sums of the pair) from settings after effects and richness; adds the default contact of backlash."""
    pair = pair_of(s.machine, s.factors, s.clamped)
    load_mass = s.load_mass + s.added_mass
    inertia = load_of(s)
    stiffness, damping = s.stiffness.copy(), s.damping.copy()
    for k in np.flatnonzero(s.gap):
        reduced = s.motor_mass[k] * inertia[k] / (s.motor_mass[k] + inertia[k])
        contact = s.contact_stiffness[k] or (2 * math.pi * CONTACT_HZ) ** 2 * reduced
        contact_damping = s.contact_damping[k] or 2 * CONTACT_DAMPING_RATIO * math.sqrt(contact * reduced)
        # gap contact and spring of one axis are in series
        in_series = stiffness[k] > 0.0
        stiffness[k] = 1 / (1 / contact + 1 / stiffness[k]) if in_series else contact
        damping[k] = min(damping[k], contact_damping) if in_series else contact_damping
    stiffness = np.where((s.soft_gap > 0) & (stiffness == 0), (2 * math.pi * 200.0) ** 2 * inertia, stiffness)
    steady = s.constant_force.copy()
    steady[2] += load_mass[2] * s.gravity
    saturation = np.where(s.saturation_a > 0, 1 / np.where(s.saturation_a > 0, s.saturation_a, 1.0) ** 2, 0.0)
    soft_share = np.where(s.soft_gap > 0, s.soft_share, 0.0)
    rows = [  # in the order of the row numbers in mechanics.py
        s.ratio, s.kt, saturation, s.dead_time_v, s.ke, s.resistance, s.inductance,
        s.motor_mass, load_mass,
        (stiffness > 0).astype(float), stiffness, damping, s.hardening * stiffness, (s.gap + s.soft_gap) / 2, soft_share,
        s.viscous, s.asymmetry, s.windage,
        s.coulomb, s.friction_wave, s.friction_wave_number, s.stribeck_excess, s.stribeck_velocity,
        s.presliding_stiffness, s.presliding_damping,
        steady, s.disturbance, s.disturbance_w,
        s.frame_w, s.frame_zeta, s.frame_ratio,
        s.ripple, s.ripple_n, s.ripple_phase, s.cogging, s.cogging_n, s.cogging_phase,
        s.lead, s.cyclic, s.cyclic_phase, np.full(len(s.linear), float(s.zero_kept)),
        s.bed_mass, s.mount_stiffness, s.mount_damping, np.where(s.bed_mass > 0, inertia, 0.0),
    ]  # fmt: skip
    return np.array(rows, dtype=float), pair


class Clock(NamedTuple):
    """Start of the run after that of the first run [s], tick [s], ticks per position cycle and per sample, RK4 steps per tick."""

    started_at: float
    tick: float
    cycle_ticks: int
    sample_ticks: int
    substeps: int


class Noise(NamedTuple):
    """Realisations [sample or tick, axis]: scale at samples and, for drives that close the position loop, between them; motor speed
    and current at ticks; delay of the scale's sampling [s]; motor encoder at samples."""

    scale: np.ndarray
    between: np.ndarray
    speed: np.ndarray
    current: np.ndarray
    jitter: np.ndarray
    motor: np.ndarray


@compiled(allocates=True)
def _simulate(
    c: Control,
    on: Compensation,
    m: np.ndarray,
    pair: np.ndarray,
    coupling: np.ndarray,
    sensors: Sensors,
    noise: Noise,
    clock: Clock,
    warming: np.ndarray,
    set_points: np.ndarray,
    state: np.ndarray,
    own: np.ndarray,
    y: np.ndarray,
    out: np.ndarray,
) -> int:
    """The loop. set_points [position or feedforward, cycle, axis], warming [share or time constant, axis];
    out [signal, sample, axis]: position, motor position, speed, speed set point, current, load, true current.

    Returns 0, or 1 + the index of an unstable axis."""
    q0 = y[Q].copy()
    play, z = q0.copy(), np.zeros(5)
    tick, cycle_ticks, sample_ticks, started_at = clock.tick, clock.cycle_ticks, clock.sample_ticks, clock.started_at
    samples = out.shape[1]
    voltage, warm, other = np.zeros(5), np.ones(5), np.zeros(5)
    work = np.zeros((8, STATES, 5))
    ring = np.zeros((RING, 5))
    past = np.zeros((5, int(c.transport.max()) + 2, 3))
    for n in range((samples - 1) * sample_ticks + 1):
        t = n * tick
        row, sampled = n // sample_ticks, n % sample_ticks == 0
        cycle = n % cycle_ticks == 0
        for k in range(5):
            # measure
            shown = motor_position(m, k, y[QM, k], q0[k]) + noise.motor[row, k]
            shown = round(shown / sensors.motor_step[k]) * sensors.motor_step[k]
            in_drive = c.transport[k] > 0.0
            if sampled or cycle or in_drive:
                q = y[Q, k]
                if sensors.play[k] != 0.0:
                    play[k] = min(max(play[k], q - 0.5 * sensors.play[k]), q + 0.5 * sensors.play[k])
                    q = play[k]
                x = q + y[F, k] + sensors.drift[k] * (started_at + t) + y[V, k] * noise.jitter[row, k]
                if sensors.eccentricity[k] != 0.0:
                    x += sensors.eccentricity[k] * (
                        math.sin(q + sensors.eccentricity_phase[k]) - math.sin(q0[k] + sensors.eccentricity_phase[k])
                    )
                if sensors.subperiod[k] != 0.0:
                    x += sensors.subperiod[k] * (math.sin(sensors.subperiod_number[k] * q) - math.sin(sensors.subperiod_number[k] * q0[k]))
                for j in range(5):
                    if sensors.crosstalk[k, j] != 0.0:
                        x += sensors.crosstalk[k, j] * (y[Q, j] - q0[j])
                x += noise.between[n, k] if in_drive and not sampled else noise.scale[row, k]
                x = round(x / sensors.scale_step[k]) * sensors.scale_step[k]
            w = motor_speed(m, k, y[QM, k], y[VM, k]) + noise.speed[n, k]
            current = y[CURRENT, k] + noise.current[n, k]
            # control
            closing = shown if sensors.on_motor[k] else x
            if cycle:
                position_cycle(c, on, state, own, k, set_points[0, n // cycle_ticks, k], set_points[1, n // cycle_ticks, k], closing)
            if in_drive:
                drive_cycle(c, state, k, n, closing, past)
            voltage[k] = current_cycle(c, state, k, w, current)
            # record
            ring[n % RING, k] = current
            if sampled:
                out[0, row, k] = x
                out[1, row, k] = shown
                out[2, row, k] = w * m[RATIO, k]
                out[3, row, k] = state[k, W_SENT] * m[RATIO, k]
                out[4, row, k] = ring[max(n - sensors.skew[k], 0) % RING, k]
                out[5, row, k] = y[Q, k]
                out[6, row, k] = y[CURRENT, k]
                if not abs(y[V, k]) < 1e3:
                    return 1 + k
            if warming[0, k] != 0.0:
                warm[k] = 1.0 + warming[0, k] * (1.0 - math.exp(-(started_at + t) / warming[1, k]))
        if n < (samples - 1) * sample_ticks:
            advance(m, pair, coupling, y, z, other, voltage, warm, q0, t, tick / clock.substeps, clock.substeps, work)
    return 0


def run(
    s: Settings,
    set_points: np.ndarray,
    seed: int | np.random.SeedSequence = 0,
    started_at_s: float = 0.0,
    substeps: int = SUBSTEPS,
    noise: bool = True,
    set_point_period_s: float | None = None,
) -> Trace:
    """Simulate one run with settings `s` over set points [sample, axis] (SI); returns its Trace at the sample period.

    The run starts `started_at_s` after the first one of its campaign (thermal drift, warming). Equal seeds give equal traces.
    `set_point_period_s` is the period of the set points; None: the sample period."""
    c, on, (m, pair), sensors = control_of(s), compensation_of(s), mechanics_of(s), sensors_of(s)
    grid, s_points, commands = _commands(s, np.ascontiguousarray(set_points, dtype=float), set_point_period_s)
    # rest: the encoder in the loop shows the first set point, the drive trains are loaded, the integrators hold the load
    q0 = s_points[0] - np.where(sensors.on_motor, 0.0, sensors.drift * started_at_s)
    hold = m[STEADY_FORCE].copy()
    hold[3:] += holding_torque(pair, q0[3], q0[4])
    lead = np.array([_deflection(m, k, hold[k]) - ahead(m, k, q0[k], q0[k]) for k in range(5)])  # of the motor encoder over the load
    q0 = q0 - np.where(sensors.on_motor, lead, 0.0)
    y = np.zeros((STATES, 5))
    y[Q] = q0
    y[QM] = q0 + np.where(m[ELASTIC] != 0.0, lead, 0.0)
    torque = hold * s.ratio / s.kt
    y[CURRENT] = torque / np.sqrt(1.0 - m[SATURATION] * torque**2)
    voltage = s.resistance * y[CURRENT] + s.dead_time_v * np.tanh(y[CURRENT] / DEAD_TIME_A)
    state = control_at_rest(c, s_points[0], y[CURRENT], voltage)
    drawn = _noise_of(s, sensors, np.random.default_rng(seed), len(grid), noise)
    clock = Clock(started_at_s, s.tick, s.cycle_ticks, s.sample_ticks, substeps)
    warming = np.array([s.warming, np.where(s.warming_time > 0, s.warming_time, 1.0)])
    out = np.zeros((7, len(grid), 5))
    own = compensation_at_rest(on, commands[0, 0], s_points[0])
    status = _simulate(c, on, m, pair, s.coupling, sensors, drawn, clock, warming, commands, state, own, y, out)
    if status:
        raise PlantError(f"axis {AXES[status - 1]} is unstable (speed above 1000 m/s or rad/s, or not a number): choose a smaller effect")
    return Trace(grid, s_points, *out)


def _commands(s: Settings, given: np.ndarray, given_period: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(sample times, set points at them, delayed set points [position or feedforward, cycle, axis]), by cubic splines."""
    period, cycle = s.tick * s.sample_ticks, s.tick * s.cycle_ticks
    given_at = np.arange(len(given)) * (given_period or period)
    samples = len(given) if given_period is None else math.floor(given_at[-1] / period + 1e-6) + 1
    grid = np.arange(samples) * period
    points = given
    if given_period is not None:
        points = np.column_stack([_delayed(given_at, given[:, k], grid, 0.0) for k in range(5)])
    cycles = np.arange(((samples - 1) * s.sample_ticks) // s.cycle_ticks + 1) * cycle
    at = _on_straight_lines if s.straight_set_points else _delayed
    delays = (s.position_delay, s.feedforward_delay)
    delayed = [np.column_stack([at(given_at, given[:, k], cycles, delay[k]) for k in range(5)]) for delay in delays]
    return grid, points, np.array(delayed)


def _noise_of(s: Settings, sensors: Sensors, rng: np.random.Generator, samples: int, on: bool) -> Noise:
    """One realisation of all noise; jitter, an effect, stays when the noise is off."""
    ticks = (samples - 1) * s.sample_ticks + 1
    scale = rng.standard_normal((samples, 5)) * sensors.scale_noise * on
    jitter = rng.standard_normal((samples, 5)) * s.jitter_s
    speed = rng.standard_normal((ticks, 5)) * (sensors.speed_noise / s.ratio * on)
    current = rng.standard_normal((ticks, 5)) * (sensors.current_noise * on)
    in_drive = bool(s.dsc_delay.any())  # such a drive reads its scale at every tick
    between = rng.standard_normal((ticks, 5)) * sensors.scale_noise * on if in_drive else np.zeros((0, 5))
    motor = rng.standard_normal((samples, 5)) * sensors.motor_noise * on
    return Noise(scale, between, speed, current, jitter, motor)


def _delayed(grid: np.ndarray, values: np.ndarray, cycles: np.ndarray, delay: float) -> np.ndarray:
    """values(cycles - delay) by a cubic spline; the first value before the start."""
    at = np.clip(cycles - delay, grid[0], grid[-1])
    if np.ptp(values) == 0.0:
        return np.full(len(at), values[0])
    return CubicSpline(grid, values)(at)


def _on_straight_lines(grid: np.ndarray, values: np.ndarray, cycles: np.ndarray, delay: float) -> np.ndarray:
    """values(cycles - delay), interpolated linearly between the values at the control's cycles."""
    return np.interp(cycles - delay, cycles, _delayed(grid, values, cycles, 0.0))


def _deflection(m: np.ndarray, k: int, force: float) -> float:
    """Drive-train deflection under a steady force, on the loaded flank; centred without force."""
    if m[ELASTIC, k] == 0.0 or force == 0.0:
        return 0.0
    inside = m[SOFT, k] * m[STIFFNESS, k] * m[HALF_GAP, k]
    load = abs(force) - inside
    if load <= 0.0 and m[SOFT, k] > 0.0:
        return force / (m[SOFT, k] * m[STIFFNESS, k])
    e = load / m[STIFFNESS, k]
    for _ in range(30):  # Newton on k e + k3 e^3 = load, convex for e > 0
        e -= (m[STIFFNESS, k] * e + m[HARDENING, k] * e**3 - load) / (m[STIFFNESS, k] + 3 * m[HARDENING, k] * e**2)
    return math.copysign(m[HALF_GAP, k] + e, force)
