"""Torque balance of two rotary axes of which one carries the other: inertias, first moments and friction from the data alone.

The frame of the pair: x along the outer axis, z along the inner axis when both stand at zero; its origin lies on the inner axis, at the height of
the outer axis. Moments of all that turns with the inner axis are in that frame, turned with the table. With the angles a and c of outer
and inner axis, the distance y0 of the axes, and gravity (g1, g2, g3) at zero:

    outer: Maa a" + Mac c" + Maa' a' c' + Mac' c'^2 + gy (my + tx sin c + ty cos c) + gz mz + friction = Kt i / r
    inner: Mcc c" + Mac a" - 1/2 Maa' a'^2 + g1 (tx sin c + ty cos c) - gz (tx cos c - ty sin c) + friction = Kt i / r
    Maa = Maa0 + b (cos 2c - 1) + s sin 2c + 2 y0 (tx sin c + ty (cos c - 1)),   Mac = -zx cos c + zy sin c,   ' = d/dc
    gy = g2 sin a - g3 cos a,   gz = g2 cos a + g3 sin a

twin.exam.plant.tilting_pair contains the derivation for A and C; the twin itself simulates the bodies. The balance is linear in the ten inertial
values, four values of friction and two of skew. One regression on the rows of both motors, weighted by their scatter, finds them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from twin.estimate.regression import regress
from twin.identify.axis_run import AxisRun
from twin.identify.drive_balance import FRICTIONS, Balance, MeanCurrent, Rows, sliding_rows, stacked
from twin.machine.machine import Machine
from twin.simulation.plant_spec import compile_model, remembered

FIRST_MOMENTS = ("moment_y", "moment_z", "table_x", "table_y")
MOMENTS = (*FIRST_MOMENTS, "unequal", "deviation_xy", "deviation_zx", "deviation_zy")
"""moment_y, _z: first moments about the outer axis of what it carries, at c = 0 without the share of table_y [kg m]; table_x, _y: first
moments about the inner axis [kg m]; unequal, deviation: second moments of what turns with it [kg m2]."""

SQUARE = 1e-3
"""Largest cosine of the angle between the axes of a pair."""


@dataclass(frozen=True)
class RotaryPair:
    """Two rotary axes on the frame of the machine, square to each other: the inner one is all that the outer one carries.

    `distance_m` of the axes, y0; `gravity` (3,) [m/s2] in the frame of the pair; `numbers` (10,): inertia of the outer and the inner axis with
    rotor, at zero [kg m2], and MOMENTS; `bodies`: those that turn with the pair and have a mass in the machine file.
    """

    outer: str
    inner: str
    distance_m: float
    gravity: np.ndarray
    numbers: np.ndarray
    bodies: tuple[str, ...]

    @property
    def axes(self) -> tuple[str, str]:
        return self.outer, self.inner

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the values of the balance: inertias [kg m2], MOMENTS, frictions at the axes, skew: inertia times the time skew between current and
        motion, see drive_balance [kg m2 s]."""
        frictions = (f"{name}_{axis}" for axis in self.axes for name in FRICTIONS)
        return (*(f"inertia_{axis}" for axis in self.axes), *MOMENTS, *frictions, *(f"skew_{axis}" for axis in self.axes))

    def gravity_at(self, angle: np.ndarray) -> np.ndarray:
        """gy and gz (2, angle) [m/s2] at angles of the outer axis [rad]: its torque by a first moment along y and z."""
        _, g2, g3 = self.gravity
        return np.array([g2 * np.sin(angle) - g3 * np.cos(angle), g2 * np.cos(angle) + g3 * np.sin(angle)])


@remembered
def pair_of(machine: Machine) -> RotaryPair | None:
    """The rotary pair of a machine in its present numbers; None without one."""
    rotary = [axis.name for axis in machine.axes if axis.kind == "rotary"]
    if len(rotary) < 2:
        return None
    model = compile_model(machine)
    joints = {name: model.joint(name) for name in machine.axis_names}
    below = {name: _below(model, int(joint.bodyid[0])) for name, joint in joints.items()}
    for outer in rotary:
        carried = [name for name, joint in joints.items() if name != outer and int(joint.bodyid[0]) in below[outer]]
        moved = any(int(joints[outer].bodyid[0]) in below[name] for name in machine.axis_names if name != outer)
        if len(carried) == 1 and carried[0] in rotary and not moved and below[outer] != below[carried[0]]:
            return _pair(machine, model, outer, carried[0], below[outer] - below[carried[0]], below[carried[0]])
    return None


def _below(model: mujoco.MjModel, body: int) -> frozenset[int]:
    """A body and all that it carries."""
    found = {body}
    for i in range(body + 1, model.nbody):  # a parent stands before its children
        if int(model.body_parentid[i]) in found:
            found.add(i)
    return frozenset(found)


