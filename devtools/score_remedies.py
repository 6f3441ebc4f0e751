#!/usr/bin/env python3
"""Examines remedies: sealed machines of the second plant are diagnosed, remedied, and run there again with the changes entered.

python -m devtools.score_remedies --seed N --cases N --out DIR [--quick] [--program RUN] [--placed] [--truth]

Each machine gets a campaign of four runs and a part program (set points only). `twin diagnose` and `twin remedy` see nothing else. Then the
seal is opened: true contour error of the tool point on the program before and after, against the predicted one; quadrant peaks of axes with a
pulse; what lead and cyclic errors behind a motor encoder still displace; machines where friction and play make most of the error. Continues
an interrupted examination; one machine after the other, on one core. `--placed` draws only lead and cyclic errors behind motor encoders.
`--truth` asks nobody: it enters the tables of the true sizes, and examines what a table can do at the feeds of the program, in minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
import json
import os
from pathlib import Path
import statistics
import subprocess
import sys
from typing import Any, NamedTuple

import numpy as np

from devtools.switched_on import switch_on
from twin.diagnose.tool_point import LOAD
from twin.effects import EFFECTS, Setting, with_effects
from twin.exam.candidate import FAILED
from twin.exam.draw import AXES, Case, draw_case, runs_of, sample_period_of, settings_for
from twin.exam.other_machine import arrangement_of
from twin.exam.plant.plant import run
from twin.exam.programme import TestRun
from twin.exam.questions import ANOTHER, RICHNESS, Question, Stratum
from twin.exam.session import machine_of, seal, sit, truths_text, unseal, write_machine_of
from twin.files import output_folder, write_whole
from twin.machine.machine import Machine, default_machine_path, load_machine
from twin.recordings.trace import Trace, write_trace
from twin.remedy.advice import TABLE
from twin.remedy.choose import candidates
from twin.remedy.predict import ToolError, tool_error
from twin.remedy.tune_change import tuned

REVERSAL = ("coulomb_friction", "stribeck", "presliding", "position_dependent_friction", "backlash")
SCREW = ("lead_error", "cyclic_error", "backlash")
PLACED = ("lead_error", "cyclic_error")


class Kind(NamedTuple):
    """Share of the machines, the effects to draw from (empty: any), and how: see `Stratum`. ANOTHER closes most loops on motor encoders."""

    share: float
    stratum: Stratum
    effects: tuple[str, ...] = ()


KINDS = (
    Kind(0.25, Stratum("friction or play", "single", 0.0, runs="short"), REVERSAL),
    Kind(0.25, Stratum(ANOTHER, "single", 0.0, runs="short"), SCREW),
    Kind(0.10, Stratum("any effect", "single", 0.0, runs="short")),
    Kind(0.15, Stratum("two", "pair", 0.0, runs="short")),
    Kind(0.10, Stratum("three", "triple", 0.0, runs="short")),
    Kind(0.15, Stratum("everyday", "everyday", 0.0, runs="short")),
)
PLACED_KINDS = (Kind(1.0, Stratum(ANOTHER, "single", 0.0, runs="short"), PLACED),)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--quick", action="store_true", help="diagnose as with 'twin diagnose --quick'")
    parser.add_argument("--program", default="program_surface", help="run of the programme on which the error is judged")
    parser.add_argument("--placed", action="store_true", help="only lead and cyclic errors behind motor encoders, in turn")
    parser.add_argument("--truth", action="store_true", help="only tables, from the true sizes in place of a diagnosis")
    parser.add_argument("--report", action="store_true", help="only print the result of what is there")
    args = parser.parse_args()
    out = output_folder(args.out.resolve())
    machine_file = str(default_machine_path())
    questions = questions_of(args.seed, args.cases, PLACED_KINDS if args.placed else KINDS)
    cases = {q.name: draw(q, machine_file) for q in questions}
    if args.truth:
        marks = [tables_of_the_truth(q, cases[q.name], load_machine(machine_file), machine_file, args.program) for q in questions]
        print("\n".join([*(f"{m['case']} {' '.join(map(str, m['placed']))}" for m in marks), "", *placed_lines(marks)]))
        return
    text = truths_text(cases)
    print(f"{len(cases)} machines sealed, SHA-256 of the truths {seal(text, out)}", flush=True)
    for q in questions:
        if args.report:
            break
        if not answered(out, q):
            candidate(q, cases[q.name], out / "cases" / q.name, machine_file, args.quick, args.program)
            print(f"{q.name} {q.stratum.name}: answered", flush=True)
    unseal(text, out)
    marks = [mark(q, cases[q.name], out / "cases" / q.name, machine_file, args.program) for q in questions if answered(out, q)]
    write_whole(out / "remedies.json", json.dumps({"seed": args.seed, "program": args.program, "marks": marks}, indent=1) + "\n")
    print("\n".join([*map(line, marks), "", *summary(marks)]))


def questions_of(seed: int, cases: int, of: Sequence[Kind]) -> list[Question]:
    """The machines to ask about, kinds and effects in turn."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 60]))
    bounds = np.cumsum([kind.share for kind in of])
    drawn = (np.arange(cases) + rng.random()) / cases % 1.0
    kinds = rng.permutation([int(np.searchsorted(bounds, u * bounds[-1])) for u in drawn])
    seeds = np.random.SeedSequence([seed, 61]).generate_state(cases)
    turns = [int(rng.integers(100)) for _ in of]
    questions = []
    for i, k in enumerate(kinds):
        kind, number = of[k], int(seeds[i])
        effect = kind.effects[turns[k] % len(kind.effects)] if kind.effects else None
        turns[k] += 1
        stratum = kind.stratum
        if stratum.name == ANOTHER:
            stratum = replace(stratum, signals=arrangement_of(number, effect)[1])
        questions.append(Question(i, stratum, number, effect))
    return questions


