"""How well campaigns of known machines are identified: recorded ones, and drawn ones with a plant richer than the twin.

    python scripts/measure_identification.py recorded ../shared/campaigns/healthy
    python scripts/measure_identification.py drawn --cases 30 --seed 8000 --keep out/drawn

With --keep campaigns and judgements stay in that folder: an interrupted study goes on where it stopped, and --again identifies the
kept campaigns anew. Drawn: all parameters up to 30 % off, torque constants known to 0.1 %, feedforward weights and delays of the control off as well,
measuring noise and rounding, compliance, pre-sliding, cogging and Stribeck friction that the twin does not have (twin.exam).
Prints one line per case, then medians and the share of intervals that hold the truth.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
import json
from pathlib import Path
import sys
import tempfile
import time
import tomllib

import numpy as np

from twin.campaign import read_campaign
from twin.effects.truth import true_machine
from twin.exam.draw import SHIPPED_MACHINE, Case, draw_case, truth_of, truth_toml, write_campaign
from twin.identify.campaign_fit import identify_campaign
from twin.identify.judge import HEADING, Judged, judge, summary
from twin.machine import Machine, load_machine
from twin.summary import table

SPREAD = 0.3
KNOWN = 0.001


def drawn_case(seed: int) -> Case:
    """A machine of its own: everything 30 % off, torque constants 0.1 %, control off by what commissioning leaves."""
    document = tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8"))
    case = draw_case(seed, "healthy", document, spread=SPREAD)
    rng = np.random.default_rng([seed, 77])
    factors = {name: dict(values) for name, values in case.factors.items()}
    effects = []
    for axis in document["axis"]:
        factors[axis]["torque_constant"] = 1.0 + KNOWN * rng.uniform(-1.0, 1.0)
        effects += [
            {"name": "velocity_feedforward", "axis": axis, "factor": 1.0 + 0.03 * rng.uniform(-1.0, 1.0)},
            {"name": "torque_feedforward", "axis": axis, "factor": 1.0 + SPREAD * rng.uniform(-1.0, 1.0)},
            {"name": "position_gain", "axis": axis, "factor": 1.0 + 0.1 * rng.uniform(-1.0, 1.0)},
            {"name": "loop_delay", "axis": axis, "delay_s": 0.5e-3 * rng.uniform(-1.0, 1.0)},
        ]
    return replace(case, factors=factors, effects=tuple(effects))


def truth_machine(machine: Machine, truth: Path) -> Machine:
    """The true machine with the control's effects written into its loops."""
    actual = true_machine(machine, truth)
    for effect in tomllib.loads(truth.read_text(encoding="utf-8")).get("effect", []):
        loops = actual.axis(effect["axis"]).loops
        if effect["name"] == "loop_delay":
            change = {"position_delay_s": loops.position_delay_s + effect["delay_s"]}
        else:
            name = {"position_gain": "position_gain_per_s"}.get(effect["name"], effect["name"])
            change = {name: effect["factor"] * getattr(loops, name)}
        actual = actual.with_axis(effect["axis"], **change)
    return actual


def drawn(seed: int, folder: Path, refine: bool) -> tuple[list[Judged], dict[str, float], list[str]]:
    """Judge one drawn campaign, drawn into `folder` where it is not there yet; the machine file's tolerance is what it was drawn with."""
    if not (folder / "truth.toml").is_file():
        case = drawn_case(seed)
        write_campaign(case, folder, tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8")))
        (folder / "truth.toml").write_text(truth_toml(truth_of(case)), encoding="utf-8")
    machine = replace(load_machine(), parameter_tolerance=SPREAD)
    result = identify_campaign(machine, read_campaign(folder, machine), refine=refine, gaps=False, torque_constant_tolerance=KNOWN)
    return judge(result, truth_machine(machine, folder / "truth.toml"), refined=refine), result.seconds, [str(f) for f in result.findings]


def judged_case(seed: int, folder: Path, refine: bool, again: bool) -> tuple[list[Judged], str]:
    """One case and a line about it; a judgement that lies in `folder` is taken as it is unless `again`."""
    kept = folder / ("judged_refined.json" if refine else "judged.json")
    if again or not kept.is_file():
        began = time.perf_counter()
        judged, seconds, findings = drawn(seed, folder, refine)
        worst = max((j for j in judged if j.group == "inertia"), key=lambda j: abs(j.error))
        outside = ", ".join(f"{j.axis}.{j.name}" for j in judged if not j.holds)
        told = (
            f"{seed}: {time.perf_counter() - began:.0f} s, regression {seconds['regression']:.0f} s, worst inertia {worst.axis} "
            f"{100 * worst.error:.2f} %; outside: {outside or '-'}; {'; '.join(findings)}"
        )
        kept.write_text(json.dumps({"judged": [asdict(j) for j in judged], "told": told}), encoding="utf-8")
    document = json.loads(kept.read_text(encoding="utf-8"))
    return [Judged(**j) for j in document["judged"]], document["told"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("recorded", "drawn"))
    parser.add_argument("campaigns", nargs="*", type=Path)
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--seed", type=int, default=8000)
    parser.add_argument("--refine", action="store_true")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="folder that keeps drawn campaigns and judgements")
    parser.add_argument("--again", action="store_true", help="identify kept campaigns anew")
    args = parser.parse_args()
    judged: list[Judged] = []
    if args.what == "recorded":
        machine = load_machine()
        for folder in args.campaigns:
            result = identify_campaign(machine, read_campaign(folder, machine), refine=args.refine, gaps=args.refine)
            here = judge(result, truth_machine(machine, folder / "truth.toml"), products=("X", "Y", "C"), refined=args.refine)
            judged += here
            print(f"{folder.name}: {', '.join(f'{k} {v:.1f} s' for k, v in result.seconds.items())}; findings: {len(result.findings)}")
            rows = [
                [
                    j.axis,
                    j.name,
                    f"{1e6 * j.error:.3f} +- {1e6 * j.half:.3f} us"
                    if j.group == "delays"
                    else f"{100 * j.error:.3f} +- {100 * j.half:.3f} %",
                    "" if j.holds else "outside",
                ]
                for j in here
            ]
            print(table(["axis", "parameter", "error +- half interval", ""], rows, left=2))
    else:
        for seed in range(args.seed, args.seed + args.cases):
            with tempfile.TemporaryDirectory() as scratch:
                here, told = judged_case(seed, args.keep / str(seed) if args.keep else Path(scratch), args.refine, args.again)
            judged += here
            print(told, flush=True)
    rows = summary(judged)
    print(table(HEADING, rows))
    return 1 if any(row[-1] for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
