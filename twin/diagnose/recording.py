"""The recording of a diagnosis: measured, nominal and corrected over each other, the telling stretches marked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.evidence import stretches
from twin.diagnose.wording import verdict_sentence
from twin.replay.events import TELLING, Event


def write_recording_of(diagnosis: Diagnosis, document: dict[str, Any], path: Path) -> None:
    """Write the run with the most telling stretch; the measured machine moves, the two simulated ones are drawn over it."""
    from twin.replay import write_recording

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
        trace = diagnosis.predictions[which][name].trace
        kept = {key: values for key, values in trace.signals.items() if key[0] in run.trace.axes}
        runs[label] = replace(trace, signals=kept, kinds={axis: kind for axis, kind in trace.kinds.items() if axis in run.trace.axes})
    write_recording(path, diagnosis.machine, runs, summary=f"run {name}\n{verdict_sentence(document)}", also=marks)
