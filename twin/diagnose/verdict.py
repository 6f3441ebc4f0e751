"""What is said of what was found: which effects, how probable, and whether something is left that is not known."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from twin.diagnose.found import Candidate, Found, closed, differs_between_runs, excess_of, is_localised, is_systematic
from twin.diagnose.left_out import EVIDENCE, beyond_tolerance
from twin.effects import Setting

TEMPERATURE = 3.0
"""Divides the evidence before it becomes a probability: models are never quite right."""

CONFIDENCE = 0.98
"""No probability is larger: what is not in the library cannot be ruled out."""

STANDS_IN = 0.3
"""Factor on the probability of an effect that leaves something unknown: it may stand in for a law that is not in the library."""

REMAINING = 0.1
"""Share of the excess over noise that, left after all found effects, makes the verdict 'unknown'."""

NOTICED_EXCESS = 0.12
"""Mean square of the residual above noise from which something is there at all."""


def probabilities_of(candidates: Sequence[Candidate]) -> list[float]:
    """Probability of each candidate of a round against its rivals and against none of them."""
    if not candidates:
        return []
    evidence = np.array([c.evidence if c.plausible else -1e3 for c in candidates] + [EVIDENCE])
    odds = np.exp(np.clip((evidence - evidence.max()) / TEMPERATURE, -700, 0))
    return (CONFIDENCE * odds / odds.sum())[:-1].tolist()


def named(found: Sequence[Found]) -> list[tuple[Setting, Found, float]]:
    """Effects of all groups, most certain first, with their probability in the round that accepted them."""
    out = []
    for f in found:
        trust = STANDS_IN if f.unknown else 1.0
        for setting in f.fit.settings:
            probability = CONFIDENCE
            for candidates in f.rounds:
                for candidate, p in zip(candidates, probabilities_of(candidates)):
                    if candidate.key == setting.key:
                        probability = p
            out.append((setting, f, probability * trust))
    strength = {id(f): closed(f) for f in found}
    return sorted(out, key=lambda item: -strength[id(item[1])])


def is_unknown(f: Found) -> bool:
    """Is something left of a group of axes that no effect found explains?

    Or is what was found one thing in one run and another in the next, or explained by parameters that no machine near the tolerance has?
    """
    excess_before, excess = excess_of(f.group, f.retuned), excess_of(f.group, f.fit)
    noticed = NOTICED_EXCESS * f.group.expected_loss
    there = excess > noticed or is_localised(f)
    if there and excess > REMAINING * max(excess_before, 1e-9):
        return True
    return is_systematic(f) or differs_between_runs(f) or beyond_tolerance(f) - max(excess, 0.0) > noticed


def verdict_of(found: Sequence[Found], settings: Sequence[Any]) -> str:
    """'effect', 'none', or 'unknown' where something is left that no effect explains."""
    if any(f.unknown for f in found):
        return "unknown"
    return "effect" if settings else "none"
