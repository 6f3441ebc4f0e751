"""`history.json`: what a history says, in SI units, the same in sentences, and its page: what changed first, then one row an axis with its sizes over time."""

from dataclasses import asdict
from datetime import datetime, timedelta
import math
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from twin.diagnose.wording import effect_title, sentence_case
from twin.effects import EFFECTS
from twin.effects.readable import interval_text
from twin.history.columns import Direction, is_watched
from twin.history.judge import ALARM, FALSE_ALARM_WEEKS, LEAST, Cause, Change, Judgement, causes_of, sizes_over_time
from twin.history.series import is_load
from twin.machine.machine import Machine
from twin.report import Figure, Section, Table, figure_svg, new_figure, write_page
from twin.report.figure import BLUE, RED, SOFT
from twin.simulation.summary import listed
from twin.system import shell_word
from twin.units import in_words, plain


def history_document(history: Judgement, machine: Machine, notes: list[str], folder: Path) -> dict[str, Any]:
    """The document; `folder` holds the campaigns."""
    causes = causes_of(history.series)
    changes = [change_entry(history, machine, c, folder) for c in history.changes]
    all_of = {d.cause for one in history.series for d in one.directions if not is_load(d.cause[0])}
    several = len({axis for one in history.series for axis in one.axes}) > 1
    return {
        "machine": machine.name,
        "alarm": bool(changes),
        "rule": {
            "mean_recordings_between_false_alarms": FALSE_ALARM_WEEKS,
            "alarm_at": ALARM,
            "statistic": float(history.evidence[-1]) if len(history.evidence) else 0.0,
            "causes": len(causes),
        },
        "campaigns": [
            {"name": row.name, "day": row.day.isoformat(), "digest": row.digest, "statistic": float(e)}
            for row, e in zip(history.rows, history.evidence)
        ],
        "changes": changes,
        "axes": _axes(history, machine, causes),
        "not_seen": [cause_entry(cause) for cause in sorted(all_of - {*causes, *(c.cause for c in history.changes)})],
        "not_watched": sorted(name for name, effect in EFFECTS.items() if not is_watched(effect) or is_load(name)),
        "notes": [
            *notes,
            *([] if several else ["one axis only: a season or a warm day looks like a change of its friction"]),
            *([] if len(history.rows) >= 8 else [f"{len(history.rows)} recordings: a change shows from about eight on"]),
        ],
    }


def in_si(direction: Direction, theta: float) -> float:
    """A change of `theta` usual sizes as the value of the size parameter: of a factor, a spring, or an amount."""
    size = direction.setting.effect.size
    if size.is_spring:
        return direction.unit / theta if theta else math.inf
    return (1.0 if size.is_factor else 0.0) + theta * direction.unit


def entry_of(direction: Direction, machine: Machine, theta: float, half: float) -> dict[str, Any]:
    """Effect, axis and the change of its size with interval, in the form of `diagnosis.json`."""
    effect, axis = direction.setting.effect, machine.axis(direction.setting.axis)
    ends = sorted(in_si(direction, theta + sign * half) for sign in (-1.0, 1.0))
    values = {"value": in_si(direction, theta), "low": ends[0], "high": ends[1], "unit": effect.size.unit(axis)}
    source = {"from_axis": direction.setting.from_axis} if direction.setting.from_axis else {}
    return {"effect": effect.name, "axis": axis.name, **source, "block": effect.block, "parameters": {effect.size.name: values}}


def difference_text(entry: dict[str, Any], theta: float) -> str:
    """'backlash on axis X 4.1 um more (3.6 to 4.6 um)', 'friction on axis Y 12 % less'."""
    (name, p), *_ = entry["parameters"].items()
    parameter = EFFECTS[entry["effect"]].parameter(name)
    if parameter.is_spring:
        size = abs(p["value"])
        spring, _ = interval_text(p["unit"], size, size, size, parameter)
        return f"{effect_title(entry)} {'softer' if theta > 0 else 'stiffer'}, as by a spring of {spring} in series"
    neutral = 1.0 if parameter.is_factor else 0.0
    d, ends = p["value"] - neutral, sorted(abs(p[end] - neutral) for end in ("low", "high"))
    low, high = ends if (p["low"] - neutral) * (p["high"] - neutral) > 0 else (0.0, ends[1])
    value, interval = interval_text(p["unit"], abs(d) + neutral, low + neutral, high + neutral, parameter)
    ends_text = f" ({interval.replace('+', '')})" if interval else ""
    return f"{effect_title(entry)} {value.lstrip('+')} {'more' if d > 0 else 'less'}{ends_text}"


