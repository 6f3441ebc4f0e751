"""The score of an examination: shares with their intervals, targets, confusion, calibration, detection limits."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
import itertools
import math
from typing import Any

import numpy as np

from .mark_budget import VISIBLE
from .mark_law import SIMILAR
from .questions import ANOTHER

Mark = Mapping[str, Any]

TARGETS = (
    # what, target: at least; at most if negative; a range if a pair
    ("first named right, usual size", 0.95),
    ("exactly right, usual size", 0.90),
    ("exactly right, a fifth of usual size", 0.85),
    ("right or rightly ambiguous, scale and current only", 0.80),
    ("right or rightly ambiguous, programs only", 0.80),
    ("both right, two effects", 0.75),
    ("healthy recognised", 0.98),
    ("exactly right, another machine", 0.93),
    ("healthy recognised, another machine", 1.0),
    ("outside the library recognised", 0.75),
    ("outside the library: axis and block", 0.90),
    ("outside the library: law over the right variable", 0.85),
    ("outside the library: shape of the law", 0.70),
    ("outside the library: no absent effect named", 0.90),
    ("outside the library: gap after at most 1.5 x floor", 0.70),
    ("median parameter error", -0.06),
    ("intervals cover the truth", (0.88, 0.99)),
    ("gap after over floor, median", -1.3),
    ("Brier score", -0.08),
    ("everyday: named effects that are there", 0.95),
    ("everyday: effects of at least 3 x noise that are named", 0.90),
    ("everyday: largest contribution named", 1.0),
    ("everyday: order of the five largest, 1 - Kendall tau, mean", -0.2),
    ("everyday: relative error of a contribution, median", -0.15),
    ("everyday: gap after over floor, median", -1.5),
    ("everyday: Brier score of the candidates", -0.05),
)
"""Targets without the prefix "everyday" exclude everyday machines."""

OF_LAWS = (
    "outside the library: law over the right variable",
    "outside the library: shape of the law",
    "outside the library: gap after at most 1.5 x floor",
)
"""Targets that only a law can meet."""

FULL = ("usual", "a fifth")
"""Strata of single effects with all signals and runs."""

EVERYDAY = "everyday"
"""Stratum of machines with many small effects."""

MOST_LEFT = 1.5
"""Largest gap over floor of a closed law outside the library."""

ROUNDING = 1e-9
"""Relative rounding error of a value."""

BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 1.0)


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    if trials == 0:
        return 0.0, 1.0
    z, p = 1.96, successes / trials
    middle, half = p + z * z / (2 * trials), z * math.sqrt(p * (1 - p) / trials + z * z / (4 * trials**2))
    return (middle - half) / (1 + z * z / trials), (middle + half) / (1 + z * z / trials)


def score(marks: Sequence[Mark], laws_searched: bool = True) -> dict[str, Any]:
    """The `score` of an `exam.json`. The targets of laws are not asked of a diagnosis that does not search laws (`--quick`)."""
    of = {name: [m for m in marks if m["stratum"] == name] for name in dict.fromkeys(m["stratum"] for m in marks)}

    def share(stratum: str, key: str) -> dict[str, Any] | None:
        rows = of.get(stratum, [])
        return _share(sum(m[key] for m in rows), len(rows)) if rows else None

    one_fault = [m for m in marks if m["stratum"] != EVERYDAY]
    parameters = [p for m in one_fault for p in m["parameters"]]
    ratios = _shrunk(one_fault)
    probabilities = [(p, right) for m in one_fault for p, right in m["probabilities"]]
    values: dict[str, Any] = {
        "first named right, usual size": share("usual", "first"),
        "exactly right, usual size": share("usual", "exact"),
        "exactly right, a fifth of usual size": share("a fifth", "exact"),
        "right or rightly ambiguous, scale and current only": share("scale and current", "first_or_ambiguous"),
        "right or rightly ambiguous, programs only": share("programs only", "first_or_ambiguous"),
        "both right, two effects": share("two", "exact"),
        "healthy recognised": share("healthy", "exact"),
        "exactly right, another machine": share(ANOTHER, "exact"),
        "healthy recognised, another machine": _exact([m for m in of.get(ANOTHER, []) if not m["true"]]),
        "outside the library recognised": share("outside", "exact"),
        "outside the library: axis and block": share("outside", "place"),
        "outside the library: law over the right variable": share("outside", "law"),
        "outside the library: shape of the law": _similar(of.get("outside", [])),
        "outside the library: no absent effect named": _none_named(of.get("outside", [])),
        "outside the library: gap after at most 1.5 x floor": _closed(of.get("outside", [])),
        "median parameter error": _value(np.median, [p["error"] for p in parameters]),
        "intervals cover the truth": _share(sum(p["covered"] for p in parameters), len(parameters)) if parameters else None,
        "gap after over floor, median": _value(np.median, ratios),
        "Brier score": _value(np.mean, [(p - right) ** 2 for p, right in probabilities]),
        **_everyday(of.get(EVERYDAY, [])),
    }
    if not laws_searched:
        values |= dict.fromkeys(OF_LAWS)
    return {
        "cases": len(marks),
        "failed": sum("failed" in m for m in marks),
        "targets": [
            {"what": what, "target": target, **(values[what] or {}), "met": _met(values[what], target)} for what, target in TARGETS
        ],
        "strata": {
            name: {
                "cases": len(rows),
                **{k: sum(m[k] for m in rows) for k in ("first", "first_or_ambiguous", "exact", "place")},
            }
            for name, rows in of.items()
        },
        "macro_f1": macro_f1(marks),
        "confusion": confusion(marks),
        "calibration": calibration(probabilities),
        "candidates": calibration(_candidates(of.get(EVERYDAY, []))),
        "by_size": by_size(marks),
        "detection": detection(marks),
        "gap": _gaps(marks),
        "same_parameters": _same_parameters(marks),
    }


def _everyday(marks: Sequence[Mark]) -> dict[str, dict[str, Any] | None]:
    """Values of the everyday targets, pooled over all their cases."""
    budgets = [m["budget"] for m in marks]

    def counted(key: str) -> dict[str, Any] | None:
        right, of = (sum(b[key][i] for b in budgets) for i in (0, 1))
        return _share(right, of) if of else None

    largest = [b["largest"] for b in budgets if b["largest"] is not None]
    named = [c for b in budgets for c in b["contributions"] if c["said"] is not None and c["true"] >= VISIBLE]
    return {
        "everyday: named effects that are there": counted("precision"),
        "everyday: effects of at least 3 x noise that are named": counted("recall"),
        "everyday: largest contribution named": _share(sum(largest), len(largest)) if largest else None,
        "everyday: order of the five largest, 1 - Kendall tau, mean": _value(
            np.mean, [1.0 - b["order"] for b in budgets if b["order"] is not None]
        ),
        "everyday: relative error of a contribution, median": _value(np.median, [abs(c["said"] / c["true"] - 1.0) for c in named]),
        "everyday: gap after over floor, median": _value(np.median, _shrunk(marks)),
        "everyday: Brier score of the candidates": _value(np.mean, [(p - there) ** 2 for p, there in _candidates(marks)]),
    }


def _candidates(marks: Sequence[Mark]) -> list[tuple[float, bool]]:
    return [(p, there) for m in marks for p, there in m["budget"]["candidates"]]


def _shrunk(marks: Sequence[Mark]) -> list[float]:
    """Gap after over floor of cases with effects; infinite without a diagnosis or if the corrected machine cannot be simulated."""
    return [m["gap"].get("after", math.inf) / m["gap"]["floor"] for m in marks if m["true"]]


def _closed(marks: Sequence[Mark]) -> dict[str, Any] | None:
    """Cases whose gap after correction is at most MOST_LEFT x the floor on the examination's own runs."""
    return _share(sum(m["gap"].get("after", math.inf) <= MOST_LEFT * m["gap"]["floor"] for m in marks), len(marks)) if marks else None


