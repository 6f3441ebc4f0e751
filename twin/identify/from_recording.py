"""A machine from a recording alone, identified: lumped parameters and tried gains are the start, the closed-loop fit of `twin identify` decides.

An axis keeps its first values where the fit does not predict the held-out motion better, and where the recording does not show them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from twin.errors import InputError, TwinError
from twin.files import write_whole
from twin.identify.campaign_fit import identify_campaign
from twin.identify.first_values import first_values
from twin.identify.write import write_identified
from twin.machine.from_recording import NewMachine, reproductions_of, write_tried_machine
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign


def machine_from_recording(folder: Path, out: Path, say: Callable[[str], None] = lambda _text: None) -> NewMachine:
    """Write the first machine file and its model. Raises InputError if no axis moves, or if no stable machine reproduces one."""
    if out.suffix != ".toml":
        raise InputError(f"--out {out}: a machine file ends in .toml; rename it")
    for path in (out, out.with_suffix(".xml")):
        if path.exists():
            raise InputError(f"{path}: exists already; give another name or remove it")
    runs = read_campaign(folder).runs
    names = list(dict.fromkeys(axis for run in runs for axis in run.trace.axes))
    common = [n for n in names if all(run.trace.has(n, "setpoint") for run in runs) and any(run.trace.moves(n) for run in runs)]
    if not common:
        raise InputError(f"{folder}: no axis moves in its runs; record a move")
    say("laws of the controls")
    return write_tried_machine(out, first_values(runs, common), runs, folder.name, say)


def identified_from_recording(folder: Path, out: Path, say: Callable[[str], None] = lambda _text: None) -> NewMachine:
    """Write the machine file and its model. Raises InputError as `machine_from_recording` does."""
    made = machine_from_recording(folder, out, say)
    first, text = load_machine(out), out.read_text(encoding="utf-8")
    try:
        result = identify_campaign(first, read_campaign(folder, first), progress=say)
        if result.refused:
            return made
        write_identified(result, out)
        followed = reproductions_of(load_machine(out), folder, made.lumps)
    except TwinError:  # the first machine is what this recording gives
        followed = {}
    if not followed or sum(one.merit for one in followed.values()) > sum(one.merit for one in made.followed.values()):
        write_whole(out, text)
        return made
    return replace(made, followed=followed)
