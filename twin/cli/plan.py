"""`twin plan`: plan a measuring campaign that identifies each parameter to a given precision."""

from pathlib import Path

from twin.cli.arguments import MACHINE, Args, arg, machine_of, number, out_argument
from twin.files import output_folder
from twin.progress import Progress

ARGUMENTS = (
    MACHINE,
    out_argument("folder for part programs, set points and plan.json (default: out/plan)", default="out/plan"),
    arg(
        "--precision", "FRACTION", "relative half width of the 95 %% interval of each parameter (default: 0.01)", default=0.01,
        type=number("a fraction between 0.00001 and 1, e.g. 0.01 for 1 %", lambda v: 1e-5 < v < 1.0),
    ),
    arg(
        "--minutes", "MIN", "longest duration of the campaign (default: 15)", default=15.0,
        type=number("minutes above 0, e.g. 15", lambda v: 0.0 < v < 24.0 * 60.0),
    ),
)  # fmt: skip


def carry_out(args: Args) -> None:
    """Plan a campaign, write it, print the predicted interval of each parameter."""
    from twin.identify.plan import plan_campaign, write_plan
    from twin.identify.result import words_of
    from twin.simulation.summary import table

    machine = machine_of(args)
    output_folder(args.out)  # fails before the long computation
    with Progress("planning", 3 * len(machine.axes)) as bar:
        plan = plan_campaign(machine, args.precision, args.minutes * 60.0, bar.step)
    files = write_plan(plan, machine, Path(args.out))
    rows = [
        [p.axis, words_of(p.name, p.axis), f"{p.value:.4g}", p.unit, f"+- {100 * p.half:.2g} %", _missed(p.half, p.law, args.precision)]
        for p in plan.predicted
    ]
    print(table(["axis", "parameter", "value", "unit", "predicted 95 %", ""], rows, left=2))
    print("runs: " + ", ".join(f"{r.name} {r.duration:.1f} s ({r.feedforward}, {r.repeats} x)" for r in plan.runs))
    print(f"written: {', '.join(str(f) for f in files)}")


def _missed(half: float, law: float, precision: float) -> str:
    """Why a parameter misses the precision; '' if it reaches it."""
    if half <= precision:
        return ""
    return "more rounds do not help" if law >= 0.95 * precision else "needs more --minutes"
