"""Mutilated recordings all the way: import, a machine of the recording, identification, gap. No traceback, and no claim that is wrong.

    scripts/fuzz --only chain --cases 500 --seed 1

A recording made here comes from a machine whose numbers are known; a real one, from --data, has numbers that many samples agree on. A case is a
fault where a command ends in a traceback, with other exit codes than 0 and 2, with more than one line of error, writes a number that no axis can
have, or claims a position gain that the recording does not have although the mutilation leaves it what it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from devtools.fuzz_import import (
    Table,
    cells_bad,
    column_gone,
    columns_swapped,
    gap,
    noise,
    order_wrong,
    rate_changed,
    repeated,
    rows_gone,
    still,
    unit_wrong,
    write_csv,
)  # fmt: skip
from devtools.fuzz_loop import called
from twin.machine.machine import load_machine

GAIN_PER_S = 40.0
ROWS = 500
FAR = 0.1
"""A claimed gain may miss the known one by this share beside its interval."""


@dataclass(frozen=True)
class Recording:
    """Columns of one recording, how its file is written, and what is known: position gain [1/s] by axis; empty where nothing is."""

    name: str
    table: Table
    write: Callable[[Path, Table, np.random.Generator], Path]
    gains: dict[str, float]


@dataclass(frozen=True)
class Mutation:
    """What is done to a table; `keeps` says whether the known numbers are still those of the recording."""

    apply: Callable[[Table, np.random.Generator], Table]
    keeps: bool


def cut(t: Table, rng: np.random.Generator) -> Table:
    """The rows from one to another."""
    n = len(next(iter(t.values())))
    a, b = sorted(rng.integers(0, n + 1, 2))
    return {k: v[a:b] for k, v in t.items()}


def unsigned(t: Table, rng: np.random.Generator) -> Table:
    """A current, voltage or torque without its sign."""
    return {k: np.abs(v) if k.split("|")[0].lower() in ("current", "vir", "torque", "act_torque_abs_nm") else v for k, v in t.items()}


def shifted(t: Table, rng: np.random.Generator) -> Table:
    """One encoder with a zero of its own."""
    names = [k for k in t if "act_pos" in k or "ENC_POS" in k or k == "qm"]
    name = str(rng.choice(names)) if names else ""
    return {k: v + 0.3 if k == name else v for k, v in t.items()}


MUTATIONS = (
    *(Mutation(m, True) for m in (cut, cut, gap, column_gone, unsigned, shifted)),
    *(Mutation(m, False) for m in (rows_gone, columns_swapped, unit_wrong, cells_bad, rate_changed, order_wrong, repeated, still, noise)),
)


def made(rng: np.random.Generator) -> Recording:
    """One axis by its law: P position controller with delay and feedforward, a lagging speed loop, inertia and friction."""
    period = float(rng.choice([0.1e-3, 0.25e-3, 1e-3, 2e-3, 4e-3, 10e-3, 40e-3, 100e-3]))
    fine = 8
    n = int(rng.integers(2, np.clip(1.2 / period, ROWS // 2, 4 * ROWS)))
    t = np.arange(n * fine) * period / fine
    w = np.array([1.7, 4.1]) * float(np.clip(2e-3 / period, 0.1, 3.0))
    s = np.sin(np.outer(t, w)) @ np.array([30.0, 5.0])
    gain = min(GAIN_PER_S, 0.2 / period)
    x, v, h = np.empty_like(s), np.empty_like(s), period / fine
    command, at, speed, wanted = np.empty_like(s), s[0], 0.0, 0.0
    for k in range(len(s)):
        if k % fine == 0:
            slope = (s[k] - s[k - fine]) / period if k >= fine else 0.0
            wanted = gain * (s[max(k - fine, 0)] - at) + slope
        speed += (wanted - speed) * h / max(2e-3, period)
        at += speed * h
        x[k], v[k], command[k] = at, speed, wanted
    acceleration = np.gradient(v, h)
    rows = slice(None, None, fine)
    table = {
        "t": t[rows], "set_point": s[rows], "act_pos": x[rows], "act_pos_mot": x[rows] + 0.01, "cmd_vel": command[rows], "act_vel": v[rows],
        "current": (np.sign(v) + 0.01 * v + 2e-3 * acceleration)[rows] + 0.01 * rng.standard_normal(n),
    }  # fmt: skip
    keep = ["t", "set_point", *(k for k in table if k not in ("t", "set_point") and rng.random() < 0.8)]
    return Recording("made", {k: table[k] for k in keep}, write_mat if rng.random() < 0.3 else write_plain_csv, {"X": gain})


def write_edge(path: Path, t: Table, rng: np.random.Generator) -> Path:
    """The JSON of SINUMERIK Edge; rows as they come."""
    own = {k: v for k, v in t.items() if k != "CYCLE"}
    counter = np.nan_to_num(t.get("CYCLE", np.arange(len(next(iter(t.values()))))), posinf=0.0, neginf=0.0)
    counter = np.clip(counter, -1e15, 1e15)
    rows = [[int(c), *(float(v[i]) for v in own.values())] for i, c in enumerate(counter)]
    names = [{"Name": n, "Axis": ""} for n in ("CYCLE", *own)]
    document = {"Header": {"SignalListHFData": names, "CycleTimeMs": 2.0}, "Payload": [{"HFData": rows}]}
    path = path.with_suffix(".json")
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def write_plain_csv(path: Path, t: Table, rng: np.random.Generator) -> Path:
    """A CSV with commas or semicolons, sometimes with a column of words; now and then with a cell that is no number."""
    if rng.random() < 0.1:
        return write_csv(path, t, rng)
    delimiter, decimal = (";", ",") if rng.random() < 0.3 else (",", ".")
    words = ["trap"] if rng.random() < 0.3 else []
    lines = [delimiter.join([*t, *(["profile"] if words else [])])]
    lines += [delimiter.join([*(repr(float(c)).replace(".", decimal) for c in row), *words]) for row in zip(*t.values())]
    path = path.with_suffix(".csv")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_mat(path: Path, t: Table, rng: np.random.Generator) -> Path:
    """A MATLAB file of rows or columns."""
    from scipy.io import savemat

    path = path.with_suffix(".mat")
    savemat(path, {k: v.reshape((1, -1) if rng.random() < 0.5 else (-1, 1)) for k, v in t.items()})
    return path


def real(folder: Path) -> list[Recording]:
    """What recordings of real machines are beside the repository."""
    from scipy.io import loadmat

    out = []
    if (file := folder / "sinumerik" / "recording.json").is_file():
        document = json.loads(file.read_text(encoding="utf-8"))
        names = [entry["Name"] for entry in document["Header"]["SignalListHFData"]]
        rows = [row for part in document["Payload"] for row in part.get("HFData", [])]
        data = np.array([[float(c) for c in row] for row in rows if len(row) == len(names)]).T
        for axis in ("1", "2", "6"):
            wanted = [n for n in names if n == "CYCLE" or n.endswith(f"|{axis}")]
            table = {n: data[names.index(n)] for n in wanted}
            out.append(Recording(f"sinumerik {axis}", table, write_edge, {axis: 33.3333} if axis != "6" else {}))
    for file in sorted((folder / "kr300").glob("*.mat")):
        record = loadmat(file, squeeze_me=True, struct_as_record=False)["rec"]
        for a in range(3):
            table = {
                f"{n}({a + 1})": np.asarray(getattr(record, n), float)[a] for n in record._fieldnames if np.ndim(getattr(record, n)) == 2
            }
            length = len(next(iter(table.values())))
            out.append(Recording(f"kr300 {a + 1}", {"t": np.arange(length) * 4e-3, **table}, write_plain_csv, {}))
    if (file := folder / "emps" / "DATA_EMPS.mat").is_file():
        content = loadmat(file, squeeze_me=True)
        table = {n: np.asarray(content[n], float) for n in ("t", "qg", "qm", "vir")}
        out.append(Recording("emps", table, write_mat, {"X": 160.18}))
    for file in sorted((folder / "actuator").glob("*.csv")):
        lines = file.read_text(encoding="utf-8").splitlines()
        cells = [line.split(",") for line in lines]
        numeric = [i for i, c in enumerate(cells[1]) if c.replace(".", "").replace("-", "").replace("e", "").isdigit()]
        table = {cells[0][i]: np.array([float(row[i]) for row in cells[1:]]) for i in numeric}
        out.append(Recording(file.stem, table, write_plain_csv, {}))
    return out


def part_of(recording: Recording, rng: np.random.Generator) -> Recording:
    """Up to 2 ROWS of a long recording, from anywhere."""
    n = len(next(iter(recording.table.values())))
    length = int(rng.integers(2, 2 * ROWS))
    first = int(rng.integers(0, max(n - length, 1)))
    return replace(recording, table={k: v[first : first + length] for k, v in recording.table.items()})


def run_case(seed: int, folder: Path, recordings: list[Recording], no_refine: bool = False) -> tuple[str, str]:
    """(how far it came, what went wrong or "") of one mutilated recording; `no_refine`: identified by regression only."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    recording = part_of(recordings[int(rng.integers(len(recordings)))], rng) if recordings and rng.random() < 0.6 else made(rng)
    table, keeps = recording.table, True
    done = []
    for _ in range(int(rng.integers(0, 4))):
        mutation = MUTATIONS[int(rng.integers(len(MUTATIONS)))]
        if len(table) > 1 and len(next(iter(table.values()))):
            table, keeps = mutation.apply(table, rng), keeps and mutation.keeps
            done.append(mutation.apply.__name__)
    path = recording.write(folder / "run", table, rng)
    what = f"seed {seed}, {recording.name}, {' '.join(done) or 'as it is'}"
    lumped, identified, result = folder / "lumped" / "m.toml", folder / "identified" / "m.toml", folder / "result.json"
    quick = ("--no-refine",) if rng.random() < 0.6 or no_refine else ()
    steps = (
        ("import", path, "--out", folder / "runs", "--no-picture"),
        ("machine", "new", "--from-recording", folder / "runs", "--out", lumped),
        ("identify", folder / "runs", "--machine", lumped, "--out", identified, "--json", result, *quick),
        ("gap", folder / "runs", "--machine", lumped, "--json", folder / "gap.json"),
    )
    reached = "nothing"
    for step in steps:
        code, fault = called(step, allowed=("found: ",))
        if fault:
            return reached, f"{what}: twin {step[0]}: {fault}"
        if code == 2 and step[0] in ("import", "machine"):
            return reached, ""
        reached = step[0] if code == 0 else reached
    wrong = impossible_numbers(lumped, identified, result, folder / "gap.json")
    if keeps and not wrong:
        wrong = wrong_gain(recording, result)
    return reached, f"{what}: {wrong}" if wrong else ""


