"""Motors, drive trains and loads of the five axes between two control ticks: RK4 at constant voltage.

State rows [axis]: QM VM motor-side position and speed (in axis units), Q V load, CURRENT, F FD frame deflection and speed, B BD
displacement and speed of the bed.
    L i' = u - R i - Ke w                      w = motor speed at its encoder
    m_m VM' = Kt i / r + ripple / r - P        P = drive-train force; a rigid axis has m_m on the load and no P
    m_l V' = P - viscous - friction - constant - gravity + disturbance - mass_c x acceleration of the other axis
    FD' = ratio V' - 2 zeta w FD - w^2 F
    (M + m_l) BD' + m_l V' = -c BD - k B     structural mode: a bed of mass M on mounts k, c; then m_l (V' + BD') in place of m_l V',
                                             while the rotor turns relative to the bed
A and C share the mass matrix of tilting_pair.py; rotors and added inertia are diagonal terms.
Drive train: d = QM + ahead(QM) - Q with the transmission error `ahead`, which on a rigid axis appears only at the motor encoder;
e = deflection beyond the edge of the gap:
    P = k e + k3 e^3 + soft k clip(d, +-gap/2) + damping (VM - V) [without soft only in contact]
Friction of the load, exact stick-slip, or a bristle if the axis has pre-sliding:
    level        F(v, q) = Coulomb (1 + fraction sin(k q)) (1 + warming) + excess exp(-(v / velocity)^2)
    stick-slip   force = clip(-(v / h + a) m, -F, F): brings the free motion v + h a to rest in a step h; the exact level while sliding, and no creep
    bristle      z' = v - stiffness |v| z / F,  force = -(stiffness z + damping z'), integrated exactly over a step of constant v, because at rapid
                 speed it saturates much faster than any step: z -> zs + (z - zs) e^-x, mean z = zs + (z - zs)(1 - e^-x)/x,
                 zs = F sign(v) / stiffness, x = stiffness |v| h / F
Friction is constant over a step and computed at its start from the free acceleration. Units SI at the axis (N, m, s; Nm, rad, s).
Source: effects.md; ordinary mechanics; the exact step is the linear ODE's solution.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .compiled import compiled
from .parameters import Settings, load_of
from .tilting_pair import pair_terms

QM, VM, Q, V, CURRENT, F, FD, B, BD = range(9)
STATES = 9
A, C = 3, 4
DEAD_TIME_A = 0.2  # current scale of the voltage lost to an inverter's dead time
CONTACT_HZ, CONTACT_DAMPING_RATIO = 450.0, 0.3  # effects.md, default of backlash


def mechanics_values(s: Settings) -> dict[str, Any]:
    """Fields of the axis records, from settings after effects and richness; adds the default contact of backlash. SI at the axis, electrics at the motor."""
    inertia = load_of(s)
    stiffness, damping = s.stiffness.copy(), s.damping.copy()
    for k in np.flatnonzero(s.gap):
        reduced = s.motor_mass[k] * inertia[k] / (s.motor_mass[k] + inertia[k])
        contact = s.contact_stiffness[k] or (2 * math.pi * CONTACT_HZ) ** 2 * reduced
        contact_damping = s.contact_damping[k] or 2 * CONTACT_DAMPING_RATIO * math.sqrt(contact * reduced)
        # gap contact and spring of one axis are in series
        in_series = stiffness[k] > 0.0
        stiffness[k] = 1 / (1 / contact + 1 / stiffness[k]) if in_series else contact
        damping[k] = min(damping[k], contact_damping) if in_series else contact_damping
    stiffness = np.where((s.soft_gap > 0) & (stiffness == 0), (2 * math.pi * 200.0) ** 2 * inertia, stiffness)
    load_mass = s.load_mass + s.added_mass
    steady = s.constant_force.copy()
    steady[2] += load_mass[2] * s.gravity
    return {
        "saturation": np.where(s.saturation_a > 0, 1 / np.where(s.saturation_a > 0, s.saturation_a, 1.0) ** 2, 0.0),  # 1/A^2
        "load_mass": load_mass,  # A, C: what comes on top of the pair's diagonal
        "elastic": stiffness > 0,  # motor and load are two masses
        "stiffness": stiffness,
        "damping": damping,
        "hardening": s.hardening * stiffness,  # coefficient of the cube of the deflection
        "half_gap": (s.gap + s.soft_gap) / 2,
        "soft": np.where(s.soft_gap > 0, s.soft_share, 0.0),
        "steady_force": steady,  # constant force and weight of Z, against +q
        "zero_kept": s.zero_kept,  # the motor encoder keeps its zero from run to run; otherwise lead and cyclic error start at zero
        "on_bed": np.where(s.bed_mass > 0, inertia, 0.0),  # mass of the load on the bed at A = C = 0
        "warming_time": np.where(s.warming_time > 0, s.warming_time, 1.0),
    }


@compiled(inline=True)
def friction_level(axis: Any, warm: float, q: float, v: float) -> float:
    """F(v, q) of the module's docstring, at least 0; `warm` is 1 + warming."""
    level = axis.coulomb * warm
    if axis.friction_wave != 0.0:
        level *= 1.0 + axis.friction_wave * math.sin(axis.friction_wave_number * q)
    if axis.stribeck_excess != 0.0:
        x = v / axis.stribeck_velocity
        if abs(x) < 6.0:
            level += axis.stribeck_excess * math.exp(-x * x)
    return max(level, 0.0)


