"""`twin machine new|check|show`: create a machine file, check it, print its data sheet."""

from dataclasses import asdict
from pathlib import Path

from twin.cli.arguments import GIVEN_MACHINE, Args, arg, flag, machine_of
from twin.control.structures import STRUCTURES
from twin.errors import InputError
from twin.files import all_or_none, write_json
from twin.progress import Progress
from twin.system import shell_word


def carry_out(args: Args) -> None:
    """Carry out the chosen action. A machine that is refused leaves no model behind."""
    with all_or_none():
        args.action(args)


def _new(args: Args) -> None:
    from twin.machine.new import new_machine

    out = Path(args.out)
    if (args.model is None) == (args.from_recording is None):
        raise InputError("twin machine new: give a MODEL, or --from-recording CAMPAIGN")
    if args.from_recording is not None:
        return _from_recording(args, out)
    sinumerik = Path(args.sinumerik) if args.sinumerik else None
    axes, left = new_machine(Path(args.model), out, args.structure or next(iter(STRUCTURES)), sinumerik)
    print(f"written: {out} with {len(axes)} {'axis' if len(axes) == 1 else 'axes'}: {', '.join(axes)}")
    if left:
        print(f"machine data without a key in the machine file, ignored: {', '.join(left)}")
    print(f"assumed values are marked; list them with: twin machine check {shell_word(out)}")


def _from_recording(args: Args, out: Path) -> None:
    from twin.identify.from_recording import machine_from_recording, reproduction_text

    if args.structure or args.sinumerik:
        raise InputError(
            "twin machine new --from-recording: structure and numbers come from the recording; omit --structure and --sinumerik"
        )
    with Progress("reproducing the recording") as bar:
        made = machine_from_recording(Path(args.from_recording), out, bar.say)
    print(f"written: {out} and {out.with_suffix('.xml').name} with {len(made.lumps)} {'axis' if len(made.lumps) == 1 else 'axes'}")
    for one in made.lumps:
        print(f"  {reproduction_text(one, made.followed[one.name])}")
        for note in one.notes:
            print(f"    - {note}")
    print(
        "drive and load are lumped parameters at the axis, in units of the recorded command; comments in the file state the source of each"
    )


def _check(args: Args) -> None:
    from twin.machine.check import check_machine
    from twin.machine.sheet import check_text

    machine = machine_of(args)
    checks, findings = check_machine(machine)
    print(f"{machine.name}: {len(machine.axes)} {'axis' if len(machine.axes) == 1 else 'axes'}\n")
    print(check_text(checks, findings))
    if args.out:
        from twin.machine.loops_figure import loop_figure
        from twin.report.figure import save_png

        out = Path(args.out)
        with Progress("drawing the loops", total=len(checks)) as bar:
            for check in checks:
                save_png(loop_figure(check, machine.name), out / f"loops_{check.axis.name}.png")
                bar(None)
        numbers = ("inertia", "inertia_ratio", "holding", "accelerating", "voltage", "first_mode_hz")
        loops = ({loop.name: asdict(m) for loop, m in zip(c.loops, c.margins)} for c in checks)
        axes = {c.axis.name: {"loops": own, **{k: getattr(c, k) for k in numbers}} for c, own in zip(checks, loops)}
        write_json({"axes": axes, "findings": [asdict(f) for f in findings]}, out / "check.json", "check")
        print(f"\nwritten to {out}: check.json, {', '.join(f'loops_{c.axis.name}.png' for c in checks)}")


def _show(args: Args) -> None:
    from twin.machine.sheet import sheet, sinumerik_sheet

    machine = machine_of(args)
    if args.control_file:
        from twin.remedy.files.existing import existing, lines_of

        for file in args.control_file:
            for found in existing(file, machine, args.comp_file_type):
                print("\n".join(lines_of(found)))
        return
    print(sinumerik_sheet(machine) if args.sinumerik else sheet(machine))


CONTROL_FILES = (
    arg("--control-file", "[AXIS=]FILE", "print what a file of the control compensates already, as tables of a machine file: archive, EEC, CEC, ini, .comp, "
        ".lis, parameter list (repeatable)", action="append", default=[]),
    ("--comp-file-type", {"type": int, "choices": (0, 1), "default": 0, "help": "COMP_FILE_TYPE of LinuxCNC compensation files (default 0)"}),
)  # fmt: skip
ACTIONS = {
    "new": (
        "create a commented machine file from an MJCF, a URDF or a recording",
        (
            arg("model", "MODEL", "MJCF (.xml) or URDF (.urdf) with slides, hinges and masses", nargs="?"),
            arg("--from-recording", "CAMPAIGN", "imported campaign instead of MODEL; drive and load become lumped parameters"),
            arg("--out", "MACHINE.toml", "machine file to write; its MJCF is written beside it", required=True),
            arg("--structure", "S", f"control structure of all axes: {', '.join(STRUCTURES)} (default: {next(iter(STRUCTURES))})"),
            arg("--sinumerik", "FILE", "TOML or archive with SINUMERIK machine data to use"),
        ),
        _new,
    ),
    "check": (
        "list missing, impossible and unusual values, and the margins of each loop",
        (GIVEN_MACHINE, arg("--out", "DIR", "folder for check.json and a plot of the loops of each axis")),
        _check,
    ),
    "show": (
        "print the data sheet",
        (GIVEN_MACHINE, flag("--sinumerik", "print it as machine data of a SINUMERIK 840D with 611D drives"), *CONTROL_FILES),
        _show,
    ),
}
