"""Measure what commands survive: Ctrl-C at any moment, kill -9 of an examination, a full disk.

    python -m devtools.measure_faults stop CAMPAIGN [--machine FILE]   Ctrl-C of `twin diagnose`, from 0.1 s after its start; with --first while
                                                                       functions are compiled for the first time
    python -m devtools.measure_faults exam [--kills 20] [--cases 2]    kill -9 of `twin exam` at random moments of each stage; resume and compare
    python -m devtools.measure_faults disk FOLDER                      commands that write to FOLDER, on a nearly full file system

For studies see `python devtools/measure_study.py kills`. Exit code 1: a promise of docs/promises.md is broken.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import random
import signal
import subprocess
import sys
import tempfile
from time import perf_counter, sleep

from devtools.measure_study import write_example

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
MOMENTS_S = (0.1, 0.2, 0.3, 0.4, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""Moments of Ctrl-C after the start of the process [s]. During the first tenth of a second Python itself, not twin, ends with a traceback."""
ENDS_IN_S = 3.0
TWIN = (sys.executable, "-m", "twin")


def stop(campaign: Path, machine: Path | None, first: bool = False) -> bool:
    """Send Ctrl-C to a diagnosis at each moment; print how long it takes to end, its exit code and its message. `first`: nothing is compiled yet."""
    fine = True
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell has background commands ignore it, also their children
    with tempfile.TemporaryDirectory() as folder:
        for moment in MOMENTS_S:
            command = [*TWIN, "diagnose", str(campaign), "--out", f"{folder}/{moment}", *(("--machine", str(machine)) if machine else ())]
            # a process group of its own, as on a terminal: all processes get the signal
            with subprocess.Popen(
                command,
                stderr=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                text=True,
                start_new_session=True,
                env={**os.environ, "TQDM_DISABLE": "1", **({"NUMBA_CACHE_DIR": f"{folder}/cache{moment}"} if first else {})},
            ) as process:
                sleep(moment)
                begin = perf_counter()
                os.killpg(process.pid, signal.SIGINT)
                _, said = process.communicate(timeout=120)
                took = perf_counter() - begin
            left = alive(process.pid)
            quiet = said.count("\n") <= 1 and "Traceback" not in said
            fine &= took < ENDS_IN_S and quiet and not left
            print(
                f"after {moment:5.2f} s: ended in {took:.2f} s, exit code {process.returncode}, {left} processes left: {said.strip() or '-'}"
            )
    print(f"load average {os.getloadavg()[0]:.1f}: {'every one within' if fine else 'FAILED'} {ENDS_IN_S:g} s, one line at most")
    return fine


def alive(group: int) -> int:
    """Number of running processes of a process group."""
    found = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        found += int(fields[2]) == group and fields[0] != "Z"
    return found


STAGES = (("", 0.5), ("cases/*/answer/diagnosis.json", 0.75), ("truths.json", 1.0))
"""Stages of an examination: the file that must exist before a kill, and the share of all kills up to the end of the stage."""
KILLED_WITHIN_S = (0.1, 8.0)
"""Range of the random delay of a kill after the start of the command, or after the file of the stage appears [s]."""


