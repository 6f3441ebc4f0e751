"""Compares an outcome with its golden result: RMS and largest difference of each signal, events, numbers."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
import math

import numpy as np

from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.regress.golden import Golden, Outcome
from twin.regress.suite import KINDS, Case
from twin.replay.events import Event
from twin.simulation.gap import gap_unit

TIME_TOLERANCE_S = 1e-9
"""Largest difference between stored and new sample times, for the rounding of the file."""


@dataclass(frozen=True)
class Check:
    """One compared quantity: difference `found` against `allowed` in `unit`; `golden` and `now` are the two values, if there are any.

    `since_s` is the time when a signal first exceeds its largest allowed difference (None: never, or not applicable).
    """

    quantity: str
    axis: str
    unit: str
    found: float
    allowed: float
    golden: float | str | None = None
    now: float | str | None = None
    block: str = ""
    since_s: float | None = None

    @property
    def ok(self) -> bool:
        return self.found <= self.allowed

    @property
    def excess(self) -> float:
        """Difference over tolerance."""
        return self.found / self.allowed if self.allowed > 0 else (0.0 if self.found == 0 else math.inf)

    @property
    def text(self) -> str:
        """The check as a phrase for messages."""
        if isinstance(self.golden, str) or isinstance(self.now, str):
            return f"{self.quantity}: {self.golden} before, {self.now} now"
        if self.golden is not None and self.now is not None:
            text = f"{self.quantity}: {self.golden:.6g} before, {self.now:.6g} now {self.unit}".rstrip()
            return f"{text} (allowed to differ by {self.allowed:.2g})"
        return f"{self.quantity} {self.found:.4g} {self.unit} (allowed {self.allowed:.4g})"


def compare(case: Case, golden: Golden, outcome: Outcome) -> list[Check]:
    """All checks of a case, in the order signals, events, numbers."""
    stopped = outcome.failed
    checks = [Check("simulation reaches its end", _axis_in(outcome), "", 1.0, 0.0, "yes", stopped)] if stopped else []
    if golden.trace is not None and outcome.trace is not None and outcome.machine is not None:
        checks += _signals(case, golden.trace, outcome.trace, outcome.machine)
        checks += _events(case, golden.events, outcome.events) if not stopped else ()
    return checks if stopped else [*checks, *_numbers(case, golden, outcome)]


def common(golden: Trace, now: Trace) -> tuple[Trace, Trace, bool]:
    """Both traces on their common golden samples, and whether they have the same duration to within a stored sample."""
    every = max(1, round(golden.period / now.period))
    thin = now.decimated(every)
    count = min(len(thin.time), len(golden.time))
    same = len(thin.time) == len(golden.time) and bool(np.all(np.abs(thin.time[:count] - golden.time[:count]) < TIME_TOLERANCE_S))
    return golden.samples(slice(count)), thin.samples(slice(count)), same


def _signals(case: Case, golden: Trace, now: Trace, machine: Machine) -> Iterator[Check]:
    before, after, same = common(golden, now)
    length, new_length = float(golden.time[-1]), float(now.time[-1])
    yield Check("duration", "", "s", 0.0 if same else abs(new_length - length) or math.inf, 0.0, length, new_length, "set points")
    for axis in before.axes:
        if axis not in machine.axis_names:
            yield Check(f"axis {axis} is driven", axis, "", 1.0, 0.0, "yes", "no")
            continue
        for signal in case.compared:
            recorded = [trace.has(axis, signal) for trace in (before, after)]
            if not all(recorded):
                if any(recorded):  # if neither has it, the axis has no such signal
                    first, then = ("yes" if has else "no" for has in recorded)
                    yield Check(f"{axis}.{signal} is recorded", axis, "", 1.0, 0.0, first, then)
                continue
            tolerance = case.tolerance[signal]
            unit, factor = gap_unit(machine.axis(axis), signal)
            difference = (after.get(axis, signal) - before.get(axis, signal)) * factor
            beyond = np.flatnonzero(~(np.abs(difference) <= tolerance["max"]))
            since = float(before.time[beyond[0]]) if beyond.size else None
            block = "set points" if signal == "setpoint" else ""
            largest = float(np.nan_to_num(np.abs(difference), nan=math.inf).max())
            rms = float(np.sqrt(np.mean(difference**2))) if math.isfinite(largest) else math.inf
            yield Check(f"{axis}.{signal} RMS", axis, unit, rms, tolerance["rms"], block=block, since_s=since)
            yield Check(f"{axis}.{signal} max", axis, unit, largest, tolerance["max"], block=block, since_s=since)


def _events(case: Case, golden: tuple[Event, ...], now: tuple[Event, ...]) -> Iterator[Check]:
    """Each kind of event of each axis: equal count and times; for blocks also equal order."""
    tolerance = case.tolerance["events"]["time_s"]
    for kind, axis in sorted({(event.kind, event.axis) for event in (*golden, *now)}):
        b, a = ([event for event in of if (event.kind, event.axis) == (kind, axis)] for of in (golden, now))
        name = f"{axis + '.' if axis else ''}{kind}"
        block = "set points" if kind in ("reversal", "block") else ""
        if len(b) != len(a):
            since = next((min(x.start, y.start) for x, y in zip(b, a) if abs(x.start - y.start) > tolerance), None)
            yield Check(f"{name} events", axis, "", abs(len(a) - len(b)), 0.0, float(len(b)), float(len(a)), block, since)
            continue
        late = max(abs(x.start - y.start) for x, y in zip(b, a))
        yield Check(f"{name} time", axis, "s", late, tolerance, block=block)
        if kind == "block":
            swapped = Counter(x.text == y.text for x, y in zip(b, a))[False]
            yield Check("order of blocks", "", "blocks", float(swapped), 0.0, block=block)


def uncompared(golden: Golden, now: Golden) -> list[str]:
    """Names of new numbers without a golden value: they are reported, but do not fail."""
    return [name for name in now.features if name not in golden.features]


def _numbers(case: Case, golden: Golden, outcome: Outcome) -> Iterator[Check]:
    """Words must be equal, none may vanish; numbers keep the tolerance of their quantity:

    summary      |now - golden| <= absolute + relative |golden|
    parameters   |now - golden| <= relative |golden| + of_interval times half the interval
    gap           now - golden  <= growth golden + above_noise times the noise alone: it may shrink
    """
    _, _, (quantity, *_) = KINDS[case.kind]
    tolerance = case.tolerance[quantity]
    for name, before in golden.features.items():
        after = outcome.features.get(name)
        if after is None or isinstance(before.value, str) or isinstance(after.value, str):
            now = str(after.value) if after else "missing"
            yield Check(name, before.axis, before.unit, float(now != str(before.value)), 0.0, str(before.value), now, before.block)
            continue
        change = after.value - before.value
        if case.kind == "campaign":
            found, allowed = max(change, 0.0), tolerance["growth"] * before.value + tolerance["above_noise"] * before.noise
        else:
            of_interval = tolerance.get("of_interval", 0.0) * before.noise
            found, allowed = abs(change), tolerance.get("absolute", 0.0) + tolerance["relative"] * abs(before.value) + of_interval
        yield Check(name, before.axis, before.unit, found, allowed, before.value, after.value, before.block)


def _axis_in(outcome: Outcome) -> str:
    """The axis in the message of an aborted simulation."""
    words = outcome.failed.replace(":", " ").split()
    names = outcome.machine.axis_names if outcome.machine else ()
    return next((b for a, b in pairwise(words) if a == "axis" and b in names), "")
