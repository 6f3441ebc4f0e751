"""Kind `claims` of the fuzzer: a real recording is cut, mutilated, imported and diagnosed, and each confident claim of the diagnosis is judged.

    python examples/real/sinumerik/run.py recording.json; python examples/real/kr300/run.py FF_A.mat FF_B.mat    once, for their machine files
    python -m devtools.fuzz_claims --cases 500 --seed 1

A claim is an effect or a law named with a probability above `SURE`, or the verdict "law". It is wrong if neither the page of the whole recording
makes it (`pages`) nor one of the mutilations can have caused it (`MUTILATIONS`).
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
import contextlib
from dataclasses import dataclass, field
import functools
import json
import math
from pathlib import Path
import time
from typing import Any
from unittest import mock

import numpy as np

from devtools import fuzz_recordings
from devtools.fuzz_loop import called, one_case
from devtools.fuzz_recordings import Recording, Table, real, write_csv
from devtools.fuzz_samples import ROOT

SURE = 0.9
"""A claim is judged from this probability."""

SECONDS = 240.0
"""Processor time that one case may take."""

Claim = tuple[str, str]
"""Effect, or "law of BLOCK over VARIABLE", and its axis."""


def role(column: str) -> str:
    """What a column of the real recordings is: clock, set point, position, speed command, speed, effort, feedforward or other."""
    name = column.split("|")[0].split("(")[0].split(" [")[0].split(".")[-1]
    roles = {
        "clock": ("CYCLE", "t", "time"),
        "set point": ("DES_POS", "qg", "setpoint", "set_point"),
        "position": ("ENC_POS", "qm", "position", "motor_position", "position_error"),
        "speed command": ("CMD_SPEED",),
        "effort": ("CURRENT", "TORQUE", "vir", "torque", "current"),
        "feedforward": ("VEL_FFW", "TORQUE_FFW"),
        "known load": ("disturbance_torque",),
    }
    return next((known for known, names in roles.items() if name in names), "other")


@dataclass(frozen=True)
class Mutilation:
    """A change of a table, in words what may honestly be claimed of it, and the same as effects by the role of the changed column."""

    apply: Callable[[Table, str, np.random.Generator], Table]
    honest: str
    effects: Mapping[str, frozenset[str]] = field(default_factory=dict)
    clock: bool = True  # may also change the clock


def scaled(t: Table, name: str, rng: np.random.Generator) -> Table:
    """A column in another unit, with another sign, or from a sensor that is wrong by some percent."""
    return {**t, name: t[name] * float(rng.choice([1e3, 1e-3, -1.0, 60.0, 57.3, 25.4, 1.05, 0.95, 1.2]))}


def late(t: Table, name: str, rng: np.random.Generator) -> Table:
    """A column that was recorded some samples late."""
    by = int(rng.integers(1, 9))
    return {**t, name: np.concatenate([np.full(by, t[name][0]), t[name][:-by]])}


def noisy(t: Table, name: str, rng: np.random.Generator) -> Table:
    """A column with white noise added, from a hundred-thousandth to a tenth of its range."""
    return {**t, name: t[name] + np.ptp(t[name]) * 10.0 ** rng.uniform(-5, -1) * rng.standard_normal(len(t[name]))}


def rounded(t: Table, name: str, rng: np.random.Generator) -> Table:
    """A column with few digits: 20 to 20 000 steps over its range."""
    step = np.ptp(t[name]) / 10.0 ** rng.uniform(1.3, 4.3) or 1.0
    return {**t, name: np.round(t[name] / step) * step}


def _of(change: Callable[[Table, np.random.Generator], Table]) -> Callable[[Table, str, np.random.Generator], Table]:
    """A mutilation of `fuzz_recordings`, which chooses its own columns and rows."""

    @functools.wraps(change)
    def apply(t: Table, _: str, rng: np.random.Generator) -> Table:
        return change(t, rng)

    return apply


LATE_IN_THE_LOOP = frozenset({"loop_delay", "set_point_filter", "velocity_feedforward"})
LATE_BEHIND_A_FORCE = frozenset({"current_filter", "transmission_compliance"})

MUTILATIONS = (
    Mutilation(
        scaled,
        "Another unit of the effort is another torque constant: all masses, frictions and forces change together, and the gain of the speed"
        " controller that commands the effort. Another unit of the speed command is another position gain or speed gain, of the feedforward another"
        " weight of it, of one of two encoders another lead. A clock that runs wrong changes masses, viscous friction, gains and times. Another unit"
        " of the set point is no machine at all: nothing.",
        {
            "effort": frozenset({"torque_constant", "inertia", "coulomb_friction", "viscous_friction", "constant_force", "speed_gain"}),
            "known load": frozenset({"torque_constant", "inertia", "coulomb_friction", "viscous_friction", "constant_force"}),
            "speed command": frozenset({"position_gain", "velocity_feedforward", "speed_gain"}),
            "feedforward": frozenset({"velocity_feedforward"}),
            "position": frozenset({"lead_error"}),
            "clock": LATE_IN_THE_LOOP
            | frozenset({"position_gain", "speed_gain", "speed_integral_time", "inertia", "viscous_friction", "current_filter"}),
        },
    ),
    Mutilation(
        late,
        "A late set point, feedforward, speed command or position is a latency of the position loop; to first order the feedforward cannot be told"
        " from it. A late effort, or a late position next to the effort, is a lag of the current, which resembles a spring behind the motor.",
        {
            "set point": LATE_IN_THE_LOOP,
            "speed command": LATE_IN_THE_LOOP,
            "feedforward": LATE_IN_THE_LOOP,
            "position": LATE_IN_THE_LOOP | LATE_BEHIND_A_FORCE,
            "effort": LATE_BEHIND_A_FORCE,
        },
        clock=False,
    ),
    Mutilation(noisy, "Noise, for which there is no effect: nothing more than before.", clock=False),
    Mutilation(rounded, "Few digits are noise: nothing more than before.", clock=False),
    Mutilation(_of(fuzz_recordings.gap), "A gap in time: nothing more than before."),
    Mutilation(_of(fuzz_recordings.cut), "A shorter recording: nothing more than before."),
    Mutilation(_of(fuzz_recordings.column_gone), "A missing column: nothing more than before."),
    Mutilation(_of(fuzz_recordings.rate_changed), "A lower rate, also from the middle on: nothing more than before."),
    Mutilation(_of(fuzz_recordings.columns_swapped), "Two columns under each other's name: nothing more than before."),
    Mutilation(_of(fuzz_recordings.unsigned), "An effort without its sign: nothing more than before."),
    Mutilation(_of(fuzz_recordings.shifted), "Another zero of an encoder is no fault: nothing more than before."),
    Mutilation(_of(fuzz_recordings.still), "A column that stands still is a dead sensor: nothing more than before."),
    Mutilation(_of(fuzz_recordings.cells_bad), "Three cells without a number, or with an impossible one: nothing more than before."),
    Mutilation(_of(fuzz_recordings.rows_gone), "Missing rows: nothing more than before."),
    Mutilation(_of(fuzz_recordings.order_wrong), "Rows in another order: nothing more than before."),
    Mutilation(_of(fuzz_recordings.repeated), "The same rows again: nothing more than before."),
)

READ = MUTILATIONS[:11]
"""A recording can usually be read after these mutilations."""


@dataclass(frozen=True)
class Base:
    """A real recording with the machine file of its page (None: only the route over identification) and the claims that the page makes."""

    recording: Recording
    machine: Path | None
    claims: frozenset[Claim]
    lengths: tuple[int, int]  # samples of a part
    of_page: float = 0.75  # share of cases with the machine file of the page

    @property
    def axis(self) -> str:
        """The only axis of the recording."""
        return self.recording.name.split()[1] if " " in self.recording.name else "X"


@functools.cache
def pages(data: Path, out: Path) -> list[Base]:
    """The recordings in `data`, with the machine files that the examples wrote to `out`; a recording without its file is left out."""
    bases = []
    emps = frozenset(
        {
            ("viscous_asymmetry", "X"),
            ("torque_ripple", "X"),
            ("law of mechanics over speed", "X"),
            ("law of mechanics over position", "X"),
            ("law of mechanics over turn", "X"),
        }
    )
    for recording in real(data):
        if recording.name == "emps":
            bases.append(Base(recording, ROOT / "examples" / "emps" / "axis.toml", emps, (1200, 3500)))
        elif recording.name.startswith("sinumerik") and (file := out / "sinumerik" / "identified" / "machine.toml").is_file():
            bases.append(Base(recording, file, frozenset(), (600, 1816)))
        elif not recording.name.startswith(("sinumerik", "kr300")):
            bases.append(Base(recording, None, frozenset(), (100, 1500)))
    return bases + robot(out / "kr300")


def robot(out: Path) -> list[Base]:
    """Axes 1 to 3 of the KR300 as examples/real/kr300 prepares them: the path of the motors as set points, and the known loads."""
    import pyarrow.parquet

    file, machine = out / "both" / "FF_A.parquet", out / "identified" / "machine.toml"
    if not (file.is_file() and machine.is_file()):
        return []
    content = pyarrow.parquet.read_table(file).to_pydict()
    bases = []
    for axis in ("1", "2", "3"):
        table = {k: np.asarray(v, float) for k, v in content.items() if k.startswith(("time", f"{axis}."))}
        bases.append(Base(Recording(f"kr300 {axis}", table, write_csv, {}), machine, frozenset(), (400, 1200), of_page=1.0))
    return bases


def claims_of(document: Mapping[str, Any]) -> list[Claim]:
    """Effects and laws of a diagnosis.json that are named with more than `SURE`, and the verdict "law"."""
    effects = [(e["effect"], e["axis"]) for e in document["effects"] if e["probability"] > SURE]
    laws = [
        (f"law of {law['block']} over {law['variables'][0]}", law["axis"])
        for law in document["laws"]
        if law["probability"] > SURE or document["verdict"] == "law"
    ]
    return [*effects, *laws]


def wrong_claims(claims: Iterable[Claim], base: Base, honest: frozenset[str]) -> list[str]:
    """Claims that the page does not make and that the mutilations cannot have caused."""
    return [f"{effect} on {axis}" for effect, axis in claims if (effect, axis) not in base.claims and effect not in honest]


@dataclass
class Tally:
    """Where the cases ended, number of claims, and number of claims that the page does not make but the mutilation can have caused."""

    reached: Counter[str] = field(default_factory=Counter)
    claims: int = 0
    caused: int = 0
    wrong: int = 0


def mutilated(base: Base, rng: np.random.Generator) -> tuple[Table, list[str], frozenset[str]]:
    """A part of the recording with none to two mutilations: (table, their names, effects that they can have caused)."""
    table = base.recording.table
    n = len(next(iter(table.values())))
    length = min(int(rng.integers(*base.lengths)), n)
    first = int(rng.integers(0, n - length + 1))
    table = {k: v[first : first + length] for k, v in table.items()}
    names, honest = [f"rows {first} to {first + length}"], frozenset[str]()
    for _ in range(int(rng.choice([0, 1, 1, 1, 2]))):
        mutilation = MUTILATIONS[int(rng.integers(len(MUTILATIONS)))]
        columns = [c for c in table if mutilation.clock or role(c) != "clock"]
        if not columns or len(next(iter(table.values()))) < 20:
            continue
        column = str(rng.choice(columns))
        table = mutilation.apply(table, column, rng)
        honest |= mutilation.effects.get(role(column), frozenset())
        names.append(mutilation.apply.__name__ + (f" {column}" if mutilation.effects or not mutilation.clock else ""))
    return table, names, honest


def claims(seed: int, folder: Path, bases: list[Base], tally: Tally, full: float = 0.0) -> str:
    """The fault of one case: a traceback, or a wrong claim. `full`: share of cases that are not diagnosed with --quick."""
    rng = np.random.default_rng(seed)
    base = bases[int(rng.integers(len(bases)))]
    table, names, honest = mutilated(base, rng)
    path = base.recording.write(folder / "run", table, rng)
    page = base.machine is not None and rng.random() < base.of_page
    machine = base.machine if page and base.machine is not None else folder / "identified" / "m.toml"
    quick = () if rng.random() < full else ("--quick",)
    lumped = folder / "lumped" / "m.toml"
    what = f"{base.recording.name}, {', '.join(names)}, {'file of the page' if page else 'identified'}{', quick' if quick else ''}"
    steps: list[tuple[object, ...]] = [("import", path, "--out", folder / "runs", "--no-picture")]
    if not page:
        steps.append(("machine", "new", "--from-recording", folder / "runs", "--out", lumped))
        steps.append(("identify", folder / "runs", "--machine", lumped, "--out", machine, "--no-refine"))
    steps.append(("diagnose", folder / "runs", "--machine", machine, "--out", folder / "diagnosis", *quick))
    for step in steps:
        with _without_report() if seed % 8 else contextlib.nullcontext():
            code, fault = called(step)
        if fault:
            return f"{what}: twin {step[0]}: {fault}"
        if code == 2 or (step[0] == "identify" and not machine.is_file()):
            tally.reached[f"refused by {step[0]}"] += 1
            return ""
    tally.reached["diagnosed"] += 1
    found = claims_of(json.loads((folder / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8")))
    wrong = wrong_claims(found, base, honest)
    tally.claims += len(found)
    tally.wrong += len(wrong)
    tally.caused += sum((effect, axis) not in base.claims and effect in honest for effect, axis in found)
    return f"{what}: claims {', '.join(wrong)}" if wrong else ""


def on_real(seed: int, folder: Path, data: Path, out: Path = ROOT / "out") -> str:
    """`claims` on the recordings in a folder; no case without any."""
    bases = pages(data, out)
    return claims(seed, folder, bases, Tally()) if bases else ""


@contextlib.contextmanager
def _without_report() -> Iterator[None]:
    """Diagnose without report and 3D recording, which take most of the time of a quick look."""
    names = ("twin.diagnose.output.write_report", "twin.diagnose.output.write_recording_of")
    with mock.patch(names[0]), mock.patch(names[1]):
        yield


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=math.inf, help="stop after this time")
    parser.add_argument("--full", type=float, default=0.05, help="share of cases that are not diagnosed with --quick")
    parser.add_argument("--only", metavar="NAME", default="", help="recordings whose name begins so")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder with recordings of real machines")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder with the results of the examples")
    args = parser.parse_args()
    bases = [b for b in pages(args.data.resolve(), args.out.resolve()) if b.recording.name.startswith(args.only)]
    print("recordings: " + ", ".join(b.recording.name for b in bases), flush=True)
    tally, faults, begin = Tally(), 0, time.monotonic()
    for seed in range(args.seed, args.seed + args.cases):
        if time.monotonic() > begin + 60.0 * args.minutes or not bases:
            break
        if seed % 20 == 0:
            print(f"seed {seed}: {sum(tally.reached.values())} cases, {dict(tally.reached)}, {tally.claims} claims", flush=True)
        if fault := one_case(lambda s, folder: claims(s, folder, bases, tally, args.full), seed, SECONDS):
            faults += 1
            print(f"seed {seed}: {fault}", flush=True)
    cases = sum(tally.reached.values())
    print(f"{cases} cases without a traceback in {time.monotonic() - begin:.0f} s: {dict(tally.reached)}; {faults} faults")
    print(f"{tally.claims} claims above {SURE}: {tally.caused} caused by the mutilation, {tally.wrong} wrong")
    return 1 if faults or not cases else 0


if __name__ == "__main__":
    raise SystemExit(main())