def change_entry(history: Judgement, machine: Machine, change: Change, folder: Path) -> dict[str, Any]:
    """A change with its days, size, rivals, forecast, a sentence, and the command that diagnoses it in depth."""
    size, half = change.size.size, change.size.half()
    entry = entry_of(change.direction, machine, size, half)
    onset, alarm = history.rows[change.onset].day, history.rows[change.alarm_row].day
    text = f"{difference_text(entry, size)} since {onset:%Y-%m-%d}"
    if change.rivals:
        text += f"; could also be {listed([effect_title(cause_entry(c)) for c in change.rivals])}"
    ahead = None
    if change.forecast is not None:
        days = (
            (name, history.rows[0].day + timedelta(days=d) if math.isfinite(d) else None) for name, d in asdict(change.forecast).items()
        )
        ahead = {"limit": change.limit.text, **{name: day and day.date().isoformat() for name, day in days}}
    if abs(size) >= change.limit.size:
        text += f"; beyond {change.limit.text}"
    elif ahead is not None:
        between = f" ({ahead['earliest']} to {ahead['latest'] or 'never'})" if ahead["earliest"] != ahead["latest"] else ""
        text += f"; at this rate {change.limit.text} is reached on {ahead['day'] or 'no near day'}{between}"
    return {
        **entry,
        "usual_sizes": {"value": size, "low": size - half, "high": size + half},
        "onset": onset.isoformat(),
        "alarm": alarm.isoformat(),
        "ambiguous_with": [cause_entry(c) for c in change.rivals],
        "forecast": ahead,
        "sentence": text,
        "diagnose": f"twin diagnose {shell_word(folder / history.rows[-1].name)} --since "
        f"{shell_word(folder / history.rows[max(change.onset - 1, 0)].name)} --out out/since",
    }


def cause_entry(cause: Cause) -> dict[str, str]:
    effect, axis, source = cause
    return {"effect": effect, "axis": axis, **({"from_axis": source} if source else {})}


def _axes(history: Judgement, machine: Machine, causes: dict[Cause, tuple[int, list[int]]]) -> dict[str, Any]:
    """Series of each axis and effect: size over time in usual sizes, scatter, smallest change that shows."""
    onset = {c.cause: c.onset for c in history.changes}
    causes = causes | {c.cause: (c.group, [c.k]) for c in history.changes}
    out: dict[str, Any] = {}
    for cause in sorted(causes, key=lambda cause: (machine.axis_names.index(cause[1]), cause[0])):
        group, own = causes[cause]
        one = history.series[group]
        k = own[int(np.argmax(np.diag(one.gram)[own]))]
        y, _ = sizes_over_time(history, group, k, onset.get(cause))
        before = y[one.at < onset.get(cause, len(history.rows))]
        scatter = float(np.std(before, ddof=1)) if len(before) > 1 else math.nan
        direction = one.directions[k]
        out.setdefault(cause[1], []).append(
            {
                **cause_entry(cause),
                "unit": {"usual_size": direction.unit, "of": direction.setting.effect.size.unit(machine.axis(cause[1]))},
                "scatter": scatter,
                "smallest_change": 5.0 * scatter,
                "campaigns": one.at.tolist(),
                "usual_sizes": y.tolist(),
            }
        )
    return out


def summary_text(document: dict[str, Any]) -> str:
    """The history in a few lines for the terminal."""
    campaigns = document["campaigns"]
    span = f"{campaigns[0]['day'][:10]} to {campaigns[-1]['day'][:10]}" if campaigns else "none"
    lines = [f"{document['machine']}: {len(campaigns)} recordings, {span}"]
    lines += [f"  ALARM on {c['alarm'][:10]}: {c['sentence']}" for c in document["changes"]]
    if not document["changes"]:
        lines.append("  no change beyond what normally differs")
    if document["not_seen"]:
        lines.append(
            f"  not seen in these recordings: {listed([effect_title(c) for c in document['not_seen'][:6]])}{' and others' * (len(document['not_seen']) > 6)}"
        )
    return "\n".join([*lines, *(f"  note: {note}" for note in document["notes"])])


