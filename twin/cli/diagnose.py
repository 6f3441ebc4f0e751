"""`twin diagnose`: find where a measured campaign differs from the twin, which effects cause it, and how far they close the gap.

Raw recordings instead of a campaign: they are imported, a machine is made from them where none is given, and a card states what the
recording shows by itself. The card is always written; a diagnosis follows if the recording allows it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.cli.arguments import OPEN, PLACE, Args, arg, finish, flag, machine_argument, machine_of, out_argument, seed, setpoints_of_input
from twin.cli.import_recordings import READING, reading_of
from twin.errors import InputError, TwinError
from twin.files import output_folder, shipped_example
from twin.machine import load_machine
from twin.machine.axis_lumps import AxisLumps
from twin.machine.machine import Machine
from twin.progress import Progress
from twin.recordings.campaign import MeasuredRun, is_campaign, read_campaign
from twin.system import shell_word

ARGUMENTS = (
    arg("inputs", "INPUT", "folder of a campaign, or raw recordings of a control or an instrument", nargs="+", type=shipped_example),
    machine_argument("the Mikron UCP 710 that ships with twin; for raw recordings a machine made from them"),
    out_argument("folder for diagnosis.json, machine.toml, report.html, diagnosis.rrd"),
    arg("--map", "MAP", "map (.toml) of raw recordings (default: DIR/campaign/map.toml, else a proposed one)"),
    *READING,
    flag("--quick", "less than half the time: fewer candidates, no search on axes at noise level (always for raw recordings)"),
    arg("--since", "BASELINE", "earlier campaigns of the same machine: say what is different now, in place of what differs from the machine file", nargs="+"),
    arg("--program", "INPUT", "also compute the gap budget for this part program or trace"),
    PLACE,
    arg("--seed", "N", "seed of the simulated noise (default 0)", type=seed, default=0),
    OPEN,
)  # fmt: skip


def carry_out(args: Args) -> None:
    """Diagnose a campaign or raw recordings, write the files and print the verdict."""
    inputs = [Path(i) for i in args.inputs]
    if len(inputs) == 1 and inputs[0].is_dir() and not is_campaign(inputs) and not any(inputs[0].iterdir()):
        raise InputError(f"{inputs[0]}: holds no files; give a campaign or recordings")
    if len(inputs) > 1 and (folder := next((one for one in inputs if is_campaign([one])), None)):
        raise InputError(f"{folder}: a campaign beside other inputs; diagnose one campaign, or compare it with an earlier one: --since")
    if args.since:
        return _since(args, inputs)
    if not is_campaign(inputs):
        return _raw(args, inputs)
    _diagnosed(args, inputs[0], machine_of(args), output_folder(args.out))


def _diagnosed(args: Args, folder: Path, machine: Machine, out: Path) -> dict[str, Any]:
    """Diagnose a campaign on a machine, write the files, print the verdict; returns the document."""
    from twin.diagnose import diagnose
    from twin.diagnose.output import summary_text, write_diagnosis
    from twin.simulation.setpoints import check_travel, setpoints_of

    campaign, program = read_campaign(folder, machine), None
    if args.program:
        source = Path(args.program)
        read, trace = setpoints_of_input(source, machine, args.place)
        check_travel(setpoints_of(trace, machine), machine, str(source))
        program = MeasuredRun(source.name, trace, read.feedforward if read else None, 0.0)
    with Progress("diagnosing", total=None) as bar:
        diagnosis = diagnose(campaign, machine, quick=args.quick, seed=args.seed, progress=bar.say, program=program)
    document = write_diagnosis(diagnosis, out)
    print(summary_text(document))
    move = "" if diagnosis.proposal.move is None else ", next_measurement.csv"
    finish(args, out, f"diagnosis.json, machine.toml, report.html, diagnosis.rrd{move}")
    return document


def _since(args: Args, inputs: list[Path]) -> None:
    """What is different from earlier campaigns: diagnose the latest of them first, unless the machine has effects already, then compare."""
    from twin.diagnose.check_campaign import same_machine
    from twin.diagnose.first.raw import machine_of_campaign
    from twin.history.since_output import diagnosed_since, write_since

    earlier = [shipped_example(b) for b in args.since]
    for folder in (*inputs, *earlier):
        if not folder.exists():
            raise InputError(f"{folder}: no such folder; give a campaign")
        if not is_campaign([folder]) or len(inputs) > 1:
            raise InputError(f"{folder}: --since compares campaigns; import it first: twin import {shell_word(folder)} --out CAMPAIGN")
    out = output_folder(args.out)
    machine = machine_of(args)
    if not args.machine and not same_machine(read_campaign(earlier[-1]), machine):
        with Progress("machine from the baseline", total=None) as bar:
            machine = load_machine(machine_of_campaign(earlier[-1], out, print, bar.say, identified=True)[0])
    present, baselines = read_campaign(inputs[0], machine), [read_campaign(b, machine) for b in earlier]
    with Progress("comparing", total=None) as bar:
        document, today, shown = diagnosed_since(present, baselines, machine, out, args.quick, args.seed, bar.say)
    write_since(document, today, shown, out)
    print(document["sentence"], *(f"  note: {note}" for note in document["notes"]), sep="\n")
    finish(args, out, f"diagnosis.json, machine.toml (of today), report.html{'' if machine.effects else ', baseline/'}")


def _raw(args: Args, inputs: list[Path]) -> None:
    """Import, card, machine from the recording, diagnosis. A step that the recording does not allow ends with its reason, not with an error."""
    from twin.diagnose.first.card import card_of, card_text, next_run, write_card, write_next
    from twin.diagnose.first.page import write_card_page
    from twin.diagnose.first.raw import MACHINE, campaign_of, files_of, machine_of_campaign
    from twin.diagnose.wording import verdict_sentence

    args.quick = True  # a first answer; the campaign in the folder can be diagnosed at length
    shown, args.open = args.open, False  # the card, not the report of the diagnosis
    files = files_of(inputs)
    out = output_folder(args.out)
    folder = campaign_of(files, Path(args.map) if args.map else None, out, print, *reading_of(args))
    verdict: list[str] = []
    machine = machine_of(args) if args.machine else None
    lumps: Sequence[AxisLumps] = ()
    if machine is None:
        try:
            with Progress("machine from the recording", total=None) as bar:
                file, made = machine_of_campaign(folder, out, print, bar.say)
            machine, lumps = load_machine(file), made.lumps if made else ()
        except TwinError as error:
            verdict.append(f"no machine from this recording, so no diagnosis: {error}")
            print(verdict[-1])
    card = card_of(read_campaign(folder).runs, lumps)
    print(f"\n{card_text(card)}")
    write_card(card, out / "card.json")
    if machine is not None:
        try:
            found = _diagnosed(args, folder, machine, out)
            verdict += [verdict_sentence(found), *found["notes"], f"next measurement: {found['next_measurement']}"]
        except TwinError as error:
            verdict.append(f"no diagnosis: {error}")
            print(verdict[-1])
        if (run := next_run(card, machine)) is not None:
            verdict.append(write_next(run, machine, out))
            print(verdict[-1])
    write_card_page(card, f"First answer: {', '.join(f.name for f in files[:3])}", verdict, out)
    if machine is not None:
        campaign, own, there = map(shell_word, (folder, Path(args.machine or out / MACHINE), out / "at_length"))
        print(f"at length: twin diagnose {campaign} --machine {own} --out {there}")
    args.open = shown
    finish(args, out, f"card.json, card.html, card.png, campaign/{'' if args.machine else ', machine_from_recording.toml'}", "card.html")
