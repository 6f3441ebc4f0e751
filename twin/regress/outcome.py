"""The result of a case: trace (if it has one), events, and numbers and words by name."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin.documents import flat
from twin.errors import InputError
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.regress.suite import SIGNAL_UNITS
from twin.replay.events import Event

Value = float | str
"""A number, or a word that must not change."""


@dataclass(frozen=True)
class Feature:
    """A number with its unit, or a word; `axis` and `block` it belongs to ('' for none)."""

    value: Value
    unit: str = ""
    axis: str = ""
    block: str = ""
    noise: float = 0.0  # for a gap: that of the measuring noise alone; for a parameter: half its interval


@dataclass(frozen=True)
class Outcome:
    """Result of a case; `failed` is the reason why a simulation was aborted ('' if it was not)."""

    features: Mapping[str, Feature]
    trace: Trace | None = None
    events: tuple[Event, ...] = ()
    machine: Machine | None = field(default=None, repr=False)
    failed: str = ""


def kept_trace(trace: Trace, every_s: float) -> Trace:
    """The stored signals of a trace, sampled every `every_s`."""
    every = max(1, round(every_s / trace.period))
    if every >= len(trace.time):
        raise InputError(f"keep_every_ms = {every_s * 1e3:g} keeps one sample of a run of {trace.time[-1]:.4g} s; keep more")
    signals = {key: np.asarray(values, float) for key, values in trace.signals.items() if key[1] in SIGNAL_UNITS}
    return replace(trace, signals=signals).decimated(every)


def values_of(content: Any) -> dict[str, Value]:
    """Numbers and words of nested tables and lists by path 'a.b.0'."""
    return {path: str(v) if isinstance(v, bool | str) or v is None else float(v) for path, v in flat(content).items()}
