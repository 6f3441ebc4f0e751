"""The recording of a diagnosis: measured, nominal and corrected motion overlaid, intervals with the largest excess marked, and the residual
of one axis as its effects are added one by one.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.diagnose.budget import simulated_each
from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.report_contents import stretches
from twin.diagnose.view import view_of
from twin.diagnose.wording import effect_title, verdict_sentence
from twin.effects import settings_of, with_effects
from twin.effects.setting import Key
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.replay.events import TELLING, Event
from twin.simulation.gap import COMPARED

if TYPE_CHECKING:
    from twin.replay.curves import PlotLine


def write_recording_of(diagnosis: Diagnosis, document: dict[str, Any], path: Path) -> None:
    """Write the run with the largest excess. The measured machine moves; the two simulated ones are overlaid."""
    from twin.replay.recording import write_recording

    telling = stretches(diagnosis, document)
    name = telling[0].run if telling else diagnosis.campaign.runs[0].name
    run = next(r for r in diagnosis.campaign.runs if r.name == name)
    marks = [
        Event(TELLING, s.axis, s.start, s.stop, f"axis {s.axis}{', ' + s.block if s.block else ''}, {s.start:.2f} to {s.stop:.2f} s")
        for s in telling
        if s.run == name
    ]
    runs = {"measured": run.trace}
    for label, which in (("nominal", "before"), ("corrected", "after")):
        trace = diagnosis.held_out.predictions[which][name].trace
        kept = {key: values for key, values in trace.signals.items() if key[0] in run.trace.axes}
        runs[label] = replace(trace, signals=kept, kinds={axis: kind for axis, kind in trace.kinds.items() if axis in run.trace.axes})
    steps = _effect_by_effect(diagnosis, run, marks[0].axis) if marks else []
    write_recording(path, diagnosis.machine, runs, summary=f"run {name}\n{verdict_sentence(document)}", also=marks, steps=steps)


def _effect_by_effect(diagnosis: Diagnosis, run: MeasuredRun, name: str) -> list[PlotLine]:
    """Position residual of an axis in a run for the machine file, after re-tuning, and after each added effect, largest at the tool point first.
    Empty if its position was not recorded or a machine cannot be simulated.
    """
    from twin.replay.curves import step_curves

    signal = next((s for s in COMPARED if run.trace.has(name, s)), None)
    if signal is None:
        return []
    view = view_of(with_effects(diagnosis.machine, []), run)
    machines = one_by_one(diagnosis, name)
    traces = simulated_each([(view, machine, (name,)) for machine in machines.values()], map, lambda i, trace: trace)
    residual = {label: run.trace.get(name, signal) - trace.get(name, signal) for label, trace in zip(machines, traces) if trace is not None}
    if len(residual) < len(machines):
        return []
    return step_curves(diagnosis.machine.axis(name), run.trace.time, residual)


def one_by_one(diagnosis: Diagnosis, axis: str) -> dict[str, Machine]:
    """Machines from the file to the corrected one, labelled by what was added: re-tuning, then each effect and law of an axis."""
    machine, corrected = diagnosis.machine, diagnosis.corrected
    rows = [r for r in diagnosis.budget.rows if r.axis == axis and r.setting is not None] if diagnosis.budget else []
    steps = {"machine file": machine}
    if not rows:
        return steps | {"corrected": corrected}
    added: set[Key] = set()
    of_rows = {row.setting.key for row in rows if row.setting}
    everything = settings_of(corrected)
    for label, setting in [("re-tuned", None), *((effect_title({"effect": r.name, "axis": r.axis}), r.setting) for r in rows)]:
        added |= {setting.key} if setting else set()
        machine = with_effects(corrected, [s for s in everything if s.key in added or s.key not in of_rows])
        step = label if setting is None else f"+ {label}"
        same = sum(known.startswith(step) for known in steps)  # two waves or two laws of one axis have one title
        steps[f"{step} ({same + 1})" if same else step] = machine
    return steps
