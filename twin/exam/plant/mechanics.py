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
Friction is constant over a step and computed at its start from the free acceleration (friction.py). Units SI at the axis.
Source: effects.md; ordinary mechanics.
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import compiled
from .friction import bristle_force, friction_level, stick_slip_force
from .tilting_pair import pair_terms

QM, VM, Q, V, CURRENT, F, FD, B, BD = range(9)
STATES = 9
A, C = 3, 4
DEAD_TIME_A = 0.2  # current scale of the voltage lost to an inverter's dead time

# Rows of the parameter table `m` [row, axis], SI at the axis, electrics at the motor. It is one array, because passing forty
# arrays to a compiled function takes longer than the mechanics.
(
    RATIO,
    KT,
    SATURATION,  # 1/A^2
    DEAD_TIME,  # V against the current
    KE,
    RESISTANCE,
    INDUCTANCE,
    MOTOR_MASS,
    LOAD_MASS,  # A, C: load mass is what comes on top of the pair's diagonal
    ELASTIC,  # 1: motor and load are two masses
    STIFFNESS,
    DAMPING,
    HARDENING,  # coefficient of the cube of the deflection
    HALF_GAP,
    SOFT,
    VISCOUS,
    ASYMMETRY,
    WINDAGE,  # N s2/m2
    COULOMB,  # this and the next four: level of the dry friction
    WAVE,
    WAVE_NUMBER,
    EXCESS,
    VELOCITY,
    BRISTLE,  # stiffness; 0: exact stick-slip
    BRISTLE_DAMPING,
    STEADY_FORCE,  # constant force and weight of Z, against +q
    DISTURBANCE,
    DISTURBANCE_W,
    FRAME_W,
    FRAME_ZETA,
    FRAME_RATIO,
    RIPPLE,  # Nm at the motor
    RIPPLE_N,  # periods a turn
    RIPPLE_PHASE,
    COGGING,  # Nm at the motor
    COGGING_N,  # periods a turn
    COGGING_PHASE,
    LEAD,
    CYCLIC,
    CYCLIC_PHASE,
    ZERO_KEPT,  # 1: the motor encoder keeps its zero from run to run, 0: lead and cyclic error start at zero in each run
    BED,  # structural mode: mass M of the bed, 0 without one
    MOUNT,  # stiffness of its mounts
    MOUNT_DAMPING,
    ON_BED,  # mass of the load on the bed at A = C = 0
) = range(45)


@compiled(inline=True)
def drive_force(m: np.ndarray, k: int, d: float, speed: float) -> float:
    """Force P of the drive train of axis k at deflection d and speed difference."""
    half, stiffness = m[HALF_GAP, k], m[STIFFNESS, k]
    if d > half:
        e = d - half
        return stiffness * e + m[HARDENING, k] * e * e * e + m[SOFT, k] * stiffness * half + m[DAMPING, k] * speed
    if d < -half:
        e = d + half
        return stiffness * e + m[HARDENING, k] * e * e * e - m[SOFT, k] * stiffness * half + m[DAMPING, k] * speed
    if m[SOFT, k] == 0.0:
        return 0.0
    return m[SOFT, k] * stiffness * d + m[DAMPING, k] * speed


@compiled(inline=True)
def ahead(m: np.ndarray, k: int, q: float, q0: float) -> float:
    """Lead of the load over the motor side by lead and cyclic error, relative to the value at q0 unless the zero is kept."""
    start = 1.0 - m[ZERO_KEPT, k]
    error = m[LEAD, k] * (q - start * q0)
    if m[CYCLIC, k] != 0.0:
        error += m[CYCLIC, k] * (math.sin(q / m[RATIO, k] + m[CYCLIC_PHASE, k]) - start * math.sin(q0 / m[RATIO, k] + m[CYCLIC_PHASE, k]))
    return error


@compiled(inline=True)
def ahead_slope(m: np.ndarray, k: int, q: float) -> float:
    """d ahead / d q."""
    slope = m[LEAD, k]
    if m[CYCLIC, k] != 0.0:
        slope += m[CYCLIC, k] / m[RATIO, k] * math.cos(q / m[RATIO, k] + m[CYCLIC_PHASE, k])
    return slope


@compiled(inline=True)
def motor_position(m: np.ndarray, k: int, q: float, q0: float) -> float:
    """Motor encoder in axis units: the rotor's position on an elastic axis, load position minus `ahead` on a rigid one."""
    return q if m[ELASTIC, k] != 0.0 else q - ahead(m, k, q, q0)


@compiled(inline=True)
def motor_speed(m: np.ndarray, k: int, q: float, v: float) -> float:
    """Motor speed [rad/s]: time derivative of motor_position, divided by r."""
    return v / m[RATIO, k] if m[ELASTIC, k] != 0.0 else (1.0 - ahead_slope(m, k, q)) * v / m[RATIO, k]


