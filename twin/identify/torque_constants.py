"""Split the identified products with the torque constant into values, with the tolerances of the machine file.

Current and motion determine only J/Kt, Fc/Kt, Fv/Kt and m g/Kt: the scale of all values of a motor remains unknown, whatever the recording.
Additional knowledge is needed: a weighed mass, a torque wrench, the motor's test sheet, or the tolerance in the machine file. Each parameter
lies within this tolerance of its nominal value, so a factor common to all products most likely belongs to the torque constant. The values
are the most probable ones given tolerances and regression,

    min  sum_i ((p_i - p_i(x)) / d_i)^2 + sum_j (x_j / t_j)^2,     x: logarithms of factors on the machine file

If the products contradict the tolerance, the torque constant of the file is kept and the other values follow from it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import math

import numpy as np
from scipy.optimize import least_squares

from twin.documents import value_at
from twin.effects.change import upward
from twin.identify.axis_run import control_inertia, moved_inertia
from twin.identify.drive_balance import FRICTIONS, Balance
from twin.identify.regressions import Regressions
from twin.identify.rotary_pair import pair_of
from twin.machine.axis import inertia_of, path_of
from twin.machine.machine import Axis, Machine
from twin.machine.parameters import SPREAD

FLOOR = 2e-4
"""Lower bound of a product's relative standard deviation, for the errors of the laws."""

CONTRADICTS = 3.0
"""The tolerance is contradicted if a parameter is off its nominal value by more than this many standard deviations."""

WIDE = 0.3
"""Standard deviation of the factors on the machine file if its tolerance is contradicted."""


@dataclass(frozen=True)
class Split:
    """Factors on machine-file values (log, standard deviation) by path for one motor or the pair, and whether the tolerance holds.

    `added`: friction by path that the machine file has at zero, so that no factor reaches it.
    """

    factors: dict[str, tuple[float, float]]
    tolerance_holds: bool
    added: dict[str, float] = field(default_factory=dict)


def split_products(machine: Machine, direct: Regressions, torque_constant_tolerance: float | None = None) -> dict[str, Split]:
    """Most probable factors by path for every identified balance; tolerances are relative half widths."""
    out = {}
    for name, balance in direct.balance.items():
        paths = _paths(machine, balance)
        predicted = _predictor(machine, balance, paths)
        nominal = predicted(np.zeros(len(paths)))
        values, deviations, seen = (of[: len(nominal)] for of in (balance.fit.values, balance.fit.deviations, balance.fit.seen))
        use = seen & np.isfinite(deviations) & (np.abs(nominal) > 0.0)
        scale = np.hypot(deviations, FLOOR * np.abs(values))
        kt_sd = (machine.parameter_tolerance if torque_constant_tolerance is None else torque_constant_tolerance) / math.sqrt(3.0)
        own = max(machine.parameter_tolerance, 1e-6) / math.sqrt(3.0)
        prior = np.array([max(kt_sd, 1e-6) if "torque_constant" in p else own * _share(machine, p) for p in paths])
        x, covariance = _most_probable(predicted, values, scale, use, prior)
        misfit = np.abs((predicted(x) - values) / scale)[use]
        holds = bool(np.all(np.abs(x) < CONTRADICTS * prior)) and float(misfit @ misfit) < (2.0 * CONTRADICTS) ** 2 * len(misfit)
        if not holds:
            prior = np.array([min(max(kt_sd, 1e-6), 1e-2) if "torque_constant" in p else WIDE for p in paths])
            x, covariance = _most_probable(predicted, values, scale, use, prior)
        deviation = np.sqrt(np.diag(covariance))
        factors = {p: (float(v), float(d)) for p, v, d in zip(paths, x, deviation)}
        out[name] = Split(factors, holds, _friction_from_zero(machine, balance, factors))
    return out


def split_machine(machine: Machine, splits: Mapping[str, Split]) -> Machine:
    """The machine with the factors applied to its values."""
    return machine.with_values({p: v for split in splits.values() for p, v in (_scaled(machine, split.factors) | split.added).items()})


