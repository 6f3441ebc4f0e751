"""`twin plan`: plan a measuring campaign that identifies each parameter to a given precision."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from twin.cli.arguments import add_machine, machine_of
from twin.errors import InputError
from twin.files import output_folder
from twin.progress import Steps

if TYPE_CHECKING:
    from twin.identify.plan import Predicted


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `twin plan`."""
    add_machine(parser)
    parser.add_argument(
        "--out", default="out/plan", metavar="DIR", help="folder for part programs, set points and plan.json (default: out/plan)"
    )
    parser.add_argument(
        "--precision",
        type=float,
        default=0.01,
        metavar="FRACTION",
        help="relative half width of the 95 %% interval of each parameter (default: 0.01)",
    )
    parser.add_argument("--minutes", type=float, default=15.0, metavar="MIN", help="longest duration of the campaign (default: 15)")


def carry_out(args: argparse.Namespace) -> int:
    """Plan a campaign, write it, print the predicted interval of each parameter."""
    from twin.identify.plan import plan_campaign, write_plan
    from twin.simulation.summary import table

    if not 1e-5 < args.precision < 1.0:
        raise InputError(f"--precision {args.precision:g}: a fraction between 0.00001 and 1, e.g. 0.01 for 1 %")
    if not 0.0 < args.minutes < 24.0 * 60.0:
        raise InputError(f"--minutes {args.minutes:g}: give minutes above 0, e.g. 15")
    machine = machine_of(args)
    output_folder(args.out)  # fails before the long computation
    with Steps("planning", 3 * len(machine.axes)) as step:
        plan = plan_campaign(machine, args.precision, args.minutes * 60.0, step)
    try:
        files = write_plan(plan, machine, Path(args.out))
    except OSError as error:
        raise InputError(f"{args.out}: cannot be written ({error.strerror}); give another --out") from None
    rows = [[p.axis, p.name, f"{p.value:.6g}", p.unit, f"+- {100 * p.half:.2g} %", _missed(p, args.precision)] for p in plan.predicted]
    print(table(["axis", "parameter", "value", "unit", "predicted 95 %", ""], rows, left=2))
    print("runs: " + ", ".join(f"{r.name} {r.duration:.1f} s ({r.feedforward}, {r.repeats} x)" for r in plan.runs))
    print(f"written: {', '.join(str(f) for f in files)}")
    return 0


def _missed(p: Predicted, precision: float) -> str:
    """What a parameter lacks to reach the precision; '' if it does."""
    if p.half <= precision:
        return ""
    return "more rounds do not help" if p.law >= 0.95 * precision else "needs more --minutes"
