"""The numbers of a change, tuned on the corrected machine along the program's own reversals."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
import itertools

import numpy as np
from scipy.optimize import minimize

from twin.control.structures import INTEGRAL
from twin.effects import settings_of
from twin.machine.check import Asked
from twin.machine.machine import Axis, Machine
from twin.remedy.advice import BACKLASH, GAIN, PULSE, TABLE, advice_on
from twin.remedy.change import Change, held
from twin.remedy.predict import Motionful, errors_of, with_changes

AMPLITUDES = (0.25, 0.5, 0.75, 1.0)
"""First amplitudes of a pulse, in units of 2 Mc r / Kp: the step of the speed set point that turns Coulomb friction round."""
DECAYS = (0.5, 1.0, 2.0)
"""First decays of a pulse, in integral times of the speed controller: with T = Tn the answer of the torque is a step."""
KNEES = (0.5, 1.5)
"""First accelerations of the full amplitude, in units of the median over the reversals."""
BEYOND = 2.0
"""The best numbers are sought within this factor of the first ones: a pulse that never decays is no pulse."""
TRIES = 24
"""Most evaluations after the first ones."""
LEFT = 0.2
"""Share of a table's wave that a raised position gain should leave, and the smallest raise that is worth it."""
SMALLEST_RAISE = 1.05
CYCLES_IF_ENDLESS = 8.0
"""Decay in position cycles where the speed controller has no integral time."""


def tuned(change: Change, machine: Machine, on: Sequence[Motionful], shaped: bool = False) -> Change:
    """The change with the numbers that make the RMS contour error over the motions smallest. `machine` is without it.

    shaped: the amplitude of a pulse rises with the acceleration of the reversal, so that it fits slow and fast ones.
    """
    axis = machine.axis(change.axis)
    if change.function == PULSE:
        first = _pulses(machine, axis)
        if shaped and (usual := _usual_acceleration(machine, axis, on)) > 0.0:
            first = [{**pulse, "acceleration_1": knee * usual} for pulse in first for knee in KNEES]
        return _best(change, machine, on, first)
    if change.function == BACKLASH:
        found = sum(s.size for s in settings_of(machine) if s.axis == axis.name and s.effect.name == "backlash")
        before = held(axis, BACKLASH).get("width", 0.0)
        return _best(
            change, machine, on, [{"width": before + share * found, "cycles": 1.0} for share in (0.7, 1.0, 1.3)], fixed=("cycles",)
        )
    if change.function == TABLE:
        return replace(change, values=_correction(machine, axis))
    return change


def faster(machine: Machine, on: Motionful, asked: Asked) -> list[Change]:
    """The position gain that leaves the share LEFT of the waves of all tables on a motion, or the nearest within the margins; [] without a wave.

    A wave of frequency w = k |dq/dt| is left to w / sqrt(w^2 + Kv^2). The gain rises on all axes alike, as axes that interpolate need it.
    """
    driven = [a for a in machine.axes if a.loops.position_gain_per_s > 0.0]
    factor = 1.0
    for axis in driven:
        wave = held(axis, TABLE)
        if not np.hypot(wave.get("sine", 0.0), wave.get("cosine", 0.0)) > 0.0:
            continue
        speed = np.diff(on.setpoints.position[:, machine.axis_names.index(axis.name)]) / on.setpoints.period
        w = 2.0 * np.pi / wave["wavelength"] * float(np.sqrt(np.mean(speed[speed != 0.0] ** 2))) if speed.any() else 0.0
        factor = max(factor, w * np.sqrt(1.0 / LEFT**2 - 1.0) / axis.loops.position_gain_per_s)
    while factor > SMALLEST_RAISE:
        changes = [
            Change(a.name, GAIN, None, {"position_gain_per_s": float(f"{factor * a.loops.position_gain_per_s:.3g}")}) for a in driven
        ]
        raised = with_changes(machine, changes)
        if not any(asked.missed_by(raised, a.name) for a in driven):
            return changes
        factor *= 0.9
    return []


