"""The mark of a law: axis, block and variable, and how well its shape agrees with the true law of an effect outside the library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twin.diagnose.law.measure import nominal_shapes
from twin.effects import check_setting
from twin.effects.law import law_in
from twin.errors import TwinError
from twin.machine.machine import Machine

from .plant.outside import LAWS, TrueLaw, played

SIMILAR = 0.95
"""Correlation with the true law from which a shape is right."""

FREQUENCIES_HZ = np.linspace(1.0, 200.0, 400)
"""Frequencies at which a filter is compared."""

POINTS = 400
"""Number of points over the range of a variable."""

STROKE = 5.0
"""Stroke over which a play is compared, as a multiple of its width."""

TOLERANCED = ("mechanics", "transmission")
"""Blocks in which toleranced parameters explain a part of a curve: friction and stiffness. In the others a constant is removed."""


def laws_of_fault(fault: Mapping[str, Any], answer: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Laws of a `diagnosis.json` with axis, block and variable of an effect outside the library."""
    wanted = fault["axis"], fault["block"], LAWS[fault["name"]].variable
    return [law for law in answer.get("laws", ()) if (law["axis"], law["block"], law["variables"][0]) == wanted]


def shape_agreement(fault: Mapping[str, Any], answer: Mapping[str, Any], machine: Machine) -> float:
    """Correlation of the laws found over the right variable with the true law, over the measured range; 0 without such a law.

    Parts that toleranced parameters explain are removed from both. Filters are compared by the change that they make to a signal from 1 to
    200 Hz, a wave over one period, a play along a stroke, a random error by its deviation.
    """
    true, found = LAWS[fault["name"]], laws_of_fault(fault, answer)
    try:
        if not found:
            return 0.0
        if true.response:
            return _filters_agree(true, fault, found)
        return _curves_agree(true, fault, found, machine)
    except (KeyError, TwinError):  # a curve in place of a filter, or the other way round
        return 0.0


def _filters_agree(true: TrueLaw, fault: Mapping[str, Any], found: Sequence[Mapping[str, Any]]) -> float:
    s = 2j * np.pi * FREQUENCIES_HZ
    assert true.response is not None
    wanted = true.response(fault, s) - 1.0
    given = np.prod([_response(law, s) for law in found], axis=0) - 1.0
    return float(np.real(np.vdot(wanted, given)) / max(np.linalg.norm(wanted) * np.linalg.norm(given), 1e-300))


def _response(law: Mapping[str, Any], s: np.ndarray) -> np.ndarray:
    """Frequency response of a filter found. Raises KeyError for a law that is none."""
    numbers = {name: float(p["value"]) for name, p in law["parameters"].items()}
    if "frequency_hz" in numbers:
        w = 2.0 * np.pi * numbers["frequency_hz"]
        return np.asarray((s**2 + w**2) / (s**2 + numbers["width"] * w * s + w**2))
    if "time_s" in numbers:
        return np.asarray(np.exp(-numbers["time_s"] * s))
    return np.asarray(1.0 / (1.0 + numbers["time_constant_s"] * s))


def _curves_agree(true: TrueLaw, fault: Mapping[str, Any], found: Sequence[Mapping[str, Any]], machine: Machine) -> float:
    assert true.values is not None
    if true.variable == "slack":
        stroke = STROKE * fault["width"]
        x = np.concatenate([np.linspace(0.0, stroke, POINTS), np.linspace(stroke, 0.0, POINTS), np.linspace(0.0, -stroke, POINTS)])
    else:
        ends = [value for law in found for value in (law["measured"]["x"][0], law["measured"]["x"][-1])]
        x = np.linspace(min(ends), max(ends), POINTS)
    nominal = nominal_shapes(x, true.variable) if fault["block"] in TOLERANCED else np.ones((len(x), 1))
    apart = [y - nominal @ np.linalg.lstsq(nominal, y, rcond=None)[0] for y in (true.values(fault, x), _values(found, x, machine))]
    wanted, given = apart
    return float(wanted @ given / max(np.linalg.norm(wanted) * np.linalg.norm(given), 1e-300))


def _values(found: Sequence[Mapping[str, Any]], x: np.ndarray, machine: Machine) -> np.ndarray:
    """Sum of the laws found at values of their variable (point,)."""
    total = np.zeros(len(x))
    for entry in found:
        keys = ("axis", "block", "output", "variables", "from_axis", "points", "between", "period")
        head = {key: entry[key] for key in keys if key in entry}
        formula = {} if "points" in entry else {"formula": entry["formula"]}
        numbers = {name: float(p["value"]) for name, p in entry["parameters"].items()}
        setting = check_setting({"name": "law", **head, **formula, **numbers}, machine, "a law of the answer")
        law, parameters = law_in(setting), setting.parameters
        if law.is_remembered:
            place = played(x, parameters["length"]) / parameters["length"]
            total += law.values(place, parameters, machine.axis(entry["axis"]))
        else:
            total += law.values(x, parameters, machine.axis(entry["axis"]))
    return total
