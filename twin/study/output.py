"""What a study writes: table.parquet and table.csv, study.json, report.html with its figures, the best machine and its replay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from twin.machine import write_machine
from twin.report import Figure, Section, Table, figure_svg, new_figure, write_page
from twin.report.figure import AMBER, BLUE, RED, SOFT
from twin.study.answers import Effect, Surrogate, depends, effects_of, pareto_front, sobol_of, surrogate_of, swings_of
from twin.study.design import machine_of, problem_of
from twin.study.spec import Study

SHOWN = 4
"""Responses that the report looks at where the study file names none."""

PREFERRED = ("mark_depth_um", "contour_error_max_um", "following_error_max", "current_rms", "copper_loss", "cycle_time_s")

Row = tuple[int, list[float], dict[str, float], str | None]


def table_of(study: Study, rows: Sequence[Row]) -> pa.Table:
    """Variant, factors, responses and reason, in the order of the design."""
    responses = list(dict.fromkeys(name for _, _, found, _ in rows for name in found))
    columns: dict[str, Any] = {"variant": [n for n, *_ in rows]}
    columns |= {f.name: [factors[i] for _, factors, _, _ in rows] for i, f in enumerate(study.factors)}
    columns |= {name: pa.array([found.get(name) for _, _, found, _ in rows], pa.float64()) for name in responses}
    columns["reason"] = pa.array([reason for *_, reason in rows], pa.string())
    return pa.table(columns)


def looked_at(study: Study, rows: Sequence[Row]) -> list[str]:
    """Responses that the report is about: those of the study file, else the telling ones that vary."""
    known = list(dict.fromkeys(name for _, _, found, _ in rows for name in found))
    if study.answer:
        from twin.errors import InputError, nearest

        for name in study.answer:
            if known and name not in known:
                raise InputError(f"{study.path}: answer: no response '{name}'; {nearest(name, known)}")
        return list(study.answer)
    ranked = sorted(known, key=lambda n: next((i for i, p in enumerate(PREFERRED) if n.startswith(p)), len(PREFERRED)))
    return [n for n in ranked if depends(_values(rows, n)[1])][:SHOWN]


def _values(rows: Sequence[Row], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Factors (variant, factor) and values (variant,) of the variants that have this response."""
    kept = [(factors, found[name]) for _, factors, found, reason in rows if reason is None and name in found]
    return np.array([f for f, _ in kept]), np.array([v for _, v in kept])


def answers_of(study: Study, rows: Sequence[Row]) -> dict[str, Any]:
    """`study.json`: per response main effects, sensitivity indices, surrogate; Pareto front; best variant; what has no effect."""
    names = [f.name for f in study.factors]
    known = list(dict.fromkeys(name for _, _, found, _ in rows for name in found))
    out: dict[str, Any] = {"variants": len(rows), "failed": sum(reason is not None for *_, reason in rows), "responses": {}}
    felt: set[str] = set()
    for name in known:
        table, y = _values(rows, name)
        if len(y) < 2 or not depends(y):
            continue
        effects = effects_of(names, table, y)
        felt |= {e.factors[0] for e in effects if len(e.factors) == 1 and abs(e.value) > 1e-6 * max(abs(float(y.mean())), 1e-12)}
        if name not in looked_at(study, rows):
            continue
        surrogate = surrogate_of(table, y)
        entry: dict[str, Any] = {
            "least": float(y.min()),
            "largest": float(y.max()),
            "effects": [{"factors": list(e.factors), "half_change": e.value, "low": e.low, "high": e.high} for e in effects],
            "surrogate": None if surrogate is None else {"kind": surrogate.kind, "error": surrogate.error, "spread": surrogate.spread},
        }
        if surrogate is not None:
            entry["swings"] = [asdict(s) for s in swings_of(names, table, surrogate)]
        if study.design["kind"] == "sobol" and len(y) == len(rows):
            entry["sobol"] = sobol_of(problem_of(study), y)
        out["responses"][name] = entry
    out["without_effect"] = [n for n in names if n not in felt]
    answers = looked_at(study, rows)
    complete = [r for r in rows if r[3] is None and all(n in r[2] for n in answers)]
    if answers and complete:
        values = np.array([[r[2][n] for n in answers] for r in complete])
        out["pareto"] = [r[0] for r, front in zip(complete, pareto_front(values)) if front]
        best = complete[int(np.argmin(values[:, 0]))]
        out["best"] = {"variant": best[0], "minimises": answers[0], "factors": dict(zip(names, best[1])), "responses": best[2]}
    return out


