"""Executes a study: variants go to an executor (threads or a Dask cluster), results to the store, one row per variant, committed as it arrives."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
import contextlib
from dataclasses import dataclass
import functools
import hashlib
import json
import logging
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from threadpoolctl import threadpool_limits

import twin
from twin.effects.user_files import loaded_files
from twin.effects.user_files import share as share_files
from twin.errors import InputError, TwinError
from twin.study.evaluate import FAULT, Answer, Work, evaluate, files_of_study, work_of
from twin.study.results import Row, check_names
from twin.study.row_file import RowFile
from twin.study.spec import Study, broken_by
from twin.system import cores
from twin.tables import is_number

FILE = "study.sqlite"
AHEAD = 4
"""Submitted variants per worker: enough to keep it busy with bounded memory."""
SECONDS_TO_ANSWER = 10
"""Time for a scheduler to answer and to have a worker."""
SECONDS_WITHOUT_WORKER = 30
"""Time for a cluster without workers to get new ones."""


def _numbers(kind: type[Any], text: object) -> Any:
    """A list or an object of finite numbers in JSON."""
    found = json.loads(text) if isinstance(text, str) else None
    if not isinstance(found, kind) or not all(map(is_number, found.values() if kind is dict else found)):
        raise ValueError("a row is damaged")
    return found


class Store(RowFile):
    """The results in one folder; only one study at a time can open it."""

    def __init__(self, folder: Path, fingerprint: str, resume: bool) -> None:
        columns = "number INTEGER PRIMARY KEY, factors TEXT, responses TEXT, reason TEXT"
        other = "holds another study (factors, runs, machine, part, a mesh, design or the version of twin differ)"
        super().__init__(folder, FILE, "variant", columns, fingerprint, other)
        with self.in_one_line():  # a variant that an error of the program ended is computed again
            self.connection.execute("DELETE FROM variant WHERE reason LIKE ?", (FAULT + "%",))
        if (done := len(self.done())) and not resume:
            self.close()
            raise InputError(f"{self.path}: already holds {done} variants; add --resume or give another --out")

    def done(self) -> set[int]:
        """Numbers of the variants that have a row."""
        return {row[0] for row in self.select("number")}

    def put(self, number: int, factors: Sequence[float], answer: Answer) -> None:
        """Commit one variant; a second row for the same variant is refused."""
        self.insert((number, json.dumps(list(factors)), json.dumps(answer.responses), answer.reason))

    def rows(self) -> list[Row]:
        """All rows in the order of the design."""
        found = self.select("number, factors, responses, reason", "number")
        with self.in_one_line():
            rows = [(n, _numbers(list, f), _numbers(dict, r), None if reason is None else str(reason)) for n, f, r, reason in found]
            if len({len(factors) for _, factors, _, _ in rows}) > 1:
                raise ValueError("rows of different length")
        return rows


@dataclass(frozen=True)
class Workers:
    """An executor, its present number of parallel tasks, and a function that sends it the shared data."""

    executor: Executor
    count: Callable[[], int]
    share: Callable[[Work], Any]


def fingerprint(study: Study, variants: np.ndarray) -> str:
    """Hash of everything that the results depend on; `answer` and constraints are evaluated later and do not count."""
    parts: list[Any] = [twin.__version__, study.machine.document, study.factors, study.tied, study.recommission, study.retune]
    parts += [(run.name, run.feedforward, run.part is not None) for run in study.runs]
    files = [file.read_bytes() for file in (*files_of_study(study), *loaded_files())]
    return hashlib.sha256(b"\0".join([variants.tobytes(), *(repr(p).encode() for p in parts), *files])).hexdigest()


def simulated(
    study: Study,
    variants: np.ndarray,
    folder: Path,
    workers: contextlib.AbstractContextManager[Workers],
    resume: bool = False,
    progress: Callable[[None], None] = lambda _done: None,
) -> tuple[list[Row], int]:
    """Rows of all variants in the folder, which `workers` complete, and the number of those that stood there before.

    A variant that ran has as reason the present constraints that it breaks, if any.
    """
    with contextlib.closing(Store(folder, fingerprint(study, variants), resume)) as store:
        known = len(store.done())
        for _ in range(known):
            progress(None)
        if known < len(variants):
            with workers as hands:
                carry_out(study, variants, store, hands, progress)
        rows = store.rows()
    return [(n, row, found, "; ".join(broken_by(study.constraints, found)) or None if found else why) for n, row, found, why in rows], known


def carry_out(study: Study, variants: np.ndarray, store: Store, workers: Workers, progress: Callable[[None], None]) -> None:
    """Evaluate every variant that the store lacks, and commit each as it arrives, in any order.

    Raises:
        InputError: no worker is left, or the study file names a response that the first variant does not have.
    """
    left = iter(sorted(set(range(len(variants))) - store.done()))
    shared: Any = None
    checked = False
    pending: dict[Future[Answer], int] = {}
    while True:
        while len(pending) < AHEAD * max(1, workers.count()) and (number := next(left, None)) is not None:
            shared = shared if shared is not None else workers.share(work_of(study))
            pending[workers.executor.submit(evaluate, shared, tuple(variants[number].tolist()))] = number
        if not pending:
            return
        arrived = wait(pending, timeout=SECONDS_WITHOUT_WORKER, return_when=FIRST_COMPLETED).done
        if not arrived and workers.count() == 0:
            raise InputError(f"{store.path}: no worker is left; start new ones and continue with --resume (finished variants are kept)")
        for future in arrived:
            number = pending.pop(future)
            try:
                answer = future.result()
            except TwinError:
                raise
            except Exception as error:  # a worker without twin, a scheduler that went away, a variant that kills its workers
                message = " ".join(str(error).split())[:200]
                raise InputError(
                    f"{store.path}: variant {number} was lost ({type(error).__name__}: {message}); "
                    "check the workers and continue with --resume (finished variants are kept)"
                ) from None
            store.put(number, variants[number].tolist(), answer)
            if not checked and answer.responses:
                check_names(study, answer.responses, some_variants=True)
                checked = True
            progress(None)


@contextlib.contextmanager
def threads_here(count: int | None = None) -> Iterator[Workers]:
    """Threads of this process, by default one per core; the compiled loop releases the interpreter lock.

    BLAS keeps to one thread: more change the last bits, since they split long dot products, and wait for each other.
    """
    count = count or cores()
    with threadpool_limits(limits=1, user_api="blas"), ThreadPoolExecutor(count) as pool:
        try:
            yield Workers(pool, lambda: count, lambda work: work)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


@contextlib.contextmanager
def dask_cluster(scheduler: str) -> Iterator[Workers]:
    """The `concurrent.futures` executor of a Dask cluster; the scheduler re-runs what a lost worker had."""
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--scheduler needs Dask: pip install 'twin[cluster]'") from None
    for name in ("distributed", "distributed.client", "distributed.core", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # errors are reported in one line below
    _check_address(scheduler)
    try:
        client = Client(scheduler, timeout=SECONDS_TO_ANSWER, set_as_default=False)
    except (OSError, ValueError, TypeError, TimeoutError) as error:
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({type(error).__name__}); start one with 'dask scheduler', or leave it out"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=SECONDS_TO_ANSWER)
        except TimeoutError:
            raise InputError(f"--scheduler {scheduler}: has no worker; start some with 'dask worker {scheduler}'") from None

        client.register_worker_callbacks(_one_blas_thread)  # also on workers that join later
        if effect_files := loaded_files():
            client.register_worker_callbacks(functools.partial(share_files, effect_files))

        def share(work: Work) -> Any:
            # a task of its own: sent once, and recomputed by the scheduler if its worker is lost
            return client.submit(_same, work.packed(), pure=False)

        executor = client.get_executor(pure=False)
        try:
            yield Workers(executor, lambda: sum(client.nthreads().values()), share)
        finally:
            executor.shutdown(wait=False)  # after an error, do not wait for running variants


def _check_address(scheduler: str) -> None:
    """Refuse an invalid address before a client is created, because its later clean-up would fail as well."""
    try:
        parts = urlsplit(scheduler if "://" in scheduler else f"tcp://{scheduler}")
        complete = bool(parts.hostname and parts.port)
    except ValueError:
        complete = False
    if not complete:
        raise InputError(f"--scheduler {scheduler}: not an address; give host and port of the scheduler, e.g. tcp://192.168.0.10:8786")


def _same(work: Work) -> Work:
    return work


def _one_blas_thread() -> None:
    """Limit BLAS of a worker to one thread from now on."""
    threadpool_limits(limits=1, user_api="blas")
