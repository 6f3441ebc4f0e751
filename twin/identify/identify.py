"""Identify a machine from a campaign: prepare the signals, regress, split products, fit drives in closed loop, judge on held-out motion."""

from collections.abc import Callable, Mapping
from dataclasses import replace
import math
from pathlib import Path
import time

from twin.control.structures import is_fed_as_recorded
from twin.errors import InputError, SimulationError, TwinError
from twin.identify.axis_run import axis_run
from twin.identify.between_samples import is_hidden
from twin.identify.check_recording import Finding
from twin.identify.drive_balance import drive_reacts_to_load
from twin.identify.drive_fit import fit_drives
from twin.identify.effort_delivered import delivered_effort
from twin.identify.held_out import Choice, Division, all_fitted, choose_stages, divide_runs, gap_or_reason
from twin.identify.parameters import (
    covering_recording,
    implausible_currents,
    parameters_of,
    reconciled,
    unidentified,
    with_drives,
    within_bounds,
)
from twin.identify.position_control import NOT_RECORDED, is_determined
from twin.identify.recording import prepare_recording
from twin.identify.regressions import Regressions, regress_blocks
from twin.identify.result import Identification, agreeing_axes
from twin.identify.torque_constants import split_machine, split_products
from twin.machine.keys import SMALLEST
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import Campaign, MeasuredRun, read_campaign, without_scale
from twin.simulation.nominal_motion import recorded_job
from twin.simulation.plant_spec import with_commissioned_inertia
from twin.simulation.recorded_noise import measurement_values
from twin.simulation.run import all_or_raise, simulate_on_all_cores
from twin.units import AXIS_UNITS


def identify(
    campaign: Campaign | str | Path,
    machine: Machine | None = None,
    *,
    refine: bool = True,
    torque_constant_tolerance: float | None = None,
    gaps: bool = True,
    progress: Callable[[str], None] | None = None,
    hold_out: bool = True,
) -> Identification:
    """Friction, inertia, gravity, gains and delays of a machine from its own traces, each with a 95 % interval.

    `campaign` is a campaign or its folder; `machine` the machine to start from. `refine` fits in closed loop what the regression leaves open.
    `torque_constant_tolerance`: relative half width of the known interval of the torque constants (default: the machine file's
    parameter_tolerance). `progress` is called with the name of each step when it begins. With `gaps` the result is judged on the held-out
    motion, without `hold_out` on all of it, which is also fitted: for a `machine` that was made of this campaign. Its `refused` then gives the
    reason if no machine file may be written. Without `gaps` the result is the machine of the regression, even after a fit in closed loop. In the
    result, `parameters` are in SI and `machine` is the identified machine. Raises InputError if the
    recording lacks the signals.
    """
    machine = machine or load_machine()
    campaign = campaign if isinstance(campaign, Campaign) else read_campaign(campaign, machine)
    say = progress or (lambda _text: None)
    clock: dict[str, float] = {}
    started = time.perf_counter()
    say("reading signals")
    if by_bar := [run.name for run in campaign.runs if run.ballbar is not None]:
        raise InputError(
            f"{campaign.path}: run {by_bar[0]}: a ballbar measures the radius only, which identifies no parameter; give it to 'twin diagnose'"
        )
    machine = with_commissioned_inertia(machine)
    recording = prepare_recording(machine, campaign)
    division = divide_runs(machine, recording.runs) if hold_out else all_fitted(machine, recording.runs)
    if not any(r is not None and (r.current is not None or r.speed_setpoint is not None) for a in recording.axis_runs.values() for r in a):
        raise InputError(
            f"{campaign.path}: no run holds position with current or speed set point; record position, current and velocity_setpoint"
        )
    say("simulating instruments")
    twins = _simulated(machine, division)
    simulated = (
        None if twins is None else {a.name: [None if run is None else axis_run(machine, a, run) for run in twins] for a in machine.axes}
    )
    say("regression")
    direct = regress_blocks(machine, division.training_part(recording.axis_runs), simulated, say)
    against = implausible_currents(machine, direct)
    if against:
        recording = recording.without_current(against)
        direct = regress_blocks(machine, division.training_part(recording.axis_runs), simulated, say)
    splits = split_products(machine, direct, torque_constant_tolerance)
    training = [division.runs[i] for i in division.training()]
    noise = measurement_values(machine, training)
    controlled = with_identified_control(machine, direct, noise)
    found = with_identified_control(split_machine(machine, splits), direct, noise)
    parameters = parameters_of(machine, direct, splits)
    not_found, notes = position_control_findings(machine, direct)
    findings = [*recording.findings, *against.values(), *not_found, *known_load_findings(machine, direct)]
    delivered = [(axis, one) for axis in machine.axes if (one := delivered_effort(axis, recording.runs)) is not None]
    doubted = any(one.off and axis.actuator.winding for axis, one in delivered)
    own = [run for run in _simulated(found, division) or () if run is not None] if doubted else []
    for axis, one in delivered:
        compared = one.beside(delivered_effort(axis, own)) if one.off and axis.actuator.winding else one
        (findings if compared.off else notes).append(Finding(compared.text(), axis.name))
    clock["regression"] = time.perf_counter() - started
    stages, disputed = {"regression": found}, list[Finding]()
    if refine:
        say("drives in closed loop")
        rows = {a: [division.fitted[a][i] for i in division.training()] for a in found.axis_names if a not in against}
        try:
            refined, fits = fit_drives(found, training, rows, direct.unexcited, say)
            hidden = [axis.name for axis in found.axes if is_hidden(found, axis)]
            parameters, disputed = reconciled(with_drives(parameters, found, fits), hidden)
            stages |= {"refined": refined} if fits else {}
        except SimulationError as error:
            findings.append(Finding(f"drives not fitted in closed loop: {error}"))
        clock["closed loop"] = time.perf_counter() - started
    parameters = covering_recording(parameters, machine, division.runs)
    findings += [*disputed, *(f for f in unidentified(machine, parameters) if f.axis not in [d.axis for d in disputed])]
    choice, tables = Choice(found), {}
    if gaps:
        say("gap on the held-out motion")
        if direct.position:
            stages["control"] = controlled
        all_tables = {name: gap_or_reason(m, division) for name, m in {"before": machine, **stages}.items()}
        choice = choose_stages(machine, stages, all_tables, division, agreeing_axes(parameters))
        findings += choice.findings
        notes += choice.notes
        tables = {name: t for name, t in all_tables.items() if not isinstance(t, str)}
        clock["gaps"] = time.perf_counter() - started
    unscaled = {a.name: without_scale(division.runs, a.name, (a.effort, "position", "motor_position")) for a in machine.axes}
    route = next((name for name, m in stages.items() if m is choice.machine), "each axis by itself")
    return Identification(
        machine, choice.machine, tuple(parameters), tuple(findings), tuple(recording.skews), direct,
        tuple(r.name for r in training), division.left_out_names(), str(campaign.path),
        {k: s.tolerance_holds for k, s in splits.items()}, tables, clock, route, choice.refused, choice.stage_of, unscaled, tuple(notes),
    )  # fmt: skip


