"""Cuts a part along the path of a run, a trace or a program, in one call."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from twin.errors import InputError
from twin.machine.machine import Machine, load_machine
from twin.recordings.trace import Trace
from twin.simulation.result import Run
from twin.surface.levels import AS_FILED, LEVELS, levels_of_program, levels_of_trace
from twin.surface.machining import Machining, machine_part
from twin.surface.part import Part, read_part


def cut(
    moved: Run | Trace | str | Path, part: str | Path | Part, machine: Machine | None = None, *, levels: Sequence[str] = LEVELS
) -> Machining:
    """Remove material along the tool path of a run, a trace, or a part program, which is simulated first with the
    feedforward of the machine.

    `part` is a part file (tool, stock, surfaces; see examples/parts). `levels` are the paths to cut: 'programmed' (programs only),
    'commanded' (set points), 'followed' (positions). The result holds the heights of every cut surface [m]; `report_of` in
    twin.surface.machining evaluates marks and roughness. Raises InputError if a path never touches the part.
    """
    unknown = set(levels) - set(LEVELS)
    if unknown:
        raise InputError(f"cut: no level '{sorted(unknown)[0]}'; use {', '.join(LEVELS)}")
    machine = machine or (moved.machine if isinstance(moved, Run) else load_machine())
    known = part if isinstance(part, Part) else read_part(part)
    if isinstance(moved, str | Path):
        return machine_part(known, levels_of_program(Path(moved), machine, known.tool, list(levels), [AS_FILED]))
    trace = moved.trace if isinstance(moved, Run) else moved
    return machine_part(known, levels_of_trace(trace, machine, known.tool, list(levels), "cut"))