def impossible_numbers(lumped: Path, identified: Path, *results: Path) -> str:
    """Numbers that no axis can have: not finite, or negative where only positive ones exist."""
    for file in (lumped, identified):
        if file.is_file():
            for axis in load_machine(file).axes:
                loops = axis.loops
                listed = {
                    "inertia": axis.reflected_inertia + (axis.moving_mass_kg or 0.0), "coulomb": axis.coulomb_friction,
                    "viscous": axis.viscous_friction, "position gain": loops.position_gain_per_s, "delay": loops.position_delay_s,
                    "drive delay": loops.dsc_delay_s,
                }  # fmt: skip
                for name, value in listed.items():
                    if not math.isfinite(value) or value < 0.0:
                        return f"{file.parent.name}: axis {axis.name} has {name} {value}"
    for file in results:
        if file.is_file():
            text = file.read_text(encoding="utf-8")
            if "NaN" in text or "Infinity" in text:
                return f"{file.name} holds a number that is none"
            for entry in parameters(json.loads(text)):
                if entry.get("name") in ("inertia", "coulomb", "viscous", "position_gain_per_s") and float(entry.get("value") or 0.0) < 0.0:
                    return f"{file.name}: {entry}"
    return ""


def parameters(content: Any) -> list[dict[str, Any]]:
    """Every table with a name and a value in a JSON document."""
    if isinstance(content, dict):
        own = [content] if "name" in content and "value" in content else []
        return own + [p for value in content.values() for p in parameters(value)]
    return [p for value in content for p in parameters(value)] if isinstance(content, list) else []


def wrong_gain(recording: Recording, result: Path) -> str:
    """A position gain that is claimed, with its interval, and is not that of the recording."""
    if not result.is_file() or not recording.gains:
        return ""
    for entry in parameters(json.loads(result.read_text(encoding="utf-8"))):
        known = recording.gains.get(str(entry.get("axis")))
        if entry.get("name") != "position_gain_per_s" or known is None:
            continue
        value = float(entry["value"])
        half = 0.5 * (float(entry.get("high") or value) - float(entry.get("low") or value))
        if abs(value - known) > 3.0 * half + FAR * known:
            return f"claims a position gain of {value:.4g} +-{half:.2g} 1/s of axis {entry.get('axis')}, it is {known:.4g}"
    return ""