def _usual_acceleration(machine: Machine, axis: Axis, on: Sequence[Motionful]) -> float:
    """Median acceleration of an axis at its reversals [m/s2, rad/s2]; 0 for an axis that does not reverse."""
    found: list[np.ndarray] = []
    for motion in on:
        points, period = motion.setpoints.position[:, machine.axis_names.index(axis.name)], motion.setpoints.period
        speed = np.diff(points) / period
        turns = np.flatnonzero(speed[1:] * speed[:-1] < 0.0)
        found.append(np.abs(speed[turns + 1] - speed[turns]) / period)
    return float(np.median(every)) if len(every := np.concatenate(found)) else 0.0


def _correction(machine: Machine, axis: Axis) -> dict[str, float]:
    """Slope and wave of the errors of an axis that a table corrects: those of its effects, E = true minus commanded position, on top of the table that it has."""
    values = {"slope": 0.0, "origin": 0.0, "sine": 0.0, "cosine": 0.0, "wavelength": 2.0 * np.pi * axis.ratio} | held(axis, TABLE)
    for setting in settings_of(machine):
        if setting.axis != axis.name or TABLE not in advice_on(setting.effect).functions(axis.encoder):
            continue
        if setting.effect.name == "lead_error":
            values["slope"] += 1e6 * setting.size / (1.0 - setting.size)
            continue
        # the load leads the motor encoder by a cyclic error; an eccentric disc reads ahead of the load
        cyclic, phase = setting.effect.name == "cyclic_error", setting.parameters["phase_rad"]
        size, wavelength = (setting.size, 2.0 * np.pi * axis.ratio) if cyclic else (-setting.size, 2.0 * np.pi)
        if not np.isclose(values["wavelength"], wavelength):  # a table holds one wave
            values |= {"sine": 0.0, "cosine": 0.0, "wavelength": wavelength}
        values["sine"] += size * np.cos(phase)
        values["cosine"] += size * np.sin(phase)
    return {name: float(value) for name, value in values.items()}


def _pulses(machine: Machine, axis: Axis) -> list[dict[str, float]]:
    """First pulses [m/s or rad/s, s], from friction and speed gain of the axis with its effects."""
    factor = np.prod([s.factor_on("coulomb_friction_nm") for s in settings_of(machine) if s.axis == axis.name] or [1.0])
    full = 2.0 * axis.coulomb_friction_nm * float(factor) * axis.ratio / axis.loops.speed_gain_nm_s_per_rad
    decay = axis.loops.speed_integral_time_s if axis.loops.has(INTEGRAL) else CYCLES_IF_ENDLESS * machine.position_cycle
    return [{"amplitude": a * full, "decay_time": d * decay} for a, d in itertools.product(AMPLITUDES, DECAYS)]


def _best(
    change: Change, machine: Machine, on: Sequence[Motionful], first: Sequence[Mapping[str, float]], fixed: Sequence[str] = ()
) -> Change:
    """The best of the first numbers, refined by a simplex over the logarithms of those that are not fixed."""
    keys = [k for k in first[0] if k not in fixed]

    def losses(many: Sequence[Mapping[str, float]]) -> np.ndarray:
        machines = [replace(change, values=values).applied(machine) for values in many]
        squares = np.zeros(len(many))
        for motion in on:
            squares += [error.rms**2 for error in errors_of(machines, motion)]
        return np.sqrt(squares / len(on))

    values = losses(first)
    low, high = ({k: factor * end(v[k] for v in first) for k in keys} for factor, end in ((1.0 / BEYOND, min), (BEYOND, max)))
    start = first[int(np.argmin(values))]
    origin = np.log([max(start[k], 1e-12) for k in keys])

    def at(x: np.ndarray) -> dict[str, float]:
        return {**start, **{k: float(np.clip(v, low[k], high[k])) for k, v in zip(keys, np.exp(x))}}

    of: Callable[[np.ndarray], float] = lambda x: float(losses([at(x)])[0])  # noqa: E731
    simplex = np.vstack([origin, *(origin + 0.2 * row for row in np.eye(len(keys)))])
    found = minimize(of, origin, method="Nelder-Mead", options={"maxfev": TRIES, "initial_simplex": simplex, "xatol": 0.02, "fatol": 1e-10})
    best = at(found.x) if found.fun < values.min() else dict(start)
    return replace(change, values=best)