@compiled(inline=True)
def stick_slip_force(level: float, v: float, free_acceleration: float, mass: float, step: float) -> float:
    """Friction force of the implicit Coulomb law over one step."""
    force = -(v / step + free_acceleration) * mass
    return min(max(force, -level), level)


@compiled(inline=True)
def bristle_force(level: float, stiffness: float, damping: float, z: float, v: float, step: float) -> tuple[float, float]:
    """(mean force over the step, z at its end)."""
    if level <= 0.0:
        return 0.0, 0.0
    x = stiffness * abs(v) * step / level
    if x < 1e-6:
        z_end = z + v * step
        z_mean = z + 0.5 * v * step
    else:
        steady = level / stiffness * (1.0 if v > 0.0 else -1.0)
        decay = math.exp(-x)
        z_end = steady + (z - steady) * decay
        z_mean = steady + (z - steady) * (1.0 - decay) / x
    return -(stiffness * z_mean + damping * (z_end - z) / step), z_end


@compiled(inline=True)
def drive_force(axis: Any, d: float, speed: float) -> float:
    """Force P of the drive train at deflection d and speed difference."""
    edge, stiffness = math.copysign(axis.half_gap, d), axis.stiffness
    if abs(d) > axis.half_gap:
        e = d - edge
        return stiffness * e + axis.hardening * e * e * e + axis.soft * stiffness * edge + axis.damping * speed
    if axis.soft == 0.0:
        return 0.0
    return axis.soft * stiffness * d + axis.damping * speed


@compiled(inline=True)
def ahead(axis: Any, q: float, q0: float) -> float:
    """Lead of the load over the motor side by lead and cyclic error, relative to the value at q0 unless the zero is kept."""
    start = 1.0 - axis.zero_kept
    error = axis.lead * (q - start * q0)
    if axis.cyclic != 0.0:
        error += axis.cyclic * (math.sin(q / axis.ratio + axis.cyclic_phase) - start * math.sin(q0 / axis.ratio + axis.cyclic_phase))
    return error


@compiled(inline=True)
def ahead_slope(axis: Any, q: float) -> float:
    """d ahead / d q."""
    slope = axis.lead
    if axis.cyclic != 0.0:
        slope += axis.cyclic / axis.ratio * math.cos(q / axis.ratio + axis.cyclic_phase)
    return slope


@compiled(inline=True)
def motor_position(axis: Any, q: float, q0: float) -> float:
    """Motor encoder in axis units: the rotor's position on an elastic axis, load position minus `ahead` on a rigid one."""
    return q if axis.elastic != 0.0 else q - ahead(axis, q, q0)


@compiled(inline=True)
def motor_speed(axis: Any, q: float, v: float) -> float:
    """Motor speed [rad/s]: time derivative of motor_position, divided by r."""
    return v / axis.ratio if axis.elastic != 0.0 else (1.0 - ahead_slope(axis, q)) * v / axis.ratio


