"""Does the recorded position controller have the blocks that the machine file lists?

A block that changes the set points is dropped, and the law fitted again: without one that the control lacks it leaves less than any rival may. A
part of the output, such as a pulse or an integral, is missing if a law without it leaves only rounding and the part would be larger.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from twin.control.block import Listed
from twin.identify.axis_run import AxisRun, behind_blocks
from twin.identify.position_control import PositionControl, fit_position_control
from twin.identify.position_law import RIVAL_RATIO, PositionLaw, level
from twin.machine.machine import Axis, Machine
from twin.simulation.drive_setpoints import with_blocks
from twin.simulation.loop_terms import SETPOINT, SPEED
from twin.units import AXIS_UNITS, in_words


def false_set_point_block(machine: Machine, axis: Axis, runs: Sequence[AxisRun], found: PositionControl | str) -> str:
    """Which listed block of the set points contradicts the record, with what the law leaves with and without it; '' if none does."""
    if isinstance(found, PositionControl) and found.only_rounding:
        return ""
    unit, factor = AXIS_UNITS[axis.kind].speed
    for one in axis.blocks:
        if one.block.stage != SETPOINT and one.block.kernel is None:
            continue
        without = replace(axis, blocks=tuple(b for b in axis.blocks if b is not one))
        other = fit_position_control(
            without, [behind_blocks(machine, without, run) for run in runs], machine.setpoint_interpolation, only=True
        )
        if isinstance(other, str) or (isinstance(found, PositionControl) and RIVAL_RATIO * other.residual_rms > found.residual_rms):
            continue
        left = f"{found.residual_rms * factor:.2g} {unit}" if isinstance(found, PositionControl) else "too much"
        return (
            f"the file lists {in_words(one.block.name)}, but without it the law leaves {other.residual_rms * factor:.2g} {unit} RMS instead of {left}; "
            f"correct [axis.{axis.name}.block.{one.block.name}], or let 'twin diagnose' size it"
        )
    return ""


def missing_parts(machine: Machine, axis: Axis, runs: Sequence[AxisRun], found: PositionControl) -> list[str]:
    """Parts of the output that the file lists and the recorded controller does not have, in words; none if its law leaves more than rounding."""
    if not found.only_rounding:
        return []
    law = PositionLaw(axis, runs, found.interpolation)
    return [
        f"the file lists {in_words(one.block.name)} ({', '.join(map(in_words, numbers))}); the recorded speed set point has none"
        for one, numbers in _parts(axis)
        if not any(f"{one.block.name}.{n.key(axis.kind)}" in found.blocks for n in one.block.numbers if n.name in numbers)
        and _size_of(one, numbers, machine, law, found) > RIVAL_RATIO * found.residual_rms
    ]


def _parts(axis: Axis) -> Iterator[tuple[Listed, tuple[str, ...]]]:
    """The listed blocks at the output, with the numbers of each of their strengths that the file gives."""
    for one in axis.blocks:
        for numbers in one.block.strengths if one.block.stage == SPEED else ():
            if given := tuple(name for name in numbers if one.values.get(name)):
                yield one, given


def _size_of(one: Listed, numbers: Sequence[str], machine: Machine, law: PositionLaw, found: PositionControl) -> float:
    """RMS of what some numbers of a listed block would add to the recorded speed set point [axis units a second]."""
    x, name = np.array(list(found.values.values())), law.axis.name
    lacking = machine.with_axis(name, **{f"block.{one.block.name}.{number}": 0.0 for number in numbers}).axis(name)
    parts = []
    for k, (run, rows) in enumerate(zip(law.runs, law.usable_rows())):
        setpoint, fed = (law.read(run, run.start - late) for late in x[2:])
        with_it, without = (
            with_blocks(axis, x[0], machine, setpoint, fed, law.error(run, x[2]), law.output(k, x), (SPEED,))
            for axis in (law.axis, lacking)
        )
        parts.append(level((with_it - without)[rows]))
    return float(np.std(np.concatenate(parts)))
