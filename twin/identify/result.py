"""The result of an identification: parameters with intervals, findings, the identified machine, gaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
import math
import re
from typing import Any

from scipy.special import ndtri

from twin.control.structures import POSITION_LOOP
from twin.estimate.regression import Range
from twin.identify.check_recording import Finding
from twin.identify.regressions import Regressions
from twin.machine.machine import Machine
from twin.recordings.skew import Skew
from twin.simulation.campaign_gap import AS_EXPECTED
from twin.units import in_words

IN_WORDS = {
    "moment_y": "first moment about {}, y", "moment_z": "first moment about {}, z", "table_x": "first moment of the table, x", "table_y": "first moment of the table, y",
    "unequal": "difference of second moments of the table", **{f"deviation_{p}": f"deviation moment {p} of the table" for p in ("xy", "zx", "zy")},
}  # fmt: skip


def words_of(name: str, axis: str) -> str:
    """A key of an axis in words, without the unit at its end."""
    return IN_WORDS[name].format(axis) if name in IN_WORDS else in_words(re.sub(r"_((nm|n|v|a)_)?(per_)?s(_per_(rad|m))?$", "", name))


@dataclass(frozen=True)
class Parameter:
    """One identified number.

    `estimate`: result of the regression; with `product` it equals value x (file's Kt / true Kt). `value`: after the split of the products.
    `refined`: result of the fit in closed loop.
    """

    axis: str
    name: str
    unit: str
    before: float
    estimate: Range
    value: Range
    product: bool
    condition: float
    at_bound: bool
    path: str = ""
    refined: Range | None = None

    def contains_before(self, among: int) -> bool:
        """Whether the file's value lies in an interval of this number that, as one of `among` numbers, holds jointly with 95 %."""
        wider = ndtri(1.0 - 0.025 / among) / ndtri(0.975)
        return any(abs(self.before - r.value) <= wider * r.half < math.inf for r in (self.estimate, self.value, self.refined) if r)


class Outcome(StrEnum):
    """What an identification did with a parameter."""

    WRITTEN = "identified"
    AGREES = "agrees with file"  # the file's value stays and lies in the interval
    REFUSED = "refused"  # held-out motion, or the loops, contradict the identified value; the file's stays


@dataclass(frozen=True)
class Identification:
    """Identification of one campaign: machine before and after, parameters, findings, direct fits, and gaps on held-out motion."""

    before: Machine
    machine: Machine
    parameters: tuple[Parameter, ...]
    findings: tuple[Finding, ...]
    skews: tuple[Skew, ...]
    direct: Regressions
    training: tuple[str, ...]
    held_out: tuple[str, ...]
    campaign: str
    tolerance_holds: dict[str, bool]
    gaps: dict[str, Any] = field(default_factory=dict)  # 'before', 'regression', 'refined' -> axis -> signal -> {rms, noise, unit}
    seconds: dict[str, float] = field(default_factory=dict)
    chosen: str = "regression"
    refused: str = ""  # why no machine file is to be written
    stage_of: Mapping[str, str] | None = None  # axis -> chosen stage; None: `chosen` for all; a missing axis keeps the file's values
    unscaled: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # axis -> signal -> unit whose scale nobody gave
    notes: tuple[Finding, ...] = ()  # further results that need no action

    def stage(self, axis: str) -> str:
        """The chosen stage of an axis; '' if it keeps the file's values."""
        return self.chosen if self.stage_of is None else self.stage_of.get(axis, "")

    def taken(self, p: Parameter) -> Range | None:
        """The range of a parameter as written to the machine file; None if the axis keeps the old value."""
        stage = self.stage(p.axis)
        control = p.name in POSITION_LOOP
        if stage == "refined" and p.refined is not None:
            return p.refined
        return p.value if stage in ("refined", "regression") or (stage == "control" and control) else None

    def outcome(self, p: Parameter) -> Outcome:
        """What became of a parameter."""
        if self.taken(p) is not None:
            return Outcome.WRITTEN
        among = sum(q.axis == p.axis for q in self.parameters)
        return Outcome.AGREES if p.contains_before(among) else Outcome.REFUSED

    def unexplained(self) -> dict[str, tuple[str, float]]:
        """Axis -> signal with its largest gap on held-out motion, and that over noise, where it is more than noise: the model lacks something there."""
        out = {}
        for axis, before in self.gaps.get("before", {}).items():
            after = self.gaps.get(self.stage(axis), {}).get(axis, before)
            ratios = {signal: own["rms"] / own["noise"] for signal, own in after.items() if own["noise"] > 0.0}
            if ratios and max(ratios.values()) > AS_EXPECTED:
                out[axis] = max(ratios.items(), key=lambda item: item[1])
        return out

    def parameter(self, axis: str, name: str) -> Parameter:
        """The parameter with this axis and name."""
        return next(p for p in self.parameters if (p.axis, p.name) == (axis, name))


def agreeing_axes(parameters: Sequence[Parameter]) -> set[str]:
    """Axes whose values in the file all lie in their identified intervals."""
    of = {axis: [p for p in parameters if p.axis == axis] for axis in {p.axis for p in parameters}}
    return {axis for axis, own in of.items() if all(p.contains_before(len(own)) for p in own)}
