"""Changes of a `remedy.json` on the second plant: each switches on a compensation of its control."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

import numpy as np

from twin.exam.plant.parameters import AXES, Settings

POINTS_A_WAVE, POINTS_A_TURN = 16, 72


def switch_on(s: Settings, change: Mapping[str, Any]) -> None:
    """Switch on one change of `remedy.json` on settings `s`: {"axis": .., "function": .., "parameters": {key with unit: number}}."""
    k, p = AXES.index(change["axis"]), change["parameters"]
    angle, turns = (1.0, 1.0) if s.linear[k] else (math.pi / 180.0, 2.0 * math.pi)
    unit, turn = ("m", "m") if s.linear[k] else ("deg", "rev")
    if change["function"] == "position_gain":
        s.kv[k] *= p["position_gain_per_s"] / s.machine["axis"][change["axis"]]["loops"]["position_gain_per_s"]
    elif change["function"] == "friction_pulse":
        knees = [p.get(f"acceleration_{i}_{turn}_per_s2", 0.0) * turns for i in (1, 2, 3)]
        sizes = [p.get(f"{name}_{turn}_per_min", 0.0) * turns / 60.0 for name in ("amplitude", "amplitude_low")]
        s.pulses[k] = (*sizes, p["decay_time_s"], *knees)
    elif change["function"] == "backlash_value":
        s.plays[k] = p[f"width_{unit}"] * angle, max(round(p["cycles"]), 1)
    elif change["function"] == "position_correction":
        number = {name: p[f"{name}_{unit}"] * angle for name in ("origin", "sine", "cosine", "wavelength")}
        axis = s.machine["axis"][change["axis"]]
        low, high = axis["travel_m"] if s.linear[k] else (0.0, 2.0 * math.pi)
        count = max(math.ceil((high - low) / number["wavelength"] * POINTS_A_WAVE), 1 if s.linear[k] else POINTS_A_TURN) + 1
        x = np.linspace(low, high, count)
        w = 2.0 * math.pi / number["wavelength"]
        error = p["slope_ppm"] * 1e-6 * (x - number["origin"]) + number["sine"] * np.sin(w * x) + number["cosine"] * np.cos(w * x)
        s.tables[k] = (low, x[1] - x[0], not s.linear[k]), error
    else:
        raise ValueError(f"no compensation {change['function']!r} on this plant")
