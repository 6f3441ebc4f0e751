"""Mutilated recordings through `twin import FILES --out CAMPAIGN`: every one is imported, or refused in one line; never a traceback.

    scripts/fuzz --only recording --cases 500 --seed 1

Rows, columns, units, gaps and rates are spoilt in CSV, SINUMERIK Edge JSON and MATLAB files, made here or taken from --data.
"""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import shutil

import numpy as np

from devtools.fuzz_loop import called

Table = dict[str, np.ndarray]
MOST_ROWS = 1200


def base(rng: np.random.Generator) -> Table:
    """A move of one axis with second encoder, current and speeds, at a random period."""
    period = float(rng.choice([0.25e-3, 1e-3, 2e-3, 4e-3, 40e-3]))
    t = np.arange(int(rng.integers(60, MOST_ROWS))) * period
    s = 30.0 * np.sin(1.7 * t) + 5.0 * np.sin(4.1 * t)
    x = 30.0 * np.sin(1.7 * (t - 0.01)) + 5.0 * np.sin(4.1 * (t - 0.01))
    v = np.gradient(x, period)
    return {
        "t": t,
        "set_point": s,
        "act_pos": x,
        "act_pos_mot": x + 0.01,
        "cmd_vel": 30.0 * (s - x),
        "act_vel": v,
        "current": np.sign(v) + 0.01 * v,
    }


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


MUTATIONS: tuple[Callable[[Table, np.random.Generator], Table], ...] = (
    rows_gone, gap, column_gone, columns_swapped, unit_wrong, cells_bad, rate_changed, order_wrong, repeated, still, noise,
)  # fmt: skip


def write_csv(path: Path, t: Table, rng: np.random.Generator) -> Path:
    delimiter, decimal = (";", ",") if rng.random() < 0.3 else (",", ".")
    names = [*t, *(["profile"] if rng.random() < 0.3 else [])]
    lines = [delimiter.join(names)]
    for row in zip(*t.values()):
        cells = [repr(float(c)).replace(".", decimal) for c in row] + ["trap"] * (len(names) - len(t))
        if rng.random() < 0.002:
            cells[int(rng.integers(len(cells)))] = str(rng.choice(["", "abc", "--", "1;2"]))
        lines.append(delimiter.join(cells))
    path = path.with_suffix(".csv")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_mat(path: Path, t: Table, rng: np.random.Generator) -> Path:
    from scipy.io import savemat

    path = path.with_suffix(".mat")
    inside = {k: (v.reshape(1, -1) if rng.random() < 0.5 else v.reshape(-1, 1)) for k, v in t.items()}
    names = [k for k in t if k != "t"]
    if rng.random() < 0.4 and names:
        inside = {"t": inside.get("t", np.zeros((1, 1))), "act_pos": np.stack([t[k] for k in names][:3])}
    savemat(path, {"rec": inside} if rng.random() < 0.5 else inside)
    return path


def write_edge(path: Path, t: Table, rng: np.random.Generator) -> Path:
    known = {"set_point": "DES_POS|1", "act_pos": "ENC_POS|1", "cmd_vel": "CMD_SPEED|1", "act_vel": "VEL_FFW|1", "current": "CURRENT|1"}
    own = {known[k]: v for k, v in t.items() if k in known}
    cycle = 2.0
    counter = np.nan_to_num(t["t"] / 2e-3 if "t" in t else np.arange(len(next(iter(t.values())))), posinf=0.0, neginf=0.0)
    names = ["CYCLE", *own]
    rows = [[int(c) if abs(c) < 1e15 else 0, *(float(v[i]) for v in own.values())] for i, c in enumerate(counter)]
    document = {
        "Header": {"SignalListHFData": [{"Name": n, "Axis": ""} for n in names], "CycleTimeMs": cycle},
        "Payload": [{"HFData": rows}, {"HFBlockEvent": {"HFProbeCounter": 10, "Channel": 1, "GCode": "N1 G0"}}],
    }
    if rng.random() < 0.5:
        spoil(document, rng)
    path = path.with_suffix(".json")
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def spoil(document: object, rng: np.random.Generator) -> None:
    """Replace something anywhere in a JSON document."""
    here = document
    for _ in range(int(rng.integers(1, 6))):
        keys = list(here) if isinstance(here, dict) else list(range(len(here))) if isinstance(here, list) else []
        if not keys:
            return
        key = keys[int(rng.integers(len(keys)))]
        if rng.random() < 0.4:
            here[key] = [None, "x", [], {}, -1, 1e300, True, "N1"][int(rng.integers(8))]  # type: ignore[index]
            return
        here = here[key]  # type: ignore[index]


def damaged(path: Path, rng: np.random.Generator) -> Path:
    """Bytes cut off or overwritten."""
    content = bytearray(path.read_bytes())
    if rng.random() < 0.5:
        del content[int(rng.integers(0, len(content))) :]
    else:
        for _ in range(int(rng.integers(1, 5))):
            at = int(rng.integers(0, len(content)))
            content[at : at + 4] = rng.bytes(4)
    path.write_bytes(bytes(content))
    return path


def recorded(source: Path, folder: Path, rng: np.random.Generator) -> Path:
    """A real recording, spoilt in its own format."""
    target = folder / source.name
    if source.suffix == ".csv":
        lines = source.read_text(encoding="utf-8").splitlines()[: int(rng.integers(2, 1500))]
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(0, len(lines)))
            cells = lines[at].split(",")
            cells[int(rng.integers(len(cells)))] = str(rng.choice(["", "NaN", "-1e9", "x", "0"]))
            lines[at : at + int(rng.integers(1, 30))] = [",".join(cells)]
        target.write_text("\n".join(lines) + "\n", encoding="utf-8")
    elif source.suffix == ".json":
        document = json.loads(source.read_text(encoding="utf-8"))
        for _ in range(int(rng.integers(1, 4))):
            spoil(document, rng)
        document["Payload"] = document["Payload"][: int(rng.integers(1, 99))] if isinstance(document.get("Payload"), list) else None
        target.write_text(json.dumps(document), encoding="utf-8")
    else:
        shutil.copyfile(source, target)
        damaged(target, rng)
    return target


def run_case(seed: int, folder: Path, real: list[Path]) -> tuple[int, str]:
    """(exit code, what went wrong or "") of one mutilated recording."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    if real and rng.random() < 0.3:
        path = recorded(real[int(rng.integers(len(real)))], folder, rng)
    else:
        table = base(rng)
        for _ in range(int(rng.integers(1, 4))):
            table = MUTATIONS[int(rng.integers(len(MUTATIONS)))](table, rng) if len(table) > 1 else table
        writer = (write_csv, write_csv, write_edge, write_edge, write_mat)[int(rng.integers(5))]
        path = writer(folder / "run", table, rng)
        if rng.random() < 0.1:
            damaged(path, rng)
    code, fault = called(("import", path, "--out", folder / "out", "--no-picture"), allowed=())
    return code, f"seed {seed}, {path.name}: {fault}" if fault else ""


def real_recordings(folder: Path) -> list[Path]:
    """What there is beside the repository."""
    return [
        p
        for part in ("sinumerik", "kr300", "actuator", "emps")
        for p in sorted((folder / part).glob("*.*"))
        if p.suffix in (".json", ".mat", ".csv")
    ]