def draw(question: Question, machine_file: str) -> Case:
    """The machine of a question, with encoders that start at their set points."""
    machine, s = machine_of(question, machine_file), question.stratum
    case = draw_case(question.seed, s.kind, machine, effect=question.effect, richness=RICHNESS["small"], run_set=s.runs)
    return replace(case, encoder_zero="each run")


def program_of(question: Question, machine_file: str, name: str) -> TestRun:
    """The part program, set points at the sample period of the machine."""
    machine = machine_of(question, machine_file)
    [test] = [r for r in runs_of(machine, question.seed, "program") if r.name == name]
    every = round(sample_period_of(machine) / 1e-3)
    return replace(test, set_points=np.round(test.set_points[::every], 10))


def candidate(question: Question, case: Case, place: Path, machine_file: str, quick: bool, program: str) -> None:
    """Diagnose and remedy a machine, by the commands' own processes, which get campaign, machine file and program."""
    sit(question, case, str(place), machine_file, quick)
    asked, remedied = place / "asked" / "program.parquet", output_folder(place / "remedy")
    if (place / "answer" / FAILED).is_file():
        (remedied / FAILED).write_text("not diagnosed\n")
        return
    machine = load_machine(write_machine_of(question, machine_file, place / "asked"))
    test = program_of(question, machine_file, program)
    time = np.arange(len(test.set_points)) * sample_period_of(machine_of(question, machine_file))
    write_trace(Trace(time, {(a, "setpoint"): test.set_points[:, k] for k, a in enumerate(AXES)}, machine.kinds), asked)
    command = [sys.executable, "-m", "twin", "remedy", str(place / "answer"), "--program", str(asked), "--target-um", "0.1", "--out"]
    done = subprocess.run(
        [*command, str(remedied)], capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}, check=False
    )
    if done.returncode:
        (remedied / FAILED).write_text(done.stderr[-2000:])


def answered(out: Path, question: Question) -> bool:
    """True once the commands have said what to do, or have failed."""
    return any((out / "cases" / question.name / "remedy" / name).is_file() for name in ("remedy.json", FAILED))


