"""From a campaign to an identified machine: find the usable parts, regress, split products, refine, compare on runs left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import math
import os
import time

import numpy as np

from twin.campaign import Campaign, MeasuredRun
from twin.errors import InputError, TwinError
from twin.gap import MOVING, gap_of, predict_campaign
from twin.identify import tilting_pair
from twin.identify.axis_run import AxisRun, axis_run
from twin.identify.direct import Direct, Runs, direct_route
from twin.identify.findings import (
    LATE_S,
    Finding,
    Late,
    checked_flags,
    coverage,
    late_channels,
    missing_signals,
    shifted_setpoint,
    stuck_channels,
)
from twin.identify.noise import measured_noise
from twin.identify.products import Split, is_vertical, split_machine, split_products
from twin.identify.result import Identification, Parameter, Range
from twin.machine import Axis, Machine
from twin.run import simulate
from twin.setpoints import setpoints_of

LEFT_OUT_SHARE = 0.3
"""Share of the runs, the last ones, that no fit sees (none of fewer than three)."""

LOOP_BOUNDS = {"position_delay_s": (0.0, 0.1), "feedforward_delay_s": (0.0, 0.1)}


def identify_campaign(
    machine: Machine,
    campaign: Campaign,
    *,
    refine: bool = True,
    torque_constant_tolerance: float | None = None,
    gaps: bool = True,
    progress: Callable[[str], None] | None = None,
) -> Identification:
    """Identify the machine of a campaign, starting from its machine file.

    `torque_constant_tolerance`: relative half width within which the torque constants are known (default: the machine file's
    parameter_tolerance). `progress` is called with the name of each step that begins.
    """
    say = progress or (lambda _text: None)
    clock: dict[str, float] = {}
    started = time.perf_counter()
    say("reading signals")
    runs, axis_runs, findings, late = _prepared(machine, campaign)
    training, left_out = _divided(runs)
    if not any(r is not None and r.current is not None for a in axis_runs.values() for r in a) and not any(
        r is not None and r.speed_setpoint is not None for a in axis_runs.values() for r in a
    ):
        raise InputError(
            f"{campaign.path}: no run holds position with current or speed set point; record position, current and velocity_setpoint"
        )
    say("simulating instruments")
    simulated = _simulated(machine, training)
    say("regression")
    direct = direct_route(machine, _part(axis_runs, runs, training), simulated, say)
    splits = split_products(machine, direct, torque_constant_tolerance)
    found = _with_loops(split_machine(machine, splits), direct)
    found = _with_noise(found, measured_noise(machine, training))
    say("regression on the runs left out")
    other = direct_route(machine, _part(axis_runs, runs, left_out)) if left_out else Direct()
    parameters = _parameters(machine, found, direct, other, splits)
    findings += _unseen(parameters)
    clock["regression"] = time.perf_counter() - started
    chosen, refined = "regression", None
    if refine:
        from twin.identify.refine import refined_machine

        say("refinement by re-simulation")
        refined = refined_machine(found, training, _doubts(found, parameters), say)
        parameters = _with_refined(parameters, found, refined.machine, refined.deviations)
        clock["refinement"] = time.perf_counter() - started
    tables = {}
    if gaps:
        say("gap on the runs left out")
        told = left_out or training
        machines = {"before": machine, "regression": found, **({"refined": refined.machine} if refined else {})}
        for name, candidate in machines.items():
            tables[name] = pooled_gap(candidate, told)
        if refined and _score(tables["refined"]) < 0.98 * _score(tables["regression"]):
            chosen = "refined"
        clock["gaps"] = time.perf_counter() - started
    best = refined.machine if refined and chosen == "refined" else found
    return Identification(
        machine, best, tuple(parameters), tuple(findings), tuple(late), direct,
        tuple(r.name for r in training), tuple(r.name for r in left_out), str(campaign.path),
        {k: s.tolerance_holds for k, s in splits.items()}, tables, clock, chosen,
    )  # fmt: skip


def _prepared(machine: Machine, campaign: Campaign) -> tuple[list[MeasuredRun], dict[str, list[AxisRun | None]], list[Finding], list[Late]]:
    """Runs with checked flags, every axis of every run on the position cycles with late channels taken back, and what was found."""
    runs = list(campaign.runs)
    findings = missing_signals(machine, runs) + [f for run in runs for f in stuck_channels(machine, run)]

    def read(lateness: dict[str, dict[str, float]]) -> dict[str, list[AxisRun | None]]:
        return {
            a.name: [axis_run(machine, a, r, lateness.get(a.name)) if a.name in r.trace.axes else None for r in runs] for a in machine.axes
        }

    axis_runs = read({})
    flags, said = checked_flags(machine, runs, axis_runs)
    findings += said
    runs = [replace(r, feedforward=f) for r, f in zip(runs, flags)]
    axis_runs = read({})
    late = _skew(machine, runs, axis_runs)
    correct: dict[str, dict[str, float]] = {}
    for _ in range(SKEW_ROUNDS):
        # a current that is late by odd samples shows another phase of its saw-tooth: what the first round leaves, the second finds
        late, more = late if not correct else _remaining(late, _skew(machine, runs, axis_runs), correct), False
        for item in late:
            if abs(item.seconds) > max(LATE_S[item.signal], 4.0 * item.deviation):
                taken = _whole(item.seconds, runs[0].trace.period)
                more |= correct.get(item.axis, {}).get(item.signal) != taken
                correct.setdefault(item.axis, {})[item.signal] = taken
        if not more:
            break
        axis_runs = read(correct)
    for item in late:
        if item.signal in correct.get(item.axis, {}):
            told = f"{item.signal} was recorded {item.seconds * 1e3:.3f} ms late (+-{1.96e3 * item.deviation:.3f} ms); taken back"
            findings.append(Finding("", item.axis, told))
    for axis in machine.axes:
        findings += coverage(machine, axis, [r for r in axis_runs[axis.name] if r is not None])
    return runs, axis_runs, findings, late


SKEW_ROUNDS = 3
NEAR_SAMPLE = 0.2
"""A skew within this fraction of a period from whole samples is taken as whole samples: recorders are late by those."""


def _whole(seconds: float, period: float) -> float:
    samples = seconds / period
    return round(samples) * period if abs(samples - round(samples)) < NEAR_SAMPLE else seconds


def _remaining(before: Sequence[Late], now: Sequence[Late], correct: dict[str, dict[str, float]]) -> list[Late]:
    """Skews after a correction: what was taken back and what is left, where a correction was made."""
    left = {(c.axis, c.signal): c for c in now}
    out = []
    for item in before:
        taken = correct.get(item.axis, {}).get(item.signal)
        after = left.get((item.axis, item.signal))
        out.append(replace(item, seconds=taken + after.seconds, deviation=after.deviation) if taken is not None and after else item)
    return out


def _skew(machine: Machine, runs: Sequence[MeasuredRun], axis_runs: dict[str, list[AxisRun | None]]) -> list[Late]:
    """Skew of each channel over the runs: weighted mean, its deviation from their scatter."""
    out = []
    for axis in machine.axes:
        items: dict[str, list[Late]] = {}
        for run, seen in zip(runs, axis_runs[axis.name]):
            for late in late_channels(machine, axis, run, seen):
                items.setdefault(late.signal, []).append(late)
            if seen is not None and np.ptp(seen.axis_position) > 0.01 * axis.max_velocity:
                shift = shifted_setpoint(axis, seen, run.trace.period)
                items.setdefault("velocity_setpoint", []).append(Late(axis.name, "velocity_setpoint", shift, seen.cycle / 20.0))
        for signal, several in items.items():
            values = np.array([s.seconds for s in several])
            weights = 1.0 / np.array([max(s.deviation, 1e-6) for s in several]) ** 2
            mean = float(np.average(values, weights=weights))
            if signal == "velocity_setpoint":
                mean = float(np.median(values))
            scatter = float(np.sqrt(np.average((values - mean) ** 2, weights=weights) / max(len(values) - 1, 1)))
            out.append(Late(axis.name, signal, mean, max(scatter, float(weights.sum() ** -0.5))))
    return out


def _divided(runs: Sequence[MeasuredRun]) -> tuple[list[MeasuredRun], list[MeasuredRun]]:
    """Runs to learn from, and the last ones to check on."""
    count = int(LEFT_OUT_SHARE * len(runs)) if len(runs) >= 3 else 0
    count = max(count, 1) if len(runs) >= 3 else 0
    return list(runs[: len(runs) - count]), list(runs[len(runs) - count :]) if count else []


def _part(axis_runs: dict[str, list[AxisRun | None]], runs: Sequence[MeasuredRun], part: Sequence[MeasuredRun]) -> Runs:
    names = {r.name for r in part}
    return {a: [x for x, r in zip(seen, runs) if r.name in names] for a, seen in axis_runs.items()}


def _simulated(machine: Machine, runs: Sequence[MeasuredRun]) -> Runs | None:
    """The runs without noise, as the machine file has it: instruments. None where the machine file cannot follow the set points."""

    def one(run: MeasuredRun) -> MeasuredRun:
        trace = simulate(
            machine.with_feedforward(run.feedforward),
            setpoints_of(run.trace, machine),
            sample_period=run.trace.period,
            started_at=run.started_at,
        ).trace
        return replace(run, trace=trace)

    try:
        with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
            twins = list(pool.map(one, runs))
    except TwinError:
        return None
    return {a.name: [axis_run(machine, a, r) for r in twins] for a in machine.axes}


def _with_loops(machine: Machine, direct: Direct) -> Machine:
    """Control values into the machine file; those that the signals did not show keep the file's."""
    values: dict[str, float] = {}
    for axis in machine.axes:
        for found in (direct.position.get(axis.name), direct.speed.get(axis.name)):
            if found is None:
                continue
            for name, value in found.values.items():
                if math.isfinite(found.deviations[name]):
                    low, high = LOOP_BOUNDS.get(name, (-math.inf, math.inf))
                    values[f"axis.{axis.name}.loops.{name}"] = float(np.clip(value, low, high))
    return machine.with_values(values)


