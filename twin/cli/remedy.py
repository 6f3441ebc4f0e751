"""`twin remedy DIAGNOSIS|MACHINE`: what to set in the control and do at the machine, what it brings, and the control's own files."""

import math
from pathlib import Path

from twin.cli.arguments import EFFECT, MARGINS, OPEN, PLACE, Args, arg, finish, machine_of, out_argument, positive, setpoints_of_input
from twin.documents import read_text
from twin.errors import InputError
from twin.files import output_folder, write_json, write_whole
from twin.progress import Progress
from twin.units import in_words

ARGUMENTS = (
    arg("source", "DIAGNOSIS|MACHINE", "folder of a diagnosis, its diagnosis.json, or a machine file with effects (default: the Mikron UCP 710)", nargs="?"),
    EFFECT,
    arg("--program", "INPUT", "part program or trace that judges the error (default: a circle of two axes)"),
    arg("--target-um", "T", "RMS error at the tool point to reach [um] (default 5)", type=positive, default=5.0),
    arg("--tolerance-um", "W", "tolerance of the part: largest error at the tool point to stay within [um]", type=positive),
    *MARGINS,
    arg("--control", "C", "sinumerik (default), heidenhain, linuxcnc or isg: whose files to write"),
    arg("--saved", "FILE.COM", "HEIDENHAIN: a correction file that the control saved, to be filled", action="append", default=[]),
    out_argument("folder for remedy.json, machine.toml, before.toml, motion.parquet, control/, replay.rrd, report.html"),
    PLACE,
    OPEN,
)  # fmt: skip


def carry_out(args: Args) -> None:
    """Choose, tune and predict the changes; write the files; print what to set."""
    from twin.machine.check import asked_of
    from twin.machine.machine import write_machine
    from twin.recordings.trace import write_trace
    from twin.remedy.choose import Goal, Task
    from twin.remedy.control_data import CONTROLS, entries_of, files_for, not_said
    from twin.remedy.predict import given_motion, slowed, standard_motions
    from twin.remedy.remedy import calibrated_in, deviations_of, machine_file_of, refusals, remedy, remedy_document, sentence
    from twin.remedy.report import REPLAY, entry_text, in_short, write_remedy_report
    from twin.replay.recording import write_recording
    from twin.simulation.setpoints import trace_of

    given, args.control = args.control, args.control or CONTROLS[0]
    if args.control not in CONTROLS:
        raise InputError(f"--control {args.control}: use one of {', '.join(CONTROLS)}")
    file, document = machine_file_of(Path(args.source)) if args.source else (None, {})
    args.machine = file and str(file)
    machine = machine_of(args)
    standard = standard_motions(machine)
    on, elsewhere = standard[0], standard[1:]
    if args.program:
        _, trace = setpoints_of_input(Path(args.program), machine, args.place)
        on = given_motion(Path(args.program).name, trace, machine)
        elsewhere = [*standard, slowed(on, machine, 0.5)]
    saved = [read_text(Path(file), "a .COM file of the control") for file in args.saved]
    goal = Goal(args.target_um * 1e-6, math.inf if args.tolerance_um is None else args.tolerance_um * 1e-6)
    out = output_folder(args.out)
    with Progress("looking for a remedy", total=None) as bar:
        asked = asked_of(args.phase_margin_deg, args.gain_margin_db)
        task = Task(machine, on, elsewhere, goal, asked, args.control, calibrated_in(document))
        found = remedy(task, deviations_of(document), bar.say)
    content = remedy_document(found)
    files, by_hand = files_for(list(found.changes), machine, args.control, saved)
    by_hand = [*(not_said(machine) if found.changes and not given else []), *by_hand]
    for change, entry in zip(found.changes, content["changes"]):
        entries = entries_of(change, machine, args.control).entries
        entry["control"] = {e.name: e.value for e in entries}
        entry["enter"] = [e._asdict() for e in entries]
    content |= {"control": args.control, "files": sorted(files), "by_hand": by_hand}
    write_json(content, out / "remedy.json", "remedy")
    write_machine(found.remedied, out / "machine.toml")
    write_machine(machine, out / "before.toml")
    write_trace(trace_of(on.setpoints, machine), out / "motion.parquet")
    for name, text in files.items():
        write_whole(out / "control" / name, text)
    write_recording(out / REPLAY, machine, found.runs, summary="\n".join(in_short(found, content)))
    write_remedy_report(found, content, document, out, file.parent / "report.html" if file and document else None)
    print("\n".join(in_short(found, content)))
    for change, entry in zip(found.changes, content["changes"]):
        print(f"  {sentence(found, change)}: {entry['before']:.2f} -> {entry['after']:.2f} um")
        print("".join(f"    enter {text}\n" for text in map(entry_text, entry["enter"])), end="")
    print("".join(f"  by hand: {text}\n" for text in by_hand), end="")
    print("".join(f"  no setting cures {text}\n" for text in refusals(found.refused)), end="")
    print(
        "".join(f"  at the machine, {one['axis']} {in_words(one['effect'])}: {one['do']}\n" for one in content["at_the_machine"]),
        end="",
    )
    finish(args, out, f"remedy.json, machine.toml, before.toml, motion.parquet, replay.rrd, report.html{', control/' if files else ''}")
