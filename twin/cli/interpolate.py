"""`twin interpolate`: convert a program to set points."""

from pathlib import Path

from twin.cli.arguments import MACHINE, PLACE, Args, arg, machine_of, picture_file, program_of_input
from twin.errors import InputError
from twin.files import shipped_example
from twin.program.read import PROGRAM_ENDINGS, is_program
from twin.progress import Progress

ARGUMENTS = (
    arg("program", "PROGRAM", "part program (.mpf .ngc .apt ...)"),
    arg("--out", "FILE", "trace to write (.parquet .csv)", required=True),
    arg("--plot", "PNG", "plot programmed and reached feed over path length"),
    MACHINE,
    PLACE,
)


def carry_out(args: Args) -> None:
    """Write the set points block by block; with --plot, hold them all in memory."""
    from twin.program import interpolate, plot_feed, set_point_blocks
    from twin.recordings.trace import written

    machine = machine_of(args)
    source, out = shipped_example(args.program), Path(args.out)
    if source.is_file() and not is_program(source):
        raise InputError(f"{source}: not a program; give a file ending in {', '.join(PROGRAM_ENDINGS)}")
    plot = picture_file(args.plot) if args.plot else None
    program = program_of_input(source, machine, args.place)
    with Progress("interpolating") as bar:
        traces = [interpolate(program, machine, progress=bar)] if plot else set_point_blocks(program, machine, progress=bar)
        for trace in written(traces, out):
            last = trace
    print(f"{source.name}: {last.time[-1]:.3f} s of set points every {machine.position_cycle * 1e3:g} ms, written to {out}")
    if plot:
        plot_feed(last, plot, source.name)
        print(f"programmed and reached feed: {plot}")
