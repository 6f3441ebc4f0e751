"""Blocks of a control that its recorded speed set point shows and the machine file does not list, such as a friction pulse or an integral."""

from collections.abc import Iterable, Sequence
import math

from twin.errors import InputError
from twin.identify.axis_run import axis_run
from twin.identify.position_control import PositionControl, fit_position_control
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun


def unlisted_blocks(machine: Machine, runs: Sequence[MeasuredRun], axes: Iterable[str]) -> list[str]:
    """A sentence for each of these axes whose record shows such a block, with its numbers as a machine file holds them."""
    notes = []
    for axis in map(machine.axis, axes):
        recorded = [run for run in runs if all(run.trace.has(axis.name, s) for s in ("setpoint", "velocity_setpoint"))]
        try:
            seen = [one for run in recorded if (one := axis_run(machine, axis, run)) is not None]
        except InputError:  # the record does not show each cycle of the control
            continue
        law = fit_position_control(axis, seen, machine.setpoint_interpolation, any_time=True) if seen else ""
        listed = {one.block.name for one in axis.blocks}
        blocks = law.blocks if isinstance(law, PositionControl) else {}
        found = {key: of for key, of in blocks.items() if key.split(".")[0] not in listed and math.isfinite(of[1])}
        if shown := [f"{key} = {value:.4g} +- {half:.1g}" for key, (value, half) in found.items()]:
            notes.append(
                f"axis {axis.name}: its recorded speed set point shows {', '.join(shown)}, which the machine file does not list; "
                f"add it below [axis.{axis.name}.block] ('twin identify' writes pulses and parts of a PID itself) and diagnose again"
            )
    return notes