def write_study(study: Study, rows: Sequence[Row], out: Path) -> dict[str, Any]:
    """Write everything; returns the content of study.json."""
    table = table_of(study, rows)
    pyarrow.parquet.write_table(table, out / "table.parquet")
    pyarrow.csv.write_csv(table, out / "table.csv")
    answers = answers_of(study, rows)
    (out / "study.json").write_text(json.dumps(answers, indent=2) + "\n", encoding="utf-8")
    if "best" in answers:
        best = machine_of(study, np.array(list(answers["best"]["factors"].values())))
        write_machine(best, out / "best_machine.toml")
    write_page(out / "report.html", f"Study {study.path.stem}", _lead(study, answers), _sections(study, rows, answers))
    return answers


def sentences(study: Study, answers: dict[str, Any]) -> list[str]:
    """The findings in words: which factor moves each response how far."""
    told = []
    for name, entry in answers["responses"].items():
        text = f"{name}: {entry['least']:.4g} to {entry['largest']:.4g}"
        if "swings" in entry:
            s = entry["swings"][0]
            text += f"; {s['factor']} moves it most, by {s['swing']:.3g}: least at {s['least_at']:.4g}, largest at {s['largest_at']:.4g}"
        elif entry["effects"]:
            e = entry["effects"][0]
            text += f"; {' and '.join(e['factors'])} moves it by {2 * e['half_change']:.3g} from the low to the high end"
        told.append(text)
    told += [f"{name} has no effect on any response" for name in answers["without_effect"]]
    if answers["failed"]:
        told.append(f"{answers['failed']} of {answers['variants']} variants could not be run; their rows give the reason")
    return told


def _lead(study: Study, answers: dict[str, Any]) -> str:
    best = answers.get("best")
    text = f"{answers['variants']} variants of {study.machine.name}, {len(study.factors)} factors, {len(study.runs)} runs."
    if best:
        factors = ", ".join(f"{k} = {v:.4g}" for k, v in best["factors"].items())
        text += f" Least {best['minimises']} ({best['responses'][best['minimises']]:.4g}): variant {best['variant']}, {factors}."
    return text


