"""The command line: one function per command, thin; all work is done by the modules that it names."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
import json
from pathlib import Path
import sys
from typing import Any

from twin.errors import SimulationError, TwinError

DESCRIPTION = """Digital twin of a machine tool's feed drives on MuJoCo.

    program -> interpolator -> set points -> cascade + plant -> trace -> tool path -> cut surface

It predicts where the axes and the tool really go, and says why a measured machine differs.
Start with:  twin run examples/x_200mm.csv --out out/first
"""

PROGRAM_ENDINGS = (".mpf", ".spf", ".ngc", ".nc", ".apt", ".cls", ".cl")


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code: 0 done, 1 a verdict that fails, 2 bad input or usage (one line on standard error)."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    parser = build_parser()
    args = parser.parse_args(arguments)
    try:
        return int(args.command(args) or 0)
    except TwinError as error:
        print(f"twin: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        print("twin: stopped by the user", file=sys.stderr)
        return 130


class _Parser(argparse.ArgumentParser):
    """Usage errors in one line, with exit code 2."""

    def error(self, message: str) -> Any:
        self.exit(2, f"twin: {message}; try '{self.prog} --help'\n")


def build_parser() -> argparse.ArgumentParser:
    from twin.replay import add_replay_arguments, replay_command

    parser = _Parser(prog="twin", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=_Parser)

    def add(name: str, command: Callable[[argparse.Namespace], int | None], text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        sub.set_defaults(command=command)
        return sub

    run = add("run", run_command, "simulate a program (.mpf .ngc .apt) or the set points of a trace (.parquet .csv)")
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

    gap = add("gap", gap_command, "simulate every run of a measured campaign and compare signal by signal")
    gap.add_argument("campaign", metavar="CAMPAIGN", help="folder with campaign.toml and its traces")
    _machine_arguments(gap)
    gap.add_argument("--json", metavar="FILE", help="write the result as JSON")

    replay = add("replay", replay_command, "open the viewer on a run, a recording, a trace or any MJCF or URDF")
    add_replay_arguments(replay)

    effects = add("effects", effects_command, "list the effects that a machine can have beyond the nominal model")
    effects.add_argument("name", nargs="?", metavar="NAME", help="tell one effect's law, parameters, bounds and usual sizes")
    _machine_arguments(effects)
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"'{text}' is out of bounds; give a number above 0 and below 1e6")
    return value


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"'{text}' is negative; give 0 or more")
    return value


def _machine_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--machine", metavar="FILE", help="machine file (default: the Mikron UCP 710 that ships with twin)")


def _load(args: argparse.Namespace) -> Any:
    from twin.machine import load_machine

    return load_machine(args.machine)


def _load_with_effects(args: argparse.Namespace) -> Any:
    """The machine of --machine with the effects of --effect added to those of its file."""
    from twin.effects import parse_setting, settings_of, with_effects

    machine = _load(args)
    return with_effects(machine, [*settings_of(machine), *(parse_setting(text, machine) for text in args.effect)])


def run_command(args: argparse.Namespace) -> int:
    """Simulate, then write trace, recording and summary."""
    from twin.run import simulate
    from twin.setpoints import check_travel, limit_warnings, setpoints_of
    from twin.summary import summary_of, summary_table
    from twin.trace import read_trace, write_trace

    machine = _load_with_effects(args)
    source = Path(args.input)
    trace = read_trace(source, axes=machine.kinds, need=("setpoint",))
    setpoints = setpoints_of(trace, machine)
    check_travel(setpoints, machine, str(source))
    warnings = limit_warnings(setpoints, machine)
    if warnings and args.strict:
        from twin.errors import InputError

        raise InputError(f"{source}: {warnings[0]}; slow the set points down or leave out --strict")
    for line in warnings:
        print(f"warning: {source.name}: {line}", file=sys.stderr)
    out = _output_folder(args.out or Path("out") / source.stem)
    period = args.sample_period_ms * 1e-3 if args.sample_period_ms else None
    with _progress(f"simulating {setpoints.duration:.1f} s") as bar:
        try:
            run = simulate(
                machine.with_feedforward(args.feedforward), setpoints, sample_period=period, noise_seed=args.noise_seed, progress=bar
            )
        except SimulationError as error:
            if error.trace is not None:
                write_trace(error.trace, out / "trace.parquet")  # type: ignore[arg-type]
                raise SimulationError(f"{error}; what was recorded up to there is in {out / 'trace.parquet'}") from None
            raise
    write_trace(run.trace, out / "trace.parquet")
    summary = summary_of(machine, run)
    _write_json(summary, out / "summary.json")
    written = [out / "trace.parquet", out / "summary.json"]
    if not args.no_recording:
        from twin.replay import write_recording

        write_recording(out / "run.rrd", machine, {"simulated": run.trace}, summary=summary_table(summary))
        written.append(out / "run.rrd")
    print(f"{machine.name}, {source.name}: {setpoints.duration:.3f} s")
    print(summary_table(summary))
    print(f"written: {', '.join(map(str, written))}")
    return 0


def effects_command(args: argparse.Namespace) -> int:
    """List all effects, or tell one of them."""
    from twin.effects import EFFECTS
    from twin.effects.effect import find_effect
    from twin.summary import table

    machine = _load(args)
    if not args.name:
        rows = [[e.name, "".join(a.name for a in e.axes(machine)), e.block, e.summary] for e in EFFECTS.values()]
        print(table(["effect", "axes", "block", "what it is"], rows, left=4))
        return 0
    effect = find_effect(args.name, "twin effects")
    print(f"{effect.name} ({effect.block}; {effect.which_axes})\n\n{effect.law}\n")
    rows = []
    for axis in effect.axes(machine):
        for p in effect.parameters:
            low, high = p.usual_range(machine, axis)
            default = f"{p.default:g}" if p.default is not None else "computed" if p.shape else "must be given"
            rows.append(
                [axis.name, p.name, p.unit(axis), f"{p.low:g} .. {p.high:g}", "-" if p.shape else f"{low:.3g} .. {high:.3g}", default]
            )
    print(table(["axis", "parameter", "unit", "bounds", "usual size", "default"], rows, left=3))
    return 0


def gap_command(args: argparse.Namespace) -> int:
    """Simulate and compare; print one line per run and axis."""
    from dataclasses import asdict

    from twin.campaign import read_campaign
    from twin.effects import settings_of
    from twin.gap import COMPARED, gap_of_campaign
    from twin.summary import table

    machine = _load(args)
    settings_of(machine)
    campaign = read_campaign(args.campaign, machine)
    with _progress("comparing", total=len(campaign.runs)) as bar:
        gaps = gap_of_campaign(machine, campaign, progress=lambda _run: bar(None))
    rows = []
    for run, axes in gaps.items():
        for axis, signals in axes.items():
            cells = [f"{g.rms:.3f} {g.max:.2f} {g.noise:.3f} {g.unit}" if (g := signals.get(s)) else "-" for s in COMPARED]
            rows.append([run, axis, *cells])
    print("measured minus simulated, each: RMS, largest, RMS that noise alone makes")
    print(table(["run", "axis", *(s.replace("_", " ") for s in COMPARED)], rows))
    if args.json:
        plain = {run: {axis: {s: asdict(g) for s, g in signals.items()} for axis, signals in axes.items()} for run, axes in gaps.items()}
        _write_json({"runs": plain}, Path(args.json))
    return 0


def _output_folder(path: str | Path) -> Path:
    from twin.errors import InputError

    out = Path(path)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot make this folder ({error.strerror}); give another --out") from None
    return out


def _write_json(content: Any, path: Path) -> None:
    from twin.errors import InputError

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another place") from None


class _progress:
    """A progress bar on a terminal for work above a second; call it with the done fraction, or None for one more step."""

    def __init__(self, text: str, total: int | None = None):
        from tqdm import tqdm

        if total is None:
            layout = "{desc} {percentage:3.0f}% |{bar}| {elapsed} < {remaining}"
            self.bar = tqdm(total=1.0, desc=text, delay=1.0, disable=None, bar_format=layout, leave=False)
        else:
            self.bar = tqdm(total=total, desc=text, delay=1.0, disable=None, leave=False)

    def __call__(self, fraction: float | None) -> None:
        self.bar.update(1 if fraction is None else fraction - self.bar.n)

    def __enter__(self) -> _progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()


if __name__ == "__main__":
    sys.exit(main())
