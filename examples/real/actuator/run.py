"""A ball screw actuator at 25 Hz with a current that has no sign: its load, and what such a record cannot show.

    python examples/real/actuator/run.py normal.csv OTHER.csv ...

The files are those of the data set for fault detection of linear actuators (Cranfield University), in the form of the project RAVEN, and are not
part of this repository. On stretches of constant speed the current is

    |i| = (friction -+ load) / K         less where the load helps the motion, more where it hinders

so half the difference of both directions is the load, half the sum the friction, both in ampere. One trial of a known load (the first of the
first file) tells K.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence
import csv
from pathlib import Path
import sys
from typing import NamedTuple

import numpy as np

from twin.errors import InputError
from twin.simulation.summary import table

STEADY = 0.8
"""A sample is steady where the set point moves faster than this share of its highest speed."""


class Trial(NamedTuple):
    """One trial: its load as the file says [kgf], and the currents [A] that load and friction take."""

    load: float
    run: str
    by_load: float
    by_friction: float


def read_trials(path: Path) -> list[Trial]:
    """Trials of a file; InputError where it is none of this kind."""
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
        raise InputError(f"{path}: no stroke with constant speed in both directions; nothing can be said")
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
    """Load of every state, from the current of one trial with a known load, and what is not said."""
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
        "backlash, wear, stiffness: cannot be seen at 25 Hz with a current that has no sign; the gap of a screw closes between two samples.",
    ]


def friction_lines(trials: dict[str, list[Trial]]) -> list[str]:
    """How the friction of the other files differs from the first one's at equal load; a cause is not named."""
    names = list(trials)
    out = []
    for name in names[1:]:
        parts = []
        for load in sorted({t.load for t in trials[name]}):
            here, there = ([t.by_friction for t in trials[n] if t.load == load] for n in (name, names[0]))
            if here and there:
                parts.append(f"{100 * (np.mean(here) / np.mean(there) - 1.0):+.0f} % at {load:g} kgf")
        out.append(
            f"friction of {name} against {names[0]}: {', '.join(parts)}. What one load shows and another does not is no proof of a cause: none is named"
        )
    return out


if __name__ == "__main__":
    sys.exit(main())
