"""Read the command line and run the command. Each command has a module in this package; `COMMANDS` lists them.

A command's module has the table `ARGUMENTS` (or `ACTIONS`: name -> help, table, function) and `carry_out(args) -> int | None`. It is imported only when
the command is used.
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
from twin.cli.arguments import number
from twin.errors import TwinError, nearest, one_line
from twin.files import hold_folders, release_folders
from twin.limits import raised
from twin.progress import Plain, hushed
from twin.stopping import say

DESCRIPTION = """Digital twin of a machine tool's feed drives on MuJoCo.

    program -> interpolator -> set points -> cascade + plant -> trace -> tool path -> cut surface

It predicts where the axes and the tool really go, and finds why a measured machine differs.
Start with:  twin run examples/x_200mm.csv --out out/first
"""


class Command(NamedTuple):
    """A command: name, module in this package, and a one-line description."""

    name: str
    module: str
    does: str


COMMANDS: dict[str, tuple[Command, ...]] = {
    "simulate": (
        Command("demo", "demo", "simulate the paper's test: X 200 mm out and back at 15 m/min, feedforward off and on"),
        Command("run", "run", "simulate a part program (.mpf .ngc .apt) or the set points of a trace (.parquet .csv)"),
        Command("interpolate", "interpolate", "convert a part program to set points without simulating it"),
        Command("check", "check", "check part programs for unknown words, travel and axis limits; compute the machining time"),
        Command("cut", "cut", "cut a part along the followed tool path; report position and depth of marks"),
    ),
    "look": (
        Command("replay", "replay", "show a run, recording, trace, MJCF or URDF in the viewer"),
        Command("desk", "desk", "list all results in a folder on a local web page; open and compare them"),
        Command("compare", "compare", "compare two runs, campaigns or machines, aligned on their set points"),
        Command("effects", "effects", "list the effects that a machine can have beyond the nominal model"),
        Command("machine", "machine", "create a machine file from a model, check it, or print its data sheet"),
    ),
    "measure": (
        Command("import", "import_recordings", "convert recordings (CSV, SINUMERIK XML, TDMS, MDF4, .mat) to a campaign"),
        Command("plan", "plan", "plan a measuring campaign that identifies each parameter to a given precision"),
        Command("identify", "identify", "identify a machine's parameters, with confidence intervals, from its traces"),
        Command("iso", "iso", "evaluate positioning by ISO 230-2 or circles by ISO 230-4, with the standard plot"),
    ),
    "diagnose": (
        Command("gap", "gap", "simulate every run of a measured campaign and compare it signal by signal"),
        Command(
            "diagnose",
            "diagnose",
            "find where a measured campaign differs from the twin, which effects cause it, and how far they close the gap",
        ),
        Command("remedy", "remedy", "say what to set and to do about a diagnosis, what it brings, and write the control's own files"),
        Command("tune", "tune", "tune gains, feedforward and delays of a healthy machine within margins, beside the symmetrical optimum"),
        Command("watch", "watch", "judge dated campaigns of one machine: what changed, since when, by what cause; raise an alarm"),
        Command("exam", "exam", "diagnose sealed campaigns of a second plant, then open the seals and score the answers"),
    ),
    "design": (Command("study", "study", "vary numbers of the machine file, simulate every variant, show the influence of each number"),),
    "guard": (
        Command("regress", "regress", "run a suite of cases and compare it with golden results; report what changed, and where first"),
    ),
    "shell": (Command("completion", "completion", "print a completion script for bash, zsh or tcsh"),),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line. Exit code: 0 done, 1 failed verdict, 2 bad input or usage (one line on standard error)."""
    # names in files of others may steer a terminal
    with contextlib.redirect_stdout(Plain(sys.stdout)), contextlib.redirect_stderr(Plain(sys.stderr)):
        return _main(list(sys.argv[1:] if arguments is None else arguments))


