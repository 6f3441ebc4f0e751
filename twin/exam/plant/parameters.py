"""Parameters of the second plant: from the parsed machine file to SI arrays with one entry per axis.

Axis order: X Y Z A C. Units at the axis: m, N, kg or rad, Nm, kg m2; `ratio` r = axis units per motor radian (lead / 2 pi, or
1 / gear ratio). From the motor side to the axis side:
    mass, inertia: J / r^2      friction: T / r      viscous: b / r^2      force: Kt i / r
The control keeps the nominal torque constant and inertia J_ff, whatever the true motor and load are (docs/theory.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from types import SimpleNamespace
from typing import Any

import numpy as np

from .tilting_pair import pair_terms

AXES = ("X", "Y", "Z", "A", "C")
LINEAR = ("X", "Y", "Z")
SPREAD_KEYS = ("torque_constant", "resistance", "inductance", "rotor_inertia", "coulomb_friction", "viscous_friction")
BODIES = ("cradle", "table", "workpiece")
SCREW = 0.010 / (2.0 * math.pi)  # screw ratio [m/rad] behind the ranges in mm
FREE = 1e30  # no limit; finite, so that products with zero stay numbers


@dataclass(frozen=True)
class Richness:
    """Imperfections that every axis has besides its faults; `small()` and `off()` are its variants. Of the default size, a diagnosis names them.

    compliance_hz: (low, high) of sqrt(k / load) / 2 pi of the drive train; damping ratio 0.04 to 0.08
    presliding: (low, high) travel to full Coulomb friction [m at the screws; A and C at equal motor angle]
    cogging: (low, high) amplitude as a share of Coulomb friction; 6 to 14 periods per motor turn
    stribeck: (low, high) excess as a share of Coulomb friction; velocity 1 to 4 mm/s (A and C at equal motor angle)
    """

    compliance_hz: tuple[float, float] | None = (150.0, 250.0)
    presliding: tuple[float, float] | None = (0.2e-6, 1.0e-6)
    cogging: tuple[float, float] | None = (0.003, 0.012)
    stribeck: tuple[float, float] | None = (0.005, 0.03)

    @classmethod
    def small(cls) -> Richness:
        """About a fifth of the default: near the measuring noise, far below the usual size of any effect.

        On a sticking axis they are about ten times the noise.
        """
        return cls((400.0, 600.0), (0.05e-6, 0.2e-6), (0.0005, 0.002), (0.001, 0.005))

    @classmethod
    def off(cls) -> Richness:
        """No imperfections."""
        return cls(None, None, None, None)


def unit_factors() -> dict:
    """Factors of 1 on the nominal machine file, in the layout of a truth.toml's [parameter] tables."""
    factors = {axis: dict.fromkeys(SPREAD_KEYS, 1.0) for axis in AXES}
    for axis in LINEAR:
        factors[axis]["moving_mass"] = 1.0
    factors["bodies"] = {f"{body}_mass": 1.0 for body in BODIES}
    return factors


def draw_factors(rng: np.random.Generator, spread: float) -> dict:
    """Factors drawn uniformly and independently within 1 +- spread."""
    factors = unit_factors()
    for table in factors.values():
        for key in table:
            table[key] = 1.0 + spread * (2.0 * rng.random() - 1.0)
    return factors


def ratio_of(axis: dict) -> float:
    """r [m/rad or rad/rad] of one [axis.*] table."""
    return axis["screw_lead_m_per_rev"] / (2.0 * math.pi) if axis["kind"] == "linear" else 1.0 / axis["gear_ratio"]


