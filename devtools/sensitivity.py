"""Sensitivity of the diagnosis to its thresholds: each is moved by a third, down and up, on fresh machines of the second plant.

    python -m devtools.sensitivity --out DIR [--seed 700] [--quick] [--minutes 60] [--only evidence price ...] [--write FILE.csv]
    python -m devtools.sensitivity --list

The cases are drawn into DIR/cases, four runs each: one of every stratum in `STRATA`. Integers change by at least 1. An answer counts as changed
if the verdict or a named effect differs, a size by more than 2 %, the remaining gap by more than 5 %, or a place of the gap (block, regime of
motion, what it scales with).

A first diagnosis of each case is watched (`devtools.watched`): a move that changes no comparison and enters no other calculation cannot change the
answer and is not diagnosed. The others are diagnosed in groups, all of a group moved at once; a group that changes the answer is halved until
single moves are left. So a move counts as without change if it changes nothing together with the other moves of its group; two moves that cancel
each other are not seen. With --quick all of them are quick looks, a third of the work; thresholds that only a whole diagnosis uses are then not
reached. Answers are kept in DIR/answers.json; the same command continues. After --minutes no further diagnosis begins; moves that were not made
are counted in the table.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
import contextlib
import csv
from dataclasses import dataclass, fields, replace
import io
import json
from pathlib import Path
import time
import tomllib
from typing import Any, NamedTuple

from devtools.watched import Move, watched
from twin.diagnose import diagnose
from twin.diagnose.settings import T, Thresholds
from twin.errors import TwinError
from twin.exam.draw import Case, write_campaign
from twin.exam.questions import questions_of
from twin.exam.session import draw, same_examination, sources
from twin.files import output_folder, write_whole
from twin.machine.machine import default_machine_path, load_machine
from twin.recordings.campaign import read_campaign
from twin.simulation.summary import table

STRATA = ("healthy", "usual", "a fifth", "two", "outside", "everyday")
FACTORS = (2.0 / 3.0, 4.0 / 3.0)
DEFAULT = replace(T)

SIZE, GAP = 0.02, 0.05
"""An answer counts as changed if a size or the remaining gap changes by more than these shares."""

GROUP = 6
"""Moves that are made at once at first."""

HEADER = ("threshold", "value", "unit", "cases that reach it", "moves", "cannot change", "made", "not made", "changes")


class Listed(NamedTuple):
    """One threshold as it is listed."""

    name: str
    value: float
    unit: str
    meaning: str
    provenance: str


def listed() -> Iterator[Listed]:
    """All thresholds with value, unit, meaning and provenance."""
    for f in fields(T):
        yield Listed(f.name, getattr(T, f.name), f.metadata["unit"], f.metadata["meaning"], f.metadata["provenance"])


def moved_value(name: str, factor: float) -> Any:
    """A default threshold after a move; an integer stays an integer and changes by at least 1."""
    value = getattr(DEFAULT, name)
    if not isinstance(value, int):
        return float(value * factor)
    moved = round(value * factor)
    return moved if moved != value else value + (1 if factor > 1.0 else -1)


@contextlib.contextmanager
def installed(thresholds: Thresholds) -> Iterator[None]:
    """Diagnoses inside use these thresholds."""
    vars(T).update(vars(thresholds))
    try:
        yield
    finally:
        vars(T).update(vars(DEFAULT))


def answer_of(folder: Path, thresholds: Thresholds, quick: bool) -> dict[str, Any]:
    """Compared values of a diagnosis: verdict, sizes of the named effects, remaining gap, places; the message if there is none."""
    machine = load_machine()
    try:
        with installed(thresholds):
            document = diagnose(read_campaign(folder, machine), machine, quick=quick).document()
    except TwinError as error:
        return {"verdict": f"no diagnosis: {error}", "sizes": {}, "after": 1.0, "places": []}
    sizes = {f"{e['effect']} {e['axis']}": next(iter(e["parameters"].values()))["value"] for e in document["effects"]}
    places = [" ".join(p[key] for key in ("axis", "block", "regime", "scales_with")) for p in document["where"]]
    return {"verdict": document["verdict"], "sizes": sizes, "after": document["gap"]["after"], "places": places}


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Differences of an answer from the one with the default thresholds."""
    out = [] if before["verdict"] == after["verdict"] else [f"{before['verdict']} -> {after['verdict']}"]
    if set(before["sizes"]) != set(after["sizes"]):
        out.append(f"names {', '.join(sorted(after['sizes'])) or 'nothing'}")
    for name in sorted(set(before["sizes"]) & set(after["sizes"])):
        change = after["sizes"][name] / before["sizes"][name] - 1.0
        if abs(change) > SIZE:
            out.append(f"{name} {change:+.1%}")
    if set(before["places"]) != set(after["places"]):
        out.append(f"places {' and '.join(after['places']) or 'none'}")
    if abs(after["after"] / before["after"] - 1.0) > GAP:
        out.append(f"gap {before['after']:.2f} -> {after['after']:.2f}")
    return out