def _with_noise(machine: Machine, noise: dict[str, float]) -> Machine:
    return machine.with_values({f"measurement.{k}": v for k, v in noise.items()}) if noise else machine


MECHANICS = {
    "inertia": ("inertia", "kg m2"),
    "coulomb": ("coulomb_friction", "Nm"),
    "viscous": ("viscous_friction", "Nm s/rad"),
    "gravity": ("gravity_torque", "Nm"),
}
LOOP_UNITS = {
    "position_gain_per_s": "1/s",
    "velocity_feedforward": "1",
    "position_delay_s": "s",
    "feedforward_delay_s": "s",
    "speed_gain_nm_s_per_rad": "Nm s/rad",
    "speed_integral_time_s": "s",
    "torque_feedforward": "1",
}
PAIR_UNITS = {"moment_y": "kg m", "moment_z": "kg m", "table_x": "kg m", "table_y": "kg m"}


def _parameters(machine: Machine, found: Machine, direct: Direct, other: Direct, splits: dict[str, Split]) -> list[Parameter]:
    """All parameters in the order of the axes: control, mechanics at the motor, moments of the table at the axes."""
    out: list[Parameter] = []
    for axis in machine.axes:
        for blocks, others in ((direct.position, other.position), (direct.speed, other.speed)):
            block, check = blocks.get(axis.name), others.get(axis.name)
            if block is None:
                continue
            for name, value in block.values.items():
                d = block.deviations[name] * block.quantile
                if not math.isfinite(d):
                    continue
                low, high = LOOP_BOUNDS.get(name, (-math.inf, math.inf))
                kept = float(np.clip(value, low, high))
                r = Range(value, value - d, value + d)
                aside = None
                if check is not None and math.isfinite(check.deviations[name]):
                    e = check.deviations[name] * check.quantile
                    aside = Range(check.values[name], check.values[name] - e, check.values[name] + e)
                out.append(
                    Parameter(
                        axis.name,
                        name,
                        LOOP_UNITS[name],
                        getattr(axis.loops, name),
                        r,
                        Range(kept, kept - d, kept + d),
                        False,
                        block.condition,
                        value < low or value > high,
                        f"axis.{axis.name}.loops.{name}",
                        aside,
                    )
                )
        out += _mechanics(machine, found, axis, direct, other, splits)
    return out


