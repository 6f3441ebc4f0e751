"""`twin run`: simulate a program or the set points of a trace."""

import contextlib
from datetime import datetime
from pathlib import Path
import sys

import numpy as np

from twin.cli.arguments import EFFECT, MACHINE, PLACE, Args, arg, finish, flag, machine_of, out_argument, seed, setpoints_of_input
from twin.errors import InputError, SimulationError, TwinError, one_line
from twin.files import output_folder, write_json
from twin.machine import Machine
from twin.progress import Progress
from twin.recordings.trace import Trace, with_program_columns, write_trace
from twin.simulation.setpoints import Setpoints, check_travel, setpoints_of
from twin.units import in_words

ARGUMENTS = (
    arg("input", "INPUT", "part program, or trace with set points"),
    MACHINE,
    PLACE,
    EFFECT,
    flag("--beside", "also simulate without --effect, and compare both"),
    arg("--feedforward", "F", "off | velocity | velocity+torque (default: from the program, else the machine file)"),
    out_argument("folder for trace.parquet, run.rrd, run.png and summary.json (default: out/<name of the input>)", default=None),
    flag("--strict", "refuse set points beyond an axis' speed, acceleration or jerk instead of warning"),
    arg("--noise-seed", "N", "add measuring noise with this seed", type=seed),
    flag("--no-recording", "do not write run.rrd"),
    flag("--open", "open the picture of the run, or the report of --beside"),
)


def carry_out(args: Args) -> None:
    """Simulate; write trace, recording and summary; for a program also the error budget of interpolator and drives."""
    from twin.report.figure import save_png
    from twin.simulation.errors_of_run import contour_error_of
    from twin.simulation.position_command import with_command_columns
    from twin.simulation.run import simulate
    from twin.simulation.setpoint_limits import limit_warnings
    from twin.simulation.summary import effects_line, feedforward_line, summary_of, summary_table

    if args.beside and not args.effect:
        raise InputError("--beside needs an --effect to compare with")
    machine = machine_of(args)
    source = Path(args.input)
    program, trace = setpoints_of_input(source, machine, args.place)
    setpoints = setpoints_of(trace, machine)
    check_travel(setpoints, machine, str(source))
    warnings = limit_warnings(setpoints, machine)
    if warnings and args.strict:
        raise InputError(f"{source}: {warnings[0]}; slow the set points down or leave out --strict")
    for line in warnings:
        print(f"warning: {one_line(f'{source.name}: {line}')}", file=sys.stderr)
    out = output_folder(args.out or Path("out") / source.stem)
    machine = machine.with_feedforward(args.feedforward or (program.feedforward if program else None))
    effects, feedforward = effects_line(machine), feedforward_line(machine)
    with Progress(f"simulating {setpoints.duration:.1f} s") as bar:
        try:
            run = simulate(machine, setpoints, noise_seed=args.noise_seed, progress=bar)
        except SimulationError as error:
            if isinstance(error.trace, Trace):
                write_trace(error.trace, out / "trace.parquet")
                raise SimulationError(f"{error}; the trace up to there is in {out / 'trace.parquet'}") from None
            raise
    followed = with_program_columns(with_command_columns(run.trace, machine, setpoints), trace)
    write_trace(followed, out / "trace.parquet")
    contour = None  # for a machine without tool or part frame
    with contextlib.suppress(TwinError):
        off = contour_error_of(run.trace, machine).error * 1e6
        contour = {"max_um": float(off.max()), "rms_um": float(np.sqrt(np.mean(off**2)))}
    summary = {
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "input": str(source),
        "machine_file": str(machine.path) if machine.path else None,
        "feedforward": feedforward,
        "noise_seed": args.noise_seed,
        **summary_of(machine, run),
        "contour": contour,
    }
    written = ["trace.parquet", "summary.json", "run.png"]
    print(f"{machine.name}, {source.name}: {setpoints.duration:.3f} s")
    print(f"effects: {effects}; feedforward: {feedforward}")
    print(summary_table(summary))
    if contour is not None and not program:  # a program has its budget
        print(f"contour error of the tool tip: {contour['max_um']:.2f} um max, {contour['rms_um']:.2f} um RMS")
    save_png(run.plot(title=f"{source.name} on {machine.name}; effects: {effects}"), out / "run.png")
    if program:
        from twin.program import error_budget, plot_feed

        budget = error_budget(program, trace, followed, machine)
        summary["error_budget"] = budget.summary()
        print(budget.table())
        plot_feed(trace, out / "feed.png", source.name)
        written.append("feed.png")
    write_json(summary, out / "summary.json", "summary")
    if not args.no_recording:
        from twin.replay.recording import write_recording

        write_recording(out / "run.rrd", machine, {"simulated": followed}, summary=f"effects: {effects}\nfeedforward: {feedforward}")
        written.append("run.rrd")
    if args.beside:
        written += _beside(args, machine, setpoints, followed, out)
    finish(args, out, f"{', '.join(written)}", ("report.html" if args.beside else "run.png"))


def _beside(args: Args, machine: Machine, setpoints: Setpoints, followed: Trace, out: Path) -> list[str]:
    """Simulate the same motion without `--effect` and compare. Returns the names of the files written."""
    from twin.compare.compare import compare
    from twin.compare.pages import write_comparison_page
    from twin.effects import settings_of, with_effects
    from twin.simulation.run import simulate
    from twin.simulation.summary import effects_line

    settings = settings_of(machine)
    own = len(settings) - len(args.effect)
    without, added = with_effects(machine, settings[:own]), settings[own:]
    with Progress("simulating without the effects") as bar:
        nominal = simulate(without, setpoints, sample_period=followed.period, noise_seed=args.noise_seed, progress=bar).trace
    name = f"with {in_words(added[0].effect.name)} {added[0].axis}" if len(added) == 1 else f"with {len(added)} effects"
    comparison = compare(nominal, followed, machine, names=("without" if own else "nominal", name))
    print(f"\n{comparison.verdict}\n{comparison.table()}")
    write_trace(nominal, out / "without.parquet")
    write_json({"kind": "runs", **comparison.document()}, out / "compare.json", "compare")
    write_comparison_page(comparison, out / "report.html", f"{args.input}, with: {effects_line(machine)}")
    return ["without.parquet", "compare.json", "report.html"]
