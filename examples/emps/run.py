"""Import, identify and diagnose the record of a real axis, and compare the result with its published model.

    python examples/emps/run.py DATA_EMPS.mat [--out out/emps] [--quick]

The record is that of the EMPS benchmark (Janot, Gautier, Brunot 2019) and is not part of this repository: 24.84 s at 1 kHz of a set
point, one motor encoder and a drive voltage. The first two thirds are fitted; the gap is evaluated on the held-out last third.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
import json
import math
from pathlib import Path
import sys
from typing import Any

import numpy as np
from single_axis import Record, fit_single_axis, read_emps

from twin.cli.parser import show_and_run
from twin.diagnose.tolerance import with_added
from twin.effects import check_setting
from twin.errors import TwinError
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import MeasuredRun, read_campaign
from twin.report import new_figure, save_png
from twin.simulation.gap import Prediction, gap_of, predict
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints
from twin.simulation.summary import table

HERE = Path(__file__).resolve().parent
MACHINE = HERE / "axis.toml"
PUBLISHED_OFFSET_N = -3.16
"""The constant force of the published model [N]. axis.toml does not contain it, so identification has to find it."""

PUBLISHED_FORCE_ERROR = 0.0408
"""Relative force error of the published model on this record."""

LEAD_M = 0.0025
PERIOD_S = 6.24
"""Period of the set points of the record."""

NEXT_BEST = 0.02
"""Least share of the squared residual of a further shape in the second opinion."""

COMPARED = ("published", "corrected")

MEASURED, NOMINAL, CORRECTED, NOISE = "#15181c", "#e07b10", "#1764c0", "#d5dae1"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("record", type=Path, metavar="PATH", help="the benchmark's DATA_EMPS.mat")
    parser.add_argument("--out", type=Path, default=Path("out/emps"), metavar="DIR", help="folder for all results")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="folder for the pictures (default: --out)")
    parser.add_argument(
        "--with-offset", action="store_true", help="start from the published model with its offset, as weight on a tilted rail"
    )
    parser.add_argument("--quick", action="store_true", help="a shorter search")
    args = parser.parse_args(arguments)
    try:
        record = read_emps(args.record)
        import_record(args.record, args.out)
        print(law_text(record))
        show_and_run("identify", args.out / "fit", "--machine", MACHINE, "--out", identified_file(args.out))
        document = diagnosed(args.out, tilted(args.out) if args.with_offset else MACHINE, quick=args.quick)
        print(order_text(document))
        machines = {
            "published, without its offset": load_machine(MACHINE),
            "published": published(),
            "identified": identified(args.out),
            "corrected": corrected(args.out),
        }
        run, predictions = last_third(args.out, machines)
        print(gap_text(run, predictions, machines, repeatability(record, PERIOD_S)))
        print(force_text(record))
        folder = args.pictures or args.out
        save_png(gap_figure(run, predictions, repeatability(record, PERIOD_S)), folder / "emps_gap.png", 110)
        save_png(friction_figure(record, machines), folder / "emps_friction.png", 110)
        print(f"pictures: {folder / 'emps_gap.png'}, {folder / 'emps_friction.png'}; report: {args.out / 'diagnosis' / 'report.html'}")
    except TwinError as error:
        print(f"run.py: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


def import_record(path: Path, out: Path, picture: bool = True) -> None:
    """The first two thirds as one campaign, the last third as another one."""
    for part, name in (("fit", "two_thirds.toml"), ("check", "last_third.toml")):
        show_and_run("import", path, "--map", HERE / name, "--out", out / part, *([] if picture else ["--no-picture"]))


def tilted(out: Path) -> Path:
    """The machine file with its rail tilted, so that the weight of the carriage makes the published offset."""
    slope = -PUBLISHED_OFFSET_N / ((load_machine(MACHINE).axis("X").moving_mass_kg or 0.0) * 9.81)
    model = (
        (HERE / "axis.xml").read_text(encoding="utf-8").replace('axis="1 0 0"', f'axis="{math.cos(slope):.9f} 0 {-math.sin(slope):.9f}"')
    )
    (out / "tilted").mkdir(parents=True, exist_ok=True)
    (out / "tilted" / "axis.xml").write_text(model, encoding="utf-8")
    (out / "tilted" / "axis.toml").write_text(MACHINE.read_text(encoding="utf-8"), encoding="utf-8")
    return out / "tilted" / "axis.toml"


def diagnosed(out: Path, machine: Path = MACHINE, quick: bool = False) -> dict[str, Any]:
    """diagnosis.json of the first two thirds against the machine file."""
    folder = out / "diagnosis"
    show_and_run("diagnose", out / "fit", "--machine", machine, "--out", folder, *(["--quick"] if quick else []))
    found: dict[str, Any] = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    return found


def published() -> Machine:
    """The published model with its offset."""
    machine = load_machine(MACHINE)
    offset = {"name": "constant_force", "axis": "X", "force": PUBLISHED_OFFSET_N}
    return with_added(machine, [check_setting(offset, machine, "published offset")])


def identified_file(out: Path) -> Path:
    """Where the identified machine file is written."""
    return out / "identified" / "machine.toml"


def identified(out: Path) -> Machine:
    """The machine file that identification wrote."""
    return load_machine(identified_file(out))


def corrected(out: Path) -> Machine:
    """The machine file that the diagnosis wrote."""
    return load_machine(out / "diagnosis" / "machine.toml")


def law_error(record: Record) -> np.ndarray:
    """Recorded voltage minus kv (kp (s - q) - dq) of the recorded position, without the first two samples (sample,) [V]."""
    q, h = record.position, record.period
    speed = (q[2:] - q[:-2]) / (2.0 * h)
    command_v = record.speed_gain * (record.position_gain * (record.setpoint - q)[2:] - speed)
    return record.voltage[2:] - np.clip(command_v, -10.0, 10.0)


def repeatability(record: Record, period_s: float) -> tuple[float, float]:
    """RMS scatter of position [m] and voltage [V] of one period, from the differences between consecutive periods of the set points."""
    n = round(period_s / record.period)
    settled = slice(n // 10, None)
    position = (record.position[n:] - record.position[:-n]) - (record.setpoint[n:] - record.setpoint[:-n])
    voltage = record.voltage[n:] - record.voltage[:-n]
    return float(np.std(position[settled]) / np.sqrt(2.0)), float(np.std(voltage[settled]) / np.sqrt(2.0))


def last_third(out: Path, machines: dict[str, Machine]) -> tuple[MeasuredRun, dict[str, Prediction]]:
    """The held-out run and the prediction of each machine."""
    run = read_campaign(out / "check", next(iter(machines.values()))).runs[0]
    return run, {name: predict(machine, run) for name, machine in machines.items()}


def law_text(record: Record) -> str:
    """How well the record agrees with the control law."""
    rms = float(np.sqrt(np.mean(law_error(record) ** 2)))
    return f"\nresidual of the control law: {rms * 1e3:.2f} mV RMS, largest voltage {np.abs(record.voltage).max():.2f} V"


def order_text(document: dict[str, Any]) -> str:
    """Share of the remaining squared gap that each effect closed when it was found, largest first, and the unexplained share."""
    taken = {(e["effect"], e["axis"]) for e in document["effects"]}
    known = {(c["effect"], c["axis"]): c for c in reversed(document["candidates"])}
    rows = []
    for key in sorted(taken, key=lambda k: -float(known[k]["explained"])):
        values = ", ".join(f"{name} {p['value']:.4g} {p['unit']}" for name, p in known[key]["parameters"].items() if p["unit"] != "rad")
        rows.append([key[0].replace("_", " "), values, f"{100 * known[key]['explained']:.1f} %", "taken"])
    gap = document["gap"]
    left = max(gap["after"] ** 2 - 1.0, 0.0) / max(gap["before"] ** 2 - 1.0, 1e-9)
    rows.append(["unexplained", "", f"{100 * left:.1f} %", f"verdict: {document['verdict']}"])
    return "\nshare of the remaining squared gap that each effect closed when it was found:\n" + table(
        ["effect", "size", "share", ""], rows, left=2
    )


def gap_text(run: MeasuredRun, predictions: dict[str, Prediction], machines: dict[str, Machine], repeats: tuple[float, float]) -> str:
    """The gap on the last third, with the scatter of the axis from period to period."""
    rows = []
    for name, prediction in predictions.items():
        gap = gap_of(machines[name], run, prediction)["X"]
        rows.append(
            [
                name,
                *(f"{gap[s].rms:.3f}" for s in ("motor_position", "voltage")),
                f"{gap['motor_position'].max:.2f}",
                f"{gap['voltage'].max:.2f}",
            ]
        )
    rows.append(["the axis, from period to period", f"{repeats[0] * 1e6:.3f}", f"{repeats[1]:.3f}", "", ""])
    return "\ngap on the held-out last third:\n" + table(["machine", "RMS [um]", "RMS [V]", "largest [um]", "largest [V]"], rows, left=1)


def force_shapes(speed: np.ndarray, position: np.ndarray, period: float) -> dict[str, list[np.ndarray]]:
    """Name -> columns of additional force laws beyond mass, viscous and Coulomb friction and a constant."""
    turn = 2.0 * np.pi * position / LEAD_M
    acceleration = np.gradient(speed, period)
    return {
        "viscous friction by direction": [np.abs(speed)],
        "friction lower below 20 mm/s": [np.tanh(speed / 0.02) - np.sign(speed)],
        "friction higher below 5 mm/s (Stribeck)": [np.exp(-((speed / 5e-3) ** 2)) * np.sign(speed)],
        "once a motor turn": [np.sin(turn), np.cos(turn)],
        "twice a motor turn": [np.sin(2.0 * turn), np.cos(2.0 * turn)],
        "jerk (a lag, or a spring behind the motor)": [np.gradient(acceleration, period)],
        "force along the travel": [position, position**2, position**3],
        "friction along the travel": [position * np.sign(speed), position**2 * np.sign(speed)],
        "friction as v|v|": [speed * np.abs(speed)],
    }


def force_text(record: Record) -> str:
    """A second opinion without the closed loop: regression of the force below 50 Hz, adding the best shape at a time."""
    part = slice(0, 2 * len(record.time) // 3)
    fit = fit_single_axis(replace(record, **{k: getattr(record, k)[part] for k in ("time", "setpoint", "position", "voltage")}))
    columns = [np.gradient(fit.speed, record.period), fit.speed, np.sign(fit.speed), np.ones_like(fit.speed)]
    shapes = force_shapes(fit.speed, fit.position, record.period)
    total, left, rows = float(fit.residual @ fit.residual), 1.0, []

    def remaining(more: list[np.ndarray]) -> float:
        x = np.column_stack([*columns, *more])
        scaled = x / np.linalg.norm(x, axis=0)
        e = fit.residual - scaled @ np.linalg.lstsq(scaled, fit.residual, rcond=None)[0]
        return float(e @ e) / total

    while shapes:
        after = {name: remaining(shape) for name, shape in shapes.items()}
        best = min(after, key=lambda name: after[name])
        if left - after[best] < NEXT_BEST:
            break
        rows.append([best, f"{100 * (left - after[best]):.0f} %"])
        columns += shapes.pop(best)
        left = after[best]
    rows.append(["none of these", f"{100 * left:.0f} %"])
    error, whole = f"{100 * fit.force_error:.1f} % of the force", fit_single_axis(record).force_error
    return (
        f"\nforce below 50 Hz by regression, whole record: relative error {100 * whole:.2f} %, published {100 * PUBLISHED_FORCE_ERROR:.2f} %"
        f"\nsecond opinion on the fitted two thirds (residual of the published form: {error}):\n"
        + table(["the residual depends on", "share"], rows, left=1)
    )


def gap_figure(run: MeasuredRun, predictions: dict[str, Prediction], repeats: tuple[float, float]):  # type: ignore[no-untyped-def]
    """One period of the last third: speed, gap of position and voltage of the published and of the corrected machine."""
    n = round(PERIOD_S / run.trace.period)
    time = run.trace.time[:n]
    figure, panels = new_figure(3, 1, height=2.2, sharex=True)
    speed, position, voltage = panels[:, 0]
    speed.plot(time, np.gradient(run.trace.get("X", "setpoint"), run.trace.period)[:n] * 1e3, color=MEASURED, linewidth=1.2)
    speed.set_ylabel("set point [mm/s]")
    for panel, signal, factor, repeat, unit in (
        (position, "motor_position", 1e6, repeats[0], "um"),
        (voltage, "voltage", 1.0, repeats[1], "V"),
    ):
        panel.axhspan(-2 * repeat * factor, 2 * repeat * factor, color=NOISE, label="the axis, period to period (95 %)")
        for name, colour in zip(COMPARED, (NOMINAL, CORRECTED)):
            gap = (run.trace.get("X", signal) - predictions[name].trace.get("X", signal))[:n] * factor
            panel.plot(time, gap, color=colour, linewidth=1.0, label=f"measured - {name}, {np.sqrt(np.mean(gap**2)):.2g} {unit} RMS")
        panel.set_ylabel(f"gap of {signal.replace('_', ' ')} [{unit}]")
        panel.legend(ncols=3, loc="lower left", bbox_to_anchor=(0.0, 0.98), frameon=False)
    voltage.set_xlabel("time [s] in the last third of the record")
    voltage.margins(x=0.01)
    return figure


def friction_figure(record: Record, machines: dict[str, Machine]):  # type: ignore[no-untyped-def]
    """Voltage of each part at constant speed minus that of the published model: measured, and simulated by the corrected machine."""
    figure, panels = new_figure(1, 1, width=8.0, height=3.6)
    panel = panels[0, 0]
    recorded = (record.voltage, *(voltages(record, machines[name]) for name in COMPARED))
    measured, published, corrected = (plateaus(replace(record, voltage=voltage)) for voltage in recorded)
    panel.axhline(0.0, color=NOMINAL, label="published model")
    for found, colour, aside, label in (
        (measured, MEASURED, -1.0, "measured parts at constant speed"),
        (corrected, CORRECTED, 1.0, "corrected machine"),
    ):
        points = [(1e3 * v + aside, 1e3 * (u - base)) for v in found for u, base in zip(found[v], published[v])]
        panel.plot(*zip(*points), color=colour, marker="o", markersize=4, linestyle="none", alpha=0.6, label=label)
    panel.set_xlabel("speed [mm/s]")
    panel.set_ylabel("voltage minus published model [mV]")
    panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
    return figure


def voltages(record: Record, machine: Machine) -> np.ndarray:
    """Voltage (sample,) [V] of a machine on the set points of the record."""
    voltage: np.ndarray = simulate(machine, Setpoints(record.setpoint[:, None], record.period)).trace.get("X", "voltage")
    return voltage[: len(record.setpoint)]


def plateaus(record: Record, least_s: float = 0.2, settle_s: float = 0.08) -> dict[float, list[float]]:
    """Speed of the set point [m/s] -> mean voltages [V] of its parts at constant speed."""
    h = record.period
    speed = np.gradient(record.setpoint, h)
    steady = np.abs(np.gradient(speed, h)) < 1e-3
    edges = np.flatnonzero(np.diff(np.concatenate([[False], steady, [False]]).astype(int)))
    out: dict[float, list[float]] = {}
    for begin, end in zip(edges[::2], edges[1::2]):
        at = float(speed[end - 1])
        if (end - begin) * h > least_s and abs(at) > 1e-3:
            out.setdefault(round(at, 3), []).append(float(np.mean(record.voltage[begin + round(settle_s / h) : end])))
    return dict(sorted(out.items()))


if __name__ == "__main__":
    sys.exit(main())
