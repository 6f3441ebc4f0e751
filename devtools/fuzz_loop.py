"""One loop for all fuzzers: seeded cases in a process of their own, with limits on time and memory; what is no refusal in one line is a fault.

Pictures are drawn in one case of `DRAWN`, they take longer than all else; and a kind in `rarely` comes once while the others come three times.

A kind is a name and a function `case(seed, folder) -> fault or ""`. The loop draws the kinds in turn. The child process writes which case it is
at, so that a crash of the process is one fault, and goes on behind it. Beside what a kind reports, a fault is: a case above `SECONDS` of processor time, memory above
`BYTES`, a file outside the folder of the case, a process that ends.
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

SECONDS = 60.0
STANDS_STILL = 20.0
"""On a computer with other work a case gets a share of a core; one that waits takes no processor time at all."""
DRAWN = 8
"""One case in so many draws its pictures; in the others an empty one is written."""
BYTES = 2_000_000_000
"""Memory that a case may take beside what the process has when all is loaded."""
LONGEST_LINE = 420
"""Characters of a message: a path, 300 for what is said."""

Case = Callable[[int, Path], str]


class TooLong(BaseException):
    """A case that goes on for longer than it may; no `except Exception` on the way swallows it."""


@dataclass
class Tally:
    """Cases by kind, and what went wrong."""

    cases: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    """Processor time by kind [s]."""
    faults: list[str] = field(default_factory=list)

    @property
    def total(self) -> int:
        """All cases."""
        return sum(self.cases.values())

    def add(self, seed: int, kind: str, seconds: float, fault: str, say: Callable[[str], Any]) -> None:
        """Count a case, and report its fault if it has one."""
        self.cases[kind] = self.cases.get(kind, 0) + 1
        self.seconds[kind] = self.seconds.get(kind, 0.0) + seconds
        if fault:
            self.faults.append(f"seed {seed} ({kind}): {fault}")
            say(self.faults[-1])


def called(arguments: tuple[object, ...], allowed: tuple[str, ...] = ("found: ", "note: ", "warning: ")) -> tuple[int, str]:
    """(exit code, fault or "") of one command in this process: done, or refused with one line that begins with `twin:`."""
    import twin
    from twin.cli import main

    out, error = io.StringIO(), io.StringIO()
    with _standard_error() as below:
        try:
            with warnings.catch_warnings(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
                warnings.simplefilter("error", RuntimeWarning)
                code = int(main([*map(str, arguments)]) or 0)
        except SystemExit as stop:  # usage: said by the parser
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
    if said := [line for line in out.getvalue().splitlines() if "nan" in line.lower().split() and "repair" not in line]:
        return code, f"prints nan: {said[0][:200]}"
    if code == 0 and lines:
        return code, f"done, and on standard error: {lines[0][:300]}"
    if "Traceback" in error.getvalue():
        return code, error.getvalue()[-1500:]
    return code, ""


@contextlib.contextmanager
def _standard_error() -> Iterator[Callable[[], str]]:
    """What libraries in C and other processes write to standard error, past Python, as far as it has come."""
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
    """Carry out cases seed, seed + 1, ..., each kind in its turn, in a child process that is begun anew where it ended; at most for so long."""
    often = [kind for kind in kinds if kind not in rarely]
    names = [*often, *often, *often, *(kind for kind in kinds if kind in rarely)]
    tally, at, end = Tally(), seed, time.monotonic() + 60.0 * minutes
    context = multiprocessing.get_context("spawn" if os.name == "nt" else "fork")
    while at < seed + cases and time.monotonic() < end:
        mine, theirs = context.Pipe(duplex=False)
        child = context.Process(target=_carry_out, args=(kinds, names, at, seed + cases, theirs, seconds, end), daemon=False)
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
    """The fault of one case, "" where there is none: in an empty folder, with a watch on time, memory and stray files."""
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
    """Pictures are written, and nothing is on them."""
    from matplotlib.figure import Figure

    def empty(_: Figure, to: Any, **__: Any) -> None:
        if isinstance(to, io.StringIO):
            to.write("<svg></svg>")
        else:
            Path(to).write_bytes(b"")

    with mock.patch.object(Figure, "savefig", empty), mock.patch("twin.report.figure.plain_text", lambda figure: figure):
        yield


_PEAK_LOADED = 600_000_000
"""Memory of a process that has all rooms loaded."""


def _carry_out(kinds: Mapping[str, Case], names: Sequence[str], start: int, end: int, pipe: Any, seconds: float, last: float) -> None:
    """The child: cases one after the other until the moment `last`, each reported when it is done."""
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
    """Raise TooLong after so much processor time, or `STANDS_STILL` times as long by the clock, where the system can."""
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
    """Largest memory of this process so far [bytes]."""
    try:
        import resource
    except ImportError:
        return None
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
