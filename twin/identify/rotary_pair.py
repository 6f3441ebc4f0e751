"""Torque balance of the tilting pair A, C: inertias, first moments and friction from the data alone.

A turns about x, C about the table's normal z. Moments of all that turns with C are in the table frame, about the intersection of C and A:

    A: Maa A" + Mac C" + Maa' A' C' + Mac' C'^2 + g (cos A (gy + mx sin C + my cos C) - sin A gz) + friction = Kt i / r
    C: Mcc C" + Mac A" - 1/2 Maa' A'^2 + g sin A (mx cos C - my sin C) + friction = Kt i / r
    Maa = Maa0 + b (cos 2C - 1) + s sin 2C,   Mac = -zx cos C + zy sin C,   ' = d/dC

twin.exam.plant.tilting_pair contains the derivation; the twin itself simulates the bodies. The balance is linear in the ten inertial
values PAIR, four values of friction and two of skew. One regression on the rows of both motors, weighted by their scatter, finds them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.estimate.regression import regress
from twin.identify.axis_run import AxisRun
from twin.identify.drive_balance import FRICTIONS, Balance, MeanCurrent, Rows, sliding_rows, stacked
from twin.machine.machine import Body, Machine

BODIES = ("cradle", "table", "workpiece")
PAIR = ("inertia_A", "inertia_C", "moment_y", "moment_z", "table_x", "table_y", "unequal", "deviation_xy", "deviation_zx", "deviation_zy")
NAMES = (*PAIR, *(f"{name}_{axis}" for axis in "AC" for name in FRICTIONS), "skew_A", "skew_C")
"""inertia: total at the axis, rotor included, at A = C = 0 [kg m2]; moment_y, _z: first moments about A at C = 0 of the parts that do not
turn with C [kg m]; table_x, _y: first moments about C [kg m]; unequal, deviation: second moments [kg m2]; friction at the axis;
skew: inertia times the time skew between current and motion, see drive_balance [kg m2 s]."""


def has_pair(machine: Machine) -> bool:
    """Is this a tilting table of cradle, table and workpiece on axes A and C?"""
    return {"A", "C"} <= set(machine.axis_names) and {*BODIES} <= {b.name for b in machine.bodies}


def pair_numbers(machine: Machine) -> np.ndarray:
    """The ten PAIR values (10,) of a machine, in closed form from its bodies and rotors."""
    bodies = {b.name: b for b in machine.bodies}
    oy, oz = (float(machine.geometry.get(f"a_axis_to_c_axis_{k}_m", 0.0)) for k in "yz")

    def about_c(b: Body) -> np.ndarray:
        x, y, z = b.centre_of_mass_m
        z += oz
        m, (i1, i2, i3) = b.mass_kg, b.inertia_kg_m2
        maa = m * ((y + oy) ** 2 + z**2) + i1
        mcc = m * (x * x + y * y) + i3
        return np.array([maa, mcc, m * oy, m * z, m * x, m * y, 0.5 * (m * (y * y - x * x) + i1 - i2), m * x * y, m * z * x, m * z * y])

    cradle = bodies["cradle"]
    _, y, z = cradle.centre_of_mass_m
    y, z, m = y + oy, z + oz, cradle.mass_kg
    own = np.array([m * (y * y + z * z) + cradle.inertia_kg_m2[0], 0.0, m * y, m * z, *np.zeros(6)])
    rotors = np.array([machine.axis("A").reflected_inertia, machine.axis("C").reflected_inertia, *np.zeros(8)])
    return own + about_c(bodies["table"]) + about_c(bodies["workpiece"]) + rotors


def pair_rows(machine: Machine, a: AxisRun, c: AxisRun, currents: tuple[np.ndarray, np.ndarray]) -> tuple[Rows, Rows]:
    """Rows of both motors of one run, where the axis of the row slides; torques at the axes [Nm]."""
    g = machine.gravity
    oy = float(machine.geometry.get("a_axis_to_c_axis_y_m", 0.0))
    axes = (machine.axis("A"), machine.axis("C"))
    n = min(len(a.speed), len(c.speed))
    cut = ("start", "axis_position", "speed", "acceleration", "limited", "known_load")
    a, c = (replace(r, **{k: getattr(r, k)[:n] for k in cut}) for r in (a, c))
    (va, aa), (vc, ac) = ((r.speed * x.ratio, r.acceleration * x.ratio) for r, x in zip((a, c), axes))
    sa, ca = np.sin(a.axis_position), np.cos(a.axis_position)
    sc, cc = np.sin(c.axis_position), np.cos(c.axis_position)
    s2, c2 = 2.0 * sc * cc, cc * cc - sc * sc
    zero = np.zeros(n)
    on_a = [
        aa, zero, g * ca, -g * sa,
        g * ca * sc + 2.0 * oy * (sc * aa + cc * va * vc),
        g * ca * cc + 2.0 * oy * ((cc - 1.0) * aa - sc * va * vc),
        (c2 - 1.0) * aa - 2.0 * s2 * va * vc, s2 * aa + 2.0 * c2 * va * vc,
        -cc * ac + sc * vc * vc, sc * ac + cc * vc * vc,
    ]  # fmt: skip
    on_c = [
        zero, ac, zero, zero,
        g * sa * cc - oy * cc * va * va, -g * sa * sc + oy * sc * va * va,
        s2 * va * va, -c2 * va * va, -cc * aa, sc * aa,
    ]  # fmt: skip
    out = []
    for k, (run, axis, columns) in enumerate(zip((a, c), axes, (on_a, on_c))):
        own = [zero] * 6
        own[2 * k], own[2 * k + 1], own[4 + k] = run.sliding_sign, (va, vc)[k], run.jerk * axis.ratio
        f = run.filtered
        torque = (currents[k][:n] * axis.motor.torque_constant_nm_per_a + run.known_load) / axis.ratio
        out.append(sliding_rows(run, np.column_stack([f(x) for x in (*columns, *own)]), f(torque)))
    return out[0], out[1]


def fit_pair(machine: Machine, runs: Sequence[tuple[AxisRun, AxisRun]], current: tuple[MeanCurrent, MeanCurrent]) -> Balance | None:
    """Balance by NAMES on the rows of both motors, weighted by the scatter of each motor's rows. None without usable rows."""
    known = [(a, c, i, j) for a, c in runs if (i := current[0].of(a)) is not None and (j := current[1].of(c)) is not None]
    both = [pair_rows(machine, a, c, (i, j)) for a, c, i, j in known]
    if sum(len(of_motor.y) for of_run in both for of_motor in of_run) < 50:
        return None
    rows, parts = [stacked(of_motor) for of_motor in zip(*both)], []
    for k, one in enumerate(rows):  # weighted by their scatter, from a fit of each motor alone
        alone = regress(one.columns, one.y, one.clusters) if len(one.y) > 30 else None
        weight = 1.0 / max(float(np.std(alone.residual)), 1e-6) if alone is not None else 1.0
        parts.append((one.columns * weight, one.y * weight, one.clusters + 10_000_000 * k))
    fit = regress(*map(np.concatenate, zip(*parts)))
    covariance = fit.covariance.copy()
    for k, (name, m) in enumerate(zip(("A", "C"), current)):
        covariance[k, k] += (m.inertia_deviation / machine.axis(name).ratio ** 2) ** 2
    return Balance(NAMES, replace(fit, covariance=covariance), dict(zip("AC", rows)))