def _exact(marks: Sequence[Mark]) -> dict[str, Any] | None:
    """Cases that are exactly right."""
    return _share(sum(m["exact"] for m in marks), len(marks)) if marks else None


def _similar(marks: Sequence[Mark]) -> dict[str, Any] | None:
    """Cases with a law of the right shape: its correlation with the true law is at least SIMILAR."""
    return _share(sum(m["shape"] >= SIMILAR for m in marks), len(marks)) if marks else None


def _none_named(marks: Sequence[Mark]) -> dict[str, Any] | None:
    """Cases without an effect of the library in the answer; a machine with a fault outside the library has none."""
    return _share(sum(not m["named"] for m in marks), len(marks)) if marks else None


def _value(of: Callable[[Sequence[float]], Any], values: Sequence[float]) -> dict[str, Any] | None:
    return {"value": float(of(values)), "of": len(values)} if values else None


def _share(successes: int, trials: int) -> dict[str, Any]:
    low, high = wilson(successes, trials)
    return {"value": successes / trials, "right": int(successes), "of": trials, "low": low, "high": high}


def _met(value: Mapping[str, Any] | None, target: float | tuple[float, float]) -> bool | None:
    if value is None:
        return None
    v = value["value"]
    if isinstance(target, tuple):
        return bool(target[0] <= v <= target[1])
    # a mean of decimal fractions may lie a rounding error beyond its target
    return bool(v <= -target * (1.0 + ROUNDING)) if target < 0 else bool(v >= target * (1.0 - ROUNDING))


