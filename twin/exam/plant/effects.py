"""The library's effects on the second plant: laws and signs of effects.md, implemented independently, and their ranges.

An effect is a dict as in a truth.toml: {"name": ..., "axis": ..., **parameters}. `apply_effect` changes settings
(parameters.settings_of) in place; `draw_effect` draws an effect. `scale` multiplies its size (1 = usual range of effects.md):
deviations of factors, amplitudes, times, and compliances (1 / stiffness), but not shapes.
A `wide` draw takes every size and shape from low^2 / high to high^2 / low instead of low to high.
For ranges that effects.md gives only in mm, rotary axes use the same motor angle.
"""

from collections.abc import Callable
import math
from typing import Any, NamedTuple

import numpy as np

from .parameters import AXES, LINEAR, SCREW, Settings, load_of

ARCSEC = math.pi / 180.0 / 3600.0

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
    draw: Callable[[DrawContext], dict]
    apply: Callable[[Settings, int, dict], Any]
    axes: tuple[str, ...] = AXES


def scale(field: str) -> Callable:
    """apply(): field *= factor."""

    def apply(s: Settings, k: int, p: dict) -> None:
        getattr(s, field)[k] *= p["factor"]

    return apply


def add(field: str, key: str) -> Callable:
    """apply(): field += parameter."""

    def apply(s: Settings, k: int, p: dict) -> None:
        getattr(s, field)[k] += p[key]

    return apply


DEFAULTS = {"mass_ratio": 0.05, "damping_ratio": 0.05}
"""Parameters that a truth.toml may leave out; all others are then 0 (a contact of backlash gets its default from the final masses)."""


def put(**fields: str | Callable[[dict], float]) -> Callable:
    """apply(): field = parameter, or a function of the parameters, for each field."""

    def apply(s: Settings, k: int, p: dict) -> None:
        for field, value in fields.items():
            getattr(s, field)[k] = value(p) if callable(value) else p.get(value, DEFAULTS.get(value, 0.0))

    return apply


def turns(p: dict) -> float:
    """Angular frequency [rad/s] of an effect with a frequency in Hz."""
    return 2.0 * math.pi * float(p["frequency_hz"])


def _factor(low: float, high: float, only_less: bool = False) -> Callable:
    def draw(d: DrawContext) -> dict:
        sign = -1.0 if only_less else d.sign()
        return {"factor": max(1.0 + sign * d.size(low, high), LEAST_FACTOR)}

    return draw


def _sizes(**ranges: tuple[float, float]) -> Callable:
    """draw(): parameters of these ranges that the scale multiplies."""
    return lambda d: {key: d.size(*ends) for key, ends in ranges.items()}


def _signed(key: str, low: float, high: float) -> Callable:
    """draw(): a parameter of either sign."""
    return lambda d: {key: d.sign() * d.size(low, high)}


def _tn_factor(d: DrawContext) -> dict:
    return {"factor": 1.0 + d.size(0.4, 1.2) if d.rng.random() < 0.5 else max(1.0 - d.size(0.5, 0.25), LEAST_FACTOR)}


def _delay(d: DrawContext) -> dict:
    return {"delay_s": max(d.sign() * d.size(0.25e-3, 0.75e-3), -d.s.position_delay[d.k])}  # the total delay stays causal


def _set_limit(s: Settings, k: int, p: dict) -> None:
    s.current_limit[k] = min(s.current_limit[k], p["limit_a"])


def _stribeck(d: DrawContext) -> dict:
    return {"excess": d.size(0.3, 0.8) * d.s.coulomb[d.k], "velocity": d.motor_like(d.within(2e-3, 6e-3))}


def _presliding(d: DrawContext) -> dict:
    stiffness = d.s.coulomb[d.k] / d.motor_like(d.size(4e-6, 20e-6))
    return {"stiffness": stiffness, "damping": 2.0 * d.within(0.1, 0.4) * math.sqrt(stiffness * d.load)}


def _position_friction(d: DrawContext) -> dict:
    return {"fraction": min(d.size(0.25, 0.5), MOST_FRACTION), "wavelength": d.within(0.03, 0.12) if d.linear else d.within(0.35, 1.2)}


def _unbalance(d: DrawContext) -> dict:
    return {"mass_kg": d.size(20.0, 60.0), "radius_m": d.within(0.1, 0.2), "angle_rad": d.phase(), "height_m": d.within(0.05, 0.2)}


def _clamp(s: Settings, k: int, p: dict) -> None:
    s.clamped.append((p["mass_kg"], p["radius_m"] * math.cos(p["angle_rad"]), p["radius_m"] * math.sin(p["angle_rad"]), p["height_m"]))


def _backlash(d: DrawContext) -> dict:
    reduced = d.load * d.s.motor_mass[d.k] / d.total
    stiffness = (2.0 * math.pi * 450.0) ** 2 * reduced
    clearance = d.size(6e-6, 25e-6) if d.linear else d.size(15.0, 50.0) * ARCSEC
    return {"clearance": clearance, "contact_stiffness": stiffness, "contact_damping": 0.6 * math.sqrt(stiffness * reduced)}


def _compliance(d: DrawContext) -> dict:
    stiffness = (2.0 * math.pi * d.within(35.0, 75.0)) ** 2 * d.load / d.scale
    return {"stiffness": stiffness, "damping": stable_damping(d, stiffness)}


