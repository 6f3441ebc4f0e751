"""Names of responses that a study file asks for: each must exist, or the study ends in one line instead of ignoring it."""

from __future__ import annotations

from collections.abc import Collection, Iterator
import fnmatch

from twin.errors import InputError, nearest
from twin.study.spec import Study

SOMETIMES = ("phase_margin_", "gain_margin_", "crossover_", "bandwidth_", "settling_time_", "first_mode_", "holding_", "electrical_energy_")
"""Beginnings of responses that one variant may have and another one lacks: a loop that never reaches a gain of 1, an axis that never settles."""
OF_RATINGS = "_used_"
"""Shares of ratings: some motors of a catalogue may have a rating, others none."""


def check_names(study: Study, known: Collection[str], some_variants: bool = False) -> None:
    """Raise InputError where `answer`, `pareto` or a constraint names no response.

    `known` are the responses of all variants, or of some: then names that other variants may have pass.
    """
    known = list(known)
    for key, name in _asked(study):
        found = fnmatch.filter(known, name) if key == "constraint" else name in known
        if found or (some_variants and _may_come(name)):
            continue
        raise InputError(f"{study.path}: {key}: no response '{name}'; correct it and add --resume, nothing is lost; {nearest(name, known)}")


def _asked(study: Study) -> Iterator[tuple[str, str]]:
    """(key of the study file, name or pattern) of all responses that it names; the constraints of every study may find nothing."""
    yield from (("answer", name) for name in study.answer)
    yield from (("pareto", name) for pair in study.pareto for name in pair)
    yield from (("constraint", constraint.pattern) for constraint in study.constraints if not constraint.standing)


def _may_come(name: str) -> bool:
    name = name.rpartition(".")[2]
    return name.startswith(SOMETIMES) or OF_RATINGS in name or name.startswith("*")
