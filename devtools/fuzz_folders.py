"""Kinds of the fuzzer: corrupted output folders that are read again, those of a run, a study, golden results, an examination and the desk.

    scripts/fuzz --only exam --cases 100

The commands write each folder once, from the samples of `fuzz_samples`; a case corrupts one of its files. The slow steps of an examination (the draw, the
diagnosis, its own runs) are done once or left out; everything that reads its folder runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
import contextlib
import functools
import http.client
import io
import json
from pathlib import Path
import random
import sqlite3
import subprocess
import sys
import tempfile
import threading
from typing import Any
from unittest import mock
from urllib.parse import quote, urlencode

from devtools.fuzz_files import laid, told
from devtools.fuzz_loop import Case, called
from devtools.fuzz_samples import Files, samples
from devtools.fuzz_spoil import spoil


def made_by(
    kind: str,
    *commands: Callable[[Path], tuple[object, ...]],
    keep: tuple[str, ...] = (".json", ".csv", ".toml", ".xml", ".parquet", ".sqlite"),
) -> dict[str, bytes]:
    """The files of a sample and those that commands write from it."""
    with tempfile.TemporaryDirectory(prefix="twin-fuzz-") as scratch:
        folder = Path(scratch)
        laid(samples()[kind], folder)
        for command in commands:
            code, fault = called(command(folder))
            assert code == 0, f"{command(folder)}: {fault or 'refused'}"
        return {
            f.relative_to(folder).as_posix(): f.read_bytes()
            for f in sorted(folder.rglob("*"))
            if f.is_file() and (f.suffix in keep or f.name == "seal.sha256")
        }


def run_again(folder: Path) -> tuple[object, ...]:
    """The command that simulates the move of a sample."""
    return ("run", folder / "move.csv", "--machine", folder / "small.toml", "--out", folder / "run", "--no-recording")


@functools.cache
def run_folder() -> dict[str, bytes]:
    """A run with its trace and summary."""
    return made_by("trace", run_again)


@functools.cache
def study_folder() -> dict[str, bytes]:
    """A finished study."""
    return made_by("study", lambda f: ("study", f / "study.toml", "--out", f / "out", "--no-replay", "--threads", "1"))


@functools.cache
def golden_folder() -> dict[str, bytes]:
    """A suite with its golden results."""
    return made_by(
        "suite",
        lambda f: (
            "regress",
            f / "suite.toml",
            "--update",
            "--reason",
            "the first result of this suite",
            "--out",
            f / "out",
            "--jobs",
            "1",
        ),
    )


@functools.cache
def desk_folder() -> dict[str, bytes]:
    """A run, a gap and a comparison beside a campaign."""
    small = lambda f: ("--machine", f / "small.toml")  # noqa: E731
    return made_by(
        "campaign",
        run_again,
        lambda f: ("gap", f, *small(f), "--json", f / "gap.json"),
        lambda f: ("compare", f / "run", f / "run", "--out", f / "compared", *small(f)),
        lambda f: ("diagnose", f, "--out", f / "diagnosis", *small(f), "--quick"),
        keep=(".json", ".csv", ".toml", ".xml", ".parquet", ".html"),
    )


def spoilt(files: Files, folder: Path, rng: random.Random, most: Callable[[str], bool]) -> str:
    """Write the files, corrupt one of them (mostly one for which `most` is true) and return its name."""
    laid(files, folder)
    chosen = [name for name in files if most(name)]
    name = rng.choice(chosen if rng.random() < 0.85 else list(files))
    if rng.random() < 0.05:
        (folder / name).unlink()
    else:
        spoil(folder / name, rng)
    return name


def run(seed: int, folder: Path) -> str:
    """Compare, replay and evaluate a run."""
    rng = random.Random(f"run folder {seed}")
    name = spoilt(run_folder(), folder, rng, lambda n: n.startswith("run/"))
    small = ("--machine", folder / "small.toml")
    command: tuple[object, ...] = rng.choice((
        ("compare", folder / "run", folder / "run", *small, "--out", folder / "out"), ("replay", folder / "run", *small, "--out", folder / "x.rrd"),
        ("iso", "230-2", folder / "run", *small, "--json", folder / "i.json"), ("gap", folder / "run", *small),
    ))  # fmt: skip
    return told(name, command, folder, called(command)[1])


def study(seed: int, folder: Path) -> str:
    """Continue a study."""
    rng = random.Random(f"study folder {seed}")
    name = spoilt(study_folder(), folder, rng, lambda n: n.endswith(".sqlite"))
    command = ("study", folder / "study.toml", "--out", folder / "out", "--no-replay", "--threads", "1", "--resume")
    return told(name, command, folder, called(command)[1])


CELLS = (None, "x", b"\xff", -1, 1e308, float("inf"), "", "[]", "{", "[[1]]", '{"a": 1e400}', '{"a": "x"}', '{"a": null}', "NaN", 2**62)
"""Unexpected values in a data base."""


def study_cells(seed: int, folder: Path) -> str:
    """Continue a study with another value in one cell of its data base."""
    rng = random.Random(f"study cells {seed}")
    laid(study_folder(), folder)
    with contextlib.closing(sqlite3.connect(folder / "out" / "study.sqlite")) as base, base:
        table = rng.choice([name for (name,) in base.execute("select name from sqlite_master where type = 'table'")])
        column = rng.choice([row[1] for row in base.execute(f"pragma table_info({table})")])
        rows = [row for (row,) in base.execute(f"select rowid from {table}")]
        value = rng.choice(CELLS)
        with contextlib.suppress(sqlite3.IntegrityError):
            base.execute(f"update {table} set {column} = ? where rowid = ?", (value, rng.choice(rows)))
    command = ("study", folder / "study.toml", "--out", folder / "out", "--no-replay", "--threads", "1", "--resume")
    return told(f"{table}.{column} = {value!r}", command, folder, called(command)[1])


def golden(seed: int, folder: Path) -> str:
    """Compare with golden results, or update them."""
    rng = random.Random(f"golden {seed}")
    name = spoilt(golden_folder(), folder, rng, lambda n: "golden" in n)
    renew = ("--update", "--reason", "the law of friction changed") if rng.random() < 0.3 else ()
    command = ("regress", folder / "suite.toml", "--out", folder / "out", "--jobs", "1", "--no-evidence", *renew)
    return told(name, command, folder, called(command)[1])


class Here(Executor):
    """An executor that runs each call at once, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """The result of the call, as a finished future."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


EXAM = ("exam", "--open", "--cases", "1", "--short", "--quick", "--only", "usual", "--seed", "3", "--out")


@contextlib.contextmanager
def cheap_exam() -> Iterator[None]:
    """Run an examination in this process: cases are drawn once, and its own runs are read but not simulated."""
    from twin.exam import mark, session
    from twin.machine.machine import load_machine
    from twin.recordings.campaign import read_campaign

    def read_only(_: object, __: object, place: Path, machine_file: str) -> dict[str, Any]:
        machine = load_machine(machine_file)
        read_campaign(place / "exam runs", machine)
        with contextlib.suppress(mark.TwinError):
            load_machine(place / "answer" / "machine.toml")
        return {"before": 2.0, "after": 1.1, "floor": 1.0, "size": 9.0}

    @contextlib.contextmanager
    def here(*_: object) -> Iterator[Executor]:
        yield Here()

    real = session.draw
    with (
        mock.patch.object(session, "processes", here), mock.patch.object(session, "draw", lambda q, *rest: _drawn(real, q, *rest)),
        mock.patch.object(mark, "_exam_gap", read_only),
    ):  # fmt: skip
        yield


_DRAWN: dict[tuple[str, str], Any] = {}


def _drawn(draw: Callable[..., Any], question: Any, machine_file: str, richness: str) -> Any:
    key = (repr(question), richness)
    if key not in _DRAWN:
        _DRAWN[key] = draw(question, machine_file, richness)
    return _DRAWN[key]


@functools.cache
def exam_folder() -> dict[str, bytes]:
    """An examination of one case, answered with the diagnosis of the small campaign under the name of another axis."""
    from twin.exam.candidate import write_answer
    from twin.machine.machine import load_machine

    said = desk_folder()["diagnosis/diagnosis.json"].replace(b'"U"', b'"X"').replace(b'"B"', b'"C"')
    rows = "".join(f"{0.004 * i:.3f},0,0\n" for i in range(50))
    runs = {
        "campaign.toml": b'machine = "any"\n[[run]]\nfile = "a.csv"\nfeedforward = "off"\n',
        "a.csv": f"time [s],X.setpoint [mm],X.position [mm]\n{rows}".encode(),
    }
    with tempfile.TemporaryDirectory(prefix="twin-fuzz-") as scratch, cheap_exam():
        out = Path(scratch)
        called((*EXAM, out))  # sealed, not answered yet
        case = out / "cases" / "0000"
        write_answer(case / "answer", load_machine(), json.loads(said))
        laid({"seconds.txt": b"12.5\n"}, case / "answer")
        laid(runs, case / "exam runs")
        code, fault = called((*EXAM, out))
        assert code < 2, fault or "refused"
        return {
            f.relative_to(out).as_posix(): f.read_bytes()
            for f in sorted(out.rglob("*"))
            if f.suffix in (".json", ".toml", ".csv", ".txt", ".sha256")
        }


def exam(seed: int, folder: Path) -> str:
    """Open an examination and score it."""
    rng = random.Random(f"exam {seed}")
    files = dict(exam_folder())
    if rng.random() < 0.5:
        del files["cases/0000/mark.json"]  # to be marked again
    name = spoilt(files, folder, rng, lambda n: n.endswith((".json", ".sha256", ".txt")))
    command = (*EXAM, folder)
    with cheap_exam():
        return told(name, command, folder, called(command)[1])


def desk(seed: int, folder: Path) -> str:
    """Request the page, files and actions of the desk. Each status must be below 500, without a traceback."""
    from twin.desk.server import Desk

    rng = random.Random(f"desk {seed}")
    name = spoilt(desk_folder(), folder, rng, lambda n: n.endswith((".json", ".html")))
    paths = ["/", *(f"/file/{quote(n)}" for n in (name, rng.choice(list(desk_folder()))))]
    paths += [
        rng.choice(
            (
                "/file/../../etc/hostname",
                "/file/%2e%2e/x",
                "/file/%00",
                "//",
                "/file/" + "x" * 5000,
                "/x?y#z",
                "/file/%ff",
                "/file//etc/hostname",
            )
        )
    ]
    error = io.StringIO()
    with contextlib.redirect_stderr(error), Desk(folder, 0, started) as served:
        thread = threading.Thread(target=served.serve_forever, args=(0.01,))
        thread.start()
        try:
            form = {
                "token": rng.choice((served.token, "x")),
                "compare": rng.choice(("run", ".", "../x")),
                "path": rng.choice(("run", "\0")),
            }
            asked = [("GET", path, "") for path in paths] + [("POST", rng.choice(("/compare", "/replay", "/x")), urlencode(form))]
            for method, path, body in asked:
                connection = http.client.HTTPConnection("127.0.0.1", served.server_address[1], timeout=30)
                try:
                    connection.request(method, path, body)
                    status = connection.getresponse().status
                except (http.client.HTTPException, OSError) as problem:
                    status = 999
                    error.write(repr(problem))
                finally:
                    connection.close()
                if status >= 500:
                    return f"{name}: desk: {method} {path}: {status}: {error.getvalue()[-1500:]}"
        finally:
            served.shutdown()
            thread.join()
    return f"{name}: desk: {error.getvalue()[-1500:]}" if error.getvalue() else ""


def started(words: Any) -> Any:
    """Stands in for a command that the desk starts."""
    return subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def all_kinds() -> dict[str, Case]:
    """All kinds of this module."""
    return {"run_folder": run, "study_folder": study, "study_cells": study_cells, "golden": golden, "exam": exam, "desk": desk}
