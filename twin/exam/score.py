"""The score of an examination: shares with their intervals, targets, confusion, calibration, detection limits."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binomtest

from twin.units import LEAST_SHOWN, plain

from .mark import VISIBLE
from .mark_law import SIMILAR
from .questions import ANOTHER

Mark = Mapping[str, Any]
Marks = Sequence[Mark]

FULL = ("usual", "a fifth")
"""Strata of single effects with all signals and runs."""

EVERYDAY, ONE_FAULT = "everyday", "one fault"
"""Stratum of machines with many small effects, and all the others together."""


ROUNDING = 1e-9
"""Relative rounding error of a value."""

BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 1.0)


Value = dict[str, Any] | None
"""`value`, and the number of cases or numbers that it is `of`; of a share also how many are right, and its interval. None without a case."""


def share_of(right: int, of: int) -> Value:
    """A share with its 95 % interval (Wilson 1927)."""
    if not of:
        return None
    low, high = map(float, binomtest(right, of).proportion_ci(0.95, "wilson"))
    return {"value": right / of, "right": right, "of": of, "low": low, "high": high}


def _value(of: Callable[[Sequence[float]], Any], values: Sequence[float]) -> Value:
    return {"value": float(of(values)), "of": len(values)} if values else None


def _right(of: str | Callable[[Mark], Any]) -> Callable[[Marks], Value]:
    """Share of the cases that are right, by a key of the mark or by a rule."""
    holds = (lambda m: m[of]) if isinstance(of, str) else of
    return lambda marks: share_of(sum(bool(holds(m)) for m in marks), len(marks))


def _counted(key: str) -> Callable[[Marks], Value]:
    """Share of the effects of all machines that are right, by a pair (right, of) of the budget."""
    return lambda marks: share_of(*(sum(m[key][i] for m in marks) for i in (0, 1)))


def _all(key: str, marks: Marks) -> list[Any]:
    """The entries of a list of all marks."""
    return [entry for m in marks for entry in m[key]]


def _known(key: str, marks: Marks) -> list[Any]:
    return [m[key] for m in marks if m[key] is not None]


def _left(m: Mark) -> float:
    """Gap after over floor; infinite without a diagnosis or if the corrected machine cannot be simulated."""
    return float(m["gap"].get("after", math.inf) / m["gap"]["floor"])


def _median_left(marks: Marks) -> Value:
    return _value(np.median, [_left(m) for m in marks if m["true"]])


def _brier(stated: Sequence[tuple[float, bool]]) -> Value:
    return _value(np.mean, [(p - right) ** 2 for p, right in stated])


def _contribution_errors(marks: Marks) -> list[float]:
    """Relative errors of the stated contributions of all visible effects that are named."""
    rows = [c for c in _all("contributions", marks) if c["said"] is not None and c["true"] >= VISIBLE]
    return [abs(c["said"] / c["true"] - 1.0) for c in rows]


class Target(NamedTuple):
    """What is asked of the cases of a stratum: its `goal` (at least; at most if negative; a range if a pair), and its value over their marks,
    which hold the marks of the budget too on everyday machines.

    Only a law can meet a target `of_laws`.
    """

    stratum: str
    what: str
    goal: float | tuple[float, float]
    value: Callable[[Marks], Value]
    of_laws: bool = False


TARGETS = (
    Target("usual", "first named right, usual size", 0.95, _right("first")),
    Target("usual", "exactly right, usual size", 0.90, _right("exact")),
    Target("a fifth", "exactly right, a fifth of usual size", 0.85, _right("exact")),
    Target("scale and current", "right or rightly ambiguous, scale and current only", 0.80, _right("first_or_ambiguous")),
    Target("programs only", "right or rightly ambiguous, programs only", 0.80, _right("first_or_ambiguous")),
    Target("two", "both right, two effects", 0.75, _right("exact")),
    Target("healthy", "healthy recognised", 0.98, _right("exact")),
    Target(ANOTHER, "exactly right, another machine", 0.93, _right("exact")),
    Target(ANOTHER, "healthy recognised, another machine", 1.0, lambda marks: _right("exact")([m for m in marks if not m["true"]])),
    Target("outside", "outside the library recognised", 0.75, _right("exact")),
    Target("outside", "outside the library: axis and block", 0.90, _right("place")),
    Target("outside", "outside the library: law over the right variable", 0.85, _right("law"), of_laws=True),
    Target("outside", "outside the library: shape of the law", 0.70, _right(lambda m: m["shape"] >= SIMILAR), of_laws=True),
    Target("outside", "outside the library: no absent effect named", 0.90, _right(lambda m: not m["named"])),
    Target("outside", "outside the library: gap after at most 1.5 x floor", 0.70, _right(lambda m: _left(m) <= 1.5), of_laws=True),
    Target(ONE_FAULT, "median parameter error", -0.06, lambda marks: _value(np.median, [p["error"] for p in _all("parameters", marks)])),
    Target(ONE_FAULT, "intervals cover the truth", (0.88, 0.99), lambda marks: _right("covered")(_all("parameters", marks))),
    Target(ONE_FAULT, "gap after over floor, median", -1.3, _median_left),
    Target(ONE_FAULT, "Brier score", -0.08, lambda marks: _brier(_all("probabilities", marks))),
    Target(EVERYDAY, "everyday: named effects that are there", 0.95, _counted("precision")),
    Target(EVERYDAY, "everyday: effects of at least 3 x noise that are named", 0.90, _counted("recall")),
    Target(EVERYDAY, "everyday: largest contribution named", 1.0, lambda marks: share_of(sum(x := _known("largest", marks)), len(x))),
    Target(
        EVERYDAY,
        "everyday: order of the five largest, 1 - Kendall tau, mean",
        -0.2,
        lambda marks: _value(np.mean, [1.0 - tau for tau in _known("order", marks)]),
    ),
    Target(
        EVERYDAY, "everyday: relative error of a contribution, median", -0.15, lambda marks: _value(np.median, _contribution_errors(marks))
    ),
    Target(EVERYDAY, "everyday: gap after over floor, median", -1.5, _median_left),
    Target(EVERYDAY, "everyday: Brier score of the candidates", -0.05, lambda marks: _brier(_all("candidates", marks))),
)


def score(marks: Marks, laws_searched: bool = True) -> dict[str, Any]:
    """The `score` of an `exam.json`. The targets of laws are not asked of a diagnosis that does not search laws (`--quick`)."""
    strata = {name: [m for m in marks if m["stratum"] == name] for name in dict.fromkeys(m["stratum"] for m in marks)}
    everyday: Marks = [{**m, **m["budget"]} for m in strata.get(EVERYDAY, [])]
    rows: dict[str, Marks] = {**strata, EVERYDAY: everyday, ONE_FAULT: [m for m in marks if m["stratum"] != EVERYDAY]}
    values = {t: None if t.of_laws and not laws_searched else t.value(rows.get(t.stratum, [])) for t in TARGETS}
    same = [m["gap"]["true_effects"] for m in marks if "true_effects" in m["gap"]]
    confused = confusion(marks)
    return {
        "cases": len(marks),
        "failed": sum("failed" in m for m in marks),
        "targets": [
            {"what": target.what, "target": target.goal, **(value or {}), "met": _met(value, target.goal)}
            for target, value in values.items()
        ],
        "strata": {
            name: {"cases": len(rows), **{k: sum(m[k] for m in rows) for k in ("first", "first_or_ambiguous", "exact", "place")}}
            for name, rows in strata.items()
        },
        "macro_f1": macro_f1(confused),
        "confusion": confused,
        "calibration": calibration(_all("probabilities", rows[ONE_FAULT])),
        "candidates": calibration(_all("candidates", everyday)),
        "detection": detection(marks),
        "gap": _gaps(marks),
        "same_parameters": {"cases": len(same), "level": _median(same), "unit": "multiples of noise"},  # of the two models, plus richness
    }


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
    least, most = _goal_of(target)
    return bool(target["high"] < least or target["low"] > most)


def _goal_of(target: Mapping[str, Any]) -> tuple[float, float]:
    """The least and the largest share that meet a target."""
    goal = target["target"]
    return tuple(goal) if isinstance(goal, (tuple, list)) else (goal, 1.0)


def target_word(target: Mapping[str, Any]) -> str:
    """'met' or 'missed'; where the 95 % interval of a share also holds the opposite, 'met so far' or 'too few to say'; '' without a value."""
    if target["met"] is None:
        return ""
    if not target["met"]:
        return "missed" if is_failed(target) else "too few to say"
    least, most = _goal_of(target)
    return "met" if "low" not in target or least <= target["low"] <= target["high"] <= most else "met so far"


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


def singles(marks: Iterable[Mark]) -> list[Mark]:
    """Cases with one effect, all signals and all runs."""
    return [m for m in marks if len(m["true"]) == 1 and m["stratum"] in FULL]


def macro_f1(confused: Mapping[str, Mapping[str, int]]) -> float:
    """Mean over the true labels (each effect, none, outside the library) of 2 tp / (2 tp + fp + fn)."""
    said = sum(map(Counter, confused.values()), Counter())
    scores = [2 * row.get(label, 0) / (sum(row.values()) + said[label]) for label, row in confused.items()]
    return float(np.mean(scores)) if scores else 0.0


def confusion(marks: Marks) -> dict[str, dict[str, int]]:
    """True label -> answered label -> count, over cases with at most one effect."""
    table: dict[str, Counter[str]] = {}
    for m in marks:
        if len(m["true"]) <= 1:
            table.setdefault(label_of(m), Counter())[answer_of(m)] += 1
    return {true: dict(said.most_common()) for true, said in sorted(table.items())}


def calibration(probabilities: Sequence[tuple[float, bool]]) -> list[dict[str, Any]]:
    """Share of present effects by bin of stated probability."""
    rows = []
    for low, high in itertools.pairwise(BINS):
        inside = [(p, right) for p, right in probabilities if low <= p < high or (high == 1.0 and p == 1.0)]
        if inside:
            said = float(np.mean([p for p, _ in inside]))
            rows.append({"said": said, **(share_of(sum(right for _, right in inside), len(inside)) or {})})
    return rows


def detection(marks: Marks) -> dict[str, dict[str, Any]]:
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


def _gaps(marks: Marks) -> dict[str, Any]:
    rows = [m["gap"] for m in marks if m["true"]]
    return {
        "unit": "multiples of the noise alone, on the exam's own runs; medians over cases with effects",
        **{key: _median(g.get(key) for g in rows) for key in ("before", "after", "floor", "true_effects")},
    }


def _median(values: Iterable[float | None]) -> float | None:
    there = [v for v in values if v is not None]
    return float(np.median(there)) if there else None


def value_text(target: Mapping[str, Any]) -> str:
    """The value of a target that is no share, with as many digits as it takes to differ from a target that it misses."""
    value, goal = target["value"], target["target"]
    digits = next((n for n in range(3, 10) if target["met"] or f"{value:.{n}g}" != f"{abs(goal):.{n}g}"), 10)
    return f"{value:.{digits}g}" if value >= LEAST_SHOWN else plain(value)


def target_text(target: object) -> str:
    """A target in words."""
    if isinstance(target, (tuple, list)):
        return f"{target[0]:.0%} to {target[1]:.0%}"
    assert isinstance(target, float)
    return f"at most {-target:.3g}" if target < 0 else f"at least {target:.0%}"