@compiled(inline=True)
def bed_follows(m: np.ndarray, k: int) -> float:
    """Acceleration of the bed against that of the load, with its mounts left out: m_l / (M + m_l); 0 without a structural mode."""
    return m[ON_BED, k] / (m[BED, k] + m[ON_BED, k]) if m[BED, k] != 0.0 else 0.0


@compiled(inline=True)
def felt_mass(m: np.ndarray, k: int) -> float:
    """Diagonal mass that a force on the load accelerates; on A and C what comes on top of the pair. A bed that gives way takes its part."""
    mass = m[LOAD_MASS, k] if m[ELASTIC, k] != 0.0 else m[LOAD_MASS, k] + m[MOTOR_MASS, k]
    return mass - bed_follows(m, k) * m[ON_BED, k]


@compiled()
def motor_torque(m: np.ndarray, k: int, y: np.ndarray, q0: np.ndarray) -> float:
    """Torque at the rotor [Nm]: Kt i with saturation, plus ripple and cogging."""
    current = y[CURRENT, k]
    torque = m[KT, k] * current
    if m[SATURATION, k] != 0.0:
        torque /= math.sqrt(1.0 + m[SATURATION, k] * current * current)
    if m[RIPPLE, k] != 0.0 or m[COGGING, k] != 0.0:
        angle = motor_position(m, k, y[QM, k], q0[k]) / m[RATIO, k]
        torque += m[RIPPLE, k] * math.sin(m[RIPPLE_N, k] * angle + m[RIPPLE_PHASE, k])
        torque += m[COGGING, k] * math.sin(m[COGGING_N, k] * angle + m[COGGING_PHASE, k])
    return torque


@compiled()
def slopes(
    m: np.ndarray,
    pair: np.ndarray,
    coupling: np.ndarray,
    y: np.ndarray,
    dy: np.ndarray,
    voltage: np.ndarray,
    friction: np.ndarray,
    shaking: np.ndarray,
    other: np.ndarray,
    q0: np.ndarray,
) -> tuple[float, float, float]:
    """Write the time derivative of y to dy; returns the A/C mass matrix (Maa, Mac, Mcc) with rotors.

    friction [axis]: friction force of this step; shaking [axis]: external force at this instant; other [axis]: load accelerations of
    the previous step, for the coupling of axes."""
    for k in range(5):
        force = motor_torque(m, k, y, q0) / m[RATIO, k]
        w = motor_speed(m, k, y[QM, k], y[VM, k])
        current = y[CURRENT, k]
        u = voltage[k] - m[RESISTANCE, k] * current - m[KE, k] * w
        if m[DEAD_TIME, k] != 0.0:
            u -= m[DEAD_TIME, k] * math.tanh(current / DEAD_TIME_A)
        dy[CURRENT, k] = u / m[INDUCTANCE, k]
        v = y[V, k]
        if m[ELASTIC, k] != 0.0:
            deflection = y[QM, k] + ahead(m, k, y[QM, k], q0[k]) - y[Q, k]
            drive = drive_force(m, k, deflection, (1.0 + ahead_slope(m, k, y[QM, k])) * y[VM, k] - v)
            dy[VM, k] = (force - drive) / m[MOTOR_MASS, k]
            force = drive
        drag = m[VISCOUS, k] * v + m[WINDAGE, k] * v * abs(v)
        if m[ASYMMETRY, k] != 0.0:
            drag += m[VISCOUS, k] * m[ASYMMETRY, k] * abs(v)
        force += friction[k] + shaking[k] - drag - m[STEADY_FORCE, k]
        for j in range(5):
            if coupling[k, j] != 0.0:
                force -= coupling[k, j] * other[j]
        if m[BED, k] != 0.0:
            force += bed_follows(m, k) * (m[MOUNT, k] * y[B, k] + m[MOUNT_DAMPING, k] * y[BD, k])
        dy[V, k] = force  # a force for now
        dy[QM, k], dy[Q, k] = y[VM, k], v
    for k in range(3):
        dy[V, k] /= felt_mass(m, k)
    maa, mac, mcc, ha, hc = pair_terms(pair, y[Q, A], y[Q, C], y[V, A], y[V, C])
    maa += felt_mass(m, A)
    mcc += felt_mass(m, C)
    qa, qc = dy[V, A] - ha, dy[V, C] - hc
    det = maa * mcc - mac * mac
    dy[V, A], dy[V, C] = (mcc * qa - mac * qc) / det, (maa * qc - mac * qa) / det
    for k in range(5):
        if m[ELASTIC, k] == 0.0:
            dy[VM, k] = dy[V, k]
        if m[FRAME_RATIO, k] != 0.0:
            w = m[FRAME_W, k]
            dy[F, k] = y[FD, k]
            dy[FD, k] = m[FRAME_RATIO, k] * dy[V, k] - 2.0 * m[FRAME_ZETA, k] * w * y[FD, k] - w * w * y[F, k]
        if m[BED, k] != 0.0:
            mounts = m[MOUNT, k] * y[B, k] + m[MOUNT_DAMPING, k] * y[BD, k]
            dy[B, k] = y[BD, k]
            dy[BD, k] = -(mounts + m[ON_BED, k] * dy[V, k]) / (m[BED, k] + m[ON_BED, k])
    return maa, mac, mcc