@compiled(inline=True)
def bed_follows(axis: Any) -> float:
    """Acceleration of the bed against that of the load, with its mounts left out: m_l / (M + m_l); 0 without a structural mode."""
    return axis.on_bed / (axis.bed_mass + axis.on_bed) if axis.bed_mass != 0.0 else 0.0


@compiled(inline=True)
def felt_mass(axis: Any) -> float:
    """Diagonal mass that a force on the load accelerates; on A and C what comes on top of the pair. A bed that gives way takes its part."""
    mass = axis.load_mass if axis.elastic != 0.0 else axis.load_mass + axis.motor_mass
    return mass - bed_follows(axis) * axis.on_bed


@compiled()
def motor_torque(axis: Any, current: float, q: float, q0: float) -> float:
    """Torque at the rotor [Nm]: Kt i with saturation, plus ripple and cogging."""
    torque = axis.kt * current
    if axis.saturation != 0.0:
        torque /= math.sqrt(1.0 + axis.saturation * current * current)
    if axis.ripple != 0.0 or axis.cogging != 0.0:
        angle = motor_position(axis, q, q0) / axis.ratio
        torque += axis.ripple * math.sin(axis.ripple_n * angle + axis.ripple_phase)
        torque += axis.cogging * math.sin(axis.cogging_n * angle + axis.cogging_phase)
    return torque


@compiled()
def slopes(m, pair, coupling, y, dy, voltage, friction, time, other, q0):  # type: ignore[no-untyped-def]
    """Write the time derivative of y to dy; returns the A/C mass matrix (Maa, Mac, Mcc) with rotors.

    friction [axis]: friction force of this step; time: this instant, for external forces; other [axis]: load accelerations of the
    previous step, for the coupling of axes."""
    for k in range(5):
        axis = m[k]
        force = motor_torque(axis, y[CURRENT, k], y[QM, k], q0[k]) / axis.ratio
        w = motor_speed(axis, y[QM, k], y[VM, k])
        current = y[CURRENT, k]
        u = voltage[k] - axis.resistance * current - axis.ke * w
        if axis.dead_time_v != 0.0:
            u -= axis.dead_time_v * math.tanh(current / DEAD_TIME_A)
        dy[CURRENT, k] = u / axis.inductance
        v = y[V, k]
        if axis.elastic != 0.0:
            deflection = y[QM, k] + ahead(axis, y[QM, k], q0[k]) - y[Q, k]
            drive = drive_force(axis, deflection, (1.0 + ahead_slope(axis, y[QM, k])) * y[VM, k] - v)
            dy[VM, k] = (force - drive) / axis.motor_mass
            force = drive
        drag = axis.viscous * v + axis.windage * v * abs(v)
        if axis.asymmetry != 0.0:
            drag += axis.viscous * axis.asymmetry * abs(v)
        shaking = axis.disturbance * math.sin(axis.disturbance_w * time) if axis.disturbance != 0.0 else 0.0
        force += friction[k] + shaking - drag - axis.steady_force
        for j in range(5):
            if coupling[k, j] != 0.0:
                force -= coupling[k, j] * other[j]
        if axis.bed_mass != 0.0:
            force += bed_follows(axis) * (axis.mount_stiffness * y[B, k] + axis.mount_damping * y[BD, k])
        dy[V, k] = force  # a force for now
        dy[QM, k], dy[Q, k] = y[VM, k], v
    for k in range(3):
        dy[V, k] /= felt_mass(m[k])
    maa, mac, mcc, ha, hc = pair_terms(pair, y[Q, A], y[Q, C], y[V, A], y[V, C])
    maa += felt_mass(m[A])
    mcc += felt_mass(m[C])
    qa, qc = dy[V, A] - ha, dy[V, C] - hc
    det = maa * mcc - mac * mac
    dy[V, A], dy[V, C] = (mcc * qa - mac * qc) / det, (maa * qc - mac * qa) / det
    for k in range(5):
        axis = m[k]
        if axis.elastic == 0.0:
            dy[VM, k] = dy[V, k]
        if axis.frame_ratio != 0.0:
            w = axis.frame_w
            dy[F, k] = y[FD, k]
            dy[FD, k] = axis.frame_ratio * dy[V, k] - 2.0 * axis.frame_zeta * w * y[FD, k] - w * w * y[F, k]
        if axis.bed_mass != 0.0:
            mounts = axis.mount_stiffness * y[B, k] + axis.mount_damping * y[BD, k]
            dy[B, k] = y[BD, k]
            dy[BD, k] = -(mounts + axis.on_bed * dy[V, k]) / (axis.bed_mass + axis.on_bed)
    return maa, mac, mcc


