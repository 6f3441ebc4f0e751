"""From factors to variants: a table (variant, factor) of values, the same for a seed on every machine."""

from __future__ import annotations

import copy
import itertools
from typing import Any

import numpy as np
from scipy.stats import qmc

from twin.errors import InputError
from twin.machine import Machine
from twin.study.spec import Study

MOST = 1_000_000


def variants_of(study: Study) -> np.ndarray:
    """Values (variant, factor) of the study's design; the nominal machine is no variant unless the design holds it."""
    kind, factors = study.design["kind"], study.factors
    levels, count = int(study.design.get("levels", 5)), int(study.design.get("count", 64))
    grids = [np.array(f.values) if f.values else np.linspace(*f.range, max(levels, 1)) for f in factors]  # type: ignore[misc]
    if kind == "grid":
        table = np.array(list(itertools.product(*grids)))
    elif kind == "one_at_a_time":
        middle = nominal_of(study)
        rows = [middle]
        for i, values in enumerate(grids):
            rows += [np.where(np.arange(len(factors)) == i, value, middle) for value in values if value != middle[i]]
        table = np.array(rows)
    elif kind == "latin_hypercube":
        low, high = np.array([f.low for f in factors]), np.array([f.high for f in factors])
        unit = qmc.LatinHypercube(len(factors), rng=np.random.default_rng(study.seed)).random(max(count, 0))
        table = low + (high - low) * unit
    elif kind == "sobol":
        from SALib.sample import sobol

        table = (
            sobol.sample(problem_of(study), max(count, 0), calc_second_order=False, seed=study.seed)
            if count > 0
            else np.zeros((0, len(factors)))
        )
    else:
        rows = study.design.get("rows", [])
        if any(not isinstance(row, list) or len(row) != len(factors) for row in rows):
            raise InputError(f"{study.path}: [design] rows: each needs {len(factors)} numbers, one for each factor")
        table = np.array(rows, float).reshape(len(rows), len(factors))
    if not len(table):
        raise InputError(f"{study.path}: the design has no variant; give count, levels or rows above 0")
    if len(table) > MOST:
        raise InputError(f"{study.path}: the design has {len(table)} variants; lower levels or count, or use a latin_hypercube")
    return table


def bounds_of(study: Study) -> tuple[list[float], list[float]]:
    """Lower and upper ends of all factors."""
    for f in study.factors:
        if f.low >= f.high:
            raise InputError(f"{study.path}: factor '{f.name}' does not vary; give it a range")
    return [f.low for f in study.factors], [f.high for f in study.factors]


def problem_of(study: Study) -> dict[str, Any]:
    """The study's factors in the words of SALib."""
    low, high = bounds_of(study)
    return {"num_vars": len(low), "names": [f.name for f in study.factors], "bounds": [list(pair) for pair in zip(low, high)]}


def nominal_of(study: Study) -> np.ndarray:
    """Each factor's value on the machine as it is; 1 for relative ones; for an effect that it lacks the lower end."""
    out = []
    for f in study.factors:
        value = 1.0 if f.relative else _number(study.machine, f.paths[0])
        out.append(f.low if value is None else value)
    return np.array(out)


def _number(machine: Machine, path: str) -> float | None:
    if path.startswith("effect."):
        return None
    value: Any = machine.document
    for key in path.split("."):
        value = value[key]
    return float(value)


def machine_of(study: Study, row: np.ndarray) -> Machine:
    """The machine with one variant's values; raises InputError where they are impossible."""
    values: dict[str, Any] = {}
    effects: dict[tuple[str, str], dict[str, Any]] = {(e["name"], e["axis"]): dict(e) for e in study.machine.effects}
    for factor, value in zip(study.factors, row.tolist()):
        for path in factor.paths:
            if path.startswith("effect."):
                _, name, axis, parameter = path.split(".")
                effects.setdefault((name, axis), {"name": name, "axis": axis})[parameter] = value
            else:
                nominal = _number(study.machine, path) or 0.0
                values[path] = value * nominal if factor.relative else value
    for tied in study.tied:
        i = next(i for i, f in enumerate(study.factors) if f.name == tied.to)
        ratio = row[i] if study.factors[i].relative else row[i] / (_number(study.machine, study.factors[i].paths[0]) or 1.0)
        values[tied.path] = (_number(study.machine, tied.path) or 0.0) * float(ratio) ** tied.exponent
    if effects:
        values["effect"] = copy.deepcopy(list(effects.values()))
    return study.machine.with_values(values)
