"""Kinds of the fuzzer: corrupted recordings of a moving axis, imported (`recording`) or taken all the way to machine, identification and gap (`chain`).

The position gain is known for simulated recordings and for some of the real ones in --data. A case of `chain` is also a fault if a command writes an
impossible number, or states a wrong position gain although the mutation does not change the gain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import functools
import json
import math
from pathlib import Path
import random
from typing import Any

import numpy as np

from devtools.fuzz_loop import called
from devtools.fuzz_spoil import spoil
from tests.builders.recorded_files import write_mdf as mdf_file
from tests.builders.recorded_files import write_tdms as tdms_file
from twin.machine.machine import load_machine

Table = dict[str, np.ndarray]
"""Columns by name."""
GAIN_PER_S = 40.0
ROWS = 500
FAR = 0.1
"""A stated gain may differ from the known one by its interval and this share."""


@dataclass(frozen=True)
class Recording:
    """Columns of a recording, the writer of its file, and the known position gains [1/s] by axis."""

    name: str
    table: Table
    write: Callable[[Path, Table, np.random.Generator], Path]
    gains: dict[str, float]


@dataclass(frozen=True)
class Mutation:
    """A change of a table; `keeps`: the known gains still hold."""

    apply: Callable[[Table, np.random.Generator], Table]
    keeps: bool


def rows_gone(t: Table, rng: np.random.Generator) -> Table:
    n = len(next(iter(t.values())))
    keep = np.sort(rng.choice(n, size=int(rng.integers(0, n)), replace=False))
    return {k: v[keep] for k, v in t.items()}


def gap(t: Table, rng: np.random.Generator) -> Table:
    n = len(next(iter(t.values())))
    a, b = sorted(rng.integers(0, n, 2))
    return {k: np.concatenate([v[:a], v[b:]]) for k, v in t.items()}


def column_gone(t: Table, rng: np.random.Generator) -> Table:
    gone = rng.choice(list(t))
    return {k: v for k, v in t.items() if k != gone}


def columns_swapped(t: Table, rng: np.random.Generator) -> Table:
    a, b = rng.choice(list(t), 2)
    return {**t, a: t[b], b: t[a]}


def unit_wrong(t: Table, rng: np.random.Generator) -> Table:
    name = rng.choice(list(t))
    return {**t, name: t[name] * float(rng.choice([1e3, 1e-3, -1.0, 60.0, 0.0, 57.3, 1e12, 1e-12]))}


def cells_bad(t: Table, rng: np.random.Generator) -> Table:
    name = rng.choice(list(t))
    values = t[name].astype(float).copy()
    if len(values):
        values[rng.integers(0, len(values), 3)] = float(rng.choice([np.nan, np.inf, -np.inf, 1e300, 1e16]))
    return {**t, name: values}


def rate_changed(t: Table, rng: np.random.Generator) -> Table:
    n = len(next(iter(t.values())))
    every = int(rng.integers(2, 9))
    half = n // 2 if rng.random() < 0.5 else 0
    return {k: np.concatenate([v[:half], v[half:][::every]]) for k, v in t.items()}


def order_wrong(t: Table, rng: np.random.Generator) -> Table:
    n = len(next(iter(t.values())))
    order = rng.permutation(n) if rng.random() < 0.5 else np.arange(n)[::-1]
    return {k: v[order] for k, v in t.items()}


def repeated(t: Table, rng: np.random.Generator) -> Table:
    times = int(rng.integers(2, 4))
    return {k: np.tile(v, times) for k, v in t.items()}


def still(t: Table, rng: np.random.Generator) -> Table:
    name = rng.choice(list(t))
    return {**t, name: np.full_like(t[name], float(rng.choice([0.0, 1.0, -7.0])), dtype=float)}


def noise(t: Table, rng: np.random.Generator) -> Table:
    name = rng.choice(list(t))
    return {**t, name: rng.standard_normal(len(t[name])) * float(rng.choice([1e-9, 1.0, 1e9]))}


def cut(t: Table, rng: np.random.Generator) -> Table:
    """Keep a range of rows."""
    n = len(next(iter(t.values())))
    a, b = sorted(rng.integers(0, n + 1, 2))
    return {k: v[a:b] for k, v in t.items()}


def unsigned(t: Table, rng: np.random.Generator) -> Table:
    """Drop the sign of currents, voltages and torques."""
    return {k: np.abs(v) if k.split("|")[0].lower() in ("current", "vir", "torque", "act_torque_abs_nm") else v for k, v in t.items()}


def shifted(t: Table, rng: np.random.Generator) -> Table:
    """Shift the zero of one encoder."""
    names = [k for k in t if "act_pos" in k or "ENC_POS" in k or k == "qm"]
    name = str(rng.choice(names)) if names else ""
    return {k: v + 0.3 if k == name else v for k, v in t.items()}


MUTATIONS = (
    *(Mutation(m, True) for m in (cut, cut, gap, column_gone, unsigned, shifted)),
    *(Mutation(m, False) for m in (rows_gone, columns_swapped, unit_wrong, cells_bad, rate_changed, order_wrong, repeated, still, noise)),
)


def made(rng: np.random.Generator) -> Recording:
    """Simulate one axis: P position controller with delay and feedforward, a lagging speed loop, inertia and friction."""
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
    return Recording("made", {k: table[k] for k in keep}, write_mat if rng.random() < 0.3 else write_csv, {"X": gain})


EDGE_NAMES = {"set_point": "DES_POS|1", "act_pos": "ENC_POS|1", "cmd_vel": "CMD_SPEED|1", "act_vel": "VEL_FFW|1", "current": "CURRENT|1"}
"""Names that a SINUMERIK Edge gives the columns of a simulated recording."""


def write_edge(path: Path, t: Table, rng: np.random.Generator) -> Path:
    """SINUMERIK Edge JSON, with the rows in their order."""
    own = {EDGE_NAMES.get(k, k): v for k, v in t.items() if k not in ("CYCLE", "t")}
    counter = t["CYCLE"] if "CYCLE" in t else t["t"] / 2e-3 if "t" in t else np.arange(len(next(iter(t.values()))))
    counter = np.clip(np.nan_to_num(counter, posinf=0.0, neginf=0.0), -1e15, 1e15)
    rows = [[int(c), *(float(v[i]) for v in own.values())] for i, c in enumerate(counter)]
    names = [{"Name": n, "Axis": ""} for n in ("CYCLE", *own)]
    block = {"HFBlockEvent": {"HFProbeCounter": 10, "Channel": 1, "GCode": "N1 G0"}}
    document = {"Header": {"SignalListHFData": names, "CycleTimeMs": 2.0}, "Payload": [{"HFData": rows}, block]}
    path = path.with_suffix(".json")
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def write_csv(path: Path, t: Table, rng: np.random.Generator) -> Path:
    """Commas or semicolons, sometimes with a column of words; now and then a cell that is no number."""
    delimiter, decimal = (";", ",") if rng.random() < 0.3 else (",", ".")
    words = ["trap"] if rng.random() < 0.3 else []
    rows = [[repr(float(c)).replace(".", decimal) for c in row] + words for row in zip(*t.values())]
    if rows and rng.random() < 0.1:
        row = rows[int(rng.integers(len(rows)))]
        row[int(rng.integers(len(row)))] = str(rng.choice(["", "abc", "--", "1;2"]))
    names = [*t, *(["profile"] if words else [])]
    path = path.with_suffix(".csv")
    path.write_text("\n".join(delimiter.join(row) for row in [names, *rows]) + "\n", encoding="utf-8")
    return path


def write_mat(path: Path, t: Table, rng: np.random.Generator) -> Path:
    """A MATLAB file of rows or columns, sometimes inside a struct."""
    from scipy.io import savemat

    path = path.with_suffix(".mat")
    inside = {k: v.reshape((1, -1) if rng.random() < 0.5 else (-1, 1)) for k, v in t.items()}
    savemat(path, {"rec": inside} if rng.random() < 0.3 else inside)
    return path


def write_mat73(path: Path, t: Table, rng: np.random.Generator) -> Path:
    """A MATLAB 7.3 file, which is HDF5."""
    import h5py

    path = path.with_suffix(".mat")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in t.items():
            file.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
    content = path.read_bytes()
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + content[128:])
    return path


def write_tdms(path: Path, t: Table, rng: np.random.Generator) -> Path:
    """A TDMS file whose channels carry start and increment."""
    return tdms_file(path.with_suffix(".tdms"), {k: v for k, v in t.items() if k != "t"}, 1e-3, {"set_point": "mm", "act_pos": "mm"})


def write_mdf(path: Path, t: Table, rng: np.random.Generator) -> Path:
    """An MDF file of one group."""
    time = np.asarray(t.get("t", np.arange(len(next(iter(t.values())))) * 1e-3), float)
    return mdf_file(path.with_suffix(".mf4"), [(time, {k: (v, "mm") for k, v in t.items() if k != "t"})])


def write_parquet(path: Path, t: Table, rng: np.random.Generator) -> Path:
    """A Parquet file with units in its headings, sometimes with integer columns."""
    import pyarrow as pa
    import pyarrow.parquet

    whole = rng.random() < 0.2
    columns = {
        k if k == "t" else f"{k} [mm]": np.nan_to_num(v).clip(0, 255).astype(np.uint8) if whole and k != "t" else v for k, v in t.items()
    }
    pyarrow.parquet.write_table(pa.table(columns), path := path.with_suffix(".parquet"))
    return path


WRITERS = (write_csv, write_csv, write_edge, write_edge, write_mat, write_mat73, write_tdms, write_mdf, write_parquet)


@functools.cache
def real(folder: Path) -> list[Recording]:
    """Recordings of real machines in a folder, if any."""
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
            out.append(Recording(f"kr300 {a + 1}", {"t": np.arange(length) * 4e-3, **table}, write_csv, {}))
    if (file := folder / "emps" / "DATA_EMPS.mat").is_file():
        content = loadmat(file, squeeze_me=True)
        table = {n: np.asarray(content[n], float) for n in ("t", "qg", "qm", "vir")}
        out.append(Recording("emps", table, write_mat, {"X": 160.18}))
    for file in sorted((folder / "actuator").glob("*.csv")):
        lines = file.read_text(encoding="utf-8").splitlines()
        cells = [line.split(",") for line in lines]
        numeric = [i for i, c in enumerate(cells[1]) if c.replace(".", "").replace("-", "").replace("e", "").isdigit()]
        table = {cells[0][i]: np.array([float(row[i]) for row in cells[1:]]) for i in numeric}
        out.append(Recording(file.stem, table, write_csv, {}))
    return out


def part_of(recording: Recording, rng: np.random.Generator) -> Recording:
    """A random part of a recording, shorter than 2 ROWS."""
    n = len(next(iter(recording.table.values())))
    length = int(rng.integers(2, 2 * ROWS))
    first = int(rng.integers(0, max(n - length, 1)))
    return replace(recording, table={k: v[first : first + length] for k, v in recording.table.items()})


def chain(seed: int, folder: Path, recordings: list[Recording], no_refine: bool = False) -> tuple[str, str]:
    """(last successful command, fault) of a corrupted recording; `no_refine`: identify by regression only."""
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
        code, fault = called(step, allowed=("finding: ",))
        if fault:
            return reached, f"{what}: twin {step[0]}: {fault}"
        if code == 2 and step[0] in ("import", "machine"):
            return reached, ""
        reached = step[0] if code == 0 else reached
    wrong = impossible_numbers(lumped, identified, result, folder / "gap.json")
    if keeps and not wrong:
        wrong = wrong_gain(recording, result)
    return reached, f"{what}: {wrong}" if wrong else ""


def recording(seed: int, folder: Path, recordings: list[Recording]) -> tuple[int, str]:
    """(exit code, fault) of importing a corrupted recording."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    chosen = part_of(recordings[int(rng.integers(len(recordings)))], rng) if recordings and rng.random() < 0.3 else made(rng)
    table, write = chosen.table, chosen.write if chosen.name != "made" else WRITERS[int(rng.integers(len(WRITERS)))]
    for _ in range(int(rng.integers(0, 4))):
        table = (
            MUTATIONS[int(rng.integers(len(MUTATIONS)))].apply(table, rng) if len(table) > 1 and len(next(iter(table.values()))) else table
        )
    path = write(folder / "run", table, rng)
    if rng.random() < 0.4:
        spoil(path, random.Random(f"recording {seed}"))
    code, fault = called(("import", path, "--out", folder / "out", "--no-picture"), allowed=())
    return code, f"seed {seed}, {path.name}: {fault}" if fault else ""


