"""The report of an examination: score against targets, plots, and every case that is not exactly right."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.report import Figure, Section, Table, figure_svg, new_figure, write_page
from twin.report.figure import AMBER, BLUE, GREEN, RED, SOFT
from twin.report.page import made_line
from twin.units import in_words

from .mark import VISIBLE
from .score import is_failed, label_of, singles, target_text, target_word, value_text

Document = Mapping[str, Any]

LISTED = 5
"""Number of effects of a case that are listed by name."""


def write_exam_report(document: Document, path: Path) -> None:
    """Write the page."""
    s = document["score"]
    usual = next((t for t in s["targets"] if t["what"].startswith("first named right") and "value" in t), None)
    lead = (
        f"{counted(document)}: machines with sealed faults, drawn on a second plant and diagnosed by a process that got only their traces. "
        + (f"The effect and its axis were named first in {usual['right']} of {usual['of']} cases of usual size." if usual else "")
    )
    write_page(path, "Examination of the diagnosis", lead, sections_of(document), made_line(seed=document["seed"]))


def sections_of(document: Document) -> list[Section]:
    """All sections with content."""
    s, marks = document["score"], document["marks"]
    same = s["same_parameters"]
    asked = [t for t in s["targets"] if "value" in t]
    others = len(s["targets"]) - len(asked)
    said = [f"No machine of this examination asks for the other {others} targets."] if others else []
    sections = [Section("Score against the targets", said, tables=[target_table(asked)])]
    if s["confusion"]:
        sections.append(Section("Confusion matrix", figures=[_confusion(s["confusion"])]))
    if singles(marks):
        text = "Size over noise: RMS change of the axis' signals by the effect alone, over signals and runs, as a multiple of the noise."
        sections.append(Section("Detection limits", [text], figures=[_detection(marks)]))
    sections.append(Section("Gap before and after", figures=[_gaps(marks)]))
    if s["calibration"]:
        sections.append(Section("Calibration of the probabilities", figures=[_calibration(s["calibration"])]))
    everyday = [m for m in marks if m.get("budget")]
    if everyday:
        text = "Machines with many small effects on every axis. Contribution: RMS change of all signals by one effect, as a multiple of the noise."
        figures = [_budgets(everyday)] + ([_calibration(s["candidates"])] if s.get("candidates") else [])
        sections.append(Section("Everyday machines", [text], figures=figures))
    wrong = [m for m in document["marks"] if "failed" in m or not m["exact"]]
    sections.append(
        Section("Cases that are not exactly right", tables=[_wrong(wrong)] if wrong else [], paragraphs=[] if wrong else ["None."])
    )
    seal = (
        f"Seed {document['seed']}, richness {document['richness']}. SHA-256 of all truths, published before the first diagnosis: {document['seal']}. "
        "The truths stayed in the memory of the examining process until all answers were written."
    )
    if same["level"] is not None:
        seal += f" With the same parameters and effects, twin and plant differ by {same['level']:.2f} times the noise (RMS)."
    return [*sections, Section("Seal", [seal])]


def counted(document: Document) -> str:
    """Number of scored cases, and the reasons for the others."""
    s, lost = document["score"], document["not_answered"]
    rest = [f"{lost} not answered when it was opened"] if lost else []
    rest += [f"{len(document['not_drawn'])} could not be drawn"] if document["not_drawn"] else []
    return f"{s['cases']} of {s['cases'] + lost} sealed cases scored" + (f" ({', '.join(rest)})" if rest else "")


def target_table(targets: Sequence[Document]) -> Table:
    """Each target with what was measured."""
    rows = []
    for t in targets:
        value = "not asked" if "value" not in t else f"{t['right']} of {t['of']}" if "right" in t else f"{value_text(t)} (of {t['of']})"
        interval = f"{t['low']:.0%} to {t['high']:.0%}" if "low" in t else ""
        share = f"{t['value']:.0%}" if "right" in t else ""
        rows.append([t["what"], value, share, interval, target_text(t["target"]), target_word(t)])
    missed = frozenset(i for i, t in enumerate(targets) if is_failed(t))
    return Table(["target", "measured", "share", "95 % interval", "asked", "verdict"], rows, marked=missed)


def _confusion(table: Document) -> Figure:
    true = list(table)
    said = sorted({s for row in table.values() for s in row}, key=lambda s: (s not in true, true.index(s) if s in true else 0, s))
    counts = np.array([[table[t].get(s, 0) for s in said] for t in true], dtype=float)
    figure, ((ax,),) = new_figure(1, 1, height=0.235 * len(true) + 2.2, width=11.5)
    ax.grid(False)
    ax.imshow(counts / counts.sum(axis=1, keepdims=True), cmap="Blues", vmin=0, vmax=1.3, aspect="auto")
    for i, j in zip(*np.nonzero(counts)):
        colour = "white" if counts[i, j] > 0.5 * counts[i].sum() else "#1c2430" if said[j] == true[i] else RED
        ax.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=8, color=colour)
    ax.set_xticks(range(len(said)), [in_words(s) for s in said], rotation=90, fontsize=8)
    ax.set_yticks(range(len(true)), [in_words(t) for t in true], fontsize=8)
    ax.set(xlabel="named first", ylabel="true")
    return Figure(figure_svg(figure), "Cases with one effect, none, or a fault outside the library, by true effect and first-named effect.")


def _detection(marks: Sequence[Document]) -> Figure:
    single = singles(marks)
    names = sorted({label_of(m) for m in single}, reverse=True)
    figure, ((ax,),) = new_figure(1, 1, height=0.22 * len(names) + 1.0)
    for good, colour, marker, text in ((True, GREEN, "o", "exactly right"), (False, RED, "x", "not exactly right")):
        rows = [m for m in single if m["exact"] == good]
        ax.plot([max(m["gap"]["size"], 1e-2) for m in rows], [names.index(label_of(m)) for m in rows], marker, color=colour, label=text)
    ax.axvline(1.0, color=SOFT, linewidth=1)
    ax.set_yticks(range(len(names)), [in_words(n) for n in names], fontsize=8)
    ax.set(xscale="log", xlabel="size over noise", ylim=(-0.6, len(names) - 0.4))
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return Figure(
        figure_svg(figure), "Every case with a single effect, by size over noise. At the line the effect is as large as the noise."
    )


def _gaps(marks: Sequence[Document]) -> Figure:
    rows = sorted((m["gap"] for m in marks if m["true"]), key=lambda g: g["before"])
    figure, ((ax,),) = new_figure(1, 1, height=2.8)
    for key, colour, marker in (("before", RED, "o"), ("true_effects", AMBER, "_"), ("after", BLUE, "o"), ("floor", SOFT, "_")):
        there = [i for i, g in enumerate(rows) if key in g]
        ax.plot(there, [rows[i][key] for i in there], marker, color=colour, markersize=5, label=in_words(key))
    ax.axhline(1.0, color="#1c2430", linewidth=1)
    ax.set(yscale="log", xticks=[], xlabel="cases with effects, by the gap of the nominal machine", ylabel="gap over noise")
    ax.legend(ncols=3, loc="upper left")
    text = (
        "Gap on runs that the diagnosis did not get. Before: machine file. True effects: twin with the true parameters and effects, "
        "without the plant's small imperfections. After: corrected machine. Floor: two recordings of the same machine."
    )
    return Figure(figure_svg(figure), text)


def _budgets(marks: Sequence[Document]) -> Figure:
    rows = [c for m in marks for c in m["budget"]["contributions"] if c["true"] > 0]
    named = [c for c in rows if c["said"]]
    missed = [c for c in rows if not c["said"]]
    figure, ((ax,),) = new_figure(1, 1, width=6.5, height=4.0)
    low, high = 0.5 * min((c["true"] for c in rows), default=0.1), 2.0 * max((c["true"] for c in rows), default=10.0)
    ax.plot([low, high], [low, high], color=SOFT, linewidth=1)
    ax.axvline(VISIBLE, color="#1c2430", linewidth=1)
    ax.plot([c["true"] for c in named], [c["said"] for c in named], "o", color=BLUE, markersize=4, label=f"named ({len(named)})")
    ax.plot([c["true"] for c in missed], [low] * len(missed), "x", color=RED, label=f"not named ({len(missed)})")
    ax.set(xscale="log", yscale="log", xlabel="true contribution, times noise", ylabel="stated contribution, times noise")
    ax.legend(loc="upper left")
    return Figure(
        figure_svg(figure),
        f"Every effect of the everyday machines; unnamed ones at the bottom. Right of the black line ({VISIBLE:.0f} x noise) each must be named.",
    )


def _calibration(bins: Sequence[Document]) -> Figure:
    figure, ((ax,),) = new_figure(1, 1, width=5.0, height=3.2)
    ax.plot([0, 1], [0, 1], color=SOFT, linewidth=1)
    for b in bins:
        ax.plot([b["said"], b["said"]], [b["low"], b["high"]], color=BLUE, linewidth=3, alpha=0.3)
        ax.plot(b["said"], b["value"], "o", color=BLUE)
        ax.annotate(str(b["of"]), (b["said"], b["value"]), textcoords="offset points", xytext=(-14, -3), fontsize=8)
    ax.set(xlabel="stated probability", ylabel="share present", xlim=(0, 1.02), ylim=(0, 1.05))
    return Figure(
        figure_svg(figure),
        "Stated probability against the share that is present; the numbers are counts. On the line the probabilities are calibrated.",
    )


def _many(effects: Sequence[Sequence[str]]) -> str:
    """The first few effects in words, and the number of the others."""
    few = ", ".join(f"{e[0].replace('_', ' ')} {e[1]}" for e in effects[:LISTED])
    return few + (f" and {len(effects) - LISTED} more" if len(effects) > LISTED else "")


def _wrong(marks: Sequence[Document]) -> Table:
    rows = []
    for m in marks:
        there = _many(m["true"]) or ", ".join(f"{n} {a} ({b})" for n, a, b in m["outside"]) or "nothing"
        if "failed" in m:
            rows.append([m["case"], m["stratum"], there, f"not diagnosed: {m['failed']}", ""])
            continue
        named = _many(m["named"])
        said = f"{m['verdict']}{': ' + named if named else ''}"
        size = f"{m['gap']['size']:.2g}" if "size" in m["gap"] else ""
        rows.append([m["case"], m["stratum"], there, said, size])
    return Table(["case", "stratum", "true", "diagnosed", "size over noise"], rows, left=4)
