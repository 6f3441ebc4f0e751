"""`twin gap`: simulate every run of a measured campaign and compare signal by signal."""

from __future__ import annotations

import argparse
from pathlib import Path

from twin.cli.arguments import add_campaign, add_machine, machine_of
from twin.files import write_json
from twin.progress import Progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    add_campaign(parser)
    add_machine(parser)
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON")


def carry_out(args: argparse.Namespace) -> int:
    """Simulate and compare; print one line per run and axis."""
    from dataclasses import asdict

    from twin.effects import settings_of
    from twin.recordings.campaign import read_campaign
    from twin.simulation.gap import COMPARED, gap_of_campaign
    from twin.simulation.summary import table

    machine = machine_of(args)
    settings_of(machine)
    campaign = read_campaign(args.campaign, machine)
    with Progress("comparing", total=len(campaign.runs)) as bar:
        gaps = gap_of_campaign(machine, campaign, progress=lambda _run: bar(None))
    shown = [s for s in COMPARED if any(s in signals for axes in gaps.values() for signals in axes.values())]
    rows = []
    for run, axes in gaps.items():
        for axis, signals in axes.items():
            cells = [f"{g.rms:.3f} {g.max:.2f} {g.noise:.3f} {g.unit}" if (g := signals.get(s)) else "-" for s in shown]
            rows.append([run, axis, *cells])
    print("measured minus simulated, each: RMS, largest, RMS that noise alone makes")
    print(table(["run", "axis", *(s.replace("_", " ") for s in shown)], rows))
    if args.json:
        plain = {run: {axis: {s: asdict(g) for s, g in signals.items()} for axis, signals in axes.items()} for run, axes in gaps.items()}
        write_json({"runs": plain}, Path(args.json))
    return 0
