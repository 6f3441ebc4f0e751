#!/usr/bin/env python3
"""Diagnoses campaigns whose truth is known and scores what was said: effects named and missed, contributions, what is left.

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
from scipy.stats import kendalltau

from twin.diagnose import diagnose
from twin.files import output_folder, write_json
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign

LARGE = 3.0
"""Contribution in multiples of noise from which an effect must be named."""

LEAST = 0.3
"""The same from which its contribution is compared."""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("campaign", nargs="+", type=Path, help="folders with a campaign and its truth")
    machine = load_machine()
    parser.add_argument("--save", type=Path, metavar="DIR", help="folder for each diagnosis.json, by the campaign's name")
    args = parser.parse_args()
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
    """Print named, missed and false effects, and what their contributions are off by."""
    truth = tomllib.loads((folder / "truth.toml").read_text(encoding="utf-8")).get("effect", [])
    true = {(e["name"], e["axis"]) for e in truth}
    named = [(e["effect"], e["axis"]) for e in document["effects"]]
    print(f"  named {len(named)}, of them there {sum(k in true for k in named)}, there in all {len(true)}")
    for what, keys in (("false", [k for k in named if k not in true]), ("missed", sorted(true - set(named)))):
        if keys:
            print(f"  {what}: " + ", ".join(" ".join(k) for k in keys))
    if not (folder / "budget.json").is_file():
        return
    known = {(b["effect"], b["axis"]): b for b in json.loads((folder / "budget.json").read_text(encoding="utf-8"))}
    rows = {(r["effect"], r["axis"]): r for r in document["budget"]["rows"] if r["kind"] == "effect"}
    large = [k for k, b in known.items() if b["times_noise"] >= LARGE]
    print(f"  of those above {LARGE:g} x noise: {sum(k in rows for k in large)} of {len(large)}")
    both = [k for k in rows if k in known and known[k]["times_noise"] >= LEAST and known[k]["true_position_rms"] > 0.0]
    to_si = {"um": 1e-6, "arcsec": np.radians(1.0 / 3600.0)}
    errors = [abs(rows[k]["position"] * to_si[rows[k]["position_unit"]] / known[k]["true_position_rms"] - 1.0) for k in both]
    if errors:
        print(f"  true position of the axis without it: off by {100 * float(np.median(errors)):.0f} % in the median of {len(errors)}")
    first = sorted(known, key=lambda k: -known[k]["times_noise"])[:5]
    tau = kendalltau([known[k]["times_noise"] for k in first], [rows[k]["times_noise"] if k in rows else 0.0 for k in first])[0]
    print(f"  order of the five largest in multiples of noise: Kendall tau {tau:.2f}; largest named: {first[0] in rows}")


if __name__ == "__main__":
    main()
