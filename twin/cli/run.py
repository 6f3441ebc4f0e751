"""`twin run`: simulate a program or the set points of a trace."""

from __future__ import annotations

import argparse
from datetime import datetime
from pathlib import Path
import sys

from twin.cli.arguments import add_machine, add_place, machine_of, positive, seed, setpoints_of_input
from twin.errors import InputError, SimulationError
from twin.files import output_folder, write_json
from twin.progress import Progress
from twin.recordings.trace import Trace, with_program_columns


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    parser.add_argument("input", metavar="INPUT", help="part program, or trace with <axis>.setpoint columns")
    add_machine(parser)
    add_place(parser)
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME:AXIS:PARAMETER=VALUE",
        help="add an effect, e.g. backlash:X:clearance=15e-6 (SI; may be given several times; see 'twin effects')",
    )
    parser.add_argument(
        "--feedforward", metavar="F", help="off | velocity | velocity+torque (default: as the machine file or the program says)"
    )
    parser.add_argument(
        "--out", metavar="DIR", help="folder for trace.parquet, run.rrd, run.png and summary.json (default: out/<name of the input>)"
    )
    parser.add_argument(
        "--strict", action="store_true", help="set points above an axis' speed, acceleration or jerk are an error, not a warning"
    )
    parser.add_argument(
        "--sample-period-ms", type=positive, metavar="MS", help="period of the written trace (default: 1, as the machine file says)"
    )
    parser.add_argument("--noise-seed", type=seed, metavar="N", help="add the machine's measuring noise, drawn with this seed")
    parser.add_argument("--no-recording", action="store_true", help="do not write run.rrd")


def carry_out(args: argparse.Namespace) -> int:
    """Simulate, then write trace, recording and summary; for a program also what the interpolator and what the drives make."""
    from twin.compare.contour import contour_numbers
    from twin.recordings.trace import write_trace
    from twin.report.figure import save_png
    from twin.simulation.command_columns import with_command_columns
    from twin.simulation.run import simulate
    from twin.simulation.setpoints import check_travel, limit_warnings, setpoints_of
    from twin.simulation.summary import effects_line, summary_of, summary_table

    machine = machine_of(args)
    source = Path(args.input)
    program, trace = setpoints_of_input(source, machine, args.place)
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
    followed = with_program_columns(with_command_columns(run.trace, machine.with_feedforward(feedforward), setpoints), trace)
    write_trace(followed, out / "trace.parquet")
    contour = contour_numbers(run)
    summary = {
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "input": str(source),
        "machine_file": str(machine.path) if machine.path else None,
        "feedforward": feedforward or "machine file",
        "noise_seed": args.noise_seed,
        **summary_of(machine, run),
        "contour": contour,
    }
    written = ["trace.parquet", "summary.json", "run.png"]
    print(f"{machine.name}, {source.name}: {setpoints.duration:.3f} s")
    print(f"effects: {effects_line(summary['effects'])}; feedforward: {feedforward or 'as the machine file says'}")
    print(summary_table(summary))
    if contour is not None:
        print(f"contour error of the tool tip: {contour['max_um']:.2f} um max, {contour['rms_um']:.2f} um RMS")
    save_png(run.plot(), out / "run.png")
    if program:
        from twin.program import error_budget, plot_feed

        budget = error_budget(program, trace, followed, machine)
        summary["error_budget"] = budget.summary()
        print(budget.table())
        plot_feed(trace, out / "feed.png", source.name)
        written.append("feed.png")
    write_json(summary, out / "summary.json", "summary")
    if not args.no_recording:
        from twin.replay import write_recording

        write_recording(out / "run.rrd", machine, {"simulated": followed})
        written.append("run.rrd")
    print(f"written to {out}: {', '.join(written)}")
    return 0
