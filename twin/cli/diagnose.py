"""`twin diagnose`: find where a measured campaign differs from the twin, which effects cause it, and how far they close the gap."""

from __future__ import annotations

import argparse
from pathlib import Path

from twin.cli.arguments import add_campaign, add_machine, add_open, add_place, machine_of, open_report, seed, setpoints_of_input
from twin.files import output_folder
from twin.progress import Progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    add_campaign(parser)
    add_machine(parser)
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for diagnosis.json, machine.toml, report.html, diagnosis.rrd")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="less than half the time: fewer candidates, no search on axes at noise level",
    )
    parser.add_argument("--program", metavar="INPUT", help="also compute the gap budget for this part program or trace")
    add_place(parser)
    parser.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of the simulated noise (default 0)")
    add_open(parser)


def carry_out(args: argparse.Namespace) -> int:
    """Diagnose a campaign, write the files and print the verdict."""
    from twin.diagnose import diagnose
    from twin.diagnose.output import summary_text, write_diagnosis
    from twin.recordings.campaign import MeasuredRun, read_campaign
    from twin.simulation.setpoints import check_travel, setpoints_of

    machine = machine_of(args)
    campaign = read_campaign(args.campaign, machine)
    program = None
    if args.program:
        source = Path(args.program)
        read, trace = setpoints_of_input(source, machine, args.place)
        check_travel(setpoints_of(trace, machine), machine, str(source))
        program = MeasuredRun(source.name, trace, read.feedforward if read else None, 0.0)
    out = output_folder(args.out)
    with Progress("diagnosing", total=None) as bar:
        diagnosis = diagnose(campaign, machine, quick=args.quick, seed=args.seed, progress=bar.say, program=program)
    document = write_diagnosis(diagnosis, out)
    print(summary_text(document))
    move = "" if diagnosis.proposal.move is None else ", next_measurement.csv"
    print(f"written to {out}: diagnosis.json, machine.toml, report.html, diagnosis.rrd{move}")
    open_report(args, out / "report.html")
    return 0
