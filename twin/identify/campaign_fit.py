"""From a campaign to an identified machine: read, regress, split products, refine, compare on runs left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import math
import os
import time

import numpy as np

from twin.errors import InputError, TwinError
from twin.identify.axis_run import axis_run
from twin.identify.direct import Direct, Runs, direct_route
from twin.identify.noise import measured_noise
from twin.identify.parameters import LOOP_BOUNDS, doubts_of, impossible, parameters_of, unseen, with_refined
from twin.identify.products import split_machine, split_products
from twin.identify.recording import prepared
from twin.identify.result import Identification
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.simulation.gap import gap_of, predict_campaign
from twin.simulation.run import simulate
from twin.simulation.setpoints import AT_REST, recorded_setpoints


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
    recording = prepared(machine, campaign)
    training, left_out = recording.divided()
    if not any(r is not None and (r.current is not None or r.speed_setpoint is not None) for a in recording.axis_runs.values() for r in a):
        raise InputError(
            f"{campaign.path}: no run holds position with current or speed set point; record position, current and velocity_setpoint"
        )
    say("simulating instruments")
    simulated = _simulated(machine, training)
    say("regression")
    direct = direct_route(machine, recording.part(training), simulated, say)
    against = impossible(direct)
    if against:
        recording = recording.without_current(against)
        direct = direct_route(machine, recording.part(training), simulated, say)
    splits = split_products(machine, direct, torque_constant_tolerance)
    found = _with_loops(split_machine(machine, splits), direct)
    found = _with_noise(found, measured_noise(machine, training))
    say("regression on the runs left out")
    other = direct_route(machine, recording.part(left_out)) if left_out else Direct()
    parameters = parameters_of(machine, direct, other, splits)
    findings = [*recording.findings, *against.values(), *unseen(machine, parameters)]
    clock["regression"] = time.perf_counter() - started
    chosen, refined = "regression", None
    if refine:
        from twin.identify.refine import refined_machine

        say("refinement by re-simulation")
        refined = refined_machine(found, training, recording.part(training), direct.current, doubts_of(found, parameters), say)
        parameters = with_refined(parameters, refined.machine, refined.deviations)
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
        machine, best, tuple(parameters), tuple(findings), tuple(recording.late), direct,
        tuple(r.name for r in training), tuple(r.name for r in left_out), str(campaign.path),
        {k: s.tolerance_holds for k, s in splits.items()}, tables, clock, chosen,
    )  # fmt: skip


def _simulated(machine: Machine, runs: Sequence[MeasuredRun]) -> Runs | None:
    """The runs without noise, as the machine file has it: instruments. None where the machine file cannot follow the set points."""

    def one(run: MeasuredRun) -> MeasuredRun:
        trace = simulate(
            machine.with_feedforward(run.feedforward),
            recorded_setpoints(run.trace, machine),
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


WORSE, WORSE_S = 0.3, 1e-3
"""Control values known no better than this, relative and in seconds, do not replace the machine file's."""


def _with_loops(machine: Machine, direct: Direct) -> Machine:
    """Control values and windings into the machine file; those that the signals did not show keep the file's."""
    values: dict[str, float] = {}
    for axis in machine.axes:
        for found in (direct.position.get(axis.name), direct.speed.get(axis.name)):
            if found is None:
                continue
            for name, value in found.values.items():
                half = found.quantile * found.deviations[name]
                if half < (WORSE_S if name.endswith("delay_s") else WORSE * abs(value)):
                    low, high = LOOP_BOUNDS.get(name, (-math.inf, math.inf))
                    values[f"axis.{axis.name}.loops.{name}"] = float(np.clip(value, low, high))
        mean = direct.current.get(axis.name)
        if mean is not None and math.isfinite(mean.fit.misfit):  # the winding, read off the saw-tooth
            values[f"axis.{axis.name}.motor.inductance_h"] = mean.fit.loop.inductance
            values[f"axis.{axis.name}.motor.resistance_ohm"] = mean.fit.loop.resistance
    return machine.with_values(values)


def _with_noise(machine: Machine, noise: dict[str, float]) -> Machine:
    return machine.with_values({f"measurement.{k}": v for k, v in noise.items()}) if noise else machine


def pooled_gap(machine: Machine, runs: Sequence[MeasuredRun]) -> dict[str, dict[str, dict[str, float | str]]]:
    """Gap over the runs: axis -> signal -> RMS, RMS of noise alone, unit."""
    predictions = predict_campaign(machine, runs)
    squares: dict[str, dict[str, list[tuple[float, float, str]]]] = {}
    for run in runs:
        for axis, signals in gap_of(machine, run, predictions[run.name]).items():
            if np.max(np.abs(np.gradient(run.trace.get(axis, "setpoint"), run.trace.period))) < AT_REST[machine.axis(axis).kind]:
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
