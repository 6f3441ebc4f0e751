"""`twin check`: whether programs are understood, fit the machine and keep its limits."""

from pathlib import Path

from twin.cli.arguments import JSON, MACHINE, PLACE, Args, arg, flag, machine_of
from twin.errors import InputError
from twin.files import shipped_example, write_json
from twin.progress import Progress

SHOWN = 12
"""Most reasons printed; the JSON file has all."""


ARGUMENTS = (
    arg("programs", "FOLDER_OR_PROGRAM", "part program, or folder of part programs", type=shipped_example),
    MACHINE,
    PLACE,
    flag("--read-only", "only read the programs; no times, no check of limits"),
    JSON,
)


def carry_out(args: Args) -> None:
    """Check every program; print a line for each, then the most frequent reasons. InputError if one is refused or too large."""
    from twin.program.check_folder import check_program, document, opening_words, programs_in, reasons
    from twin.simulation.summary import table

    machine = machine_of(args)
    folder = Path(args.programs)
    paths = programs_in(folder)
    with Progress("checking", total=len(paths)) as bar:
        found = []
        for path in paths:
            found.append(check_program(path, machine, place=args.place == "auto", plan=not args.read_only))
            bar(None)
    rows = []
    for one in found:
        name = str(one.path.relative_to(folder)) if folder.is_dir() else one.path.name
        time = f"{one.duration_s:.1f} s" if one.duration_s is not None else "-"
        rows.append([name, one.verdict, str(one.moves) if one.understood else "-", time, (one.reason or "; ".join(one.limits))[:100]])
    print(table(["program", "verdict", "moves", "time", "problem"], rows, left=2))
    count = sum(one.understood for one in found)
    fits = sum(one.fits for one in found)
    print(
        f"\n{len(found)} program{'s' * (len(found) > 1)} on {machine.name}: {count} understood, {fits} fit, {sum(one.verdict == 'ok' for one in found)} within limits"
    )
    for reason, times, first in reasons(found)[:SHOWN]:
        print(f"  {times} x {reason[:120]}" + (f"\n      first in {first[:140]}" if len(found) > 1 else ""))
    if words := opening_words(found):
        shown = ", ".join(f"{w} ({opens} / {stops})" for w, opens, stops in words[:SHOWN])
        print(f"\nunknown words (programs that could be read with this word alone / that it stops): {shown}")
    if args.json:
        write_json(document(found, machine), Path(args.json), "programs")
    if refused := [one for one in found if not one.fits]:
        of = f"{len(refused)} of {len(found)} programs cannot be run, the first: " if folder.is_dir() else ""
        raise InputError(f"{of}{refused[0].path}: {refused[0].reason}")
