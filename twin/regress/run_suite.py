"""Runs all cases of a suite in parallel processes and compares each with its golden result."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
import contextlib
from dataclasses import dataclass, field, replace
import multiprocessing
from pathlib import Path
import signal
import threading
import time
import traceback

from twin.errors import TwinError
from twin.regress.compare import Check, compare, uncompared
from twin.regress.golden import Golden, golden_of, read_golden, versions
from twin.regress.runners import Skip, run_case
from twin.regress.suite import Case
from twin.regress.where import Place, place_of
from twin.stopping import end_with_parent
from twin.system import cores

PASSED, FAILED, SKIPPED, BROKEN = "passed", "failed", "skipped", "error"
HEAVY = {"diagnose": 0, "study": 1, "identify": 2, "cut": 3, "campaign": 4, "run": 5}
"""Order of the kinds: long cases start first, so that no core idles at the end."""


@dataclass(frozen=True)
class Verdict:
    """Result of one case: status, checks, duration, message, and place of a failure."""

    case: Case
    status: str
    seconds: float = 0.0
    checks: tuple[Check, ...] = ()
    text: str = ""
    place: Place | None = None
    note: str = ""
    new: Golden | None = field(default=None, repr=False)
    golden: Golden | None = field(default=None, repr=False)
    written: Path | None = None
    stopped: bool = False  # the simulation was aborted

    @property
    def worst(self) -> Check | None:
        """The check with the largest difference over tolerance."""
        return max((c for c in self.checks if c.allowed > 0 or not c.ok), key=lambda c: c.excess, default=None)


def run_suite(
    cases: Sequence[Case], *, jobs: int | None = None, out: Path | None = None, update: bool = False, done: Callable[[], None] | None = None
) -> list[Verdict]:
    """Verdicts in the order of the cases. `out`: folder for the evidence of failed cases.

    `update` also accepts golden results of an earlier version of a case, and cases without one.
    """
    if not update:
        for case in cases:
            read_golden(case)  # report errors of the suite before running it
    order = sorted(cases, key=lambda case: HEAVY[case.kind])
    found: dict[str, Verdict] = {}
    for verdict in _verdicts(order, min(jobs or cores(), len(order)), out, update):
        found[verdict.case.name] = verdict
        if done:
            done()
    return [found[case.name] for case in cases]


def _verdicts(order: Sequence[Case], count: int, out: Path | None, update: bool) -> Iterator[Verdict]:
    """Verdicts in order of completion, `count` cases at a time."""
    if count <= 1:
        yield from (judge(case, out, update) for case in order)
        return
    # fresh processes, without the state of this one; compiled functions come from the cache on disk
    with ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"), initializer=end_with_parent) as pool:
        try:
            with _deaf_children():
                running = {pool.submit(judge, case, out, update): case for case in order}
            for future in as_completed(running):
                try:
                    yield future.result()
                except BrokenProcessPool:
                    yield Verdict(running[future], BROKEN, text="not run: a process of the suite was killed (out of memory?); try --jobs 1")
        except BaseException:  # stopped by the user: cancel waiting cases and end running ones
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            raise


@contextlib.contextmanager
def _deaf_children() -> Iterator[None]:
    """Child processes started here ignore Ctrl-C; this process ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def judge(case: Case, out: Path | None, update: bool) -> Verdict:
    """Run and compare one case; an error in it becomes its verdict and does not stop the others."""
    began = time.perf_counter()
    try:
        golden = read_golden(case, of_this_case=not update)
    except TwinError:
        if not update:
            raise
        golden = None
    try:
        verdict = compared(case, golden, out if not update else None)
    except Skip as reason:
        verdict = Verdict(case, SKIPPED, text=str(reason))
    except TwinError as error:
        verdict = Verdict(case, BROKEN, text=f"cannot run: {' '.join(str(error).split()).removeprefix(f'{case.where}: ')}")
    except Exception as error:
        line = traceback.extract_tb(error.__traceback__)[-1]
        cause = " ".join(f"{type(error).__name__}: {error}".split())
        verdict = Verdict(case, BROKEN, text=f"cannot run: {cause} in {Path(line.filename).name}, line {line.lineno}")
    return replace(verdict, seconds=time.perf_counter() - began)


def compared(case: Case, golden: Golden | None, out: Path | None) -> Verdict:
    """Run one case and compare it with a golden result (None: there is none yet); evidence of a failure goes below `out`."""
    outcome = run_case(case)
    new, stopped = golden_of(outcome, case), bool(outcome.failed)
    if golden is None:
        text = f"simulation aborted: {outcome.failed}" if stopped else "no golden result so far"
        return Verdict(case, BROKEN if stopped else PASSED, text=text, new=new, stopped=stopped)
    checks, new_names = tuple(compare(case, golden, outcome)), uncompared(golden, new)
    shift = f"{case.name}: {len(new_names)} numbers without golden value, e.g. {new_names[0]}; add them with --update" if new_names else ""
    note = "; ".join(filter(None, (version_note(golden), shift)))
    if all(check.ok for check in checks):
        return Verdict(case, PASSED, checks=checks, note=note, new=new, golden=golden)
    place = place_of(outcome.machine, golden.trace, outcome.trace, checks)
    text = sentence(case, checks, place, outcome.failed)
    written = None
    if out is not None:
        from twin.regress.failed_case import write_evidence

        written = write_evidence(out / case.name, case, golden, outcome, checks, place, text)
    return Verdict(case, FAILED, checks=checks, text=text, place=place, note=note, new=new, golden=golden, written=written, stopped=stopped)


def version_note(golden: Golden) -> str:
    """Note on versions that differ from the golden result; '' if none does."""
    now = versions()
    other = [f"{name} {golden.versions.get(name, '?')} -> {now[name]}" for name in now if golden.versions.get(name) != now[name]]
    return f"golden result of another version: {', '.join(other)}; to accept the change: --update --reason '...'" if other else ""


def sentence(case: Case, checks: Sequence[Check], place: Place, failed: str) -> str:
    """A failure in words: axis, time, first block and worst difference."""
    worst = max((c for c in checks if not c.ok), key=lambda c: c.excess)
    subject = f"axis {place.axis}" if place.axis else case.name
    since = f" from {place.since_s:.3f} s on" if place.since_s is not None else ""
    first = f"; first changed block: {place.block}" if place.block and place.axis else f"; in: {place.block}" if place.block else ""
    stopped = f" (simulation aborted: {failed})" if failed else ""
    return f"{subject} differs{since}{first}; worst: {worst.text}{stopped}"