def mark(question: Question, case: Case, place: Path, machine_file: str, program: str) -> dict[str, Any]:
    """True and predicted error of one machine, before and after."""
    said = {"case": question.name, "stratum": question.stratum.name, "true": [[e["name"], e["axis"]] for e in case.effects[:4]]}
    if (place / "remedy" / FAILED).is_file():
        return {**said, "failed": (place / "remedy" / FAILED).read_text().strip().splitlines()[-1:]}
    remedy = json.loads((place / "remedy" / "remedy.json").read_text())
    tables = machine_of(question, machine_file)
    machine = load_machine(write_machine_of(question, machine_file, place / "asked"))
    test = program_of(question, machine_file, program)
    changes = remedy["changes"]
    before = judged(case, tables, machine, test, [])
    after = judged(case, tables, machine, test, changes)
    smooth = judged(case, tables, machine, test, [], friction=False)
    placed = [e for e in case.effects if e["name"] in PLACED and e["axis"] in on_motor(machine)]
    pulsed = sorted({c["axis"] for c in changes if c["function"] == "friction_pulse"})
    return {
        **said,
        "named": [[c["effect"], c["axis"], c["function"]] for c in changes],
        "before": [1e6 * before.rms, remedy["before"]],
        "after": [1e6 * after.rms, remedy["after"]],
        "interval": [remedy["low"], remedy["high"]],
        "friction_share": max(0.0, 1.0 - (smooth.rms / before.rms) ** 2),
        "peaks": {a: [before.peaks[a], after.peaks[a]] for a in pulsed if before.peaks[a] > 0.0},
        "placed": [[e["name"], e["axis"], *(displaced(case, tables, machine, test, e, own) for own in ([], changes))] for e in placed],
    }  # fmt: skip


def tables_of_the_truth(question: Question, case: Case, given: Machine, machine_file: str, program: str) -> dict[str, Any]:
    """What lead and cyclic errors displace without and with the tables of their true sizes."""
    tables = machine_of(question, machine_file)
    machine = Machine(tables, given.model_path)
    test = program_of(question, machine_file, program)
    settings = [Setting(EFFECTS[e["name"]], e["axis"], {k: v for k, v in e.items() if k not in ("name", "axis")}) for e in case.effects]
    true = with_effects(machine, settings)
    changes = [tuned(c, true, []) for c in candidates(true)[0] if c.function == TABLE]
    entered = [{"axis": c.axis, "function": TABLE, "effect": None, "parameters": c.table(true)} for c in changes]
    placed = [e for e in case.effects if e["name"] in PLACED and e["axis"] in on_motor(machine)]
    ways: tuple[list[dict[str, Any]], ...] = ([], entered)
    found = [(e["name"], e["axis"], *(displaced(case, tables, machine, test, e, own) for own in ways)) for e in placed]
    return {"case": question.name, "placed": found}


def on_motor(machine: Machine) -> set[str]:
    return {a.name for a in machine.axes if a.encoder == "motor"}


def entered(case: Case, tables: dict[str, Any], test: TestRun, changes: Sequence[dict[str, Any]]) -> Any:
    """Settings of the plant with the changes of `remedy.json` entered in its control."""
    undone = {(c["effect"], c["axis"]) for c in changes if c["function"] == "set_back"}
    case = replace(case, effects=tuple(e for e in case.effects if (e["name"], e["axis"]) not in undone or e["name"] == "inertia"))
    settings = settings_for(case, tables, test.feedforward)
    for change in changes:
        if change["function"] != "set_back":
            switch_on(settings, change)
        elif change["effect"] == "inertia":
            settings.inertia_control[AXES.index(change["axis"])] = change["parameters"]["inertia_kg_m2"]
    return settings


def played(settings: Any, machine: Machine, test: TestRun, seed: int) -> Trace:
    """A run of the plant, in the coordinates of the machine: the encoder in the loop shows the first set point at the start."""
    found = run(settings, test.set_points, np.random.SeedSequence([seed, 62]))
    signals = {(a, name): values[:, k] for k, a in enumerate(AXES) for name, values in (("setpoint", found.setpoint), (LOAD, found.load))}
    return Trace(found.time, signals, machine.kinds)


