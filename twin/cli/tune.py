"""`twin tune MACHINE`: gains, feedforward and delays of the healthy machine, beside the symmetrical optimum and the values in the file."""

from pathlib import Path

from twin.cli.arguments import EFFECT, GIVEN_MACHINE, MARGINS, OPEN, PLACE, Args, arg, finish, machine_of, out_argument, setpoints_of_input
from twin.files import output_folder
from twin.progress import Progress

ARGUMENTS = (
    GIVEN_MACHINE,
    EFFECT,
    arg("--program", "INPUT", "part program or trace for the fit of delays (default: a circle of two axes)"),
    *MARGINS,
    out_argument("folder for machine.toml and report.html"),
    PLACE,
    OPEN,
)


def carry_out(args: Args) -> None:
    """Tune; write the machine file and the page; print the table."""
    from twin.machine.check import asked_of
    from twin.machine.machine import write_machine
    from twin.remedy.predict import given_motion, standard_motions
    from twin.remedy.tune import changed_numbers, tune
    from twin.remedy.tune_report import HEADING, mode_sentences, rows_of, sentence_of, write_tune_report
    from twin.simulation.summary import table

    machine = machine_of(args)
    asked = asked_of(args.phase_margin_deg, args.gain_margin_db)
    if args.program:
        _, trace = setpoints_of_input(Path(args.program), machine, args.place)
        on = given_motion(Path(args.program).name, trace, machine)
    else:
        on = standard_motions(machine)[0]
    out = output_folder(args.out)
    with Progress("tuning", total=None) as bar:
        found = tune(machine, on, asked, bar.say)
        modes = mode_sentences(found[-1], asked)
    moved = changed_numbers(found[0].machine, found[-1].machine)
    write_machine(machine.with_values({key: new for key, (_, new) in moved.items()}), out / "machine.toml")
    write_tune_report(found, on.name, modes, out / "report.html")
    print(table(HEADING, rows_of(found), left=2))
    print(sentence_of(found, on.name), *modes, sep="\n")
    finish(args, out, "machine.toml, report.html")