def _pair(
    machine: Machine, model: mujoco.MjModel, outer: str, inner: str, cradle: frozenset[int], table: frozenset[int]
) -> RotaryPair | None:
    """The pair of two axes, whose bodies are `cradle` and `table`; None if the axes are not square to each other."""
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    a, c = (model.joint(name).id for name in (outer, inner))
    along_x, along_z = data.xaxis[a], data.xaxis[c]
    if abs(along_x @ along_z) > SQUARE:
        return None
    frame = np.array([along_x, np.cross(along_z, along_x), along_z])
    offset = frame @ (data.xanchor[c] - data.xanchor[a])
    origin = data.xanchor[c] - offset[2] * along_z
    numbers = np.array([machine.axis(outer).reflected_inertia, machine.axis(inner).reflected_inertia, *np.zeros(len(MOMENTS))])
    for i in cradle | table:
        x, y, z = frame @ (data.xipos[i] - origin)
        turned = frame @ data.ximat[i].reshape(3, 3)
        m, own = model.body_mass[i], turned @ np.diag(model.body_inertia[i]) @ turned.T
        about_x = m * ((y + offset[1]) ** 2 + z * z) + own[0, 0]
        if i in cradle:
            numbers += [about_x, 0.0, m * (y + offset[1]), m * z, *np.zeros(6)]
            continue
        unequal = 0.5 * (m * (y * y - x * x) + own[0, 0] - own[1, 1])
        deviations = m * x * y - own[0, 1], m * z * x - own[0, 2], m * z * y - own[1, 2]
        numbers += [about_x, m * (x * x + y * y) + own[2, 2], m * offset[1], m * z, m * x, m * y, unequal, *deviations]
    known = {model.body(i).name for i in cradle | table}
    bodies = tuple(body.name for body in machine.bodies if body.name in known)
    return RotaryPair(outer, inner, float(offset[1]), frame @ model.opt.gravity, numbers, bodies)


Motion = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Angle, speed and acceleration (row,) of an axis [rad, rad/s, rad/s2]."""


def pair_columns(pair: RotaryPair, outer: Motion, inner: Motion) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Torques of the outer and of the inner axis, each a list of ten columns (row,): those of one unit of each of the ten inertial values."""
    (a, va, aa), (c, vc, ac) = outer, inner
    sc, cc = np.sin(c), np.cos(c)
    s2, c2 = 2.0 * sc * cc, cc * cc - sc * sc
    zero, y0 = np.zeros(len(a)), pair.distance_m
    g1, (gy, gz) = pair.gravity[0], pair.gravity_at(a)
    on_outer = [
        aa, zero, gy, gz,
        gy * sc + 2.0 * y0 * (sc * aa + cc * va * vc),
        gy * cc + 2.0 * y0 * ((cc - 1.0) * aa - sc * va * vc),
        (c2 - 1.0) * aa - 2.0 * s2 * va * vc, s2 * aa + 2.0 * c2 * va * vc,
        -cc * ac + sc * vc * vc, sc * ac + cc * vc * vc,
    ]  # fmt: skip
    on_inner = [
        zero, ac, zero, zero,
        g1 * sc - gz * cc - y0 * cc * va * va, g1 * cc + gz * sc + y0 * sc * va * va,
        s2 * va * va, -c2 * va * va, -cc * aa, sc * aa,
    ]  # fmt: skip
    return on_outer, on_inner


def pair_rows(machine: Machine, pair: RotaryPair, runs: tuple[AxisRun, AxisRun], currents: tuple[np.ndarray, np.ndarray]) -> list[Rows]:
    """Rows of both motors of one run, where the axis of the row slides; torques at the axes [Nm]."""
    axes = [machine.axis(name) for name in pair.axes]
    n = min(len(run.speed) for run in runs)
    cut = ("start", "axis_position", "speed", "acceleration", "limited", "known_load")
    both = [replace(r, **{k: getattr(r, k)[:n] for k in cut}) for r in runs]
    motions = [(r.axis_position, r.speed * x.ratio, r.acceleration * x.ratio) for r, x in zip(both, axes)]
    out = []
    for k, (run, axis, columns) in enumerate(zip(both, axes, pair_columns(pair, motions[0], motions[1]))):
        own = [np.zeros(n)] * 6
        own[2 * k], own[2 * k + 1], own[4 + k] = run.sliding_sign, motions[k][1], run.jerk * axis.ratio
        f = run.filtered
        torque = (currents[k][:n] * axis.motor.torque_constant_nm_per_a + run.known_load) / axis.ratio
        out.append(sliding_rows(run, np.column_stack([f(x) for x in (*columns, *own)]), f(torque)))
    return out


def fit_pair(
    machine: Machine, pair: RotaryPair, runs: Sequence[tuple[AxisRun, AxisRun]], current: tuple[MeanCurrent, MeanCurrent]
) -> Balance | None:
    """Balance by the names of the pair on the rows of both motors, weighted by the scatter of each motor's rows. None without usable rows."""
    known = [(a, c, i, j) for a, c in runs if (i := current[0].of(a)) is not None and (j := current[1].of(c)) is not None]
    both = [pair_rows(machine, pair, (a, c), (i, j)) for a, c, i, j in known]
    if sum(len(of_motor.y) for of_run in both for of_motor in of_run) < 50:
        return None
    rows, parts = [stacked(of_motor) for of_motor in zip(*both)], []
    for k, one in enumerate(rows):  # weighted by their scatter, from a fit of each motor alone
        alone = regress(one.columns, one.y, one.clusters) if len(one.y) > 30 else None
        weight = 1.0 / max(float(np.std(alone.residual)), 1e-6) if alone is not None else 1.0
        parts.append((one.columns * weight, one.y * weight, one.clusters + 10_000_000 * k))
    fit = regress(*map(np.concatenate, zip(*parts)))
    covariance = fit.covariance.copy()
    for k, (name, m) in enumerate(zip(pair.axes, current)):
        covariance[k, k] += (m.inertia_deviation / machine.axis(name).ratio ** 2) ** 2
    return Balance(pair.names, replace(fit, covariance=covariance), dict(zip(pair.axes, rows)))
