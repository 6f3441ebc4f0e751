"""`twin regress [SUITE] [--update]`: run a suite and compare it with golden results."""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
from pathlib import Path
import sys
import time
from typing import TYPE_CHECKING

from twin.cli.arguments import Args, arg, count, flag, out_argument
from twin.errors import InputError
from twin.files import shipped_example

if TYPE_CHECKING:
    from twin.regress.compare import Check
    from twin.regress.suite import Case

DEFAULT_SUITE = "examples/regression"
ROUNDING = 1e-6
"""Below this difference over tolerance only file rounding differs; no new golden result is written."""


ARGUMENTS = (
    arg("suite", "SUITE", f"suite file, or folder of suite files (default: {DEFAULT_SUITE})", nargs="?", default=DEFAULT_SUITE),
    arg("--only", "NAME", "only cases with this name (* and ? match; repeatable)", action="append", default=[]),
    arg("--jobs", "N", "cases run in parallel (default: one per core)", type=count),
    out_argument("folder for results and evidence (default: out/regress)", default="out/regress"),
    arg("--junit", "FILE", "JUnit XML to write (default: junit.xml in --out)"),
    arg("--json", "FILE", "JSON to write (default: regress.json in --out)"),
    flag("--no-evidence", "do not write a folder for each failed case"),
    flag("--list", "list the cases and what they guard; run nothing"),
    flag("--update", "store the current results as golden results; needs --reason"),
    arg("--reason", "TEXT", "why the golden results change; stored with them"),
)


def carry_out(args: Args) -> int:
    """Run and compare. Returns 0 if all differences are within tolerance, 1 if a case failed or could not run."""
    from twin.progress import Progress
    from twin.regress.run_suite import BROKEN, FAILED, run_suite
    from twin.regress.suite import chosen, read_suite
    from twin.regress.write import counts, verdict_table, write_results
    from twin.simulation.summary import table

    if args.reason is not None and not args.update:
        raise InputError("--reason needs --update; give both or neither")
    args.suite = str(shipped_example(args.suite))
    cases = chosen(read_suite(args.suite), args.only, args.suite)
    if args.list:
        print(table(["case", "kind", "what it guards"], [[c.name, c.kind, str(c.table.get("why", ""))] for c in cases], left=3))
        return 0
    if args.update:
        return _update(args, cases)
    out = Path(args.out)
    evidence = None if args.no_evidence else out
    began = time.perf_counter()
    with Progress("regression", total=len(cases)) as bar:
        verdicts = run_suite(cases, jobs=args.jobs, out=evidence, done=lambda: bar(None))
    seconds = time.perf_counter() - began
    write_results(verdicts, seconds, Path(args.junit or out / "junit.xml"), Path(args.json or out / "regress.json"))
    print(verdict_table(verdicts))
    print(f"{counts(verdicts)} in {seconds:.1f} s; results in {out}")
    return 1 if any(v.status in (FAILED, BROKEN) for v in verdicts) else 0


def _update(args: Args, cases: Sequence[Case]) -> int:
    """Show old and new values, ask for a reason, write the changed golden results."""
    from twin.progress import Progress
    from twin.regress.compare import uncompared
    from twin.regress.golden import golden_paths, history_of, write_golden
    from twin.regress.run_suite import BROKEN, SKIPPED, run_suite
    from twin.simulation.summary import table

    with Progress("regression", total=len(cases)) as bar:
        verdicts = run_suite(cases, jobs=args.jobs, update=True, done=lambda: bar(None))
    broken = [v for v in verdicts if v.status == BROKEN or v.stopped]
    if broken:
        raise InputError(f"{broken[0].case.where}: {broken[0].text}; golden results need a complete run; correct the case first")
    for v in verdicts:
        if v.status == SKIPPED:
            print(f"skipped, golden result unchanged: {v.case.name}: {v.text}")
    rows, changed = [], []
    for v in verdicts:
        if v.new is None:
            continue
        if v.golden is None:
            rows.append([v.case.name, "(new case)", "-", f"{len(v.new.features)} numbers", "-", "-"])
            changed.append(v)
            continue
        differing = [c for c in v.checks if c.excess > ROUNDING or (v.case.kind == "campaign" and _is_smaller(c))]
        for c in sorted(differing, key=lambda c: -c.excess)[:12]:
            old, new = (_cell(value) for value in (c.golden, c.now))
            rows.append([v.case.name, c.quantity, old, new, f"{c.found:.4g} {c.unit}", f"{min(c.excess, 1e6):.2g}"])
        rows += [[v.case.name, name, "-", _cell(v.new.features[name].value), "-", "-"] for name in uncompared(v.golden, v.new)[:12]]
        if not differing and v.golden.case != v.new.case:
            rows.append([v.case.name, "(the case's table)", v.golden.case, v.new.case, "-", "-"])
        if differing or v.note or v.golden.case != v.new.case:
            changed.append(v)
    if not changed:
        print("no difference from the golden results; nothing written")
        return 0
    print(table(["case", "quantity", "old", "new", "difference", "of tolerance"], rows, left=2))
    if others := {v.note for v in changed if v.note}:
        print("\n".join(f"note: {note}" for note in sorted(others)))
    reason = args.reason or ""
    if args.reason is None and sys.stdin.isatty():
        with contextlib.suppress(EOFError):
            reason = input(f"Why do these {len(changed)} golden results change? ")
    reason = reason.strip()
    if len(reason) < 5:
        raise InputError("--update: new golden results need a reason, which is stored; give --reason 'what changed and why it is right'")
    for v in changed:
        assert v.new is not None
        number = sum(c.excess > ROUNDING for c in v.checks) if v.golden else len(v.new.features)
        write_golden(v.case, v.new, history_of(v.case), reason, number)
    print(f"{len(changed)} golden results written to {golden_paths(changed[0].case)[0].parent}: {reason}")
    return 0


def _cell(value: float | str | None) -> str:
    return "-" if value is None else value if isinstance(value, str) else f"{value:.8g}"


def _is_smaller(check: Check) -> bool:
    """A gap that became smaller is no failure, but a golden result to store: later it may not grow back unnoticed."""
    return isinstance(check.golden, float) and isinstance(check.now, float) and check.now < check.golden * (1.0 - ROUNDING)
