"""Runs an examination: draw, seal, write campaigns, have each diagnosed by a separate process.

The truths exist only in the memory of the examining process. Their SHA-256 is published before the first diagnosis begins. The
diagnosing process gets a campaign folder and a machine file; nothing on the disk reveals more. After the last diagnosis the truths
are written (`truths.json`) and must match that hash.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
import contextlib
from dataclasses import replace
import hashlib
import json
import math
import multiprocessing
import os
from pathlib import Path
import subprocess
import sys
import time
from typing import Any

from twin.documents import read_json, read_toml
from twin.errors import InputError
from twin.files import write_whole
from twin.machine.machine import Machine, load_machine, write_machine
from twin.stopping import PARENT, end_with_parent
from twin.system import cores

from .budget import budget_of
from .candidate import DIAGNOSIS, FAILED
from .draw import Case, draw_case, runs_of, truth_of, write_campaign
from .other_machine import another_machine, with_noise_keys
from .plant.plant import PlantError
from .questions import ANOTHER, RICHNESS, Question

SEAL, TRUTHS, ASKED = "seal.sha256", "truths.json", "asked.json"


def machine_of(question: Question, machine_file: str) -> dict[str, Any]:
    """Tables of the machine file of a case: those of the examination, or another machine."""
    given = read_toml(Path(machine_file))
    return another_machine(given, question.seed, question.effect) if question.stratum.name == ANOTHER else given


def write_machine_of(question: Question, machine_file: str, folder: Path, noise_keys: str = "given") -> Path:
    """The machine file of a case, written to `folder` if it is not the examination's."""
    if question.stratum.name != ANOTHER and noise_keys == "given":
        return Path(machine_file)
    file = folder / "machine.toml"
    document = with_noise_keys(machine_of(question, machine_file), noise_keys)
    write_machine(Machine(document, load_machine(machine_file).model_path), file)
    return file


def draw(question: Question, machine_file: str, richness: str) -> Case | str:
    """The case of a question, or the reason why none can be drawn."""
    machine = machine_of(question, machine_file)
    s = question.stratum
    for attempt in range(5):  # the effect may be unstable on the drawn axis: draw another one
        try:
            case = draw_case(
                question.seed + attempt,
                s.kind,
                machine,
                effect=question.effect,
                scale=s.scale,
                richness=RICHNESS[richness],
                run_set=s.runs,
                wide=question.wide,
            )
            if s.kind != "everyday":
                return case
            return replace(case, budget=budget_of(case, machine, runs_of(machine, case.seed, s.runs)))
        except PlantError as error:
            reason = str(error)
    return reason


def truths_text(cases: dict[str, Case]) -> str:
    """All truths as one text, in a fixed order."""
    return json.dumps({name: truth_of(case) for name, case in sorted(cases.items())}, indent=1, sort_keys=True) + "\n"


def same_examination(out: Path, asked: dict[str, Any]) -> None:
    """Record the options, machine and code of an examination; an examination that was begun with others is not continued."""
    file = out / ASKED
    text = json.dumps(asked, indent=1) + "\n"
    if file.exists():
        before = read_json(file)
        other = sorted(key for key in asked if before.get(key) != asked[key])
        if other:
            raise InputError(
                f"{out}: this examination was begun with another {', '.join(other)}; repeat the first call, or give another --out"
            )
    write_whole(file, text)


def sources() -> str:
    """Digest of the twin's source files and the user's effects."""
    from twin.effects.user_files import loaded_files

    home = Path(__file__).resolve().parents[1]
    parts = [f.relative_to(home).as_posix().encode() + f.read_bytes() for f in sorted(home.rglob("*.py"))]
    return hashlib.sha256(b"\0".join([*parts, *(f.read_bytes() for f in loaded_files())])).hexdigest()[:16]


def seal(text: str, out: Path) -> str:
    """Write and return the hash of the truths; a continued examination must have the same."""
    digest = hashlib.sha256(text.encode()).hexdigest()
    file = out / SEAL
    if file.exists() and _sealed(out) != digest:
        raise InputError(f"{file}: an examination with other machines was sealed here; give another --out")
    write_whole(file, digest + "\n")
    return digest


def _sealed(out: Path) -> str:
    return (out / SEAL).read_text(encoding="utf-8", errors="replace").strip()


def unseal(text: str, out: Path) -> None:
    """Write the truths, after checking them against the seal."""
    digest = hashlib.sha256(text.encode()).hexdigest()
    if _sealed(out) != digest:
        raise InputError(f"{out / TRUTHS}: the truths are not those that were sealed; the examination is void")
    write_whole(out / TRUTHS, text)


def is_answered(folder: str) -> bool:
    """Has this case an answer: a diagnosis, or the reason why there is none?"""
    return any((Path(folder) / "answer" / name).exists() for name in (DIAGNOSIS, FAILED))


def sit(question: Question, case: Case, folder: str, machine_file: str, quick: bool, noise_keys: str = "given") -> float:
    """Write a case's campaign and have it diagnosed by another process, whose machine file has these `noise_keys`; returns the duration of the
    diagnosis [s].
    """
    place = Path(folder)
    campaign, answer = place / "campaign", place / "answer"
    if not is_answered(folder):
        machine = machine_of(question, machine_file)
        shown = write_machine_of(question, machine_file, place / "asked", noise_keys)
        try:
            if not (campaign / "campaign.toml").exists():  # written last
                write_campaign(case, campaign, machine, runs=question.stratum.runs, signals=question.stratum.signals)
        except PlantError as error:
            raise InputError(f"{folder}: the plant cannot run this campaign ({error}); draw with another --seed") from None
        command = [sys.executable, "-m", "twin.exam.candidate", str(campaign), str(shown), str(answer), *(["--quick"] if quick else [])]
        started = time.perf_counter()
        done = subprocess.run(
            command, capture_output=True, encoding="locale", errors="replace", check=False,
            env={**os.environ, "OMP_NUM_THREADS": "1", PARENT: str(os.getpid())},
        )  # fmt: skip
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        if done.returncode < 0:  # killed from outside: no answer
            raise InputError(f"{folder}: the diagnosing process was killed (signal {-done.returncode}); repeat the command to continue")
        if done.returncode:
            write_whole(answer / FAILED, reason + "\n")
            return time.perf_counter() - started
        write_whole(answer / "seconds.txt", f"{time.perf_counter() - started:.1f}\n")
    return _seconds(answer / "seconds.txt")


def _seconds(file: Path) -> float:
    """Recorded duration of a diagnosis [s]; 0 if there is none."""
    try:
        seconds = float(file.read_bytes())
    except (OSError, ValueError):
        return 0.0
    return seconds if math.isfinite(seconds) else 0.0


@contextlib.contextmanager
def processes(scheduler: str | None, workers: int | None) -> Iterator[Executor]:
    """Processes of this machine, or a Dask cluster that shares this file system."""
    if scheduler:
        from twin.study.execution import dask_cluster

        with dask_cluster(scheduler) as cluster:
            yield cluster.executor
    else:
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers or cores(), mp_context=spawn, initializer=end_with_parent) as pool:
            try:
                yield pool
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)  # running tasks end, no new ones start
                raise


def each(
    executor: Executor, function: Callable[..., Any], work: dict[str, tuple[Any, ...]], progress: Callable[[None], None]
) -> dict[str, Any]:
    """function(*arguments) of every entry, in parallel; `progress` is called after each."""
    futures = {executor.submit(function, *arguments): name for name, arguments in work.items()}
    results = {}
    for future in as_completed(futures):
        results[futures[future]] = future.result()
        progress(None)
    return {name: results[name] for name in work}
