"""Change of a circle (ISO 230-4) by each diagnosed effect.

The corrected machine runs the circle, then again without one of its effects at a time. The difference is the share of that effect:

share = RMS over the angle, both directions, of radius(with) - radius(without)            [m]
unknown = the same of radius(measured) - radius(corrected)
"""

from collections.abc import Callable, Mapping
import math
from typing import Any

import numpy as np

from twin.effects import with_effects
from twin.errors import InputError
from twin.iso230.circles import GRID, CircleTest, circle_numbers
from twin.machine.machine import Machine

UNKNOWN = "unknown"


def circle_budget(
    corrected: Machine, diagnosis: Mapping[str, Any], measured: CircleTest, run: Callable[[Machine], CircleTest]
) -> tuple[CircleTest, list[dict[str, Any]]]:
    """The circle of the corrected machine, and the rows of the budget: largest share first, the unknown part last.

    A row has effect and axis, probability (None for the unknown part), share `rms_um`, and `adds_um`, its contribution to the numbers of the standard.
    `diagnosis` is the document of `twin diagnose`; `run` simulates the measured circle on a machine.
    """
    tables = [dict(table) for table in corrected.document.get("effect", [])]
    whole = run(corrected)
    try:
        probability = {(str(found["effect"]), str(found["axis"])): float(found["probability"]) for found in diagnosis.get("effects", [])}
    except (KeyError, TypeError, ValueError):
        raise InputError("diagnosis.json: an effect has no name, axis or probability; diagnose again") from None
    rows = []
    for i, table in enumerate(tables):
        without = run(with_effects(corrected, tables[:i] + tables[i + 1 :]))
        key = (str(table["name"]), str(table.get("axis", "")))
        rows.append(_row(*key, probability.get(key), whole, without))
    rows.sort(key=lambda row: -row["rms_um"])
    return whole, [*rows, _row(UNKNOWN, "", None, measured, whole)]


def _row(effect: str, axis: str, probability: float | None, a: CircleTest, b: CircleTest) -> dict[str, Any]:
    """The row of what makes one circle differ from another, over their common directions."""
    angle = np.arange(GRID) * (2.0 * math.pi / GRID)
    squares = [np.mean((a.paths[d].at(angle) - b.paths[d].at(angle)) ** 2) for d in a.paths if d in b.paths]
    rms = float(np.sqrt(np.mean(squares))) if squares else math.nan
    first, second = circle_numbers(a), circle_numbers(b)
    adds = {k: 1e6 * (first[k] - second[k]) for k in ("G_b", "G_ccw", "G_cw", "F_max", "F_min") if k in first and k in second}
    return {"effect": effect, "axis": axis, "probability": probability, "rms_um": 1e6 * rms, "adds_um": adds}
