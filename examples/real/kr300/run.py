"""Identify axes 1 to 3 of a robot with two encoders on each axis (KUKA KR300), starting from published parameters.

    python examples/real/kr300/run.py FF_A.mat FF_B.mat [--out out/kr300] [--diagnose]

The recordings are those of the MIT-licensed project Robot_Identification (J. Weigand and others); they are not part of this repository.
The first one is fitted, the others are held out. The robot's position controller is unknown, so the twin follows the measured path of the
motors, and torque and second encoder are compared. Gravity, coupling with other axes and the change of inertia are given by the authors'
model along the path as a known load. The twin starts with rigid axes; identification finds the elasticity of the arm as a structural mode.
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
from scipy.interpolate import make_interp_spline
from scipy.io import loadmat

from twin.cli.parser import show_and_run
from twin.effects import with_effects
from twin.errors import TwinError
from twin.machine.machine import Axis, Machine, load_machine
from twin.recordings.campaign import MeasuredRun, read_campaign
from twin.recordings.trace import LOADS, Trace, write_trace
from twin.simulation.gap import is_moving, predict
from twin.simulation.summary import table

AXES = ("1", "2", "3")
CYCLE_S = 0.125e-3
"""Cycle of the twin's control, which follows a spline through the recorded path. Commands that are constant for the 4 ms of the record would cause
a saw-tooth in the torque as large as the torque of the inertia."""

LAG_S = 2e-3
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
        rigid = load_machine(published)
        runs = [following(run, model) for run, model in zip(read_campaign(out / "imported").runs, models)]
        fine = [resampled(run) for run in runs]
        write_campaign(out / "fitted", fine[:1], rigid.name)
        identified = out / "identified" / "machine.toml"
        show_and_run("identify", out / "fitted", "--machine", published, "--out", identified)
        machines = {"rigid": rigid, "their stiffness": with_stiffness(rigid, models[0]), "identified": load_machine(identified)}
        predicted = {label: [predict(machine, run, realisations=1).trace for run in fine] for label, machine in machines.items()}
        print(gaps_text(machines, fine, predicted))
        print(modes_text(models[0], machines["identified"]))
        print(angle_text(rigid.axis("2"), fine, predicted["identified"]))
        write_campaign(out / "both", runs, rigid.name)
        if args.diagnose:
            show_and_run("diagnose", out / "both", "--machine", identified, "--out", out / "diagnosis")
    except TwinError as error:
        print(f"run.py: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


def write_campaign(folder: Path, runs: Sequence[MeasuredRun], machine: str) -> None:
    """A campaign of these runs. The import took out the constant difference of the encoders, so that the mean of their difference carries nothing."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f"machine = {json.dumps(machine)}"]
    for run in runs:
        write_trace(run.trace, folder / f"{run.name}.parquet")
        lines.append(f'[[run]]\nfile = "{run.name}.parquet"\nfeedforward = "velocity"')
        for (axis, signal), fact in run.facts.items():
            if axis in AXES and fact.offset_taken_out:
                lines.append(
                    f'[[run.channel]]\naxis = "{axis}"\nsignal = "{signal}"\noffset_rad = {fact.offset:.9g}\noffset_taken_out = true'
                )
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Model:
    """The authors' model of axes 1 to 3: parameters (axis,), inertia and load along the path (axis, sample) at the joint, SI."""

    ratio: np.ndarray
    rotor: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    stiffness: np.ndarray
    inertia: np.ndarray
    load: np.ndarray  # gravity, Coriolis torque, torque by the other axes' accelerations and by the change of inertia


def model_of(file: Path) -> Model:
    """The authors' model in a recording. Their friction law Fc sign v + Fa atan(Fb v) is Coulomb friction Fc + Fa pi / 2 where the axis slides."""
    content: dict[str, Any] = loadmat(file, squeeze_me=True, struct_as_record=False)
    p, axes = content["para"], slice(0, len(AXES))
    load = content["tau_g_init"][axes, None] + content["tau_g_all"][axes] + content["tau_c_all"][axes] + content["tau_a_all"][axes]
    coulomb = p.f_coul[axes] + 0.5 * np.pi * p.f_a[axes]
    inertia = content["m_all"][axes]
    changing = (inertia - inertia.mean(axis=1, keepdims=True)) * content["ref_kin"].phi_r_all_d2.T[axes]
    return Model(p.u[axes], p.J_mr[axes], coulomb, p.f_vis[axes], p.c_rad_ode[axes], inertia, load + changing)


def following(run: MeasuredRun, model: Model) -> MeasuredRun:
    """The run with the path of each motor as its set point, and the authors' loads beyond mean inertia and friction as known loads.

    The path is not smoothed: the arms vibrate at 7 to 10 Hz, and the motors feel it up to the highest recorded frequencies.
    """
    signals: dict[tuple[str, str], np.ndarray] = {}
    for a, name in enumerate(AXES):
        signals |= {(name, s): run.trace.get(name, s) for s in ("position", "motor_position", "torque")}
        signals[name, "setpoint"] = signals[name, "motor_position"]
        signals[name, LOADS["Nm"]] = -model.load[a, : len(run.trace.time)]
    return replace(run, trace=replace(run.trace, signals=signals, kinds=dict.fromkeys(AXES, "rotary")), feedforward="velocity")


def resampled(run: MeasuredRun) -> MeasuredRun:
    """The run with a sample in every cycle of the twin's control, by splines, as identification requires. It holds no more than before."""
    before = run.trace.time
    time = before[0] + CYCLE_S * np.arange(round((before[-1] - before[0]) / CYCLE_S) + 1)
    signals = {key: make_interp_spline(before, values, k=5)(time) for key, values in run.trace.signals.items()}
    return replace(run, trace=replace(run.trace, time=time, signals=signals))


