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
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from .compensation import compensation_at_rest, compensation_of
from .compiled import compiled
from .control import W_SENT, control_at_rest, control_values, current_cycle, drive_cycle, position_cycle
from .mechanics import CURRENT, DEAD_TIME_A, QM, STATES, VM, F, Q, V, advance, ahead, mechanics_values, motor_position, motor_speed
from .parameters import AXES, Settings, axis_records, pair_of, sensor_values
from .tilting_pair import holding_torque

SUBSTEPS = 8  # RK4 steps per 125 us tick; errors at 450 Hz contacts and 250 Hz modes stay far below a nanometre
RING = 256  # length of the current history in ticks: 32 ms


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


def machine_of(s: Settings) -> tuple[np.ndarray, np.ndarray]:
    """(records of the axes, sums of the pair) from settings after effects and richness."""
    return axis_records(s, control_values(s) | sensor_values(s) | mechanics_values(s)), pair_of(s.machine, s.factors, s.clamped)


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
def _simulate(m, on, pair, coupling, crosstalk, noise, clock, set_points, state, own, y, out):  # type: ignore[no-untyped-def]
    """The loop over the records `m` of the axes. clock: start of the run after that of the first run [s], tick [s], ticks per position cycle and
    per sample, RK4 steps per tick. set_points [position or feedforward, cycle, axis]; out [signal, sample, axis]: position, motor position,
    speed, speed set point, current, load, true current.

    Returns 0, or 1 + the index of an unstable axis."""
    q0 = y[Q].copy()
    play, z = q0.copy(), np.zeros(5)
    started_at, tick, cycle_ticks, sample_ticks, substeps = clock
    samples = out.shape[1]
    voltage, warm, other = np.zeros(5), np.ones(5), np.zeros(5)
    work = np.zeros((6, STATES, 5))
    ring = np.zeros((RING, 5))
    past = np.zeros((5, int(m.transport.max()) + 2, 3))
    for n in range((samples - 1) * sample_ticks + 1):
        t = n * tick
        row, sampled = n // sample_ticks, n % sample_ticks == 0
        cycle = n % cycle_ticks == 0
        for k in range(5):
            axis = m[k]
            # measure
            shown = motor_position(axis, y[QM, k], q0[k]) + noise.motor[row, k]
            shown = round(shown / axis.motor_step) * axis.motor_step
            in_drive = axis.transport > 0.0
            if sampled or cycle or in_drive:
                q = y[Q, k]
                if axis.scale_play != 0.0:
                    play[k] = min(max(play[k], q - 0.5 * axis.scale_play), q + 0.5 * axis.scale_play)
                    q = play[k]
                x = q + y[F, k] + axis.drift * (started_at + t) + y[V, k] * noise.jitter[row, k]
                if axis.eccentricity != 0.0:
                    x += axis.eccentricity * (math.sin(q + axis.eccentricity_phase) - math.sin(q0[k] + axis.eccentricity_phase))
                if axis.subperiod != 0.0:
                    x += axis.subperiod * (math.sin(axis.subperiod_number * q) - math.sin(axis.subperiod_number * q0[k]))
                for j in range(5):
                    if crosstalk[k, j] != 0.0:
                        x += crosstalk[k, j] * (y[Q, j] - q0[j])
                x += noise.between[n, k] if in_drive and not sampled else noise.scale[row, k]
                x = round(x / axis.scale_step) * axis.scale_step
            w = motor_speed(axis, y[QM, k], y[VM, k]) + noise.speed[n, k]
            current = y[CURRENT, k] + noise.current[n, k]
            # control
            closing = shown if axis.on_motor != 0.0 else x
            if cycle:
                position_cycle(axis, on, state, own, k, set_points[0, n // cycle_ticks, k], set_points[1, n // cycle_ticks, k], closing)
            if in_drive:
                drive_cycle(axis, state, k, n, closing, past)
            voltage[k] = current_cycle(axis, state, k, w, current)
            # record
            ring[n % RING, k] = current
            if sampled:
                out[0, row, k] = x
                out[1, row, k] = shown
                out[2, row, k] = w * axis.ratio
                out[3, row, k] = state[k, W_SENT] * axis.ratio
                out[4, row, k] = ring[max(n - int(axis.skew), 0) % RING, k]
                out[5, row, k] = y[Q, k]
                out[6, row, k] = y[CURRENT, k]
                if not abs(y[V, k]) < 1e3:
                    return 1 + k
            if axis.warming != 0.0:
                warm[k] = 1.0 + axis.warming * (1.0 - math.exp(-(started_at + t) / axis.warming_time))
        if n < (samples - 1) * sample_ticks:
            advance(m, pair, coupling, y, z, other, voltage, warm, q0, t, tick / substeps, substeps, work)
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
    on, (m, pair) = compensation_of(s), machine_of(s)
    on_motor = m["on_motor"] != 0.0
    grid, s_points, commands = _commands(s, np.ascontiguousarray(set_points, dtype=float), set_point_period_s)
    # rest: the encoder in the loop shows the first set point, the drive trains are loaded, the integrators hold the load
    q0 = s_points[0] - np.where(on_motor, 0.0, s.drift * started_at_s)
    hold = m["steady_force"].copy()
    hold[3:] += holding_torque(pair, q0[3], q0[4])
    lead = np.array([_deflection(m[k], hold[k]) - ahead(m[k], q0[k], q0[k]) for k in range(5)])  # of the motor encoder over the load
    q0 = q0 - np.where(on_motor, lead, 0.0)
    y = np.zeros((STATES, 5))
    y[Q] = q0
    y[QM] = q0 + np.where(m["elastic"] != 0.0, lead, 0.0)
    torque = hold * s.ratio / s.kt
    y[CURRENT] = torque / np.sqrt(1.0 - m["saturation"] * torque**2)
    voltage = s.resistance * y[CURRENT] + s.dead_time_v * np.tanh(y[CURRENT] / DEAD_TIME_A)
    state = control_at_rest(m, s_points[0], y[CURRENT], voltage)
    drawn = _noise_of(s, m, np.random.default_rng(seed), len(grid), noise)
    clock = started_at_s, s.tick, s.cycle_ticks, s.sample_ticks, substeps
    out = np.zeros((7, len(grid), 5))
    own = compensation_at_rest(on, commands[0, 0], s_points[0])
    status = _simulate(m, on, pair, s.coupling, s.crosstalk, drawn, clock, commands, state, own, y, out)
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


def _noise_of(s: Settings, m: np.ndarray, rng: np.random.Generator, samples: int, on: bool) -> Noise:
    """One realisation of all noise; jitter, an effect, stays when the noise is off."""
    ticks = (samples - 1) * s.sample_ticks + 1
    scale = rng.standard_normal((samples, 5)) * m["scale_noise"] * on
    jitter = rng.standard_normal((samples, 5)) * s.jitter_s
    speed = rng.standard_normal((ticks, 5)) * (m["speed_noise"] / s.ratio * on)
    current = rng.standard_normal((ticks, 5)) * (m["current_noise"] * on)
    in_drive = bool(s.dsc_delay.any())  # such a drive reads its scale at every tick
    between = rng.standard_normal((ticks, 5)) * m["scale_noise"] * on if in_drive else np.zeros((0, 5))
    motor = rng.standard_normal((samples, 5)) * m["motor_noise"] * on
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


def _deflection(axis: Any, force: float) -> float:
    """Drive-train deflection of an axis record under a steady force, on the loaded flank; centred without force."""
    if axis["elastic"] == 0.0 or force == 0.0:
        return 0.0
    stiffness, hardening, soft = axis["stiffness"], axis["hardening"], axis["soft"]
    load = abs(force) - soft * stiffness * axis["half_gap"]
    if load <= 0.0 and soft > 0.0:
        return force / (soft * stiffness)
    e = load / stiffness
    for _ in range(30):  # Newton on k e + k3 e^3 = load, convex for e > 0
        e -= (stiffness * e + hardening * e**3 - load) / (stiffness + 3 * hardening * e**2)
    return math.copysign(axis["half_gap"] + e, force)
