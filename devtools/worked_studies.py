"""The worked studies of docs/worked_studies.md: runs them and prints their numbers, with closed forms.

python devtools/worked_studies.py [--studies FOLDER] [--only NAME]     into FOLDER (default out/studies), resumed where they are there
"""

from __future__ import annotations

import argparse
from dataclasses import replace
import math
from pathlib import Path

import numpy as np
import pyarrow.parquet

from twin.cli import main as twin
from twin.geometry.scurve import time_of_move
from twin.machine.machine import Machine, load_machine
from twin.study.design import machine_of
from twin.study.evaluate import evaluate, work_of
from twin.study.paths import with_numbers
from twin.study.results import surrogate_from
from twin.study.spec import read_study

EXAMPLES = Path(__file__).resolve().parent.parent / "examples" / "studies"
Table = dict[str, np.ndarray]


def carried_out(name: str, studies: Path) -> Path:
    """The folder of a worked study, simulated as far as necessary."""
    folder = studies / name
    if twin(["study", str(EXAMPLES / f"{name}.toml"), "--out", str(folder), "--resume", "--no-replay", "--quiet"]):
        raise SystemExit(2)
    return folder


def table_of(folder: Path) -> Table:
    """Factors and responses of a finished study, each (variant,)."""
    table = pyarrow.parquet.read_table(folder / "table.parquet")
    return {name: table.column(name).to_numpy() for name in table.column_names if name != "reason"}


def span(values: np.ndarray) -> str:
    """Least and largest."""
    return f"{values.min():.2f} to {values.max():.2f}"


def corner(out: Path) -> None:
    """Carriage mass in a corner; a speed controller with integral time Tn leaves an error J Tn jerk / (Kp Kv) at constant jerk."""
    t, machine = table_of(out), load_machine()
    contour, deviation, gain = t["contour_error_max_um"], t["control_deviation_max_X_um"], t["position gain"]
    own = gain == 1.0
    print(f"largest contour error, um: {span(contour[own])}; with the position gain at 0.7 to 1.4 times {span(contour)}")
    light, heavy = (contour[own & (t["X mass"] == mass) & (t["Y saddle"] == 1150.0)][0] for mass in (500.0, 900.0))
    print(f"  X from 500 to 900 kg changes it by {heavy - light:+.3f}")
    for factor in (0.7, 1.0, 1.4):
        here = (gain == factor) & (t["X mass"] == 500.0)
        print(f"  gain x {factor:g}, X of 500 kg: deviation of X {deviation[here].mean():.2f}, contour error {contour[here].mean():.2f}")
    friction_share()
    nominal = {"X mass": 700.0, "Y saddle": 1050.0, "position gain": 1.0}
    print("control deviation for 100 kg more, um: study, and r^2 Tn jerk / (Kp Kv)")
    for axis, factor, mass in (("X", "X mass", 700.0), ("Y", "Y saddle", 1050.0)):
        predict = surrogate_from(out, f"control_deviation_max_{axis}_um")
        more = predict({**nominal, factor: nominal[factor] + 100.0})[0] - predict({**nominal, factor: nominal[factor] - 100.0})[0]
        a = machine.axis(axis)
        theory = 100.0 * a.ratio**2 * a.loops.speed_integral_time_s * a.max_jerk
        theory /= a.loops.speed_gain_nm_s_per_rad * a.loops.position_gain_per_s
        share = mass * a.ratio**2 / a.commissioned_inertia
        print(f"  {axis}: {more / 2:.4f}, {theory * 1e6:.4f}; {mass:g} kg are {100 * share:.0f} % of the inertia at the motor")


def friction_share() -> None:
    """The nominal corner with and without Coulomb friction on X and Y."""
    study = read_study(EXAMPLES / "corner_mass.toml")
    smooth = with_numbers(study.machine, {f"axis.{axis}.coulomb_friction_nm": 0.0 for axis in "XY"})
    print("corner of the present machine, um: deviation of X, contour error")
    for words, machine in (("with Coulomb friction", study.machine), ("without", smooth)):
        found = evaluate(replace(work_of(study), study=replace(study, machine=machine)), (700.0, 1050.0, 1.0)).responses
        print(f"  {words}: {found['control_deviation_max_X_um']:.2f}, {found['contour_error_max_um']:.2f}")