@compiled()
def find_friction(
    m: np.ndarray,
    y: np.ndarray,
    dy: np.ndarray,
    friction: np.ndarray,
    z: np.ndarray,
    warm: np.ndarray,
    step: float,
    maa: float,
    mac: float,
    mcc: float,
    free: np.ndarray,
) -> None:
    """Friction forces for the coming step, from the slopes dy without friction; adds their accelerations to dy."""
    det = maa * mcc - mac * mac
    for k in range(5):
        free[k] = dy[V, k]
        v = y[V, k]
        level = friction_level(m[COULOMB, k] * warm[k], m[WAVE, k], m[WAVE_NUMBER, k], m[EXCESS, k], m[VELOCITY, k], y[Q, k], v)
        friction[k] = level  # the level for now
        if m[BRISTLE, k] != 0.0:
            friction[k], z[k] = bristle_force(level, m[BRISTLE, k], m[BRISTLE_DAMPING, k], z[k], v, step)
    for k in range(3):
        mass = felt_mass(m, k)
        if m[BRISTLE, k] == 0.0:
            friction[k] = stick_slip_force(friction[k], y[V, k], dy[V, k], mass, step)
        dy[V, k] += friction[k] / mass
    # A and C are coupled by Mac: a few iterations converge, as Mac^2 / (Maa Mcc) is below 1 %
    level_a, level_c = friction[A], friction[C]
    force_a, force_c = 0.0, 0.0
    if m[BRISTLE, A] != 0.0:
        force_a = friction[A]
    if m[BRISTLE, C] != 0.0:
        force_c = friction[C]
    for _ in range(4):
        if m[BRISTLE, A] == 0.0:
            force_a = stick_slip_force(level_a, y[V, A], dy[V, A] - mac / det * force_c, det / mcc, step)
        if m[BRISTLE, C] == 0.0:
            force_c = stick_slip_force(level_c, y[V, C], dy[V, C] - mac / det * force_a, det / maa, step)
        if mac == 0.0:
            break
    friction[A], friction[C] = force_a, force_c
    dy[V, A] += (mcc * force_a - mac * force_c) / det
    dy[V, C] += (maa * force_c - mac * force_a) / det
    for k in range(5):
        if m[ELASTIC, k] == 0.0:
            dy[VM, k] = dy[V, k]
        dy[FD, k] += m[FRAME_RATIO, k] * (dy[V, k] - free[k])
        dy[BD, k] -= bed_follows(m, k) * (dy[V, k] - free[k])


@compiled()
def advance(
    m: np.ndarray,
    pair: np.ndarray,
    coupling: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    other: np.ndarray,
    voltage: np.ndarray,
    warm: np.ndarray,
    q0: np.ndarray,
    time: float,
    step: float,
    steps: int,
    work: np.ndarray,
) -> None:
    """Advance y and z by `steps` RK4 steps of `step` seconds; work [8, STATES, axis] is scratch memory."""
    k1, k2, k3, k4, mid = work[0], work[1], work[2], work[3], work[4]
    friction, shake, none = work[5, 0], work[5, 1], work[5, 2]
    shake_mid, shake_end = work[6, 0], work[6, 1]
    for n in range(steps):
        t = time + n * step
        for k in range(5):
            none[k] = 0.0
            if m[DISTURBANCE, k] != 0.0:
                shake[k] = m[DISTURBANCE, k] * math.sin(m[DISTURBANCE_W, k] * t)
                shake_mid[k] = m[DISTURBANCE, k] * math.sin(m[DISTURBANCE_W, k] * (t + 0.5 * step))
                shake_end[k] = m[DISTURBANCE, k] * math.sin(m[DISTURBANCE_W, k] * (t + step))
        maa, mac, mcc = slopes(m, pair, coupling, y, k1, voltage, none, shake, other, q0)
        find_friction(m, y, k1, friction, z, warm, step, maa, mac, mcc, work[7, 0])
        for r in range(STATES):
            for k in range(5):
                mid[r, k] = y[r, k] + 0.5 * step * k1[r, k]
        slopes(m, pair, coupling, mid, k2, voltage, friction, shake_mid, other, q0)
        for r in range(STATES):
            for k in range(5):
                mid[r, k] = y[r, k] + 0.5 * step * k2[r, k]
        slopes(m, pair, coupling, mid, k3, voltage, friction, shake_mid, other, q0)
        for r in range(STATES):
            for k in range(5):
                mid[r, k] = y[r, k] + step * k3[r, k]
        slopes(m, pair, coupling, mid, k4, voltage, friction, shake_end, other, q0)
        for r in range(STATES):
            for k in range(5):
                y[r, k] += step / 6.0 * (k1[r, k] + 2.0 * k2[r, k] + 2.0 * k3[r, k] + k4[r, k])
        for k in range(5):
            other[k] = k4[V, k]
