"""From a program file to set points in one call."""

from __future__ import annotations

from pathlib import Path

from twin.machine.machine import Machine, load_machine
from twin.program import interpolator
from twin.program.moves import Program
from twin.program.read import read_program
from twin.recordings.trace import Trace


def interpolate(program: str | Path | Program, machine: Machine | None = None) -> Trace:
    """Set points of a part program (.mpf .ngc .apt), at the machine's position cycle, as a trace.

    Columns `<axis>.setpoint` [m, rad] (sample,), and of the pseudo axis `program` the block, line, feed and path length of each sample.
    Raises InputError with file and line for a word that is not understood and for a position outside an axis' travel.
    """
    machine = machine or load_machine()
    return interpolator.interpolate(program if isinstance(program, Program) else read_program(Path(program), machine), machine)
