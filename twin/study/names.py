"""Checks that every response named in a study file exists."""

from __future__ import annotations

from collections.abc import Collection, Iterator
import fnmatch

from twin.errors import InputError, nearest
from twin.study.spec import Study

SOMETIMES = ("phase_margin_", "gain_margin_", "crossover_", "bandwidth_", "settling_time_", "first_mode_", "holding_", "electrical_energy_")
"""Prefixes of responses that only some variants have, for example because a loop never reaches a gain of 1 or an axis never settles."""
OF_RATINGS = "_used_"
"""Part of the names of shares of ratings, which not every motor of a catalogue has."""


def check_names(study: Study, known: Collection[str], some_variants: bool = False) -> None:
    """Raise InputError if `answer`, `pareto` or a constraint names an unknown response.

    `known` are the responses of all variants, or of `some_variants`: then names that other variants may have are accepted.
    """
    known = list(known)
    for key, name in _asked(study):
        found = fnmatch.filter(known, name) if key == "constraint" else name in known
        if found or (some_variants and _may_come(name)):
            continue
        raise InputError(f"{study.path}: {key}: no response '{name}'; {nearest(name, known)}; correct it and continue with --resume")


def _asked(study: Study) -> Iterator[tuple[str, str]]:
    """(key of the study file, name or pattern) of all responses that it names, without the standing constraints."""
    yield from (("answer", name) for name in study.answer)
    yield from (("pareto", name) for pair in study.pareto for name in pair)
    yield from (("constraint", constraint.pattern) for constraint in study.constraints if not constraint.standing)


def _may_come(name: str) -> bool:
    name = name.rpartition(".")[2]
    return name.startswith(SOMETIMES) or OF_RATINGS in name or name.startswith("*")
