"""The report of an identification as one HTML file, and its figures as PNG."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from twin.estimate.regression import Range
from twin.identify import figures
from twin.identify.check_recording import in_sentences
from twin.identify.result import Identification, Outcome, words_of
from twin.identify.write import is_wide
from twin.machine.commented import BOUNDED
from twin.report import Figure, Section, Table, figure_svg, save_png, write_page
from twin.report.page import made_line
from twin.simulation.summary import listed
from twin.units import in_words, plain

DRAWN: dict[str, tuple[str, Callable[[Identification], Any], str]] = {
    "friction": (
        "Friction", figures.friction_figure,
        "Friction against speed in both directions. Points: measured torque at constant speed minus inertia and gravity. Line and band: "
        "the law Fc sign(v) + Fv v with its 95 % interval.",
    ),
    "gravity": ("Tilting table", figures.gravity_figure, "Gravity torque of the table, and its first moments."),
    "gap": ("Gap before and after", figures.gap_figure, "Simulated against measured on held-out motion."),
}  # fmt: skip
"""Section of each figure, what draws it (None: nothing to show), and its caption."""


def write_report(result: Identification, path: str | Path) -> list[Path]:
    """Write the page and, beside it, each figure as PNG; returns all paths."""
    path = Path(path)
    files, sections = [path], [summary(result)]
    for name, (title, draw, caption) in DRAWN.items():
        figure = draw(result)
        if figure is not None:
            files.append(path.with_name(f"{path.stem}_{name}.png"))
            save_png(figure, files[-1])
        pictures = [Figure(figure_svg(figure), caption)] if figure is not None else []
        if name == "gap":
            sections += [
                Section("Parameters before and after", [_HOW_TO_READ], tables=[parameters_table(result)]),
                _gap(result, title, pictures),
            ]
        elif pictures:
            sections.append(Section(title, figures=pictures))
    sections.append(_caveats(result))
    axes = ", ".join(a.name for a in result.before.axes)
    lead = f"{result.before.name}, axes {axes}. Campaign {result.campaign}."
    write_page(path, "Identified from measured traces", lead, sections, made_line(result.before.name, str(result.campaign)))
    return files


SHOWN = 12
"""Number of changed values in the summary; the table has all."""


def summary(result: Identification) -> Section:
    """Route of the written values, values that changed, and the remaining gap."""
    if any(p.refined for p in result.parameters):
        route = {"refined": "the fit in closed loop", "control": "the position controllers alone"}.get(result.chosen, result.chosen)
        chosen = f"{route}: for each axis, those with the smallest gap on held-out motion"
    else:
        chosen = "the regression"
    moved = _moved(result)
    if moved:
        count = "1 value of the old machine file lies" if len(moved) == 1 else f"{len(moved)} values of the old machine file lie"
        found = f"{count} outside the identified 95 % interval" + (f"; the {SHOWN} furthest:" if len(moved) > SHOWN else ":")
    else:
        found = "No value of the old machine file lies outside the identified 95 % interval."
    runs = f"Fitted on {', '.join(result.training)}; held out: {', '.join(result.held_out) or 'none'}."
    lines = [result.refused or f"The new machine file contains the values of {chosen}.", runs, *_gap_lines(result), found]
    return Section("In short", lines, items=moved[:SHOWN])


def _moved(result: Identification) -> list[str]:
    """Values that were written and whose interval does not contain the file's old value, largest relative change first."""
    moved = []
    for p in result.parameters:
        taken = result.taken(p)
        if taken is not None and abs(taken.value - p.before) > taken.half:
            text = f"{p.axis}: {words_of(p.name, p.axis)} from {p.before:.4g} to {taken.number} {p.unit} ({_half(taken)})"
            moved.append((abs(taken.value - p.before) / max(taken.half, 1e-300), text))
    return [text for _, text in sorted(moved, key=lambda row: -row[0])]


def _gap_lines(result: Identification) -> list[str]:
    """Position gap of each axis before and after, with noise, and the axes that are not explained; empty if it was not simulated."""
    parts = []
    for axis, signals in result.gaps.get("before", {}).items():
        after = result.gaps.get(result.stage(axis), result.gaps["before"]).get(axis, {})
        if "position" in signals and "position" in after:
            before, now = signals["position"], after["position"]
            parts.append(f"{axis} {plain(before['rms'])} to {plain(now['rms'])} {now['unit']} (noise {plain(now['noise'])})")
    left = [f"{axis} ({in_words(signal)} {plain(ratio)} x noise)" for axis, (signal, ratio) in result.unexplained().items()]
    lacking = f"The model lacks something on {listed(left)}: the 95 % intervals of such an axis hold for a complete model only. `twin diagnose` looks for the cause."
    return [*([f"Position gap on held-out motion, RMS: {'; '.join(parts)}."] if parts else []), *([lacking] if left else [])]


def _caveats(result: Identification) -> Section:
    """Limits of the result and findings about the recording."""
    lines = [
        "Current and motion identify inertia, friction and gravity only as products with each motor's torque constant. "
        + (
            "The products agree with the machine file's parameter_tolerance and were split with it. The intervals of the values include this tolerance, those of the products do not."
            if result.tolerance_holds and all(result.tolerance_holds.values())
            else "They contradict the machine file's parameter_tolerance, so its torque constants were kept and the other values follow from them. "
            "A known mass, a torque wrench or the motor's test sheet would determine them."
        ),
    ]
    findings = in_sentences((*result.findings, *result.notes)) or ["No problem was found in the recording."]
    return Section("Limits and findings", lines, items=findings)


def parameters_table(result: Identification) -> Table:
    """Identified value of each parameter, and whether it is in the new file. A written value with a wide interval is bounded, as in the file."""
    rows = []
    for p in result.parameters:
        taken, outcome = result.taken(p), result.outcome(p)
        r = taken or p.refined or p.value
        found = [r.number, _half(r), f"{p.estimate.number} {_half(p.estimate)}" if p.product else ""]
        became = BOUNDED if taken is not None and is_wide(p, taken) else outcome
        rows.append(
            [p.axis, words_of(p.name, p.axis), p.unit, f"{p.before:.4g}", *(["", "", ""] if outcome == Outcome.REFUSED else found), became]
        )
    heading = ("axis", "parameter", "unit", "before", "identified", "95 %", "product at the file's Kt", "result")
    return Table(heading, rows, left=3, marked=frozenset(i for i, p in enumerate(result.parameters) if p.at_bound))


_HOW_TO_READ = (
    "Product: the value at the machine file's torque constant, as determined by current and motion. Identified: after the split. Marked rows: the value lies "
    "at its bound. Result: identified (in the new file); bounded (in the new file, its interval is wider than half of it); agrees with file (whose value "
    "stays and lies in the interval); refused (held-out motion contradicts the value, which is not shown; the file's stays)."
)


def _half(r: Range) -> str:
    return f"± {100 * r.half / abs(r.value):.2g} %" if abs(r.value) > 20.0 * r.half else r.interval.replace("+-", "±")


def _gap(result: Identification, title: str, pictures: Sequence[Figure]) -> Section:
    if not result.gaps:
        return Section(title, ["Not simulated."])
    rows = []
    for (axis, signal), gaps in figures.shared_gaps(result).items():
        rows.append([axis, in_words(signal), gaps[0]["unit"], *(plain(g["rms"]) for g in gaps), plain(gaps[-1]["noise"])])
    heading = ["axis", "signal", "unit", *(figures.STAGES[s][1] for s in result.gaps), "noise alone"]
    return Section(title, figures=pictures, tables=[Table(heading, rows, left=3)])
