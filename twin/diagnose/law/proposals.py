"""Proposed laws of an axis: the curves, formulas and filters that predict best in the blocks furthest from noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from twin.diagnose.law.filters import filters_of
from twin.diagnose.law.measure import MeasuredCurve, excess, measured_laws
from twin.diagnose.law.residual import MECHANICS, SPRING, Samples
from twin.diagnose.law.shapes import PER_NUMBER, Described, described
from twin.diagnose.law.springs import stage_over_force
from twin.diagnose.settings import T
from twin.effects import Setting, check_setting
from twin.effects.law_shapes import SHAPES
from twin.errors import InputError
from twin.machine.machine import Machine

LEAST_LAG = 0.25
"""Start value of an actuator's lag at least, in speed cycles."""


@dataclass(frozen=True)
class Selection:
    """Which candidates are described by formulas and fitted in closed loop.

    `predicts` is the smallest fraction of the loss on runs left out that a candidate must predict in its block, `near_best` the same as a
    fraction of that of the best candidate, `most` their largest number. A candidate improves most of the runs, weighted by their loss.
    """

    predicts: float
    near_best: float
    most: int


STRONG = Selection(predicts=0.15, near_best=0.4, most=3)
WEAK = Selection(predicts=0.04, near_best=0.15, most=6)
"""Tried if no strong candidate reduces the gap. A law that acts at constant speed or for a short time predicts little of the force of an axis that
accelerates, and much of its position."""


@dataclass(frozen=True)
class Measured:
    """What was measured in a block: curves and filters, each best first. `loudness` is the power of its residual over noise."""

    samples: Samples
    loudness: float
    curves: list[MeasuredCurve]
    filters: list[Described]


def measured_in(blocks: Sequence[Samples], machine: Machine, axis: str) -> list[Measured]:
    """Curves and filters of the blocks of an axis that are above noise. In the mechanics a filter is a lag of the actuator; it is measured in any
    case, because the smoothing of the force hides most of it."""
    own = machine.axis(axis)
    found = []
    for s in blocks:
        loudness = excess(s)
        curves = measured_laws(s, own) if loudness > T.clean_square else []
        has_filters = bool(s.passed) if s.block == MECHANICS else loudness > T.clean_square
        found.append(Measured(s, loudness, curves, filters_of(s, machine) if has_filters else []))
    return found


class ProposedLaw(NamedTuple):
    """A law as it was measured in the samples of a block, and as the setting from which its fit in closed loop starts."""

    measured: Described
    samples: Samples
    setting: Setting


def propose_laws(measured: Sequence[Measured], machine: Machine, axis: str, selection: Selection) -> list[ProposedLaw]:
    """The laws that predict best in the blocks of an axis that are furthest from noise, as formulas, filters or tables."""
    own = machine.axis(axis)
    found: list[tuple[float, Described, Samples]] = []
    for m in measured:
        s = m.samples
        suited = [c for c in m.curves if c.predicts > selection.predicts and c.runs_better >= T.most]
        distinct: dict[tuple[str, str, str, bool], MeasuredCurve] = {}
        for c in suited:
            distinct.setdefault((c.relation.output, c.relation.variable, c.relation.source, bool(c.relation.period)), c)
        near = [c for c in distinct.values() if c.predicts > selection.near_best * suited[0].predicts][: selection.most + 1]
        passing = m.filters if s.block != MECHANICS else []
        filters = [f for f in passing if f.predicts > selection.predicts and f.curve.runs_better >= T.most]
        stages = [stage for c in near if s.block == SPRING and (stage := stage_over_force(s, c)) and stage.predicts > selection.predicts]
        for d in [*(described(s, c, own) for c in near), *filters, *stages]:
            found.append((m.loudness * (d.predicts - PER_NUMBER * len(d.numbers)), d, s))
    found.sort(key=lambda f: -f[0])
    best = [*((d, s) for _, d, s in found[: selection.most]), *_actuator_lags(measured, machine)]
    return [ProposedLaw(d, s, setting) for d, s in best if (setting := start_of(d, axis, machine)) is not None]


def _actuator_lags(measured: Sequence[Measured], machine: Machine) -> list[tuple[Described, Samples]]:
    """A lag of an actuator that acts at once in the model, starting at a quarter of the speed cycle or more."""
    least = LEAST_LAG * machine.speed_cycle
    return [
        (replace(d, numbers={name: max(value, least) for name, value in d.numbers.items()}), m.samples)
        for m in measured
        if m.samples.block == MECHANICS
        for d in m.filters
    ]


def start_of(law: Described, axis: str, machine: Machine) -> Setting | None:
    """A measured law as a setting; None if a number is out of the bounds of its shape. The length of a play is its height, which is measured better."""
    table = law.table(axis)
    if law.relation.variable == "slack" and "height" in table:
        table["length"] = abs(table["height"])
    try:
        return check_setting(table, machine, "a measured law")
    except InputError:
        return None


def label(d: Described) -> str:
    if d.shape is not None and SHAPES[d.shape].is_filter:
        return f"{d.shape} of the {d.relation.output}"
    return f"{d.relation.output} over {d.relation.variable}{f' of {d.relation.source}' if d.relation.source else ''}"
