"""A machine from a recording alone, identified: lumped parameters and tried gains are the start, the closed-loop fit of `twin identify` decides.

An axis keeps its first values where the fit does not predict the held-out motion better, and where the recording does not show them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from twin.errors import TwinError
from twin.files import write_whole
from twin.identify.campaign_fit import identify_campaign
from twin.identify.write import write_identified
from twin.machine.from_recording import NewMachine, machine_from_recording, reproductions_of
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign


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
