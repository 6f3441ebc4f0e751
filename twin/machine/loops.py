"""The loops of an axis as linear sampled systems: open and closed frequency response, margins, bandwidth.

Each controller samples at its own cycle T and holds its output; the motor moves in continuous time between samples. Let
the plant of a loop be x(k+1) = A x(k) + B u(k), y(k) = C x(k) over one of its cycles (exact: a matrix exponential over the
fastest cycle, then powers). With its controller included, e -> y is the open loop:

    L(z) = C (z I - A)^-1 B,   closed = L / (1 + L),   z = exp(j w T)

    current    u = Kpi e + I                                       winding and free rotor
    speed      i* = (Kp e + I) / Kt                                closed current loop, rotor (and load behind a spring), filtered speed
    position   w* = Kv e / r                                       closed speed loop, encoder

With DSC (`dsc_delay_s` = Td; m speed cycles in a position cycle) the drive closes the position loop at every speed cycle. Its law
w* = w*_NC(T - Td) - Kv (x(T) - x(T - Td)) / r takes x at each speed cycle, while w*_NC holds x for a position cycle. So

L(z) = Kv P(z) (1 - z^-(Td/Ts) (1 - (1 + z^-1 + ... + z^-(m-1)) / m))

This is exact except for aliasing by sampling at the position cycle. Td itself costs no phase in the loop.

Friction is viscous here, the inertia is that of the home pose, and limits are not reached. The spring is that of `transmission_compliance`.
"""

from __future__ import annotations

import cmath
from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from scipy.linalg import block_diag, expm
from scipy.optimize import brentq, minimize_scalar

from twin.effects import load_inertia, settings_of
from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.simulation.plant_spec import home_inertia_at_motor

GRID = 3000
LOWEST_HZ = 0.05
STABLE = 1.0 + 1e-9
"""Largest radius of the poles of a stable closed loop. A viscous axis at rest without an integral part has a pole on the unit circle."""


@dataclass(frozen=True)
class Loop:
    """An open loop x+ = a x + b e, y = c x with sample `period` [s]; `name`: current, speed or position."""

    name: str
    period: float
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    def open_response(self, frequency: np.ndarray) -> np.ndarray:
        """L at frequencies [Hz] (frequency,), complex."""
        z = np.exp(2j * np.pi * np.atleast_1d(frequency) * self.period)
        matrices = z[:, None, None] * np.eye(len(self.a)) - self.a
        states = np.linalg.solve(matrices, np.broadcast_to(self.b.astype(complex), (len(z), *self.b.shape)))
        return np.asarray((self.c @ states)[:, 0, 0])

    def closed_response(self, frequency: np.ndarray) -> np.ndarray:
        """L / (1 + L) at frequencies [Hz]."""
        response = self.open_response(frequency)
        return response / (1.0 + response)

    @property
    def is_stable(self) -> bool:
        """True if all poles of the closed loop lie inside the unit circle."""
        return bool(np.abs(np.linalg.eigvals(self.a - self.b @ self.c)).max() < STABLE)

    def grid(self, count: int = GRID) -> np.ndarray:
        """Frequencies [Hz] up to half the sampling rate: `count` logarithmic ones, and those of the open loop's poles."""
        even = np.geomspace(min(LOWEST_HZ, 1e-3 / self.period), 0.5 / self.period * (1.0 - 1e-6), count)
        # a resonance may be narrower than the steps, so its frequency is added
        own = np.abs(np.angle(np.linalg.eigvals(self.a))) / (2.0 * np.pi * self.period)
        return np.union1d(even, own[(own > even[0]) & (own < even[-1])])


@dataclass(frozen=True)
class Margins:
    """Margins of a loop: gain [1] at the phase crossing, phase [deg] at the gain crossover, both frequencies [Hz]; inf if there is none.

    `bandwidth` [Hz]: where the closed loop first falls to -3 dB. `peak`: its largest gain [1].
    """

    gain: float
    phase_crossing: float
    phase: float
    crossover: float
    bandwidth: float
    peak: float
    stable: bool


ZERO_GAIN = 1e-300
"""A loop gain below this counts as zero."""


