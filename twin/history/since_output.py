"""`diagnosis.json`, machine file and report of a diagnosis since a baseline: the effects are the differences.

Pictures show what was recorded then and now where a change shows clearest, and its change beside that of the twin.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure
import numpy as np
from scipy.ndimage import uniform_filter1d
from threadpoolctl import threadpool_limits

from twin.diagnose import diagnose
from twin.diagnose.budget import SIGNALS, Part, budget_over, document_of
from twin.diagnose.check_campaign import check_campaign, guessed_controls
from twin.diagnose.judgement import EVEN, LOUD
from twin.diagnose.output import write_diagnosis
from twin.diagnose.report_figures import CORRECTED, MEASURED, MOST_POINTS, NOISE, image, signal_of
from twin.diagnose.settings import T
from twin.diagnose.simulations import Mapper, simulate_group
from twin.diagnose.tuning import moved_by
from twin.diagnose.wording import percent, place_text, times
from twin.effects import Setting, settings_of
from twin.effects.setting import key_in
from twin.errors import TwinError
from twin.estimate.regression import NORMAL_95
from twin.files import output_folder, write_json
from twin.history.columns import changed
from twin.history.dated import day_of
from twin.history.document import cause_entry, difference_text, entry_of
from twin.history.projection import reference_view
from twin.history.series import same_program
from twin.history.since import Difference, Differences, differences
from twin.history.watch import program_of
from twin.machine.commented import guessed_values
from twin.machine.machine import Machine, write_machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.recordings.trace import Trace
from twin.report import Section, Table, new_figure, write_page
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
    tried = sorted({e["axis"] for e in effects} & guessed_controls(machine))
    if tried:
        notes.append(
            f"axis {', '.join(tried)}: numbers of the control are only tried, bounded or assumed, and the twin answers a change with them: a size may be "
            "off by more than its interval, and a second cause may stand in for what they miss"
        )
    effects.sort(key=lambda e: -tool.get(key_in(e), 0.0))
    unknown = any(d.is_unexplained for d in found)
    changes = "; ".join("perhaps " * (e["probability"] <= EVEN) + e["sentence"] for e in effects)
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
        *([Section("Notes", items=document["notes"])] if document["notes"] else []),
    ]  # fmt: skip
    write_page(out / "report.html", f"Since {', '.join(document['since'])}", document["sentence"], sections)


DRAWN = {"position": "following error"}
"""A position is drawn as the following error."""

WINDOW_S = 2.0
"""Length of the interval that is drawn [s]."""


class ShownChange(NamedTuple):
    """One signal (sample,) in `unit` over an interval, smoothed: recorded then and now, and the change that the twin makes of the causes found."""

    axis: str
    run: str
    signal: str
    unit: str
    time: np.ndarray
    then: np.ndarray
    now: np.ndarray
    twin: np.ndarray

    @property
    def caption(self) -> str:
        return f"Axis {self.axis}, run {self.run}, where the change shows clearest; means over {1e3 * T.smooth_s:.0f} ms."


def where_changes_show(
    changes: Sequence[Difference], present: Campaign, baselines: Sequence[Campaign], reference: Machine, today: Machine
) -> list[ShownChange]:
    """Where each change shows clearest, each place once; without those that have no recording of the same set points, or cannot be simulated."""
    runs = {run.name: run for run in present.runs}
    earlier = [run for baseline in baselines for run in baseline.runs]
    places = dict.fromkeys(
        (one.runs[0], axis, DRAWN.get(channel, channel)) for one in changes if one.shows for axis, channel in [one.shows]
    )
    found = (_shown(runs[name], earlier, axis, signal, reference, today) for name, axis, signal in places)
    return [shown for shown in found if shown is not None]


def _shown(
    run: MeasuredRun, earlier: Sequence[MeasuredRun], axis: str, signal: str, reference: Machine, today: Machine
) -> ShownChange | None:
    """A signal of an axis where the twin changes it most. None without a recording of the same set points, or if a machine cannot be simulated."""
    own = reference.axis(axis)
    signal = own.recorded_as(signal)
    apart = _offset(run, earlier, axis)
    if apart is None:
        return None
    before, first, start = apart
    try:
        traces = [simulate_group(reference_view(machine, run), (axis,)).without_noise for machine in (reference, today)]
    except TwinError:
        return None
    smooth = max(1, round(T.smooth_s / run.trace.period))
    unit = signal_of(own, run.trace, run.trace, signal)[1]

    def values(trace: Trace, measured: Trace) -> np.ndarray:
        return np.asarray(uniform_filter1d(signal_of(own, trace, measured, signal)[0], smooth))

    count = min(len(run.trace.time) - first, len(before.time) - start)
    without, with_changes = (values(trace, run.trace) for trace in traces)
    twin, now = (values_of[first:][:count] for values_of in (with_changes - without, values(run.trace, run.trace)))
    then = values(before, before)[start:][:count]
    width = min(count, max(1, round(WINDOW_S / run.trace.period)))
    at = int(np.argmax(np.convolve(np.square(twin), np.ones(width), "valid")))
    part = slice(at, at + width, max(1, width // MOST_POINTS))
    return ShownChange(axis, run.name, signal, unit, run.trace.time[first:][part], then[part], now[part], twin[part])


def _offset(run: MeasuredRun, earlier: Iterable[MeasuredRun], axis: str) -> tuple[Trace, int, int] | None:
    """The latest earlier recording of the same program with the same set points of this axis, and the samples of both where the axis begins to move."""
    if not run.trace.has(axis, "setpoint"):
        return None
    found, program = None, program_of([run])
    for one in earlier:
        if one.feedforward != run.feedforward or abs(one.trace.period / run.trace.period - 1.0) > 1e-6:
            continue
        if not same_program(program_of([one]), program):
            continue
        points = [trace.get(axis, "setpoint") for trace in (run.trace, one.trace)]
        first, start = (int(np.argmax(np.diff(p) != 0.0)) for p in points)
        count = min(len(points[0]) - first, len(points[1]) - start)
        now, then = points[0][first:][:count], points[1][start:][:count]
        if np.abs(now - then).max() <= 1.5 * np.abs(np.diff(now)).max():  # one sample apart
            found = one.trace, first, start
    return found


def change_figure(shown: ShownChange) -> Figure:
    """The signal then and now, and its change beside that of the twin."""
    figure, parts = new_figure(2, 1, 12.6, 2.2, sharex=True)
    above, below = parts[:, 0]
    above.plot(shown.time, shown.then, color=NOISE, linewidth=1.3, label="recorded then")
    above.plot(shown.time, shown.now, color=MEASURED, linewidth=1.3, label="recorded now")
    above.set_ylabel(f"{in_words(shown.signal)} [{shown.unit}]", fontsize=9)
    below.plot(shown.time, shown.now - shown.then, color=MEASURED, linewidth=4.0, alpha=0.35, label="recorded change")
    below.plot(shown.time, shown.twin, color=CORRECTED, linewidth=1.3, label="the twin with what it found")
    below.set_ylabel(f"change [{shown.unit}]", fontsize=9)
    below.set_xlabel("time in the run [s]", fontsize=9)
    for ax in (above, below):
        ax.margins(x=0)
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=2, fontsize=9, frameon=False, borderpad=0.1)
    figure.align_ylabels()
    return figure
