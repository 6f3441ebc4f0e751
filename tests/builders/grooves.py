"""A groove cut by one slow pass and a fast one 20 um deeper: the smallest cut with a mark."""

import numpy as np

from twin.machine.machine import load_machine
from twin.recordings.trace import Trace

PART = """
name = "groove"
[tool]
kind = "ball"
diameter_mm = 10
[stock]
allowance_mm = 0.05
[placement]
origin_mm = [0, 0, {z}]
[[surface]]
name = "plane"
kind = "plane"
along_mm = [-10, 10]
across_mm = [-1, 1]
spacing_mm = 0.2
zone_um = 50
"""


def groove_trace(jump: float = 0.0) -> Trace:
    """A trace of one slow and one fast pass along X, the fast one 20 um deeper; `jump` [m] of X in the middle of it."""
    time = np.arange(2001) * 1e-3
    x = np.where(time < 1.0, -12e-3 + 24e-3 * time, 12e-3 - 24e-3 * np.clip((time - 1.0) / 0.2, 0.0, 1.0))
    depth = np.where(time < 1.0, 0.0, 20e-6)
    x[1500:] += jump
    signals = {}
    for name, values in (("X", x), ("Z", -depth)):
        signals[name, "setpoint"] = values + 0.0 * time
        signals[name, "position"] = values + 0.0 * time
    return Trace(time, signals, load_machine().kinds)