def stable_damping(d: DrawContext, stiffness: float) -> float:
    """Damping of a load spring that keeps the position loop on the scale stable: 2 zeta w = damping / load > Kv."""
    usual = 2.0 * d.within(0.04, 0.09) * math.sqrt(stiffness * d.load)
    return max(usual, d.within(1.25, 1.7) * d.s.kv[d.k] * d.load)


def _frame(d: DrawContext) -> dict:
    return {"frequency_hz": d.within(20.0, 45.0), "mass_ratio": d.size(0.03, 0.10), "damping_ratio": d.within(0.03, 0.08)}


def _ripple(d: DrawContext) -> dict:
    amplitude = d.size(0.08, 0.3) if d.linear else d.size(0.04, 0.15)
    return {"amplitude_nm": amplitude, "periods_per_rev": d.whole(4, 12), "phase_rad": d.phase()}


def _cyclic(d: DrawContext) -> dict:
    return {"amplitude": d.size(2e-6, 7e-6) if d.linear else d.size(4.0, 15.0) * ARCSEC, "phase_rad": d.phase()}


def other_linear(d: DrawContext) -> str:
    """Another linear axis, drawn."""
    others = [a for a in LINEAR if a != AXES[d.k]]
    return others[d.rng.integers(len(others))]


def _set_coupling(s: Settings, k: int, p: dict) -> None:
    s.coupling[k, AXES.index(p["from_axis"])] += p["mass"]


def _disturbance(d: DrawContext) -> dict:
    return {"frequency_hz": d.within(7.0, 35.0), "force": d.size(0.15, 0.4) * d.s.coulomb[d.k]}


LIBRARY: dict[str, Effect] = {
    # control
    "position_gain": Effect("position controller", _factor(0.06, 0.15), scale("kv")),
    "velocity_feedforward": Effect("position controller", _factor(0.015, 0.05), scale("velocity_weight")),
    "torque_feedforward": Effect("speed controller", _factor(0.2, 0.5), scale("torque_weight")),
    "loop_delay": Effect("position controller", _delay, add("position_delay", "delay_s")),
    "speed_gain": Effect("speed controller", _factor(0.2, 0.4), scale("kp")),
    "speed_integral_time": Effect("speed controller", _tn_factor, scale("tn")),
    "set_point_filter": Effect("position controller", _sizes(time_constant_s=(1e-3, 4e-3)), add("set_point_lag", "time_constant_s")),
    "current_filter": Effect("speed controller", _sizes(time_constant_s=(0.5e-3, 1.5e-3)), add("current_lag", "time_constant_s")),
    "current_limit": Effect("speed controller", lambda d: {"limit_a": d.peak_current[d.k] * (1.0 - d.size(0.04, 0.15))}, _set_limit),
    "torque_constant": Effect("current loop", _factor(0.05, 0.12, only_less=True), scale("kt")),
    # mechanics
    "inertia": Effect("mechanics", lambda d: {"added": d.size(0.10, 0.35) * d.total}, add("added_mass", "added")),
    "coulomb_friction": Effect("mechanics", _factor(0.25, 0.5), scale("coulomb")),
    "viscous_friction": Effect("mechanics", _factor(0.3, 0.6), scale("viscous")),
    "stribeck": Effect("mechanics", _stribeck, put(stribeck_excess="excess", stribeck_velocity="velocity")),
    "presliding": Effect("mechanics", _presliding, put(presliding_stiffness="stiffness", presliding_damping="damping")),
    "viscous_asymmetry": Effect("mechanics", _signed("fraction", 0.15, 0.35), add("asymmetry", "fraction")),
    "position_dependent_friction": Effect(
        "mechanics", _position_friction, put(friction_wave="fraction", friction_wave_number=lambda p: 2.0 * math.pi / p["wavelength"])
    ),
    "constant_force": Effect(
        "mechanics", lambda d: {"force": d.sign() * d.size(0.2, 0.5) * d.s.coulomb[d.k]}, add("constant_force", "force")
    ),
    "table_unbalance": Effect("mechanics", _unbalance, _clamp, ("A",)),
    "torque_ripple": Effect("mechanics", _ripple, put(ripple="amplitude_nm", ripple_n="periods_per_rev", ripple_phase="phase_rad")),
    "cross_axis_coupling": Effect(
        "mechanics", lambda d: {"from_axis": other_linear(d), "mass": d.size(0.08, 0.25) * d.s.load_mass[d.k]}, _set_coupling, LINEAR
    ),
    "periodic_disturbance": Effect("mechanics", _disturbance, put(disturbance="force", disturbance_w=turns)),
    # transmission
    "backlash": Effect(
        "transmission", _backlash, put(gap="clearance", contact_stiffness="contact_stiffness", contact_damping="contact_damping")
    ),
    "transmission_compliance": Effect("transmission", _compliance, put(stiffness="stiffness", damping="damping")),
    "lead_error": Effect("transmission", _signed("fraction", 25e-6, 80e-6), add("lead", "fraction"), LINEAR),
    "cyclic_error": Effect("transmission", _cyclic, put(cyclic="amplitude", cyclic_phase="phase_rad")),
    # measurement
    "frame_vibration": Effect("measurement", _frame, put(frame_w=turns, frame_ratio="mass_ratio", frame_zeta="damping_ratio")),
    "encoder_eccentricity": Effect("measurement", _cyclic, put(eccentricity="amplitude", eccentricity_phase="phase_rad"), ("C",)),
    "thermal_drift": Effect("measurement", _signed("rate", 0.1e-6, 0.4e-6), add("drift", "rate"), LINEAR),
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
