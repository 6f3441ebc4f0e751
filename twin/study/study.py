"""A design study in one call."""

from pathlib import Path
import tempfile

from twin.study.design import variants_of
from twin.study.execution import simulated, threads_here
from twin.study.output import write_study
from twin.study.results import Answers, answers_of
from twin.study.spec import read_study


def study(spec: str | Path, out: str | Path | None = None, *, machine: str | Path | None = None, threads: int | None = None) -> Answers:
    """Run a study on the threads of this computer and return its answers.

    `out` is the folder for results and report (None: nothing is kept); results of the same study in it are continued. `machine` is
    another machine file. The answers hold the effect of each factor on each response from its low to its high end in the response's
    unit, the Pareto front and the best variant. Raises InputError for an invalid study file.
    """
    known = read_study(spec, machine)
    with tempfile.TemporaryDirectory(prefix="twin-study-", ignore_cleanup_errors=True) as scratch:
        rows, _ = simulated(known, variants_of(known), Path(out or scratch), threads_here(threads), resume=out is not None)
        answers = answers_of(known, rows)
        if out is not None:
            write_study(known, answers, Path(out))
    return answers
