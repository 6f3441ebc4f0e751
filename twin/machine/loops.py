"""The loops of an axis as linear sampled systems: open and closed frequency response, margins, bandwidth.

Each controller samples at its own cycle T and holds its output; the motor moves in continuous time between samples. The plant of a loop is exact
over one of its cycles (a matrix exponential over the fastest cycle, then powers). With its controller included, e -> y is the open loop:

    L(z) = C (z I - A)^-1 B,   closed = L / (1 + L),   z = exp(j w T)

    current    u = Kpi e + I                                       winding and free rotor
    speed      i* = (Kp e + I) / Kt                                closed current loop, rotor (and load behind a spring), filtered speed
    position   w* = Kv e / r                                       closed speed loop, encoder; in the NC or in the drive

The linear models of the blocks stand in `twin.control`.
Friction is viscous here, the inertia is that of the home pose, and limits are not reached. The spring is that of `transmission_compliance`.
"""

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from scipy.optimize import brentq

from twin.control.current_controller import lag_model, winding_model
from twin.control.drive_position_loop import closed_in_drive
from twin.control.linear import GRID, Loop, closed, held, padded, sampled, with_controller, with_transfer
from twin.control.speed_controller import with_reference_model, with_seen_speed
from twin.effects import load_inertia, settings_of
from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.simulation.plant_spec import home_inertia_at_motor


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
        _refined(lambda x: math.log(abs(_open(loop, x))), f[i], f[i + 1])
        for i in _sign_changes(np.log(np.maximum(np.abs(response), ZERO_GAIN)))
    ]
    # the imaginary part changes sign on the negative real axis
    turns = [i for i in _sign_changes(response.imag) if response[i].real < 0.0 and response[i + 1].real < 0.0]
    crossings = [_refined(lambda x: _open(loop, x).imag, f[i], f[i + 1]) for i in turns]
    if response[-1].real < 0.0:
        crossings.append(0.5 / loop.period)  # at half the sampling rate L is real
    phases = [(math.degrees(np.angle(-_open(loop, x))), x) for x in crossovers]
    gains = [(1.0 / size, x) for x in crossings if (size := abs(_open(loop, x))) > ZERO_GAIN]
    phase, crossover = min(phases, key=lambda p: abs(p[0])) if phases else (math.inf, math.inf)
    gain, phase_crossing = min(gains, key=lambda g: abs(math.log(g[0]))) if gains else (math.inf, math.inf)
    # a loop gain beyond all numbers closes to 1
    gains_closed = np.abs(np.divide(response, 1.0 + response, out=np.ones_like(response), where=np.isfinite(response)))
    return Margins(
        float(gain),
        float(phase_crossing),
        float(phase),
        float(crossover),
        _bandwidth(loop, f, gains_closed),
        float(gains_closed.max()),
        loop.is_stable,
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
    position = motor if axis.encoder == "motor" else load
    commissioned = axis.commissioned_torque_constant
    loops = []
    if axis.actuator.winding:
        a, b, c = winding_model(axis.motor, a, b, speed)
        a, b = sampled(a, b, machine.current_cycle)
        current = with_controller(
            "current",
            machine.current_cycle,
            (a, b, c),
            axis.loops.current_gain_v_per_a,
            axis.loops.current_gain_v_per_a * machine.current_cycle / axis.loops.current_integral_time_s,
        )
        loops.append(current)
        a, b = closed(current)
        speed, motor, position = (padded(np.insert(row, 0, 0.0), len(a)) for row in (speed, motor, position))
        a, b = held(a, b, round(machine.speed_cycle / machine.current_cycle))
    else:
        b = b * axis.motor.torque_constant_nm_per_a
        if axis.loops.actuator_lag_s > 0.0:
            a, b = lag_model(axis.loops.actuator_lag_s, a, b)
            speed, motor, position = (np.insert(row, 0, 0.0) for row in (speed, motor, position))
        a, b = sampled(a, b, machine.speed_cycle)
    a, b, seen = with_seen_speed(axis.loops, machine.speed_cycle, a, b, speed, motor)
    gain = axis.loops.speed_gain_nm_s_per_rad / commissioned
    integral = gain * machine.speed_cycle / axis.loops.speed_integral_time_s
    inner = with_controller("speed", machine.speed_cycle, (a, b, seen[None]), gain, integral)
    loops.append(inner)
    a, b = closed(inner)
    if integral > 0.0 and axis.loops.speed_reference_time_s > 0.0:
        a, b = with_reference_model(a, b, integral, -math.expm1(-machine.speed_cycle / axis.loops.speed_reference_time_s))
    position = padded(position, len(a))
    cycles = round(machine.position_cycle / machine.speed_cycle)
    if axis.loops.dsc_delay_s > 0.0:
        a, b, row = closed_in_drive(axis.loops.dsc_delay_s / machine.speed_cycle, cycles, a, b, position)
        loops.append(Loop("position", machine.speed_cycle, a, b * axis.loops.position_gain_per_s, row[None]))
        return loops
    loop = Loop("position", machine.position_cycle, *held(a, b, cycles), position[None])
    added = [b.block.linear(b.values, machine, axis.loops.position_gain_per_s) for b in axis.blocks if b.block.linear is not None]
    loops.append(with_transfer(loop, axis.loops.position_gain_per_s, [one for one in added if one[0].any()]))
    return loops


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


def _open(loop: Loop, frequency: float) -> complex:
    """L at one frequency [Hz]."""
    return complex(loop.open_response(np.array([frequency]))[0])


def _bandwidth(loop: Loop, f: np.ndarray, closed: np.ndarray) -> float:
    """Frequency [Hz] where the closed loop, with these gains on a grid, first falls to -3 dB; inf if it never does."""
    level = math.sqrt(0.5)
    falls = np.flatnonzero((closed[:-1] >= level) & (closed[1:] < level))
    return next((_refined(lambda x: abs(loop.closed_response(np.array([x]))[0]) - level, f[i], f[i + 1]) for i in falls), math.inf)


def _sign_changes(values: np.ndarray) -> np.ndarray:
    return np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)


def _refined(function: Callable[[float], float], low: float, high: float) -> float:
    return float(brentq(function, low, high, xtol=1e-12, rtol=1e-12))