def _mechanics(machine: Machine, found: Machine, axis: Axis, direct: Direct, other: Direct, splits: dict[str, Split]) -> list[Parameter]:
    key = next((k for k in direct.balance if axis.name in k.split()), None)
    if key is None:
        return []
    balance, check = direct.balance[key], other.balance.get(key)
    from twin.plant import home_inertia_at_motor

    index = machine.axis_names.index(axis.name)
    r = axis.ratio
    names: list[tuple[str, str, str, float, float, float]] = []  # in the fit, name, unit, factor to the motor, before, after
    now = found.axis(axis.name)
    if key == "A C":
        suffix = f"_{axis.name}"
        inertia_before, inertia_after = (float(home_inertia_at_motor(m)[index]) for m in (machine, found))
        names += [(f"inertia{suffix}", "inertia", "kg m2", r * r, inertia_before, inertia_after)]
        names += [(f"coulomb{suffix}", "coulomb_friction", "Nm", r, axis.coulomb_friction_nm, now.coulomb_friction_nm)]
        names += [
            (
                f"viscous{suffix}",
                "viscous_friction",
                "Nm s/rad",
                r * r,
                axis.viscous_friction_nm_s_per_rad,
                now.viscous_friction_nm_s_per_rad,
            )
        ]
        if axis.name == "A":
            numbers = (tilting_pair.pair_numbers(machine), tilting_pair.pair_numbers(found))
            for k, name in enumerate(tilting_pair.PAIR):
                if k >= 2:
                    names.append((name, name, PAIR_UNITS.get(name, "kg m2"), 1.0, float(numbers[0][k]), float(numbers[1][k])))
    else:
        inertia_before, inertia_after = (float(home_inertia_at_motor(m)[index]) for m in (machine, found))
        vertical = is_vertical(machine, axis.name)
        weight = [(m.axis(axis.name).moving_mass_kg or 0.0) * m.gravity * r if vertical else 0.0 for m in (machine, found)]
        values = {
            "inertia": (inertia_before, inertia_after),
            "coulomb": (axis.coulomb_friction_nm, now.coulomb_friction_nm),
            "viscous": (axis.viscous_friction_nm_s_per_rad, now.viscous_friction_nm_s_per_rad),
            "gravity": (weight[0], weight[1]),
        }
        names += [(k, *MECHANICS[k], 1.0, *values[k]) for k in values if k != "gravity" or vertical]
        if not vertical:
            names.append(("gravity", "constant_torque", "Nm", 1.0, 0.0, 0.0))
    out = []
    kt = f"axis.{axis.name}.motor.torque_constant_nm_per_a"
    kt_log, kt_sd = splits[key].factors[kt] if key in splits else (0.0, 0.0)
    for inner, name, unit, factor, before, _after in names:
        i = balance.names.index(inner)
        if not balance.fit.seen[i] or not math.isfinite(balance.fit.deviations[i]):
            continue
        value = float(balance.fit.values[i] * factor)
        d = float(balance.fit.deviations[i] * balance.fit.quantile * factor)
        aside = None
        if check is not None and check.fit.seen[i] and math.isfinite(check.fit.deviations[i]):
            v, e = float(check.fit.values[i] * factor), float(check.fit.deviations[i] * check.fit.quantile * factor)
            aside = Range(v, v - e, v + e)
        # the value: the product at the most probable torque constant, whose doubt adds
        v = value * math.exp(kt_log)
        e = math.hypot(d, 1.96 * kt_sd * abs(v))
        path = {
            "coulomb_friction": f"axis.{axis.name}.coulomb_friction_nm",
            "viscous_friction": f"axis.{axis.name}.viscous_friction_nm_s_per_rad",
        }
        bound = name in path and v <= 0.0
        out.append(
            Parameter(
                axis.name,
                name,
                unit,
                before,
                Range(value, value - d, value + d),
                Range(v, v - e, v + e),
                True,
                balance.fit.condition,
                bound,
                path.get(name, ""),
                aside,
            )
        )
    return out


