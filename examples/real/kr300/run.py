"""Identify axes 1 to 3 of a robot with two encoders on each axis (KUKA KR300), starting from published parameters.

    python examples/real/kr300/run.py FF_A.mat FF_B.mat [--out out/kr300] [--diagnose]

The recordings are those of the MIT-licensed project Robot_Identification (J. Weigand and others); they are not part of this repository.
The first one is fitted, the others are held out. The robot's position controller is unknown, so the twin follows the measured path of the
motors, and torque and second encoder are compared. Gravity, coupling with other axes and the change of inertia are given by the authors'
model along the path as a known load.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import json
from pathlib import Path
import sys
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.io import loadmat
from scipy.signal import butter, savgol_filter, sosfiltfilt

from twin.cli.parser import show_and_run
from twin.errors import TwinError
from twin.machine.machine import Axis, Machine, load_machine
from twin.recordings.campaign import MeasuredRun, read_campaign
from twin.recordings.trace import LOADS, write_trace
from twin.simulation.gap import is_moving, predict
from twin.simulation.summary import table

AXES = ("1", "2", "3")
SMOOTHED = 15
"""Number of samples over which the path of a motor is smoothed before the twin follows it."""

KNOWN_HZ = 28.0
"""The smoothed path has no content above this frequency, so no machine file can explain the recorded torque there."""

FOLLOWED_S = 0.5e-3
"""Cycle of the twin's control, and of the record after resampling (spline). A command that is constant for the 4 ms of the record would cause a
saw-tooth in the torque as large as the torque of the inertia."""

LAG_S = 4e-3
"""Lag of the twin's speed loop on this path [s]."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recordings", type=Path, nargs="+", metavar="FF_A.mat", help="recordings; all but the first are held out")
    parser.add_argument("--out", type=Path, default=Path("out/kr300"), metavar="DIR", help="folder for all results")
    parser.add_argument("--diagnose", action="store_true", help="also diagnose the remaining gap")
    args = parser.parse_args(arguments)
    if missing := [str(f) for f in args.recordings if not f.is_file()]:
        print(f"run.py: {missing[0]}: no such file; skipped. Give the recordings of the project Robot_Identification", file=sys.stderr)
        return 2
    out = args.out
    try:
        show_and_run("import", *args.recordings, "--out", out / "imported")
        models = [model_of(f) for f in args.recordings]
        published = out / "published" / "machine.toml"
        published.parent.mkdir(parents=True, exist_ok=True)
        (published.parent / "axes.xml").write_text(model_xml(models[0]), encoding="utf-8")
        published.write_text(machine_text(models[0]), encoding="utf-8")
        machine = load_machine(published)
        runs = [following(run, model) for run, model in zip(read_campaign(out / "imported").runs, models)]
        write_campaign(out / "fitted", runs[:1], machine.name)
        identified = out / "identified" / "machine.toml"
        show_and_run("identify", out / "fitted", "--machine", published, "--out", identified)
        print(gaps_text({"published": machine, "identified": load_machine(identified)}, runs))
        print(bounds_text(machine, runs))
        print(angle_text(machine, runs))
        if args.diagnose:
            write_campaign(out / "both", runs, machine.name)
            show_and_run("diagnose", out / "both", "--machine", identified, "--out", out / "diagnosis")
    except TwinError as error:
        print(f"run.py: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


def write_campaign(folder: Path, runs: Sequence[MeasuredRun], machine: str) -> None:
    """A campaign of these runs."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f"machine = {json.dumps(machine)}"]
    for run in runs:
        write_trace(run.trace, folder / f"{run.name}.parquet")
        lines.append(f'[[run]]\nfile = "{run.name}.parquet"\nfeedforward = "velocity"')
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Model:
    """The authors' model of axes 1 to 3: parameters (axis,), and inertia and load along the path (axis, sample) at the joint [kg m2, Nm]."""

    ratio: np.ndarray
    rotor: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    inertia: np.ndarray
    load: np.ndarray  # gravity, Coriolis torque and torque by the other axes' accelerations


def model_of(file: Path) -> Model:
    """The authors' model in a recording. Their friction law Fc sign v + Fa atan(Fb v) is Coulomb friction Fc + Fa pi / 2 where the axis slides."""
    content: dict[str, Any] = loadmat(file, squeeze_me=True, struct_as_record=False)
    p, axes = content["para"], slice(0, len(AXES))
    load = content["tau_g_init"][axes, None] + content["tau_g_all"][axes] + content["tau_c_all"][axes] + content["tau_a_all"][axes]
    coulomb = p.f_coul[axes] + 0.5 * np.pi * p.f_a[axes]
    return Model(p.u[axes], p.J_mr[axes], coulomb, p.f_vis[axes], content["m_all"][axes], load)


def following(run: MeasuredRun, model: Model) -> MeasuredRun:
    """The run with the path of each motor as its set point, and the authors' loads beyond mean inertia and friction as known loads."""
    signals = {}
    for a, name in enumerate(AXES):
        path = savgol_filter(run.trace.get(name, "motor_position"), SMOOTHED, 3)
        acceleration = savgol_filter(run.trace.get(name, "motor_position"), SMOOTHED, 3, deriv=2, delta=run.trace.period)
        count = len(path)
        changing = (model.inertia[a, :count] - model.inertia[a].mean()) * acceleration
        signals[name, "setpoint"] = path
        signals[name, LOADS["Nm"]] = -(model.load[a, :count] + changing)
        signals |= {(name, s): run.trace.get(name, s) for s in ("position", "motor_position", "torque")}
    before = run.trace.time
    time = before[0] + FOLLOWED_S * np.arange(round((before[-1] - before[0]) / FOLLOWED_S) + 1)
    between = {key: CubicSpline(before, values)(time) for key, values in signals.items()}
    trace = replace(run.trace, time=time, signals=between, kinds=dict.fromkeys(AXES, "rotary"))
    return replace(run, trace=trace, feedforward="velocity")


def machine_text(model: Model) -> str:
    """A machine file: three rotary axes whose drives take a torque."""
    lines = [
        'name = "KR300, axes 1 to 3"\nmodel = "axes.xml"\ngravity_m_per_s2 = 0.0   # given along the path\nparameter_tolerance = 0.05',
        f'axis_order = ["1", "2", "3"]\n[control]\nspeed_cycle_us = {FOLLOWED_S * 1e6:g}\nposition_cycle_us = {FOLLOWED_S * 1e6:g}',
    ]
    for a, name in enumerate(AXES):
        u, inertia = model.ratio[a], model.rotor[a] + model.inertia[a].mean() / model.ratio[a] ** 2
        lines.append(f"""
[axis.{name}]
kind = "rotary"
structure = "P/PI"
encoder = "motor"
travel_deg = "endless"
max_velocity_rev_per_min = 20.0
max_acceleration_rev_per_s2 = 1.0
max_jerk_rev_per_s3 = 50.0
gear_ratio = {u:.6f}
rotor_and_gear_inertia_kg_m2 = {model.rotor[a]:.6g}
coulomb_friction_nm = {model.coulomb[a] / u:.6g}
viscous_friction_nm_s_per_rad = {model.viscous[a] / u**2:.6g}
[axis.{name}.actuator]
command = "torque"
peak_torque_nm = 50.0
[axis.{name}.loops]
position_gain_per_s = 20.0
speed_gain_nm_s_per_rad = {inertia / LAG_S:.6g}
speed_integral_time_s = 0.05
velocity_feedforward = 1.0""")
    lines.append(
        f"\n[measurement]\nsample_period_us = {FOLLOWED_S * 1e6:g}\nrotary_encoder_noise_deg = 0.0002\nmotor_encoder_noise_rad = 1e-6"
    )
    return "\n".join(lines) + "\n"


def model_xml(model: Model) -> str:
    """Three independent hinges, each with the mean inertia of its joint along the path."""
    bodies = "".join(
        f'<body name="body{n}" pos="0 {a} 0"><inertial pos="0 0 0" mass="1" diaginertia="{j:.6g} {j:.6g} {j:.6g}"/>'
        f'<joint name="{n}" type="hinge" axis="0 0 1"/></body>'
        for a, (n, j) in enumerate(zip(AXES, model.inertia.mean(axis=1)))
    )
    return f'<mujoco model="kr300"><compiler angle="radian" inertiafromgeom="false"/><worldbody>{bodies}</worldbody></mujoco>\n'


def gaps_text(machines: Mapping[str, Machine], runs: Sequence[MeasuredRun]) -> str:
    """RMS gap of torque [Nm at the motor], total and below KNOWN_HZ, and of the second encoder [arcsec], where the axes move."""
    rows = []
    for number, run in enumerate(runs):
        simulated = {label: predict(machine, run, realisations=1).trace for label, machine in machines.items()}
        known = butter(4, KNOWN_HZ, fs=1.0 / run.trace.period, output="sos")
        for name in AXES:
            row = [run.name, "fitted" if number == 0 else "held out", name]
            for signal, factor, slow in (("torque", 1.0, False), ("torque", 1.0, True), ("position", np.degrees(1.0) * 3600.0, False)):
                for label, machine in machines.items():
                    off = run.trace.get(name, signal) - simulated[label].get(name, signal)
                    off = (sosfiltfilt(known, off) if slow else off)[is_moving(run.trace, machine.axis(name))]
                    row.append(f"{float(np.sqrt(np.mean(off**2))) * factor:.3g}")
            rows.append(row)
    compared = ("torque", f"below {KNOWN_HZ:g} Hz", "second encoder")
    heading = ["run", "", "axis", *(f"{c}, {m}" for c in compared for m in machines)]
    return "\nRMS of the gap, torque in Nm at the motor, second encoder in arcsec:\n" + table(heading, rows, left=3)


def bounds_text(machine: Machine, runs: Sequence[MeasuredRun]) -> str:
    """How small a gap any law of position, speed and acceleration could leave of the torque [Nm at the motor], where the axes move.

    `friction` has inertia, constant and friction over the speed; `place` lets all of them change with the position, too. Each is fitted by
    least squares to the first run, and to the run itself: no law of that form leaves less there.
    """
    rows = []
    known = butter(4, KNOWN_HZ, fs=1.0 / runs[0].trace.period, output="sos")
    for run in runs[1:]:
        for name in AXES:
            axis = machine.axis(name)
            moving = is_moving(run.trace, axis)
            off = run.trace.get(name, "torque")
            row = [run.name, name, f"{_rms((off - sosfiltfilt(known, off))[moving]):.3g}"]
            for place in (False, True):
                columns, torque = _law(run, axis, place)
                for fitted in (runs[0], run):
                    taken, wanted = _law(fitted, axis, place)
                    values = np.linalg.lstsq(taken[is_moving(fitted.trace, axis)], wanted[is_moving(fitted.trace, axis)], rcond=1e-9)[0]
                    row.append(f"{_rms((torque - columns @ values)[moving]):.3g}")
            rows.append(row)
    heading = ["run", "axis", f"torque above {KNOWN_HZ:g} Hz", "friction", "fitted to itself", "and place", "fitted to itself"]
    return "\nRMS of what any law leaves of the torque, in Nm at the motor:\n" + table(heading, rows, left=2)


def angle_text(machine: Machine, runs: Sequence[MeasuredRun]) -> str:
    """Torque over the angle of axis 2 that the authors' model lacks, by least squares beside inertia and friction, from each recording alone.

    Two shapes: a parabola about angle zero and a free one. R2 compares the curve of the first recording with that of the other one over the
    angles of the other one; the constant is left out, because the friction's is the same.
    """
    axis, rows = machine.axis("2"), []
    for label, powers in (("parabola about zero", (2,)), ("free parabola", (1, 2))):
        curves = []
        for run in runs:
            columns, torque = _law(run, axis, place=False)
            path, moving = run.trace.get("2", "setpoint"), is_moving(run.trace, axis)
            taken = np.column_stack([columns[:, [0, 1, 2, 3, 5]], *(path**n for n in powers)])
            curves.append(np.linalg.lstsq(taken[moving], torque[moving], rcond=None)[0][-len(powers) :] / axis.ratio)
        for run, own in zip(runs[1:], curves[1:]):
            path = run.trace.get("2", "setpoint")
            angles = np.linspace(path.min(), path.max(), 100)
            first, second = (sum(c * angles**n for c, n in zip(curve, powers)) for curve in (curves[0], own))
            agreement = 1.0 - float(np.var(first - second) / np.var(second))
            coefficients = [", ".join(f"{c / 1e3:.2f}" for c in curve) for curve in (curves[0], own)]
            rows.append([run.name, label, *coefficients, f"{agreement:.2f}"])
    heading = ["run", "torque over angle of axis 2", "from the first run [kNm/rad^n]", "from this run", "R2"]
    return "\nTorque over the angle that the authors' model lacks, at the joint:\n" + table(heading, rows, left=2)


def _law(run: MeasuredRun, axis: Axis, place: bool) -> tuple[np.ndarray, np.ndarray]:
    """Columns (sample, term) of a law, each of RMS near 1, and the torque (sample,) less the given loads [Nm at the motor]."""
    path = run.trace.get(axis.name, "setpoint")
    speed = np.gradient(path, run.trace.period)
    acceleration = np.gradient(speed, run.trace.period)
    v, a, q = speed / 0.5, acceleration / 2.0, path / 0.5
    sign = np.tanh(v / 0.03)
    terms = [a, sign, v, np.ones_like(v), np.abs(v), v * np.abs(v), v**3, *(sign * np.exp(-np.abs(v) / w) for w in (0.05, 0.2, 0.8))]
    if place:
        terms += [t * shape for t in (a, sign, v, np.ones_like(v), v * np.abs(v)) for shape in (q, q**2)]
    return np.column_stack(terms), run.trace.get(axis.name, "torque") + run.trace.get(axis.name, LOADS["Nm"]) * axis.ratio


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    sys.exit(main())