def is_failed(target: Mapping[str, Any]) -> bool:
    """Is a target missed? A share counts as missed only if its whole 95 % interval misses the target."""
    if target["met"] is not False:
        return False
    if "low" not in target:
        return True
    goal = target["target"]
    least, most = goal if isinstance(goal, (tuple, list)) else (goal, 1.0)
    return bool(target["high"] < least or target["low"] > most)


def target_word(target: Mapping[str, Any]) -> str:
    """'met', 'missed', 'too few to say' if the interval includes the target, '' without a value."""
    if target["met"] is None:
        return ""
    return "met" if target["met"] else "missed" if is_failed(target) else "too few to say"


def label_of(m: Mark) -> str:
    """Label of the truth: effect, none, or outside the library."""
    return "outside the library" if m["outside"] else m["true"][0][0] if m["true"] else "none"


def answer_of(m: Mark) -> str:
    """Label of the answer; the right effect on another axis gets a label of its own."""
    if m["verdict"] != "effect" or not m["named"]:
        outside = dict.fromkeys(("unknown", "law"), label_of({"outside": True}))
        return {**outside, "effect": "none"}.get(m["verdict"], str(m["verdict"]))
    name, axis = m["named"][0]
    same = any(t[0] == name for t in m["true"])
    return name if [name, axis] in m["true"] or not same else f"{name}, other axis"


def _one_each(marks: Iterable[Mark]) -> list[Mark]:
    return [m for m in marks if len(m["true"]) <= 1]


def singles(marks: Iterable[Mark]) -> list[Mark]:
    """Cases with one effect, all signals and all runs."""
    return [m for m in marks if len(m["true"]) == 1 and m["stratum"] in FULL]


def macro_f1(marks: Sequence[Mark]) -> float:
    """Mean over the true labels (each effect, none, outside the library) of 2 tp / (2 tp + fp + fn)."""
    pairs = [(label_of(m), answer_of(m)) for m in _one_each(marks)]
    labels = sorted({true for true, _ in pairs})
    scores = []
    for label in labels:
        hit = sum(t == s == label for t, s in pairs)
        wrong = sum((t == label) != (s == label) for t, s in pairs)
        scores.append(2 * hit / (2 * hit + wrong))
    return float(np.mean(scores)) if scores else 0.0


