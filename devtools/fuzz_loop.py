"""The loop of all fuzzers: seeded cases in a child process, with limits on time and memory.

A kind is a name and a function `case(seed, folder)` that returns a fault, or "" if there is none. The loop takes the kinds in turn; a kind in
`rarely` comes once while the others come three times. Every case is reported to the parent process, so that a crash of the child counts as one fault
and the loop continues with the next case. A case is also a fault if it takes more than `SECONDS` of processor time or `BYTES` of memory, or leaves a
file outside its folder. Pictures are drawn in one case out of `DRAWN`, because drawing takes most of the time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass, field
import io
import math
import multiprocessing
import os
from pathlib import Path
import signal
import tempfile
import time
import traceback
from typing import Any
from unittest import mock
import warnings

from twin.stopping import end_with_parent

SECONDS = 60.0
STANDS_STILL = 20.0
"""A case may take this many times `SECONDS` by the clock: a waiting process uses no processor time."""
DRAWN = 8
"""One case in this many draws its pictures; the others write empty files."""
BYTES = 2_000_000_000
"""Memory that a case may use beyond that of a process with all modules loaded."""
EACH = 1000
"""Cases of one child process: a library of the viewer keeps threads of every recording that a process wrote."""
LONGEST_LINE = 420
"""Characters of a message: 300, and a path."""

STEERING = {chr(n) for n in (*range(9), *range(11, 32), *range(127, 160), *range(0x202A, 0x202F))}
"""Characters that steer a terminal; none may be printed."""

Case = Callable[[int, Path], str]


class TooLong(BaseException):
    """A case exceeded its time. Not an Exception, so that no handler on the way catches it."""


@dataclass
class Tally:
    """Number of cases and processor time by kind, and all faults."""

    cases: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    """Processor time by kind [s]."""
    faults: list[str] = field(default_factory=list)

    @property
    def total(self) -> int:
        """Number of all cases."""
        return sum(self.cases.values())

    def add(self, seed: int, kind: str, seconds: float, fault: str, say: Callable[[str], Any]) -> None:
        """Count a case and report its fault, if any."""
        self.cases[kind] = self.cases.get(kind, 0) + 1
        self.seconds[kind] = self.seconds.get(kind, 0.0) + seconds
        if fault:
            self.faults.append(f"seed {seed} ({kind}): {fault}")
            say(self.faults[-1])


def called(arguments: tuple[object, ...], allowed: tuple[str, ...] = ("finding: ", "note: ", "warning: ")) -> tuple[int, str]:
    """Run a command in this process: (exit code, fault). It must succeed, or print one line that starts with `twin:`."""
    import twin
    from twin.cli import main

    out, error = io.StringIO(), io.StringIO()
    with _standard_error() as below:
        try:
            with warnings.catch_warnings(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
                warnings.simplefilter("error", RuntimeWarning)
                code = int(main([*map(str, arguments)]) or 0)
        except SystemExit as stop:  # usage errors of the parser
            code = int(stop.code or 0)
        except TooLong:
            raise
        except BaseException:
            return -1, traceback.format_exc(limit=-4)
        error.write(below())
    lines = [line for line in error.getvalue().strip().splitlines() if not line.startswith((*allowed, f"twin {twin.__version__}, "))]
    if code not in (0, 1, 2):
        return code, f"exit code {code}: {error.getvalue()[:300]}"
    if code == 2 and (len(lines) != 1 or not lines[0].startswith("twin: ")):
        return code, f"exit code 2 with {len(lines)} lines: {error.getvalue()[:300]}"
    if code == 2 and len(lines[0]) > LONGEST_LINE + len(str(arguments)):
        return code, f"a message of {len(lines[0])} characters: {lines[0][:300]}"
    if said := [
        line
        for line in out.getvalue().splitlines()
        if "nan" in line.lower().split() and not {"repair", "holds", "map:", "use:"} & set(line.split())
    ]:
        return code, f"prints nan: {said[0][:200]}"
    if code == 0 and lines:
        return code, f"done, and on standard error: {lines[0][:300]}"
    if steering := set(out.getvalue() + error.getvalue()) & STEERING:
        return code, f"prints {sorted(steering)!r}"
    if "Traceback" in error.getvalue():
        return code, error.getvalue()[-1500:]
    return code, ""


@contextlib.contextmanager
def _standard_error() -> Iterator[Callable[[], str]]:
    """Capture what C libraries and child processes write to standard error; yields a function that returns it."""
    kept = os.dup(2)
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 2)

        def read() -> str:
            file.seek(0)
            return file.read().decode(errors="replace")

        try:
            yield read
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def fuzz(
    kinds: Mapping[str, Case],
    cases: int,
    seed: int,
    say: Callable[[str], Any] = print,
    seconds: float = SECONDS,
    minutes: float = math.inf,
    rarely: tuple[str, ...] = (),
) -> Tally:
    """Run cases `seed`, `seed + 1`, ... for at most `minutes`, taking the kinds in turn, in a child process that is restarted after a crash."""
    often = [kind for kind in kinds if kind not in rarely]
    names = [*often, *often, *often, *(kind for kind in kinds if kind in rarely)]
    tally, at, end = Tally(), seed, time.monotonic() + 60.0 * minutes
    context = multiprocessing.get_context("spawn" if os.name == "nt" else "fork")
    while at < seed + cases and time.monotonic() < end:
        mine, theirs = context.Pipe(duplex=False)
        child = context.Process(
            target=_carry_out, args=(kinds, names, at, min(at + EACH, seed + cases), theirs, seconds, end), daemon=False
        )
        child.start()
        theirs.close()
        for done, seconds_taken, fault in _messages(mine):
            at = done + 1
            tally.add(done, names[done % len(names)], seconds_taken, fault, say)
        child.join()
        if at < seed + cases and child.exitcode != 0:
            tally.add(at, names[at % len(names)], 0.0, f"the process ended with {child.exitcode}", say)
            at += 1
    return tally


def one_case(kind: Case, seed: int, seconds: float = SECONDS) -> str:
    """The fault of one case, or "": run in an empty folder, with limits on time and memory and a check for files outside."""
    with tempfile.TemporaryDirectory(prefix="twin-fuzz-") as scratch:
        here, place = Path(scratch) / "here", Path(scratch) / "case"
        here.mkdir()
        place.mkdir()
        before, peak = os.getcwd(), _peak()
        os.chdir(here)
        try:
            with _watch(seconds), contextlib.nullcontext() if seed % DRAWN == 0 else _undrawn():
                fault = kind(seed, place)
        except TooLong:
            fault = f"takes longer than {seconds:g} s: {traceback.format_exc(limit=-3)}"
        except MemoryError:
            fault = f"memory: {traceback.format_exc(limit=-4)}"
        finally:
            os.chdir(before)
        if not fault and (stray := [p.name for p in (*here.iterdir(), *Path(scratch).iterdir()) if p not in (here, place)]):
            fault = f"wrote outside its folder: {', '.join(stray)}"
        if not fault and peak is not None and (_peak() or 0) > max(peak, _PEAK_LOADED) + BYTES:
            fault = f"took {((_peak() or 0) - peak) / 1e9:.1f} GB"
    return fault


@contextlib.contextmanager
def _undrawn() -> Iterator[None]:
    """Replace drawing by writing empty pictures."""
    from matplotlib.figure import Figure

    def empty(_: Figure, to: Any, **__: Any) -> None:
        if isinstance(to, io.StringIO):
            to.write("<svg></svg>")
        else:
            Path(to).write_bytes(b"")

    with mock.patch.object(Figure, "savefig", empty):
        yield


_PEAK_LOADED = 600_000_000
"""Memory of a process with all modules loaded [bytes]."""


def _carry_out(kinds: Mapping[str, Case], names: Sequence[str], start: int, end: int, pipe: Any, seconds: float, last: float) -> None:
    """Body of the child process: run cases until the time `last`, and report each."""
    end_with_parent()
    with contextlib.suppress(ImportError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (24_000_000_000, resource.RLIM_INFINITY))
    for seed in range(start, end):
        if time.monotonic() >= last:
            break
        begun = time.process_time()
        fault = one_case(kinds[names[seed % len(names)]], seed, seconds)
        pipe.send((seed, time.process_time() - begun, fault))
    pipe.close()


def _messages(pipe: Any) -> Iterator[tuple[int, float, str]]:
    while True:
        try:
            yield pipe.recv()
        except EOFError:
            return


@contextlib.contextmanager
def _watch(seconds: float) -> Iterator[None]:
    """Raise TooLong after `seconds` of processor time, or `STANDS_STILL` times as long by the clock; on Unix only."""
    if not hasattr(signal, "setitimer"):
        yield
        return
    clocks = ((signal.SIGPROF, signal.ITIMER_PROF, seconds), (signal.SIGALRM, signal.ITIMER_REAL, STANDS_STILL * seconds))

    def ring(*_: object) -> None:
        raise TooLong

    before = [signal.signal(number, ring) for number, _, _ in clocks]
    for _, timer, most in clocks:
        signal.setitimer(timer, most)
    try:
        yield
    finally:
        for (number, timer, _), handler in zip(clocks, before):
            signal.setitimer(timer, 0.0)
            signal.signal(number, handler)


def _peak() -> int | None:
    """Peak memory of this process [bytes]."""
    try:
        import resource
    except ImportError:
        return None
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
