"""Sealed pairs of recordings of the second plant, before and after a fault, judged by what `twin diagnose --since` uses.

    python -m devtools.pairs --count 24 --seed 5100 --out FOLDER      draw, compare and score; prints a line for each pair

Each machine has 37 small effects that the twin does not know. One in six is healthy; a fault has its usual size or 0.3 of it. In every other pair, friction
differs from day to day. The twin is the machine file without a diagnosis of the baseline.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from devtools.histories import Fault, deviation, draw_history, machine_tables, program, scaled, write_week
from twin.exam.draw import SHIPPED_MACHINE
from twin.history.since import Difference, differences
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign
from twin.system import cores

QUIET = ("kelvin", "scatter", "tool_kg", "workpiece_kg")
"""What differs from week to week in a history."""
FRICTION = 0.3
"""Part of the weekly differences of friction that a pair has."""


def size_of(one: Difference) -> float:
    """Size of a difference as a deviation from neutral; the compliance of a spring."""
    return one.size / one.direction.unit if one.direction.setting.effect.size.is_spring else one.size * one.direction.unit


def pair(seed: int, folder: Path) -> tuple[Path, Path, tuple[str, str, float] | None]:
    """A campaign before and one after, and the fault between them: effect, axis, size."""
    drawn = draw_history(seed, 6, faulty=seed % 6 != 0)
    varies = FRICTION if seed % 2 else 0.0
    drawn = replace(drawn, **{name: (0.0 if name.endswith("_kg") else varies) * getattr(drawn, name) for name in QUIET})
    share, run = (1.0, 0.3)[seed // 2 % 2], program(machine_tables(), 3.0)
    fault = Fault(scaled(drawn.fault.effect, share), 0, 0) if drawn.fault else None
    before = write_week(replace(drawn, fault=None), 0, folder / "before", run=run)
    after = write_week(replace(drawn, fault=fault), 1, folder / "after", run=run)
    return before, after, (fault.effect["name"], fault.effect["axis"], deviation(fault.effect)) if fault else None


@threadpool_limits.wrap(limits=1, user_api="blas")
def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--seed", type=int, default=5100)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    machine = load_machine(SHIPPED_MACHINE)
    faults, named, others, within = 0, 0, 0, 0
    for seed in range(args.seed, args.seed + args.count):
        before, after, fault = pair(seed, args.out / str(seed))
        then, now = (read_campaign(path, machine) for path in (before, after))
        with ThreadPoolExecutor(cores()) as pool:
            groups, _ = differences(now, [then], machine, pool.map, lambda _: None)
        found = {one.cause[:2]: size_of(one) for group in groups for one in group.found}
        print(seed, "fault", fault, "found", found, "unexplained" if any(group.is_unexplained for group in groups) else "", flush=True)
        faults += fault is not None
        own = found.pop(fault[:2], None) if fault else None
        named, others = named + (own is not None), others + len(found)
        within += own is not None and fault is not None and abs(abs(own / fault[2]) - 1.0) <= 0.15
    print(f"{args.count} pairs: {named} of {faults} faults named, {within} with a size within 15 %; named besides: {others}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
