"""Share of each campaign's gap that remains with the true parameters and effects: a check of the physics of the effects.

    python devtools/measure_effects.py ../shared/campaigns

For each campaign with a truth.toml, per axis and signal, over all runs without the chirp (and for the chirp separately):
left = (after^2 - floor^2) / (before^2 - floor^2), where floor is the same gap on the campaign `nominal`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

import numpy as np

from twin.effects.truth import true_machine
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import read_campaign
from twin.simulation.gap import COMPARED, gap_of, predict_campaign
from twin.simulation.summary import table

RELEVANT = 1.5
"""Least factor of the gap before over the floor for a signal to count."""


def pooled_gap(machine: Machine, folder: Path) -> dict[tuple[str, str, bool], float]:
    """Pooled RMS by (axis, signal, run is the chirp)."""
    campaign = read_campaign(folder, machine)
    squares: dict[tuple[str, str, bool], list[float]] = {}
    predictions = predict_campaign(machine, campaign.runs)
    for run in campaign.runs:
        for axis, signals in gap_of(machine, run, predictions[run.name]).items():
            for signal in COMPARED:
                squares.setdefault((axis, signal, run.name == "chirp"), []).append(signals[signal].rms ** 2)
    return {key: float(np.sqrt(np.mean(values))) for key, values in squares.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaigns", type=Path)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--limit", type=float, default=0.05)
    args = parser.parse_args()
    machine = load_machine()
    floor = pooled_gap(machine, args.campaigns / "nominal")
    failed = seen = 0
    for folder in sorted(args.campaigns.iterdir()):
        if folder.name == "nominal" or not (folder / "truth.toml").is_file() or (args.only and folder.name not in args.only):
            continue
        seen += 1
        before = pooled_gap(machine, folder)
        truth = true_machine(machine, folder / "truth.toml")
        after = pooled_gap(truth, folder)
        rows = []
        for key, b in before.items():
            f = floor[key]
            if b > RELEVANT * f:
                left = max(after[key] ** 2 - f**2, 0.0) / (b**2 - f**2)
                bad = left > args.limit and not key[2]
                failed += bad
                cells = [f"{v:.4g}" for v in (b, after[key], f)]
                rows.append([key[0], key[1], "chirp" if key[2] else "runs", *cells, f"{left:.4f}", "MISSED" if bad else ""])
        effects = ", ".join(f"{e['name']} {e['axis']}" for e in truth.effects) or "no effect"
        print(f"\n{folder.name}: {effects}")
        print(table(["axis", "signal", "runs", "before", "after", "floor", "left", ""], rows))
    if not seen:
        print(f"{args.campaigns}: no campaign with a truth.toml; give another folder or another --only", file=sys.stderr)
        return 2
    print(f"\n{failed} above {args.limit}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
