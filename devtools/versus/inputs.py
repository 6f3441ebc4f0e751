"""The inputs of the comparison: one axis, runs to fit, runs left out, and what is known of the truth, which no method sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import importlib.util
import json
from pathlib import Path
import shutil
import sys
from typing import Any

import numpy as np

from twin.cli.parser import show_and_run
from twin.documents import read_toml
from twin.effects import with_effects
from twin.effects.truth import true_machine
from twin.exam.draw import SHIPPED_MACHINE, Case, draw_case, truth_of, write_campaign
from twin.exam.questions import RICHNESS
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine, load_machine, write_machine
from twin.recordings.campaign import MeasuredRun, read_campaign
from twin.recordings.trace import write_trace
from twin.simulation.campaign_file import write_campaign as twin_campaign
from twin.simulation.plant_spec import with_commissioned_inertia
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

from .numbers import MECHANICS, drive_force, numbers_of, with_numbers

HERE = Path(__file__).resolve().parent
KR300 = HERE.parents[1] / "examples" / "real" / "kr300" / "run.py"
EMPS = HERE.parents[1] / "examples" / "emps"


@dataclass(frozen=True)
class Input:
    """What a method is given: a machine file with one driven axis and a campaign folder of fitted runs, both also as read."""

    file: Path
    campaign: Path
    machine: Machine
    fitted: tuple[MeasuredRun, ...]

    @property
    def axis(self) -> str:
        return self.machine.axis_names[0]


@dataclass(frozen=True)
class Known:
    """What is known of an input: runs left out, the machine file with its noise, numbers of the true machine ({} if unknown), true causes
    (None if unknown), one line of description."""

    text: str
    machine: Machine
    held_out: tuple[MeasuredRun, ...]
    numbers: dict[str, float]
    causes: tuple[str, ...] | None
    outside: bool = False


def given(file: Path, campaign: Path) -> Input:
    """The input in a machine file and a campaign folder."""
    machine = with_commissioned_inertia(load_machine(file))
    return Input(file, campaign, machine, read_campaign(campaign, machine).runs)


def emps(data: Path, out: Path) -> tuple[Input, Known]:
    """The EMPS benchmark: two thirds fitted, the last third left out. The truth is unknown; the published numbers stand in its place."""
    for part, name in (("fit", "two_thirds.toml"), ("check", "last_third.toml")):
        show_and_run("import", data / "emps" / "DATA_EMPS.mat", "--map", EMPS / name, "--out", out / part, "--no-picture")
    one = given(EMPS / "axis.toml", out / "fit")
    published = {"inertia": 95.1089, "coulomb_friction": 20.3935, "viscous_friction": 203.5034, "constant_force": -3.1648}
    return one, Known("EMPS", one.machine, read_campaign(out / "check", one.machine).runs, published, None)


def kr300(data: Path, out: Path) -> tuple[Input, Known]:
    """Axis 1 of the KR300 robot, prepared as in examples/real/kr300: recording A fitted, B left out. The truth is unknown."""
    spec = importlib.util.spec_from_file_location("kr300_run", KR300)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = script  # its dataclass looks there
    spec.loader.exec_module(script)
    recordings = [data / "kr300" / name for name in ("FF_A.mat", "FF_B.mat")]
    show_and_run("import", *recordings, "--out", out / "imported", "--no-picture")
    models = [script.model_of(file) for file in recordings]
    (out / "axes.xml").write_text(script.model_xml(models[0]), encoding="utf-8")
    (out / "all.toml").write_text(script.machine_text(models[0]), encoding="utf-8")
    file = out / "machine" / "machine.toml"
    file.parent.mkdir(exist_ok=True)
    write_machine(load_machine(out / "all.toml").with_axes(["1"]), file)
    runs = []
    for run, model in zip(read_campaign(out / "imported").runs, models):
        followed = script.following(run, model)
        one = replace(followed, trace=followed.trace.select(["1"]), facts={k: v for k, v in followed.facts.items() if k[0] == "1"})
        runs.append(script.resampled(one))
    script.write_campaign(out / "fit", runs[:1], "KR300")
    one = given(file, out / "fit")
    return one, Known("KR300, axis 1", one.machine, tuple(runs[1:]), {}, None)


FITTED_SHARE = 0.7
"""Share of the travel of a single run that the methods are given, from its start."""


def recorded(recording: Path, axis: str, text: str, out: Path) -> tuple[Input, Known]:
    """One axis of a recording without a data sheet: the last of its runs left out, of a single run the last part of its travel. All methods begin with
    the machine file that `twin machine new` makes of the fitted part. The truth is unknown. What an earlier call left in `out` is made again."""
    shutil.rmtree(out, ignore_errors=True)
    show_and_run("import", recording, "--out", out / "imported", "--no-picture")
    runs = [run for run in read_campaign(out / "imported").runs if run.trace.has(axis, "setpoint") and run.trace.moves(axis)]
    if len(runs) == 1:
        travel = np.abs(np.diff(runs[0].trace.get(axis, "setpoint"))).cumsum()
        cut = int(np.searchsorted(travel, FITTED_SHARE * travel[-1]))
        runs = [_part(runs[0], slice(cut)), _part(runs[0], slice(cut, None))]
    for part, some in (("fit", runs[:-1]), ("check", runs[-1:])):
        alone = [replace(run, trace=run.trace.select([axis]), facts={k: v for k, v in run.facts.items() if k[0] == axis}) for run in some]
        twin_campaign({f"{part}_{i}": run for i, run in enumerate(alone)}, out / part)
    file = out / "machine" / "machine.toml"
    show_and_run("machine", "new", "--from-recording", out / "fit", "--out", file)
    machine = given(file, out / "fit").machine
    write_machine(_without_zeros(machine, read_campaign(out / "fit", machine).runs), file)
    one = given(file, out / "fit")
    return one, Known(text, one.machine, read_campaign(out / "check", one.machine).runs, {}, None)


def _without_zeros(machine: Machine, runs: Sequence[MeasuredRun]) -> Machine:
    """The machine with a small friction in place of none, since the other methods search about the size that they are given."""
    (axis,), start = machine.axes, numbers_of(machine)
    force = START_SHARE * max(float(np.sqrt(np.mean(drive_force(axis, run.trace) ** 2))) for run in runs)
    speed = max(float(np.abs(np.gradient(run.trace.get(axis.name, "setpoint"), run.trace.period)).max()) for run in runs)
    least = {"coulomb_friction": force, "viscous_friction": force / speed}
    return with_numbers(machine, {name: value for name, value in least.items() if start[name] == 0.0})


def _part(run: MeasuredRun, rows: slice) -> MeasuredRun:
    """These samples of a run, from time zero on."""
    part = run.trace.samples(rows)
    return replace(run, trace=replace(part, time=part.time - part.time[0]))


START_SHARE = 0.05
"""Share of the recorded force with which a friction begins that the machine file does not have."""

STROKES = {  # run -> (stroke [m], speed [m/s]) there and back
    "fast": ((0.2, 0.12), (0.1, 0.08)),
    "slow": ((0.02, 0.02), (0.05, 0.05), (0.1, 0.12)),
    "left_out": ((0.15, 0.1), (0.03, 0.03)),
}


def simulated(out: Path, changes: Mapping[str, float], effects: Sequence[Mapping[str, Any]] = ()) -> tuple[Input, Known]:
    """A small input that the twin makes itself, without any file of others: the axis of the EMPS example with numbers changed by these factors
    and with effects; five seconds of strokes fitted, three left out, with the noise of its encoder."""
    machine = with_commissioned_inertia(load_machine(EMPS / "axis.toml"))
    numbers = {name: factor * numbers_of(machine)[name] for name, factor in changes.items()}
    true = with_effects(with_numbers(machine, numbers), effects)
    (axis,) = machine.axes
    for part, names in (("fit", ("fast", "slow")), ("check", ("left_out",))):
        (out / part).mkdir(parents=True, exist_ok=True)
        lines = ['machine = "EMPS"']
        for i, name in enumerate(names):
            moves = [(sign * stroke, speed) for stroke, speed in STROKES[name] for sign in (1, -1)]
            pieces, at = [], 0.0
            for stroke, speed in moves:
                _, position = moves_in_turn(at, [stroke], speed, axis.max_acceleration, axis.max_jerk, 0.1, 1e-3)
                pieces.append(position)
                at = float(position[-1])
            run = simulate(true, Setpoints(np.concatenate(pieces)[:, None], 1e-3), noise_seed=i)
            trace = replace(
                run.trace, signals={k: v for k, v in run.trace.signals.items() if k[1] in ("setpoint", "motor_position", "voltage")}
            )
            write_trace(trace, out / part / f"{name}.parquet")
            lines.append(f'[[run]]\nfile = "{name}.parquet"\nfeedforward = "off"')
        (out / part / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    causes = tuple(str(e["name"]) for e in effects)
    text = f"simulated: {', '.join(causes) or 'no effect'}"
    known = Known(text, machine, read_campaign(out / "check", machine).runs, mechanics_of(true), causes)
    return given(EMPS / "axis.toml", out / "fit"), known


def mechanics_of(machine: Machine) -> dict[str, float]:
    """The true mechanical numbers of the driven axis."""
    return {name: value for name, value in numbers_of(machine).items() if name in MECHANICS}


SHORT = ("constant_velocity", "acceleration")


def made(kind: str, seed: int, axis: str, out: Path, runs: Sequence[str] | None = SHORT) -> tuple[Input, Known]:
    """One axis of a machine that the examination draws: kind as in `twin exam`, its own runs left out.

    `runs` keeps only the named runs of the short campaign; None: all four.
    """
    table = read_toml(SHIPPED_MACHINE)
    case = draw_case(seed, kind, table, axis=axis if kind in ("single", "outside") else None, richness=RICHNESS["small"], run_set="short")
    file = out / "machine.toml"
    out.mkdir(parents=True, exist_ok=True)
    write_machine(load_machine(SHIPPED_MACHINE).with_axes([axis]), file)
    machine = load_machine(file)
    fitted = _one_axis(case, table, machine, "short", out / "fit", runs)
    held_out = _one_axis(case, table, machine, "exam", out / "check", None)
    truth = truth_of(case)
    causes = tuple(e["name"] for e in (*truth["effect"], *truth["outside"]) if e["axis"] == axis)
    true = mechanics_of(true_machine(load_machine(SHIPPED_MACHINE), {"parameter": truth["parameter"]}).with_axes([axis]))
    for effect in truth["effect"]:  # effects that are a change of one of the numbers
        if effect["axis"] == axis and effect["name"] == "constant_force":
            true["constant_force"] += effect["force"]
        elif effect["axis"] == axis and effect["name"] in true and "factor" in effect:
            true[effect["name"]] *= effect["factor"]
    text = f"made, {axis}: {f'{len(causes)} small effects' if len(causes) > 2 else ', '.join(causes) or 'no effect'}"
    known = Known(text, machine, read_campaign(held_out, machine).runs, true, causes, bool(truth["outside"]))
    return given(file, fitted), known


def _one_axis(case: Case, table: dict, machine: Machine, run_set: str, folder: Path, kept: Sequence[str] | None) -> Path:
    """The campaign folder of one axis of a case: runs in which it moves, without the columns of the other axes."""
    whole = folder.with_name(folder.name + "_whole")
    if not (whole / "campaign.toml").exists():
        write_campaign(case, whole, table, runs=run_set)
    folder.mkdir(exist_ok=True)
    lines = [f"machine = {json.dumps(machine.name)}"]
    (name,) = machine.axis_names
    for run in read_campaign(whole, load_machine(SHIPPED_MACHINE)).runs:
        signals = {key: values for key, values in run.trace.signals.items() if key[0] == name}
        moves = float(signals[name, "setpoint"].max() - signals[name, "setpoint"].min()) > 1e-5
        if not moves or (kept is not None and run.name not in kept):
            continue
        write_trace(replace(run.trace, signals=signals, kinds=machine.kinds), folder / f"{run.name}.parquet")
        lines.append(f'[[run]]\nfile = "{run.name}.parquet"\nfeedforward = "{run.feedforward}"\nstarted_at_s = {run.started_at:.3f}')
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder
