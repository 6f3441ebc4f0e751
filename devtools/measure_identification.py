"""Accuracy of the identification on machines with known parameters: recorded, drawn on a plant richer than the twin, and a measured axis.

    python devtools/measure_identification.py recorded ../shared/campaigns/healthy
    python devtools/measure_identification.py drawn --cases 30 --seed 9000 --keep out/drawn
    python devtools/measure_identification.py emps ../shared/data/emps/DATA_EMPS.mat

With --keep campaigns and scores stay in that folder: an interrupted
study continues there, and --again identifies the kept campaigns again.
recorded: campaigns with a truth.toml; for X, Y and C products with the torque constant are scored, because the data determine only these.
drawn: all parameters up to 30 % off, torque constants known to 0.1 %, feedforward weights and delays of the control also off, measuring
noise and rounding, and compliance, pre-sliding, cogging and Stribeck friction that the twin does not have (twin.exam).
Prints the cases, then medians and the coverage of the intervals.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, replace
import json
from pathlib import Path
import resource
import sys
import tempfile
import tomllib

import numpy as np

from devtools.identification_score import HEADING, Judged, judge, summary
from devtools.truth_file import truth_toml
from examples.emps.single_axis import NAMES, fit_single_axis, read_emps, refine_single_axis, residual_shapes, resimulate
from twin.effects.truth import true_machine
from twin.exam.draw import SHIPPED_MACHINE, Case, draw_case, truth_of, write_campaign
from twin.identify.identify import identify
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import read_campaign
from twin.simulation.summary import table

SPREAD = 0.3
KNOWN = 0.001


def drawn_case(seed: int) -> Case:
    """A drawn machine: parameters up to 30 % off, torque constants 0.1 %, control as commissioning may leave it."""
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


def draw(seed: int, folder: Path) -> None:
    """Draw a campaign into `folder` unless it exists."""
    if not (folder / "truth.toml").is_file():
        case = drawn_case(seed)
        write_campaign(case, folder, tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8")))
        (folder / "truth.toml").write_text(truth_toml(truth_of(case)), encoding="utf-8")


def drawn(seed: int, folder: Path) -> tuple[list[Judged], dict[str, float], list[str]]:
    """Score one drawn campaign; the tolerance of the machine file is the spread of the draw."""
    draw(seed, folder)
    machine = load_machine().with_values({"parameter_tolerance": SPREAD})
    result = identify(read_campaign(folder, machine), machine, refine=False, gaps=False, torque_constant_tolerance=KNOWN)
    return judge(result, truth_machine(machine, folder / "truth.toml")), result.seconds, [str(f) for f in result.findings]


def judged_case(seed: int, folder: Path, again: bool) -> tuple[list[Judged], str]:
    """Scores of one case and a summary line; scores in `folder` are reused unless `again`."""
    kept = folder / "judged.json"
    if again or not kept.is_file():
        judged, seconds, findings = drawn(seed, folder)
        outside = ", ".join(f"{j.axis}.{j.name}" for j in judged if not j.holds) or "-"
        told = (
            f"{seed}: {', '.join(f'{k} {v:.0f} s' for k, v in seconds.items())}; outside: {outside}; findings: {'; '.join(findings) or '-'}"
        )
        document = {"judged": [asdict(j) for j in judged], "told": told}
        kept.write_text(json.dumps(document), encoding="utf-8")
    document = json.loads(kept.read_text(encoding="utf-8"))
    return [Judged(**j) for j in document["judged"]], document["told"]


def error_text(j: Judged) -> str:
    """'error +- half interval', marked if the interval does not contain the truth."""
    factor, unit = (1e6, "us") if j.group == "delays" else (100.0, "%")
    return f"{factor * j.error:.3f} +- {factor * j.half:.3f} {unit}{'' if j.holds else '  outside'}"


def recorded(folders: Sequence[Path]) -> list[Judged]:
    """Identify recorded campaigns, print every parameter, return the scores."""
    machine, pooled = load_machine(), []
    for folder in folders:
        campaign = read_campaign(folder, machine)
        before = resource.getrusage(resource.RUSAGE_SELF)
        result = identify(campaign, machine, refine=False, gaps=False)
        after = resource.getrusage(resource.RUSAGE_SELF)
        length = sum(r.trace.time[-1] - r.trace.time[0] for r in campaign.runs)
        print(
            f"{folder.name}, {length:.0f} s of {len(campaign.runs)} runs: after {', '.join(f'{k} {v:.1f} s' for k, v in result.seconds.items())}; "
            f"processor {after.ru_utime - before.ru_utime:.1f} s user, {after.ru_stime - before.ru_stime:.1f} s system; "
            f"findings: {'; '.join(map(str, result.findings)) or 'none'}"
        )
        judged = judge(result, truth_machine(machine, folder / "truth.toml"), products=("X", "Y", "C"))
        print(table(["axis", "parameter", "error +- half interval"], [[j.axis, j.name, error_text(j)] for j in judged], left=2))
        pooled += judged
    return pooled


def emps(files: Sequence[Path]) -> int:
    """The measured axis: both routes against the published symmetric model, force errors over the filter, what the residual holds."""
    for file in files:
        record = read_emps(file)
        fit = fit_single_axis(record)
        refined = refine_single_axis(record, fit.values)
        rows = [
            [
                name,
                f"{p:g}",
                f"{v:.2f} +- {d * fit.fit.quantile:.2f}",
                f"{100 * (v / p - 1):+.2f} %",
                f"{r:.2f}",
                f"{100 * (r / p - 1):+.2f} %",
            ]
            for name, p, v, d, r in zip(NAMES, PUBLISHED, fit.values, fit.fit.deviations, refined)
        ]
        print(table(["parameter", "published", "regression", "off", "refined", "off"], rows, left=1))
        bands = ", ".join(f"{band} Hz {100 * fit_single_axis(record, band).force_error:.2f} %" for band in (30, 50, 300))
        print(f"relative force error of the regression, all columns through the same filter: {bands}")
        for name, values in (("regression", fit.values), ("refined", refined)):
            again = resimulate(record, values)
            print(
                f"re-simulated with the values of the {name}: position RMS {1e6 * again.position_rms:.2f} um, "
                f"force error {100 * again.force_error:.2f} % (below 50 Hz {100 * again.force_error_filtered:.2f} %)"
            )
        rows = [[name, f"{100 * share:.0f} %"] for name, share in residual_shapes(fit, record.period).items()]
        print(table(["residual of the regression", "share of its variance"], rows, left=1))
    return 0


PUBLISHED = (95.11, 203.5, 20.39, -3.16)
"""Symmetric model of the EMPS benchmark's authors: kg, N s/m, N, N."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("recorded", "drawn", "emps"))
    parser.add_argument("inputs", nargs="*", type=Path, metavar="CAMPAIGN or FILE")
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--seed", type=int, default=9000)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="folder for drawn campaigns and scores")
    parser.add_argument("--again", action="store_true", help="identify kept campaigns again")
    args = parser.parse_args()
    if args.what == "emps":
        return emps(args.inputs)
    pooled: list[Judged] = []
    if args.what == "recorded":
        pooled = recorded(args.inputs)
    else:
        for seed in range(args.seed, args.seed + args.cases):
            with tempfile.TemporaryDirectory() as scratch:
                judged, told = judged_case(seed, args.keep / str(seed) if args.keep else Path(scratch), args.again)
            pooled += judged
            print(told, flush=True)
    rows = summary(pooled)
    print(table(HEADING, rows))
    return int(any(row[-1] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
