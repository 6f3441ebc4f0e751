"""Identify a machine from a campaign in one call."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from twin.identify.campaign_fit import identify_campaign
from twin.identify.result import Identification
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import Campaign, read_campaign


def identify(
    campaign: Campaign | str | Path, machine: Machine | None = None, *, refine: bool = True, progress: Callable[[str], None] | None = None
) -> Identification:
    """Friction, inertia, gravity, gains and delays of a machine from its own traces, each with a 95 % interval.

    `campaign` is a campaign or its folder; `machine` the machine to start from. `refine` fits in closed loop what the regression leaves open.
    In the result, `parameters` are in SI and `machine` is the identified machine. Raises InputError if the runs lack the needed signals.
    """
    machine = machine or load_machine()
    known = campaign if isinstance(campaign, Campaign) else read_campaign(campaign, machine)
    return identify_campaign(machine, known, refine=refine, progress=progress)