def _main(arguments: list[str]) -> int:
    if (unread := next((a for a in arguments if not _is_text(a)), None)) is not None:
        print(f"twin: {_NO_TEXT.format(one_line(ascii(unread)))}", file=sys.stderr)
        return 2
    if (empty := _empty_in(arguments)) is not None:
        print(
            f"twin: {one_line(empty)}: this argument is empty; give a value or leave it out (is a shell variable unset?)",
            file=sys.stderr,
        )
        return 2
    hold_folders()
    try:
        args = build_parser(_command_in(arguments)).parse_args(arguments)
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
    except OSError as error:  # no permission, disk full
        what = f"{error.filename or 'a file'}: {error.strerror or error}; choose another place or free space there"
        print(f"twin: {one_line(what)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stop:
        say(getattr(stop, "number", signal.SIGINT))
        return int(getattr(stop, "code", 130))
    finally:
        release_folders()


_NO_TEXT = "{}: this name is not valid UTF-8; rename the file or its folder"


def _is_text(name: str) -> bool:
    """Whether a name is valid text. Python keeps invalid bytes as lone surrogates, which the libraries refuse."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _empty_in(arguments: Sequence[str]) -> str | None:
    """The first empty argument with the word before it; None without one. No command accepts one: it would silently become a default."""
    for before, argument in zip(("twin", *arguments), arguments, strict=False):
        if not argument:
            return f"{before} ''"
        if argument.startswith("--") and argument.endswith("=") and argument.count("=") == 1:
            return argument
    return None


def _effects_of(args: argparse.Namespace) -> contextlib.AbstractContextManager[None]:
    """Context in which the library also has the effects of the `--effects` files."""
    if not getattr(args, "effects", None):
        return contextlib.nullcontext()
    from twin.effects.user_files import effects_of

    return effects_of(args.effects)


def _carried_out(args: argparse.Namespace) -> int:
    """Run the command and return its exit code. --quiet prints nothing; --verbose adds versions and run time on standard error."""
    began = time.perf_counter()
    with contextlib.ExitStack() as stack:
        if args.limits is not None:
            stack.enter_context(raised(args.limits))
        if args.quiet:
            stack.enter_context(hushed())
            stack.enter_context(contextlib.redirect_stdout(stack.enter_context(open(os.devnull, "w"))))
        code = int(_module(args.command).carry_out(args) or 0)
    if args.verbose:
        parts = [f"{name} {importlib.metadata.version(name)}" for name in ("mujoco", "numpy", "numba")]
        print(f"twin {twin.__version__}, {', '.join(parts)}: {time.perf_counter() - began:.1f} s", file=sys.stderr)
    return code


class _Parser(argparse.ArgumentParser):
    """Reports usage errors in one line, with exit code 2."""

    def error(self, message: str) -> Any:
        self.exit(2, f"twin: {one_line(message)}; try '{self.prog} --help'\n")


def build_parser(only: str | None = None) -> argparse.ArgumentParser:
    """The parser, with the arguments of one command (`only`) or of all."""
    parser = _Parser(prog="twin", description=DESCRIPTION + _overview(), formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--version", action="version", version=f"twin {twin.__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", dest="command", required=True, parser_class=_Parser, help=argparse.SUPPRESS)
    for command in _commands().values():
        sub = commands.add_parser(command.name, help=command.does, description=command.does[0].upper() + command.does[1:] + ".")
        if only is None or only == command.name:
            _add(sub, _module(command.name))
            sub.set_defaults(limits=None, quiet=False, verbose=False)
            _add_common(sub)
    return parser


def show_and_run(*arguments: object) -> None:
    """Print a command and run it, for the example scripts; a failing command ends the script."""
    words = [str(a) for a in arguments]
    print(f"\n$ twin {' '.join(words)}", flush=True)
    if code := main(words):
        raise SystemExit(code)


def _add(parser: argparse.ArgumentParser, module: ModuleType) -> None:
    """Add the arguments of a command, or of its actions."""
    for name, options in getattr(module, "ARGUMENTS", ()):
        parser.add_argument(name, **options)
    if found := getattr(module, "ACTIONS", None):
        actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True, parser_class=_Parser)
        for action, (does, arguments, carry_out) in found.items():
            sub = actions.add_parser(action, help=does)
            sub.set_defaults(action=carry_out)
            for name, options in arguments:
                sub.add_argument(name, **options)


def _add_common(parser: argparse.ArgumentParser) -> None:
    """Add the options of every command to a command and its actions; `--effects FILE` if it takes a machine."""
    for action in list(parser._actions):
        if isinstance(action, argparse._SubParsersAction):
            for sub in action.choices.values():
                _add_common(sub)
    has_machine = any(action.dest == "machine" for action in parser._actions)
    # the defaults of an action must not undo what stands before it: twin machine --quiet check
    common = parser.add_argument_group("options of every command", argument_default=argparse.SUPPRESS)
    if has_machine:
        common.add_argument(
            "--effects", action="append", default=None, metavar="FILE.py", help="Python file with your own effects (repeatable)"
        )
    factor = number("a factor from 1 to 1e6", lambda v: 1.0 <= v <= 1e6)
    common.add_argument("--limits", type=factor, metavar="FACTOR", help="multiply all size limits by this factor (default: 1)")
    common.add_argument("--quiet", action="store_true", help="print errors only")
    common.add_argument("--verbose", action="store_true", help="also print versions and run time")


def _commands() -> dict[str, Command]:
    return {command.name: command for group in COMMANDS.values() for command in group}


def _module(command: str) -> ModuleType:
    return importlib.import_module(f"{__package__}.{_commands()[command].module}")


def _command_in(arguments: Sequence[str]) -> str | None:
    """The given command, or '' without one. An unknown command exits with a line that names the nearest."""
    word = next((a for a in arguments if not a.startswith("-")), None)
    if word is not None and word not in _commands() and arguments and arguments[0] == word:
        sys.stderr.write(f"twin: no command '{one_line(word)}'; {nearest(word, _commands())}; try 'twin --help'\n")
        raise SystemExit(2)
    return word if word in _commands() else ""


def _overview() -> str:
    """The commands, grouped by task."""
    lines = []
    for group, commands in COMMANDS.items():
        lines.append(f"\n{group}")
        lines += [f"  {command.name:<13}{command.does}" for command in commands]
    return "\n".join(lines)
