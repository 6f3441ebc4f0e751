"""What one case gives: a trace (where it has one), events, and numbers and words by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.regress.suite import SIGNAL_UNITS
from twin.replay.events import Event

Value = float | str
"""A number, or a word that must stay the same."""


@dataclass(frozen=True)
class Feature:
    """A number with its unit, or a word; `axis` and `block` say whose it is ('' where it belongs to none)."""

    value: Value
    unit: str = ""
    axis: str = ""
    block: str = ""
    noise: float = 0.0  # of a gap: what measuring noise alone makes; of a parameter: half its interval


@dataclass(frozen=True)
class Outcome:
    """Result of a case; `failed` is the reason why a simulation stopped before its end ('' where it did not)."""

    features: Mapping[str, Feature]
    trace: Trace | None = None
    events: tuple[Event, ...] = ()
    machine: Machine | None = field(default=None, repr=False)
    failed: str = ""


def kept_trace(trace: Trace, every_s: float) -> Trace:
    """The signals that are kept, each `every_s`."""
    every = max(1, round(every_s / trace.period))
    if every >= len(trace.time):
        raise InputError(f"keep_every_ms = {every_s * 1e3:g} keeps one sample of a run of {trace.time[-1]:.4g} s; keep more")
    signals = {key: np.asarray(values, float) for key, values in trace.signals.items() if key[1] in SIGNAL_UNITS}
    return replace(trace, signals=signals).decimated(every)


def flat(prefix: str, content: Any, out: dict[str, Value]) -> dict[str, Value]:
    """Nested tables and lists as one table of numbers and words, 'a.b.0' -> value."""
    if isinstance(content, Mapping):
        for key, value in content.items():
            flat(f"{prefix}.{key}" if prefix else str(key), value, out)
    elif isinstance(content, list | tuple):
        for i, value in enumerate(content):
            flat(f"{prefix}.{i}", value, out)
    elif isinstance(content, bool | str) or content is None:
        out[prefix] = str(content)
    else:
        out[prefix] = float(content)
    return out