def machine_text(model: Model) -> str:
    """A machine file: three rotary axes whose drives take a torque."""
    lines = [
        'name = "KR300, axes 1 to 3"\nmodel = "axes.xml"\ngravity_m_per_s2 = 0.0   # given along the path\nparameter_tolerance = 0.05',
        f'axis_order = ["1", "2", "3"]\n[control]\nspeed_cycle_us = {CYCLE_S * 1e6:g}\nposition_cycle_us = {CYCLE_S * 1e6:g}',
    ]
    for a, name in enumerate(AXES):
        u, inertia = model.ratio[a], model.rotor[a] + model.inertia[a].mean() / model.ratio[a] ** 2
        lines.append(f"""
[axis.{name}]
kind = "rotary"
structure = "P/PI"
encoder = "motor"
friction_side = "motor"
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
    lines.append("\n[measurement]\nsample_period_us = 4000\nrotary_encoder_noise_deg = 0.0002\nmotor_encoder_noise_rad = 1e-6")
    return "\n".join(lines) + "\n"


def model_xml(model: Model) -> str:
    """Three independent hinges, each with the mean inertia of its joint along the path."""
    bodies = "".join(
        f'<body name="body{n}" pos="0 {a} 0"><inertial pos="0 0 0" mass="1" diaginertia="{j:.6g} {j:.6g} {j:.6g}"/>'
        f'<joint name="{n}" type="hinge" axis="0 0 1"/></body>'
        for a, (n, j) in enumerate(zip(AXES, model.inertia.mean(axis=1)))
    )
    return f'<mujoco model="kr300"><compiler angle="radian" inertiafromgeom="false"/><worldbody>{bodies}</worldbody></mujoco>\n'


def with_stiffness(rigid: Machine, model: Model) -> Machine:
    """The machine with the authors' stiffness of the joints, between motor and second encoder."""
    return with_effects(
        rigid, [{"name": "transmission_compliance", "axis": n, "stiffness": float(k)} for n, k in zip(AXES, model.stiffness)]
    )


def gaps_text(machines: Mapping[str, Machine], runs: Sequence[MeasuredRun], predicted: Mapping[str, Sequence[Trace]]) -> str:
    """RMS gap of the torque [Nm at the motor] and of the second encoder [arcsec] where the axes move."""
    rows = []
    for number, run in enumerate(runs):
        for name in AXES:
            moving = is_moving(run.trace, machines["rigid"].axis(name))
            row = [run.name, "fitted" if number == 0 else "held out", name]
            for signal, factor in (("torque", 1.0), ("position", np.degrees(1.0) * 3600.0)):
                off = [(run.trace.get(name, signal) - predicted[label][number].get(name, signal))[moving] for label in machines]
                row += [f"{_rms(gap) * factor:.3g}" for gap in off]
                row += [f"{1.0 - _rms(off[-1]) / _rms(off[0]):.0%}"] if signal == "torque" else []
            rows.append(row)
    first, second = [f"torque, {m}" for m in machines], [f"second encoder, {m}" for m in machines]
    return "\nRMS of the gap, torque in Nm at the motor, second encoder in arcsec:\n" + table(
        ["run", "", "axis", *first, "reduced by", *second], rows, left=3
    )


def modes_text(model: Model, identified: Machine) -> str:
    """Natural frequencies of the arm with the motor held [Hz]."""
    theirs = np.sqrt(model.stiffness / model.inertia.mean(axis=1)) / (2.0 * np.pi)
    rows = [[name, f"{by:.2f}", f"{identified.axis(name).mode_frequency_hz:.2f}"] for name, by in zip(AXES, theirs)]
    return "\nNatural frequency of the arm with the motor held, Hz:\n" + table(["axis", "by their stiffness", "identified"], rows, left=1)


def angle_text(axis: Axis, runs: Sequence[MeasuredRun], predicted: Sequence[Trace]) -> str:
    """Torque over the angle of axis 2 that the model lacks, from each recording alone: least squares on what is left, beside friction.

    R2 compares the curve of the first recording with that of the other one over the angles of the other one, without the constant.
    """
    curves = []
    for run, trace in zip(runs, predicted):
        path, moving = run.trace.get(axis.name, "setpoint"), is_moving(run.trace, axis)
        speed = np.gradient(path, run.trace.period)
        columns = np.column_stack([np.ones_like(path), np.sign(speed), speed, path, path**2])[moving]
        left = (run.trace.get(axis.name, "torque") - trace.get(axis.name, "torque"))[moving]
        curves.append(np.linalg.lstsq(columns, left, rcond=None)[0][-2:] / axis.ratio / 1e3)
    rows = []
    for run, own in zip(runs[1:], curves[1:]):
        path = run.trace.get(axis.name, "setpoint")
        angles = np.linspace(path.min(), path.max(), 100)
        first, second = (c[0] * angles + c[1] * angles**2 for c in (curves[0], own))
        coefficients = [", ".join(f"{c:.2f}" for c in curve) for curve in (curves[0], own)]
        rows.append([run.name, *coefficients, f"{1.0 - float(np.var(first - second) / np.var(second)):.2f}"])
    heading = ["run", "from the first run [kNm/rad, kNm/rad2]", "from this run", "R2"]
    return f"\nTorque over the angle of axis {axis.name} that the model lacks, at the joint, as a parabola:\n" + table(
        heading, rows, left=1
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    sys.exit(main())
