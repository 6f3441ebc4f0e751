"""Reads the command line and carries the command out. One module of this package a command; `COMMANDS` lists them.

A module of a command has `add_arguments(parser)` and `carry_out(args) -> int | None`, and is imported only when its command is given.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import contextlib
import importlib
import importlib.metadata
import os
import signal
import sys
import time
from types import ModuleType
from typing import Any, NamedTuple

import twin
from twin.errors import TwinError, nearest, one_line
from twin.files import hold_folders, release_folders
from twin.limits import RAISED_BY
from twin.stopping import say

DESCRIPTION = """Digital twin of a machine tool's feed drives on MuJoCo.

    program -> interpolator -> set points -> cascade + plant -> trace -> tool path -> cut surface

It predicts where the axes and the tool really go, and says why a measured machine differs.
Start with:  twin run examples/x_200mm.csv --out out/first
"""


class Command(NamedTuple):
    """One command: its name, the module of this package that carries it out, and what it does in a line."""

    name: str
    module: str
    does: str


COMMANDS: dict[str, tuple[Command, ...]] = {
    "simulate": (
        Command("demo", "demo", "the paper's test: X 200 mm out and back at 15 m/min, feedforward off and on"),
        Command("run", "run", "simulate a program (.mpf .ngc .apt) or the set points of a trace (.parquet .csv)"),
        Command("interpolate", "interpolate", "convert a program to set points without simulating it"),
        Command("check", "check", "check part programs: unknown words, travel, axis limits, time"),
        Command("cut", "cut", "cut a part along the followed tool path; report the place and depth of marks"),
    ),
    "look": (
        Command("replay", "replay", "open the viewer on a run, a recording, a trace or any MJCF or URDF"),
        Command("desk", "desk", "list what lies in a folder on a local page: reports, viewer, comparisons"),
        Command("compare", "compare", "compare two runs, campaigns or machines, aligned on their set points"),
        Command("effects", "effects", "list the effects that a machine can have beyond the nominal model"),
        Command("machine", "machine", "make a machine file from a model, check it, show its data sheet"),
    ),
    "measure": (
        Command("import", "import_recordings", "turn recorded files (CSV, Sinumerik XML, TDMS, MDF4, .mat) into a campaign"),
        Command("plan", "plan", "propose a measuring campaign that identifies each parameter to a wanted precision"),
        Command("identify", "identify", "identify a machine's parameters, with intervals, from its own traces"),
    ),
    "judge": (
        Command(
            "iso",
            "iso",
            "evaluate positioning by ISO 230-2 or circles by ISO 230-4 from a table, trace, run or campaign, with the usual plot",
        ),
    ),
    "diagnose": (
        Command("gap", "gap", "simulate every run of a measured campaign and compare signal by signal"),
        Command(
            "diagnose",
            "diagnose",
            "find where a measured campaign differs from the twin, which effect causes it, and how far it closes the gap",
        ),
        Command("exam", "exam", "diagnose campaigns of a second plant whose faults are sealed, then open the seals and score"),
    ),
    "design": (
        Command(
            "study", "study", "vary numbers of the machine file by a design, simulate every variant, show the influence of each number"
        ),
    ),
    "guard": (Command("regress", "regress", "run a suite of cases and compare with golden results; report what changed, and where first"),),
    "shell": (Command("completion", "completion", "print the completion of commands and options for bash, zsh or tcsh"),),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code: 0 done, 1 a verdict that fails, 2 bad input or usage (one line on standard error)."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if (unread := next((a for a in arguments if not _is_text(a)), None)) is not None:
        print(f"twin: {_NO_TEXT.format(one_line(ascii(unread)))}", file=sys.stderr)
        return 2
    if (empty := _empty_in(arguments)) is not None:
        print(
            f"twin: {one_line(empty)}: nothing is given; give a value or leave it out (a variable of the shell that is not set?)",
            file=sys.stderr,
        )
        return 2
    args = build_parser(_command_in(arguments)).parse_args(arguments)
    hold_folders()
    try:
        with _effects_of(args):
            return _carried_out(args)
    except TwinError as error:
        print(f"twin: {one_line(error)}", file=sys.stderr)
        return 2
    except UnicodeEncodeError as error:
        if error.reason != "surrogates not allowed":
            raise
        print(f"twin: {_NO_TEXT.format(one_line(ascii(error.object)))}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        return 0
    except OSError as error:  # a place that cannot be written, a disk that is full
        print(f"twin: {error.filename or 'a file'}: {error.strerror or error}; give another place or free this one", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stop:
        say(getattr(stop, "number", signal.SIGINT))
        return int(getattr(stop, "code", 130))
    finally:
        release_folders()


_NO_TEXT = "{}: a name with bytes that are no text in UTF-8; rename the file or its folder"


def _is_text(name: str) -> bool:
    """Is this a text? Bytes of a name that are none stand in it as lone surrogates, which no library behind this one takes."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _empty_in(arguments: Sequence[str]) -> str | None:
    """What stands before the first argument that is empty, if any is: no command takes one, and read as "not given" it would go on with a default."""
    for before, argument in zip(("twin", *arguments), arguments, strict=False):
        if not argument:
            return f"{before} ''"
        if argument.startswith("--") and argument.endswith("=") and argument.count("=") == 1:
            return argument
    return None