@dataclass(frozen=True)
class Answers:
    """Answers of all cases, kept in a file; no diagnosis begins later than `until` [s, monotonic]."""

    folder: Path
    kept: dict[str, dict[str, Any]]
    until: float
    quick: bool = False

    def plain(self, name: str) -> dict[str, Any]:
        """The answer with the default thresholds, and which moves can change it."""
        if name not in self.kept and time.monotonic() < self.until:
            every = {(threshold.name, factor): moved_value(threshold.name, factor) for threshold in listed() for factor in FACTORS}
            thresholds, watch = watched(DEFAULT, every)
            answer = answer_of(self.folder / "cases" / name, thresholds, self.quick)
            outcomes = {key: sorted(found) for key, found in sorted(watch.outcomes.items())}
            noted = {"open": [list(m) for m in every if m in watch.open], "reached": sorted(watch.reached), "outcomes": outcomes}
            self._keep(name, {"answer": answer, **noted, "moves": {}})
        return self.kept.get(name, {"open": [], "reached": [], "outcomes": {}, "moves": {}})

    def changed(self, name: str, moves: Sequence[Move]) -> list[str] | None:
        """What these moves change together; None: not diagnosed."""
        known = self.plain(name)
        key = ", ".join(f"{threshold} x {factor:.2f}" for threshold, factor in moves)
        if key not in known["moves"] and time.monotonic() < self.until:
            thresholds = replace(DEFAULT, **{threshold: moved_value(threshold, factor) for threshold, factor in moves})
            found = changes(known["answer"], answer_of(self.folder / "cases" / name, thresholds, self.quick))
            print(f"{name}: {key}: {'; '.join(found) or '-'}", flush=True)
            self._keep(name, {**known, "moves": {**known["moves"], key: found}})
        return self.kept[name]["moves"].get(key) if name in self.kept else None

    def halved(self, name: str, moves: Sequence[Move]) -> dict[Move, list[str]]:
        """Changes by each move that was made, alone or in a group without change."""
        found = self.changed(name, moves) if moves else None
        if found is None:
            return {}
        if len(moves) == 1 or not found:
            return dict.fromkeys(moves, found)
        half = len(moves) // 2
        return {**self.halved(name, moves[:half]), **self.halved(name, moves[half:])}

    def _keep(self, name: str, entry: dict[str, Any]) -> None:
        self.kept[name] = entry
        write_whole(self.folder / "answers.json", json.dumps(self.kept, indent=1) + "\n")


