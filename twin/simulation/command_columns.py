"""Signals of a run that follow from its command: velocity feedforward, and acceleration of the motor in axis units.

A SINUMERIK records them as VFFWS and TFFWS; identification reads weight and delay of the feedforward from them. The loop records `torque_feedforward`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation.plant_spec import commissioned_inertia
from twin.simulation.position_command import command_of
from twin.simulation.setpoints import Setpoints


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
