"""What the commands do: each loads, calls the modules that do the work, prints and writes."""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
from typing import Any

from twin.errors import InputError, SimulationError
from twin.files import output_folder, write_json
from twin.program.read import PROGRAM_ENDINGS
from twin.progress import Progress
from twin.recordings.trace import Trace, with_program_columns

PICTURE_ENDINGS = (".png", ".svg", ".pdf")


def _load(args: argparse.Namespace) -> Any:
    from twin.machine.machine import load_machine

    return load_machine(args.machine)


def _load_with_effects(args: argparse.Namespace) -> Any:
    """The machine of --machine with the effects of --effect added to those of its file."""
    from twin.effects import parse_setting, settings_of, with_effects

    machine = _load(args)
    return with_effects(machine, [*settings_of(machine), *(parse_setting(text, machine) for text in args.effect)])


def run_command(args: argparse.Namespace) -> int:
    """Simulate, then write trace, recording and summary; for a program also what the interpolator and what the drives make."""
    from twin.recordings.trace import write_trace
    from twin.simulation.run import simulate
    from twin.simulation.setpoints import check_travel, limit_warnings, setpoints_of
    from twin.simulation.summary import summary_of, summary_table

    machine = _load_with_effects(args)
    source = Path(args.input)
    program, trace = _setpoint_trace(source, machine)
    setpoints = setpoints_of(trace, machine)
    check_travel(setpoints, machine, str(source))
    warnings = limit_warnings(setpoints, machine)
    if warnings and args.strict:
        raise InputError(f"{source}: {warnings[0]}; slow the set points down or leave out --strict")
    for line in warnings:
        print(f"warning: {source.name}: {line}", file=sys.stderr)
    out = output_folder(args.out or Path("out") / source.stem)
    period = args.sample_period_ms * 1e-3 if args.sample_period_ms else None
    feedforward = args.feedforward or (program.feedforward if program else None)
    with Progress(f"simulating {setpoints.duration:.1f} s") as bar:
        try:
            run = simulate(machine.with_feedforward(feedforward), setpoints, sample_period=period, noise_seed=args.noise_seed, progress=bar)
        except SimulationError as error:
            if isinstance(error.trace, Trace):
                write_trace(error.trace, out / "trace.parquet")
                raise SimulationError(f"{error}; what was recorded up to there is in {out / 'trace.parquet'}") from None
            raise
    followed = with_program_columns(run.trace, trace)
    write_trace(followed, out / "trace.parquet")
    summary = summary_of(machine, run)
    written = ["trace.parquet", "summary.json"]
    print(f"{machine.name}, {source.name}: {setpoints.duration:.3f} s")
    print(summary_table(summary))
    if program:
        from twin.program import error_budget, plot_feed

        budget = error_budget(program, trace, followed, machine)
        summary["error_budget"] = budget.summary()
        print(budget.table())
        plot_feed(trace, out / "feed.png", source.name)
        written.append("feed.png")
    write_json(summary, out / "summary.json")
    if not args.no_recording:
        from twin.replay import write_recording

        write_recording(out / "run.rrd", machine, {"simulated": followed}, summary=summary_table(summary))
        written.append("run.rrd")
    print(f"written to {out}: {', '.join(written)}")
    return 0


def interpolate_command(args: argparse.Namespace) -> int:
    """Program to set points only."""
    from twin.program import plot_feed
    from twin.recordings.trace import write_trace

    machine = _load(args)
    source, out = Path(args.program), Path(args.out)
    if source.suffix.lower() not in PROGRAM_ENDINGS:
        raise InputError(f"{source}: not a program; give a file ending in {', '.join(PROGRAM_ENDINGS)}")
    if args.plot and Path(args.plot).suffix.lower() not in PICTURE_ENDINGS:
        raise InputError(f"{args.plot}: a picture ends in {', '.join(PICTURE_ENDINGS)}")
    _, trace = _setpoint_trace(source, machine)
    write_trace(trace, out)
    print(f"{source.name}: {trace.time[-1]:.3f} s of set points every {trace.period * 1e3:g} ms, written to {out}")
    if args.plot:
        plot_feed(trace, args.plot, source.name)
        print(f"programmed and reached feed: {args.plot}")
    return 0


def _setpoint_trace(source: Path, machine: Any) -> tuple[Any, Trace]:
    """Set points of a program (with the program) or of a trace."""
    from twin.recordings.trace import read_trace

    if source.suffix.lower() not in PROGRAM_ENDINGS:
        return None, read_trace(source, axes=machine.kinds, need=("setpoint",))
    from twin.program import interpolate, read_program

    program = read_program(source, machine)
    for note in program.notes:
        print(f"note: {source.name}: {note}", file=sys.stderr)
    with Progress("interpolating") as bar:
        return program, interpolate(program, machine, progress=bar)


def effects_command(args: argparse.Namespace) -> int:
    """List all effects, or tell one of them."""
    from twin.effects import EFFECTS
    from twin.effects.effect import find_effect
    from twin.simulation.summary import table

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

    from twin.effects import settings_of
    from twin.recordings.campaign import read_campaign
    from twin.simulation.gap import COMPARED, gap_of_campaign
    from twin.simulation.summary import table

    machine = _load(args)
    settings_of(machine)
    campaign = read_campaign(args.campaign, machine)
    with Progress("comparing", total=len(campaign.runs)) as bar:
        gaps = gap_of_campaign(machine, campaign, progress=lambda _run: bar(None))
    shown = [s for s in COMPARED if any(s in signals for axes in gaps.values() for signals in axes.values())]
    rows = []
    for run, axes in gaps.items():
        for axis, signals in axes.items():
            cells = [f"{g.rms:.3f} {g.max:.2f} {g.noise:.3f} {g.unit}" if (g := signals.get(s)) else "-" for s in shown]
            rows.append([run, axis, *cells])
    print("measured minus simulated, each: RMS, largest, RMS that noise alone makes")
    print(table(["run", "axis", *(s.replace("_", " ") for s in shown)], rows))
    if args.json:
        plain = {run: {axis: {s: asdict(g) for s, g in signals.items()} for axis, signals in axes.items()} for run, axes in gaps.items()}
        write_json({"runs": plain}, Path(args.json))
    return 0


def diagnose_command(args: argparse.Namespace) -> int:
    """Diagnose a campaign; print the verdict and write the evidence."""
    from twin.diagnose import diagnose
    from twin.diagnose.output import summary_text, write_diagnosis
    from twin.recordings.campaign import read_campaign

    machine = _load(args)
    campaign = read_campaign(args.campaign, machine)
    out = output_folder(args.out)
    with Progress("diagnosing", total=None) as bar:
        diagnosis = diagnose(campaign, machine, quick=args.quick, seed=args.seed, progress=bar.say)
    document = write_diagnosis(diagnosis, out)
    print(summary_text(document))
    move = "" if diagnosis.proposal.move is None else ", next_measurement.csv"
    print(f"written to {out}: diagnosis.json, machine.toml, report.html, diagnosis.rrd{move}")
    return 0
