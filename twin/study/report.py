"""The report of a study: findings in words, a section for each response, the trade-off, what could not be run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.report import Figure, Section, Table, figure_svg, new_figure, save_png, write_page
from twin.report.figure import AMBER, BLUE, GREEN, RED, SOFT
from twin.report.stamp import made_line
from twin.study.constraints import in_words
from twin.study.duty import Duty, driven_axes, torque_speed_figure, torque_table
from twin.study.holding_figure import holding_figure
from twin.study.labels import changed, label_of, scale_of, titled, unit_of, valued
from twin.study.outcomes import Effect, depends, middle_of
from twin.study.paths import unit_at
from twin.study.results import Answers, Response, values_of
from twin.study.spec import Study

MOST_LINES = 50
"""Rows of a table in the report; all of them are in table.csv."""
MOST_BARS = 12
MANY_POINTS = 200
ENTRIES = (BLUE, AMBER, GREEN, RED, "#7a4f9a", "#3f8f9b")
"""Colours of the entries of a catalogue."""
COLUMNS = 3
"""Panels side by side."""


ROUNDING = 1e-9
"""Share of a response below which a change of it is the rounding of a surrogate."""


def sentences(answers: Answers) -> list[str]:
    """The findings in words: which factor moves each response how far."""
    said = []
    for r in answers.responses:
        text = f"{label_of(r.name)}: {valued(r.name, float(r.y.min()))} to {valued(r.name, float(r.y.max()))}"
        if r.swings:
            s = r.swings[0]
            text += f"; {s.factor} moves it most, by {changed(r.name, s.swing)}: "
            text += f"least at {answers.said_of(s.factor, s.least_at)}, largest at {answers.said_of(s.factor, s.largest_at)}"
        elif r.surrogate:
            text += "; the variants are too few, or it is too uneven, to say which factor moves it most"
        said.append(text)
    said += [f"{name} has no effect on any response" for name in answers.without_effect]
    for count, ran, what in (
        (answers.failed, False, "could not be run"),
        (answers.broken, True, "break a constraint: they enter neither effects nor best"),
    ):
        if count:
            said.append(f"{count} of {len(answers.rows)} variants {what}; commonest reason: {answers.commonest(ran)}")
    return said


def swing_rows(answers: Answers, r: Response) -> list[list[str]]:
    """A line for each factor: how far it moves the response, and where that is least and largest."""
    lines = []
    for s in r.swings:
        moves = s.swing > ROUNDING * float(np.abs(r.y).max())
        places = [answers.said_of(s.factor, place) if moves else "-" for place in (s.least_at, s.largest_at)]
        lines.append([s.factor, changed(r.name, s.swing if moves else 0.0), *places])
    return lines


def sensitivity_rows(study: Study, r: Response) -> list[list[str]]:
    """A line for each factor: by how much the response changes for a step that people think in: 100 kg, 10 %, a tenth of the range."""
    lines = []
    change = {e.factors[0]: e for e in r.effects if len(e.factors) == 1}
    for i, factor in enumerate(study.factors):
        width = float(np.ptp(r.table[:, i]))
        if factor.name not in change or width == 0.0 or factor.choices:
            continue
        unit = unit_at(factor.paths[0])
        step, said = (
            (0.1, "10 %") if factor.relative else (100.0, "100 kg") if unit == "kg" else (width / 10.0, f"{width / 10.0:.3g} {unit}")
        )
        effect = change[factor.name]
        low, value, high = (2.0 * v / width * step * scale_of(r.name) for v in (effect.low, _rounded(effect), effect.high))
        band = f"{low:+.3g} .. {high:+.3g}" if np.isfinite(low) else "-"
        lines.append([factor.name, f"{value:+.3g} {unit_of(r.name)} per {said}", band])
    return lines


def _rounded(effect: Effect) -> float:
    """The change of an effect; 0 where rounding alone makes it, far inside its interval."""
    return 0.0 if abs(effect.value) < 1e-6 * (effect.high - effect.low) else effect.value


def effect_rows(r: Response) -> list[list[str]]:
    """A line for each effect: factors, change from the low to the high end, its 95 % interval."""
    twice = 2.0 * scale_of(r.name)
    return [
        [
            " x ".join(e.factors),
            f"{twice * _rounded(e):+.4g}",
            f"{twice * e.low:+.4g} .. {twice * e.high:+.4g}" if np.isfinite(e.low) else "-",
        ]
        for e in r.effects[:MOST_BARS]
    ]


def write_report(study: Study, answers: Answers, duties: list[Duty], out: Path) -> list[str]:
    """Write report.html and the same plots as files; returns the names of the plots."""
    written: list[str] = []

    def shown(figure: Any, name: str, caption: str) -> Figure:
        save_png(figure, out / "plots" / f"{name}.png")
        written.append(f"plots/{name}.png")
        return Figure(figure_svg(figure), caption)

    sections = [Section("Findings", items=sentences(answers))]
    for r in answers.responses:
        figures = [
            shown(
                factors_figure(study, r),
                r.name,
                f"{titled(r.name)} of every variant that keeps the constraints, and the surrogate (line) with the other factors at their median",
            ),
        ]
        if r.swings:
            caption = "How far each factor moves it over its range with the others at their median; red: the surrogate's error"
            figures.append(shown(_swings_figure(r), f"{r.name}_effects", caption))
        words = []
        if r.surrogate:
            share = f", {100 * r.surrogate.error / r.surrogate.spread:.2g} % of their spread" if r.surrogate.spread else ""
            words.append(f"Surrogate: {r.surrogate.kind}; it misses left-out variants by {changed(r.name, r.surrogate.error)} RMS{share}.")
            if not r.surrogate.fits:
                words.append("That is too much to believe: it is not drawn, and no effect is given.")
        tables = (
            []
            if not r.effects
            else [
                Table(
                    ["factors", _with_unit("change, low to high end", r.name), "95 % interval"],
                    effect_rows(r),
                    caption="Main effects and interactions",
                )
            ]
        )
        if sensitivities := sensitivity_rows(study, r):
            tables.insert(
                0, Table(["factor", "changes it by", "95 % interval"], sensitivities, caption="Sensitivities: straight line over the range")
            )
        if r.sobol:
            columns = (r.sobol[key] for key in ("S1", "S1_conf", "ST", "ST_conf"))
            lines = [[n, *(f"{v:.3f}" for v in line)] for n, *line in zip(answers.factors, *columns)]
            tables.append(Table(["factor", "first order", "+-", "total", "+-"], lines, caption="Sobol indices: shares of the variance"))
        sections.append(Section(titled(r.name), words, figures, tables))
    for i, (pair, front) in enumerate(answers.fronts.items()):
        if front and _varies(answers, pair):
            figure = shown(
                _pareto_figure(answers, pair, front), "pareto" if i == 0 else f"pareto_{i + 1}", "Every variant, and those on the front"
            )
            sections.append(_trade_off(answers, pair, front, figure))
    if duties and driven_axes(duties):
        caption = (
            "Torque of each motor against its speed: points of the duty cycle, the largest while driving, curve and rating of the motor"
        )
        sections.append(
            Section("Motors", figures=[shown(torque_speed_figure(duties), "torque_speed", caption)], tables=[torque_table(duties)])
        )
    held = holding_figure({duty.label: duty.machine for duty in duties}) if duties else None
    if held is not None:
        caption = "Current that holds each axis against gravity, from the least to the largest over the angles of the other rotary axes"
        sections.append(Section("Holding by pose", figures=[shown(held, "holding", caption)]))
    for title, rows in (
        ("Variants that could not be run", [r for r in answers.rows if not r[2]]),
        ("Variants that break a constraint", [r for r in answers.rows if r[2] and r[3]]),
    ):
        if rows:
            lines = [[str(n), *answers.shown(factors), reason or ""] for n, factors, _, reason in rows[:MOST_LINES]]
            sections.append(Section(title, _of(rows), tables=[Table(["variant", *answers.headings, "reason"], lines)]))
    write_page(
        out / "report.html", f"Study {study.path.stem}", _lead(study, answers), sections, made_line(inputs=study.path.name, seed=study.seed)
    )
    return written


def _lead(study: Study, answers: Answers) -> str:
    runs = ", ".join(run.name for run in study.runs)
    text = f"{len(answers.rows)} variants of {study.machine.name} ({study.design.kind}), run on {runs}."
    if answers.best is not None:
        number, _, responses, _ = answers.row(answers.best)
        name = answers.minimised
        text += f" Least {label_of(name)}: {valued(name, responses[name])} with variant {number} ({answers.design_of(number)})."
    return f"{text} Constraints: {'; '.join(map(in_words, study.constraints))}."


def _of(rows: Sequence[Any]) -> list[str]:
    return [f"The first {MOST_LINES} of {len(rows)}; all are in table.csv."] if len(rows) > MOST_LINES else []


def _with_unit(text: str, name: str) -> str:
    return text if unit_of(name) == "1" else f"{text} [{unit_of(name)}]"


def _varies(answers: Answers, pair: Sequence[str]) -> bool:
    """Do both responses of a pair vary over the variants that have them?"""
    return all(depends(y) for y in (values_of(answers.rows, name)[1] for name in pair) if len(y))


def _trade_off(answers: Answers, pair: tuple[str, str], front: Sequence[int], figure: Figure) -> Section:
    rows = sorted((answers.row(n) for n in front), key=lambda row: row[2][pair[0]])
    lines = [
        [str(n), *answers.shown(factors), *(f"{scale_of(k) * found[k]:.4g}" for k in pair)] for n, factors, found, _ in rows[:MOST_LINES]
    ]
    said = " and ".join(map(label_of, pair))
    words = [f"{len(rows)} variants are beaten by no other one in both {said}; each is to be small.", *_of(rows)]
    return Section(f"Trade-off: {said}", words, [figure], [Table(["variant", *answers.headings, *map(titled, pair)], lines)])


def factors_figure(study: Study, r: Response) -> Any:
    """The response against each factor, with the surrogate along it; where a factor is a catalogue, in a colour for each of its entries."""
    count = len(study.factors)
    columns = min(count, COLUMNS)
    figure, axes = new_figure(-(-count // columns), columns, width=min(1.2 + 3.6 * columns, 12.0), height=3.0, sharey=True)
    panels = axes.ravel()
    for panel in panels[count:]:
        panel.set_visible(False)
    listed = [i for i, f in enumerate(study.factors) if f.choices]
    middle, scale = middle_of(r.table, listed), scale_of(r.name)
    groups = [("", BLUE, AMBER, np.ones(len(r.y), bool), middle)]
    if listed and len(names := [c.name for c in study.factors[listed[0]].choices]) <= len(ENTRIES):
        groups = []
        for entry, (name, colour) in enumerate(zip(names, ENTRIES)):
            here = r.table[:, listed[0]] == entry
            groups.append((name, colour, colour, here, np.where(np.arange(count) == listed[0], entry, middle)))
    for i, (factor, panel) in enumerate(zip(study.factors, panels)):
        for _, colour, line, here, at in groups:
            panel.plot(
                r.table[here, i],
                scale * r.y[here],
                ".",
                color=colour,
                alpha=0.7,
                markersize=6 if len(r.y) < MANY_POINTS else 3,
                markeredgewidth=0,
            )
            if factor.choices or r.surrogate is None or not r.surrogate.fits or not here.any() or not np.ptp(r.table[:, i]) > 0:
                continue
            points = np.tile(at, (120, 1))
            points[:, i] = np.linspace(r.table[:, i].min(), r.table[:, i].max(), 120)
            panel.plot(points[:, i], scale * r.surrogate.predict(points), color=line, linewidth=2.0)
        if factor.choices:
            panel.set_xticks(range(len(factor.choices)), [choice.name for choice in factor.choices])
        panel.set_xlabel(factor.titled)
    for row in axes:
        row[0].set_ylabel(titled(r.name))
    return figure


def _swings_figure(r: Response) -> Any:
    swings, scale = r.swings[:MOST_BARS], scale_of(r.name)
    error = scale * r.surrogate.error if r.surrogate else 0.0
    figure, axes = new_figure(1, 1, width=8.0, height=0.8 + 0.34 * len(swings))
    panel = axes[0][0]
    for i, s in enumerate(reversed(swings)):
        swing = scale * s.swing
        panel.barh(i, swing, color=BLUE, height=0.6)
        panel.plot([max(swing - error, 0.0), swing + error], [i, i], color=RED, linewidth=1.6)
    panel.set_yticks(range(len(swings)), [s.factor for s in reversed(swings)])
    panel.set_xlabel(f"moved by: {titled(r.name)}")
    return figure


def _pareto_figure(answers: Answers, pair: tuple[str, str], front: Sequence[int]) -> Any:
    figure, axes = new_figure(1, 1, width=7.0, height=4.2)
    panel = axes[0][0]
    a, b = pair
    on = set(front)
    for style, label, take in (
        ({"color": SOFT, "markersize": 5}, "keeps the constraints", lambda n, reason: reason is None and n not in on),
        ({"color": AMBER, "markersize": 5}, "breaks a constraint", lambda n, reason: reason is not None),
        ({"color": RED, "markersize": 8}, "on the front", lambda n, reason: n in on),
    ):
        points = [
            (scale_of(a) * found[a], scale_of(b) * found[b])
            for n, _, found, reason in answers.rows
            if a in found and b in found and take(n, reason)
        ]
        if points:
            panel.plot(*np.array(points).T, ".", label=label, markeredgewidth=0, **style)
    panel.set_xlabel(titled(a))
    panel.set_ylabel(titled(b))
    panel.legend(frameon=False, fontsize=8.5)
    return figure