def _sections(study: Study, rows: Sequence[Row], answers: dict[str, Any]) -> list[Section]:
    names = [f.name for f in study.factors]
    sections = [Section("Findings", items=sentences(study, answers))]
    for name, entry in answers["responses"].items():
        table, y = _values(rows, name)
        figures = [Figure(figure_svg(_response_figure(study, name, table, y, surrogate_of(table, y))), f"{name} against each factor")]
        figures.append(
            Figure(figure_svg(_effects_figure(entry)), "Change from the low to the high end of each factor, with 95 % intervals")
        )
        words = []
        if entry["surrogate"]:
            s = entry["surrogate"]
            words.append(
                f"Surrogate: {s['kind']}; it misses left-out variants by {s['error']:.3g} RMS, {100 * s['error'] / s['spread']:.1f} % of their spread."
            )
        tables = []
        if "sobol" in entry:
            s = entry["sobol"]
            lines = [[n, *(f"{v:.3f}" for v in r)] for n, *r in zip(names, s["S1"], s["S1_conf"], s["ST"], s["ST_conf"])]
            tables.append(Table(["factor", "first order", "+-", "total", "+-"], lines, caption="Sobol indices"))
        sections.append(Section(name, words, figures, tables))
    looked = list(answers["responses"])
    if len(looked) >= 2 and answers.get("pareto"):
        sections.append(
            Section(
                "Trade-off",
                ["Points on the front are beaten by no other variant in all responses."],
                [Figure(figure_svg(_pareto_figure(rows, looked, answers)), "Pareto front")],
            )
        )
        front = [r for r in rows if r[0] in answers["pareto"]][:30]
        lines = [[str(n), *(f"{v:.4g}" for v in f), *(f"{found[k]:.4g}" for k in looked)] for n, f, found, _ in front]
        sections[-1] = Section(
            sections[-1].title, sections[-1].paragraphs, sections[-1].figures, [Table(["variant", *names, *looked], lines)]
        )
    failed = [r for r in rows if r[3]]
    if failed:
        lines = [[str(n), *(f"{v:.4g}" for v in f), reason or ""] for n, f, _, reason in failed[:50]]
        sections.append(Section("Variants that could not be run", tables=[Table(["variant", *names, "reason"], lines, left=1)]))
    return sections


def _response_figure(study: Study, name: str, table: np.ndarray, y: np.ndarray, surrogate: Surrogate | None) -> Any:
    count = len(study.factors)
    figure, axes = new_figure(1, count, width=max(4.5, min(3.6 * count, 13.0)), height=3.0, sharey=True)
    middle = np.median(table, axis=0)
    for i, (factor, panel) in enumerate(zip(study.factors, axes[0])):
        panel.plot(table[:, i], y, ".", color=BLUE, markersize=5 if len(y) < 200 else 2.5)
        if surrogate is not None and np.ptp(table[:, i]) > 0:
            points = np.tile(middle, (80, 1))
            points[:, i] = np.linspace(table[:, i].min(), table[:, i].max(), 80)
            panel.plot(points[:, i], surrogate.predict(points), color=AMBER, label="surrogate, others at their median")
        panel.set_xlabel(f"{factor.name}{' (times)' if factor.relative else ''}")
    axes[0][0].set_ylabel(name)
    if surrogate is not None:
        axes[0][0].legend()
    return figure


def _effects_figure(entry: dict[str, Any]) -> Any:
    effects = [Effect(tuple(e["factors"]), e["half_change"], e["low"], e["high"]) for e in entry["effects"][:12]]
    figure, axes = new_figure(1, 1, width=7.5, height=0.7 + 0.32 * len(effects))
    panel = axes[0][0]
    for i, e in enumerate(reversed(effects)):
        panel.barh(i, 2 * e.value, color=BLUE if len(e.factors) == 1 else SOFT, height=0.6)
        if np.isfinite(e.low):
            panel.plot([2 * e.low, 2 * e.high], [i, i], color=RED, linewidth=1.4)
    panel.set_yticks(range(len(effects)), [" x ".join(e.factors) for e in reversed(effects)])
    panel.axvline(0.0, color=SOFT, linewidth=0.8)
    return figure


def _pareto_figure(rows: Sequence[Row], looked: Sequence[str], answers: dict[str, Any]) -> Any:
    figure, axes = new_figure(1, 1, width=6.5, height=4.0)
    a, b = looked[:2]
    points = np.array([[found[a], found[b]] for _, _, found, reason in rows if reason is None and a in found and b in found])
    front = np.array([[found[a], found[b]] for n, _, found, _ in rows if n in answers["pareto"] and a in found and b in found])
    axes[0][0].plot(points[:, 0], points[:, 1], ".", color=SOFT, markersize=4)
    axes[0][0].plot(front[:, 0], front[:, 1], "o", color=RED, markersize=5, label="on the front")
    axes[0][0].set_xlabel(a)
    axes[0][0].set_ylabel(b)
    axes[0][0].legend()
    return figure