def margins_of(loop: Loop, count: int = GRID) -> Margins:
    """Margins, located on a grid of `count` frequencies and refined. Of several crossings the one with the smallest margin counts."""
    f = loop.grid(count)
    response = loop.open_response(f)
    crossovers = [
        _refined(lambda x: math.log(abs(_at(loop, x))), f[i], f[i + 1])
        for i in _sign_changes(np.log(np.maximum(np.abs(response), ZERO_GAIN)))
    ]
    # the imaginary part changes sign on the negative real axis
    turns = [i for i in _sign_changes(response.imag) if response[i].real < 0.0 and response[i + 1].real < 0.0]
    crossings = [_refined(lambda x: _at(loop, x).imag, f[i], f[i + 1]) for i in turns]
    if response[-1].real < 0.0:
        crossings.append(0.5 / loop.period)  # at half the sampling rate L is real
    phases = [(math.degrees(np.angle(-_at(loop, x))), x) for x in crossovers]
    gains = [(1.0 / size, x) for x in crossings if (size := abs(_at(loop, x))) > ZERO_GAIN]
    phase, crossover = min(phases, key=lambda p: abs(p[0])) if phases else (math.inf, math.inf)
    gain, phase_crossing = min(gains, key=lambda g: abs(math.log(g[0]))) if gains else (math.inf, math.inf)
    closed = np.abs(response / (1.0 + response))
    return Margins(
        float(gain), float(phase_crossing), float(phase), float(crossover), _bandwidth(loop, f, closed), float(closed.max()), loop.is_stable
    )


def loops_of(machine: Machine, axis: Axis, inertia: float | None = None) -> list[Loop]:
    """The loops of an axis, innermost first. `inertia` [kg m2 at the motor] defaults to the model's in the home pose."""
    for fast, slow, what in (
        (machine.current_cycle, machine.speed_cycle, "speed_cycle_us is not a multiple of current_cycle_us"),
        (machine.speed_cycle, machine.position_cycle, "position_cycle_us is not a multiple of speed_cycle_us"),
    ):
        if abs(slow / fast - round(slow / fast)) > 1e-6 or slow < fast * (1.0 - 1e-6):
            raise InputError(f"machine {machine.name}: {what}; the loops cannot be nested: change the cycles")
    total = float(home_inertia_at_motor(machine)[machine.axis_names.index(axis.name)]) if inertia is None else inertia
    a, b, speed, motor, load = _mechanics(machine, axis, total)
    commissioned = axis.commissioned_torque_constant
    loops = []
    if axis.has_current_loop:
        a, b, c = _winding(axis, a, b, speed)
        a, b = _sampled(a, b, machine.current_cycle)
        current = _with_controller(
            "current",
            machine.current_cycle,
            (a, b, c),
            axis.loops.current_gain_v_per_a,
            axis.loops.current_gain_v_per_a * machine.current_cycle / axis.loops.current_integral_time_s,
        )
        loops.append(current)
        a, b = _closed(current)
        speed, motor, load = (_padded(row, len(a)) for row in (np.insert(speed, 0, 0.0), np.insert(motor, 0, 0.0), np.insert(load, 0, 0.0)))
        a, b = _held(a, b, round(machine.speed_cycle / machine.current_cycle))
    else:
        a, b = _sampled(a, b * axis.motor.torque_constant_nm_per_a, machine.speed_cycle)
    a, b, seen = _with_seen_speed(axis, machine.speed_cycle, a, b, speed, motor)
    motor, load = _padded(motor, len(a)), _padded(load, len(a))
    gain = axis.loops.speed_gain_nm_s_per_rad / commissioned
    integral = gain * machine.speed_cycle / axis.loops.speed_integral_time_s
    inner = _with_controller("speed", machine.speed_cycle, (a, b, seen[None]), gain, integral)
    loops.append(inner)
    a, b = _closed(inner)
    if integral > 0.0 and axis.loops.speed_reference_time_s > 0.0:
        a, b = _with_reference_model(a, b, integral, -math.expm1(-machine.speed_cycle / axis.loops.speed_reference_time_s))
    position = _padded(motor if axis.encoder == "motor" else load, len(a))
    cycles = round(machine.position_cycle / machine.speed_cycle)
    if axis.loops.dsc_delay_s > 0.0:
        a, b, row = _closed_in_drive(axis.loops.dsc_delay_s / machine.speed_cycle, cycles, a, b, position)
        loops.append(Loop("position", machine.speed_cycle, a, b * axis.loops.position_gain_per_s, row[None]))
        return loops
    a, b = _held(a, b, cycles)
    loops.append(Loop("position", machine.position_cycle, a, b * axis.loops.position_gain_per_s, position[None]))
    return loops