def confusion(marks: Sequence[Mark]) -> dict[str, dict[str, int]]:
    """True label -> answered label -> count."""
    table: dict[str, Counter[str]] = {}
    for m in _one_each(marks):
        table.setdefault(label_of(m), Counter())[answer_of(m)] += 1
    return {true: dict(said.most_common()) for true, said in sorted(table.items())}


def calibration(probabilities: Sequence[tuple[float, bool]]) -> list[dict[str, Any]]:
    """Share of present effects by bin of stated probability."""
    rows = []
    for low, high in itertools.pairwise(BINS):
        inside = [(p, right) for p, right in probabilities if low <= p < high or (high == 1.0 and p == 1.0)]
        if inside:
            said = float(np.mean([p for p, _ in inside]))
            rows.append({"said": said, **_share(sum(right for _, right in inside), len(inside))})
    return rows


def by_size(marks: Sequence[Mark]) -> list[dict[str, Any]]:
    """Share exactly right of `singles`, by bin of size over noise."""
    rows = []
    edges = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, math.inf)
    asked = singles(marks)
    for low, high in itertools.pairwise(edges):
        inside = [m for m in asked if low <= m["gap"]["size"] < high]
        if inside:
            rows.append({"from": low, "to": high if math.isfinite(high) else None, **_share(sum(m["exact"] for m in inside), len(inside))})
    return rows


def detection(marks: Sequence[Mark]) -> dict[str, dict[str, Any]]:
    """Per effect: smallest size over noise that was diagnosed exactly, and largest that was not."""
    out: dict[str, dict[str, Any]] = {}
    for m in singles(marks):
        row = out.setdefault(m["true"][0][0], {"cases": 0, "right": 0, "smallest_right": None, "largest_missed": None})
        size = m["gap"]["size"]
        row["cases"] += 1
        row["right"] += m["exact"]
        key, better = ("smallest_right", min) if m["exact"] else ("largest_missed", max)
        row[key] = size if row[key] is None else better(row[key], size)
    return dict(sorted(out.items()))


def _gaps(marks: Sequence[Mark]) -> dict[str, Any]:
    rows = [m["gap"] for m in marks if m["true"]]
    return {
        "unit": "multiples of the noise alone, on the exam's own runs; medians over cases with effects",
        **{key: _median(g.get(key) for g in rows) for key in ("before", "after", "floor", "true_effects")},
    }


def _median(values: Iterable[float | None]) -> float | None:
    there = [v for v in values if v is not None]
    return float(np.median(there)) if there else None


def _same_parameters(marks: Sequence[Mark]) -> dict[str, Any]:
    """Difference of twin and plant with the same parameters and effects: that of the two models, plus richness."""
    rows = [m["gap"] for m in marks if "true_effects" in m["gap"]]
    axes = sorted({a for g in rows for a in g["true_effects_position"]})
    return {
        "cases": len(rows),
        "level": _median(g["true_effects"] for g in rows),
        "position_rms": {a: _median(g["true_effects_position"].get(a) for g in rows) for a in axes},
        "unit": "level in multiples of noise; position RMS in um (X, Y, Z) and arcsec (A, C)",
    }


def value_text(target: Mapping[str, Any]) -> str:
    """The value of a target that is no share, with as many digits as it takes to tell it from a target that it misses."""
    value, goal = target["value"], target["target"]
    digits = next((n for n in range(3, 10) if target["met"] or f"{value:.{n}g}" != f"{abs(goal):.{n}g}"), 10)
    return f"{value:.{digits}g}"


def target_text(target: object) -> str:
    """A target in words."""
    if isinstance(target, (tuple, list)):
        return f"{target[0]:.0%} to {target[1]:.0%}"
    assert isinstance(target, float)
    return f"at most {-target:.3g}" if target < 0 else f"at least {target:.0%}"