SHOWN = 5
"""Sparklines in the row of an axis."""


def write_history_page(document: dict[str, Any], path: Path) -> None:
    """Write the page."""
    changes, rule = document["changes"], document["rule"]
    lead = "; ".join(c["sentence"] for c in changes) or "no change beyond what normally differs between recordings"
    rows = [[c["onset"][:10], c["alarm"][:10], c["sentence"]] for c in changes]
    folded = [
        Table(
            ("effect", "scatter [usual sizes]", "smallest change that shows", "now"),
            [
                [in_words(e["effect"]), f"{e['scatter']:.3f}", f"{e['smallest_change']:.2f}", f"{e['usual_sizes'][-1]:+.3f}"]
                for e in effects
            ],
            folded=f"All effects of axis {axis}",
        )
        for axis, effects in document["axes"].items()
    ]
    drill = [f"{sentence_case(effect_title(c))}, in depth: {c['diagnose']}" for c in changes]
    sections = [
        Section("What changed", items=drill, tables=[Table(("since", "alarm", "what"), rows, left=2, words=frozenset({2}))] if rows else [],
                paragraphs=[f"One rule for all {rule['causes']} effects and axes: at most one false alarm in {rule['mean_recordings_between_false_alarms']:.0f} "
                            f"recordings. The evidence for a further change is {plain(rule['statistic'])} now; the alarm is at {rule['alarm_at']:.0f}."]),
        Section("Sizes over time", figures=[Figure(figure_svg(sparklines(document)), "One row for each axis: the effects that moved most. Size in usual sizes of the "
                "effect as a fault, free of temperature, season, tool and workpiece; grey: twice the scatter between recordings; red: since the onset.")],
                tables=folded),
        Section("What cannot be seen", items=[effect_title(c) for c in document["not_seen"]] or ["Every watched effect shows."],
                paragraphs=[f"Not watched: {', '.join(in_words(n) for n in document['not_watched'])}. A diagnosis finds them."]),
        *([Section("Notes", items=document["notes"])] if document["notes"] else []),
    ]  # fmt: skip
    write_page(path, f"History: {document['machine']}", f"{sentence_case(lead)}.", sections)


def sparklines(document: dict[str, Any]) -> Any:
    """One row an axis, its effects that moved most over time."""
    axes = document["axes"]
    days = [datetime.fromisoformat(c["day"]) for c in document["campaigns"]]
    changed = {(c["effect"], c["axis"]): datetime.fromisoformat(c["onset"]) for c in document["changes"]}
    figure, panels = new_figure(max(len(axes), 1), SHOWN, height=1.15)
    for row, (axis, effects) in zip(panels, axes.items()):
        # those that changed, then those that moved most in their scatter
        moved = {e["effect"]: np.max(np.abs(e["usual_sizes"])) / max(np.nan_to_num(e["scatter"]), LEAST / 5.0) for e in effects}
        order = sorted(effects, key=lambda e: ((e["effect"], axis) not in changed, -moved[e["effect"]]))[:SHOWN]
        for panel, effect in zip(row, order):
            when = [days[i] for i in effect["campaigns"]]
            y, wide = np.array(effect["usual_sizes"]), 2.0 * np.nan_to_num(effect["scatter"])
            panel.axhspan(-wide, wide, color=SOFT, alpha=0.2, lw=0)
            panel.plot(when, y, color=BLUE, lw=0.9)
            if onset := changed.get((effect["effect"], axis)):
                since = [d >= onset for d in when]
                panel.plot(np.array(when)[since], y[since], color=RED, lw=1.2)
            panel.set_title(fill(in_words(effect["effect"]), 18), fontsize=7.5)
            low, high = panel.get_ylim()
            panel.set_ylim(min(low, -LEAST), max(high, LEAST))
            panel.tick_params(labelsize=6.5)
            panel.set_xticks([when[0], when[-1]], [f"{when[0]:%y-%m-%d}", f"{when[-1]:%y-%m-%d}"])
            panel.grid(visible=False)
        for panel in row[len(order) :]:
            panel.set_visible(False)
        row[0].set_ylabel(axis, rotation=0, fontsize=11, labelpad=10)
    return figure
