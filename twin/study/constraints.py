"""Constraints of a design: bounds on responses, by name or pattern. A variant that breaks one records the reason.

Two constraints always apply: a least phase margin of every loop (with less it rings), and a largest share of a run that an axis may spend
at its current or voltage limit (half a millisecond of clipped voltage at a corner is acceptable).
"""

from collections.abc import Iterator, Mapping, Sequence
import fnmatch
from typing import Annotated

from twin.study.labels import label_of, valued
from twin.tables import Number, Table, asks

MARGINS, LIMITS = "phase_margin_*_deg", "time_at_*_limit_*_share"
"""Responses whose constraints apply to every study, even if its machine has none of them."""


class Constraint(Table, frozen=True):
    """[[constraint]]: a bound on all responses whose names match a pattern (`*` and `?`): not below `least`, not above `most`."""

    response: Annotated[str, asks("name a response or a pattern, e.g. current_limit_used_*")]
    least: Number | None = None
    most: Number | None = None


def in_words(constraint: Constraint) -> str:
    """A constraint as a phrase: 'phase margin of every loop at least 30 deg'."""
    name = constraint.response
    what = label_of(name.replace("_*_", "_").rstrip("*").rstrip("_")) if "*" in name else label_of(name)
    bounds = [
        f"{words} {valued(name, value)}"
        for words, value in (("at least", constraint.least), ("at most", constraint.most))
        if value is not None
    ]
    return f"{what}{' (all)' if '*' in name else ''} {' and '.join(bounds)}"


def broken_by(constraints: Sequence[Constraint], responses: Mapping[str, float]) -> Iterator[str]:
    """A sentence for each response that breaks a constraint; with several runs the joined value is checked."""
    for constraint in constraints:
        for name in fnmatch.filter(responses, constraint.response):
            value = responses[name]
            if constraint.least is not None and value < constraint.least:
                yield f"{label_of(name)} is {valued(name, value)}, below the least of {valued(name, constraint.least)}"
            if constraint.most is not None and value > constraint.most:
                yield f"{label_of(name)} is {valued(name, value)}, above the limit of {valued(name, constraint.most)}"
