"""The library's effects on the second plant: laws and signs of effects.md, implemented independently, and their ranges.

An effect is a dict as in a truth.toml: {"name": ..., "axis": ..., **parameters}. `apply_effect` changes settings
(parameters.settings_of) in place; `draw_effect` draws an effect. `scale` multiplies its size (1 = usual range of effects.md):
deviations of factors, amplitudes, times, and compliances (1 / stiffness), but not shapes.
A `wide` draw takes every size and shape from low^2 / high to high^2 / low instead of low to high.
For ranges that effects.md gives only in mm, rotary axes use the same motor angle.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any, NamedTuple

import numpy as np

from .parameters import AXES, LINEAR, Settings, load_of

ARCSEC = math.pi / 180.0 / 3600.0
SCREW = 0.010 / (2.0 * math.pi)  # screw ratio [m/rad] behind the ranges in mm

LEAST_FACTOR, MOST_FRACTION = 0.3, 0.95  # limits of wide draws of gains and friction; the twin accepts no more


class DrawContext(NamedTuple):
    """Reference quantities for the sizes of effects on axis `k`."""

    rng: np.random.Generator
    k: int
    scale: float
    s: Settings  # settings with this machine's spread, without effects
    peak_current: np.ndarray  # of each axis in the programme [A]
    peak_speed: np.ndarray  # of each axis in the programme [axis units per s]
    wide: bool = False  # ranges three times as wide, on a logarithmic scale

    def within(self, low: float, high: float) -> float:
        if self.wide:
            return low * (high / low) ** (3.0 * self.rng.random() - 1.0)
        return low + (high - low) * self.rng.random()

    def sign(self) -> float:
        return 1.0 if self.rng.random() < 0.5 else -1.0

    def size(self, low: float, high: float) -> float:
        return self.scale * self.within(low, high)

    def phase(self) -> float:
        return 2.0 * math.pi * self.rng.random()

    def whole(self, low: int, high: int) -> float:
        """A whole number from low to high; wide: 1 to 3 high."""
        return float(self.rng.integers(1, 3 * high + 1) if self.wide else self.rng.integers(low, high + 1))

    @property
    def linear(self) -> bool:
        return bool(self.s.linear[self.k])

    def motor_like(self, metres: float) -> float:
        """A travel or speed of the screws, converted to this axis at equal motor angle."""
        return metres if self.linear else metres / SCREW * self.s.ratio[self.k]

    @property
    def load(self) -> float:
        return load_of(self.s)[self.k]

    @property
    def total(self) -> float:
        return self.load + self.s.motor_mass[self.k]


class Effect(NamedTuple):
    block: str
    axes: tuple[str, ...]
    parameters: tuple[str, ...]  # as they are drawn and sealed
    draw: Callable[[DrawContext], dict]
    apply: Callable[[Settings, int, dict], Any]


def _scale(field: str, key: str = "factor") -> Callable:
    def apply(s: Settings, k: int, p: dict) -> None:
        getattr(s, field)[k] *= p[key]

    return apply


def _add(**fields: str) -> Callable:
    """apply(): field += parameter, for each field=parameter."""

    def apply(s: Settings, k: int, p: dict) -> None:
        for field, key in fields.items():
            getattr(s, field)[k] += p[key]

    return apply


def _factor(low: float, high: float, signs: str = "both") -> Callable:
    def draw(d: DrawContext) -> dict:
        sign = {"both": d.sign, "less": lambda: -1.0}[signs]()
        return {"factor": max(1.0 + sign * d.size(low, high), LEAST_FACTOR)}

    return draw


def _tn_factor(d: DrawContext) -> dict:
    return {"factor": 1.0 + d.size(0.4, 1.2) if d.rng.random() < 0.5 else max(1.0 - d.size(0.5, 0.25), LEAST_FACTOR)}


def _delay(d: DrawContext) -> dict:
    return {"delay_s": max(d.sign() * d.size(0.25e-3, 0.75e-3), -d.s.position_delay[d.k])}  # the total delay stays causal


def _limit(d: DrawContext) -> dict:
    peak = d.peak_current[d.k]
    return {"limit_a": peak * (1.0 - d.size(0.04, 0.15))}


def _set_limit(s: Settings, k: int, p: dict) -> None:
    s.current_limit[k] = min(s.current_limit[k], p["limit_a"])


def _presliding(d: DrawContext) -> dict:
    stiffness = d.s.coulomb[d.k] / d.motor_like(d.size(4e-6, 20e-6))
    return {"stiffness": stiffness, "damping": 2.0 * d.within(0.1, 0.4) * math.sqrt(stiffness * d.load)}


def _position_friction(d: DrawContext) -> dict:
    return {"fraction": min(d.size(0.25, 0.5), MOST_FRACTION), "wavelength": d.within(0.03, 0.12) if d.linear else d.within(0.35, 1.2)}


def _set_position_friction(s: Settings, k: int, p: dict) -> None:
    s.friction_wave[k], s.friction_wave_number[k] = p["fraction"], 2.0 * math.pi / p["wavelength"]


def _unbalance(d: DrawContext) -> dict:
    return {"mass_kg": d.size(20.0, 60.0), "radius_m": d.within(0.1, 0.2), "angle_rad": d.phase(), "height_m": d.within(0.05, 0.2)}


def _clamp(s: Settings, k: int, p: dict) -> None:
    s.clamped.append((p["mass_kg"], p["radius_m"] * math.cos(p["angle_rad"]), p["radius_m"] * math.sin(p["angle_rad"]), p["height_m"]))


def _backlash(d: DrawContext) -> dict:
    reduced = d.load * d.s.motor_mass[d.k] / d.total
    stiffness = (2.0 * math.pi * 450.0) ** 2 * reduced
    return {
        "clearance": d.size(6e-6, 25e-6) if d.linear else d.size(15.0, 50.0) * ARCSEC,
        "contact_stiffness": stiffness,
        "contact_damping": 0.6 * math.sqrt(stiffness * reduced),
    }


def _set_backlash(s: Settings, k: int, p: dict) -> None:
    s.gap[k] = p["clearance"]
    s.contact_stiffness[k] = p.get("contact_stiffness", 0.0)  # 0: the default, from the final masses
    s.contact_damping[k] = p.get("contact_damping", 0.0)


def _compliance(d: DrawContext) -> dict:
    stiffness = (2.0 * math.pi * d.within(35.0, 75.0)) ** 2 * d.load / d.scale
    return {"stiffness": stiffness, "damping": stable_damping(d, stiffness)}


def stable_damping(d: DrawContext, stiffness: float) -> float:
    """Damping of a load spring that keeps the position loop on the scale stable: 2 zeta w = damping / load > Kv."""
    usual = 2.0 * d.within(0.04, 0.09) * math.sqrt(stiffness * d.load)
    return max(usual, d.within(1.25, 1.7) * d.s.kv[d.k] * d.load)


def _set_compliance(s: Settings, k: int, p: dict) -> None:
    s.stiffness[k], s.damping[k] = p["stiffness"], p.get("damping", 0.0)


def _frame(d: DrawContext) -> dict:
    return {"frequency_hz": d.within(20.0, 45.0), "mass_ratio": d.size(0.03, 0.10), "damping_ratio": d.within(0.03, 0.08)}


def _set_frame(s: Settings, k: int, p: dict) -> None:
    s.frame_w[k] = 2.0 * math.pi * p["frequency_hz"]
    s.frame_ratio[k], s.frame_zeta[k] = p.get("mass_ratio", 0.05), p.get("damping_ratio", 0.05)


def _ripple(d: DrawContext) -> dict:
    return {
        "amplitude_nm": d.size(0.08, 0.3) if d.linear else d.size(0.04, 0.15),
        "periods_per_rev": d.whole(4, 12),
        "phase_rad": d.phase(),
    }


def _set_ripple(s: Settings, k: int, p: dict) -> None:
    s.ripple[k], s.ripple_n[k], s.ripple_phase[k] = p["amplitude_nm"], p["periods_per_rev"], p.get("phase_rad", 0.0)


def _cyclic(d: DrawContext) -> dict:
    return {"amplitude": d.size(2e-6, 7e-6) if d.linear else d.size(4.0, 15.0) * ARCSEC, "phase_rad": d.phase()}


def _set_cyclic(s: Settings, k: int, p: dict) -> None:
    s.cyclic[k], s.cyclic_phase[k] = p["amplitude"], p.get("phase_rad", 0.0)


def _set_eccentricity(s: Settings, k: int, p: dict) -> None:
    s.eccentricity[k], s.eccentricity_phase[k] = p["amplitude"], p.get("phase_rad", 0.0)


def _coupling(d: DrawContext) -> dict:
    others = [a for a in LINEAR if a != AXES[d.k]]
    return {"from_axis": others[d.rng.integers(len(others))], "mass": d.size(0.08, 0.25) * d.s.load_mass[d.k]}


def _set_coupling(s: Settings, k: int, p: dict) -> None:
    s.coupling[k, AXES.index(p["from_axis"])] += p["mass"]


def _set_disturbance(s: Settings, k: int, p: dict) -> None:
    s.disturbance[k], s.disturbance_w[k] = p["force"], 2.0 * math.pi * p["frequency_hz"]


ALL = AXES
LIBRARY: dict[str, Effect] = {
    # control
    "position_gain": Effect("position controller", ALL, ("factor",), _factor(0.06, 0.15), _scale("kv")),
    "velocity_feedforward": Effect("position controller", ALL, ("factor",), _factor(0.015, 0.05), _scale("velocity_weight")),
    "torque_feedforward": Effect("speed controller", ALL, ("factor",), _factor(0.2, 0.5), _scale("torque_weight")),
    "loop_delay": Effect("position controller", ALL, ("delay_s",), _delay, _add(position_delay="delay_s")),
    "speed_gain": Effect("speed controller", ALL, ("factor",), _factor(0.2, 0.4), _scale("kp")),
    "speed_integral_time": Effect("speed controller", ALL, ("factor",), _tn_factor, _scale("tn")),
    "set_point_filter": Effect(
        "position controller",
        ALL,
        ("time_constant_s",),
        lambda d: {"time_constant_s": d.size(1e-3, 4e-3)},
        _add(set_point_lag="time_constant_s"),
    ),
    "current_filter": Effect(
        "speed controller",
        ALL,
        ("time_constant_s",),
        lambda d: {"time_constant_s": d.size(0.5e-3, 1.5e-3)},
        _add(current_lag="time_constant_s"),
    ),
    "current_limit": Effect("speed controller", ALL, ("limit_a",), _limit, _set_limit),
    "torque_constant": Effect("current loop", ALL, ("factor",), _factor(0.05, 0.12, "less"), _scale("kt")),
    # mechanics
    "inertia": Effect("mechanics", ALL, ("added",), lambda d: {"added": d.size(0.10, 0.35) * d.total}, _add(added_mass="added")),
    "coulomb_friction": Effect("mechanics", ALL, ("factor",), _factor(0.25, 0.5), _scale("coulomb")),
    "viscous_friction": Effect("mechanics", ALL, ("factor",), _factor(0.3, 0.6), _scale("viscous")),
    "stribeck": Effect(
        "mechanics",
        ALL,
        ("excess", "velocity"),
        lambda d: {"excess": d.size(0.3, 0.8) * d.s.coulomb[d.k], "velocity": d.motor_like(d.within(2e-3, 6e-3))},
        lambda s, k, p: (_add(stribeck_excess="excess")(s, k, p), s.stribeck_velocity.__setitem__(k, p["velocity"])),
    ),
    "presliding": Effect(
        "mechanics",
        ALL,
        ("stiffness",),
        _presliding,
        lambda s, k, p: (s.presliding_stiffness.__setitem__(k, p["stiffness"]), s.presliding_damping.__setitem__(k, p.get("damping", 0.0))),
    ),
    "viscous_asymmetry": Effect(
        "mechanics", ALL, ("fraction",), lambda d: {"fraction": d.sign() * d.size(0.15, 0.35)}, _add(asymmetry="fraction")
    ),
    "position_dependent_friction": Effect("mechanics", ALL, ("fraction", "wavelength"), _position_friction, _set_position_friction),
    "constant_force": Effect(
        "mechanics", ALL, ("force",), lambda d: {"force": d.sign() * d.size(0.2, 0.5) * d.s.coulomb[d.k]}, _add(constant_force="force")
    ),
    "table_unbalance": Effect("mechanics", ("A",), ("mass_kg", "radius_m", "angle_rad", "height_m"), _unbalance, _clamp),
    "torque_ripple": Effect("mechanics", ALL, ("amplitude_nm", "periods_per_rev"), _ripple, _set_ripple),
    "cross_axis_coupling": Effect("mechanics", LINEAR, ("from_axis", "mass"), _coupling, _set_coupling),
    "periodic_disturbance": Effect(
        "mechanics",
        ALL,
        ("frequency_hz", "force"),
        lambda d: {"frequency_hz": d.within(7.0, 35.0), "force": d.size(0.15, 0.4) * d.s.coulomb[d.k]},
        _set_disturbance,
    ),
    # transmission
    "backlash": Effect("transmission", ALL, ("clearance",), _backlash, _set_backlash),
    "transmission_compliance": Effect("transmission", ALL, ("stiffness",), _compliance, _set_compliance),
    "lead_error": Effect(
        "transmission", LINEAR, ("fraction",), lambda d: {"fraction": d.sign() * d.size(25e-6, 80e-6)}, _add(lead="fraction")
    ),
    "cyclic_error": Effect("transmission", ALL, ("amplitude",), _cyclic, _set_cyclic),
    # measurement
    "frame_vibration": Effect("measurement", ALL, ("frequency_hz",), _frame, _set_frame),
    "encoder_eccentricity": Effect(
        "measurement",
        ("C",),
        ("amplitude",),
        lambda d: {"amplitude": d.size(4.0, 15.0) * ARCSEC, "phase_rad": d.phase()},
        _set_eccentricity,
    ),
    "thermal_drift": Effect("measurement", LINEAR, ("rate",), lambda d: {"rate": d.sign() * d.size(0.1e-6, 0.4e-6)}, _add(drift="rate")),
}


def draw_effect(name: str, axis: str, context: DrawContext, library: dict[str, Effect] = LIBRARY) -> dict:
    """A drawn effect in the form of a truth.toml."""
    return {"name": name, "axis": axis, **library[name].draw(context)}


def apply_effect(s: Settings, effect: dict, library: dict[str, Effect] = LIBRARY) -> None:
    """Apply one effect to settings `s`; raises ValueError for an unknown name or an axis that cannot have it."""
    name, axis = effect["name"], effect["axis"]
    if name not in library:
        raise ValueError(f"no effect {name!r}; there are: {', '.join(library)}")
    if axis not in library[name].axes:
        raise ValueError(f"{name} cannot be on axis {axis!r}, only on {', '.join(library[name].axes)}")
    library[name].apply(s, AXES.index(axis), effect)
