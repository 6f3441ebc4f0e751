"""`diagnosis.json`, machine file and report of a diagnosis since a baseline: the effects are the differences."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from twin.diagnose import diagnose
from twin.diagnose.budget import SIGNALS, Part, budget_over, document_of
from twin.diagnose.check_campaign import check_campaign
from twin.diagnose.judgement import LOUD
from twin.diagnose.output import write_diagnosis
from twin.diagnose.report_figures import image
from twin.diagnose.simulations import Mapper
from twin.diagnose.tuning import moved_by
from twin.diagnose.wording import percent, place_text, times
from twin.effects import Setting, settings_of
from twin.effects.setting import key_in
from twin.estimate.regression import NORMAL_95
from twin.files import output_folder, write_json
from twin.history.columns import changed
from twin.history.dated import day_of
from twin.history.document import cause_entry, difference_text, entry_of
from twin.history.projection import reference_view
from twin.history.since import Difference, Differences, differences
from twin.history.since_figure import ShownChange, change_figure, where_changes_show
from twin.machine.commented import guessed_values
from twin.machine.machine import Machine, write_machine
from twin.recordings.campaign import Campaign
from twin.report import Section, Table, write_page
from twin.simulation.gap import sensor_noise
from twin.simulation.summary import listed
from twin.system import cores, shell_word
from twin.units import in_words


@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnosed_since(
    present: Campaign, baselines: Sequence[Campaign], machine: Machine, out: Path, quick: bool, seed: int, progress: Callable[[str], None]
) -> tuple[dict[str, Any], Machine, list[ShownChange]]:
    """The document, the machine of today, and where each change shows clearest. The latest baseline is diagnosed in OUT/baseline, unless the machine has effects already."""
    when = listed([baseline.path.name if (day := day_of(baseline.path)) is None else f"{day:%Y-%m-%d}" for baseline in baselines])
    reference, notes = machine, []
    check_campaign(present, machine)
    if not machine.effects:
        diagnosis = diagnose(baselines[-1], machine, quick=quick, seed=seed, progress=progress)
        left = write_diagnosis(diagnosis, out / "baseline")["gap"]["after"]
        reference = diagnosis.corrected
        if diagnosis.verdict == "unknown" and left > LOUD and not guessed_values(machine):
            notes = [
                f"{machine.name} with what was found in the baseline leaves {times(left)} times the noise there: shares are those of its values, and a cause may "
                f"stand in for another one; if it is not this machine: twin machine new --from-recording {shell_word(baselines[-1].path)} --out MACHINE.toml"
            ]
    with ThreadPoolExecutor(cores()) as pool:
        found, today = differences(present, baselines, reference, pool.map, progress)
        progress("computing the budget")
        several = [one for d in found for one in d.found]
        budget = _budget(several, present, reference, today, pool.map)
    shown = where_changes_show(several, present, baselines, reference, today)
    before, after = (float(np.sqrt(np.mean([getattr(d, which) ** 2 for d in found]))) if found else 1.0 for which in ("before", "after"))
    was = {s.key: s.parameters for s in settings_of(reference)}
    tool = {key_in(row): row["tool_point"] for row in budget["rows"]}
    effects = []
    for d in found:
        for one in d.found:
            entry = entry_of(one.direction, reference, one.size, NORMAL_95 * one.error)
            entry |= {
                "probability": one.probability,
                "explained": max(1.0 - d.left, 0.0),
                "was": dict(was.get(one.direction.setting.key, {})),
            }
            effects.append(entry | {"sentence": difference_text(entry, one.size)})
    effects.sort(key=lambda e: -tool.get(key_in(e), 0.0))
    unknown = any(d.is_unexplained for d in found)
    changes = "; ".join(e["sentence"] for e in effects)
    sentence = f"Since {when}: {changes}." if changes else f"No difference from {when} beyond noise and what repetitions differ by."
    if unknown:
        sentence = f"Since {when} something changed that no effect explains{f'; part of it is {changes}' * bool(changes)}."
    document = {
        "verdict": "unknown" if unknown else "effect" if effects else "none",
        "since": [baseline.path.name for baseline in baselines],
        "sentence": sentence,
        "effects": effects,
        "candidates": _candidates(found, effects, reference),
        "where": _where(found, several),
        "gap": {
            "before": before,
            "after": after,
            "noise_floor": 1.0,
            "unit": "RMS of the difference from the baseline in the directions of the effects, in multiples of what repetitions differ by",
            "held_out_runs": sorted({name for d in found if len(d.held_out) > 1 for name in d.held_out}),
        },
        "budget": budget,
        "ambiguous_with": [
            {**cause_entry(r), "instead_of": one.cause[0], "instead_of_axis": one.cause[1]} for one in several for r in one.rivals
        ],
        "not_visible": [{**cause_entry(c), "usual_sizes": None} for d in found for c in d.not_seen],
        "next_measurement": "the same programs once more: two recordings of one day show what differs between repetitions",
        "laws": [],
        "notes": [*notes, *(note for d in found for note in d.notes)],
    }
    return document, today, shown


def _candidates(found: Sequence[Differences], effects: Sequence[dict[str, Any]], machine: Machine) -> list[dict[str, Any]]:
    """All causes, those found first, then by evidence."""
    named = {(e["effect"], e["axis"], e.get("from_axis", "")) for e in effects}
    others = [one for d in found for cause, one in d.candidates.items() if cause not in named]
    unsaid = {"probability": 0.0, "explained": 0.0}
    rows = [{**entry_of(direction, machine, size, 0.0), **unsaid, "evidence": evidence} for evidence, size, direction in others]
    return [*effects, *sorted(rows, key=lambda row: -row["evidence"])]


def _where(found: Sequence[Differences], several: Sequence[Difference]) -> list[dict[str, Any]]:
    total = sum(one.evidence for one in several) or 1.0
    rows = [(one.cause[1], one.direction.setting.effect.block, one.evidence / total, one.runs) for one in several]
    rows += [(d.axes[0], "mechanics", 0.0, d.held_out[:3]) for d in found if d.is_unexplained]
    return [
        {"axis": axis, "block": block, "share": share, "scales_with": "-", "regime": "all", "runs": list(runs)}
        for axis, block, share, runs in sorted(rows, key=lambda row: -row[2])
    ]


def _budget(several: Sequence[Difference], present: Campaign, reference: Machine, machine: Machine, mapper: Mapper) -> dict[str, Any]:
    """What each change moves: the machine of today with and without it, over the runs of today."""
    views = [reference_view(reference, run) for run in present.runs]
    rotary = tuple(a.name for a in reference.axes if a.kind == "rotary")
    parts = []
    for one in several:
        effect = one.direction.setting.effect
        gone = Setting(effect, one.cause[1], {}, one.cause[2] or None)
        own = next((s for s in settings_of(machine) if s.key == one.direction.setting.key), gone)
        without = changed(reference, [c for other in several if other is not one for c in other.changes])
        moved = moved_by([own], rotary)
        parts.append(Part("effect", effect.name, one.cause[1], moved, without, changed(reference, list(one.changes)), own))
    noise = {
        (axis.name, signal): level
        for axis in reference.axes
        for signal in SIGNALS
        if (level := sensor_noise(reference, axis, axis.recorded_as(signal))) > 0.0
    }
    budget = budget_over(parts, reference, machine, views, [None] * len(views), noise, mapper)
    probability = {one.direction.setting.key: one.probability for one in several}
    error = {one.direction.setting.key: NORMAL_95 * one.error / abs(one.size) for one in several}
    return {**document_of(budget, reference, probability, error), "unexplained": []}


def write_since(document: dict[str, Any], machine: Machine, shown: Sequence[ShownChange], out: Path) -> None:
    """Write `diagnosis.json`, `machine.toml` (the machine of today) and `report.html`."""
    output_folder(out)
    write_json(document, out / "diagnosis.json", "diagnosis")
    write_machine(machine, out / "machine.toml")
    gap, tool = document["gap"], {(r["effect"], r["axis"]): r for r in document["budget"]["rows"]}
    both = ((e, tool.get((e["effect"], e["axis"]))) for e in document["effects"])
    rows = [
        [e["sentence"], f"{r['tool_point']:.2f}", f"{r['current']:.2f}", f"{e['probability']:.2f}", percent(e["explained"])]
        for e, r in both
        if r
    ]
    sections = [
        Section(
            "What changed",
            figures=[image(change_figure(one), one.caption) for one in shown],
            tables=[Table(("change", "at the tool point [um RMS]", "current [A RMS]", "probability", "of what changed on its axes, all explain"), rows)] if rows else [],
            paragraphs=[
                f"Difference from the baseline: {gap['before']:.1f} times what repetitions differ by, {gap['after']:.1f} times once the changes are in "
                f"the twin ({'on runs left out of the fit' if gap['held_out_runs'] else 'one run: nothing could be left out'})."
            ],
        ),
        Section("Could also be", items=[f"{in_words(r['effect'])} on {r['axis']} instead of {in_words(r['instead_of'])} on {r['instead_of_axis']}" for r in document["ambiguous_with"]] or ["Nothing else explains it as well."]),
        Section("Not visible in these runs", items=[f"{in_words(r['effect'])} on {place_text(r)}" for r in document["not_visible"]] or ["Every change of a fifth of its usual size would show."]),
        Section("Notes", items=document["notes"] or ["None."]),
    ]  # fmt: skip
    write_page(out / "report.html", f"Since {', '.join(document['since'])}", document["sentence"], sections)
