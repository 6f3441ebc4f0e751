#!/usr/bin/env python3
"""Diagnoses campaigns with known truth and scores the answers: named and missed effects, contributions, remaining gap.

python -m devtools.score_campaigns CAMPAIGN [CAMPAIGN ...]

A campaign is a folder with `truth.toml`, and `budget.json` where contributions are known. The truth is opened after the diagnosis.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import time
import tomllib
from typing import Any

import numpy as np

from twin.diagnose import diagnose
from twin.exam.mark import VISIBLE, mark_budget, what_of
from twin.files import output_folder, write_json
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign
from twin.units import ARCSEC

LEAST = 0.3
"""Least contribution that is compared, as a multiple of the noise."""

NOTHING = {"times_noise": 0.0}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("campaign", nargs="+", type=Path, help="folders with a campaign and its truth")
    parser.add_argument("--save", type=Path, metavar="DIR", help="folder for each diagnosis.json, by the campaign's name")
    args = parser.parse_args()
    machine = load_machine()
    for folder in args.campaign:
        start, worked = time.perf_counter(), time.process_time()
        document = diagnose(read_campaign(folder, machine), machine).document()
        seconds, work = time.perf_counter() - start, time.process_time() - worked
        gap = document["gap"]
        print(
            f"{folder.name}: verdict {document['verdict']}, gap {gap['before']:.2f} to {gap['after']:.2f} x noise on runs left out, "
            f"{seconds:.0f} s ({work:.0f} s of processor)",
            flush=True,
        )
        print_score(document, folder)
        if args.save:
            write_json(document, output_folder(args.save) / f"{folder.name}.json", "diagnosis")


def print_score(document: dict[str, Any], folder: Path) -> None:
    """Print named, missed and false effects, and the errors of their contributions."""
    truth = tomllib.loads((folder / "truth.toml").read_text(encoding="utf-8")).get("effect", [])
    true = {(e["name"], e["axis"]) for e in truth}
    named = [(e["effect"], e["axis"]) for e in document["effects"]]
    print(f"  named {len(named)}, of these present {sum(k in true for k in named)}, present in all {len(true)}")
    for what, keys in (("false", [k for k in named if k not in true]), ("missed", sorted(true - set(named)))):
        if keys:
            print(f"  {what}: " + ", ".join(" ".join(k) for k in keys))
    if not (folder / "budget.json").is_file():
        return
    budget = json.loads((folder / "budget.json").read_text(encoding="utf-8"))
    marks = mark_budget({"budget": budget}, document)
    print(f"  of those above {VISIBLE:g} x noise: {marks['recall'][0]} of {marks['recall'][1]}")
    known = {what_of(b): b for b in budget}
    rows = [r for r in document["budget"]["rows"] if r["kind"] == "effect" and known.get(what_of(r), NOTHING)["times_noise"] >= LEAST]
    to_si = {"um": 1e-6, "arcsec": ARCSEC}
    true = [known[what_of(r)]["true_position_rms"] for r in rows]
    errors = [abs(r["position"] * to_si[r["position_unit"]] / rms - 1.0) for r, rms in zip(rows, true) if rms > 0.0]
    if errors:
        print(f"  change of the true position by an effect: median error {100 * float(np.median(errors)):.0f} % of {len(errors)}")
    brier = np.mean([(probability - there) ** 2 for probability, there in marks["candidates"]])
    print(
        f"  order of the five largest in multiples of noise: Kendall tau {marks['order']:.2f}; largest named: {marks['largest']}; "
        f"Brier score of {len(marks['candidates'])} candidates {brier:.4f}"
    )


if __name__ == "__main__":
    main()
