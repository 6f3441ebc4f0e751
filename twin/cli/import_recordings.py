"""`twin import`: convert recordings to a campaign, with a map that is proposed, completed or given."""

from dataclasses import replace
from pathlib import Path

from twin.cli.arguments import Args, arg, flag, positive
from twin.errors import InputError
from twin.files import output_folder
from twin.recordings.formats.by_content import FORMATS
from twin.recordings.mapping import read_map
from twin.recordings.signals import Clock

READING = (
    arg("--interval-ms", "T", "interval of the samples, for files without a time", type=positive),
    arg("--columns", "A,B,...", "names of all columns, for text without a heading: 'time [ms],position [mm],-' (-: unused)"),
)
"""What a file without a heading or without a time leaves open."""
ARGUMENTS = (
    arg("files", "FILES", f"recorded files: {FORMATS}", nargs="+"),
    arg("--map", "MAP", "map (.toml) from columns to axes and signals; a partial map is completed (default: proposed from names and numbers, written "
        "to CAMPAIGN/map.toml)"),
    arg("--out", "CAMPAIGN", "folder for the campaign (without --out: only print what the files hold)"),
    *READING,
    arg("--machine", "FILE", "machine file to check against (default: from the map)"),
    flag("--no-picture", "do not plot the runs"),
)  # fmt: skip


def reading_of(args: Args) -> tuple[Clock | None, dict[str, object]]:
    """Clock and [csv] table of these arguments."""
    dialect: dict[str, object] = {"columns": [c.strip() for c in args.columns.split(",")]} if args.columns else {}
    return Clock(interval_s=args.interval_ms * 1e-3) if args.interval_ms else None, dialect


def carry_out(args: Args) -> None:
    """Import the files and print a report."""
    files = [Path(f) for f in args.files]
    clock, dialect = reading_of(args)
    given = read_map(args.map, args.machine) if args.map else None
    if given is not None and not given.partial and args.out is None:
        raise InputError("--out is missing; name the folder for the campaign")
    if given is None or given.partial:
        from twin.recordings.imported import proposal_of

        found = proposal_of(files, clock, dialect, given)
        print(found.table)
        if args.out is None:
            print(f"\n{found.map}\nnothing is written; give --out CAMPAIGN to import")
            return
        path = Path(args.out) / "map.toml"
        if path.with_name("campaign.toml").exists() and not path.with_name("import.json").exists():
            raise InputError(f"{args.out}: holds a campaign that was not imported; give another --out")
        if path.exists() and path.read_text(encoding="utf-8", errors="replace") != found.map:
            raise InputError(f"{path}: differs from the map proposed now; use it with --map {path}, or remove it")
        output_folder(args.out)
        found.write(path)
        print(f"\nmap proposed from names and numbers: {path}")
        given = read_map(path, args.machine)
    from twin.recordings.imported import MOST_PICTURES, import_campaign

    mapping = replace(given, clock=clock or given.clock, dialect={**given.dialect, **dialect})
    traces = import_campaign(mapping, files, Path(args.out), picture=not args.no_picture, say=print)
    drawn = "of each" if traces <= MOST_PICTURES else f"of the first {MOST_PICTURES} of a recording"
    pictures = "" if args.no_picture else f", a picture (.png) {drawn}"
    print(f"written to {args.out}: campaign.toml, {traces} trace{'s' * (traces > 1)}{pictures}, import.json")
