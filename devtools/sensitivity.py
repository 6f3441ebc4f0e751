"""Sensitivity of the diagnosis to its thresholds: each is varied by a third, up and down, on machines of the second plant.

    python devtools/sensitivity.py --out DIR [--cases 3] [--seed 500] [--only evidence price ...] [--full]
    python devtools/sensitivity.py --list

The cases (healthy, one effect, two effects, in turn) are drawn once into DIR/cases, four runs each. Each threshold of
`twin.diagnose.settings` is multiplied by 2/3 and by 4/3; integers change by at least 1. An answer counts as changed if the verdict or a
named effect differs, a size differs by more than 2 %, or the remaining gap by more than 5 %. Answers are stored in DIR/answers.json, so
that an interrupted run continues. One diagnosis takes about a minute on two idle cores, three minutes with `--full`; all thresholds on
three cases take a night.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
import json
from pathlib import Path
import tomllib
from typing import Any

from twin.diagnose import diagnose
from twin.diagnose.settings import DEFAULT, Thresholds, listed
from twin.exam.draw import draw_case, write_campaign
from twin.exam.plant.parameters import Richness
from twin.files import output_folder, write_json
from twin.machine.machine import default_machine_path, load_machine
from twin.recordings.campaign import read_campaign
from twin.simulation.summary import table

KINDS = ("single", "healthy", "pair")
FACTORS = (2.0 / 3.0, 4.0 / 3.0)
SIZE, GAP = 0.02, 0.05
"""Relative changes of a size and of the remaining gap above which an answer counts as changed."""


def varied(name: str, factor: float) -> Thresholds:
    """The default thresholds with one multiplied; an integer stays an integer and changes by at least 1."""
    value = getattr(DEFAULT, name)
    if isinstance(value, int):
        moved = round(value * factor)
        return replace(DEFAULT, **{name: moved if moved != value else value + (1 if factor > 1.0 else -1)})
    return replace(DEFAULT, **{name: value * factor})


def answer_of(folder: Path, thresholds: Thresholds, quick: bool) -> dict[str, Any]:
    """Compared values of a diagnosis: verdict, sizes of the named effects, remaining gap."""
    machine = load_machine()
    document = diagnose(read_campaign(folder, machine), machine, quick=quick, thresholds=thresholds).document()
    sizes = {f"{e['effect']} {e['axis']}": next(iter(e["parameters"].values()))["value"] for e in document["effects"]}
    return {"verdict": document["verdict"], "sizes": sizes, "after": document["gap"]["after"]}


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Differences of an answer from the one with the default thresholds."""
    out = [] if before["verdict"] == after["verdict"] else [f"{before['verdict']} -> {after['verdict']}"]
    if set(before["sizes"]) != set(after["sizes"]):
        out.append(f"names {', '.join(sorted(after['sizes'])) or 'nothing'}")
    for name in set(before["sizes"]) & set(after["sizes"]):
        change = after["sizes"][name] / before["sizes"][name] - 1.0
        if abs(change) > SIZE:
            out.append(f"{name} {change:+.1%}")
    if abs(after["after"] / before["after"] - 1.0) > GAP:
        out.append(f"gap {before['after']:.2f} -> {after['after']:.2f}")
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for cases and answers")
    parser.add_argument("--cases", type=int, default=3)
    parser.add_argument("--seed", type=int, default=500)
    parser.add_argument("--only", nargs="*", help="only these thresholds")
    parser.add_argument("--full", action="store_true", help="whole diagnoses, not quick ones")
    parser.add_argument("--list", action="store_true", help="print every threshold with unit, meaning and provenance")
    args = parser.parse_args()
    if args.list:
        print(
            table(
                ["threshold", "value", "unit", "meaning", "provenance"], [[r.name, f"{r.value:g}", *r[2:]] for r in listed(DEFAULT)], left=5
            )
        )
        return
    if args.out is None:
        parser.error("--out is missing")
    out = output_folder(args.out)
    sheet = tomllib.loads(default_machine_path().read_text(encoding="utf-8"))
    folders = [out / "cases" / f"{args.seed + i}" for i in range(args.cases)]
    for i, folder in enumerate(folders):
        if not (folder / "campaign.toml").is_file():
            case = draw_case(args.seed + i, KINDS[i % len(KINDS)], sheet, richness=Richness.small(), run_set="short")
            write_campaign(case, folder, sheet, runs="short")
    kept = out / "answers.json"
    answers: dict[str, dict[str, Any]] = json.loads(kept.read_text(encoding="utf-8")) if kept.is_file() else {}

    def asked(folder: Path, name: str, factor: float) -> dict[str, Any]:
        key = f"{folder.name} {name} {factor:.3f} {'full' if args.full else 'quick'}"
        if key not in answers:
            answers[key] = answer_of(folder, varied(name, factor) if name else DEFAULT, not args.full)
            write_json(answers, kept)
        return answers[key]

    rows, matter = [], 0
    for threshold in listed(DEFAULT):
        if args.only and threshold.name not in args.only:
            continue
        found = []
        for folder in folders:
            plain = asked(folder, "", 1.0)
            for factor in FACTORS:
                found += [f"{folder.name} x {factor:.2f}: {c}" for c in changes(plain, asked(folder, threshold.name, factor))]
        matter += bool(found)
        rows.append([threshold.name, f"{threshold.value:g}", "; ".join(found) or "-"])
        print(" | ".join(rows[-1]), flush=True)
    print(table(["threshold", "value", "what changes"], rows, left=3))
    print(f"{matter} of {len(rows)} thresholds change an answer on {args.cases} cases")


if __name__ == "__main__":
    main()
