"""Arguments that several commands share."""

from __future__ import annotations

import argparse
import contextlib
import os
from pathlib import Path
import sys
from typing import TYPE_CHECKING

from twin.errors import InputError
from twin.files import shipped_example
from twin.progress import Progress

if TYPE_CHECKING:
    from twin.machine import Machine
    from twin.program import Program
    from twin.recordings import Trace

PICTURE_ENDINGS = (".png", ".svg", ".pdf")


def positive(text: str) -> float:
    """A number above 0, for argparse."""
    with contextlib.suppress(ValueError):
        if 0.0 < (value := float(text)) < 1e6:
            return value
    raise argparse.ArgumentTypeError(f"'{text}': give a number above 0 and below 1e6")


def seed(text: str) -> int:
    """A seed, for argparse."""
    with contextlib.suppress(ValueError):
        if (value := int(text)) >= 0:
            return value
    raise argparse.ArgumentTypeError(f"'{text}': give a whole number, 0 or more")


def add_machine(parser: argparse.ArgumentParser, default: str = "the Mikron UCP 710 that ships with twin") -> None:
    """`--machine FILE`; without it the environment variable TWIN_MACHINE applies."""
    parser.add_argument("--machine", metavar="FILE", help=f"machine file (default: $TWIN_MACHINE, else {default})")


def add_effect(parser: argparse.ArgumentParser) -> None:
    """`--effect NAME:AXIS:PARAMETER=VALUE`, repeatable."""
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME:AXIS:PARAMETER=VALUE",
        help="add an effect, e.g. backlash:X:clearance=15e-6 (SI; repeatable; see 'twin effects')",
    )


def add_margins(parser: argparse.ArgumentParser) -> None:
    """`--phase-margin-deg`, `--gain-margin-db`."""
    parser.add_argument(
        "--phase-margin-deg", type=positive, metavar="P", help="smallest phase margin of speed and position loop (default 40 and 50)"
    )
    parser.add_argument("--gain-margin-db", type=positive, default=6.0, metavar="G", help="smallest gain margin of both (default 6)")


def add_campaign(parser: argparse.ArgumentParser) -> None:
    """`CAMPAIGN`, a folder of measured runs."""
    parser.add_argument("campaign", metavar="CAMPAIGN", type=shipped_example, help="folder with campaign.toml and traces")


def add_open(parser: argparse.ArgumentParser, does: str = "open the report in the browser") -> None:
    """`--open`: show the report in the browser."""
    parser.add_argument("--open", action="store_true", help=does)


def open_report(args: argparse.Namespace, page: Path) -> None:
    """Open a report if `--open` was given."""
    if getattr(args, "open", False):
        import webbrowser

        webbrowser.open(page.resolve().as_uri())


def machine_of(args: argparse.Namespace) -> Machine:
    """The machine of `--machine`, with the effects of its file and of `--effect`."""
    from twin.machine import load_machine

    machine = load_machine(args.machine or os.environ.get("TWIN_MACHINE"))
    added = getattr(args, "effect", None)
    if not added:
        return machine
    from twin.effects import parse_setting, settings_of, with_effects

    return with_effects(machine, [*settings_of(machine), *(parse_setting(text, machine) for text in added)])


def add_place(parser: argparse.ArgumentParser) -> None:
    """`--place`: position of the part of a program."""
    parser.add_argument("--place", choices=("as-is", "auto"), default="as-is", help="auto: shift a part outside the travel into it")


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
    from twin.program.place import OutsideTravel, placed

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
