"""Signals of a run that follow from its command: what the control feeds forward, and the acceleration of the motor in axis units.

A SINUMERIK records VFFWS and TFFWS, from which gain and delay of the feedforward are read; `torque_feedforward` the loop records itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation.lanes import commissioned_inertia
from twin.simulation.setpoints import Setpoints, command_of


def with_command_columns(trace: Trace, machine: Machine, setpoints: Setpoints) -> Trace:
    """The trace with `velocity_feedforward` [m/s, rad/s], held over each position cycle, and `acceleration` [m/s2, rad/s2]."""
    cycle = np.floor(trace.time / machine.position_cycle + 1e-6).astype(int)
    command = command_of(machine, commissioned_inertia(machine), setpoints, 0, int(cycle[-1]) + 1)
    signals = dict(trace.signals)
    for a, axis in enumerate(machine.axes):
        signals[axis.name, "velocity_feedforward"] = command.velocity_feedforward[cycle, a]
        if trace.has(axis.name, "velocity"):
            signals[axis.name, "acceleration"] = np.gradient(trace.get(axis.name, "velocity"), trace.time)
    return replace(trace, signals=signals)
