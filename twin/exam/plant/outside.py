"""Effects that the library lacks: the diagnosis should answer "unknown" or "law", with the right axis and block.

Same form as effects.LIBRARY. Symbols: T* torque set point, w* speed set point, s set point, x scale, d drive-train deflection:

| effect | block | law | size at scale 1 |
|---|---|---|---|
| notch_filter | speed controller | T* through (s^2 + w^2)/(s^2 + width w s + w^2) | 90 to 160 Hz, width 0.6 to 1.2 |
| position_dead_band | position controller | s - x pulled towards zero by `band` | 3 to 10 um |
| speed_set_point_smoothing | position controller | w* += share (w* - before): first-order lag at every tick | 2 to 6 ms |
| one_sided_speed_clip | position controller | w* <= limit in the positive direction only | 92 to 97 % of the fastest set point |
| magnetic_saturation | current loop | torque = Kt i / sqrt(1 + (i / i_s)^2) | 8 to 20 % lost at the programme's peak current |
| inverter_dead_time | current loop | u - u_d tanh(i / 0.2 A) | 8 to 20 V |
| windage | mechanics | force -c v |v| | 40 to 100 % of Coulomb at the fastest set point |
| warming_friction | mechanics | Coulomb (1 + share (1 - exp(-t / tau))), t over all runs | -50 to +60 %, tau 40 to 120 s |
| hardening_spring | transmission | P = k d + k3 d^3 | 45 to 65 Hz at rest, twice as stiff at 2 to 5 um (8 to 20 arcsec) |
| two_stage_lost_motion | transmission | stiffness share k inside a gap, k outside; one damper | 15 to 40 um, share 3 to 8 % |
| scale_coupling_play | measurement | scale = play operator of q, width w (a loose encoder coupling) | 5 to 15 um, 10 to 30 arcsec |
| scale_interpolation_error | measurement | + amplitude sin(2 pi q / 20 um), A and C 72 arcsec a line | 0.5 to 1.5 um, 2 to 5 arcsec |
| tilt_crosstalk | measurement | scale + gain (position of another axis - its start) | 40 to 150 um/m |
| current_recorded_late | measurement | recorded current is `skew_s` old | 2 to 6 ms |
| scale_sampling_jitter | measurement | scale sampled at t + tau, tau Gaussian | 20 to 60 us |

The ranges in um apply to screws; A and C as given or at equal motor angle. Source: machine-tool practice, own choice.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from .effects import ARCSEC, DrawContext, Effect, other_linear, put, stable_damping
from .mechanics import DEAD_TIME_A
from .parameters import AXES, LINEAR, Settings


def _length(d: DrawContext, um: tuple[float, float], arcsec: tuple[float, float]) -> float:
    return d.size(um[0], um[1]) * 1e-6 if d.linear else d.size(*arcsec) * ARCSEC


def _saturation(d: DrawContext) -> dict:
    # share lost at the peak: 1 - 1 / sqrt(1 + x^2), x = peak / i_s
    lost = d.size(0.08, 0.20)
    return {"saturation_a": d.peak_current[d.k] / math.sqrt(1.0 / (1.0 - lost) ** 2 - 1.0)}


def _hardening(d: DrawContext) -> dict:
    reference = d.within(2e-6, 5e-6) if d.linear else d.within(8.0, 20.0) * ARCSEC
    stiffness = (2.0 * math.pi * d.within(45.0, 65.0)) ** 2 * d.load / d.scale
    return {"stiffness": stiffness, "damping": stable_damping(d, stiffness), "per_m2": 1.0 / reference**2}


def _lost_motion(d: DrawContext) -> dict:
    stiffness = (2.0 * math.pi * d.within(150.0, 250.0)) ** 2 * d.load
    return {
        "width": d.motor_like(d.size(15e-6, 40e-6)),
        "share": d.within(0.03, 0.08),
        "stiffness": stiffness,
        "damping": 2.0 * 0.06 * math.sqrt(stiffness * d.load),
    }


def _set_crosstalk(s: Settings, k: int, p: dict) -> None:
    s.crosstalk[k, AXES.index(p["from_axis"])] = p["gain"]


def _warming(d: DrawContext) -> dict:
    return {"share": d.size(0.3, 0.6) if d.sign() > 0 else -d.size(0.3, 0.5), "time_constant_s": d.within(40.0, 120.0)}


@dataclass(frozen=True)
class TrueLaw:
    """The law of an effect as the examination marks it: its variable by the name in `diagnosis.json`, and its shape up to a positive factor.

    `values` (parameters, x) is the output over the variable; `response` (parameters, s) the frequency response of a filter.
    """

    variable: str
    values: Callable[[Mapping[str, Any], np.ndarray], np.ndarray] | None = None
    response: Callable[[Mapping[str, Any], np.ndarray], np.ndarray] | None = None


def _notch_response(p: Mapping[str, Any], s: np.ndarray) -> np.ndarray:
    w = 2.0 * math.pi * p["frequency_hz"]
    passed: np.ndarray = (s**2 + w**2) / (s**2 + p["width"] * w * s + w**2)
    return passed


LAWS = {
    "notch_filter": TrueLaw("current_setpoint", response=_notch_response),
    "position_dead_band": TrueLaw("following_error", lambda p, x: -np.clip(x, -p["band"], p["band"])),
    "speed_set_point_smoothing": TrueLaw("speed_setpoint", response=lambda p, s: 1.0 / (1.0 + p["time_constant_s"] * s)),
    "one_sided_speed_clip": TrueLaw("speed_setpoint", lambda p, x: np.minimum(x, p["limit"]) - x),
    "magnetic_saturation": TrueLaw("current", lambda p, x: x / np.sqrt(1.0 + (x / p["saturation_a"]) ** 2) - x),
    "inverter_dead_time": TrueLaw("current", lambda p, x: -np.tanh(x / DEAD_TIME_A)),
    "windage": TrueLaw("speed", lambda p, x: x**2),
    "warming_friction": TrueLaw("time", lambda p, x: p["share"] * (1.0 - np.exp(-x / p["time_constant_s"]))),
    "hardening_spring": TrueLaw("windup", lambda p, x: x**3),
    "two_stage_lost_motion": TrueLaw("windup", lambda p, x: -np.clip(x, -0.5 * p["width"], 0.5 * p["width"])),
    "scale_coupling_play": TrueLaw("slack", lambda p, x: -played(x, 0.5 * p["width"])),
    "scale_interpolation_error": TrueLaw("position", lambda p, x: np.sin(2.0 * math.pi * x / p["period"])),
    "tilt_crosstalk": TrueLaw("position", lambda p, x: p["gain"] * x),
    "current_recorded_late": TrueLaw("current", response=lambda p, s: np.exp(-p["skew_s"] * s)),
    "scale_sampling_jitter": TrueLaw("speed", lambda p, x: np.abs(x)),
}
"""Laws of the effects. Of a play, x is the travel of the load."""


def played(x: np.ndarray, half: float) -> np.ndarray:
    """Position (sample,) of the load within a play of +-half along a travel x (sample,) that starts in the middle."""
    out = np.zeros(len(x))
    for i in range(1, len(x)):
        out[i] = min(max(out[i - 1] + x[i] - x[i - 1], -half), half)
    return out


OUTSIDE: dict[str, Effect] = {
    "notch_filter": Effect(
        "speed controller",
        lambda d: {"frequency_hz": d.within(90.0, 160.0), "width": d.size(0.6, 1.2)},
        put(notch_hz="frequency_hz", notch_width="width"),
    ),
    "position_dead_band": Effect("position controller", lambda d: {"band": _length(d, (3, 10), (5, 15))}, put(dead_band="band")),
    "speed_set_point_smoothing": Effect(
        "position controller", lambda d: {"time_constant_s": d.size(2e-3, 6e-3)}, put(speed_lag="time_constant_s")
    ),
    "one_sided_speed_clip": Effect(
        "position controller", lambda d: {"limit": d.peak_speed[d.k] * (1.0 - d.size(0.03, 0.08))}, put(speed_clip="limit")
    ),
    "magnetic_saturation": Effect("current loop", _saturation, put(saturation_a="saturation_a")),
    "inverter_dead_time": Effect("current loop", lambda d: {"voltage_v": d.size(8.0, 20.0)}, put(dead_time_v="voltage_v")),
    "windage": Effect("mechanics", lambda d: {"drag": d.size(0.4, 1.0) * d.s.coulomb[d.k] / d.peak_speed[d.k] ** 2}, put(windage="drag")),
    "warming_friction": Effect("mechanics", _warming, put(warming="share", warming_time="time_constant_s")),
    "hardening_spring": Effect("transmission", _hardening, put(stiffness="stiffness", damping="damping", hardening="per_m2")),
    "two_stage_lost_motion": Effect(
        "transmission", _lost_motion, put(soft_gap="width", soft_share="share", stiffness="stiffness", damping="damping")
    ),
    "scale_coupling_play": Effect("measurement", lambda d: {"width": _length(d, (5, 15), (10, 30))}, put(scale_play="width")),
    "scale_interpolation_error": Effect(
        "measurement",
        lambda d: {"amplitude": _length(d, (0.5, 1.5), (2, 5)), "period": 20e-6 if d.linear else 72.0 * ARCSEC},
        put(subperiod="amplitude", subperiod_length="period"),
    ),
    "tilt_crosstalk": Effect(
        "measurement", lambda d: {"from_axis": other_linear(d), "gain": d.sign() * d.size(40e-6, 150e-6)}, _set_crosstalk, LINEAR
    ),
    "current_recorded_late": Effect("measurement", lambda d: {"skew_s": d.size(2e-3, 6e-3)}, put(skew_s="skew_s")),
    "scale_sampling_jitter": Effect("measurement", lambda d: {"deviation_s": d.size(20e-6, 60e-6)}, put(jitter_s="deviation_s")),
}
