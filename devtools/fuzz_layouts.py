#!/usr/bin/env python3
"""One known recording, written in random layouts and imported without a map: is the proposal right, does it ask, or is it wrong without a word?

devtools/fuzz_layouts.py [--cases 200] [--seed 1] [--show]      table of outcomes; --show prints the head of each file that is not right

The twin simulates strokes of two axes; each case writes some of their signals with a random delimiter, decimal mark, heading, language, units, kind of time, order, extra
columns, blanks and pieces, as a table, in pairs, as a long table or with a time for each signal. Outcomes: `right` (all written signals of a known
meaning arrive as they were simulated), `part` (some do, none is wrong), `asked` (refused in one line, or nothing used), `said` (a unit or the interval is wrong, and the
proposal asks about it), `wrong` (a signal or the interval differs, and nothing says so), `fault` (an error that is no InputError).
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
import functools
from pathlib import Path
import sys
import tempfile

from msgspec import structs
import numpy as np

from twin.errors import InputError

Key = tuple[str, str]
PERIOD_S = 1e-3
LEAD_MM = 10.0
WITHIN = 0.02
"""Largest relative RMS difference between a signal as simulated and as imported."""
OUTCOMES = ("right", "part", "asked", "said", "wrong", "fault")
SIGNALS = ("setpoint", "position", "velocity", "current", "motor_position", "velocity_setpoint")
NAMES = {
    "English": ("{a} command position", "{a} actual position", "{a} actual velocity", "{a} current", "{a} motor position", "{a} velocity command"),
    "German": ("Lagesollwert {a}", "Lageistwert {a}", "Istdrehzahl {a}", "Momentenbildender Strom {a}", "Motorposition {a}", "Drehzahlsollwert {a}"),
    "French": ("Consigne de position {a}", "Position mesurée {a}", "Vitesse {a}", "Courant {a}", "Position moteur {a}", "Consigne de vitesse {a}"),
    "PLC": ("MAIN.Axis{n}.fSetPos", "MAIN.Axis{n}.fActPos", "MAIN.Axis{n}.fActVelo", "MAIN.Axis{n}.fActCurrent", "MAIN.Axis{n}.fMotorPos", "MAIN.Axis{n}.fSetVelo"),
    "Edge": ("DES_POS|{n}", "ENC2_POS|{n}", "ACT_VEL|{n}", "CURRENT|{n}", "ENC1_POS|{n}", "CMD_SPEED|{n}"),
    "robot": ("target_q_{n}", "actual_q_{n}", "actual_qd_{n}", "actual_current_{n}", "motor_position_{n}", "target_qd_{n}"),
}  # fmt: skip
LENGTHS = {"mm": 1e3, "m": 1.0, "um": 1e6}
SPEEDS = {"mm/s": 1e3, "m/min": 60.0, "mm/min": 60e3, "m/s": 1.0, "rev/min": 60e3 / LEAD_MM}


@dataclass(frozen=True)
class Case:
    """One file: its text, the simulated signals [SI] row by row of each piece, and what was chosen."""

    text: str
    encoding: str
    truth: tuple[dict[Key, np.ndarray], ...]
    interval_s: float | None
    choice: dict[str, str]


@functools.cache
def simulated(feedforward: str) -> dict[Key, np.ndarray]:
    """Two axes of the Mikron on strokes with rests, 3 s at 1 kHz [SI]; `feedforward`: on or off."""
    import twin
    from twin.recordings.trace import Trace

    time = np.arange(3000) * PERIOD_S
    x = 0.05 * (1.0 - np.cos(2.0 * np.pi * np.clip(time - 0.2, 0.0, 2.5) / 1.25)) * 0.5
    y = 0.02 * np.sin(2.0 * np.pi * np.clip(time - 0.4, 0.0, 2.0) / 0.8) ** 3
    setpoints = Trace(time, {("X", "setpoint"): x, ("Y", "setpoint"): y}, {"X": "linear", "Y": "linear"})
    machine = twin.load_machine().with_feedforward("velocity" if feedforward == "on" else "off")
    run = twin.simulate(machine, setpoints, noise_seed=1)
    return {(axis, signal): run.trace.get(axis, signal) for axis in "XY" for signal in SIGNALS}


def make(rng: np.random.Generator) -> Case:
    """One random layout."""

    def pick(*options: str) -> str:
        return str(rng.choice(options))

    delimiter, decimal = [(",", "."), (";", ","), (";", "."), ("\t", "."), ("\t", ","), (" ", "."), ("|", ".")][rng.integers(7)]
    choice = {
        "layout": pick("table", "table", "table", "table", "pairs", "long", "many times"),
        "names": pick(*NAMES, "unknown", "none"),
        "units": pick("brackets", "round brackets", "row", "none"),
        "time": pick("s", "ms", "us", "s unsaid", "ms unsaid", "date", "clock", "since 1970", "line", "none"),
        "pieces": pick("one", "one", "one", "two", "three with headings"),
        "extra": pick("none", "none", "unused", "words", "noise", "counter"),
        "feedforward": pick("on", "off"),
        "blanks": pick("none", "none", "none", "slow channel"),
    }
    if delimiter == " " or choice["layout"] == "pairs":
        choice["names"] = pick("PLC", "Edge", "robot", *(["unknown"] if choice["layout"] == "pairs" else ["none"]))
        choice |= {"extra": "none", "blanks": "none", "units": "none" if choice["layout"] == "pairs" else choice["units"]}
    if choice["layout"] == "pairs":
        delimiter = pick(" ", ";", "\t")
        choice["time"] = pick("line", "none")
    if choice["layout"] in ("long", "many times"):
        choice |= {"extra": "none", "blanks": "none", "pieces": "one", "time": pick("s", "ms"), "names": pick(*NAMES)}
        delimiter = ";" if delimiter == " " else delimiter
        choice["units"] = "none" if choice["layout"] == "long" else choice["units"]
    if choice["names"] == "none":
        choice |= {"units": "none", "time": pick("ms unsaid", "none")}
        choice["pieces"] = "one" if choice["pieces"].startswith("three") else choice["pieces"]
    choice["pieces"] = "one" if choice["time"] in ("none", "line") else choice["pieces"]
    if delimiter == " " and choice["time"] == "date":
        choice["time"] = "clock"
    if delimiter == " " and choice["units"] != "row":
        choice["units"] = "none"
    if delimiter == "|" and choice["names"] == "Edge":
        delimiter = ";"  # its names hold bars
    choice |= {"delimiter": repr(delimiter), "decimal": decimal}

    # signals: always a set point and a position; the unit of one signal is that of all axes
    axes = ["X"] if rng.random() < 0.7 else ["X", "Y"]
    signals = ["setpoint", "position", *[s for s in SIGNALS[2:] if rng.random() < 0.6]]
    length = pick(*LENGTHS) if choice["units"] != "none" else "mm"
    unit = dict.fromkeys(("setpoint", "position", "motor_position"), length) | {"current": "A"}
    unit["velocity"] = unit["velocity_setpoint"] = pick(*SPEEDS) if choice["units"] != "none" else pick("mm/s", "m/min", "rev/min")
    columns: dict[str, tuple[Key, str]] = {}
    for n, axis in enumerate(axes, start=1):
        for s in signals:
            template = NAMES.get(choice["names"], ("f{k}",) * 6)[SIGNALS.index(s)]
            columns[template.format(a=axis, n=n, k=len(columns) + 1)] = ((axis, s), unit[s])
    names = list(columns)
    rng.shuffle(names)

    # rows of each piece, values as written
    count = 3000
    bounds = {"one": [(0, count)], "two": [(0, 1600), (1600, count)]}.get(choice["pieces"], [(0, 1000), (1000, 2000), (2000, count)])
    truth = tuple({key: simulated(choice["feedforward"])[key][a:b] for key, _ in columns.values()} for a, b in bounds)
    factor = {**LENGTHS, **SPEEDS, "A": 1.0}
    values = {name: [part[key] * factor[u] for part in truth] for name, (key, u) in columns.items()}
    digits = {
        name: 4 if columns[name][1] in ("um", "mm/min", "rev/min") else 9 if columns[name][1] in ("m", "m/s") else 7 for name in names
    }

    def number(value: float, places: int) -> str:
        return f"{value:.{places}f}".replace(".", decimal)

    cells = {name: [[number(v, digits[name]) for v in part] for part in values[name]] for name in names}
    if choice["blanks"] == "slow channel":
        for name in names:
            if columns[name][0][1] == "current":
                cells[name] = [[c if i % 4 == 0 else "" for i, c in enumerate(part)] for part in cells[name]]
    return _written(rng, choice, names, columns, cells, truth, delimiter, decimal, number)


def _times(kind: str, count: int, number: Callable[[float, int], str]) -> tuple[str, str, list[str]]:
    """Name, unit and cells of the time column."""
    t = np.arange(count) * PERIOD_S
    stamp = np.datetime64("2025-03-04T08:21:07.250000") + np.rint(t * 1e6).astype("timedelta64[us]")
    if kind in ("s", "s unsaid"):
        return "Time", "s", [number(v, 4) for v in t]
    if kind in ("ms", "ms unsaid"):
        return "Zeit", "ms", [number(v * 1e3, 1) for v in t]
    if kind == "us":
        return "time", "us", [str(round(v * 1e6)) for v in t]
    if kind == "since 1970":
        return "timestamp", "", [str(1741076467250 + round(v * 1e3)) for v in t]
    texts = [str(s)[:23] for s in stamp]
    return "timestamp", "", texts if kind == "date" else [s[11:] for s in texts]


def _written(
    rng: np.random.Generator,
    choice: dict[str, str],
    names: list[str],
    columns: dict[str, tuple[Key, str]],
    cells: dict[str, list[list[str]]],
    truth: tuple[dict[Key, np.ndarray], ...],
    delimiter: str,
    decimal: str,
    number: Callable[[float, int], str],
) -> Case:
    """The file of a case."""
    layout, units, time_kind = choice["layout"], choice["units"], choice["time"]
    shown = {name: columns[name][1] for name in names}
    bracket = {"brackets": "{} [{}]", "round brackets": "{} ({})"}.get(units)
    lines = [f"Sampling period {number(PERIOD_S * 1e3, 3)} ms"] if time_kind == "line" else []
    if rng.random() < 0.3:
        lines = ["Recording 12", "Machine" + delimiter + "test bench", *lines]
    body: list[str] = []
    for piece in range(len(truth)):
        count = len(cells[names[0]][piece])
        table: dict[str, list[str]] = {}
        if time_kind not in ("line", "none"):
            name, unit, texts = _times(time_kind, count, number)
            said = unit and time_kind not in ("s unsaid", "ms unsaid")
            # rounded units rows leave the time to its name
            title = f"{name} [{unit}]" if said and (units != "row" or layout == "long") else name
            table[title] = texts
            shown[title] = unit if said else ""
        clock = list(table)
        for name in names:
            unit = columns[name][1]
            title = bracket.format(name, unit) if bracket else name
            table[title] = cells[name][piece]
            shown[title] = unit
        table |= _extra(rng, choice["extra"], count, number)
        titles = list(table)
        if layout == "many times":
            titles = [part for title in titles if title not in clock for part in (clock[0], title)]
        if layout == "long":
            rows = [
                delimiter.join((table[clock[0]][i], title, table[title][i])) for i in range(count) for title in titles if title not in clock
            ]
            heading = [delimiter.join((clock[0], "signal", "value"))]
        elif layout == "pairs":
            rows = [delimiter.join(f"{title}{delimiter}{table[title][i]}" for title in titles) + delimiter for i in range(count)]
            heading = []
        else:
            rows = [delimiter.join(table[title][i] for title in titles) for i in range(count)]
            plain = [title.rstrip("0") if title.startswith("Not selected") else title for title in titles]
            plain = [f'"{title}"' if delimiter in title and delimiter != " " else title for title in plain]
            heading = [] if choice["names"] == "none" else [delimiter.join(plain)]
            if units == "row" and heading:
                heading.append(delimiter.join(shown.get(title, "") or "-" for title in titles))
        if piece == 0 or choice["pieces"] == "three with headings":
            body += heading
        body += rows
    encoding = "latin-1" if rng.random() < 0.3 else "utf-8"
    return Case("\n".join([*lines, *body]) + "\n", encoding, truth, PERIOD_S, choice)


def _extra(rng: np.random.Generator, kind: str, count: int, number: Callable[[float, int], str]) -> dict[str, list[str]]:
    """Columns that are no signal of an axis."""
    if kind == "unused":
        return {"Not selected": ["0"] * count, "Not selected0": ["0"] * count}
    if kind == "words":
        return {"phase": ["move" if i > count // 2 else "rest" for i in range(count)]}
    if kind == "noise":
        return {"Temperature": [number(v, 2) for v in 21.0 + 0.02 * rng.standard_normal(count)]}
    return {"index": [str(i) for i in range(count)]} if kind == "counter" else {}


def judge(case: Case, folder: Path) -> tuple[str, str]:
    """Outcome of importing a case without a map, and why."""
    from twin.recordings.formats.by_content import read_recording
    from twin.recordings.imported import proposal_of
    from twin.recordings.mapping import read_map, runs_of
    from twin.recordings.recorded_run import run_of_recordings
    from twin.recordings.signals import ReadOptions

    file, map_file = folder / "case.log", folder / "map.toml"
    file.write_bytes(case.text.encode(case.encoding))
    try:
        found = proposal_of([file])
        found.write(map_file)
        mapping = read_map(map_file)
        ((run, paths),) = runs_of(mapping, [file])
        as_recorded = replace(mapping, settings=structs.replace(mapping.settings, skew="report", offsets="report"))
        wanted = frozenset(c.name for c in mapping.columns)
        recording = read_recording(paths[0], ReadOptions(mapping.clock, wanted, folder / "scratch", mapping.dialect))
        known = run_of_recordings(as_recorded, run, [recording])
    except InputError as error:
        return "asked", str(error)
    except Exception as error:
        return "fault", f"{type(error).__name__}: {error}"
    # what the proposal asks about is an assumption that it says; the user may overrule it
    said = "; ".join([recording.source.text] * recording.source.assumed + found.proposal.questions)
    period = known.pieces[0].period
    if case.interval_s is not None and abs(period / case.interval_s - 1.0) > WITHIN:
        return ("said" if said else "wrong"), f"interval {period * 1e3:g} ms; {said}"
    written = set(case.truth[0])
    arrived: set[Key] = set()
    for piece, truth in zip(known.pieces, case.truth):
        for (axis, signal), values in known.block(piece, 0, piece.count).items():
            # a slow channel has every fourth sample
            step = 4 if case.choice["blanks"] == "slow channel" and signal == "current" else 1
            same = [
                key for key in written if key[1] in _also(signal, case.choice["feedforward"]) and _same(values[::step], truth[key][::step])
            ]
            if not same:
                return ("said" if said else "wrong"), f"{axis}.{signal} is not what was simulated; {said}"
            arrived.add(min(same, key=lambda key: (key in arrived, key[1] != signal)))
    return ("right", "") if arrived == written else ("part", f"missing: {', '.join('.'.join(k) for k in sorted(written - arrived))}")


def _also(signal: str, feedforward: str) -> tuple[str, ...]:
    """Simulated signals that may arrive under this name without harm: numbers alone do not tell which of two encoders is which, nor, with feedforward,
    a speed from its set point."""
    speeds = ("velocity", "velocity_setpoint", "velocity_feedforward")
    if feedforward == "on" and signal in speeds:
        return speeds
    return ("position", "motor_position") if signal in ("position", "motor_position") else (signal,)


def _same(values: np.ndarray, truth: np.ndarray) -> bool:
    """True if values arrived; a piece may lack samples at its ends, where a slow channel has none."""
    count = min(len(values), len(truth))
    scale = float(np.sqrt(np.mean((truth - truth.mean()) ** 2))) or 1.0
    return count > 0.9 * len(truth) and float(np.sqrt(np.mean((values[:count] - truth[:count]) ** 2))) < WITHIN * scale


def enough(case: Case) -> str:
    """What a proposal could know the map from: names, numbers, or too little."""
    if case.choice["time"] == "none":
        return "no time"
    return "numbers" if case.choice["names"] in ("unknown", "none") else "names"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--show", action="store_true", help="print each case that is not right")
    args = parser.parse_args()
    counts: dict[str, Counter[str]] = {}
    for number in range(args.cases):
        case = make(np.random.default_rng([args.seed, number]))
        with tempfile.TemporaryDirectory(prefix="fuzz_layouts_") as folder:
            outcome, why = judge(case, Path(folder))
        counts.setdefault(enough(case), Counter())[outcome] += 1
        if outcome in ("wrong", "fault") or (args.show and outcome != "right"):
            print(f"{number}: {outcome}: {why}\n    {case.choice}")
            if args.show:
                print("    " + "\n    ".join(case.text.splitlines()[:5]))
    for kind, counted in sorted(counts.items()):
        print(f"{kind:9}", ", ".join(f"{name} {counted[name]}" for name in OUTCOMES if counted[name]), f"of {counted.total()}")
    return int(any(counted["wrong"] or counted["fault"] for counted in counts.values()))


if __name__ == "__main__":
    sys.exit(main())
