"""`twin interpolate`: a program to set points, no more."""

from __future__ import annotations

import argparse
from pathlib import Path

from twin.cli.arguments import add_machine, add_place, machine_of, picture_file, setpoints_of_input
from twin.errors import InputError
from twin.program.read import PROGRAM_ENDINGS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    parser.add_argument("program", metavar="PROGRAM", help="part program (.mpf .ngc .apt ...)")
    parser.add_argument("--out", required=True, metavar="FILE", help="trace with the set points (.parquet or .csv)")
    parser.add_argument("--plot", metavar="PNG", help="plot programmed and reached feed over path length")
    add_machine(parser)
    add_place(parser)


def carry_out(args: argparse.Namespace) -> int:
    """Program to set points only."""
    from twin.program import plot_feed
    from twin.recordings.trace import write_trace

    machine = machine_of(args)
    source, out = Path(args.program), Path(args.out)
    if source.suffix.lower() not in PROGRAM_ENDINGS:
        raise InputError(f"{source}: not a program; give a file ending in {', '.join(PROGRAM_ENDINGS)}")
    plot = picture_file(args.plot) if args.plot else None
    _, trace = setpoints_of_input(source, machine, args.place)
    write_trace(trace, out)
    print(f"{source.name}: {trace.time[-1]:.3f} s of set points every {trace.period * 1e3:g} ms, written to {out}")
    if plot:
        plot_feed(trace, plot, source.name)
        print(f"programmed and reached feed: {plot}")
    return 0
