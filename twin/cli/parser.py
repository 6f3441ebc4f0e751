"""The command line: one function per command, thin; all work is done by the modules that it names."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
import contextlib
import importlib
import sys
from typing import Any

from twin.errors import TwinError

DESCRIPTION = """Digital twin of a machine tool's feed drives on MuJoCo.

    program -> interpolator -> set points -> cascade + plant -> trace -> tool path -> cut surface

It predicts where the axes and the tool really go, and says why a measured machine differs.
Start with:  twin run examples/x_200mm.csv --out out/first
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code: 0 done, 1 a verdict that fails, 2 bad input or usage (one line on standard error)."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    parser = build_parser()
    args = parser.parse_args(arguments)
    try:
        return int(_resolved(args.command)(args) or 0)
    except TwinError as error:
        print(f"twin: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        return 0
    except OSError as error:  # a place that cannot be written, a disk that is full
        print(f"twin: {error.filename or 'a file'}: {error.strerror or error}; give another place or free this one", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("twin: stopped by the user", file=sys.stderr)
        return 130


def _resolved(command: str | Callable[[argparse.Namespace], int | None]) -> Callable[[argparse.Namespace], int | None]:
    """A command by its name in `twin.cli.commands`, imported only when it is called: `twin --help` needs no engine."""
    return getattr(importlib.import_module("twin.cli.commands"), command) if isinstance(command, str) else command


class _Parser(argparse.ArgumentParser):
    """Usage errors in one line, with exit code 2."""

    def error(self, message: str) -> Any:
        self.exit(2, f"twin: {message}; try '{self.prog} --help'\n")


def build_parser() -> argparse.ArgumentParser:
    """All commands and their arguments; loads neither engine nor viewer."""
    from twin.cli.cut import add_cut_arguments, cut_command
    from twin.cli.exam import add_exam_arguments, exam_command
    from twin.cli.identify import add_identify_arguments, add_plan_arguments, identify_command, plan_command
    from twin.cli.import_recordings import add_import_arguments, import_command
    from twin.cli.machine import add_machine_arguments, machine_command
    from twin.cli.regress import add_regress_arguments, regress_command
    from twin.cli.replay import add_replay_arguments, replay_command
    from twin.cli.study import add_study_arguments, study_command

    parser = _Parser(prog="twin", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=_Parser)

    def add(name: str, command: str | Callable[[argparse.Namespace], int | None], text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        sub.set_defaults(command=command)
        return sub

    run = add("run", "run_command", "simulate a program (.mpf .ngc .apt) or the set points of a trace (.parquet .csv)")
    run.add_argument("input", metavar="INPUT", help="part program, or trace with <axis>.setpoint columns")
    _machine_arguments(run)
    run.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME:AXIS:PARAMETER=VALUE",
        help="add an effect, e.g. backlash:X:clearance=15e-6 (SI; may be given several times; see 'twin effects')",
    )
    run.add_argument(
        "--feedforward", metavar="F", help="off | velocity | velocity+torque (default: as the machine file or the program says)"
    )
    run.add_argument("--out", metavar="DIR", help="folder for trace.parquet, run.rrd and summary.json (default: out/<name of the input>)")
    run.add_argument(
        "--strict", action="store_true", help="set points above an axis' speed, acceleration or jerk are an error, not a warning"
    )
    run.add_argument(
        "--sample-period-ms", type=_positive, metavar="MS", help="period of the written trace (default: 1, as the machine file says)"
    )
    run.add_argument("--noise-seed", type=_seed, metavar="N", help="add the machine's measuring noise, drawn with this seed")
    run.add_argument("--no-recording", action="store_true", help="do not write run.rrd")

    interpolate = add("interpolate", "interpolate_command", "turn a program into set points, no more")
    interpolate.add_argument("program", metavar="PROGRAM", help="part program (.mpf .ngc .apt ...)")
    interpolate.add_argument("--out", required=True, metavar="FILE", help="trace with the set points (.parquet or .csv)")
    interpolate.add_argument("--plot", metavar="PNG", help="plot programmed and reached feed over path length")
    _machine_arguments(interpolate)

    gap = add("gap", "gap_command", "simulate every run of a measured campaign and compare signal by signal")
    gap.add_argument("campaign", metavar="CAMPAIGN", help="folder with campaign.toml and its traces")
    _machine_arguments(gap)
    gap.add_argument("--json", metavar="FILE", help="write the result as JSON")

    identify = add("identify", identify_command, "identify a machine's parameters, with intervals, from its own traces")
    add_identify_arguments(identify)

    plan = add("plan", plan_command, "propose a measuring campaign that identifies each parameter to a wanted precision")
    add_plan_arguments(plan)

    importing = add("import", import_command, "turn recorded files (CSV, Sinumerik XML, TDMS, MDF4, .mat) into a campaign by a map")
    add_import_arguments(importing)

    diagnose = add(
        "diagnose", "diagnose_command", "say where a measured campaign differs from the twin, which effect causes it, how far it shrinks"
    )
    diagnose.add_argument("campaign", metavar="CAMPAIGN", help="folder with campaign.toml and its traces")
    _machine_arguments(diagnose)
    diagnose.add_argument("--out", required=True, metavar="DIR", help="folder for diagnosis.json, machine.toml, report.html, diagnosis.rrd")
    diagnose.add_argument(
        "--quick", action="store_true", help="fewer candidates, quiet axes not searched: a look in less than half the time"
    )
    diagnose.add_argument("--seed", type=_seed, default=0, metavar="N", help="seed of the noise that the twin draws (default 0)")

    exam = add("exam", exam_command, "diagnose sealed campaigns of a second plant, open the seals, score")
    add_exam_arguments(exam)

    cut = add("cut", cut_command, "cut the part along the followed tool path: where the mark is and how deep")
    add_cut_arguments(cut)

    regress = add("regress", regress_command, "run a suite of cases headless and compare with golden results: what moved, and where first")
    add_regress_arguments(regress)

    study = add("study", study_command, "vary numbers of the machine file by a design, run every variant, tell what each number buys")
    add_study_arguments(study)

    replay = add("replay", replay_command, "open the viewer on a run, a recording, a trace or any MJCF or URDF")
    add_replay_arguments(replay)

    machine = add("machine", machine_command, "make a machine file from a model, check it, show its data sheet")
    add_machine_arguments(machine)

    effects = add("effects", "effects_command", "list the effects that a machine can have beyond the nominal model")
    effects.add_argument("name", nargs="?", metavar="NAME", help="tell one effect's law, parameters, bounds and usual sizes")
    _machine_arguments(effects)
    return parser


def _positive(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0.0 < (value := float(text)) < 1e6:
            return value
    raise argparse.ArgumentTypeError(f"'{text}': give a number above 0 and below 1e6")


def _seed(text: str) -> int:
    with contextlib.suppress(ValueError):
        if (value := int(text)) >= 0:
            return value
    raise argparse.ArgumentTypeError(f"'{text}': give a whole number, 0 or more")


def _machine_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--machine", metavar="FILE", help="machine file (default: the Mikron UCP 710 that ships with twin)")


if __name__ == "__main__":
    sys.exit(main())
