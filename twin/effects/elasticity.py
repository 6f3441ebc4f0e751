"""Effects of an elastic transmission between motor and load: dead zone and spring."""

import math

from twin.effects.change import Change, load_inertia, reduced_mass
from twin.effects.effect import Parameter, Picture, effect
from twin.machine.machine import Axis, Machine
from twin.units import ARCSEC

CONTACT_FREQUENCY_HZ = 450.0
CONTACT_DAMPING_RATIO = 0.3
COMPLIANCE_DAMPING_RATIO = 0.08
COMPLIANCE_STABLE = 1.4
"""Default damping of the contact, and of a screw with its bearings. COMPLIANCE_STABLE is the smallest damping of a screw as a multiple of
Kv x load: with less than Kv x load, a position loop closed on the load is unstable."""


@effect(
    block="transmission",
    axes="transmission",
    parameters=(
        Parameter(
            "clearance", "length", 0.0, 1e-2,
            lambda m, a: (6e-6, 25e-6) if a.kind == "linear" else (15 * ARCSEC, 50 * ARCSEC), neutral=0.0, logarithmic=True,
            starts=3, bends=True,
        ),
        Parameter("contact_stiffness", "stiffness", 1e-6, 1e12, shape=True),
        Parameter("contact_damping", "damping", 0.0, 1e9, shape=True),
    ),
    separating_move="micro-reversals",
    rivals="A compliance deflects in proportion to the force; backlash is a step, and the load stands still until the motor has crossed it.",
    contains=("transmission_compliance",),
    picture=Picture(
        "Slow reversal: motor and scale differ by the clearance; the load stands still until the motor has crossed it.", "reversal"
    ),
)  # fmt: skip
def backlash(
    change: Change, axis: Axis, clearance: float, contact_stiffness: float | None = None, contact_damping: float | None = None
) -> None:
    """Dead zone between motor and load.

    Contact only outside +-clearance/2, through a spring and a damper (default: 450 Hz with the reduced mass
    m1 m2 / (m1 + m2), damping ratio 0.3). A slow reversal shows clearance + 2 Fc / contact_stiffness between motor and
    scale. Source: Nordin, Gutman 2002 (physical backlash).
    """
    reduced = reduced_mass(change.machine, axis)
    w = 2.0 * math.pi * CONTACT_FREQUENCY_HZ
    stiffness = contact_stiffness if contact_stiffness is not None else w**2 * reduced
    damping = contact_damping if contact_damping is not None else 2.0 * CONTACT_DAMPING_RATIO * math.sqrt(stiffness * reduced)
    change.couple("backlash", axis, stiffness, damping, clearance)


def _first_mode(machine: Machine, axis: Axis) -> tuple[float, float]:
    load = load_inertia(machine, axis)
    return ((2 * math.pi * 35.0) ** 2 * load, (2 * math.pi * 75.0) ** 2 * load)


@effect(
    block="transmission",
    axes="transmission",
    parameters=(
        Parameter("stiffness", "stiffness", 1e-6, 1e12, _first_mode, neutral=math.inf, logarithmic=True),
        Parameter(
            "damping", "damping", 0.0, 1e9, shape=True, logarithmic=True, fitted=lambda m, a, v: _screw_damping(m, a, v["stiffness"])
        ),
    ),
    separating_move="chirp",
    rivals="Inertia does not separate motor and scale. A chirp excites the resonance, which an inertia does not have.",
    normal="elasticity",
    picture=Picture(
        "A chirp from 10 to 70 Hz excites the resonance; motor minus scale is the deflection of the spring.", "chirp", smooth_s=0.0005
    ),
)
def transmission_compliance(change: Change, axis: Axis, stiffness: float, damping: float | None = None) -> None:
    """Spring and damper between motor and load.

    F = stiffness (motor position - load position) + damping (their speeds' difference); friction on the load, or as `friction_side` says. First mode
    sqrt(stiffness / load) / 2 pi with the motor held. Default damping: ratio 0.08 on the reduced mass, at least 1.4 Kv load.
    Source: Altintas et al. 2011 (machine tool feed drives).
    """
    if damping is None:
        damping = _screw_damping(change.machine, axis, stiffness)
    change.couple("transmission_compliance", axis, stiffness, damping)


def _screw_damping(machine: Machine, axis: Axis, stiffness: float) -> float:
    stable = COMPLIANCE_STABLE * axis.loops.position_gain_per_s * load_inertia(machine, axis)
    return max(2.0 * COMPLIANCE_DAMPING_RATIO * math.sqrt(stiffness * reduced_mass(machine, axis)), stable)