def _effects_of(args: argparse.Namespace) -> contextlib.AbstractContextManager[None]:
    """The library with the effects of the files of `--effects`, while the command is carried out."""
    if not getattr(args, "effects", None):
        return contextlib.nullcontext()
    from twin.effects.user_files import effects_of

    return effects_of(args.effects)


def _carried_out(args: argparse.Namespace) -> int:
    """The command's exit code; silent with --quiet, with versions and time on standard error with --verbose."""
    began = time.perf_counter()
    if args.limits is not None:
        os.environ[RAISED_BY] = repr(args.limits)
    if args.quiet:
        os.environ["TQDM_DISABLE"] = "1"
    with open(os.devnull, "w") if args.quiet else contextlib.nullcontext(sys.stdout) as out, contextlib.redirect_stdout(out):
        code = int(_module(args.command).carry_out(args) or 0)
    if args.verbose:
        parts = [f"{name} {importlib.metadata.version(name)}" for name in ("mujoco", "numpy", "numba")]
        print(f"twin {twin.__version__}, {', '.join(parts)}: {time.perf_counter() - began:.1f} s", file=sys.stderr)
    return code


class _Parser(argparse.ArgumentParser):
    """Usage errors in one line, with exit code 2; commands by groups in the help."""

    def error(self, message: str) -> Any:
        self.exit(2, f"twin: {one_line(message)}; try '{self.prog} --help'\n")


def build_parser(only: str | None = None) -> argparse.ArgumentParser:
    """The parser of the command line: with the arguments of one command, or those of all."""
    parser = _Parser(prog="twin", description=DESCRIPTION + _overview(), formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--version", action="version", version=f"twin {twin.__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", dest="command", required=True, parser_class=_Parser, help=argparse.SUPPRESS)
    for command in _commands().values():
        sub = commands.add_parser(command.name, help=command.does, description=command.does[0].upper() + command.does[1:] + ".")
        if only is None or only == command.name:
            _module(command.name).add_arguments(sub)
            sub.set_defaults(limits=None, quiet=False, verbose=False)
            _add_common(sub)
    return parser


def show_and_run(*arguments: object) -> None:
    """A command of twin as an example carries it out: shown first; the example ends where the command fails."""
    words = [str(a) for a in arguments]
    print(f"\n$ twin {' '.join(words)}", flush=True)
    if code := main(words):
        raise SystemExit(code)


def _factor(text: str) -> float:
    """A factor on the limits, for argparse."""
    with contextlib.suppress(ValueError):
        if 1.0 <= (value := float(text)) <= 1e6:
            return value
    raise argparse.ArgumentTypeError(f"'{text[:40]}': give a factor from 1 to 1e6")


def _add_common(parser: argparse.ArgumentParser) -> None:
    """The options of every command, for a command and for its actions; `--effects FILE` where it takes a machine."""
    for action in list(parser._actions):
        if isinstance(action, argparse._SubParsersAction):
            for sub in action.choices.values():
                _add_common(sub)
    has_machine = any(action.dest == "machine" for action in parser._actions)
    # the defaults of an action must not undo what stands before it: twin machine --quiet check
    common = parser.add_argument_group("options of every command", argument_default=argparse.SUPPRESS)
    if has_machine:
        common.add_argument(
            "--effects",
            action="append",
            default=None,
            metavar="FILE.py",
            help="Python file with effects of your own, used like those of the library; may be given several times",
        )
    common.add_argument("--limits", type=_factor, metavar="FACTOR", help="raise all limits on sizes by this factor (default: 1)")
    common.add_argument("--quiet", action="store_true", help="print errors only; the results are in the files")
    common.add_argument("--verbose", action="store_true", help="also print versions and run time")


def _commands() -> dict[str, Command]:
    return {command.name: command for group in COMMANDS.values() for command in group}


def _module(command: str) -> ModuleType:
    return importlib.import_module(f"{__package__}.{_commands()[command].module}")


def _command_in(arguments: Sequence[str]) -> str | None:
    """The command that is given, if it is one: a word that is none gets one line with the nearest."""
    word = next((a for a in arguments if not a.startswith("-")), None)
    if word is not None and word not in _commands() and arguments and arguments[0] == word:
        sys.stderr.write(f"twin: no command '{one_line(word)}'; {nearest(word, _commands())}; try 'twin --help'\n")
        raise SystemExit(2)
    return word if word in _commands() else ""


def _overview() -> str:
    """The commands by what one wants to do."""
    lines = []
    for group, commands in COMMANDS.items():
        lines.append(f"\n{group}")
        lines += [f"  {command.name:<13}{command.does}" for command in commands]
    return "\n".join(lines)