def exam(kills: int, cases: int) -> bool:
    """Kill one examination at random moments of each stage, resume it each time, let it finish and compare with an undisturbed one."""
    draw = random.Random(6)
    with tempfile.TemporaryDirectory() as name:
        out, whole = Path(name) / "killed", Path(name) / "whole"
        options = ["--seed", "6", "--short", "--quick", "--only", "healthy", "--workers", "1"]
        command = [*TWIN, "exam", *options, "--cases", str(cases), "--out"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        begin = perf_counter()
        subprocess.run([*command, str(whole)], check=False, **quiet)
        undisturbed, took = results(whole), perf_counter() - begin
        print(f"undisturbed: {cases} cases in {took:.0f} s, load average {os.getloadavg()[0]:.1f}", flush=True)
        killed, fine = 0, bool(undisturbed)
        for awaited, share in STAGES:
            while killed < round(kills * share):
                with subprocess.Popen([*command, str(out)], start_new_session=True, **quiet) as process:
                    while awaited and process.poll() is None and not any(out.glob(awaited)):
                        sleep(0.1)
                    sleep(draw.uniform(*KILLED_WITHIN_S))
                    ended = process.poll() is not None  # it finished before the kill: not counted
                    process.send_signal(signal.SIGKILL)
                killed += not ended
                sleep(1.5)  # time for the workers to notice
                left = alive(process.pid)
                fine &= not left
                there = sorted(p.name for p in out.glob("*")) if out.is_dir() else []
                print(
                    f"{'ended' if ended else f'kill {killed}'}: {left} processes left, there: {', '.join(there) or 'nothing'}", flush=True
                )
        subprocess.run([*command, str(out)], check=False, **quiet)
        same = results(out) == undisturbed
        fine &= same
        print(
            f"killed -9 {killed} times, load average {os.getloadavg()[0]:.1f}: seal, answers and marks as without a kill: {same}; "
            f"{'all is as promised' if fine else 'FAILED'}"
        )
    return fine


def results(out: Path) -> dict[str, object]:
    """Seal, score, marks and answers of an examination, without times."""
    if not (out / "exam.json").is_file():
        return {}
    document = json.loads((out / "exam.json").read_text(encoding="utf-8"))
    document.pop("seconds")
    answers = {file.parent.parent.name: file.read_text(encoding="utf-8") for file in sorted(out.glob("cases/*/answer/diagnosis.json"))}
    return {"exam": without_times(document), "answers": {name: without_times(json.loads(text)) for name, text in answers.items()}}


def without_times(content: object) -> object:
    """A document without the keys for durations and paths."""
    if isinstance(content, dict):
        return {k: without_times(v) for k, v in content.items() if not (k in ("seconds", "campaign") or str(k).endswith("_took_s"))}
    return [without_times(v) for v in content] if isinstance(content, list) else content


def disk(folder: Path) -> bool:
    """Run all commands that write much until the disk is full: each must be refused in one line, without a partial file."""
    with tempfile.TemporaryDirectory() as name:
        commands = disk_commands(folder, write_example(Path(name), 8, seconds=0.4))
        ended = [written(folder, what, arguments) for what, arguments in commands.items()]  # run all of them, even after a failure
        return all(ended)


def disk_commands(folder: Path, study: Path) -> dict[str, tuple[object, ...]]:
    """Commands by name; each fills the disk further."""
    traces, recorded = EXAMPLES / "traces", ("x_feedforward_off.csv", "x_velocity_feedforward.xml")
    return {
        "run": ("run", EXAMPLES / "x_200mm.csv", "--out", folder / "run"),
        "run, five axes": ("run", EXAMPLES / "five_axis.mpf", "--out", folder / "five"),
        "interpolate": ("interpolate", EXAMPLES / "five_axis.mpf", "--out", folder / "five.csv"),
        "replay": ("replay", EXAMPLES / "x_200mm.csv", "--out", folder / "x.rrd"),
        "import": ("import", *(traces / name for name in recorded), "--map", traces / "map.toml", "--out", folder / "import"),
        "study": ("study", study, "--out", folder / "study"),
    }  # fmt: skip


def written(folder: Path, what: str, arguments: tuple[object, ...]) -> bool:
    """Run one command and print how it ended. It must succeed or be refused in one line, without a partial file."""
    quiet = {**os.environ, "TQDM_DISABLE": "1"}
    done = subprocess.run([*TWIN, *map(str, arguments)], capture_output=True, text=True, check=False, env=quiet)
    said = [line for line in done.stderr.splitlines() if not line.startswith(("warning: ", "note: "))]
    half = [p.name for p in folder.rglob("*") if p.name.startswith(".") and p.name != ".twin-lock"]
    right = done.returncode in (0, 2) and len(said) <= 1 and not half and "Traceback" not in done.stderr
    print(f"{what}: exit code {done.returncode}, {'' if right else 'WRONG '}{' | '.join(said)[:300]}{f' left: {half}' if half else ''}")
    return right


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True, dest="what")
    stopping = commands.add_parser("stop")
    stopping.add_argument("campaign", type=Path)
    stopping.add_argument("--machine", type=Path)
    stopping.add_argument("--first", action="store_true")
    sitting = commands.add_parser("exam")
    sitting.add_argument("--kills", type=int, default=20)
    sitting.add_argument("--cases", type=int, default=2)
    commands.add_parser("disk").add_argument("folder", type=Path)
    args = parser.parse_args()
    if args.what == "stop":
        return int(not stop(args.campaign, args.machine, args.first))
    if args.what == "exam":
        return int(not exam(args.kills, args.cases))
    return int(not disk(args.folder))


if __name__ == "__main__":
    sys.exit(main())
