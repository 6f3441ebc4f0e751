"""The report of an identification as one HTML file, and its figures as PNG."""

from __future__ import annotations

import math
from pathlib import Path

from twin.identify import figures
from twin.identify.result import Identification, Parameter, Range
from twin.report import Figure, Section, Table, figure_svg, save_png, write_page
from twin.report.stamp import made_line

CAPTIONS = {
    "friction": "Friction against speed in both directions. Points: measured torque at constant speed minus inertia and gravity. Line and band: "
    "the law Fc sign(v) + Fv v with its 95 % interval.",
    "inertia": "Torque minus friction and gravity against acceleration, below 20 Hz. The current is the mean over a position cycle.",
    "gravity": "Gravity torque of the table, and its first moments.",
    "residuals": "Residual of the torque balance, run after run, and its autocorrelation. The filter alone correlates rows up to 50 ms apart. Longer correlation is why the intervals come from whole strokes.",
    "gap": "Simulated against measured on held-out motion.",
}


def write_report(result: Identification, path: str | Path) -> list[Path]:
    """Write the page and, beside it, each figure as PNG; returns all paths."""
    path = Path(path)
    drawn = {
        "friction": figures.friction_figure(result) if result.direct.balance else None,
        "inertia": figures.inertia_figure(result) if result.direct.balance else None,
        "gravity": figures.gravity_figure(result),
        "residuals": figures.residual_figure(result) if result.direct.balance else None,
        "gap": figures.gap_figure(result),
    }
    files = [path]
    pictures = {}
    for name, figure in drawn.items():
        if figure is not None:
            png = path.with_name(f"{path.stem}_{name}.png")
            save_png(figure, png)
            files.append(png)
            pictures[name] = Figure(figure_svg(figure), CAPTIONS[name])
    sections = [_summary(result)]
    for title, names in (
        ("Friction", ("friction",)),
        ("Inertia", ("inertia",)),
        ("Tilting table", ("gravity",)),
        ("Residuals", ("residuals",)),
    ):
        shown = [pictures[n] for n in names if n in pictures]
        if shown:
            sections.append(Section(title, figures=shown))
    sections.append(_parameters(result))
    sections.append(_gap(result, pictures.get("gap")))
    sections += [_caveats(result), _signals(result)]
    axes = ", ".join(a.name for a in result.before.axes)
    lead = f"{result.before.name}, axes {axes}. Campaign {result.campaign}.\nFitted on {', '.join(result.training)}; held out: {', '.join(result.held_out) or 'none'}."
    write_page(path, "Identified from measured traces", lead, sections, made_line(result.before.name, str(result.campaign)))
    return files


SHOWN = 12
"""Number of changed values in the summary; the table has all."""


def _summary(result: Identification) -> Section:
    """What was written, which values changed, and the remaining gap."""
    if any(p.refined for p in result.parameters):
        route = {"refined": "the re-simulation", "control": "the position controllers alone"}.get(result.chosen, result.chosen)
        chosen = f"{route}: for each axis, those with the smallest gap on held-out motion"
    else:
        chosen = "the regression, without re-simulation"
    moved = _moved(result)
    if moved:
        count = "1 value of the old machine file lies" if len(moved) == 1 else f"{len(moved)} values of the old machine file lie"
        found = f"{count} outside the identified 95 % interval" + (f"; the {SHOWN} furthest:" if len(moved) > SHOWN else ":")
    else:
        found = "No value of the old machine file lies outside the identified 95 % interval."
    lines = [result.refused or f"The new machine file contains the values of {chosen}.", *_gap_lines(result), found]
    return Section("In short", lines, items=moved[:SHOWN])


def _moved(result: Identification) -> list[str]:
    """Values that were written and whose interval does not contain the file's old value, largest relative change first."""
    moved = []
    for p in result.parameters:
        taken = result.taken(p)
        if taken is not None and abs(taken.value - p.before) > taken.half:
            text = f"{p.axis}: {p.name.replace('_', ' ')} from {p.before:.4g} to {taken.value:.4g} {p.unit} ({_half(taken)})"
            moved.append((abs(taken.value - p.before) / max(taken.half, 1e-300), text))
    return [text for _, text in sorted(moved, key=lambda row: -row[0])]


def _gap_lines(result: Identification) -> list[str]:
    """Position gap of each axis before and after, with noise; empty if it was not simulated."""
    parts = []
    for axis, signals in result.gaps.get("before", {}).items():
        stage = result.chosen if result.stage_of is None else result.stage_of.get(axis, "")
        after = result.gaps.get(stage, result.gaps["before"]).get(axis, {})
        if "position" in signals and "position" in after:
            before, now = signals["position"], after["position"]
            parts.append(f"{axis} {before['rms']:.3g} to {now['rms']:.3g} {now['unit']} (noise {now['noise']:.3g})")
    return [f"Position gap on held-out motion, RMS: {'; '.join(parts)}."] if parts else []


