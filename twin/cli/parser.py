"""Read the command line and run the command. Each command has a module in this package; `COMMANDS` lists them.

A command's module has the table `ARGUMENTS` (or `ACTIONS`: name -> help, table, function) and `carry_out(args) -> int | None`. It is imported only when
the command is used.
"""

import argparse
from collections.abc import Sequence
import contextlib
import importlib
import importlib.metadata
import os
import re
import signal
import sys
import time
from types import ModuleType
from typing import Any

import twin
from twin.cli.arguments import add_arguments, number
from twin.errors import TwinError, nearest, one_line
from twin.files import hold_folders, release_folders
from twin.limits import raised
from twin.progress import Plain, hushed
from twin.stopping import say
from twin.system import command_line

DESCRIPTION = """Digital twin of a machine tool's feed drives on MuJoCo.

    program -> interpolator -> set points -> cascade + plant -> trace -> tool path -> cut surface

It predicts where the axes and the tool really go, and finds why a measured machine differs.
Start with:  twin run examples/x_200mm.csv --out out/first
"""


COMMANDS: dict[str, dict[str, str]] = {
    "simulate": {
        "demo": "simulate the paper's test: X 200 mm out and back at 15 m/min, feedforward off and on",
        "run": "simulate a part program (.mpf .ngc .apt) or the set points of a trace (.parquet .csv)",
        "interpolate": "convert a part program to set points without simulating it",
        "check": "check part programs for unknown words, travel and axis limits; compute the machining time",
        "cut": "cut a part along the followed tool path; report position and depth of marks",
    },
    "look": {
        "replay": "show a run, recording, trace, MJCF or URDF in the viewer",
        "desk": "list all results in a folder on a local web page; open and compare them",
        "compare": "compare two runs, campaigns or machines, aligned on their set points",
        "effects": "list the effects that a machine can have beyond the nominal model",
        "machine": "create a machine file from a model, check it, or print its data sheet",
    },
    "measure": {
        "import": "convert recordings of any control or drive (text, Excel, SINUMERIK, MATLAB, TDMS, MDF4, ...) to a campaign",
        "plan": "plan a measuring campaign that identifies each parameter to a given precision",
        "identify": "identify a machine's parameters, with confidence intervals, from its traces",
        "iso": "evaluate positioning by ISO 230-2 or circles by ISO 230-4, with the standard plot",
    },
    "diagnose": {
        "gap": "simulate every run of a measured campaign and compare it signal by signal",
        "diagnose": "find where a measured campaign differs from the twin, which effects cause it, and how far they close the gap",
        "remedy": "say what to set and to do about a diagnosis, what it brings, and write the control's own files",
        "tune": "tune gains, feedforward and delays of a healthy machine within margins, beside the symmetrical optimum",
        "watch": "judge dated campaigns of one machine: what changed, since when, by what cause; raise an alarm",
        "exam": "diagnose sealed campaigns of a second plant, then open the seals and score the answers",
    },
    "design": {"study": "vary numbers of the machine file, simulate every variant, show the influence of each number"},
    "guard": {"regress": "run a suite of cases and compare it with golden results; report what changed, and where first"},
    "shell": {
        "completion": "print a completion script for bash, zsh or tcsh",
        "schema": "write JSON Schemas of campaign, map, study, suite, part, catalogue and machine file: an editor completes and checks with them",
    },
}
"""What each command does, grouped by task."""
_DOES = {name: does for group in COMMANDS.values() for name, does in group.items()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line. Exit code: 0 done, 1 failed verdict, 2 bad input or usage (one line on standard error)."""
    # names in files of others may steer a terminal
    with contextlib.redirect_stdout(Plain(sys.stdout)), contextlib.redirect_stderr(Plain(sys.stderr)):
        return _main(command_line() if arguments is None else list(arguments))


def _main(arguments: list[str]) -> int:
    if (unread := next((a for a in arguments if _NO_UTF8.search(a)), None)) is not None:
        return _refused(_NO_TEXT.format(one_line(ascii(unread))))
    if (empty := _empty_in(arguments)) is not None:
        return _refused(f"{one_line(empty)}: this argument is empty; give a value or leave it out (is a shell variable unset?)")
    hold_folders()
    try:
        return _carried_out(build_parser(_command_in(arguments)).parse_args(arguments))
    except TwinError as error:
        return _refused(one_line(error))
    except UnicodeEncodeError as error:
        if error.reason != "surrogates not allowed":
            raise
        return _refused(_NO_TEXT.format(one_line(ascii(error.object))))
    except BrokenPipeError:
        return 0
    except OSError as error:  # no permission, disk full
        return _refused(one_line(f"{error.filename or 'a file'}: {error.strerror or error}; choose another place or free space there"))
    except KeyboardInterrupt as stop:
        say(getattr(stop, "number", signal.SIGINT))
        return int(getattr(stop, "code", 130))
    finally:
        release_folders()


def _refused(line: str) -> int:
    """Print why the command cannot be carried out, in one line; returns the exit code."""
    print(f"twin: {line}", file=sys.stderr)
    return 2


_NO_TEXT = "{}: this name is not valid UTF-8; rename the file or its folder"
_NO_UTF8 = re.compile("[\ud800-\udfff]")
"""Python keeps invalid bytes as lone surrogates, which the libraries refuse."""


def _empty_in(arguments: Sequence[str]) -> str | None:
    """The first empty argument with the word before it, or None. Empty arguments are refused: they would silently become defaults."""
    for before, argument in zip(("twin", *arguments), arguments, strict=False):
        if not argument:
            return f"{before} ''"
        if argument.startswith("--") and argument.endswith("=") and argument.count("=") == 1:
            return argument
    return None


def _carried_out(args: argparse.Namespace) -> int:
    """Run the command and return its exit code. --quiet prints nothing; --verbose adds versions and run time on standard error."""
    began = time.perf_counter()
    with contextlib.ExitStack() as stack:
        if getattr(args, "effects", None):
            from twin.effects.user_files import effects_of

            stack.enter_context(effects_of(args.effects))
        if args.limits is not None:
            stack.enter_context(raised(args.limits))
        if args.quiet:
            stack.enter_context(hushed())
            stack.enter_context(contextlib.redirect_stdout(stack.enter_context(open(os.devnull, "w", encoding="utf-8"))))
        code = int(_module(args.command).carry_out(args) or 0)
    if args.verbose:
        parts = [f"{name} {importlib.metadata.version(name)}" for name in ("mujoco", "numpy", "numba")]
        print(f"twin {twin.__version__}, {', '.join(parts)}: {time.perf_counter() - began:.1f} s", file=sys.stderr)
    return code


class _Parser(argparse.ArgumentParser):
    """Reports usage errors in one line, with exit code 2."""

    def error(self, message: str) -> Any:
        self.exit(2, f"twin: {one_line(message)}; try '{self.prog} --help'\n")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Words that a command does not know are refused here, where its options are known."""
        known, unknown = super().parse_known_args(args, namespace)
        if unknown:
            near = nearest(unknown[0].partition("=")[0], self._option_string_actions)
            self.error(f"unrecognized arguments: {' '.join(unknown)}{f'; {near}' if near.startswith('did') else ''}")
        return known, unknown


def build_parser(only: str | None = None) -> argparse.ArgumentParser:
    """The parser, with the arguments of one command (`only`) or of all."""
    overview = "".join(f"\n{group}\n" + "".join(f"  {name:<13}{does}\n" for name, does in of.items()) for group, of in COMMANDS.items())
    parser = _Parser(prog="twin", description=DESCRIPTION + overview, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--version", action="version", version=f"twin {twin.__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", dest="command", required=True, parser_class=_Parser, help=argparse.SUPPRESS)
    for name, does in _DOES.items():
        sub = commands.add_parser(name, help=does, description=does[0].upper() + does[1:] + ".")
        if only is None or only == name:
            add_arguments(sub, _module(name))
            sub.set_defaults(limits=None, quiet=False, verbose=False)
            _add_common(sub)
    return parser


def show_and_run(*arguments: object) -> None:
    """Print a command and run it, for the example scripts; a failing command ends the script."""
    words = [str(a) for a in arguments]
    print(f"\n$ twin {' '.join(words)}", flush=True)
    if code := main(words):
        raise SystemExit(code)


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


def _module(command: str) -> ModuleType:
    """The module of a command, of its name; `import` is a word of Python."""
    return importlib.import_module(f"{__package__}.{'import_recordings' if command == 'import' else command}")


def _command_in(arguments: Sequence[str]) -> str | None:
    """The given command; '' if none is given. An unknown command exits with a line that names the nearest."""
    word = next((a for a in arguments if not a.startswith("-")), None)
    if word is not None and word not in _DOES and arguments and arguments[0] == word:
        raise SystemExit(_refused(f"no command '{one_line(word)}'; {nearest(word, _DOES)}; try 'twin --help'"))
    return word if word in _DOES else ""
