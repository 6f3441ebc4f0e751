#!/usr/bin/env python3
"""Mutation test of the regression suite: changes one thing at a time in a copy of the package and runs the suite on the copy.

    python devtools/mutate.py [--stop-early] [--each-axis] [--jobs N] [--only NAME] [--cases NAME] [--json FILE]

A mutation is caught if `twin regress` exits with 1. The axis and block that most failed cases name should be the changed ones (a change
of a law has no axis). The unchanged copy must pass. `--stop-early` runs the cases with traces first, and the long ones only if all of
them pass. `--each-axis` changes eleven numbers of every axis instead of the list, with which the block finder was developed. Nothing
is written in this tree.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tempfile
import time
from typing import Any

from twin.regress.suite import read_suite

HERE = Path(__file__).resolve().parents[1]
DATA = "models/mikron_ucp710.toml"


@dataclass(frozen=True)
class Mutation:
    """Replaces the first `old` after `after` in `file`; the suite should name `axis` and one of `blocks`."""

    name: str
    file: str
    after: str
    old: str
    new: str
    axis: str = ""
    blocks: tuple[str, ...] = ()


MECHANICS = ("mechanics",)
MUTATIONS = (
    # one number of the machine file
    Mutation("X position gain 1 % up", DATA, "[axis.X.loops]", "50.0", "50.5", "X", ("position controller",)),
    Mutation("Y speed gain 1 % up", DATA, "[axis.Y.loops]", "= 4.0 ", "= 4.04 ", "Y", ("speed controller",)),
    Mutation("Z integral time 2 % up", DATA, "[axis.Z.loops]", "0.010", "0.0102", "Z", ("speed controller",)),
    Mutation("X velocity feedforward 0.2 % down", DATA, "[axis.X.loops]", "velocity_feedforward = 1.0", "velocity_feedforward = 0.998",
             "X", ("position controller",)),
    Mutation("C set point one cycle later", DATA, "[axis.C.loops]", "position_delay_s = 0.002", "position_delay_s = 0.004",
             "C", ("position controller",)),
    Mutation("X torque constant 1 % up", DATA, "[axis.X.motor]", "torque_constant_nm_per_a = 1.4", "torque_constant_nm_per_a = 1.414",
             "X", ("current loop",)),
    Mutation("X friction 2 % up", DATA, "[axis.X]", "coulomb_friction_nm = 1.8", "coulomb_friction_nm = 1.836", "X", MECHANICS),
    Mutation("A friction 2 % up", DATA, "[axis.A]", "coulomb_friction_nm = 0.50", "coulomb_friction_nm = 0.51", "A", MECHANICS),
    Mutation("X rotor inertia 1 % up", DATA, "[axis.X]", "6.8e-3", "6.868e-3", "X", MECHANICS),
    Mutation("Y moving mass 1 % up", DATA, "[axis.Y]", "1050.0", "1060.5", "Y", MECHANICS),
    Mutation("Z weighs 0.1 % more (gravity)", DATA, "", "9.81 ", "9.82 ", "Z", MECHANICS),
    # the law
    Mutation("speed controller: sign of the integral", "twin/simulation/cascade.py", "def speed_controller", "+= drives", "-= drives", "", ("speed controller",)),
    Mutation("position controller: sign of feedforward", "twin/simulation/cascade.py", "def position_controller", "+ velocity_feedforward",
             "- velocity_feedforward", "", ("position controller",)),
    Mutation("current controller: integral one part in ten slower", "twin/simulation/cascade.py", "def current_controller",
             "+= drives.current_integral_gain[a]", "+= 0.9 * drives.current_integral_gain[a]", "", ("current loop",)),
    Mutation("torque feedforward one cycle late", "twin/simulation/position_command.py", "def _evaluated", "acceleration = (now - 2.0 * before + earlier) / tp**2",
             "acceleration = np.roll((now - 2.0 * before + earlier) / tp**2, 1)", "", ("speed controller",)),
    Mutation("current set point one cycle late", "twin/simulation/loop.py", "def current_cycle", "current_setpoint = state.current_setpoint[a]",
             "current_setpoint = signals[a, X_CURRENT_SETPOINT]; signals[a, X_CURRENT_SETPOINT] = state.current_setpoint[a]", "", ("current loop",)),
    # integrator and time
    Mutation("integrator: winding by Euler", "twin/simulation/cascade.py", "def winding", "return final + away * drives.mean_decay[a]", "return final + away", "",
             ("current loop",)),
    Mutation("integrator: position half a step ahead", "twin/simulation/loop.py", "def read_mechanics", "middle - 0.5 * h * speed", "middle", "", ("transmission", "measurement")),
    # units and words
    Mutation("unit: feed of a program per 61 s", "twin/program/build.py", "per_minute", "/ 60.0", "/ 61.0", "", ("set points",)),
    Mutation("unit: half a diameter is off by 0.05 %", "twin/surface/tools.py", "def end_mill", "r = diameter / 2.0", "r = diameter / 2.001", "",
             ("cut surface",)),
    # effects
    Mutation("effect: Stribeck with another exponent", "twin/effects/contact.py", "p[0] exp", "-ratio * ratio", "-ratio", "X", MECHANICS),
    Mutation("effect: ripple of the other sign", "twin/effects/motor.py", "p[0] sin", "+= p[0] * math.sin", "-= p[0] * math.sin", "X", MECHANICS),
)  # fmt: skip


EACH_AXIS = (
    # what, table of the axis, key, times, block
    ("position gain 1 % up", ".loops", "position_gain_per_s", 1.01, "position controller"),
    ("velocity feedforward 0.5 % down", ".loops", "velocity_feedforward", 0.995, "position controller"),
    ("set point half a cycle later", ".loops", "position_delay_s", 1.5, "position controller"),
    ("speed gain 1 % up", ".loops", "speed_gain_nm_s_per_rad", 1.01, "speed controller"),
    ("integral time 2 % up", ".loops", "speed_integral_time_s", 1.02, "speed controller"),
    ("commissioned inertia 2 % up", ".commissioned", "inertia_kg_m2", 1.02, "speed controller"),
    ("current gain 5 % down", ".loops", "current_gain_v_per_a", 0.95, "current loop"),
    ("torque constant 1 % up", ".motor", "torque_constant_nm_per_a", 1.01, "current loop"),
    ("friction 2 % up", "", "coulomb_friction_nm", 1.02, "mechanics"),
    ("viscous friction 5 % up", "", "viscous_friction_nm_s_per_rad", 1.05, "mechanics"),
    ("rotor inertia 1 % up", "", "rotor_and_(?:screw|gear)_inertia_kg_m2", 1.01, "mechanics"),
)  # fmt: skip


def of_each_axis() -> tuple[Mutation, ...]:
    """EACH_AXIS on every axis of the machine file."""
    text = (HERE / DATA).read_text(encoding="utf-8")
    found = []
    for what, below, key, times, block in EACH_AXIS:
        for axis in "XYZAC":
            table = f"[axis.{axis}{below}]"
            number = re.search(rf"^({key} = )(\S+)", text[text.index(table) :], re.MULTILINE)
            if number is None:
                sys.exit(f"mutate: no {key} after {table} in {DATA}; correct the list")
            new = f"{number[1]}{float(number[2]) * times:.9g}"
            found.append(Mutation(f"{axis} {what}", DATA, table, number[0], new, axis, (block,)))
    return tuple(found)


def copied(folder: Path) -> None:
    """Copy the package with models, examples and compiled functions."""
    for name in ("twin", "models", "examples"):
        shutil.copytree(HERE / name, folder / name)


def mutated(folder: Path, mutation: Mutation) -> None:
    """Apply a mutation to the copy in a folder."""
    file = folder / mutation.file
    text = file.read_text(encoding="utf-8")
    start = text.find(mutation.after)
    at = text.find(mutation.old, max(start, 0))
    if start < 0 or at < 0:
        sys.exit(f"mutate: {mutation.name}: {mutation.old!r} after {mutation.after!r} is not in {mutation.file}; correct the list")
    file.write_text(text[:at] + mutation.new + text[at + len(mutation.old) :], encoding="utf-8")


def judged(folder: Path, passes: list[list[str]], jobs: int) -> tuple[int, dict[str, Any], str]:
    """Exit code, document and last message of the suite on a copy, from the first pass that does not exit with 0."""
    code, document, words = 0, dict[str, Any](), ""
    for i, cases in enumerate(passes):
        out = folder / f"out{i}"
        command = [sys.executable, "-m", "twin", "regress", "examples/regression", "--out", str(out), "--no-evidence", "--jobs", str(jobs)]
        command += [word for name in cases for word in ("--only", name)]
        environment = {**os.environ, "PYTHONPATH": str(folder)}
        ran = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=900, check=False)
        file = out / "regress.json"
        document = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
        code, words = ran.returncode, ran.stderr.strip().splitlines()[-1] if ran.stderr.strip() else ""
        if code != 0:
            break
    return code, document, words


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help="mutations whose name holds this (several times)")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--cases", action="append", default=[], help="only these cases of the suite (as twin regress --only)")
    which.add_argument("--stop-early", action="store_true", help="long cases only where no case with traces fails")
    parser.add_argument("--each-axis", action="store_true", help="eleven numbers of every axis instead of the list")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="cases at the same time")
    parser.add_argument("--json", help="write the results")
    args = parser.parse_args()
    passes = [args.cases]
    if args.stop_early:
        cases = read_suite(HERE / "examples/regression")
        passes = [[c.name for c in cases if (c.kind == "run") == traced] for traced in (True, False)]
    results = []
    with tempfile.TemporaryDirectory() as base:
        folder = Path(base) / "plain"
        copied(folder)
        began = time.perf_counter()
        code, document, words = judged(folder, passes, args.jobs)
        if code != 0:
            sys.exit(f"mutate: the unchanged copy does not pass (exit {code}; {words}); run twin regress first")
        print(f"unchanged copy: passes ({time.perf_counter() - began:.0f} s)", flush=True)
    print(f"{'changed':52s} failed   axis  block first in chain  cases that name it", flush=True)
    mutations = of_each_axis() if args.each_axis else MUTATIONS
    for mutation in [m for m in mutations if not args.only or any(name in m.name for name in args.only)]:
        with tempfile.TemporaryDirectory() as base:
            folder = Path(base) / "mutant"
            copied(folder)
            mutated(folder, mutation)
            began = time.perf_counter()
            code, document, words = judged(folder, passes, args.jobs)
            seconds = time.perf_counter() - began
        first = document.get("first", {"axis": "", "block": ""})
        failed = [c for c in document.get("cases", []) if c["status"] in ("failed", "error")]
        axis_right = not mutation.axis or first["axis"] == mutation.axis
        block_right = first["block"] in mutation.blocks
        alike = sum(bool(c["place"]) and c["place"]["block"] in mutation.blocks for c in failed)
        result = {"mutation": mutation.name, "caught": code == 1, "failed": len(failed), "block_named_by": alike, **first}
        named = block_right or (bool(mutation.axis) and axis_right)
        results.append({**result, "axis_right": axis_right, "block_right": block_right, "named": named, "seconds": seconds})
        if code != 1:
            verdict = f"NOT CAUGHT (exit {code}; {words})"
        else:
            shown = first["axis"] if mutation.axis else "(any)"
            wrong = " and ".join(["axis"] * (not axis_right) + ["block"] * (not block_right))
            verdict = (
                f"{len(failed):6d}   {shown or '-':5s} {first['block'] or '-':20s} {alike:6d}   {wrong + ' WRONG' if wrong else 'right'}"
            )
        print(f"{mutation.name:52s} {verdict}  ({seconds:.0f} s)", flush=True)
    if not results:
        print("mutate: no mutation has such a name; --only takes parts of their names", file=sys.stderr)
        return 2
    caught = sum(r["caught"] for r in results)
    either = sum(r["caught"] and r["named"] for r in results)
    right = sum(r["caught"] and r["axis_right"] and r["block_right"] for r in results)
    print(f"{caught} of {len(results)} caught, {either} with the right axis or block, {right} with both")
    if args.json:
        Path(args.json).write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return 0 if either >= 0.95 * len(results) else 1


if __name__ == "__main__":
    sys.exit(main())