def pair_of(machine: dict, factors: dict, clamped: Sequence[tuple[float, float, float, float]] = ()) -> np.ndarray:
    """Sums over the bodies on the tilting pair (see tilting_pair.py); `clamped` point masses (m, x, y, z) on the table."""
    body, geometry = machine["body"], machine["geometry"]
    oy, oz = geometry["a_axis_to_c_axis_y_m"], geometry["a_axis_to_c_axis_z_m"]
    f = factors["bodies"]
    m0 = body["cradle"]["mass_kg"] * f["cradle_mass"]
    _, y0, z0 = body["cradle"]["centre_of_mass_m"]
    y0, z0 = y0 + oy, z0 + oz
    i0 = body["cradle"]["inertia_kg_m2"][0] * f["cradle_mass"]
    parts = [
        (body[b]["mass_kg"] * f[b + "_mass"], *body[b]["centre_of_mass_m"], *(i * f[b + "_mass"] for i in body[b]["inertia_kg_m2"]))
        for b in ("table", "workpiece")
    ]
    parts += [(*c, 0.0, 0.0, 0.0) for c in clamped]
    m, x, y, z, *inertia = (np.array(column) for column in zip(*parts))
    zeta = z + oz
    first = [m.sum(), *((m * q).sum() for q in (x, y, zeta))]
    second = [(m * p * q).sum() for p, q in ((x, x), (y, y), (x, y), (zeta, zeta), (zeta, x), (zeta, y))]
    cradle = [i0 + m0 * (y0**2 + z0**2), m0 * y0, m0 * z0]
    return np.array([machine["gravity_m_per_s2"], *cradle, *first, oy, *second, *(i.sum() for i in inertia)])


Settings = Any  # a SimpleNamespace of arrays [axis], made by settings_of


ZERO = [
    # effects of the library
    "set_point_lag", "current_lag", "stribeck_excess", "presliding_stiffness", "presliding_damping", "asymmetry", "friction_wave",
    "friction_wave_number", "constant_force", "added_mass", "gap", "contact_stiffness", "contact_damping", "stiffness", "damping",
    "hardening", "frame_w", "frame_zeta", "frame_ratio", "ripple", "ripple_n", "ripple_phase", "cogging", "cogging_n",
    "cogging_phase", "lead", "cyclic", "cyclic_phase", "eccentricity", "eccentricity_phase", "drift", "disturbance", "disturbance_w",
    # effects outside it
    "dead_band", "speed_lag", "notch_hz", "notch_width", "saturation_a", "dead_time_v", "windage", "warming", "warming_time",
    "soft_gap", "soft_share", "scale_play", "subperiod", "subperiod_length", "skew_s", "jitter_s",
]  # fmt: skip
"""Parameters of effects, one number per axis; zero on a machine without effects."""


