"""Effects between motor and load: dead zone, spring, wrong lead, errors that come back every turn."""

from __future__ import annotations

import math

from twin.effects.change import Change, load_inertia
from twin.effects.effect import Parameter, effect
from twin.machine.machine import Axis, Machine
from twin.simulation.loop_terms import (
    MEASURE,
    X_LOAD_FORCE,
    X_LOAD_MIDDLE,
    X_LOAD_SPEED,
    X_MOTOR_POSITION,
    X_MOTOR_SPEED,
    X_ROTOR_FORCE,
    X_ROTOR_MIDDLE,
    X_ROTOR_POSITION,
    X_ROTOR_SPEED,
    arrays,
    term,
)
from twin.units import ARCSEC

CONTACT_FREQUENCY_HZ = 450.0
CONTACT_DAMPING_RATIO = 0.3
COMPLIANCE_DAMPING_RATIO = 0.08
COMPLIANCE_STABLE = 1.4
"""Damping where none is given: of the contact, and of a screw with its bearings (at least this multiple of Kv x load: a position
loop closed on the load over a spring swings up by itself below Kv x load, and a machine that works does not)."""


@effect(
    block="transmission",
    axes="transmission",
    parameters=(
        Parameter(
            "clearance", "length", 0.0, 1e-2,
            lambda m, a: (6e-6, 25e-6) if a.kind == "linear" else (15 * ARCSEC, 50 * ARCSEC), neutral=0.0, logarithmic=True,
        ),
        Parameter("contact_stiffness", "stiffness", 1e3, 1e12, shape=True),
        Parameter("contact_damping", "damping", 0.0, 1e9, shape=True),
    ),
)  # fmt: skip
def backlash(
    change: Change, axis: Axis, clearance: float, contact_stiffness: float | None = None, contact_damping: float | None = None
) -> None:
    """Dead zone between motor and load.

    The load is touched only outside +-clearance/2, then through a spring and a damper (default: 450 Hz on the reduced mass
    m1 m2 / (m1 + m2), damping ratio 0.3). A slow reversal shows clearance + 2 Fc / contact_stiffness between motor and
    scale. Source: Nordin, Gutman 2002 (physical backlash).
    """
    reduced = change.reduced_mass(axis)
    w = 2.0 * math.pi * CONTACT_FREQUENCY_HZ
    stiffness = contact_stiffness if contact_stiffness is not None else w**2 * reduced
    damping = contact_damping if contact_damping is not None else 2.0 * CONTACT_DAMPING_RATIO * math.sqrt(stiffness * reduced)
    change.couple(axis, stiffness, damping, clearance)


def _first_mode(machine: Machine, axis: Axis) -> tuple[float, float]:
    load = load_inertia(machine, axis)
    return ((2 * math.pi * 35.0) ** 2 * load, (2 * math.pi * 75.0) ** 2 * load)


@effect(
    block="transmission",
    axes="transmission",
    parameters=(
        Parameter("stiffness", "stiffness", 1e3, 1e12, _first_mode, neutral=math.inf, logarithmic=True),
        Parameter(
            "damping", "damping", 0.0, 1e9, shape=True, logarithmic=True, fitted=lambda m, a, v: _screw_damping(m, a, v["stiffness"])
        ),
    ),
)
def transmission_compliance(change: Change, axis: Axis, stiffness: float, damping: float | None = None) -> None:
    """Spring and damper between motor and load.

    F = stiffness (motor position - load position) + damping (their speeds' difference); friction on the load. First mode
    sqrt(stiffness / load) / 2 pi with the motor held. Default damping: ratio 0.08 on the reduced mass, at least 1.4 Kv load.
    Source: Altintas et al. 2011 (machine tool feed drives).
    """
    if damping is None:
        damping = _screw_damping(change.machine, axis, stiffness)
    change.couple(axis, stiffness, damping)


def _screw_damping(machine: Machine, axis: Axis, stiffness: float) -> float:
    load = load_inertia(machine, axis)
    reduced = load * axis.reflected_inertia / (load + axis.reflected_inertia)
    stable = COMPLIANCE_STABLE * axis.loops.position_gain_per_s * load
    return max(2.0 * COMPLIANCE_DAMPING_RATIO * math.sqrt(stiffness * reduced), stable)


@effect(
    block="transmission",
    axes="linear",
    parameters=(Parameter("fraction", "number", -0.01, 0.01, (-80e-6, 80e-6), neutral=0.0),),
)
def lead_error(change: Change, axis: Axis, fraction: float) -> None:
    """Lead of the screw off by a fraction.

    Motor position = q0 + (q - q0)(1 - fraction), q0 where the run starts; motor speed is its derivative, so the speed loop
    feels it. Torque and rotor inertia stay reflected through the nominal ratio. Source: ISO 3408-3 lead deviation.
    """
    change.add_term(wrong_lead, MEASURE, axis, [fraction])


@effect(
    block="transmission",
    axes="turning motor",
    parameters=(
        Parameter(
            "amplitude", "length", 0.0, 1e-3,
            lambda m, a: (2e-6, 7e-6) if a.kind == "linear" else (4 * ARCSEC, 15 * ARCSEC), neutral=0.0, logarithmic=True,
        ),
        Parameter("phase_rad", "angle", -2 * math.pi, 2 * math.pi, default=0.0, shape=True, periodic=True),
    ),
)  # fmt: skip
def cyclic_error(change: Change, axis: Axis, amplitude: float, phase_rad: float) -> None:
    """Error between motor and load that comes back every motor turn (wobble of the screw, worm).

    Motor position = q - amplitude (sin(q / r + phase) - sin(q0 / r + phase)); motor speed is its derivative.
    """
    change.add_term(every_motor_turn, MEASURE, axis, [amplitude, 1.0 / axis.ratio, phase_rad])


@term
def coupling(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F = k (d -+ c/2) + b d' outside the dead zone |d| <= p[0], on the load; its reaction on the rotor."""
    p, s, x = arrays(parameters, state, signals)
    stretch = x[axis, X_ROTOR_MIDDLE] - x[axis, X_LOAD_MIDDLE]
    if stretch > p[0]:
        stretch -= p[0]
    elif stretch < -p[0]:
        stretch += p[0]
    elif p[0] > 0.0:
        return
    force = p[1] * stretch + p[2] * (x[axis, X_ROTOR_SPEED] - x[axis, X_LOAD_SPEED])
    x[axis, X_LOAD_FORCE] += force
    x[axis, X_ROTOR_FORCE] -= force


@term
def wrong_lead(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """Motor encoder: q0 + (q - q0)(1 - p[0])."""
    p, s, x = arrays(parameters, state, signals)
    if s[1] == 0.0:
        s[0] = x[axis, X_ROTOR_POSITION]
        s[1] = 1.0
    x[axis, X_MOTOR_POSITION] -= p[0] * (x[axis, X_ROTOR_POSITION] - s[0])
    x[axis, X_MOTOR_SPEED] -= p[0] * x[axis, X_ROTOR_SPEED]


@term
def every_motor_turn(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """Motor encoder: q - p[0] (sin(p[1] q + p[2]) - sin(p[1] q0 + p[2]))."""
    p, s, x = arrays(parameters, state, signals)
    angle = p[1] * x[axis, X_ROTOR_POSITION] + p[2]
    if s[1] == 0.0:
        s[0] = math.sin(angle)
        s[1] = 1.0
    x[axis, X_MOTOR_POSITION] -= p[0] * (math.sin(angle) - s[0])
    x[axis, X_MOTOR_SPEED] -= p[0] * p[1] * math.cos(angle) * x[axis, X_ROTOR_SPEED]
