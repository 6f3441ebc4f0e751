"""Carry a study out: variants to an executor, results to the store. Threads here, or the futures of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
import contextlib
import hashlib
import os
from typing import Any

import numpy as np

from twin.errors import InputError, TwinError
from twin.setpoints import Setpoints, setpoints_of
from twin.study.design import machine_of
from twin.study.evaluate import Task, evaluate
from twin.study.spec import Study, StudyRun
from twin.study.store import Store
from twin.trace import read_trace

PROGRAM_ENDINGS = (".mpf", ".spf", ".ngc", ".nc", ".iso", ".apt", ".aptsource", ".cls", ".cl")
AHEAD = 4
"""Tasks in flight for each worker: enough to keep it busy, few enough to bound the memory."""


def fingerprint(study: Study, variants: np.ndarray) -> str:
    """What a folder of results is the result of."""
    parts = [study.text.encode(), repr(study.machine.document).encode(), variants.tobytes()]
    parts += [run.input.read_bytes() for run in study.runs]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()


def carry_out(study: Study, variants: np.ndarray, store: Store, executor: Executor, workers: int, progress: Callable[[None], None]) -> None:
    """Evaluate every variant that the store lacks; each is committed as it arrives, in whatever order."""
    sources = [_source(study, run) for run in study.runs]
    left = iter(sorted(set(range(len(variants))) - store.done()))
    local = isinstance(executor, ThreadPoolExecutor)
    pending: dict[Future[Any], int] = {}
    while True:
        while len(pending) < AHEAD * workers and (number := next(left, None)) is not None:
            try:
                task = Task(machine_of(study, variants[number]), tuple(sources), str(study.part) if study.part else None)
                pending[executor.submit(evaluate, task if local else task.packed())] = number
            except TwinError as error:  # an impossible machine is a result
                store.put(number, variants[number].tolist(), {"reason": " ".join(str(error).split())})
                progress(None)
        if not pending:
            return
        for future in wait(pending, return_when=FIRST_COMPLETED).done:
            number = pending.pop(future)
            store.put(number, variants[number].tolist(), future.result())
            progress(None)


def _source(study: Study, run: StudyRun) -> tuple[str, Setpoints | str, str, str | None]:
    """Set points of a run; a program stays text where a factor changes the limits that it is interpolated with."""
    ending = run.input.suffix.lower()
    if ending not in PROGRAM_ENDINGS:
        trace = read_trace(run.input, axes=study.machine.kinds, need=("setpoint",))
        return run.name, setpoints_of(trace, study.machine), "", run.feedforward
    from twin.program import interpolate, read_program

    program = read_program(run.input, study.machine)
    paths = [p for f in study.factors for p in f.paths] + [t.path for t in study.tied]
    if any(".max_" in p or p.startswith("control.") for p in paths):
        return run.name, run.input.read_text(encoding="utf-8"), ending, run.feedforward or program.feedforward
    return run.name, setpoints_of(interpolate(program, study.machine), study.machine), "", run.feedforward or program.feedforward


@contextlib.contextmanager
def executor_of(scheduler: str | None, threads: int | None) -> Iterator[tuple[Executor, int]]:
    """Threads of this machine, or the `concurrent.futures` executor of a Dask cluster; with how many workers it has."""
    if scheduler is None:
        count = threads or os.cpu_count() or 1
        with ThreadPoolExecutor(count) as pool:
            try:
                yield pool, count
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        return
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--scheduler needs Dask: pip install 'twin[cluster]'") from None
    try:
        client = Client(scheduler, timeout=10, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({type(error).__name__}); start one, or leave it out"
        ) from None
    with client:
        yield client.get_executor(retries=3), max(1, sum(client.nthreads().values()))