def judged(
    case: Case, tables: dict[str, Any], machine: Machine, test: TestRun, changes: Sequence[dict[str, Any]], friction: bool = True
) -> ToolError:
    """The true error with these changes."""
    settings = entered(case, tables, test, changes)
    if not friction:
        for name in ("coulomb", "stribeck_excess", "presliding_stiffness", "gap"):
            getattr(settings, name)[:] = 0.0
    return tool_error(played(settings, machine, test, case.seed), machine)


def displaced(
    case: Case, tables: dict[str, Any], machine: Machine, test: TestRun, effect: dict, changes: Sequence[dict[str, Any]]
) -> float:
    """RMS displacement [m, rad] of an axis by one effect, which a table of the changes may take back."""
    axis = effect["axis"]
    with_it = played(entered(case, tables, test, changes), machine, test, case.seed)
    without = replace(case, effects=tuple(e for e in case.effects if e is not effect))
    others = [c for c in changes if (c["axis"], c["function"]) != (axis, "position_correction")]
    clean = played(entered(without, tables, test, others), machine, test, case.seed)
    return float(np.sqrt(np.mean((with_it.get(axis, LOAD) - clean.get(axis, LOAD)) ** 2)))


def line(m: dict[str, Any]) -> str:
    true = ", ".join(" ".join(e) for e in m["true"]) or "healthy"
    if "failed" in m:
        return f"{m['case']} {m['stratum']:<17} {true}: failed: {m['failed']}"
    (b, pb), (a, pa) = m["before"], m["after"]
    named = ", ".join(f"{function} {axis}" for _, axis, function in m["named"]) or "no change"
    return (
        f"{m['case']} {m['stratum']:<17} {true}: {b:.2f} -> {a:.2f} um ({1 - a / b:.0%}), predicted {pb:.2f} -> {pa:.2f} ({1 - pa / pb:.0%})"
        f" | friction {m['friction_share']:.0%} | {named}"
    )


def median(values: Sequence[float]) -> str:
    return f"{statistics.median(values):.0%} of {len(values)}" if values else "none"


def placed_lines(marks: Sequence[dict[str, Any]]) -> list[str]:
    """By how much lead and cyclic errors behind motor encoders displace less, together and by kind."""
    found = [(name, 1.0 - after / before) for m in marks for name, _, before, after in m["placed"]]
    return [
        f"lead and cyclic errors behind a motor encoder, median reduction of what they displace: {median([r for _, r in found])}; asked 80 %",
        *(f"  {name}: {median([r for n, r in found if n == name])}" for name in PLACED),
    ]


def summary(marks: Sequence[dict[str, Any]]) -> list[str]:
    """The result against what is asked."""
    done = [m for m in marks if "failed" not in m]
    changed = [m for m in done if m["named"]]
    reduction = lambda m, i: 1.0 - m["after"][i] / m["before"][i]  # noqa: E731
    off = [abs(reduction(m, 0) - reduction(m, 1)) for m in done]
    peaks = [1.0 - after / before for m in done for before, after in m["peaks"].values()]
    rubbing = [reduction(m, 0) for m in changed if m["friction_share"] > 0.5]
    return [
        f"{len(done)} of {len(marks)} machines answered, {len(changed)} with changes",
        f"predicted reduction within 10 points of the true one: {sum(d <= 0.1 for d in off)} of {len(off)}"
        f" (with changes {sum(abs(reduction(m, 0) - reduction(m, 1)) <= 0.1 for m in changed)} of {len(changed)}); asked 90 %",
        f"worse than before: {sum(m['after'][0] > m['before'][0] for m in changed)} of {len(changed)}"
        f" (largest increase {max((-reduction(m, 0) for m in changed), default=0.0):.1%}); asked 0",
        f"quadrant peaks of axes with a pulse, median reduction: {median(peaks)}; asked 60 %",
        *placed_lines(done),
        f"contour error where friction and play make most of it, median reduction: {median(rubbing)}; asked 50 %",
    ]


if __name__ == "__main__":
    main()