def _simulated(machine: Machine, division: Division) -> list[MeasuredRun | None] | None:
    """Noise-free simulation of the training runs in the decoupled plant, None for the other runs: the instruments, which need no more. None if the
    machine cannot follow the set points."""
    training = division.training()
    try:
        jobs = [recorded_job(machine, run)._replace(sample_period=run.trace.period) for run in (division.runs[i] for i in training)]
        traces = [run.trace for run in all_or_raise(simulate_on_all_cores(jobs))]
        twins = {i: replace(division.runs[i], trace=trace) for i, trace in zip(training, traces)}
        return [twins.get(i) for i in range(len(division.runs))]
    except TwinError:
        return None


def known_load_findings(machine: Machine, direct: Regressions) -> list[Finding]:
    """Findings about axes whose drive does not react to the recorded outside load."""
    text = 'the {} does not react to the recorded disturbance, so it already contains it; map it as signal = "injected_command"'
    found = [(name, rows) for balance in direct.balance.values() for name, rows in balance.rows.items()]
    return [Finding(text.format(machine.axis(name).effort), name) for name, rows in found if not drive_reacts_to_load(rows)]


def position_control_findings(machine: Machine, direct: Regressions) -> tuple[list[Finding], list[Finding]]:
    """Findings: why a position controller was not identified. Notes: further results about identified ones."""
    findings, notes = [], []
    for axis in machine.axes:
        unit, factor = AXIS_UNITS[axis.kind].speed
        reason = direct.unfitted.get(axis.name, "")
        if reason and reason != NOT_RECORDED:
            findings.append(Finding(f"position controller not identified: {reason}; the machine file's values are kept", axis.name))
        findings += [
            Finding(f"{text}; correct the file, or let 'twin diagnose' size it", axis.name) for text in direct.missing.get(axis.name, ())
        ]
        if (found := direct.position.get(axis.name)) is not None:
            rms = found.residual_rms * factor
            notes.append(
                Finding(f"position controller: residual of its law {rms:.2g} {unit} RMS of the recorded speed set point", axis.name)
            )
            notes += [Finding(f"the position controller is {found.more}", axis.name)] if found.more else []
        if (loop := direct.drive_loop.get(axis.name)) is not None:
            notes.append(Finding(loop.evidence(unit, factor), axis.name))
    return findings, notes


def with_identified_control(machine: Machine, direct: Regressions, noise: Mapping[str, float]) -> Machine:
    """The machine with the identified control values and windings, and the noise of the recording; what rounding alone leaves is none.

    Values that were not identified keep the file's.
    """
    values: dict[str, object] = {f"measurement.{key}": level if level >= SMALLEST else 0.0 for key, level in noise.items()}
    for axis in machine.axes:
        known = [one for one in (direct.position.get(axis.name), direct.speed.get(axis.name)) if one is not None]
        values |= {
            f"axis.{axis.name}.loops.{name}": within_bounds(name, value)
            for found in known
            for name, value in found.values.items()
            if is_determined(found, name)
        }
        if (law := direct.position.get(axis.name)) is not None:
            values |= {f"axis.{axis.name}.block.{path}": value for path, (value, _) in law.blocks.items()}
        if (loop := direct.drive_loop.get(axis.name)) is not None:
            values[f"axis.{axis.name}.loops.dsc_delay_s"] = loop.delay_s if loop.closed_in_drive else 0.0
        mean = direct.current.get(axis.name)
        is_plain = axis.actuator.winding and is_fed_as_recorded(axis.loops, axis.blocks)
        if mean is not None and is_plain and math.isfinite(mean.fit.misfit):  # the winding, fitted to the saw-tooth
            names = (f"axis.{axis.name}.motor.{n}" for n in ("inductance_h", "resistance_ohm"))
            values.update(zip(names, mean.fit.loop.winding))
    ways = {p.interpolation for p in direct.position.values()}
    if len(ways) == 1 and ways != {machine.setpoint_interpolation}:
        values["control.setpoint_interpolation"] = ways.pop()
    return machine.with_values(values)