def least_at(out: Path, response: str, rotor: float, low: float, high: float) -> tuple[float, float]:
    """Lead [m] and value at the minimum of a response on the study's surrogate."""
    predict = surrogate_from(out, response)
    leads = np.linspace(low, high, 2001)
    values = [predict({"screw lead": float(lead), "rotor inertia": rotor})[0] for lead in leads]
    i = int(np.argmin(values))
    return float(leads[i]), values[i]


def rigid_body_current(machine: Machine, tilt: np.ndarray, turn: np.ndarray, period: float) -> np.ndarray:
    """Current of A (sample,) from rigid bodies: friction, gravity m g y and the change of the angular momentum about A.

    A body at y (rotated by C) and z from the axis of A has L = (I + m (y^2 + z^2)) A' - m z y', which includes the motion of C.
    """
    a = machine.axis("A")
    speed = np.gradient(tilt, period)
    torque = a.coulomb_friction * np.sign(speed) + a.viscous_friction * speed
    momentum = a.reflected_inertia * speed
    for body in machine.bodies:
        c = np.zeros(len(turn)) if body.name == "cradle" else turn
        x, y, z = body.centre_of_mass_m
        y_turned = x * np.sin(c) + y * np.cos(c)
        inertia = body.inertia_kg_m2[0] * np.cos(c) ** 2 + body.inertia_kg_m2[1] * np.sin(c) ** 2 + body.mass_kg * (y_turned**2 + z**2)
        torque += body.mass_kg * machine.gravity * (y_turned * np.cos(tilt) - z * np.sin(tilt))
        momentum += inertia * speed - body.mass_kg * z * np.gradient(y_turned, period)
    return (torque + np.gradient(momentum, period)) * a.ratio / a.motor.torque_constant_nm_per_a


def payload_currents(out: Path) -> tuple[np.ndarray, np.ndarray]:
    """Largest current of A of every variant (variant,): simulated, and from rigid bodies."""
    study = read_study(EXAMPLES / "table_payload.toml")
    setpoints = work_of(study).sources[0].setpoints
    if setpoints is None:
        raise AssertionError("the path is the same for all variants")
    tilt, turn = setpoints.position[:, 3], setpoints.position[:, 4]
    rows = pyarrow.parquet.read_table(out / "table.parquet").to_pylist()
    machines = [machine_of(study, np.array([row[f.name] for f in study.factors])) for row in rows]
    theory = [float(np.abs(rigid_body_current(m, tilt, turn, setpoints.period)).max()) for m in machines]
    return np.array([row["current_smooth_max_A_a"] for row in rows]), np.array(theory)


def payload(out: Path) -> None:
    """Influence of mass and place of a payload; the largest current of A against that of rigid bodies."""
    t, limit = table_of(out), load_machine().axis("A").motor.peak_current_a
    found, theory = payload_currents(out)
    most, mass = int(np.argmax(found)), t["payload mass"]
    # the variant with the least current among those about as heavy as the worst one
    alike = np.flatnonzero(np.abs(mass - mass[most]) < 15.0)
    least = alike[np.argmin(found[alike])]
    print(f"largest current of A, A: {span(found)}, {100 * found[most] / limit:.0f} % of its limit; rigid bodies {span(theory)}")
    print(
        f"  {mass[most]:.0f} kg take {found[most]:.2f}, {mass[least]:.0f} kg at another place {found[least]:.2f}: {found[most] / found[least]:.1f} times"
    )
    error = found - theory
    print(f"  study less rigid bodies over {len(found)} variants: mean {error.mean():+.3f}, RMS about it {error.std():.3f}")
    for name, unit in (
        ("control_deviation_max_A_arcsec", "arcsec"),
        ("control_deviation_max_C_arcsec", "arcsec"),
        ("contour_error_max_um", "um"),
    ):
        print(f"{name}: {span(t[name])} {unit}, {np.ptp(t[name]):.2f} apart")