def _with_refined(parameters: list[Parameter], found: Machine, refined: Machine, deviations: dict[str, float]) -> list[Parameter]:
    """The parameters with what re-simulation made of them: the same factor as on the machine-file values."""
    from twin.plant import home_inertia_at_motor

    inertia = home_inertia_at_motor(refined)
    pair = tilting_pair.pair_numbers(refined) if tilting_pair.has_pair(refined) else np.zeros(10)
    out = []
    for p in parameters:
        axis = refined.axis(p.axis)
        value = {
            "inertia": float(inertia[refined.axis_names.index(p.axis)]),
            "coulomb_friction": axis.coulomb_friction_nm,
            "viscous_friction": axis.viscous_friction_nm_s_per_rad,
            "gravity_torque": (axis.moving_mass_kg or 0.0) * refined.gravity * axis.ratio if p.name == "gravity_torque" else 0.0,
        }.get(p.name)
        if p.name in tilting_pair.PAIR:
            value = float(pair[tilting_pair.PAIR.index(p.name)])
        key = f"{p.axis}.{p.name}"
        d = deviations.get(key)
        if d is None and f"{p.axis}.loops.{p.name}" in deviations:
            value, d = getattr(axis.loops, p.name), deviations[f"{p.axis}.loops.{p.name}"]
        out.append(replace(p, refined=Range(value, value - 1.96 * d, value + 1.96 * d)) if value is not None and d is not None else p)
    return out


