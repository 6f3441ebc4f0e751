"""What an identification hands on: parameters with their doubts, findings, the machine, gaps."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from twin.identify.direct import Direct
from twin.identify.findings import ChannelSkew, Finding
from twin.machine.machine import Machine


@dataclass(frozen=True)
class Range:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def half(self) -> float:
        """Half width."""
        return 0.5 * (self.high - self.low)

    def holds(self, value: float) -> bool:
        """Does the interval hold this value?"""
        return bool(self.low <= value <= self.high)


@dataclass(frozen=True)
class Parameter:
    """One identified number.

    `estimate` is what the regression found; with `product` it stands for value x (file's Kt / true Kt). `value` is what the machine file
    gets after products are split; `held_out` the same regression on the runs left out; `refined` the re-simulated one.
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
    held_out: Range | None = None
    refined: Range | None = None


@dataclass(frozen=True)
class Identification:
    """Everything about one campaign: the machine before and after, parameters, direct fits of training runs, and gaps on runs left out."""

    before: Machine
    machine: Machine
    parameters: tuple[Parameter, ...]
    findings: tuple[Finding, ...]
    skews: tuple[ChannelSkew, ...]
    direct: Direct
    training: tuple[str, ...]
    held_out: tuple[str, ...]
    campaign: str
    tolerance_holds: dict[str, bool]
    gaps: dict[str, Any] = field(default_factory=dict)  # 'before', 'regression', 'refined' -> axis -> signal -> {rms, noise, unit}
    seconds: dict[str, float] = field(default_factory=dict)
    chosen: str = "regression"
    refused: str = ""  # why no machine file is to be written
    stage_of: dict[str, str] | None = None  # axis -> stage that was taken; None: `chosen` for all; an axis that is missing keeps its file
    notes: tuple[Finding, ...] = ()  # what was found besides parameters

    def taken(self, p: Parameter) -> Range | None:
        """The range of a parameter that the machine file gets; None where the axis keeps the number of the file before."""
        stage = self.chosen if self.stage_of is None else self.stage_of.get(p.axis, "")
        control = p.name.endswith(("delay_s", "gain_per_s", "velocity_feedforward"))
        if stage == "refined" and p.refined is not None:
            return p.refined
        return p.value if stage in ("refined", "regression") or (stage == "control" and control) else None

    def parameter(self, axis: str, name: str) -> Parameter:
        """The parameter of that axis and name."""
        return next(p for p in self.parameters if (p.axis, p.name) == (axis, name))
