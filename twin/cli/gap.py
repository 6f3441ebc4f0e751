"""`twin gap`: simulate every run of a measured campaign and compare it signal by signal."""

from pathlib import Path

from twin.cli.arguments import CAMPAIGN, JSON, MACHINE, OPEN, Args, arg, machine_of, open_report
from twin.files import write_json
from twin.progress import Progress

SHOWN = 12
"""Most outliers printed; the HTML page has all."""


ARGUMENTS = (CAMPAIGN, MACHINE, JSON, arg("--html", "FILE", "write a report"), OPEN)


def carry_out(args: Args) -> None:
    """Simulate and compare; print the verdict, the gap of each axis and the outliers."""
    from twin.compare.pages import GAP_HEADING, gap_cells, write_gap_page
    from twin.effects import settings_of
    from twin.recordings.campaign import read_campaign
    from twin.simulation.campaign_gap import AS_EXPECTED, gap
    from twin.simulation.summary import table

    machine = machine_of(args)
    settings_of(machine)
    campaign = read_campaign(args.campaign, machine)
    with Progress("comparing", total=len(campaign.runs)) as bar:
        found = gap(campaign, machine, progress=lambda _run: bar(None))
    print("\n".join([found.verdict, *found.notes]))
    print("\nLargest gap of each axis: RMS of measured minus simulated, multiple of noise alone, run")
    print(found.summary_table())
    outliers = found.outliers
    if outliers:
        most = f", the largest {SHOWN}" if len(outliers) > SHOWN else ""
        print(f"\n{len(outliers)} signals above {AS_EXPECTED:g} times noise{most}:")
        print(table(GAP_HEADING, gap_cells(outliers[:SHOWN]), left=3))
    if args.json:
        write_json(found.document(), Path(args.json), "gap")
    page = args.html or ("out/gap.html" if args.open else None)
    if page:
        write_gap_page(found, Path(page))
        print(f"written: {page}")
        open_report(args, Path(page))