def _doubts(machine: Machine, parameters: Sequence[Parameter]) -> dict[tuple[str, str], float]:
    """The regression's standard deviations as the refinement's knobs take them: relative, delays in seconds."""
    out: dict[tuple[str, str], float] = {}
    for p in parameters:
        d = (p.estimate.high - p.estimate.low) / 3.92
        relative = d / abs(p.estimate.value) if p.estimate.value else math.inf
        axis = machine.axis(p.axis)
        if p.name == "inertia":
            # the rotor carries the change of the whole
            out[p.axis, "rotor_inertia_kg_m2"] = d / axis.rotor_inertia_kg_m2
        elif p.name in ("coulomb_friction", "viscous_friction"):
            out[p.axis, f"{p.name}_nm" + ("_s_per_rad" if p.name == "viscous_friction" else "")] = relative
        elif p.name == "gravity_torque":
            out[p.axis, "moving_mass_kg"] = relative
        elif p.name == "moment_z":
            out[p.axis, "body.cradle"] = relative
        elif p.name == "table_x":
            out[p.axis, "body.workpiece"] = relative
        elif p.name in LOOP_UNITS:
            out[p.axis, p.name] = d if p.name.endswith("delay_s") else relative
    return out


LOOSE = 0.1
"""A half interval above this fraction of the value counts as not identified."""


def _unseen(parameters: Sequence[Parameter]) -> list[Finding]:
    """Parameters that the campaign leaves open, with the run that would close them."""
    cure = {
        "inertia": "accelerated moves",
        "coulomb_friction": "constant speeds in both directions",
        "viscous_friction": "constant speeds from creeping to rapid",
        "gravity_torque": "moves of the vertical axis in both directions",
        "moment_y": "slow turns of A over its range",
        "moment_z": "slow turns of A over its range",
        "table_x": "turns of C at several tilts",
        "table_y": "turns of C at several tilts",
        "torque_feedforward": "accelerations with torque feedforward on",
    }
    out = []
    for p in parameters:
        scale = abs(p.before) or abs(p.estimate.value)
        half = 0.5 * (p.estimate.high - p.estimate.low)
        if p.name in cure and scale > 0.0 and half > LOOSE * scale:
            out.append(Finding("", p.axis, f"{p.name} only within {100 * half / scale:.0f} %; add {cure[p.name]} ('twin plan')"))
    return out


def pooled_gap(machine: Machine, runs: Sequence[MeasuredRun]) -> dict[str, dict[str, dict[str, float | str]]]:
    """Gap over the runs: axis -> signal -> RMS, RMS of noise alone, unit."""
    predictions = predict_campaign(machine, runs)
    squares: dict[str, dict[str, list[tuple[float, float, str]]]] = {}
    for run in runs:
        for axis, signals in gap_of(machine, run, predictions[run.name]).items():
            if np.max(np.abs(np.gradient(run.trace.get(axis, "setpoint"), run.trace.period))) < MOVING[machine.axis(axis).kind]:
                continue
            for signal, g in signals.items():
                squares.setdefault(axis, {}).setdefault(signal, []).append((g.rms, g.noise, g.unit))
    return {
        axis: {
            s: {
                "rms": math.sqrt(np.mean([v[0] ** 2 for v in values])),
                "noise": math.sqrt(np.mean([v[1] ** 2 for v in values])),
                "unit": values[0][2],
            }
            for s, values in signals.items()
        }
        for axis, signals in squares.items()
    }


def _score(table: dict[str, dict[str, dict[str, float | str]]]) -> float:
    """Mean logarithm of gap over noise, as a factor."""
    ratios = [math.log(max(float(g["rms"]) / max(float(g["noise"]), 1e-12), 0.1)) for signals in table.values() for g in signals.values()]
    return math.exp(float(np.mean(ratios))) if ratios else math.inf
