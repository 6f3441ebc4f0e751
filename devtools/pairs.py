"""Sealed pairs of recordings of the second plant, before and after a fault: what `twin diagnose AFTER --since BEFORE` says of them.

    python -m devtools.pairs --count 24 --seed 5100 --out FOLDER      draw, diagnose and score; prints a line for each pair

Each machine has 37 small effects that the twin does not know. One in six is healthy; a fault has its usual size or 0.3 of it. In every other pair, friction
differs from day to day. As in the command, the baseline is diagnosed first.
"""

import argparse
from dataclasses import replace
from pathlib import Path

from devtools.histories import Fault, deviation, draw_history, machine_tables, program, scaled, write_week
from twin.exam.draw import SHIPPED_MACHINE
from twin.history.since_output import diagnosed_since
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign

QUIET = ("kelvin", "scatter", "tool_kg", "workpiece_kg")
"""What differs from week to week in a history."""
FRICTION = 0.3
"""Part of the weekly differences of friction that a pair has."""


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


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--seed", type=int, default=5100)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    machine = load_machine(SHIPPED_MACHINE)
    faults, named, others, within, holding = 0, 0, 0, 0, 0
    for seed in range(args.seed, args.seed + args.count):
        before, after, fault = pair(seed, args.out / str(seed))
        then, now = (read_campaign(path, machine) for path in (before, after))
        document, _, _ = diagnosed_since(now, [then], machine, args.out / str(seed), False, 0, lambda _: None)
        found = {(e["effect"], e["axis"]): e["parameters"] for e in document["effects"]}
        print(seed, "fault", fault, "found:", document["sentence"], document["verdict"], flush=True)
        faults += fault is not None
        own = found.pop(fault[:2], None) if fault else None
        others += len(found)
        if own is None or fault is None:
            continue
        low, size, high = (deviation({key: of[which] for key, of in own.items()}) for which in ("low", "value", "high"))
        named, within = named + 1, within + (abs(abs(size / fault[2]) - 1.0) <= 0.15)
        holding += min(low, high) <= fault[2] <= max(low, high)
    print(
        f"{args.count} pairs: {named} of {faults} faults named, {within} with a size within 15 %, {holding} within their interval; "
        f"named besides: {others}"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
