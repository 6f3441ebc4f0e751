"""Tables of arguments: what a command lists in `ARGUMENTS`, and the arguments that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
import contextlib
import os
from pathlib import Path
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from twin.errors import InputError
from twin.files import shipped_example
from twin.progress import Progress
from twin.system import shell_word

if TYPE_CHECKING:
    from twin.machine import Machine
    from twin.program import Program
    from twin.recordings import Trace
    from twin.recordings.campaign import MeasuredRun

PICTURE_ENDINGS = (".png", ".svg", ".pdf")
Args = argparse.Namespace
"""What a command was given, by the names of its arguments."""
Argument = tuple[str, dict[str, Any]]
"""An argument of a command: its name, and the options of `argparse.ArgumentParser.add_argument`."""


def arg(name: str, metavar: str, does: str, **options: Any) -> Argument:
    """An argument with a value. It takes part in a command's table `ARGUMENTS`."""
    return name, {"metavar": metavar, "help": does, **options}


def flag(name: str, does: str) -> Argument:
    """An option without a value."""
    return name, {"action": "store_true", "help": does}


def add_arguments(parser: argparse.ArgumentParser, module: ModuleType) -> None:
    """Add the arguments of a command, or of its actions."""
    for name, options in getattr(module, "ARGUMENTS", ()):
        parser.add_argument(name, **options)
    if found := getattr(module, "ACTIONS", None):
        actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True, parser_class=type(parser))
        for action, (does, arguments, carry_out) in found.items():
            sub = actions.add_parser(action, help=does)
            sub.set_defaults(action=carry_out)
            for name, options in arguments:
                sub.add_argument(name, **options)


def number(words: str, fits: Callable[[Any], bool], kind: type = float) -> Callable[[str], Any]:
    """Type of an argument: a number that `fits`. `words` say which."""

    def read(text: str) -> Any:
        with contextlib.suppress(ValueError, OverflowError):
            if fits(value := kind(text)):
                return value
        raise argparse.ArgumentTypeError(f"'{text[:40]}': give {words}")

    return read


positive = number("a number above 0 and below 1e6", lambda v: 0.0 < v < 1e6)
seed = number("a whole number, 0 or more", lambda v: v >= 0, int)
count = number("a whole number, 1 or more", lambda v: v >= 1, int)
port = number("a number from 0 to 65535", lambda v: 0 <= v <= 65535, int)


def machine_argument(default: str) -> Argument:
    """`--machine FILE`; without it the environment variable TWIN_MACHINE applies."""
    return arg("--machine", "FILE", f"machine file (default: $TWIN_MACHINE, else {default})")


MACHINE = machine_argument("the Mikron UCP 710 that ships with twin")
GIVEN_MACHINE = arg("machine", "MACHINE", "machine file (default: the Mikron UCP 710 that ships with twin)", nargs="?")
EFFECT = arg("--effect", "NAME:AXIS:PARAMETER=VALUE", "add an effect, e.g. backlash:X:clearance=15e-6 (SI; repeatable; see 'twin effects')", action="append", default=[])  # fmt: skip
MARGINS = (
    arg("--phase-margin-deg", "P", "smallest phase margin of speed and position loop (default 40 and 50)", type=positive),
    arg("--gain-margin-db", "G", "smallest gain margin of both (default 6)", type=positive, default=6.0),
)
CAMPAIGN = arg("campaign", "CAMPAIGN", "folder with campaign.toml and traces", type=shipped_example)
JSON = arg("--json", "FILE", "write the result as JSON")
OPEN = flag("--open", "open the report in the browser")
PLACE: Argument = ("--place", {"choices": ("as-is", "auto"), "default": "as-is", "help": "auto: shift a part outside the travel into it"})
THREADS = arg("--threads", "N", "number of threads (default: one per core)", type=count)


def out_argument(does: str, **options: Any) -> Argument:
    """`--out DIR`, required unless the options say otherwise."""
    return arg("--out", "DIR", does, **(options or {"required": True}))


def open_report(args: Args, page: Path) -> None:
    """Open a report if `--open` was given."""
    if getattr(args, "open", False):
        import webbrowser

        webbrowser.open(page.resolve().as_uri())


def finish(args: Args, out: Path, files: str, page: str = "report.html") -> None:
    """Print what was written to the folder, and open the page if `--open` was given."""
    print(f"written to {out}: {files}")
    open_report(args, out / page)


def machine_of(args: Args) -> Machine:
    """The machine of `--machine`, with the effects of its file and of `--effect`."""
    from twin.machine import load_machine

    machine = load_machine(args.machine or os.environ.get("TWIN_MACHINE"))
    added = getattr(args, "effect", None)
    if not added:
        return machine
    from twin.effects import parse_setting, settings_of, with_effects

    return with_effects(machine, [*settings_of(machine), *(parse_setting(text, machine) for text in added)])


def trace_file(path: Path) -> Path:
    """The trace in the folder of a run, or the file itself."""
    from twin.recordings.trace import TRACE_ENDINGS, trace_in

    if not path.is_dir():
        if path.suffix.lower() not in TRACE_ENDINGS:
            from twin.program.read import is_program  # not for a trace: its import takes a second

            if is_program(path):
                raise InputError(
                    f"{path}: a part program, not a trace; simulate it first: twin run {shell_word(path)} --out DIR, and give DIR"
                )
        return path
    if (found := trace_in(path)) is None:
        raise InputError(
            f"{path}: no trace.parquet in this folder; give the --out folder of 'twin run', a trace, a campaign or a machine file"
        )
    return found


def runs_of(source: Path, machine: Machine) -> Sequence[MeasuredRun]:
    """The runs of a campaign; of a run folder or a trace its only one."""
    from twin.recordings.campaign import MeasuredRun, read_campaign, read_trace

    if (source / "campaign.toml").is_file():
        return read_campaign(source, machine).runs
    return (MeasuredRun(source.stem, read_trace(trace_file(source), axes=machine.kinds, need=("setpoint",)), None, 0.0),)


def setpoints_of_input(source: Path, machine: Machine, place: str = "as-is") -> tuple[Program | None, Trace]:
    """Set points of a program (with the program) or of a trace (without); `place` 'auto' shifts a part into the travel."""
    from twin.program.read import is_program
    from twin.recordings import read_trace

    source = shipped_example(source)
    if not is_program(source):
        return None, read_trace(source, axes=machine.kinds, need=("setpoint",))
    from twin.program import interpolate

    program = program_of_input(source, machine, place)
    with Progress("interpolating") as bar:
        return program, interpolate(program, machine, progress=bar)


def program_of_input(source: Path, machine: Machine, place: str) -> Program:
    """Read a program; print a note for each word without effect."""
    from twin.program import read_program
    from twin.program.part_placement import OutsideTravel, placed

    try:
        program = read_program(source, machine)
    except OutsideTravel as error:
        if place != "auto":
            raise InputError(f"{error}, or add --place auto") from None
        program = placed(error.program)
    for note in program.notes:
        print(f"note: {source.name}: {note}", file=sys.stderr)
    return program


def picture_file(text: str) -> Path:
    """The path of a picture; InputError for an unknown ending."""
    path = Path(text)
    if path.suffix.lower() not in PICTURE_ENDINGS:
        raise InputError(f"{path}: a picture ends in {', '.join(PICTURE_ENDINGS)}")
    return path
