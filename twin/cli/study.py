"""`twin study`: run a design study and evaluate it."""

from pathlib import Path

from twin.cli.arguments import OPEN, THREADS, Args, arg, finish, flag, out_argument
from twin.errors import InputError
from twin.files import shipped_example
from twin.progress import Progress

ARGUMENTS = (
    arg("spec", "SPEC", "study file (.toml): factors, design, runs", type=shipped_example),
    arg("--machine", "FILE", "machine file (default: from the study file, else the Mikron UCP 710)"),
    out_argument("folder for the results"),
    flag("--resume", "continue a stopped study: simulate only the missing variants"),
    arg("--scheduler", "ADDRESS", "Dask cluster, e.g. tcp://host:8786 (default: threads on this computer)"),
    THREADS,
    ("--compare", {"type": int, "nargs": 2, "metavar": ("A", "B"), "help": "also record two variants side by side and compare their motor torques"}),
    flag("--no-replay", "do not record the best variant beside the nominal machine"),
    OPEN,
)  # fmt: skip


def carry_out(args: Args) -> None:
    """Run the study, evaluate it, print the results."""
    from twin.simulation.summary import table
    from twin.study.design import variants_of
    from twin.study.execution import dask_cluster, simulated, threads_here
    from twin.study.labels import titled
    from twin.study.output import write_comparison, write_study
    from twin.study.report import SWING_HEADING, best_sentence, sentences, swing_rows
    from twin.study.results import answers_of
    from twin.study.spec import read_study

    if args.threads and args.scheduler:
        raise InputError("--threads applies to this computer, --scheduler uses the workers of a cluster; leave out one of them")
    study = read_study(args.spec, args.machine)
    variants = variants_of(study)
    out = Path(args.out)
    workers = dask_cluster(args.scheduler) if args.scheduler else threads_here(args.threads)
    with Progress("variants", total=len(variants)) as bar:
        rows, known = simulated(study, variants, out, workers, args.resume, bar)
    if not any(responses for _, _, responses, _ in rows):
        raise InputError(f"{args.spec}: no variant could be simulated; the first one: {rows[0][3]}")
    answers = answers_of(study, rows)
    with Progress("report", total=0):
        written = write_study(study, answers, out, replay=not args.no_replay)
        if args.compare:
            written += write_comparison(study, answers, args.compare, out)
    print(f"{study.machine.name}: {len(rows)} variants{f', {known} of them done before' if known else ''}")
    for line in sentences(answers):
        print(line)
    for r in answers.responses:
        if r.swings:
            print(f"\n{titled(r.name)} ({r.name})")
            print(table(SWING_HEADING, swing_rows(answers, r)))
        if r.sobol:
            lines = zip(answers.factors, r.sobol["S1"], r.sobol["S1_conf"], r.sobol["ST"], r.sobol["ST_conf"])
            print(table(["factor", "first order", "total"], [[n, f"{a:.3f} +- {b:.3f}", f"{c:.3f} +- {d:.3f}"] for n, a, b, c, d in lines]))
    print(f"\n{best_sentence(answers)}".rstrip())
    finish(args, out, f"{', '.join(name for name in written if not name.startswith('plots/'))}, plots/")
