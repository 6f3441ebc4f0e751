"""`twin watch FOLDER`: dated campaigns or short recordings of one machine into a history; says what changed, by what cause, and raises an alarm."""

from pathlib import Path

from twin.cli.arguments import MACHINE, OPEN, Args, arg, finish, machine_of, positive
from twin.files import write_json
from twin.progress import Progress

ARGUMENTS = (
    arg("folder", "FOLDER", "dated campaigns (2026-05-03/campaign.toml) or traces (2026-05-03.parquet)"),
    MACHINE,
    arg("--out", "HISTORY", "folder for history.sqlite, history.json, report.html; run again, it continues", required=True),
    arg("--tolerance-um", "W", "a growing change is a fault where it alone moves the tool by this much [um]", type=positive),
    arg("--limit", "NAME:AXIS:PARAMETER=VALUE", "a growing effect is a fault at this size, e.g. backlash:X:clearance=15um (repeatable; default: its usual size)",
        action="append", default=[]),
    OPEN,
)  # fmt: skip


def carry_out(args: Args) -> int:
    """Judge what is new, write the history, print what changed; exit code 1 on an alarm."""
    from twin.effects.setting import parse_setting
    from twin.history.document import history_document, summary_text, write_history_page
    from twin.history.watch import watch

    machine, folder, out = machine_of(args), Path(args.folder), Path(args.out)
    limits = [parse_setting(text, machine, "--limit") for text in args.limit]
    tolerance = None if args.tolerance_um is None else args.tolerance_um * 1e-6
    with Progress("watching", total=None) as bar:
        history, notes = watch(folder, out, machine, limits=limits, tolerance=tolerance, progress=bar.say)
    document = history_document(history, machine, notes, folder)
    write_json(document, out / "history.json", "history")
    write_history_page(document, out / "report.html")
    print(summary_text(document))
    finish(args, out, "history.sqlite, history.json, report.html")
    return 1 if document["alarm"] else 0
