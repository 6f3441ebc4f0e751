"""The list of cases of an examination, by stratum, from a seed. `draw` draws the machine of each case.

usual             one effect of usual size, every effect of the library in turn
a fifth           one effect of a fifth of that size
scale and current one effect, only set point, scale and current recorded
programs only     one effect, three part programs and no test run
two, three        effects at once
healthy           no effect
outside           one effect that the library does not have
everyday          background effects of 3 to 15 % of usual size on every axis, plus none to three effects of usual size
another machine   other drives, cycles, encoders and tolerance, see `other_machine`; no effect in every fifth case, one of usual size in the others

One case in ten, of every kind, is drawn wide: sizes and shapes come from ranges three times as wide.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .other_machine import arrangement_of
from .plant.effects import LIBRARY
from .plant.outside import OUTSIDE
from .plant.parameters import Richness

RICHNESS = {"off": Richness.off(), "small": Richness.small(), "full": Richness()}

ANOTHER = "another machine"
"""Stratum whose cases have machine files of their own."""

HEALTHY_EVERY = 5
"""One case in this many of that stratum has no effect."""

WIDE = 10
"""One case in this many, of every kind, is drawn wide."""


@dataclass(frozen=True)
class Stratum:
    """A kind of case: how it is drawn, and its share of an examination."""

    name: str
    kind: str
    share: float
    scale: float = 1.0
    signals: str = "full"
    runs: str = "all"


STRATA = (
    Stratum("usual", "single", 22 / 100),
    Stratum("a fifth", "single", 13 / 100, scale=0.2),
    Stratum("scale and current", "single", 8 / 100, signals="scale and current"),
    Stratum("programs only", "single", 7 / 100, runs="program"),
    Stratum("two", "pair", 9 / 100),
    Stratum("three", "triple", 2 / 100),
    Stratum("healthy", "healthy", 11 / 100),
    Stratum("outside", "outside", 8 / 100),
    Stratum("everyday", "everyday", 10 / 100),
    Stratum(ANOTHER, "single", 10 / 100),
)


@dataclass(frozen=True)
class Question:
    """One case to be drawn: number, stratum, seed, fixed effect, wide or not."""

    number: int
    stratum: Stratum
    seed: int
    effect: str | None = None
    wide: bool = False

    @property
    def name(self) -> str:
        return f"{self.number:04d}"


def questions_of(seed: int, cases: int, short: bool = False, only: str | None = None) -> list[Question]:
    """`cases` questions in random order: strata by their shares, and within a stratum every effect in turn.

    short: campaigns of four runs instead of ten. only: this stratum alone."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 50]))
    asked = [s for s in STRATA if only in (None, s.name)]
    chosen = [(stratum, effect) for stratum, count in zip(asked, _counts(asked, cases)) for effect in _effects(stratum, count, rng)]
    order = rng.permutation(len(chosen))
    seeds = np.random.SeedSequence([seed, 51]).generate_state(len(chosen))
    first = int(np.random.default_rng(np.random.SeedSequence([seed, 52])).integers(WIDE))
    questions = []
    for i, k in enumerate(order):
        stratum, effect = chosen[k]
        asked_as = replace(stratum, runs="short") if short and stratum.runs == "all" else stratum
        if stratum.name == ANOTHER:
            asked_as = replace(asked_as, signals=arrangement_of(int(seeds[i]), effect)[1], kind="single" if effect else "healthy")
        questions.append(Question(i, asked_as, int(seeds[i]), effect, bool(k % WIDE == first)))
    return questions


def _counts(strata: Sequence[Stratum], cases: int) -> list[int]:
    """Cases of each stratum, by the method of largest remainders."""
    exact = np.array([s.share for s in strata]) / sum(s.share for s in strata) * cases
    counts = np.floor(exact).astype(int)
    for k in np.argsort(counts - exact)[: cases - counts.sum()]:
        counts[k] += 1
    return counts.tolist()


def _effects(stratum: Stratum, count: int, rng: np.random.Generator) -> list[str | None]:
    """Effects in random order, each once before any repeats; None for kinds without exactly one effect."""
    library = {"single": LIBRARY, "outside": OUTSIDE}.get(stratum.kind)
    if library is None:
        return [None] * count
    if stratum.name == ANOTHER:
        effects = iter(_effects(replace(stratum, name=""), count, rng))
        return [None if i % HEALTHY_EVERY == 0 else next(effects) for i in range(count)]
    names: list[str | None] = []
    while len(names) < count:
        names += [str(n) for n in rng.permutation(list(library))]
    return names[:count]
