"""`twin study`: carry a design study out and answer it."""

from __future__ import annotations

import argparse
from pathlib import Path

from twin.errors import InputError
from twin.progress import Progress


def add_study_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("spec", metavar="SPEC", help="study file (.toml): factors, design, runs")
    parser.add_argument("--machine", metavar="FILE", help="machine file (default: the study's, else the Mikron UCP 710)")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the results; a killed study goes on there with --resume")
    parser.add_argument("--resume", action="store_true", help="go on with the variants that the folder lacks")
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="run on a Dask cluster, e.g. tcp://host:8786 (default: threads of this machine)"
    )
    parser.add_argument("--threads", type=int, metavar="N", help="threads of this machine (default: one for each core)")


def study_command(args: argparse.Namespace) -> int:
    """Carry out, answer, print the findings."""
    from twin.study.carry_out import carry_out, executor_of, fingerprint
    from twin.study.design import variants_of
    from twin.study.output import looked_at, sentences, write_study
    from twin.study.spec import read_study
    from twin.study.store import Store

    if args.threads is not None and args.threads < 1:
        raise InputError(f"--threads {args.threads}: give 1 or more")
    study = read_study(args.spec, args.machine)
    variants = variants_of(study)
    out = Path(args.out)
    store = Store(out, fingerprint(study, variants), args.resume)
    try:
        with executor_of(args.scheduler, args.threads) as (executor, workers), Progress("variants", total=len(variants)) as bar:
            for _ in store.done():
                bar(None)
            carry_out(study, variants, store, executor, workers, bar)
        rows = store.rows()
        looked_at(study, rows)
        answers = write_study(study, rows, out)
    finally:
        store.close()
    for line in sentences(study, answers):
        print(line)
    print(f"written to {out}: table.parquet, table.csv, study.json, report.html{', best_machine.toml' if 'best' in answers else ''}")
    if answers["failed"] == answers["variants"]:
        raise InputError(f"{args.spec}: no variant could be run; the first one: {rows[0][3]}")
    return 0
