"""Throughput, memory and robustness of a design study.

    python devtools/measure_study.py throughput [--seconds 20]    two threads over one; steps per second over bare mj_step on all cores
    python devtools/measure_study.py thousand [--variants 1000]   a whole `twin study` of that many 2 s moves, and its memory
    python devtools/measure_study.py against TREE [--variants 200] [--turns 4]   the same, alternating with another checkout
    python devtools/measure_study.py kills [--kills 20]           kill -9 at random moments, resume, compare with the undisturbed table

Throughput is measured in alternating turns of about a second (one thread, all threads, bare engine), and medians of their ratios are
printed, so that other loads affect all alike. The same ratios are also printed without the time in which ready threads had no core, as
counted by Linux: an estimate for idle cores. Waits of the threads for each other remain included.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import random
import resource
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
from time import perf_counter, sleep

import numpy as np
import pyarrow.parquet

from devtools.benchmark import BareEngine, moving_setpoints
from twin.machine.machine import load_machine
from twin.recordings.trace import write_trace
from twin.simulation.setpoints import trace_of
from twin.study.design import variants_of
from twin.study.evaluate import evaluate, work_of
from twin.study.spec import read_study

Rates = tuple[float, float]

EXAMPLES = Path(__file__).resolve().parent.parent / "examples" / "studies"
MOVE_S = 2.0
SPEC = """
[[run]]
input = "move.parquet"
[[factor]]
name = "X mass"
path = "axis.X.moving_mass_kg"
range = [500.0, 900.0]
[[factor]]
name = "gain"
path = "axis.*.loops.position_gain_per_s"
relative = true
range = [0.8, 1.2]
[design]
kind = "latin_hypercube"
count = {count}
"""


def write_example(folder: Path, count: int, seconds: float = MOVE_S) -> Path:
    """A study of `count` variants in which all five axes move for `seconds`."""
    machine = load_machine()
    setpoints = moving_setpoints(machine, seconds)
    write_trace(trace_of(setpoints, machine), folder / "move.parquet")
    spec = folder / "study.toml"
    spec.write_text(SPEC.format(count=count), encoding="utf-8")
    return spec


def throughput(seconds: float) -> None:
    """Variants per second on one and on all threads, and simulated steps per second against bare `mj_step`."""
    cores = len(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory() as folder:
        study = read_study(write_example(Path(folder), 4096))
        rows = iter(variants_of(study).tolist() * 100)
        work = work_of(study)
    machine = study.machine
    ticks = round(MOVE_S / machine.base_tick)
    engines = [BareEngine(machine, np.array([0.05 if a.kind == "linear" else 0.2 for a in machine.axes])) for _ in range(cores)]
    evaluate(work, tuple(next(rows)))  # compile first
    lock = threading.Lock()

    def rates(threads: int, span: float, step: Callable[[int], float]) -> Rates:
        """Steps per second of threads that repeat `step` (thread) -> steps; the second rate excludes waits for a core."""
        end = perf_counter() + span

        def worker(thread: int) -> Rates:
            begin, waited, done = perf_counter(), waited_s(), 0.0
            while perf_counter() < end:
                done += step(thread)
            took = perf_counter() - begin
            return done / took, done / (took - (waited_s() - waited))

        with ThreadPoolExecutor(threads) as pool:
            wall, own = zip(*pool.map(worker, range(threads)))
        return sum(wall), sum(own)

    def variant(_: int) -> float:
        with lock:
            row = tuple(next(rows))
        evaluate(work, row)
        return ticks

    def bare(thread: int) -> float:
        engines[thread].seconds(1600)
        return 1600

    turns = []
    begin = perf_counter()
    while perf_counter() - begin < seconds:
        turns.append([rates(1, 1.0, variant), rates(cores, 1.0, variant), rates(1, 1.0, bare), rates(cores, 1.0, bare)])
    print(f"load average {os.getloadavg()[0]:.1f} on {cores} cores; medians of {len(turns)} turns")
    for clock, words in enumerate(("by the clock", "without waits for a core")):
        one, every, bare_one, bare_every = np.array([[rate[clock] for rate in turn] for turn in turns]).T
        print(f"{words}:")
        print(
            f"  variants of a {MOVE_S:g} s move a second: {np.median(one) / ticks:.2f} on one thread, {np.median(every) / ticks:.2f} on {cores}"
        )
        print(
            f"  {cores} threads over one: {ratio_text(every / one)}; of bare mj_step, which shares nothing: {ratio_text(bare_every / bare_one)}"
        )
        print(f"  steps a second: {np.median(every):,.0f} in the study, {np.median(bare_every):,.0f} bare mj_step on {cores} threads")
        print(f"  study over bare mj_step: {ratio_text(every / bare_every)}")


def ratio_text(ratios: np.ndarray) -> str:
    """Median and range of the turns."""
    return f"{np.median(ratios):.2f} (turns: {ratios.min():.2f} to {ratios.max():.2f})"


def waited_s() -> float:
    """Time for which this thread has been ready without a core so far [s]; 0 if the system does not report it."""
    try:
        return int(Path(f"/proc/self/task/{threading.get_native_id()}/schedstat").read_text().split()[1]) * 1e-9
    except (OSError, IndexError):
        return 0.0


def thousand(variants: int) -> None:
    """Time of a whole command with `variants`, and its memory from the first tenth to the end."""
    with tempfile.TemporaryDirectory() as folder:
        spec = write_example(Path(folder), variants)
        command = [sys.executable, "-m", "twin", "study", str(spec), "--out", f"{folder}/out", "--no-replay"]
        begin, before = perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        sizes: list[tuple[float, float]] = []
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            page = resource.getpagesize()
            while process.poll() is None:
                fields = Path(f"/proc/{process.pid}/statm").read_text().split()
                if len(fields) > 1:
                    sizes.append((perf_counter() - begin, int(fields[1]) * page / 2**20))
                sleep(0.25)
            took, after = perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
            text = process.stdout.read() if process.stdout else ""
        rows = pyarrow.parquet.read_table(f"{folder}/out/table.parquet").num_rows
    print(text.splitlines()[0])
    print(f"{rows} variants of a {MOVE_S:g} s move in {took:.1f} s, load average {os.getloadavg()[0]:.1f}: the whole command")
    print(f"processor time {after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime:.1f} s")
    running = [m for t, m in sizes if 0.15 * took < t < 0.9 * took]
    print(
        f"resident memory while variants run: {min(running):.0f} to {max(running):.0f} MB; {running[-1] - running[0]:+.1f} MB from first to last"
    )


def against(tree: Path, variants: int, turns: int) -> None:
    """The same study by this code and by another checkout, in turn: processor time of all their processes, and the clock."""
    trees = {"this code": EXAMPLES.parent.parent, f"that of {tree}": tree.resolve()}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        spec, few = write_example(folder, variants), folder / "few.toml"
        few.write_text(SPEC.format(count=2), encoding="utf-8")

        def took(place: Path, study: Path, out: str) -> Rates:
            """Seconds by the clock and of processor time of one whole command."""
            begin, before = perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
            command = [sys.executable, "-m", "twin", "study", str(study), "--out", str(folder / out), "--no-replay"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=folder, env={**os.environ, "PYTHONPATH": str(place)})
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            return perf_counter() - begin, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

        for i, place in enumerate(trees.values()):
            took(place, few, f"compiled{i}")  # compile first
        found = np.array(
            [[took(place, spec, f"out{turn}_{i}") for i, place in enumerate(trees.values())] for turn in range(turns)]
        )  # (turn, tree, clock)
    print(f"{variants} variants of a {MOVE_S:g} s move, {turns} turns, load average {os.getloadavg()[0]:.1f}")
    for clock, words in enumerate(("by the clock", "processor time of all processes")):
        for i, label in enumerate(trees):
            print(f"{words}, {label}: {', '.join(f'{t:.1f}' for t in found[:, i, clock])} s")
        print(f"  this code over the other: {ratio_text(found[:, 0, clock] / found[:, 1, clock])}")


def kills(count: int, variants: int = 400) -> None:
    """Kill the command `count` times at random moments, resume each time, and compare; a finished study starts again."""
    draw = random.Random(4)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        command = [sys.executable, "-m", "twin", "study", str(write_example(folder, variants, seconds=0.4)), "--no-replay", "--out"]
        begin = perf_counter()
        subprocess.run([*command, str(folder / "whole")], check=True, stdout=subprocess.DEVNULL)
        whole = perf_counter() - begin
        begin = perf_counter()
        subprocess.run([*command, str(folder / "whole"), "--resume"], check=True, stdout=subprocess.DEVNULL)
        idle = perf_counter() - begin  # start and report, nothing to simulate
        undisturbed = pyarrow.parquet.read_table(folder / "whole" / "table.parquet")
        killed, fine = 0, True
        for study in range(count):
            out = folder / f"killed{study}"
            came, ended = [0], False
            while not ended and killed < count:
                with subprocess.Popen([*command, str(out), "--resume"], stdout=subprocess.DEVNULL) as process:
                    sleep(draw.uniform(0.3 * idle, idle + 1.5 * (whole - idle) / count))
                    ended = process.poll() is not None
                    process.send_signal(signal.SIGKILL)
                killed += not ended
                came.append(rows_in(out / "study.sqlite"))
                fine &= came[-1] >= came[-2]  # no row is lost
            subprocess.run([*command, str(out), "--resume"], check=True, stdout=subprocess.DEVNULL)
            table = pyarrow.parquet.read_table(out / "table.parquet")
            once = table.column("variant").to_pylist() == list(range(variants))
            equal = table.equals(undisturbed)
            fine &= once and equal
            print(f"study {study + 1}: variants done at each kill: {', '.join(map(str, came[1:]))}; then {variants}")
            print(f"  every variant exactly once: {once}; table equal to the undisturbed one, number by number: {equal}")
            if killed >= count:
                break
        print(f"killed -9 {killed} times, load average {os.getloadavg()[0]:.1f}: {'nothing lost, nothing twice' if fine else 'FAILED'}")
        sys.exit(not fine)


def rows_in(file: Path) -> int:
    """Variants in the database of a killed study."""
    if not file.exists():
        return 0
    store = sqlite3.connect(file)
    try:
        tables = store.execute("SELECT count(*) FROM sqlite_master WHERE name = 'variant'").fetchone()[0]
        return store.execute("SELECT count(*) FROM variant").fetchone()[0] if tables else 0
    finally:
        store.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True, dest="what")
    commands.add_parser("throughput").add_argument("--seconds", type=float, default=20.0)
    commands.add_parser("thousand").add_argument("--variants", type=int, default=1000)
    other = commands.add_parser("against")
    other.add_argument("tree", type=Path)
    other.add_argument("--variants", type=int, default=200)
    other.add_argument("--turns", type=int, default=4)
    commands.add_parser("kills").add_argument("--kills", type=int, default=20)
    args = parser.parse_args()
    if args.what == "throughput":
        throughput(args.seconds)
    elif args.what == "thousand":
        thousand(args.variants)
    elif args.what == "against":
        against(args.tree, args.variants, args.turns)
    else:
        kills(args.kills)


if __name__ == "__main__":
    main()
