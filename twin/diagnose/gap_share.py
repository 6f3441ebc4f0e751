"""Share of the measured gap, in position or current, that the error of a block causes.

position controller   speed error e of its law:   position error e / (s + Kv)
speed controller      current error di:           speed error e = di Kt r / Kp, then the same
mechanics             force error F:              current error F r / Kt
transmission          motor minus scale:          itself, compared with the gap of the position
"""

from collections.abc import Sequence
import math

import numpy as np
import scipy

from twin.diagnose.blocks import BlockResidual
from twin.diagnose.observe import Group
from twin.diagnose.view import RunView
from twin.machine.machine import Axis


def share_of_gap(group: Group, name: str, block: str, parts: Sequence[BlockResidual]) -> float:
    """Share of the squared gap of an axis that a block causes, from 0 to 1; 1 if the gap was not recorded.

    `group` holds the gap: its channels about the machine file. `parts` are the residuals of the block, one per run.
    """
    made = gap = 0.0
    for part in parts:
        view = group.views[part.run]
        axis = view.machine.axis(name)
        square = {c.name: float(np.mean(c.residual**2)) for c in group.channels if (c.run, c.axis) == (part.run, name)}
        weight = len(view.trace.time)
        if block == "transmission":
            made += weight * square.get("motor_minus_scale", 0.0)
            gap += weight * (square.get("motor_minus_scale", 0.0) + square.get("position", 0.0))
        elif block == "mechanics":
            made += weight * float(np.mean((part.residual * axis.ratio / axis.motor.torque_constant_nm_per_a) ** 2))
            gap += weight * square.get("current", 0.0)
        else:
            kp = axis.loops.speed_gain_nm_s_per_rad
            speed = part.residual * (1.0 if block == "position controller" else axis.commissioned_torque_constant * axis.ratio / kp)
            made += weight * float(np.mean(_position_error(speed, part, view, axis) ** 2))
            gap += weight * square.get("position", 0.0)
    return min(1.0, made / gap) if gap > 0.0 else 1.0


def _position_error(speed: np.ndarray, part: BlockResidual, view: RunView, axis: Axis) -> np.ndarray:
    """Position error (sample,) that an error of the speed set point causes in closed loop: x' = e - Kv x, e held over a sample."""
    step = float(np.median(np.diff(part.index))) * view.trace.period if len(part.index) > 1 else view.trace.period
    gain = axis.loops.position_gain_per_s
    decay = math.exp(-gain * step)
    return np.asarray(scipy.signal.lfilter([0.0, (1.0 - decay) / gain], [1.0, -decay], speed))
