"""Starts of each effect: a few settings per effect and axis, from usual sizes and from spectra of the residual.

A start is simulated once. Its size is then scaled linearly; effects with a phase are combined from sine and cosine.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import itertools
import math

import numpy as np

from twin.diagnose.observe import Group
from twin.diagnose.start_values import StartValues
from twin.effects import EFFECTS, Effect, Setting
from twin.effects.effect import Parameter
from twin.effects.setting import Key
from twin.machine.machine import Axis, Machine


@dataclass(frozen=True)
class Start:
    """Settings to simulate: a single one, or a sine and a cosine of the same effect."""

    settings: tuple[Setting, ...]

    @property
    def effect(self) -> Effect:
        return self.settings[0].effect

    @property
    def axis(self) -> str:
        return self.settings[0].axis

    @property
    def key(self) -> Key:
        """Identity of the candidate."""
        return self.settings[0].key


def starts_of(group: Group, residual: np.ndarray) -> list[Start]:
    """All starts of all effects on the axes of a group; `residual` (row,) weighted, for the spectra."""
    starts, machine = [], group.machine
    for name in group.axes:
        axis = machine.axis(name)
        read = StartValues(group, axis, residual)
        for effect in EFFECTS.values():
            for source in effect.sources(machine, name):
                starts += [start_at(effect, machine, axis, source, values) for values in _values(effect, machine, axis, read)]
    return starts


def middle_starts(starts: Sequence[Start]) -> dict[Key, Start]:
    """One start per effect and axis: the middle one of its sizes and shapes."""
    keys = dict.fromkeys(s.key for s in starts)
    return {key: (same := [s for s in starts if s.key == key])[len(same) // 2] for key in keys}


def start_at(effect: Effect, machine: Machine, axis: Axis, source: str | None, values: dict[str, float]) -> Start:
    """The start with these values; shape parameters at their defaults."""
    shaped = {p.name: p.default for p in effect.parameters if p.default is not None}
    shaped |= {p.name: p.fitted(machine, axis, {**shaped, **values}) for p in effect.parameters if p.fitted is not None}
    settings = [Setting(effect, axis.name, {**shaped, **values}, source)]
    if phase := effect.phase:
        settings = [Setting(effect, axis.name, {**shaped, **values, phase.name: angle}, source) for angle in (0.0, math.pi / 2)]
    return Start(tuple(settings))


def _values(effect: Effect, machine: Machine, axis: Axis, read: StartValues) -> list[dict[str, float]]:
    """Starting values of the parameters, except shape parameters."""
    choices: list[list[tuple[str, float]]] = []
    size = effect.size
    for p in effect.parameters:
        if p.shape and p is not size:
            continue
        low, high = p.usual_range(machine, axis)
        if p.scan:
            values = read.of(p)
        elif p is size and p.is_scaled:  # a usual size of nothing, such as a share of no friction, starts nowhere
            values = [v for v in _sizes(p, low, high) if p.deviation(v) > 0.0]
        elif p.periodic:
            values = [i * math.pi / 3 for i in range(6)]
        elif p.logarithmic:
            values = list(np.geomspace(low / 1.5, high * 1.5, 5)) if p is size else list(np.geomspace(low, high, 3))
        else:
            values = [0.5 * (low + high)]
        choices.append([(p.name, float(v)) for v in values])
    return [dict(combination) for combination in itertools.product(*choices)]


def _sizes(p: Parameter, low: float, high: float) -> list[float]:
    """Starting sizes: one usual size, or as many as the parameter specifies; a factor is tried on both sides of 1 if both are usual."""
    neutral = p.neutral or 0.0
    if low < neutral < high:
        ends = [low, high] if p.is_factor else [high, low] if p.starts > 1 else [high]
        return [neutral + 0.5 * (end - neutral) for end in ends]
    if p.logarithmic and not p.is_factor:
        return [float(v) for v in np.geomspace(low, high, p.starts)] if p.starts > 1 else [math.sqrt(low * high)]
    return [0.5 * (low + high)]


def softened(start: Start, machine: Machine, share: float) -> Setting:
    """The setting of a spring with `share` times the compliance of the start; parameters that depend on the stiffness follow."""
    first = start.settings[0]
    fitted = {p.name for p in start.effect.parameters if p.fitted is not None}
    values = {name: value for name, value in first.parameters.items() if name not in fitted}
    values[start.effect.size.name] /= share
    return start_at(start.effect, machine, machine.axis(first.axis), first.from_axis, values).settings[0]


def combine(start: Start, sizes: Sequence[float], machine: Machine) -> Setting:
    """The setting that a linear combination of the start's responses represents: `sizes` multiply the deviation from neutral.

    For a lag they multiply the delay.
    """
    first = start.settings[0]
    size = start.effect.size
    neutral = size.neutral or 0.0
    deviation = first.parameters[size.name] - neutral
    if len(sizes) == 2:
        phase = start.effect.phase
        assert phase is not None
        # c1 sin(x) + c2 sin(x + pi/2) = amplitude sin(x + phase)
        amplitude, angle = math.hypot(*sizes), math.atan2(sizes[1], sizes[0])
        values = {size.name: neutral + amplitude * deviation, phase.name: angle % (2 * math.pi)}
    elif size.lag_cycle:
        cycle = getattr(machine, size.lag_cycle)
        delay = sizes[0] * cycle / math.expm1(cycle / deviation)
        values = {size.name: cycle / math.log1p(cycle / delay)}
    else:
        values = {size.name: neutral + sizes[0] * deviation}
    return Setting(start.effect, first.axis, {**first.parameters, **values}, first.from_axis)