def lead(out: Path) -> None:
    """Influence of the lead on the present machine and with half the rotor."""
    t = table_of(out)
    print("at leads of 10, 20 and 30 mm: largest smooth current, A; copper loss of X, W; rapid move, s")
    for rotor in (1.0, 0.5):
        for mm in (10.0, 20.0, 30.0):
            i = int(np.argmin(np.abs(t["screw lead"] - mm * 1e-3) + 10.0 * np.abs(t["rotor inertia"] - rotor)))
            current, loss, time = (
                t[name][i] for name in ("set_points.current_smooth_max_X_a", "set_points.copper_loss_X_w", "rapid.cycle_time_s")
            )
            print(f"  rotor x {rotor:g}, {t['screw lead'][i] * 1e3:.1f} mm: {current:.2f}, {loss:.2f}, {time:.2f}")


def matching(out: Path) -> None:
    """Torque over acceleration (J + m r^2) / r is least at r = sqrt(J / m); viscous friction b v adds b v / a to J."""
    machine = load_machine()
    x = machine.axis("X")
    jerk, speed = 5.0, 0.25
    a_peak = math.sqrt(speed * jerk)  # the move of x_200mm.csv does not reach its acceleration limit: constant jerk up and down
    print("lead of least current, mm: study, sqrt(J / m), and with viscous friction at half speed")
    for rotor in (0.5, 1.0, 2.0):
        inertia = rotor * x.rotor_inertia_kg_m2
        plain = math.sqrt(inertia / x.moving_mass_kg)
        friction = math.sqrt((inertia + x.viscous_friction_nm_s_per_rad * 0.5 * speed / a_peak) / x.moving_mass_kg)
        lead, value = least_at(out, "set_points.current_smooth_max_X_a", rotor, 0.01, 0.06)
        cost = (inertia / friction + x.moving_mass_kg * friction) * a_peak + x.coulomb_friction_nm
        cost += x.viscous_friction_nm_s_per_rad * 0.5 * speed / friction
        torque = cost / x.motor.torque_constant_nm_per_a
        print(
            f"  rotor x {rotor:g}: {lead * 1e3:.1f}, {plain * 2e3 * math.pi:.1f}, {friction * 2e3 * math.pi:.1f}; "
            f"current {value:.2f} A, torque of the law over Kt {torque:.2f} A"
        )
    print("lead of the shortest rapid move, mm, and its time, s: study, jerk-limited moves in closed form")
    for rotor in (0.5, 1.0, 2.0):
        leads = np.linspace(0.01, 0.06, 501)
        times = [rapid_time(machine, rotor, float(lead)) for lead in leads]
        i = int(np.argmin(times))
        lead, value = least_at(out, "rapid.cycle_time_s", rotor, 0.01, 0.06)
        print(f"  rotor x {rotor:g}: {lead * 1e3:.1f} ({value:.3f}), {leads[i] * 1e3:.1f} ({times[i]:.3f} without pauses at the stops)")


def rapid_time(machine: Machine, rotor: float, lead: float) -> float:
    """Two moves of 600 mm with the limits of the study."""
    x = machine.axis("X")
    nominal_inertia = x.rotor_inertia_kg_m2 + x.moving_mass_kg * x.ratio**2
    ratio = lead / (2.0 * math.pi * x.ratio)
    inertia = rotor * x.rotor_inertia_kg_m2 + x.moving_mass_kg * (lead / (2.0 * math.pi)) ** 2
    force = ratio * nominal_inertia / inertia
    return 2.0 * time_of_move(0.6, 22.0 / 60.0 * ratio, x.max_acceleration * force, 50.0 * force)


STUDIES = {"corner_mass": (corner,), "table_payload": (payload,), "inertia_matching": (lead, matching)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--studies", type=Path, default=Path("out") / "studies", metavar="FOLDER")
    parser.add_argument("--only", choices=STUDIES)
    args = parser.parse_args()
    for name in [args.only] if args.only else STUDIES:
        folder = carried_out(name, args.studies)
        print(f"\n{name}")
        for said in STUDIES[name]:
            said(folder)


if __name__ == "__main__":
    main()
