"""The report of a study: findings, a section per response, trade-offs, variants without result."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from twin.report import Figure, Section, Table, figure_svg, new_figure, save_png, write_page
from twin.report.figure import AMBER, BLUE, GREEN, RED, SOFT
from twin.report.page import made_line
from twin.study.duty import COLUMNS, Duty, driven_axes, holding_figure, panels_for, torque_speed_figure, torque_table
from twin.study.factors import Factor
from twin.study.labels import changed, label_of, scale_of, titled, unit_of, valued
from twin.study.outcomes import depends, middle_of
from twin.study.results import Answers, Response, values_of
from twin.study.spec import Study, in_words
from twin.units import plain

MOST_LINES = 50
"""Most rows of a table in the report; table.csv holds all."""
MOST_BARS = 12
MANY_POINTS = 200
ENTRIES = (BLUE, AMBER, GREEN, RED, "#7a4f9a", "#3f8f9b")
"""Colours of catalogue entries."""
LEAST = 0.01
"""Smallest effect in the table, as a share of the range of the response."""
ROUNDING = 1e-9
"""A smaller relative change of a response is rounding of the surrogate."""


def sentences(answers: Answers) -> list[str]:
    """The findings in words: the range of each response and the factor with the largest influence."""
    said = []
    for r in answers.responses:
        least, largest = float(r.y.min()), float(r.y.max())
        text = f"{label_of(r.name)}: {valued(r.name, least)} to {valued(r.name, largest)}"
        if len(answers.rows) == len(r.y) == 2:
            first, second = r.y.tolist()
            text = f"{label_of(r.name)}: {valued(r.name, first)} with {answers.design_of(0)}, {valued(r.name, second)} with {answers.design_of(1)}"
            text += f" ({100.0 * (second / first - 1.0):+.0f} %)" if first else ""
        if r.swings:
            s = r.swings[0]
            text += f"; largest influence: {s.factor}, {changed(r.name, s.swing)}, "
            text += f"least at {answers.value_text_of(s.factor, s.least_at)}, largest at {answers.value_text_of(s.factor, s.largest_at)}"
        elif r.surrogate:
            text += "; too few variants, or too irregular, to rank the factors"
        said.append(text)
    said += [f"{name} has no effect on any response" for name in answers.without_effect]
    for count, ran, what in (
        (answers.failed, False, "could not be run"),
        (answers.broken, True, "break a constraint and are left out of effects and best variant"),
    ):
        if count:
            said.append(f"{count} of {len(answers.rows)} variants {what}; most common reason: {answers.commonest(ran)}")
    return said


def swing_rows(answers: Answers, r: Response) -> list[list[str]]:
    """A row per factor, largest influence first: the change of the response over its range, where it is least and largest, and its slope.

    The slope is per 100 kg, per 10 % or per tenth of the range, '-' where the response has an optimum inside the
    range: there a slope says nothing.
    """
    lines, straight = [], {e.factors[0]: e for e in r.effects if len(e.factors) == 1}
    for s in r.swings:
        moves = s.swing > ROUNDING * float(np.abs(r.y).max())
        places = [answers.value_text_of(s.factor, place) if moves else "-" for place in (s.least_at, s.largest_at)]
        effect, i = straight.get(s.factor), answers.factors.index(s.factor)
        slope = "-"
        ends = float(r.table[:, i].min()), float(r.table[:, i].max())
        if moves and effect is not None and not answers.definitions[i].choices and {s.least_at, s.largest_at} == {*ends}:
            width = ends[1] - ends[0]
            step, said = _step(answers.definitions[i], width)
            slope = f"{plain(2.0 * effect.value / width * step * scale_of(r.name), 3, '+')} {unit_of(r.name).replace('1', '')} per {said}".replace(
                "  ", " "
            )
        lines.append([s.factor, changed(r.name, s.swing if moves else 0.0), *places, slope])
    return lines


def best_sentence(answers: Answers) -> str:
    """The best variant in words; '' if no variant can be the best."""
    if answers.best is None:
        return ""
    number, _, responses, _ = answers.row(answers.best)
    name = answers.minimised
    return f"the {label_of(name)} is least, {valued(name, responses[name])}, with variant {number}: {answers.design_of(number)}"


SWING_HEADING = ("factor", "changes it by", "least at", "largest at", "slope")


def _step(factor: Factor, width: float) -> tuple[float, str]:
    """A step of a factor that people think in, and its words."""
    if factor.relative:
        return 0.1, "10 %"
    tenth = float(f"{width / 10.0:.1g}")
    return (100.0, "100 kg") if factor.unit == "kg" else (tenth, factor.value_text(tenth))


def effect_rows(r: Response) -> list[list[str]]:
    """A row per effect that the swings do not show: factors together, or each factor where the variants are too few for swings. None below LEAST."""
    twice, least = 2.0 * scale_of(r.name), 0.5 * LEAST * float(np.ptp(r.y))
    effects = [e for e in r.effects if (len(e.factors) > 1 or not r.swings) and abs(e.value) > least]
    between = (f"{plain(twice * e.low, 4, '+')} .. {plain(twice * e.high, 4, '+')}" if np.isfinite(e.low) else "-" for e in effects)
    return [[" x ".join(e.factors), plain(twice * e.value, 4, "+"), span] for e, span in zip(effects[:MOST_BARS], between)]


def write_report(study: Study, answers: Answers, duties: list[Duty], out: Path, present: Mapping[str, float]) -> list[str]:
    """Write report.html and its plots as files; returns the names of the plots. `present` holds the responses of the machine as it is, if it can run."""
    written: list[str] = []

    def shown(figure: Any, name: str, caption: str) -> Figure:
        save_png(figure, out / "plots" / f"{name}.png")
        written.append(f"plots/{name}.png")
        return Figure(figure_svg(figure), caption)

    sections = [Section("Findings", items=[f"{text[0].upper()}{text[1:]}" for text in sentences(answers)])]
    sections += [_response_section(study, answers, r, shown) for r in answers.responses]
    for i, (pair, front) in enumerate(answers.fronts.items()):
        if front and all(depends(y) for y in (values_of(answers.rows, name)[1] for name in pair) if len(y)):
            name = "pareto" if i == 0 else f"pareto_{i + 1}"
            figure = shown(_pareto_figure(answers, pair, front), name, "All variants, and those on the Pareto front")
            sections.append(_trade_off(answers, pair, front, figure))
    sections += _drive_sections(duties, shown)
    for title, rows in (
        ("Variants that could not be run", [r for r in answers.rows if not r[2]]),
        ("Variants that break a constraint", [r for r in answers.rows if r[2] and r[3]]),
    ):
        if rows:
            lines = [[str(n), *answers.shown(factors), reason or ""] for n, factors, _, reason in rows[:MOST_LINES]]
            sections.append(Section(title, _of(rows), tables=[Table(["variant", *answers.headings, "reason"], lines)]))
    made = made_line(inputs=study.path.name, seed=study.seed)
    write_page(out / "report.html", f"Study {study.path.stem}", _lead(study, answers, present), sections, made)
    return written


Shown = Callable[[Any, str, str], Figure]
"""Saves a plot under a name and returns it with its caption."""


def _response_section(study: Study, answers: Answers, r: Response, shown: Shown) -> Section:
    """Plots, surrogate, effects, sensitivities and Sobol indices of one response."""
    caption = f"{titled(r.name)} of every variant that keeps the constraints; line: surrogate with the other factors at their median"
    figures = [shown(factors_figure(study, r), r.name, caption)]
    if r.swings:
        caption = "Change over the range of each factor with the others at their median; red: error of the surrogate"
        figures.append(shown(_swings_figure(r), f"{r.name}_effects", caption))
    words, tables = [], []
    if r.surrogate:
        share = f", {100 * r.surrogate.error / r.surrogate.spread:.2g} % of their spread" if r.surrogate.spread else ""
        words.append(f"Surrogate: {r.surrogate.kind}; RMS error on left-out variants {changed(r.name, r.surrogate.error)}{share}.")
        if not r.surrogate.fits:
            words.append("This error is too large: the surrogate is not drawn, and no effects are given.")
    if r.swings:
        tables.append(Table(SWING_HEADING, swing_rows(answers, r), caption="Each factor over its range, the others at their median"))
    if rows := effect_rows(r):
        heading = ["factors", titled(r.name, "change, low to high end"), "95 % interval"]
        tables.append(Table(heading, rows, caption="Factors together" if r.swings else "Main effects and interactions"))
    if r.sobol:
        columns = (r.sobol[key] for key in ("S1", "S1_conf", "ST", "ST_conf"))
        lines = [[n, *(f"{v:.3f}" for v in line)] for n, *line in zip(answers.factors, *columns)]
        tables.append(Table(["factor", "first order", "+-", "total", "+-"], lines, caption="Sobol indices: shares of the variance"))
    return Section(titled(r.name), words, figures, tables)


def _drive_sections(duties: list[Duty], shown: Shown) -> list[Section]:
    """Torque over speed of the motors, and holding currents by pose, where there are any."""
    sections: list[Section] = []
    if not duties:
        return sections
    if driven_axes(duties):
        caption = "Torque of each motor over its speed: duty cycle, largest torque, torque curve and rating"
        figure = shown(torque_speed_figure(duties), "torque_speed", caption)
        sections.append(Section("Motors", figures=[figure], tables=[torque_table(duties)]))
    if (held := holding_figure(duties)) is not None:
        caption = "Holding current of each axis against gravity, from least to largest over the angles of the other rotary axes"
        sections.append(Section("Holding by pose", figures=[shown(held, "holding", caption)]))
    return sections


def _lead(study: Study, answers: Answers, present: Mapping[str, float]) -> str:
    runs = ", ".join(run.name for run in study.runs)
    text = f"{len(answers.rows)} variants of {study.machine.name} ({study.design.kind}), run on {runs}."
    if answers.best is not None:
        name, said = answers.minimised, best_sentence(answers)
        text += f" {said[0].upper()}{said[1:]}." + (f" The machine as it is has {valued(name, present[name])}." if name in present else "")
    return f"{text} Constraints: {'; '.join(map(in_words, study.constraints))}."


def _of(rows: Sequence[Any]) -> list[str]:
    return [f"The first {MOST_LINES} of {len(rows)}; all are in table.csv."] if len(rows) > MOST_LINES else []


def _trade_off(answers: Answers, pair: tuple[str, str], front: Sequence[int], figure: Figure) -> Section:
    rows = sorted((answers.row(n) for n in front), key=lambda row: row[2][pair[0]])
    lines = [
        [str(n), *answers.shown(factors), *(plain(scale_of(k) * found[k], 4) for k in pair)] for n, factors, found, _ in rows[:MOST_LINES]
    ]
    said = " and ".join(map(label_of, pair))
    words = [f"{len(rows)} variants are on the Pareto front of {said}; both are minimised.", *_of(rows)]
    return Section(f"Trade-off: {said}", words, [figure], [Table(["variant", *answers.headings, *map(titled, pair)], lines)])


def factors_figure(study: Study, r: Response) -> Any:
    """The response against each factor, with the surrogate; one colour per entry if a factor is a catalogue."""
    count = len(study.factors)
    figure, panels = panels_for(count, 3.0, sharey=True)
    listed = [i for i, f in enumerate(study.factors) if f.choices]
    middle, scale = middle_of(r.table, listed), scale_of(r.name)
    groups = [("", BLUE, AMBER, np.ones(len(r.y), bool), middle)]
    if listed and len(names := [c.name for c in study.factors[listed[0]].choices]) <= len(ENTRIES):
        groups = []
        for entry, (name, colour) in enumerate(zip(names, ENTRIES)):
            here = r.table[:, listed[0]] == entry
            groups.append((name, colour, colour, here, np.where(np.arange(count) == listed[0], entry, middle)))
    for i, (factor, panel) in enumerate(zip(study.factors, panels)):
        read = factor.read_in[1]
        for _, colour, line, here, at in groups:
            dots: dict[str, Any] = {"color": colour, "alpha": 0.7, "markersize": 6 if len(r.y) < MANY_POINTS else 3, "markeredgewidth": 0}
            panel.plot(read * r.table[here, i], scale * r.y[here], ".", **dots)
            if factor.choices or r.surrogate is None or not r.surrogate.fits or not here.any() or not np.ptp(r.table[:, i]) > 0:
                continue
            points = np.tile(at, (120, 1))
            points[:, i] = np.linspace(r.table[:, i].min(), r.table[:, i].max(), 120)
            panel.plot(read * points[:, i], scale * r.surrogate.predict(points), color=line, linewidth=2.0)
        if factor.choices:
            panel.set_xticks(range(len(factor.choices)), [choice.name for choice in factor.choices])
        panel.set_xlabel(factor.titled)
    for panel in panels[::COLUMNS]:
        panel.set_ylabel(fill(titled(r.name), 28))
    return figure


def _swings_figure(r: Response) -> Any:
    swings, scale = r.swings[:MOST_BARS], scale_of(r.name)
    error = scale * r.surrogate.error if r.surrogate else 0.0
    figure, ((panel,),) = new_figure(1, 1, width=8.0, height=0.8 + 0.34 * len(swings))
    for i, s in enumerate(reversed(swings)):
        swing = scale * s.swing
        panel.barh(i, swing, color=BLUE, height=0.6)
        panel.plot([max(swing - error, 0.0), swing + error], [i, i], color=RED, linewidth=1.6)
    panel.set_yticks(range(len(swings)), [s.factor for s in reversed(swings)])
    panel.set_xlabel(f"change of {titled(r.name)}")
    return figure


def _pareto_figure(answers: Answers, pair: tuple[str, str], front: Sequence[int]) -> Any:
    figure, ((panel,),) = new_figure(1, 1, width=7.0, height=4.2)
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
    panel.set(xlabel=titled(a), ylabel=fill(titled(b), 40))
    panel.legend(frameon=False, fontsize=8.5)
    return figure