def _closed_in_drive(
    delay: float, cycles: int, a: np.ndarray, b: np.ndarray, position: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The plant, extended by past encoder values, and the row that the drive's position loop sees. `delay`, `cycles` in speed cycles."""
    weights = np.zeros(math.ceil(delay) + cycles + 1)  # of the encoder values, newest first
    weights[0] = 1.0
    whole = math.floor(delay)
    for late, part in ((whole, 1.0 - (delay - whole)), (whole + 1, delay - whole)):
        if part > 0.0:
            weights[late] -= part
            weights[late : late + cycles] += part / cycles
    size, last = len(a), len(weights) - 1
    a = block_diag(a, np.zeros((last, last)))
    a[size, :size] = position
    for i in range(1, last):
        a[size + i, size + i - 1] = 1.0
    return a, np.vstack([b, np.zeros((last, 1))]), np.concatenate([weights[0] * position, weights[1:]])


def first_mode(machine: Machine, axis: Axis) -> float | None:
    """Natural frequency [Hz] of the load on its spring with the motor held; None if the file has no compliance."""
    stiffness = _spring(machine, axis)
    return None if stiffness is None else math.sqrt(stiffness[0] / load_inertia(machine, axis)) / (2.0 * math.pi)


def _spring(machine: Machine, axis: Axis) -> tuple[float, float] | None:
    """Stiffness and damping between motor and load, at the axis; None if the file has no compliance."""
    from twin.effects.change import apply_effects

    if not any(s.axis == axis.name and s.effect.normal == "elasticity" and not s.is_nil for s in settings_of(machine)):
        return None
    coupling = apply_effects(machine).couplings.get(axis.name)
    return None if coupling is None else (coupling.stiffness, coupling.damping)


def _mechanics(machine: Machine, axis: Axis, inertia: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Mechanics at the motor, from torque to speed, motor angle and load angle: a, b and the three rows."""
    damping = axis.viscous_friction_nm_s_per_rad
    spring = _spring(machine, axis)
    if spring is None:
        a = np.array([[-damping / inertia, 0.0], [1.0, 0.0]])
        return a, np.array([[1.0 / inertia], [0.0]]), np.array([1.0, 0.0]), np.array([0.0, 1.0]), np.array([0.0, 1.0])
    k, d = (value * axis.ratio**2 for value in spring)
    rotor = axis.rotor_inertia_kg_m2
    load = inertia - rotor
    # states: speeds of rotor and load, then their angles
    a = np.array(
        [
            [-d / rotor, d / rotor, -k / rotor, k / rotor],
            [d / load, -(d + damping) / load, k / load, -k / load],
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
        ]
    )
    rows = np.eye(4)
    return a, np.array([[1.0 / rotor], [0.0], [0.0], [0.0]]), rows[0], rows[2], rows[3]


def _winding(axis: Axis, a: np.ndarray, b: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The mechanics with the winding in front, from voltage to current. The current is the first state."""
    motor = axis.motor
    n = len(a) + 1
    wide = np.zeros((n, n))
    wide[0, 0] = -motor.resistance_ohm / motor.inductance_h
    wide[0, 1:] = -motor.back_emf_v_s_per_rad / motor.inductance_h * speed
    wide[1:, 1:] = a
    wide[1:, :1] = b * motor.torque_constant_nm_per_a
    voltage = np.zeros((n, 1))
    voltage[0] = 1.0 / motor.inductance_h
    return wide, voltage, np.eye(n)[:1]


def _sampled(a: np.ndarray, b: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Discretise with a zero-order hold over a period."""
    n = len(a)
    wide = np.zeros((n + 1, n + 1))
    wide[:n, :n], wide[:n, n:] = a, b
    step = expm(wide * period)
    return step[:n, :n], step[:n, n:]


def _held(a: np.ndarray, b: np.ndarray, cycles: int) -> tuple[np.ndarray, np.ndarray]:
    """The plant over several cycles with constant input."""
    total = b.copy()
    power = np.eye(len(a))
    for _ in range(cycles - 1):
        power = a @ power
        total = total + power @ b
    return a @ power, total


def _with_controller(name: str, period: float, plant: tuple[np.ndarray, np.ndarray, np.ndarray], gain: float, integral: float) -> Loop:
    """A plant with a P or PI controller: u = gain e + I, I+ = I + integral e."""
    a, b, c = plant
    if integral == 0.0:
        return Loop(name, period, a, gain * b, c)
    n = len(a)
    wide = block_diag(a, 1.0)
    wide[:n, n:] = b
    return Loop(name, period, wide, np.vstack([gain * b, [[integral]]]), np.hstack([c, [[0.0]]]))


def _closed(loop: Loop) -> tuple[np.ndarray, np.ndarray]:
    """The closed loop, from set point to state."""
    return loop.a - loop.b @ loop.c, loop.b


def _with_reference_model(a: np.ndarray, b: np.ndarray, integral: float, share: float) -> tuple[np.ndarray, np.ndarray]:
    """A closed speed loop whose integrator (the last state) sees the set point through a lag w_r += share (w* - w_r)."""
    into = np.zeros((len(a), 1))
    into[-1] = integral
    wide = block_diag(a, 1.0 - share)
    wide[: len(a), len(a) :] = into * (1.0 - share)
    return wide, np.vstack([b + into * (share - 1.0), [[share]]])


def _with_seen_speed(
    axis: Axis, period: float, a: np.ndarray, b: np.ndarray, speed: np.ndarray, motor: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The plant and the row of the speed that the controller sees: measured, or differentiated from the motor angle, then filtered."""
    row = speed
    n = axis.loops.speed_mean_cycles
    if n:
        size = len(a)
        a = block_diag(a, np.zeros((n, n)))
        a[size, :size] = motor  # past angles, newest first
        for i in range(1, n):
            a[size + i, size + i - 1] = 1.0
        b = np.vstack([b, np.zeros((n, 1))])
        row = (_padded(motor, size + n) - np.eye(size + n)[size + n - 1]) / (n * period)
    if axis.loops.speed_filter_time_s > 0.0:
        share = -math.expm1(-period / axis.loops.speed_filter_time_s)
        size = len(a)
        a = block_diag(a, 1.0 - share)
        a[size, :size] = share * row
        b = np.vstack([b, [[0.0]]])
        row = np.append(share * row, 1.0 - share)
    return a, b, row


def _padded(row: np.ndarray, size: int) -> np.ndarray:
    return np.append(row, np.zeros(size - len(row)))


def _at(loop: Loop, frequency: float) -> complex:
    """L at one frequency [Hz]."""
    z = cmath.exp(2j * math.pi * frequency * loop.period)
    return complex((loop.c @ np.linalg.solve(z * np.eye(len(loop.a)) - loop.a, loop.b))[0, 0])


def _bandwidth(loop: Loop, f: np.ndarray, closed: np.ndarray) -> float:
    """Frequency [Hz] where the closed loop, with these gains on a grid, first falls to -3 dB; inf if it never does."""
    level = math.sqrt(0.5)
    above = np.flatnonzero(closed >= level)
    if not above.size:
        return math.inf
    fallen = np.flatnonzero(closed[above[0] :] < level) + above[0]
    end = int(fallen[0]) if fallen.size else len(f) - 1
    # a notch may reach the level between two grid frequencies
    inside = np.arange(above[0] + 1, end)
    for i in inside[(closed[inside] < closed[inside - 1]) & (closed[inside] <= closed[inside + 1])]:
        bottom = minimize_scalar(
            lambda x: _closed_gain(loop, x), bounds=(f[i - 1], f[i + 1]), method="bounded", options={"xatol": 1e-6 * f[i]}
        )
        if bottom.fun < level:
            return _refined(lambda x: _closed_gain(loop, x) - level, f[i - 1], float(bottom.x))
    return _refined(lambda x: _closed_gain(loop, x) - level, f[end - 1], f[end]) if fallen.size else math.inf


def _closed_gain(loop: Loop, frequency: float) -> float:
    """abs(L / (1 + L)) at one frequency [Hz]."""
    response = _at(loop, frequency)
    return abs(response / (1.0 + response))


def _sign_changes(values: np.ndarray) -> np.ndarray:
    return np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)


def _refined(function: Callable[[float], float], low: float, high: float) -> float:
    return float(brentq(function, low, high, xtol=1e-12, rtol=1e-12))
