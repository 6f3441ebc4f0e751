"""`twin identify`: identify the parameters of a machine, with 95 % intervals, from measured traces."""

from pathlib import Path
import sys

from twin.cli.arguments import CAMPAIGN, JSON, MACHINE, OPEN, Args, arg, flag, machine_of, number, open_report
from twin.errors import InputError
from twin.files import output_file, write_json
from twin.progress import Progress

STEPS = 14
"""Approximate number of steps of an identification, for the progress bar."""


ARGUMENTS = (
    CAMPAIGN,
    arg("--out", "MACHINE.toml", "machine file to write; its MJCF is copied beside it", required=True),
    MACHINE,
    JSON,
    OPEN,
    flag("--no-refine", "regression only, without the fit in closed loop"),
    arg(
        "--torque-constant-within", "FRACTION",
        "relative uncertainty of the torque constants, e.g. 0.001 (default: parameter_tolerance)",
        type=number("a fraction between 0 and 1, e.g. 0.001 for 0.1 %", lambda v: 0.0 <= v < 1.0),
    ),
)  # fmt: skip


def carry_out(args: Args) -> None:
    """Identify; write machine file, report and JSON; print the table."""
    from twin.identify.check_recording import in_sentences
    from twin.identify.identify import identify
    from twin.identify.report import parameters_table, summary, write_report
    from twin.identify.write import as_json, write_identified
    from twin.recordings.campaign import read_campaign
    from twin.simulation.summary import table

    out = Path(args.out)
    if out.suffix.lower() != ".toml":
        raise InputError(f"--out {out}: the name of a machine file must end in .toml; rename it")
    machine = machine_of(args)
    campaign = read_campaign(args.campaign, machine)
    output_file(out)  # fails before the long computation
    with Progress("identifying", STEPS) as bar:
        result = identify(
            campaign, machine, refine=not args.no_refine, torque_constant_tolerance=args.torque_constant_within, progress=bar.step
        )
    if not result.refused:
        write_identified(result, out)
    with Progress("drawing the report", total=0):
        files = write_report(result, out.with_suffix(".html"))
    for finding in in_sentences(result.findings):
        print(f"finding: {finding}", file=sys.stderr)
    for note in result.notes:
        print(note)
    found = parameters_table(result)
    print(table(found.heading, found.rows, found.left))
    short = summary(result)
    print("\n".join([*short.paragraphs, *short.items]))
    if not all(result.tolerance_holds.values()):
        print("The identified products contradict parameter_tolerance; the torque constants of the machine file were kept.")
    if args.json:
        write_json(as_json(result), Path(args.json), "identification")
    if result.refused:
        raise InputError(f"{out}: {result.refused}; see {files[0]}")
    print(f"written: {out}, {files[0]}")
    open_report(args, Path(files[0]))
