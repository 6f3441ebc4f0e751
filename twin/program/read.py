"""One door to all program formats, chosen by the ending of the file."""

from __future__ import annotations

from pathlib import Path

from twin.errors import InputError, nearest
from twin.machine.machine import Machine
from twin.program.moves import Program

GCODE = (".mpf", ".spf", ".ngc", ".nc", ".iso")
APT = (".apt", ".cls", ".cl", ".aptsource", ".ncl", ".cldata", ".cld")
PROGRAM_ENDINGS = (*GCODE, *APT)
"""What a file that is a part program ends in."""


def read_program(path: str | Path, machine: Machine) -> Program:
    """Read a part program: Sinumerik or ISO G-code, or APT/CL; every fault is an InputError with line and column."""
    path = Path(path)
    ending = path.suffix.lower()
    if ending in GCODE:
        from twin.program.gcode import read_gcode

        return read_gcode(path, machine)
    if ending in APT:
        from twin.program.apt import read_apt

        return read_apt(path, machine)
    raise InputError(f"{path}: '{ending}' is no ending of a program; {nearest(ending, PROGRAM_ENDINGS)}")
