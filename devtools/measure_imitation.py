"""Largest evidence for effects that are absent, on healthy machines of the second plant.

    python devtools/measure_imitation.py [--machines 20] [--seed 1000] [--signals full] [--runs short]

The machines have parameters within the tolerance and the plant's small imperfections. Prints per machine the plausible effect with the
most evidence in a group of axes over the noise there, for blocks that are cut out of the loop and for others, and the axis with the
largest remaining excess over noise. The thresholds of the diagnosis for imperfections and noticed excess must lie above these values. These
seeds are for development.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
import functools
import os
from pathlib import Path
import tempfile
import tomllib

from twin.diagnose import diagnose
from twin.diagnose.state import excess_of, expected_of, is_isolated
from twin.exam.draw import draw_case, write_campaign
from twin.exam.plant.parameters import Richness
from twin.machine.machine import default_machine_path, load_machine
from twin.recordings.campaign import read_campaign
from twin.simulation.summary import table


def imitated(seed: int, signals: str, runs: str) -> tuple[str, dict[bool, tuple[float, str]], tuple[float, str]]:
    """One healthy machine: verdict, largest (share, effect) for cut (True) and other blocks, largest (excess, axis)."""
    sheet = tomllib.loads(default_machine_path().read_text(encoding="utf-8"))
    machine = load_machine()
    case = draw_case(seed, "healthy", sheet, richness=Richness.small(), run_set=runs)
    with tempfile.TemporaryDirectory() as folder:
        write_campaign(case, Path(folder) / "campaign", sheet, runs=runs, signals=signals)
        diagnosis = diagnose(read_campaign(Path(folder) / "campaign", machine), machine, threads=1)
    most = {True: (0.0, ""), False: (0.0, "")}
    for found in diagnosis.states:
        for candidate in found.rounds[0] if found.rounds else []:
            if candidate.plausible:
                share = candidate.evidence / found.group.expected_loss
                cut = is_isolated(found.group, candidate.setting)
                most[cut] = max(most[cut], (share, f"{candidate.setting.effect.name} {candidate.setting.axis}"))
    left = max((e / expected_of(f.group, axis), axis) for f in diagnosis.states for axis, e in excess_of(f.group, f.fit).items())
    return diagnosis.verdict, most, left


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--signals", default="full", help="full, no motor position, no velocity set point, scale and current")
    parser.add_argument("--runs", default="short", help="short (four runs), all (ten), program")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    args = parser.parse_args()
    rows = []
    worst, largest = {True: 0.0, False: 0.0}, -1.0
    seeds = range(args.seed, args.seed + args.machines)
    with ProcessPoolExecutor(args.workers) as pool:
        for seed, (verdict, most, left) in zip(seeds, pool.map(functools.partial(imitated, signals=args.signals, runs=args.runs), seeds)):
            worst = {cut: max(worst[cut], most[cut][0]) for cut in worst}
            largest = max(largest, left[0])
            shares = [f"{1e3 * most[cut][0]:.2f} {most[cut][1]}" for cut in (True, False)]
            rows.append([str(seed), verdict, *shares, f"{left[0]:.2f} {left[1]}"])
            print(rows[-1], flush=True)
    print(table(["seed", "verdict", "block cut [1e-3]", "not cut [1e-3]", "left"], rows, left=5))
    print(
        f"{len(rows)} healthy machines, signals {args.signals}: at most {1e3 * worst[True]:.2f}e-3 where cut, "
        f"{1e3 * worst[False]:.2f}e-3 elsewhere; of an axis {largest:.2f} of noise left above it"
    )


if __name__ == "__main__":
    main()
