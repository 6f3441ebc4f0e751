"""The report of a diagnosis: one self-contained page, verdict first, evidence below."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.diagnose.budget import FINDINGS, overlap_text
from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.law.figures import laws_figure
from twin.diagnose.report_contents import Stretch, blocks_map, retuned_values, run_levels, stretches
from twin.diagnose.report_figures import budget_figure, closes_something, image, map_figure, stretch_figure, waterfall_figure
from twin.diagnose.wording import (
    calibration_text,
    closed_texts,
    effect_line,
    effect_title,
    parameters_of,
    parameters_text,
    percent,
    place_text,
    sentence_case,
    times,
    unseen_text,
    verdict_sentence,
)
from twin.effects import EFFECTS
from twin.report import Section, Table, write_page
from twin.report.page import made_line
from twin.simulation.summary import listed
from twin.system import shell_word
from twin.units import ARCSEC, LEAST_SHOWN, in_words, plain

Document = dict[str, Any]

CANDIDATES_SHOWN = 12
STRETCHES_SHOWN = 3
ROWS_SHOWN = 20
"""Most contributions of a budget in the page; diagnosis.json holds all."""
SMALL = 0.1
"""Rows of the budget with a smaller contribution, in multiples of the noise, are only counted, unless they are findings."""
LEFT = 2.0
"""Rows with a larger gap after the correction, in multiples of the noise, are highlighted."""

AT_TOOL = (1, 2, 3, 6)
"""Columns of a budget that say something about the tool point."""

_HOW_TO_READ = [
    "The gap is measured minus simulated, in multiples of the measuring noise: 1 is a perfect twin. Shares refer to the squared gap above noise.",
    "'Machine file as it is' is the nominal twin; 'corrected machine' has the re-tuned values and the effects found. The following error is drawn "
    "without the position delay.",
    "A probability compares the candidates of a round with each other and with 'no effect'; it never exceeds 98 %, because a cause outside the "
    "library cannot be excluded.",
]


def write_report(diagnosis: Diagnosis, document: Document, path: Path) -> None:
    """Write the page. Raises InputError if the file cannot be written."""
    axes, _ = run_levels(diagnosis)
    runs = diagnosis.campaign.runs
    seconds = sum(float(run.trace.time[-1] - run.trace.time[0]) for run in runs)
    inputs = f"{diagnosis.campaign.path.name} ({len(runs)} run{'s' * (len(runs) > 1)}, {seconds:.0f} s, axes {' '.join(axes)})"
    sections = sections_of(diagnosis, document, path.parent)
    write_page(path, verdict_sentence(document, numbers=True), gap_sentence(document), sections, made_line(diagnosis.machine.name, inputs))


def sections_of(diagnosis: Diagnosis, document: Document, folder: Path) -> list[Section]:
    """The page from the three answers (where, which, how far) to the evidence; `folder` holds the corrected machine."""
    shown = stretches(diagnosis, document)[:STRETCHES_SHOWN]
    sections = [Section("Where, which, how far", cards=[_where(document), _which(document), _how_far(diagnosis, document)])]
    if document["effects"]:
        sections.append(_budget("Gap budget at the tool point", document["budget"], at_tool=True))
    if program := document.get("budget_on_program"):
        said = f"The corrected machine moves the tool by {plain(program['change'])} um RMS relative to the machine file."
        unknown = "The unexplained gap is not known on a program that was not measured."
        budget = _budget(f"Gap budget on {program['program']}", program, at_tool=False, picture=bool(document["effects"]))
        sections.append(Section(budget.title, [f"{said} {unknown}"], budget.figures, budget.tables))
    measured_on = "held-out runs" if document["gap"]["held_out_runs"] else "the runs of the fit"
    closes = f"First and last bar measured on {measured_on}; percentages refer to the squared gap."
    if not closes_something(diagnosis.waterfall):
        closes = f"Measured on {measured_on}. There is no gap that a correction would close."
    alone = "Each block by itself with its measured inputs, compared with its own noise, so that a fault is visible in one block only."
    sections += [
        Section("What closes the gap", figures=[image(waterfall_figure(diagnosis.waterfall), closes)]),
        Section("Where it lies: share by axis and block", figures=[image(map_figure(*blocks_map(diagnosis, document)), alone)]),
        *(_stretch(diagnosis, s, "Before and after: ") for s in shown[:1]),
        *([_laws(diagnosis, document)] if document.get("laws") else []),
        _next(document, folder),
        *([_effects(document)] if document["effects"] else []),
        *([_places(document)] if document["where"] else []),
        *(_stretch(diagnosis, s, "Evidence: ") for s in shown[1:]),
        _gap_by_signal(document),
        _gap_by_run(diagnosis),
        *([_candidates(document)] if document["candidates"] else []),
        *([_retuned(diagnosis, document, values)] if (values := retuned_values(diagnosis)) else []),
        Section("How to read this page", _HOW_TO_READ),
    ]
    return sections


def gap_sentence(document: Document) -> str:
    """How far the gap shrinks, in multiples of noise."""
    gap = document["gap"]
    where = "held-out runs" if gap["held_out_runs"] else "the runs of the fit"
    if not (document["effects"] or document.get("laws") or document.get("calibrated")):
        return f"The gap is {times(gap['before'])} times the noise, after re-tuning within tolerance {times(gap['after'])} times."
    what = "correction" if document["effects"] or document.get("laws") else "calibration"
    return f"The {what} reduces the gap from {times(gap['before'])} to {times(gap['after'])} times the noise, on {where}."


def _where(document: Document) -> Section:
    if not document["where"]:
        return Section("Where", ["Nowhere", "Every block of every axis agrees with the machine file."])
    first, *others = document["where"]
    scale = f"; scales with {first['scales_with']}" if first["scales_with"] != "-" else ""
    band = f"; {_band(first)}" if "band_hz" in first else ""
    words = [
        f"Axis {first['axis']}, {first['block']}",
        f"{percent(first['share'])} of the residual above noise in all blocks; regime: {first['regime']}{scale}{band}.",
    ]
    words += [f"Mostly in {in_words(', '.join(first['runs'][:3]))}."] if first["runs"] else []
    return Section("Where", words + [f"Also axis {o['axis']}, {o['block']}: {percent(o['share'])}." for o in others[:2]])


def _which(document: Document) -> Section:
    effects, words = document["effects"], []
    for effect in effects[:3]:
        words += [
            sentence_case(effect_title(effect)),
            EFFECTS[effect["effect"]].summary,
            sentence_case(f"{effect_line(document, effect)}."),
        ]
    if not effects:
        words = [{"none": "No effect", "law": "An unlisted law"}.get(document["verdict"], "None of the known effects")]
        words += [f"{len(document['candidates'])} combinations of effect and axis were tried."] if document["candidates"] else []
    words += [f"And {len(effects) - 3} more in the budget below."] if len(effects) > 3 else []
    words += [sentence_case(f"{closed}.") for closed in closed_texts(document)]
    if document["ambiguous_with"]:
        rivals = (f"{effect_title(a)} instead of {in_words(a['instead_of'])}" for a in document["ambiguous_with"])
        words.append(f"Could also be: {'; '.join(rivals)}.")
    return Section("Which", words)


def _how_far(diagnosis: Diagnosis, document: Document) -> Section:
    gap = document["gap"]
    words = [f"{times(gap['before'])} \u2192 {times(gap['after'])} \u00d7 noise"]
    for g in telling_gaps(document):
        signal = f"{g['signal'].capitalize()} of {g['axis']}"
        words.append(f"{signal}: {plain(g['before'])} \u2192 {plain(g['after'])} {g['unit']} RMS (noise {plain(g['noise_floor'])})")
    tolerance = 100.0 * diagnosis.machine.parameter_tolerance
    words.append(f"Re-tuning within \u00b1{tolerance:.2g} % and normal imperfections alone close {percent(gap['retuning_share'])}.")
    held_out = (
        "Each run is predicted by a fit without that run." if gap["held_out_runs"] else "Single run: no run can be held out of the fit."
    )
    return Section("How far", [*words, held_out])


def telling_gaps(document: Document) -> list[dict[str, Any]]:
    """For each axis with an effect its worst signal over noise: axis, signal, before, after, noise_floor, unit."""
    rows = []
    for axis in dict.fromkeys(e["axis"] for e in document["effects"]):
        signals = {name: g for name, g in document["gap"]["axes"].get(axis, {}).items() if g["noise_floor"] > 0}
        if signals:
            name = max(signals, key=lambda s: signals[s]["before"] / signals[s]["noise_floor"])
            rows.append({"axis": axis, "signal": in_words(name), **signals[name]})
    return rows


def _budget(title: str, budget: Document, at_tool: bool, picture: bool = True) -> Section:
    """The contribution of each effect to the error, as a picture and a table."""
    rows = budget["rows"]
    small = [r for r in rows if r["kind"] not in FINDINGS and r["times_noise"] < SMALL]
    shown = [r for r in rows[:ROWS_SHOWN] if r not in small]
    cells = [
        [
            effect_title(r) + (f" ({r['kind']})" if r["kind"] not in FINDINGS else ""),
            plain(r["tool_point"]),
            plain(r["alone"]),
            plain(r["largest"]),
            in_words(r["run"]),
            f"{r['at_s']:.2f}",
            ", ".join(f"{v:.1f}" for v in r["at_mm"]),
            f"{plain(r['position'])} {r['position_unit']}",
            plain(r["current"]),
            plain(r["times_noise"]),
            percent(r["probability"]) if r["kind"] == "effect" else "",
        ]
        for r in shown
    ]
    for r in budget.get("unexplained", ()) if at_tool else ():
        cells.append([f"not explained: axis {r['axis']}, {r['block']}", plain(r["tool_point"]), *[""] * 7, plain(r["times_noise"]), ""])
    most = plain(max((r["tool_point"] for r in small), default=0.0))
    rest = f"{len(small)} more, each below a tenth of the noise, move the tool by up to {most} um: diagnosis.json." if small else ""
    heading = ("contribution", "tool point [um]", "alone [um]", "largest [um]", "in run", "at [s]", "at X, Y, Z of the part [mm]",
               "true position of the axis", "current [A]", "\u00d7 noise", "probability")  # fmt: skip
    marked = frozenset(i for i, r in enumerate(shown) if r["kind"] == "effect")
    caption = (
        "Bar: RMS change of the true tool point if this effect is removed from the corrected machine; line: 95 % interval of its size."
        + (f" Contributions overlap and do not add up: {overlap_text(budget)}." if at_tool else "")
        + " Motion that no encoder measures, such as thermal growth, is included."
    )
    at_rest = max((r["tool_point"] for r in rows), default=0.0) < LEAST_SHOWN
    kept = [i for i in range(len(heading)) if not at_rest or i not in AT_TOOL]
    table = Table(
        [heading[i] for i in kept], [[row[i] for i in kept] for row in cells], marked=marked, words=frozenset({kept.index(4)}), caption=rest
    )
    if at_rest:
        return Section(
            "Gap budget", ["Nothing of it moves the tool point: each row is the change of the true position of its axis."], tables=[table]
        )
    return Section(title, figures=[image(budget_figure(budget), caption)] if picture else [], tables=[table])


def _stretch(diagnosis: Diagnosis, s: Stretch, words: str) -> Section:
    title = f"{words}axis {s.axis}{s.block and f', {s.block}'}, run {in_words(s.run)}, {s.start:.2f} to {s.stop:.2f} s"
    return Section(title, figures=[image(stretch_figure(diagnosis, s), "Measured, nominal and corrected.")])


def _laws(diagnosis: Diagnosis, document: Document) -> Section:
    words = []
    for law in document["laws"]:
        words.append(
            f"Axis {law['axis']}, {law['block']}: {law['sentence']}. Formula: {law['formula']}. It explains {percent(law['explained'])} "
            "of the gap of the axis that the effects leave."
        )
        words += [f"Looks like: {k['name']}. {k['sentence']} To confirm it, measure {k['to_be_sure']}." for k in law["looks_like"]]
    caption = (
        "Points: measured in the block alone, shifted to the level of the formula, with a 95 % band; orange: few samples. Each law is in "
        "machine.toml. It was accepted because it reduces the simulated gap on held-out runs."
    )
    return Section("Laws that no effect describes", words, [image(laws_figure(diagnosis.laws, diagnosis.machine), caption)])


def _next(document: Document, folder: Path) -> Section:
    words = [f"Next measurement: {document['next_measurement']}"]
    corrected = shell_word(folder / "machine.toml")
    if document["effects"] or document.get("laws"):
        words.append(f"The corrected machine is in {corrected}; simulate with it: twin run PROGRAM --machine {corrected}")
        there = shell_word(folder)
        words.append(
            f"What to set in the control, what it brings and what it costs: twin remedy {there} --out {shell_word(folder / 'remedy')}; this page then links to it"
        )
    if unseen := unseen_text(document):
        words.append(
            f"Not visible in these runs and signals at usual size, and therefore not excluded: {unseen}. "
            "twin exam --plan lists the runs or sensors that would show them."
        )
    if document["calibrated"]:
        words.append(
            f"Calibrated, because the file had only assumed or tried it or its controller, or has it in its interval, so no finding: {calibration_text(document)}."
        )
    return Section("What to do next", [*words, *(f"Note: {note}" for note in document["notes"])])


def _effects(document: Document) -> Section:
    rows = []
    for effect in document["effects"]:
        head, tail = [effect_title(effect), effect["block"]], [percent(effect["probability"]), percent(effect["explained"])]
        for p in parameters_of(effect):
            rows.append([*head, p["name"], p["value"], p["interval"] or "not fitted", *tail])
            head, tail = ["", ""], ["", ""]
    heading = ("effect", "block", "parameter", "value", "95 % interval", "probability", "closed on its axis by all")
    return Section("Evidence: effects found", tables=[Table(heading, rows, left=3)])


def _places(document: Document) -> Section:
    rows = []
    for place in document["where"]:
        level = f"{times(place['level'])} \u00d7 noise" if "level" in place else ""
        s = place.get("stretch")
        interval = f"{in_words(s['run'])} {s['from_s']:.2f} to {s['to_s']:.2f} s" if s else ""
        words = [place["regime"], place["scales_with"], _band(place), in_words(", ".join(place["runs"])), interval]
        rows.append([place["axis"], place["block"], percent(place["share"]), level, *words])
    heading = ["axis", "block", "share", "level", "regime", "scales with", "band", "runs", "interval"]
    shown = [column for column in zip(heading, *rows) if set(column[1:]) - {"", "-"}]
    written = frozenset(i for i, column in enumerate(shown) if column[0] in heading[4:])
    names, *lines = zip(*shown)
    return Section("Places of the gap", tables=[Table(names, lines, left=2, words=written)])


def _gap_by_signal(document: Document) -> Section:
    rows: list[list[str]] = []
    marked: set[int] = set()
    for axis, signals in document["gap"]["axes"].items():
        for i, (signal, g) in enumerate(signals.items()):
            left = g["after"] / g["noise_floor"] if g["noise_floor"] > 0 else 0.0
            if left > LEFT:
                marked.add(len(rows))
            numbers = [plain(g[key]) for key in ("before", "after", "noise_floor")]
            rows.append(["" if i else axis, in_words(signal), *numbers, g["unit"], times(left) if left else ""])
    heading = ("axis", "signal", "before", "after", "noise alone", "unit", "after / noise")
    return Section("Gap by axis and signal, RMS over all runs", tables=[Table(heading, rows, left=2, marked=frozenset(marked))])


def _gap_by_run(diagnosis: Diagnosis) -> Section:
    axes, runs = run_levels(diagnosis)
    rows = [[in_words(run), *(f"{times(c[0])} \u2192 {times(c[1])}" if c else "at rest" for c in cells)] for run, cells in runs]
    marked = frozenset(i for i, (_, cells) in enumerate(runs) if any(c and c[1] > LEFT for c in cells))
    table = Table(("run", *axes), rows, marked=marked, caption="Highlighted: more than twice the noise remains.")
    return Section("Gap by run, multiples of noise", tables=[table])


def _candidates(document: Document) -> Section:
    shown = document["candidates"][:CANDIDATES_SHOWN]
    rows = [
        [
            in_words(c["effect"]) + (f", with {in_words(', '.join(c['beside']))}" if "beside" in c else ""),
            place_text(c),
            percent(c["probability"]),
            percent(c["explained"]) if document["verdict"] != "none" else "-",
            parameters_text(c),
        ]
        for c in shown
    ]
    heading = ("effect", "axis", "probability", "share explained after re-tuning", "parameters")
    table = Table(heading, rows, left=2, marked=frozenset(range(len(document["effects"]))), words=frozenset({4}))
    return Section(f"Candidates: the best {len(shown)} of {len(document['candidates'])}", tables=[table])


def _retuned(diagnosis: Diagnosis, document: Document, values: Sequence[tuple[str, str, float]]) -> Section:
    """Deviations by owner (row) and quantity (column); empty where a parameter is not re-tuned."""
    quantities = list(dict.fromkeys(quantity for _, quantity, _ in values))
    cells = {(owner, quantity): deviation for owner, quantity, deviation in values}
    rows = [
        [in_words(owner), *(_signed_percent(cells.get((owner, q))) for q in quantities)] for owner in dict.fromkeys(o for o, _, _ in values)
    ]
    tolerance = 100.0 * diagnosis.machine.parameter_tolerance
    words = [
        f"The prior keeps them near the tolerance of \u00b1{tolerance:.2g} %; they are normal differences between machines, not effects."
    ]
    if document["normal"]:
        kinds = {"elasticity": "an elastic drive train", "slip": "slip before break-away"}
        said = [f"{kinds[EFFECTS[n['name']].normal]} on axis {n['axis']} ({_stiffness(diagnosis, n)})" for n in document["normal"]]
        words.append(f"Normal imperfections of the corrected machine, too small to count as effects: {listed(said)}.")
    return Section("Re-tuned parameters, deviation from the machine file", words, tables=[Table(("", *quantities), rows)])


def _band(place: Document) -> str:
    return f"{plain(place['band_hz'][0], 2)} to {plain(place['band_hz'][1], 2)} Hz" if "band_hz" in place else ""


def _stiffness(diagnosis: Diagnosis, table: Document) -> str:
    """Stiffness of a normal imperfection in data-sheet units."""
    linear = diagnosis.machine.axis(table["axis"]).kind == "linear"
    return f"{plain(table['stiffness'] * 1e-6)} N/um" if linear else f"{plain(table['stiffness'] * ARCSEC)} Nm/arcsec"


def _signed_percent(fraction: float | None) -> str:
    """A deviation in percent with its sign; 0 has none."""
    if fraction is None:
        return ""
    rounded = round(100.0 * fraction, 2)
    return f"{rounded:+.2f} %" if rounded else "0.00 %"
