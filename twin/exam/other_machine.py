"""Another machine for a case: other drives, gains, cycles, encoders, noise and tolerance than the machine file of the examination.

    changed = another_machine(machine, seed)      the tables of its machine file; bodies, travel and limits of the axes stay

On most of them, as in the field, the motor encoder closes the position loops, mostly with a scale recorded beside it. The candidate gets
this machine file; nothing in it is hidden.
    inertia at the motor   J = J_rotor + m r^2, m the load from the given file's commissioned inertia
    speed gain             Kp = w J, w = 2 pi 45 to 65 Hz       position gain   Kv Tp at most 0.12
    current gain           in proportion to L: amplitude optimum
Torque constants, and noise of speed and current, are at least those of the given file, so that the small imperfections of `Richness.small` stay near the noise.
With `keys` the file's noise and resolution are left out, ten times too small or ten times too large (`with_noise_keys`).
"""

from collections.abc import Mapping
import copy
import math
from typing import Any

import numpy as np

from .plant.parameters import ratio_of

ARRANGEMENTS = (("motor", "full"), ("motor", "full"), ("motor", "full"), ("motor", "no scale"), ("scale", "full"))
"""Encoder that closes the position loop, and recorded signals; drawn with equal probability."""

CYCLES_US = ((1000, 1000), (2000, 1000), (2000, 2000), (4000, 1000), (4000, 2000))
"""Position cycle and sample period."""

NEEDS_A_SCALE = ("lead_error", "cyclic_error", "thermal_drift", "encoder_eccentricity", "frame_vibration")
"""Effects that no other sensor shows."""

NOISE_KEYS: Mapping[str, float | None] = {"given": 1.0, "absent": None, "tenth": 0.1, "tenfold": 10.0}
"""What the candidate's machine file says of noise and resolution: the truth times this factor, or nothing."""


def arrangement_of(seed: int, effect: str | None) -> tuple[str, str]:
    """Entry of ARRANGEMENTS for a machine with this effect, with a scale if no other sensor shows it."""
    drawn = ARRANGEMENTS[np.random.default_rng(np.random.SeedSequence([seed, 17])).integers(len(ARRANGEMENTS))]
    return ARRANGEMENTS[0] if effect in NEEDS_A_SCALE else drawn


def another_machine(machine: Mapping[str, Any], seed: int, effect: str | None = None) -> dict[str, Any]:
    """The tables of another machine, on which this effect can be seen."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 18]))
    out = copy.deepcopy(dict(machine))

    def about(factor: float) -> float:
        """A factor drawn between 1 / factor and factor, logarithmically."""
        return float(factor ** rng.uniform(-1.0, 1.0))

    position_us, sample_us = CYCLES_US[rng.integers(len(CYCLES_US))]
    encoder, _ = arrangement_of(seed, effect)
    out["name"] = f"{machine['name']}, other drives"
    out["parameter_tolerance"] = float(rng.choice([0.01, 0.02, 0.05]))
    out["control"] |= {"position_cycle_us": position_us}
    for axis in out["axis"].values():
        _other_drive(axis, encoder, position_us * 1e-6, about, rng)
    step = float(rng.choice([1e-7, 2e-7, 5e-7, 1e-6]))  # m, and the same share of a table's radius
    motor_step = float(rng.choice([1e-8, 1e-7, 5e-7]))
    given = out["measurement"]
    out["measurement"] = given | {
        "sample_period_us": sample_us,
        "linear_scale_resolution_m": step,
        "linear_scale_noise_m": 0.5 * step * about(2.0),
        "rotary_encoder_resolution_deg": 50.0 * step,
        "rotary_encoder_noise_deg": 20.0 * step * about(2.0),
        "motor_encoder_resolution_m": motor_step,
        "motor_encoder_noise_m": 0.5 * motor_step * about(2.0),
        "motor_encoder_resolution_rad": motor_step,
        "motor_encoder_noise_rad": 0.5 * motor_step * about(2.0),
        **{key: given[key] * float(3.0 ** rng.uniform()) for key in ("speed_noise_m_per_s", "speed_noise_deg_per_s", "current_noise_a")},
    }
    return out


def _other_drive(axis: dict[str, Any], encoder: str, position_s: float, about: Any, rng: np.random.Generator) -> None:
    """Change one [axis.*] table in place."""
    motor, loops, commissioned = axis["motor"], axis["loops"], axis["commissioned"]
    rotor = next(key for key in axis if key.startswith("rotor_and"))
    before = ratio_of(axis)
    load = (commissioned["inertia_kg_m2"] - axis[rotor]) / before**2
    if axis["kind"] == "linear":
        axis["screw_lead_m_per_rev"] *= float(rng.choice([0.8, 1.0, 1.6, 2.0]))
    else:
        axis["gear_ratio"] *= float(rng.choice([0.8, 1.0, 1.25]))
    change = ratio_of(axis) / before
    axis["encoder"] = encoder
    axis[rotor] *= about(1.4)
    axis["coulomb_friction_nm"] *= about(1.3)
    axis["viscous_friction_nm_s_per_rad"] *= about(1.3)
    constant = float(2.0 ** rng.uniform())
    inertia = axis[rotor] + load * ratio_of(axis) ** 2
    torque = inertia / commissioned["inertia_kg_m2"] / change  # needed for the same acceleration
    motor["torque_constant_nm_per_a"] *= constant
    motor["back_emf_v_s_per_rad"] *= constant
    motor["resistance_ohm"] *= constant**2 * about(1.3)
    inductance = motor["inductance_h"]
    motor["inductance_h"] *= constant**2 * about(1.3)
    motor["peak_current_a"] *= 1.3 * max(torque, change) / constant
    motor["bus_limit_v"] *= max(1.0, 1.3 * constant * max(1.0 / change, torque, change))
    w = 2.0 * math.pi * rng.uniform(45.0, 65.0)
    loops["speed_gain_nm_s_per_rad"] = w * inertia
    loops["speed_integral_time_s"] *= about(1.5) * 1.2
    loops["position_gain_per_s"] = min(rng.uniform(30.0, 60.0), 0.12 / position_s)
    loops["current_gain_v_per_a"] *= motor["inductance_h"] / inductance
    loops["current_integral_time_s"] = motor["inductance_h"] / motor["resistance_ohm"]
    loops["position_delay_s"] = position_s
    commissioned["torque_constant_nm_per_a"] = motor["torque_constant_nm_per_a"]
    commissioned["inertia_kg_m2"] = inertia


def with_noise_keys(machine: Mapping[str, Any], keys: str) -> dict[str, Any]:
    """The tables with noise and resolution as NOISE_KEYS says."""
    factor = NOISE_KEYS[keys]
    numbers = {k: v for k, v in machine["measurement"].items() if "_noise_" in k or "_resolution_" in k}
    kept = {k: v for k, v in machine["measurement"].items() if k not in numbers}
    return {**machine, "measurement": kept if factor is None else kept | {k: factor * v for k, v in numbers.items()}}