def settings_of(machine: dict, factors: dict) -> Settings:
    """Arrays of control and mechanics for a machine without effects; effects change them in place."""
    axis = [machine["axis"][a] for a in AXES]
    motor, loops = [a["motor"] for a in axis], [a["loops"] for a in axis]
    linear = np.array([a["kind"] == "linear" for a in axis])

    def pick(tables: list[dict], key: str) -> np.ndarray:
        return np.array([t[key] for t in tables], dtype=float)

    def commissioned(key: str, nominal: np.ndarray) -> np.ndarray:
        """Value of the commissioning, if the file has one."""
        return np.array([a.get("commissioned", {}).get(key, n) for a, n in zip(axis, nominal)])

    def spread(key: str) -> np.ndarray:
        return np.array([factors[a].get(key, 1.0) for a in AXES])

    s = SimpleNamespace(linear=linear)
    s.on_motor = np.array([a.get("encoder", "scale") == "motor" for a in axis])  # the position loop is closed on the motor encoder
    s.ratio = np.array([ratio_of(a) for a in axis])
    rotor_key = {"linear": "rotor_and_screw_inertia_kg_m2", "rotary": "rotor_and_gear_inertia_kg_m2"}
    rotor_nominal = np.array([a[rotor_key[a["kind"]]] for a in axis])
    mass_nominal = np.array([a.get("moving_mass_kg", 0.0) for a in axis])

    # Control: nominal numbers only
    s.tick = machine["control"]["speed_cycle_us"] * 1e-6
    s.cycle_ticks = round(machine["control"]["position_cycle_us"] / machine["control"]["speed_cycle_us"])
    s.sample_ticks = round(machine["measurement"]["sample_period_us"] / machine["control"]["speed_cycle_us"])
    s.kv, s.kp, s.tn = pick(loops, "position_gain_per_s"), pick(loops, "speed_gain_nm_s_per_rad"), pick(loops, "speed_integral_time_s")
    s.kpi, s.tni = pick(loops, "current_gain_v_per_a"), pick(loops, "current_integral_time_s")
    s.velocity_weight, s.torque_weight = pick(loops, "velocity_feedforward"), pick(loops, "torque_feedforward")
    s.position_delay, s.feedforward_delay = pick(loops, "position_delay_s"), pick(loops, "feedforward_delay_s")
    s.dsc_delay = np.array([table.get("dsc_delay_s", 0.0) for table in loops], dtype=float)
    s.straight_set_points = machine["control"].get("setpoint_interpolation") == "linear"
    s.kt_control, s.bus = commissioned("torque_constant_nm_per_a", pick(motor, "torque_constant_nm_per_a")), pick(motor, "bus_limit_v")
    s.current_limit = pick(motor, "peak_current_a")
    at_zero = _at_zero(pair_of(machine, unit_factors()))
    s.inertia_control = commissioned("inertia_kg_m2", rotor_nominal + (mass_nominal + at_zero) * s.ratio**2)

    # Motor and load: nominal numbers times this machine's factors
    s.kt = pick(motor, "torque_constant_nm_per_a") * spread("torque_constant")
    s.ke = pick(motor, "back_emf_v_s_per_rad")
    s.resistance = pick(motor, "resistance_ohm") * spread("resistance")
    s.inductance = pick(motor, "inductance_h") * spread("inductance")
    s.motor_mass = rotor_nominal * spread("rotor_inertia") / s.ratio**2
    s.load_mass = mass_nominal * spread("moving_mass")
    s.coulomb = pick(axis, "coulomb_friction_nm") * spread("coulomb_friction") / s.ratio
    s.viscous = pick(axis, "viscous_friction_nm_s_per_rad") * spread("viscous_friction") / s.ratio**2
    s.gravity = machine["gravity_m_per_s2"]

    # structural mode: a bed under the nominal load, which swings at the file's frequency with the axis held
    share, zeta, w = (np.array([a.get(f"mode_{key}", 0.0) for a in axis]) for key in ("mass_share", "damping_ratio", "frequency_hz"))
    w = 2.0 * math.pi * w
    together = np.divide(mass_nominal + at_zero, share, out=np.zeros(len(AXES)), where=share > 0)
    s.bed_mass, s.mount_stiffness, s.mount_damping = (1.0 - share) * together, w**2 * together, 2.0 * zeta * w * together
    s.clamped = []
    s.pulses, s.plays, s.tables = {}, {}, {}  # compensations by number of the axis, see compensation.py
    s.machine, s.factors = machine, factors

    # Neutral values of everything that effects change
    for key in ZERO:
        setattr(s, key, np.zeros(len(AXES)))
    s.stribeck_velocity = np.full(len(AXES), 1e-3)
    s.zero_kept = False  # motor encoders, see mechanics.mechanics_values
    s.speed_clip = np.full(len(AXES), FREE)
    s.coupling = np.zeros((len(AXES), len(AXES)))  # [this, from]: mass
    s.crosstalk = np.zeros((len(AXES), len(AXES)))  # [this, from]: axis units per axis unit, outside the library
    return s


def _at_zero(pair: np.ndarray) -> np.ndarray:
    """Inertias (axis,) of the bodies on the pair at A = C = 0."""
    maa, _, mcc, _, _ = pair_terms(pair, 0.0, 0.0, 0.0, 0.0)
    return np.array([0.0, 0.0, 0.0, maa, mcc])


def load_of(s: Settings) -> np.ndarray:
    """Load mass or inertia [kg, kg m2] of each axis at A = C = 0, including clamped and added ones."""
    return s.load_mass + s.added_mass + _at_zero(pair_of(s.machine, s.factors, s.clamped))