def impossible_numbers(lumped: Path, identified: Path, *results: Path) -> str:
    """Numbers that no axis can have: not finite, or negative where only positive ones are possible."""
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
                # an estimate that is not taken may be negative if its interval includes positive values: it is undetermined
                value, high = (float(entry.get(key) or 0.0) for key in ("value", "high"))
                stated = entry.get("taken", True) or high < 0.0
                if entry.get("name") in ("inertia", "coulomb", "viscous", "position_gain_per_s") and value < 0.0 and stated:
                    return f"{file.name}: {entry}"
    return ""


def parameters(content: Any) -> list[dict[str, Any]]:
    """All objects with a name and a value in a JSON document."""
    if isinstance(content, dict):
        own = [content] if "name" in content and "value" in content else []
        return own + [p for value in content.values() for p in parameters(value)]
    return [p for value in content for p in parameters(value)] if isinstance(content, list) else []


def wrong_gain(recording: Recording, result: Path) -> str:
    """A stated position gain that is not that of the recording."""
    if not result.is_file() or not recording.gains:
        return ""
    for entry in parameters(json.loads(result.read_text(encoding="utf-8"))):
        known = recording.gains.get(str(entry.get("axis")))
        if entry.get("name") != "position_gain_per_s" or known is None:
            continue
        value = float(entry["value"])
        half = 0.5 * (float(entry.get("high") or value) - float(entry.get("low") or value))
        if abs(value - known) > 3.0 * half + FAR * known:
            return f"states a position gain of {value:.4g} +-{half:.2g} 1/s of axis {entry.get('axis')}, it is {known:.4g}"
    return ""
