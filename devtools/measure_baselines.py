"""What simpler methods say of an examination that has been opened, without the diagnosis: their score by kind of case.

python devtools/measure_baselines.py DIR [--cases 40]      the folder that `twin exam --out DIR` wrote; the first so many cases
"""

from __future__ import annotations

import argparse
from collections import Counter
import json
from pathlib import Path

from twin.diagnose.fit import no_effect
from twin.diagnose.imperfections import with_imperfections
from twin.diagnose.observe import axis_groups, observe
from twin.diagnose.state import GroupState
from twin.diagnose.tuning import tuning_of
from twin.diagnose.view import view_of
from twin.exam.baselines import baselines_of
from twin.exam.mark import marked_baseline
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import read_campaign
from twin.simulation.summary import table


def answers(campaign_folder: Path, machine: Machine) -> dict[str, dict]:
    """Answer of each method to one campaign."""
    campaign = read_campaign(campaign_folder, machine)
    views = [view_of(machine, run) for run in campaign.runs]
    found = []
    for axes in axis_groups(machine, sorted({axis for run in campaign.runs for axis in run.trace.axes})):
        group = observe(views, axes)
        if group.size:
            tuning = with_imperfections(tuning_of(group, machine, map), group, machine, group.residual, map)
            retuned = no_effect(group, tuning)
            found.append(GroupState(group, group, tuning, retuned, retuned, 1.0))
    return baselines_of(found, machine)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("exam", type=Path, metavar="DIR")
    parser.add_argument("--cases", type=int, default=40)
    args = parser.parse_args()
    machine = load_machine()
    truths = json.loads((args.exam / "truths.json").read_text(encoding="utf-8"))
    marks = {m["case"]: m for m in json.loads((args.exam / "exam.json").read_text(encoding="utf-8"))["marks"]}
    asked: Counter[str] = Counter()
    right: Counter[tuple[str, str]] = Counter()
    names: list[str] = []
    for case in sorted(marks)[: args.cases]:
        stratum, said = marks[case]["stratum"], answers(args.exam / "cases" / case / "campaign", machine)
        asked[stratum] += 1
        right[stratum, "diagnosis"] += marks[case]["first"]
        names = ["diagnosis", *said]
        for name, answer in said.items():
            right[stratum, name] += marked_baseline(truths[case], answer)["first"]
    print(table(["kind of case", "cases", *names], [[s, str(n), *(str(right[s, m]) for m in names)] for s, n in asked.items()], left=1))


if __name__ == "__main__":
    main()