def sensor_values(s: Settings) -> dict[str, Any]:
    """Fields of the axis records: noise and resolution of the machine file's [measurement] table, and errors between load and reading.

        scale = q + frame + drift (started_at + t) + eccentricity (sin(q + phase) - sin(q0 + phase))
        reading = round((scale + noise) / step) step, and the same for the motor encoder
    Noise is white and Gaussian. As in the recorded campaigns it is added before rounding, and the position controller uses the rounded sample
    of the encoder that closes its loop; the speed and current controllers see their noise at every tick.
    """
    t = s.machine["measurement"]
    rad = math.pi / 180.0

    def by_kind(linear: float, rotary: float) -> np.ndarray:
        return np.where(s.linear, linear, rotary)

    return {
        "scale_noise": by_kind(t["linear_scale_noise_m"], t["rotary_encoder_noise_deg"] * rad),
        "scale_step": by_kind(t["linear_scale_resolution_m"], t["rotary_encoder_resolution_deg"] * rad),
        "motor_noise": by_kind(t.get("motor_encoder_noise_m", 0.0), t.get("motor_encoder_noise_rad", 0.0)),
        "motor_step": by_kind(t["motor_encoder_resolution_m"], t["motor_encoder_resolution_rad"]),
        "speed_noise": by_kind(t["speed_noise_m_per_s"], t["speed_noise_deg_per_s"] * rad),  # axis units per s
        "current_noise": t["current_noise_a"],
        "subperiod_number": 2 * math.pi / np.where(s.subperiod_length > 0, s.subperiod_length, 1.0),
        "skew": np.round(s.skew_s / s.tick),  # ticks
    }


def axis_records(s: Settings, derived: Mapping[str, Any]) -> np.ndarray:
    """Records (axis,) of floats for the compiled functions: the arrays of the settings by name, with `derived` ones in addition or instead."""
    own = {name: value for name, value in vars(s).items() if isinstance(value, np.ndarray) and value.ndim == 1}
    fields = {**own, **derived}
    records = np.zeros(len(AXES), [(name, float) for name in sorted(fields)])
    for name, value in fields.items():
        records[name] = value
    return records


def apply_richness(s: Settings, richness: Richness, rng: np.random.Generator) -> None:
    """Change settings `s` in place, after the effects; the draws do not depend on the effects."""
    n = len(s.linear)
    draw = {kind: rng.random((3, n)) for kind in ("compliance", "presliding", "cogging", "stribeck")}

    def span(pair: tuple[float, float], u: np.ndarray) -> np.ndarray:
        return pair[0] + (pair[1] - pair[0]) * u

    load = load_of(s)
    at_axis = np.where(s.linear, 1.0, s.ratio / SCREW)  # metres at a screw to axis units at equal motor angle

    if richness.presliding:
        stiffness = s.coulomb / (span(richness.presliding, draw["presliding"][0]) * at_axis)
        damping = 2.0 * span((0.2, 0.6), draw["presliding"][1]) * np.sqrt(stiffness * load)
        free = s.presliding_stiffness == 0.0
        s.presliding_stiffness[free], s.presliding_damping[free] = stiffness[free], damping[free]
    if richness.compliance_hz:
        stiffness = (2.0 * math.pi * span(richness.compliance_hz, draw["compliance"][0])) ** 2 * load
        damping = 2.0 * span((0.04, 0.08), draw["compliance"][1]) * np.sqrt(stiffness * load)
        free = (s.stiffness == 0.0) & (s.gap == 0.0)
        s.stiffness[free], s.damping[free] = stiffness[free], damping[free]
    if richness.cogging:
        s.cogging += span(richness.cogging, draw["cogging"][0]) * s.coulomb * s.ratio
        s.cogging_n[:] = np.floor(span((6, 15), draw["cogging"][1]))
        s.cogging_phase[:] = 2.0 * math.pi * draw["cogging"][2]
    if richness.stribeck:
        free = s.stribeck_excess == 0.0
        s.stribeck_excess[free] = (span(richness.stribeck, draw["stribeck"][0]) * s.coulomb)[free]
        s.stribeck_velocity[free] = (span((1e-3, 4e-3), draw["stribeck"][1]) * at_axis)[free]
