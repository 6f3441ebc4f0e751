"""The mark of a law: axis, block and variable, and how well its shape agrees with the true law of an effect outside the library."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.diagnose.law.measure import nominal_shapes
from twin.effects import Setting, check_setting
from twin.effects.law import cycle_of, law_in
from twin.effects.law_filters import response
from twin.errors import TwinError
from twin.machine.machine import Machine

from .plant.outside import LAWS, played

SIMILAR = 0.95
"""Least correlation with the true law of a right shape."""

FREQUENCIES_HZ = np.linspace(1.0, 200.0, 400)
"""A filter is compared at these frequencies."""

POINTS = 400
"""Number of points over the range of a variable."""

STROKE = 5.0
"""A play is compared over this stroke, as a multiple of its width."""

TOLERANCED = ("mechanics", "transmission")
"""Toleranced parameters explain a part of a curve in these blocks (friction and stiffness). In the others a constant is removed."""


def laws_of_fault(fault: Mapping[str, Any], answer: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Laws of a `diagnosis.json` with axis, block and variable of an effect outside the library."""
    wanted = fault["axis"], fault["block"], LAWS[fault["name"]].variable
    return [law for law in answer.get("laws", ()) if (law["axis"], law["block"], law["variables"][0]) == wanted]


def shape_agreement(fault: Mapping[str, Any], answer: Mapping[str, Any], machine: Machine) -> float:
    """Correlation of the laws found over the right variable with the true law, over the measured range; 0 without such a law.

    Parts that toleranced parameters explain are removed from both. Filters are compared by the change that they make to a signal from 1 to
    200 Hz, a wave over one period, a play along a stroke, a random error by its deviation.
    """
    true, entries = LAWS[fault["name"]], laws_of_fault(fault, answer)
    try:
        settings = [_setting(entry, machine) for entry in entries]
    except TwinError:
        return 0.0
    if not settings or any(law_in(s).shape.is_filter != (true.response is not None) for s in settings):
        return 0.0
    if true.response:
        wanted = true.response(fault, 2j * np.pi * FREQUENCIES_HZ)
        passed = [response(law.shape, s.parameters, cycle_of(law, machine), FREQUENCIES_HZ) for s in settings for law in [law_in(s)]]
        return _correlation(wanted - 1.0, np.prod(passed, axis=0) - 1.0)
    assert true.values is not None
    if true.variable == "slack":
        end = STROKE * fault["width"]  # to one end of a stroke, then to the other one, of a load with a play of this width
        x = np.concatenate([np.linspace(a, b, POINTS) for a, b in ((0.0, end), (end, 0.0), (0.0, -end))])
    else:
        ends = [entry["measured"]["x"][end] for entry in entries for end in (0, -1)]
        x = np.linspace(min(ends), max(ends), POINTS)
    nominal = nominal_shapes(x, true.variable) if fault["block"] in TOLERANCED else np.ones((len(x), 1))
    curves = true.values(fault, x), sum(_values(s, x, machine) for s in settings)
    return _correlation(*(y - nominal @ np.linalg.lstsq(nominal, y, rcond=None)[0] for y in curves))


def _setting(entry: Mapping[str, Any], machine: Machine) -> Setting:
    """A law of a `diagnosis.json` as a setting. Raises TwinError for one that the machine cannot have."""
    shape = ("points",) if "points" in entry else ("formula",)
    head = {key: entry[key] for key in ("axis", "block", "output", "variables", "from_axis", *shape) if key in entry}
    numbers = {name: float(p["value"]) for name, p in entry["parameters"].items()}
    return check_setting({"name": "law", **head, **numbers}, machine, "a law of the answer")


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.real(np.vdot(a, b)) / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-300))


def _values(setting: Setting, x: np.ndarray, machine: Machine) -> np.ndarray:
    """Values (point,) of a law over its variable; of a play, over the travel of the load."""
    law, numbers = law_in(setting), setting.parameters
    over = played(x, numbers["length"]) / numbers["length"] if law.is_remembered else x
    return law.values(over, numbers, machine.axis(setting.axis))
