"""Friction effects near standstill: Stribeck and pre-sliding. Terms of order 0 and 1 set the friction level, the bristle (2) uses it."""

import math

from twin.effects.change import Change, total_inertia
from twin.effects.effect import Parameter, Picture, effect
from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.simulation import loop_terms
from twin.simulation.loop_terms import FORCE, arrays, term

VANISHED = 6.1
"""At a larger multiple x of the Stribeck speed, exp(-x^2) is below machine precision."""

BRISTLE_DAMPING_RATIO = 0.3
"""Default damping ratio of the bristle with the total inertia of the axis."""


@effect(
    block="mechanics",
    parameters=(
        Parameter("excess", "force", 0.0, 1e5, lambda m, a: (0.3 * a.coulomb_friction, 0.8 * a.coulomb_friction), neutral=0.0),
        Parameter(
            "velocity", "speed", 1e-5, 1.0,
            lambda m, a: (2e-3, 6e-3) if a.kind == "linear" else (math.radians(0.6), math.radians(2.0)), logarithmic=True,
        ),
    ),
    separating_move="micro-reversals",
    rivals="Coulomb friction is higher at every speed, Stribeck friction only below a few mm/s.",
    picture=Picture(
        "Higher friction at low speed: the current peaks when the axis starts and stops.",
        "slow",
        sizes={"excess": 700.0, "velocity": 0.004},
    ),
)  # fmt: skip
def stribeck(change: Change, axis: Axis, excess: float, velocity: float) -> None:
    """Higher friction at low speed (Stribeck).

    F(v) = Fc + excess exp(-(v / velocity)^2). Source: Armstrong-Helouvry, Dupont, Canudas de Wit 1994.
    """
    change.add_term(stribeck_level, FORCE, axis, [excess, velocity], order=1)


def _bristle_range(machine: Machine, axis: Axis) -> tuple[float, float]:
    low, high = (4e-6, 20e-6) if axis.kind == "linear" else (math.radians(4 / 3600), math.radians(20 / 3600))
    return (axis.coulomb_friction / high, axis.coulomb_friction / low)


@effect(
    block="mechanics",
    parameters=(
        Parameter("stiffness", "stiffness", 1e-6, 1e13, _bristle_range, neutral=math.inf, logarithmic=True),
        Parameter(
            "damping", "damping", 0.0, 1e9, shape=True, logarithmic=True, fitted=lambda m, a, v: _bristle_damping(m, a, v["stiffness"])
        ),
    ),
    separating_move="micro-reversals",
    rivals="Backlash separates motor and scale; pre-sliding does not. Coulomb friction jumps at a reversal; pre-sliding friction builds up over micrometres.",
    normal="slip",
    picture=Picture("Micro-reversals: friction builds up over micrometres instead of jumping.", "micro", smooth_s=0.004),
)
def presliding(change: Change, axis: Axis, stiffness: float, damping: float | None = None) -> None:
    """Elastic contact below break-away (pre-sliding).

    Bristle z' = v - stiffness |v| z / F(v); force stiffness z + damping z' (+ viscous v). F(v) is the friction level
    of the other terms. Default damping: ratio 0.3 with the total inertia of the axis.
    Source: Canudas de Wit, Olsson, Astrom, Lischinsky 1995 (LuGre).
    """
    load = change.load_inertia(axis)
    change.check_step(axis, "presliding", stiffness, load)
    limit = load / change.machine.base_tick
    if damping is None:
        damping = min(_bristle_damping(change.machine, axis, stiffness), limit)
    if damping > limit:
        raise InputError(
            f"presliding on axis {axis.name}: damping = {damping:g} stops the load within a tick of {change.machine.base_tick * 1e6:g} us; "
            f"give at most {limit:.3g}"
        )
    change.add_term(bristle, FORCE, axis, [stiffness, damping], order=2)


def _bristle_damping(machine: Machine, axis: Axis, stiffness: float) -> float:
    return 2.0 * BRISTLE_DAMPING_RATIO * math.sqrt(stiffness * total_inertia(machine, axis))


@term
def stribeck_level(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F += p[0] exp(-(v / p[1])^2)."""
    p, s, x = arrays(parameters, state, signals)
    ratio = x[axis, loop_terms.X_LOAD_SPEED] / p[1]
    if abs(ratio) < VANISHED:  # exp() is slow for results near zero
        x[axis, loop_terms.X_FRICTION_LEVEL] += p[0] * math.exp(-ratio * ratio)


@term
def bristle(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """z' = v - k |v| z / F, solved exactly over the tick for the speed at its middle; the mean force acts."""
    p, s, x = arrays(parameters, state, signals)
    h = x[axis, loop_terms.X_STEP]
    other_side = x[axis, loop_terms.X_OTHER_SIDE_LEVEL]
    level = x[axis, loop_terms.X_FRICTION_LEVEL] - other_side
    x[axis, loop_terms.X_FRICTION_LEVEL] = other_side
    if level <= 0.0:
        return
    speed = x[axis, loop_terms.X_LOAD_SPEED] + 0.5 * h * x[axis, loop_terms.X_LOAD_ACCELERATION]
    rate = p[0] * abs(speed) / level * h
    before = s[0]
    if rate > 1e-9:
        steady = math.copysign(level / p[0], speed)
        fade = math.exp(-rate)
        s[0] = steady + (before - steady) * fade
        mean = steady + (before - steady) * (1.0 - fade) / rate
    else:
        s[0] = before + speed * h
        mean = before + 0.5 * speed * h
    x[axis, loop_terms.X_FRICTION_FORCE] -= p[0] * mean + p[1] * (s[0] - before) / h