@compiled()
def find_friction(m, y, dy, friction, z, warm, step, maa, mac, mcc, level, free):  # type: ignore[no-untyped-def]
    """Friction forces for the coming step, from the slopes dy without friction; adds their accelerations to dy."""
    det = maa * mcc - mac * mac
    for k in range(5):
        axis = m[k]
        free[k] = dy[V, k]
        level[k] = friction_level(axis, warm[k], y[Q, k], y[V, k])
        friction[k] = 0.0
        if axis.presliding_stiffness != 0.0:
            friction[k], z[k] = bristle_force(level[k], axis.presliding_stiffness, axis.presliding_damping, z[k], y[V, k], step)
    # A and C are coupled by Mac: a few iterations converge, as Mac^2 / (Maa Mcc) is below 1 %
    for _ in range(4):
        for k in range(5):
            if m[k].presliding_stiffness == 0.0:
                mass, alone = felt_mass(m[k]), dy[V, k]
                if k == A:
                    mass, alone = det / mcc, dy[V, A] - mac / det * friction[C]
                elif k == C:
                    mass, alone = det / maa, dy[V, C] - mac / det * friction[A]
                friction[k] = stick_slip_force(level[k], y[V, k], alone, mass, step)
        if mac == 0.0:
            break
    for k in range(3):
        dy[V, k] += friction[k] / felt_mass(m[k])
    dy[V, A] += (mcc * friction[A] - mac * friction[C]) / det
    dy[V, C] += (maa * friction[C] - mac * friction[A]) / det
    for k in range(5):
        axis = m[k]
        if axis.elastic == 0.0:
            dy[VM, k] = dy[V, k]
        dy[FD, k] += axis.frame_ratio * (dy[V, k] - free[k])
        dy[BD, k] -= bed_follows(axis) * (dy[V, k] - free[k])


@compiled(inline=True)
def move(y, slope, by, out):  # type: ignore[no-untyped-def]
    """out = y + by slope."""
    for r in range(STATES):
        for k in range(5):
            out[r, k] = y[r, k] + by * slope[r, k]


@compiled()
def advance(m, pair, coupling, y, z, other, voltage, warm, q0, time, step, steps, work):  # type: ignore[no-untyped-def]
    """Advance y and z by `steps` RK4 steps of `step` seconds; work [6, STATES, axis] is scratch memory."""
    k1, k2, k3, k4, mid = work[0], work[1], work[2], work[3], work[4]
    friction, none, level, free = work[5, 0], work[5, 1], work[5, 2], work[5, 3]
    none[:] = 0.0
    for n in range(steps):
        t = time + n * step
        maa, mac, mcc = slopes(m, pair, coupling, y, k1, voltage, none, t, other, q0)
        find_friction(m, y, k1, friction, z, warm, step, maa, mac, mcc, level, free)
        move(y, k1, 0.5 * step, mid)
        slopes(m, pair, coupling, mid, k2, voltage, friction, t + 0.5 * step, other, q0)
        move(y, k2, 0.5 * step, mid)
        slopes(m, pair, coupling, mid, k3, voltage, friction, t + 0.5 * step, other, q0)
        move(y, k3, step, mid)
        slopes(m, pair, coupling, mid, k4, voltage, friction, t + step, other, q0)
        for r in range(STATES):
            for k in range(5):
                y[r, k] += step / 6.0 * (k1[r, k] + 2.0 * k2[r, k] + 2.0 * k3[r, k] + k4[r, k])
        for k in range(5):
            other[k] = k4[V, k]