def drawn(out: Path, seed: int) -> list[str]:
    """Write the cases that are not there yet; their names."""
    machine_file, names = default_machine_path(), []
    sheet = tomllib.loads(machine_file.read_text(encoding="utf-8"))
    for stratum in STRATA:
        question = questions_of(seed, 1, short=True, only=stratum)[0]
        names.append(stratum.replace(" ", "_"))
        folder = out / "cases" / names[-1]
        if not (folder / "campaign.toml").is_file():
            case = draw(question, str(machine_file), "small")
            assert isinstance(case, Case), case
            write_campaign(case, folder, sheet, runs=question.stratum.runs)
    return names


def measured(answers: Answers, names: Sequence[str], only: Sequence[str] | None) -> dict[tuple[str, Move], list[str]]:
    """Changes by every move that was made on every case."""
    made: dict[tuple[str, Move], list[str]] = {}
    for name in names:
        answers.plain(name)
    for name in names:
        # a threshold that changed another case is moved alone, the others in groups
        known = {move for (_, move), found in made.items() if found}
        for factor in FACTORS:
            moves = [(t, f) for t, f in answers.plain(name)["open"] if f == factor and (not only or t in only)]
            quiet = [m for m in moves if m not in known]
            groups = [[m] for m in moves if m in known] + [quiet[i : i + GROUP] for i in range(0, len(quiet), GROUP)]
            for group in groups:
                made |= {(name, move): found for move, found in answers.halved(name, group).items()}
    return made


def rows_of(answers: Answers, names: Sequence[str], made: Mapping[tuple[str, Move], list[str]]) -> list[list[str]]:
    """One row for each threshold, see `HEADER`."""
    rows = []
    for threshold in listed():
        cases = [(n, answers.kept[n]) for n in names if n in answers.kept]
        moves = [(n, (threshold.name, factor)) for n in names for factor in FACTORS]
        still = [(n, (t, f)) for n, known in cases for t, f in known["open"] if t == threshold.name]
        done = [move for move in still if move in made]
        cannot = len(FACTORS) * len(cases) - len(still)
        found = [f"{n} x {m[1]:.2f}: {', '.join(made[n, m])}" for n, m in done if made[n, m]]
        reached = sum(threshold.name in known["reached"] for _, known in cases)
        numbers = (reached, len(moves), cannot, len(done), len(moves) - cannot - len(done))
        rows.append([threshold.name, f"{threshold.value:g}", threshold.unit, *map(str, numbers), "; ".join(found)])
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for cases and answers")
    parser.add_argument("--seed", type=int, default=700)
    parser.add_argument("--quick", action="store_true", help="quick looks instead of whole diagnoses")
    parser.add_argument("--minutes", type=float, default=600.0, help="begin no further diagnosis after this time")
    parser.add_argument("--only", nargs="*", help="only these thresholds")
    parser.add_argument("--write", type=Path, metavar="FILE.csv", help="write the table")
    parser.add_argument("--list", action="store_true", help="print every threshold with unit, meaning and provenance")
    args = parser.parse_args()
    if args.list:
        rows = [[r.name, f"{r.value:g}", *r[2:]] for r in listed()]
        print(table(["threshold", "value", "unit", "meaning", "provenance"], rows, left=5))
        return
    if args.out is None:
        parser.error("--out is missing")
    out = output_folder(args.out)
    same_examination(out, {"seed": args.seed, "quick": args.quick, "code": sources()})
    names = drawn(out, args.seed)
    file = out / "answers.json"
    kept = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    answers = Answers(out, kept, time.monotonic() + 60.0 * args.minutes, args.quick)
    rows = rows_of(answers, names, measured(answers, names, args.only))
    print(table(list(HEADER), rows, left=3))
    changed, moves, missing = sum(bool(row[-1]) for row in rows), sum(int(row[4]) for row in rows), sum(int(row[7]) for row in rows)
    print(f"{changed} of {len(rows)} thresholds change an answer on {len(answers.kept)} cases; {missing} of {moves} moves were not made")
    if args.write:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([HEADER, *rows])
        write_whole(args.write, text.getvalue())


if __name__ == "__main__":
    main()
