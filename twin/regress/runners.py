"""Runs each kind of case and collects its numbers."""

from collections.abc import Callable
from dataclasses import replace
import math
from pathlib import Path
import tempfile
from typing import Any

from twin.documents import flat
from twin.effects import settings_of, with_effects
from twin.errors import InputError, SimulationError
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import Campaign, read_campaign
from twin.recordings.trace import Trace, read_trace, with_program_columns
from twin.regress.golden import Feature, Outcome
from twin.regress.recorded import recorded_campaign, setpoints_of_moves
from twin.regress.suite import Case


class Skip(Exception):
    """A case that cannot run because its campaign is absent."""


def run_case(case: Case) -> Outcome:
    """Run one case. Raises Skip or InputError; an aborted simulation is an outcome with the trace up to that time."""
    outcome = _RUNNERS[case.kind](case, machine_of(case))
    # 'nan' and 'inf' are stored as words, so that they can be compared
    words = {
        n: replace(f, value=str(f.value))
        for n, f in outcome.features.items()
        if not isinstance(f.value, str) and not math.isfinite(f.value)
    }
    return replace(outcome, features={**outcome.features, **words})


def machine_of(case: Case) -> Machine:
    """The machine of a case: file (default: the Mikron), changed values, driven axes, effects, feedforward."""
    machine = load_machine(case.path("machine") if "machine" in case.table else None)
    if "values" in case.table:
        machine = machine.with_values(case.table["values"])
    if "axes" in case.table:
        machine = machine.with_axes(case.table["axes"])
    if "effects" in case.table:
        machine = with_effects(machine, [*settings_of(machine), *case.table["effects"]])
    settings_of(machine)
    return machine.with_feedforward(case.table.get("feedforward"))


def values_of(content: Any) -> dict[str, float | str]:
    """Numbers and words of nested tables and lists by path 'a.b.0'."""
    return {path: str(v) if isinstance(v, bool | str) or v is None else float(v) for path, v in flat(content).items()}


_SUMMARY_UNITS = {"a": "A", "v": "V", "nm": "Nm", "n": "N", "s": "s"}


def _run(case: Case, machine: Machine) -> Outcome:
    from twin.program import error_budget, interpolate, is_program, read_program
    from twin.replay.events import find_events
    from twin.simulation.run import simulate
    from twin.simulation.setpoints import check_travel, setpoints_of
    from twin.simulation.summary import summary_of

    program: Any = None
    commanded: Any = None
    if "moves" in case.table:
        setpoints = setpoints_of_moves(case, machine)
    elif is_program(case.path("input")):
        program = read_program(case.path("input"), machine)
        commanded = interpolate(program, machine)
        setpoints = setpoints_of(commanded, machine)
        machine = machine.with_feedforward(case.table.get("feedforward", program.feedforward))
    else:
        setpoints = setpoints_of(read_trace(case.path("input"), axes=machine.kinds, need=("setpoint",)), machine)
    check_travel(setpoints, machine, case.where)
    try:
        run = simulate(machine, setpoints)
    except SimulationError as error:
        trace = error.trace if isinstance(error.trace, Trace) else None
        return Outcome({}, trace, (), machine, str(error))
    _check_compared(case, machine, run.trace)
    features: dict[str, Feature] = {}
    for axis, table in summary_of(machine, run)["axes"].items():
        for name, value in values_of(table).items():
            if not isinstance(value, str):
                features[f"{axis}.{name}"] = Feature(value, _unit_of(name, table), axis)
    trace = run.trace
    if program is not None:
        for row in error_budget(program, commanded, trace, machine).summary():
            block = "set points" if row["level"] == 1 else ""
            for name in ("rms_um", "max_um"):
                features[f"error budget.{row['error']}.{name}"] = Feature(row[name], "um", "", block)
        trace = with_program_columns(trace, commanded)
    return Outcome(features, trace, tuple(find_events(machine, trace)), machine)


def _unit_of(name: str, table: dict[str, Any]) -> str:
    """Unit of a number in an axis' summary: errors have the unit of the following error; '' for counts and shares."""
    what, _, last = name.rpartition("_")
    if name == "reversal_peak" or what == "error_without_delay":
        what = "following_error"
    return str(table.get(f"{what}_unit", _SUMMARY_UNITS.get(last, "")))


def _check_compared(case: Case, machine: Machine, trace: Trace) -> None:
    """Some axis must have every compared signal; without `compare`, the command of each axis must be among the compared signals."""
    for signal in case.compared:
        if "compare" in case.table and not any(trace.has(name, signal) for name in machine.axis_names):
            raise InputError(f"{case.where}: compare: no axis of {machine.name} has the signal '{signal}'; leave it out")
    for axis in machine.axes:
        if "compare" not in case.table and axis.effort not in case.compared:
            signals = ", ".join(f'"{s}"' for s in (*case.compared[:-1], axis.effort))
            raise InputError(
                f"{case.where}: axis {axis.name} commands a {axis.effort}; write compare = [{signals}] and [tolerance.{axis.effort}]"
            )


