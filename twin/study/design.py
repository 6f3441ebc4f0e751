"""From factors to a table (variant, factor) of values, reproducible by seed, and from a row to its machine."""

import itertools
import math
from typing import Any

import numpy as np
from scipy.stats import qmc

from twin.limits import refuse_above
from twin.machine.machine import Machine
from twin.simulation.plant_spec import commissioned_inertia, home_inertia_at_motor
from twin.study.catalogue import with_choices
from twin.study.factors import Factor
from twin.study.paths import INERTIA, number_at, with_numbers
from twin.study.spec import Study

MOST = 1_000_000
"""More variants than this are refused."""


def variants_of(study: Study) -> np.ndarray:
    """Values (variant, factor) of the study's design; the nominal machine is a variant only if the design contains it."""
    design, factors = study.design, study.factors
    levels = factors if design.kind in ("grid", "one_at_a_time") else ()
    counts = [len(f.values) if f.values else design.levels for f in levels]
    number = {
        "grid": math.prod(counts),
        "one_at_a_time": 1 + sum(counts),
        "latin_hypercube": design.count,
        "sobol": design.count * (len(factors) + 2),
        "list": len(design.rows),
    }[design.kind]
    refuse_above(number, MOST, "variants", f"{study.path}: [design]", "lower levels or count, or use a latin_hypercube")
    grids = [np.array(f.values) if f.values else np.linspace(f.low, f.high, design.levels) for f in levels]
    if design.kind == "grid":
        return np.array(list(itertools.product(*grids)))
    if design.kind == "one_at_a_time":
        middle = nominal_of(study)
        rows = [middle]
        for i, values in enumerate(grids):
            rows += [np.where(np.arange(len(factors)) == i, value, middle) for value in values if value != middle[i]]
        return np.array(rows)
    if design.kind == "latin_hypercube":
        unit = qmc.LatinHypercube(len(factors), rng=np.random.default_rng(study.seed)).random(design.count)
        return _from_unit(factors, unit)
    if design.kind == "sobol":
        from SALib.sample import sobol

        return _from_unit(factors, sobol.sample(problem_of(study), design.count, calc_second_order=False, seed=study.seed))
    return np.array(design.rows)


def _from_unit(factors: tuple[Factor, ...], unit: np.ndarray) -> np.ndarray:
    """Samples (variant, factor) in 0 .. 1 mapped to each factor's range, or to its values in equal parts."""
    columns = []
    for factor, u in zip(factors, unit.T):
        if factor.values:
            columns.append(np.array(factor.values)[np.minimum((u * len(factor.values)).astype(int), len(factor.values) - 1)])
        else:
            columns.append(factor.low + (factor.high - factor.low) * u)
    return np.column_stack(columns)


def problem_of(study: Study) -> dict[str, Any]:
    """The study's factors as a SALib problem in the unit cube."""
    names = [f.name for f in study.factors]
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}


def nominal_of(study: Study) -> np.ndarray:
    """Each factor's value (factor,) on the present machine: 1 if relative, the lower end for an effect that the machine lacks."""
    values = []
    for factor in study.factors:
        names = [choice.name for choice in factor.choices]
        installed = float(names.index(factor.installed)) if factor.installed in names else 0.0
        value = installed if names else 1.0 if factor.relative else number_at(study.machine, factor.paths[0])
        values.append(factor.low if value is None else value)
    return np.array(values)


def machine_of(study: Study, row: np.ndarray) -> Machine:
    """The machine of one variant; raises InputError for impossible values."""
    nominal = study.machine if study.recommission else with_commissioned_values(study.machine)
    chosen = list(zip(study.factors, row.tolist()))
    values = with_choices([factor.choices[round(value)] for factor, value in chosen if factor.choices], nominal)
    ratio: dict[str, float] = {}
    change: dict[str, float] = {}
    for factor, value in chosen:
        if factor.choices:
            continue
        base = number_at(nominal, factor.paths[0]) or 0.0
        for path in factor.paths:
            values[path] = value * (number_at(nominal, path) or 0.0) if factor.relative else value
        ratio[factor.name] = value if factor.relative else value / base if base else 1.0
        change[factor.name] = values[factor.paths[0]] - base

    # ties to factors first, then ties to the resulting inertia
    for of_inertia in (False, True):
        ties = [tied for tied in study.tied if tied.to.startswith(INERTIA) == of_inertia]
        if of_inertia and ties:
            grown = home_inertia_at_motor(with_numbers(nominal, values)) / home_inertia_at_motor(nominal)
            ratio |= {f"{INERTIA}{name}": times for name, times in zip(nominal.axis_names, grown.tolist())}
        for tied in ties:
            for path in tied.paths:
                now = values.get(path, number_at(nominal, path) or 0.0)
                values[path] = now * ratio[tied.to] ** tied.exponent if tied.slope is None else now + tied.slope * change[tied.to]
    machine = with_numbers(nominal, values)
    if study.retune:
        machine = retuned(machine, study.machine)
    return with_commissioned_values(machine, anew=True) if study.recommission else machine


def retuned(machine: Machine, like: Machine) -> Machine:
    """The machine with gains that give its loops the margins of the machine `like`, so that designs are compared, not tunings.

    The speed gain is scaled with the inertia at the motor, the current gain with the inductance, the current integral time with L / R.
    The position gain stays, because the speed loops then behave alike. A gain set by a factor refers to the inertia of `like`.
    """
    numbers: dict[str, dict[str, float]] = {}
    grown = home_inertia_at_motor(machine) / home_inertia_at_motor(like)
    for axis, model, factor in zip(machine.axes, like.axes, grown.tolist()):
        winding = axis.motor.inductance_h / model.motor.inductance_h
        lag = winding * model.motor.resistance_ohm / axis.motor.resistance_ohm
        numbers[axis.name] = axis.loops.for_plant(factor, winding, lag)
    return machine.with_loops(numbers)


def with_commissioned_values(machine: Machine, *, anew: bool = False) -> Machine:
    """The machine with its torque constants and inertias as commissioned values: where its file has none, or all if `anew`."""
    values: dict[str, float] = {}
    inertias = home_inertia_at_motor(machine) if anew else commissioned_inertia(machine)
    for axis, inertia in zip(machine.axes, inertias.tolist()):
        where = f"axis.{axis.name}.commissioned"
        values[f"{where}.inertia_kg_m2"] = inertia
        if axis.has_constant:
            constant = axis.motor.torque_constant_nm_per_a if anew else axis.commissioned_torque_constant
            values[f"{where}.torque_constant_nm_per_a"] = constant
    return machine.with_values(values)
