"""Estimate load and friction of a ball screw actuator from a current recorded at 25 Hz without its sign.

    python examples/real/actuator/run.py normal.csv OTHER.csv ...

The files are those of the data set for fault detection of linear actuators (Cranfield University), in the form of the project RAVEN, and are not
part of this repository. At constant speed the current is

    |i| = (friction -+ load) / K         - if the load supports the motion, + if it opposes it

so half the difference of the two directions is the load, half their sum the friction, both in ampere. One trial with a known load (the first
of the first file) gives K.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from collections.abc import Sequence
import csv
from pathlib import Path
import sys
from typing import NamedTuple

import numpy as np

from twin.errors import InputError
from twin.history.change import level
from twin.simulation.summary import table

STEADY = 0.8
"""A sample is at constant speed if the set point moves faster than this share of its highest speed."""


CONFIDENCE = 0.999
"""Of the interval of a change of friction; a trial is called changed if it excludes zero."""

VERDICTS = ("no change", "friction more", "friction less")


class Trial(NamedTuple):
    """One trial: load given in the file [kgf], and currents [A] for load and friction."""

    load: float
    run: str
    by_load: float
    by_friction: float


def read_trials(path: Path) -> list[Trial]:
    """Trials of a file; InputError if it is not a file of this data set."""
    strokes: dict[tuple[float, str, str], list[tuple[float, float, float]]] = defaultdict(list)
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                key = (float(row["load"]), row["run"], row["group"])
                strokes[key].append((float(row["time"]), float(row["set_point"]), float(row["current"])))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); skipped. Give a file of the data set") from None
    except (KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: no trial of this data set ({error}); it must hold load, run, group, time, set_point, current") from None
    means: dict[tuple[float, str], list[tuple[float, float]]] = defaultdict(list)
    for (load, run, _), rows in strokes.items():
        t, s, i = np.array(rows).T
        if len(t) < 10 or np.any(np.diff(t) <= 0.0):
            continue
        speed = np.gradient(s, t)
        out, back = (sign * speed > STEADY * np.abs(speed).max() for sign in (1.0, -1.0))
        if out.sum() > 5 and back.sum() > 5:
            means[load, run].append((float(i[out].mean()), float(i[back].mean())))
    trials = []
    for (load, run), pairs in means.items():
        forth, back = np.mean(pairs, axis=0)
        trials.append(Trial(load, run, 0.5 * (back - forth), 0.5 * (back + forth)))
    if not trials:
        raise InputError(f"{path}: no stroke with constant speed in both directions; load and friction cannot be estimated")
    return trials


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("files", type=Path, nargs="+", metavar="CSV", help="files of the data set; the first one calibrates")
    args = parser.parse_args(arguments)
    try:
        trials = {path.stem: read_trials(path) for path in args.files}
    except InputError as error:
        print(f"run.py: {error}", file=sys.stderr)
        return 2
    print("\n".join(summary_lines(trials)))
    return 0


def summary_lines(trials: dict[str, list[Trial]]) -> list[str]:
    """Estimated load and friction by file and load, calibrated on one trial with a known load, and what the record cannot show."""
    first = next(iter(trials.values()))[0]
    k = first.by_load / first.load
    rows = []
    for name, several in trials.items():
        for load in sorted({t.load for t in several}):
            seen = [t for t in several if t.load == load and t is not first]
            estimates = [t.by_load / k for t in seen]
            friction = [t.by_friction for t in seen]
            if seen:
                worst = max(abs(e / load - 1.0) for e in estimates)
                rows.append(
                    [name, f"{load:g}", str(len(seen)), f"{np.mean(estimates):.1f}", f"{100 * worst:.0f} %", f"{np.mean(friction):.3f}"]
                )
    heading = ["file", "load [kgf]", "trials", "from the current [kgf]", "worst trial off by", "friction [A]"]
    return [
        f"calibrated on trial {first.run} with {first.load:g} kgf: {1e3 * k:.2f} mA/kgf",
        table(heading, rows, left=1),
        *friction_lines(trials),
        *change_lines(trials),
        "backlash, wear and stiffness cannot be seen at 25 Hz with an unsigned current: the screw crosses its backlash between two samples.",
    ]


def friction_lines(trials: dict[str, list[Trial]]) -> list[str]:
    """Friction of the other files relative to the first one at equal load, without naming a cause."""
    names = list(trials)
    out = []
    for name in names[1:]:
        parts = []
        for load in sorted({t.load for t in trials[name]}):
            here, there = ([t.by_friction for t in trials[n] if t.load == load] for n in (name, names[0]))
            if here and there:
                parts.append(f"{100 * (np.mean(here) / np.mean(there) - 1.0):+.0f} % at {load:g} kgf")
        out.append(
            f"friction of {name} against {names[0]}: {', '.join(parts)}. No cause is named: a difference at some loads only does not prove one"
        )
    return out


def change_lines(trials: dict[str, list[Trial]]) -> list[str]:
    """Every trial against the healthy ones (first file) of its load, itself left out: a table of what was said."""
    healthy, counts, sizes = next(iter(trials.values())), {name: Counter[str]() for name in trials}, defaultdict(list)
    for name, several in trials.items():
        for trial in several:
            others = [t.by_friction for t in healthy if t.load == trial.load and t is not trial]
            if len(others) < 3:
                continue
            y = np.array([*others, trial.by_friction])
            change = level(y, np.ones((len(y), 1)), len(others))
            certain = abs(change.size) > change.half(CONFIDENCE)
            said = VERDICTS[0] if not certain else VERDICTS[1 if change.size > 0.0 else 2]
            counts[name][said] += 1
            if certain:
                sizes[name, trial.load].append(100.0 * change.size / np.mean(others))
    rows = [[name, *(str(counts[name][verdict]) for verdict in VERDICTS)] for name in trials]
    found = [f"{name} at {load:g} kgf {np.mean(changes):+.0f} % ({len(changes)} trials)" for (name, load), changes in sizes.items()]
    return [
        "each trial against the healthy ones of its load, itself left out:",
        table(["trials of", *VERDICTS], rows, left=1),
        f"friction that changed for certain: {', '.join(found) or 'none'}. 'No change' means that none shows, not that there is none",
    ]


if __name__ == "__main__":
    sys.exit(main())