_JUMPING = ("mark.u_mm", "mark.v_mm")
"""Not compared: along a mark of even depth, rounding decides the position of the deepest point."""


def _cut(case: Case, machine: Machine) -> Outcome:
    from twin.surface.levels import LEVELS, levels_of_program
    from twin.surface.machining import check_rays, machine_part, report_of
    from twin.surface.part import read_part

    part, spacing = read_part(case.path("part")), case.table.get("zone_um")
    zone_spacing = spacing * 1e-6 if spacing else None
    check_rays(part, zone_spacing)
    word = case.table.get("feedforward", "velocity+torque")
    levels = levels_of_program(case.path("input"), machine, part.tool, list(LEVELS), [word])
    machining = machine_part(part, levels, threads=1, zone_spacing=zone_spacing)
    features = {}
    for one in machining.cuts:
        report = report_of(machining, one)
        name = " ".join(filter(None, (report["surface"], report["level"], report["feedforward"])))
        for key, value in values_of(report).items():
            if key not in ("surface", "level", "feedforward", *_JUMPING):
                features[f"{name}.{key}"] = Feature(value, "um" if "um" in key else "", "", "cut surface")
    return Outcome(features, machine=machine)


def _campaign(case: Case, machine: Machine) -> Campaign:
    if "recorded" in case.table:
        with tempfile.TemporaryDirectory() as folder:
            return recorded_campaign(case, machine, Path(folder))
    path = case.path("campaign")
    if not path.is_dir():
        raise Skip(f"campaign {case.table['campaign']} is not here")
    return read_campaign(path, machine)


def _gap(case: Case, machine: Machine) -> Outcome:
    from twin.simulation.campaign_gap import gap

    gaps = gap(_campaign(case, machine), machine).runs
    features = {
        f"{axis}.{signal} gap in {run}": Feature(gap.rms, gap.unit, axis, "", gap.noise)
        for run, axes in gaps.items()
        for axis, signals in axes.items()
        for signal, gap in signals.items()
    }
    return Outcome(features, machine=machine)


def _identify(case: Case, machine: Machine) -> Outcome:
    from twin.identify.identify import identify

    found = identify(_campaign(case, machine), machine, refine=False, gaps=False)
    features = {}
    for p in found.parameters:
        features[f"{p.axis}.{p.name}"] = Feature(p.value.value, p.unit, p.axis, "identification", 0.5 * (p.value.high - p.value.low))
    return Outcome(features, machine=machine)


def _diagnose(case: Case, machine: Machine) -> Outcome:
    from twin.diagnose import diagnose

    document = diagnose(_campaign(case, machine), machine, quick=True, seed=case.table.get("seed", 0)).document()
    features = {"verdict": Feature(document["verdict"], "", "", "diagnosis")}
    found = [f"{e['effect']} on {e['axis']}" for e in document["effects"]]
    features["effects"] = Feature(", ".join(found) or "none", "", "", "diagnosis")
    for e in document["effects"]:
        for name, value in e["parameters"].items():
            half = 0.5 * (value["high"] - value["low"])
            features[f"{e['axis']}.{e['effect']}.{name}"] = Feature(value["value"], value["unit"], e["axis"], "diagnosis", half)
    return Outcome(features, machine=machine)


def _study(case: Case, machine: Machine) -> Outcome:
    from twin.study.design import variants_of
    from twin.study.execution import simulated, threads_here
    from twin.study.labels import UNITS, is_share
    from twin.study.spec import read_study

    study = read_study(case.path("spec"), str(machine.path) if "machine" in case.table else None)
    with tempfile.TemporaryDirectory() as folder:
        rows, _ = simulated(study, variants_of(study), Path(folder), threads_here(1))
    features: dict[str, Feature] = {}
    for number, _, responses, reason in rows:
        if reason:
            features[f"variant {number}"] = Feature(f"cannot run: {reason}", block="study")
        for name, value in responses.items():
            words = name.split("_")
            axis = next((a for a in machine.axis_names if a in words), "")
            unit = "" if is_share(name) else UNITS.get(words[-1], "")
            features[f"variant {number}.{name}"] = Feature(value, unit, axis, "study")
    return Outcome(features, machine=machine)


_RUNNERS: dict[str, Callable[[Case, Machine], Outcome]] = {
    "run": _run,
    "cut": _cut,
    "campaign": _gap,
    "identify": _identify,
    "diagnose": _diagnose,
    "study": _study,
}