def _caveats(result: Identification) -> Section:
    """Limits of the result and findings about the recording."""
    times = ", ".join(f"{k} after {v:.0f} s" for k, v in result.seconds.items())
    lines = [
        "Current and motion identify inertia, friction and gravity only as products with each motor's torque constant. "
        + (
            "The products agree with the machine file's parameter_tolerance and were split with it. The intervals of the values include this tolerance, those of the products do not."
            if result.tolerance_holds and all(result.tolerance_holds.values())
            else "They contradict the machine file's parameter_tolerance, so its torque constants were kept and the other values follow from them. "
            "A known mass, a torque wrench or the motor's test sheet would determine them."
        ),
        f"Time: {times}.",
    ]
    findings = [str(f) for f in (*result.findings, *result.notes)] or ["No problem was found in the recording."]
    return Section("Limits and findings", lines, items=findings)


WIDER_INTERVAL = 20.0
"""A parameter is not compared with its held-out value if the interval of that is wider by more than this factor."""


def _parameters(result: Identification) -> Section:
    heading = [
        "axis",
        "parameter",
        "unit",
        "before",
        "value",
        "95 %",
        "product",
        "95 %",
        "re-simulated",
        "95 %",
        "held out",
        "condition",
        "at bound",
    ]
    rows, marked = [], set()  # type: ignore[var-annotated]
    for p in result.parameters:
        judges = p.held_out is not None and p.held_out.half < WIDER_INTERVAL * p.estimate.half
        off = judges and p.held_out is not None and (p.held_out.low > p.estimate.high or p.held_out.high < p.estimate.low)
        if off or p.at_bound:
            marked.add(len(rows))
        rows.append(
            [
                p.axis,
                p.name.replace("_", " "),
                p.unit,
                f"{p.before:.4g}",
                _number(p.value),
                _half(p.value),
                _number(p.estimate) if p.product else "",
                _half(p.estimate) if p.product else "",
                _number(p.refined),
                _half(p.refined),
                _held_out_cell(p),
                f"{p.condition:.0f}" if math.isfinite(p.condition) else "",
                "yes" if p.at_bound else "",
            ]
        )
    note = (
        "Product: the value at the machine file's torque constant, as determined by current and motion. Value: after the split. Marked rows: the interval "
        "from held-out motion does not overlap, or the value lies at its bound. Condition: condition number of the scaled regressors."
    )
    shown_columns = [i for i in range(len(heading)) if i < 6 or any(row[i] for row in rows)]
    heading, rows = [heading[i] for i in shown_columns], [[row[i] for i in shown_columns] for row in rows]
    return Section("Parameters before and after", [note], tables=[Table(heading, rows, left=3, marked=frozenset(marked))])


def _number(r: Range | None) -> str:
    """A value with as many digits as its interval justifies, at least two and at most six."""
    if r is None:
        return ""
    standing = abs(r.value) / max(r.half, 1e-5 * abs(r.value), 1e-300)
    return f"{r.value:.{max(math.ceil(math.log10(max(standing, 1.0))) + 1, 2)}g}"


def _half(r: Range | None) -> str:
    if r is None:
        return ""
    return f"± {100 * r.half / abs(r.value):.2g} %" if abs(r.value) > 20.0 * r.half else r.interval.replace("+-", "±")


def _held_out_cell(p: Parameter) -> str:
    return f"{_number(p.held_out)} {_half(p.held_out)}" if p.held_out else ""


def _gap(result: Identification, picture: Figure | None) -> Section:
    rows = []
    if result.gaps:
        stages = list(result.gaps)
        for axis, signals in result.gaps[stages[0]].items():
            for signal, g in signals.items():
                if not all(signal in result.gaps[s].get(axis, {}) for s in stages):
                    continue
                rows.append(
                    [
                        axis,
                        signal,
                        str(g["unit"]),
                        *(f"{result.gaps[s][axis][signal]['rms']:.4g}" for s in stages),
                        f"{result.gaps[stages[-1]][axis][signal]['noise']:.4g}",
                    ]
                )
        table = [Table(["axis", "signal", "unit", *stages, "noise alone"], rows, left=3)]
        return Section("Gap before and after", figures=[picture] if picture else [], tables=table)
    return Section("Gap before and after", ["Not simulated."])


def _signals(result: Identification) -> Section:
    rows = [[c.axis, c.signal, f"{1e6 * c.seconds:.0f}", f"± {1.96e6 * c.deviation:.0f}"] for c in result.skews]
    before, after = (m.document.get("measurement", {}) for m in (result.before, result.machine))
    noise = [[k, f"{before[k]:.4g}", f"{after[k]:.4g}"] for k in before if "noise" in k and after[k] != before[k]]
    return Section(
        "Recording",
        [
            "Skew of each channel against the scale, the current against the acceleration; below 0.4 ms a current's skew cannot be separated from the current loop."
        ],
        tables=[
            Table(["axis", "channel", "late [us]", "95 %"], rows, left=2),
            Table(["measuring noise, from standstills", "file", "measured"], noise),
        ],
    )