def _friction_from_zero(machine: Machine, balance: Balance, factors: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Identified friction of a single axis whose value in the machine file is zero, by path; not that which is one number with a constant force."""
    out = {}
    for axis in map(machine.axis, () if balance.paired else balance.rows):
        kt = math.exp(factors.get(path_of(axis, "torque_constant"), (0.0, 0.0))[0])
        for quantity in FRICTIONS:
            i, _ = balance.place(axis, quantity)
            if axis.number(SPREAD[quantity]) == 0.0 and math.isfinite(balance.fit.deviations[i]) and balance.fit.values[i] > 0.0:
                out[path_of(axis, quantity)] = float(balance.fit.values[i]) * kt
    return out


def _paths(machine: Machine, balance: Balance) -> list[str]:
    """Paths of the machine-file values that the products of a motor contain."""
    out = []
    for axis in map(machine.axis, balance.rows):
        inertia = inertia_of(axis)
        # the constant of an ideal actuator is the unit of the values, so it is not split
        known = ["torque_constant"] if axis.actuator.winding else []
        parameters = [*known, inertia, *FRICTIONS]
        # a vertical axis shows its weight and so its mass; elsewhere only the total inertia is known, and the rotor's value takes it
        if is_vertical(machine, axis.name) and inertia != "moving_mass":
            parameters.append("moving_mass")
        out += [path_of(axis, parameter) for parameter in parameters]
    if balance.paired and (pair := pair_of(machine)):
        out += [f"body.{name}.mass_kg" for name in pair.bodies]
    return out


def _share(machine: Machine, path: str) -> float:
    """Factor on the tolerance of a value; above 1 for a rotor whose value also includes the load's mass."""
    table, name, _ = path.split(".", 2)
    axis = machine.axis(name) if table == "axis" else None
    if axis is None or axis.kind != "linear" or path != path_of(axis, "rotor_inertia") or is_vertical(machine, name):
        return 1.0
    return math.hypot(1.0, moved_inertia(axis) / axis.rotor_inertia_kg_m2)


def _predictor(machine: Machine, balance: Balance, paths: list[str]) -> Callable[[np.ndarray], np.ndarray]:
    """Products at the file's torque constants as a function of log factors, in the order of the balance's names."""
    index = {p: i for i, p in enumerate(paths)}
    axes = [machine.axis(n) for n in balance.rows]
    # the numbers of a pair are linear in mass and inertia of each body
    pair = pair_of(machine) if balance.paired else None
    parts = (
        {} if pair is None else {b: changed.numbers - pair.numbers for b in pair.bodies if (changed := pair_of(machine.with_body(b, 2.0)))}
    )

    def predicted(x: np.ndarray) -> np.ndarray:
        def f(path: str) -> float:
            return math.exp(x[index[path]]) if path in index else 1.0

        def of(axis: Axis, parameter: str) -> float:
            return f(path_of(axis, parameter))

        kt = [of(axis, "torque_constant") for axis in axes]
        if pair is not None:  # at the axes
            numbers = pair.numbers + sum((f(f"body.{b}.mass_kg") - 1.0) * part for b, part in parts.items())
            for k, axis in enumerate(axes):
                numbers[k] += axis.reflected_inertia * (of(axis, "rotor_inertia") - 1.0)
            friction = [getattr(a, p) * of(a, p) / k for a, k in zip(axes, kt) for p in FRICTIONS]
            return np.concatenate([numbers / np.where(np.arange(10) == 1, kt[1], kt[0]), friction])
        (axis,) = axes
        load = moved_inertia(axis) * of(axis, "moving_mass")
        if axis.moving_mass_kg is None:
            load = max(control_inertia(axis) - axis.rotor_inertia_kg_m2, 0.0)
        rotor = axis.rotor_inertia_kg_m2 * of(axis, "rotor_inertia")
        # a horizontal axis has no product with weight: a constant force there is not due to a mass
        weight = load / axis.ratio * machine.gravity if is_vertical(machine, axis.name) else 0.0
        friction = [axis.number(SPREAD[p]) * of(axis, p) for p in FRICTIONS]
        return np.array([rotor + load, *friction, weight]) / kt[0]

    return predicted


def is_vertical(machine: Machine, name: str) -> bool:
    """Does the drive of this linear axis carry its weight?"""
    axis = machine.axis(name)
    return axis.kind == "linear" and abs(upward(machine, axis)) > 0.5


def _most_probable(
    predicted: Callable[[np.ndarray], np.ndarray], values: np.ndarray, scale: np.ndarray, use: np.ndarray, prior: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    def residual(x: np.ndarray) -> np.ndarray:
        return np.concatenate([((predicted(x) - values) / scale)[use], x / prior])

    found = least_squares(residual, np.zeros(len(prior)), x_scale=prior)
    return found.x, np.linalg.pinv(found.jac.T @ found.jac, hermitian=True)


def _scaled(machine: Machine, factors: Mapping[str, tuple[float, float]]) -> dict[str, object]:
    """Scaled values by path; a body's inertia scales with its mass."""
    out: dict[str, object] = {}
    for asked, (log_factor, _) in factors.items():
        path = machine.in_file(asked, 0.0)[0]
        factor = math.exp(log_factor)
        out[path] = float(value_at(machine.document, path)) * factor
        if path.startswith("body."):
            body = path.split(".")[1]
            out[f"body.{body}.inertia_kg_m2"] = [factor * v for v in machine.document["body"][body]["inertia_kg_m2"]]
    return out
