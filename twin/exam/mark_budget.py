"""The mark of an everyday machine: the budget of the diagnosis against the true one.

Effects below `VISIBLE` times the noise need not be named, and their probabilities are not scored. Naming them is no error either,
because they are present.
"""

from collections.abc import Mapping, Sequence
import math
from typing import Any

from scipy.stats import kendalltau

VISIBLE = 3.0
"""Above this multiple of the noise an effect must be named."""

LARGEST = 5
"""Number of largest contributions whose order is marked."""

What = tuple[str, str, str]
"""Effect, axis, and source axis ('' if none)."""


def what_of(e: Mapping[str, Any]) -> What:
    """The identity of an effect in a truth, an answer or a budget."""
    return e.get("effect") or e["name"], e["axis"], e.get("from_axis", "")


def mark_budget(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, Any]:
    """Marks of one case; `recall` and `precision` are pairs (right, of), `order` is Kendall's tau (None for fewer than two effects)."""
    true = {what_of(row): float(row["times_noise"]) for row in truth["budget"]}
    named = {what_of(e) for e in answer["effects"]}
    visible = {what for what, size in true.items() if size >= VISIBLE}
    rows = (answer.get("budget") or {}).get("rows", [])
    said = {what_of(row): float(row["times_noise"]) for row in rows if row.get("kind", "effect") == "effect"}
    largest = sorted(true, key=lambda what: -true[what])
    return {
        "recall": [len(visible & named), len(visible)],
        "precision": [len(named & set(true)), len(named)],
        "largest": bool(largest[0] in named) if visible else None,
        "order": _order([true[w] for w in largest[:LARGEST]], [said.get(w, 0.0) for w in largest[:LARGEST]]),
        "contributions": [{"effect": w[0], "axis": w[1], "true": true[w], "said": said.get(w) if w in named else None} for w in largest],
        "candidates": [[p, there] for p, there in _candidates(true, answer)],
    }


def _order(true: Sequence[float], said: Sequence[float]) -> float | None:
    """Kendall's tau of two rankings; 0 if all stated values are equal."""
    if len(true) < 2:
        return None
    tau = float(kendalltau(true, said).statistic)
    return tau if math.isfinite(tau) else 0.0


def _candidates(true: Mapping[What, float], answer: Mapping[str, Any]) -> list[tuple[float, bool]]:
    """(probability, is present) of every candidate; a visible effect that was neither tried nor named has probability 0."""
    stated: dict[What, float] = {}
    for e in answer.get("candidates", []):
        stated[what_of(e)] = max(stated.get(what_of(e), 0.0), float(e["probability"]))
    stated |= {what_of(e): float(e["probability"]) for e in answer["effects"]}
    asked = sorted(set(stated) | {w for w, size in true.items() if size >= VISIBLE})
    return [(stated.get(w, 0.0), w in true) for w in asked if w not in true or true[w] >= VISIBLE]
