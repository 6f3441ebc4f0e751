"""Sealed histories: a machine recorded week by week on the second plant, with everyday background, seasons, tools and workpieces; some have one fault.

    python -m devtools.histories --count 10 --seed 100 --out FOLDER      draw, watch and score; prints a table; goes on where it was stopped

Each week is one short recording of the same production program. Temperature (a season and the weather of the week) changes the friction of all
axes, each by its own coefficient; the tool changes the mass on Z, the workpiece the mass on the table; friction also scatters by itself. The twin
gets the folder of recordings and the machine file; the truth stays in the memory of this process until all verdicts are in.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from datetime import date, timedelta
import json
import math
from pathlib import Path
import subprocess
import sys
import time
import tomllib
from typing import Any

from matplotlib.figure import Figure
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from twin.exam.draw import SHIPPED_MACHINE, SIGNALS, Case, columns_of, draw_case, peaks_of, settings_for, simulate
from twin.exam.paths import DEG, MARGIN, limits_of, path_of, together
from twin.exam.plant.effects import LIBRARY, DrawContext, draw_effect
from twin.exam.plant.parameters import AXES, Settings, settings_of
from twin.exam.programme import TestRun
from twin.report.figure import AMBER, BLUE, RED, SOFT, new_figure, save_png

FAULTS = ("backlash", "coulomb_friction", "viscous_friction", "stribeck", "transmission_compliance", "cyclic_error", "position_gain",
          "speed_gain", "torque_constant", "lead_error", "constant_force", "viscous_asymmetry")  # fmt: skip
"""What wears, loosens, or is changed on machines."""

SUBSTEPS = 2
"""RK4 steps in a tick of the second plant. Its answers differ by less than a count of the encoders from those of eight steps, as a count that rounds
the other way already makes them differ.
"""

FIRST = date(2026, 1, 5)
SHARE_WITH_FAULT = 0.6


@dataclass(frozen=True)
class Fault:
    """One effect that starts in week `onset` and reaches its size after `growth` weeks (0: at once)."""

    effect: dict[str, Any]
    onset: int
    growth: int

    def share(self, week: int) -> float:
        """Share of the final size in a week."""
        if week < self.onset:
            return 0.0
        return 1.0 if not self.growth else min(1.0, (week - self.onset + 1) / self.growth)


@dataclass(frozen=True)
class History:
    """A sealed history: the machine, its nuisances by week, and its fault if it has one."""

    seed: int
    case: Case
    weeks: int
    kelvin: np.ndarray  # (week,)
    by_kelvin: np.ndarray  # (axis, viscous and Coulomb) relative change of friction per kelvin
    scatter: np.ndarray  # (week, axis, viscous and Coulomb)
    tool_kg: np.ndarray  # (week,)
    workpiece_kg: np.ndarray  # (week,)
    fault: Fault | None


def machine_tables() -> dict[str, Any]:
    """The shipped machine file."""
    return tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8"))


def program(machine: dict[str, Any], seconds: float = 4.0) -> TestRun:
    """A production program: moves of all axes at several speeds with reversals, each axis in its own time."""
    lim = limits_of(machine)
    acc = np.minimum(MARGIN * lim.acceleration, [2.0, 2.0, 2.1, 5.0, 5.0])
    home, columns = np.array([0.0, 0.0, 0.0, -30.0 * DEG, 0.0]), []
    for k in range(5):
        unit = 1e-3 if k < 3 else DEG
        steps = unit * np.array([30.0, 45.0, 40.0, 0.0, 4.0, 0.0, 15.0, 0.0])
        speeds = unit * np.array([100.0, 30.0, 8.0, 160.0, 25.0, 12.0, 60.0, 40.0])
        columns.append(path_of(home[k], list(home[k] + steps), list(speeds), acc[k], MARGIN * lim.jerk[k], 0.08, 0.1 + 0.03 * k))
    return TestRun("production", "program", "velocity+torque", together(columns)[: round(seconds / 1e-3)])


def draw_history(seed: int, weeks: int = 52, faulty: bool | None = None, name: str | None = None, axis: str | None = None) -> History:
    """A history from its seed; `faulty`, `name` and `axis` fix what is drawn otherwise."""
    machine = machine_tables()
    rng = np.random.default_rng(np.random.SeedSequence([seed, 77]))
    case = draw_case(seed, "everyday", machine)
    background = tuple(e for e in case.effects if e["name"] != "thermal_drift")
    week = np.arange(weeks)
    kelvin = rng.uniform(3.0, 8.0) * np.sin(2 * math.pi * (week / 52 - rng.random())) + rng.normal(0.0, 1.5, weeks)
    by_kelvin = -np.column_stack([rng.uniform(0.006, 0.014, 5), rng.uniform(0.001, 0.004, 5)])
    workpiece = np.repeat(rng.uniform(0.0, 30.0, weeks), rng.integers(3, 9, weeks))[:weeks]
    tool = rng.choice([0.0, 2.0, 4.0, 7.0], weeks)
    fault = None
    if rng.random() < SHARE_WITH_FAULT if faulty is None else faulty:
        name = name or str(rng.choice(FAULTS))
        axis = axis or str(rng.choice(LIBRARY[name].axes))
        s = settings_of(machine, case.factors)
        peaks = peaks_of(machine, case.factors, [program(machine)])
        effect = draw_effect(name, axis, DrawContext(rng, AXES.index(axis), float(rng.uniform(0.6, 1.0)), s, *peaks))
        fault = Fault(effect, int(rng.integers(16, max(17, weeks - 12))), int(rng.choice([0, 0, 6, 12])))
        background = tuple(e for e in background if (e["name"], e["axis"]) != (name, axis))
    return History(
        seed, replace(case, effects=background), weeks, kelvin, by_kelvin, rng.normal(0.0, 0.01, (weeks, 5, 2)), tool, workpiece, fault
    )


def scaled(effect: dict[str, Any], share: float) -> dict[str, Any]:
    """An effect at a share of its size: deviations of factors, amplitudes, compliances."""
    shapes = ("wavelength", "velocity", "periods_per_rev", "phase_rad", "contact_stiffness", "contact_damping", "radius_m", "angle_rad")
    out = dict(effect)
    for key, value in effect.items():
        if key == "factor":
            out[key] = 1.0 + share * (value - 1.0)
        elif key in ("stiffness", "damping"):
            out[key] = value / share
        elif isinstance(value, float) and key not in shapes:
            out[key] = share * value
    return out


def worn(healthy: Settings, fault: dict[str, Any] | None) -> list[dict[str, Any]]:
    """The fault next to what the healthy machine has of it, and the springs of all drive trains: they stay the same whatever the machine carries.

    A spring of a fault is in series with the healthy one; an effect would take its place, and a backlash that of the spring.
    """
    springs = {axis: {"name": "transmission_compliance", "axis": axis, "stiffness": k, "damping": d}
               for axis, k, d in zip(AXES, healthy.stiffness.tolist(), healthy.damping.tolist()) if k > 0.0}  # fmt: skip
    if fault is None:
        return list(springs.values())
    if fault["name"] == "transmission_compliance" and (own := springs.get(fault["axis"])):
        k, d, soft = own["stiffness"], own["damping"], own["stiffness"] + fault["stiffness"]
        own |= {"stiffness": k * fault["stiffness"] / soft, "damping": (d * fault["stiffness"] + fault["damping"] * k) / soft}
        return list(springs.values())
    if fault["name"] == "stribeck":
        fault = {**fault, "excess": fault["excess"] + float(healthy.stribeck_excess[AXES.index(fault["axis"])])}
    return [*springs.values(), fault]


def case_of(history: History, week: int) -> Case:
    """The machine in one week."""
    friction = 1.0 + history.by_kelvin * history.kelvin[week] + history.scatter[week]
    effects = [e for e in history.case.effects if e["name"] != "transmission_compliance"]
    for k, name in enumerate(AXES):
        effects += [{"name": n, "axis": name, "factor": float(f)} for n, f in zip(("viscous_friction", "coulomb_friction"), friction[k])]
    effects.append({"name": "inertia", "axis": "Z", "added": float(history.tool_kg[week])})
    clamped = {"mass_kg": float(history.workpiece_kg[week]), "radius_m": 0.03, "angle_rad": 1.0, "height_m": 0.1}
    effects.append({"name": "table_unbalance", "axis": "A", **clamped})
    share = history.fault.share(week) if history.fault else 0.0
    effects += worn(settings_for(history.case, machine_tables()), scaled(history.fault.effect, share) if history.fault and share else None)
    return replace(history.case, effects=tuple(effects), noise_seed=1000 * history.seed + week)


def write_week(history: History, week: int, folder: Path, signals: str = "full", run: TestRun | None = None) -> Path:
    """One dated campaign; nothing in it reveals the truth."""
    machine = machine_tables()
    out = folder / (FIRST + timedelta(weeks=week)).isoformat()
    out.mkdir(parents=True, exist_ok=True)
    trace = simulate(case_of(history, week), machine, run or program(machine), substeps=SUBSTEPS)
    pq.write_table(pa.table(columns_of(trace, SIGNALS[signals])), out / "production.parquet", compression="zstd")
    text = 'machine = "mikron_ucp710"\n[[run]]\nfile = "production.parquet"\nfeedforward = "velocity+torque"\n'
    (out / "campaign.toml").write_text(text, encoding="utf-8")
    return out


def write_history(history: History, folder: Path, signals: str = "full") -> None:
    """All weeks of a history."""
    run = program(machine_tables())
    for week in range(history.weeks):
        write_week(history, week, folder, signals, run)


def usual_size(effect: dict[str, Any]) -> float:
    """Middle of the usual sizes of an effect on its axis, as a deviation from neutral: what a share of a size is taken of."""
    sizes = []
    for seed in range(40):
        machine = machine_tables()
        s = settings_of(machine, draw_case(0, "healthy", machine, spread=0.0).factors)
        peaks = peaks_of(machine, draw_case(0, "healthy", machine, spread=0.0).factors, [program(machine)])
        sizes.append(
            abs(
                deviation(
                    draw_effect(
                        effect["name"], effect["axis"], DrawContext(np.random.default_rng(seed), AXES.index(effect["axis"]), 1.0, s, *peaks)
                    )
                )
            )
        )
    return float(np.median(sizes))


def deviation(effect: dict[str, Any]) -> float:
    """Size of an effect: its scored parameter as a deviation from neutral; the compliance of a spring."""
    name = next(key for key in effect if key not in ("name", "axis", "from_axis", "mass_kg"))
    value = float(effect[name])
    return value - 1.0 if name == "factor" else 1.0 / value if name == "stiffness" else value


def scored(history: History, document: dict[str, Any]) -> dict[str, Any]:
    """What a history said against the truth: false alarms, onset, cause, size, delay."""
    weeks = {c["day"][:10]: i for i, c in enumerate(document["campaigns"])}
    fault, changes = history.fault, document["changes"]
    row: dict[str, Any] = {
        "seed": history.seed,
        "weeks": history.weeks,
        "fault": None,
        "alarms": [[c["effect"], c["axis"], weeks[c["alarm"][:10]]] for c in changes],
    }
    healthy = fault.onset if fault else history.weeks
    row["healthy_weeks"] = healthy
    row["false_alarms"] = sum(weeks[c["alarm"][:10]] < healthy for c in changes)
    if fault is None:
        return row
    true, usual = deviation(fault.effect), usual_size(fault.effect)
    row["fault"], row["usual_sizes"], row["growth"] = [fault.effect["name"], fault.effect["axis"], fault.onset], true / usual, fault.growth
    shares = [abs(true) * fault.share(w) >= 0.2 * usual for w in range(history.weeks)]
    reached = shares.index(True) if any(shares) else None
    after = [c for c in changes if weeks[c["alarm"][:10]] >= fault.onset]
    own = next((c for c in after if (c["effect"], c["axis"]) == (fault.effect["name"], fault.effect["axis"])), None)
    row |= {"reached": reached, "named": own is not None, "others": len(after) - (own is not None)}
    if after:
        row["delay"] = weeks[after[0]["alarm"][:10]] - (fault.onset if reached is None else reached)
        row["onset_off"] = weeks[after[0]["onset"][:10]] - (fault.onset if reached is None else reached)
    if own is not None:
        (_, p), *_ = own["parameters"].items()
        said = p["value"] - 1.0 if "factor" in own["parameters"] else 1.0 / p["value"] if "stiffness" in own["parameters"] else p["value"]
        row["size_error"] = abs(abs(said) / abs(true) - 1.0)
    return row


def summary(rows: list[dict[str, Any]]) -> str:
    """The scores of several histories."""
    faulty = [r for r in rows if r["fault"] and r["reached"] is not None]
    found = [r for r in faulty if "delay" in r]
    named = [r for r in faulty if r["named"]]
    weeks, false = sum(r["healthy_weeks"] for r in rows), sum(r["false_alarms"] for r in rows)
    return "\n".join([
        f"{len(rows)} histories, {weeks} healthy machine-weeks: {false} false alarms; {len(faulty)} with a fault that reaches a fifth of its usual size",
        f"alarm: {len(found)} of {len(faulty)}; within two weeks of a fifth of the usual size: {sum(r['delay'] <= 2 for r in found)}; onset off by at most two weeks: "
        f"{sum(abs(r['onset_off']) <= 2 for r in found)}",
        f"cause right: {len(named)} of {len(faulty)}; named besides: {sum(r['others'] for r in faulty)}; size within 15 %: {sum(r['size_error'] <= 0.15 for r in named)}",
    ])  # fmt: skip


def delays(rows: list[dict[str, Any]]) -> Figure:
    """Weeks between a fifth of the usual size and the alarm, over the final size; faults without an alarm in red at the top."""
    figure, [[panel]] = new_figure(1, 1, height=3.4)
    faulty = [r for r in rows if r["fault"] and r["reached"] is not None]
    top = max([8.0, *(r["delay"] + 2.0 for r in faulty if "delay" in r)])
    for growing, colour, label in ((False, BLUE, "at once"), (True, AMBER, "growing")):
        own = [r for r in faulty if "delay" in r and (r["growth"] > 0) is growing]
        panel.scatter(
            [abs(r["usual_sizes"]) for r in own], [r["delay"] for r in own], color=colour, label=f"{label}: {len(own)}", alpha=0.7
        )
    missed = [abs(r["usual_sizes"]) for r in faulty if "delay" not in r]
    panel.scatter(missed, [top] * len(missed), color=RED, marker="x", label=f"no alarm: {len(missed)}")
    panel.axhline(2.0, color=SOFT, lw=1.0, ls="--")
    panel.set_xlabel("final size of the fault [usual sizes]")
    panel.set_ylabel("alarm after a fifth\nof the usual size [weeks]")
    panel.legend(loc="upper right")
    return figure


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--weeks", type=int, default=52)
    parser.add_argument("--signals", default="full", choices=sorted(SIGNALS))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--picture", type=Path, help="write the delays over the sizes to this picture")
    args = parser.parse_args()
    scores = args.out / "scores.json"
    rows = json.loads(scores.read_text(encoding="utf-8")) if scores.is_file() else []
    for seed in range(args.seed, args.seed + args.count):
        if any(row["seed"] == seed for row in rows):
            continue
        history, folder = draw_history(seed, args.weeks), args.out / str(seed)
        write_history(history, folder / "weeks", args.signals)
        start = time.perf_counter()
        command = [sys.executable, "-m", "twin", "watch", str(folder / "weeks"), "--out", str(folder / "history")]
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        if done.returncode == 2:
            print(f"{seed}: {done.stderr.strip()}")
            continue
        rows.append(
            scored(history, json.loads((folder / "history" / "history.json").read_text(encoding="utf-8")))
            | {"seconds": time.perf_counter() - start}
        )
        print(json.dumps(rows[-1], default=float), flush=True)
        scores.write_text(json.dumps(rows, default=float), encoding="utf-8")
    print(summary(rows))
    if args.picture:
        save_png(delays(rows), args.picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
