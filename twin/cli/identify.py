"""Command line of `twin identify` and `twin plan`."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
import sys
from typing import TYPE_CHECKING

from twin.errors import InputError
from twin.files import write_json

if TYPE_CHECKING:
    from twin.identify.plan import Predicted

STEPS = 14
"""About so many steps are reported by an identification with refinement."""


def add_identify_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `twin identify CAMPAIGN --out MACHINE.toml`."""
    parser.add_argument("campaign", metavar="CAMPAIGN", help="folder with campaign.toml and its traces")
    parser.add_argument("--out", required=True, metavar="MACHINE.toml", help="machine file to write; its MJCF is copied beside it")
    parser.add_argument("--machine", metavar="FILE", help="machine file to start from (default: the Mikron UCP 710 that ships with twin)")
    parser.add_argument("--report", metavar="FILE.html", help="report with pictures (default: beside the machine file)")
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON")
    parser.add_argument("--no-refine", action="store_true", help="regression only, without re-simulation")
    parser.add_argument(
        "--torque-constant-within",
        type=float,
        metavar="FRACTION",
        help="torque constants are known within this fraction, e.g. 0.001 (default: parameter_tolerance)",
    )


def identify_command(args: argparse.Namespace) -> int:
    """Identify, write machine file, report and JSON, print the table."""
    from twin.identify.campaign_fit import identify_campaign
    from twin.identify.report import write_report
    from twin.identify.write import as_json, write_identified
    from twin.machine.machine import load_machine
    from twin.recordings.campaign import read_campaign
    from twin.simulation.summary import table

    out = Path(args.out)
    if out.suffix != ".toml":
        raise InputError(f"--out {out}: a machine file ends in .toml; rename it")
    within = args.torque_constant_within
    if within is not None and not 0.0 <= within < 1.0:
        raise InputError(f"--torque-constant-within {within:g}: a fraction between 0 and 1, e.g. 0.001 for 0.1 %")
    machine = load_machine(args.machine)
    campaign = read_campaign(args.campaign, machine)
    with _steps("identifying", STEPS) as step:
        result = identify_campaign(machine, campaign, refine=not args.no_refine, torque_constant_tolerance=within, progress=step)
    try:
        write_identified(result, out)
        files = write_report(result, args.report or out.with_suffix(".html"))
    except OSError as error:
        raise InputError(f"{error.filename or out}: cannot be written ({error.strerror}); give another place") from None
    for finding in result.findings:
        print(f"found: {finding}", file=sys.stderr)
    rows = []
    for p in result.parameters:
        r = p.refined if result.chosen == "refined" and p.refined else p.value
        product = f"{p.estimate.value:.6g} +- {p.estimate.half:.2g}" if p.product else ""
        rows.append([p.axis, p.name, f"{p.before:.6g}", f"{r.value:.6g}", f"+- {r.half:.2g}", p.unit, product])
    print(table(["axis", "parameter", "before", "identified", "95 %", "unit", "product at the file's Kt"], rows, left=2))
    if not all(result.tolerance_holds.values()):
        print("The products contradict parameter_tolerance; the file's torque constants were kept.")
    print(f"route: {result.chosen}; fitted on {', '.join(result.training)}; left out: {', '.join(result.left_out) or 'none'}")
    print(f"written: {out}, {files[0]}")
    if args.json:
        write_json(as_json(result), Path(args.json))
    return 0


def add_plan_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `twin plan`."""
    parser.add_argument("--machine", metavar="FILE", help="machine file (default: the Mikron UCP 710 that ships with twin)")
    parser.add_argument(
        "--out", default="out/plan", metavar="DIR", help="folder for part programs, set points and plan.json (default: out/plan)"
    )
    parser.add_argument(
        "--precision", type=float, default=0.01, metavar="FRACTION", help="wanted half interval of each parameter (default: 0.01)"
    )
    parser.add_argument("--minutes", type=float, default=15.0, metavar="MIN", help="longest campaign allowed (default: 15)")


def plan_command(args: argparse.Namespace) -> int:
    """Plan a campaign, write it, print what each parameter will be known to."""
    from twin.identify.plan import plan_campaign, write_plan
    from twin.machine.machine import load_machine
    from twin.simulation.summary import table

    if not 1e-5 < args.precision < 1.0:
        raise InputError(f"--precision {args.precision:g}: a fraction between 0.00001 and 1, e.g. 0.01 for 1 %")
    if not 0.0 < args.minutes < 24.0 * 60.0:
        raise InputError(f"--minutes {args.minutes:g}: give minutes above 0, e.g. 15")
    machine = load_machine(args.machine)
    with _steps("planning", 3 * len(machine.axes)) as step:
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
    """What stands behind a parameter that does not reach the wanted precision."""
    if p.half <= precision:
        return ""
    return "more rounds do not help" if p.law >= 0.95 * precision else "needs more --minutes"


class _steps:
    """A bar on a terminal that goes one step with each report, with its name."""

    def __init__(self, text: str, total: int):
        from tqdm import tqdm

        self.bar = tqdm(total=total, desc=text, delay=1.0, disable=None, leave=False, bar_format="{desc} |{bar}| {elapsed}")

    def __call__(self, name: str) -> None:
        self.bar.set_description_str(name)
        if self.bar.n < self.bar.total - 1:  # type: ignore[operator]
            self.bar.update(1)

    def __enter__(self) -> Callable[[str], None]:
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()
