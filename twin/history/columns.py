"""Unit effects: the directions in which a machine can change, each at a usual size.

A change of size is a multiple theta of a unit effect: d parameter = theta x unit. For a spring it is its compliance that is multiplied. A
sinusoidal effect has two directions, sine and cosine; an effect whose wave is unknown has directions at several of its usual ones. Effects
without a small size (a limit that is reached or not) and waves locked to time have no direction: `NOT_WATCHED`.
"""

from __future__ import annotations

from dataclasses import dataclass
import itertools
import math

import numpy as np

from twin.diagnose.candidates import start_at
from twin.effects import EFFECTS, Effect, Setting
from twin.effects.effect import Parameter
from twin.effects.scan import InTime
from twin.machine.machine import Axis, Machine

WAVES = 5
"""Wavelengths or frequencies of an effect whose own one is not known."""


@dataclass(frozen=True)
class Direction:
    """A unit effect; `phase` is 1 for the cosine of a sinusoidal effect, `unit` the deviation of its size from neutral [SI]."""

    setting: Setting
    phase: int
    unit: float

    @property
    def cause(self) -> tuple[str, str, str]:
        """Effect, axis and source axis: what a change is named by."""
        return self.setting.effect.name, self.setting.axis, self.setting.from_axis or ""

    @property
    def wave(self) -> tuple[tuple[str, float], ...]:
        """Parameters besides size and phase: sine and cosine of one wave have the same."""
        effect = self.setting.effect
        own = {effect.size.name, effect.phase.name if effect.phase else "", *(p.name for p in effect.parameters if p.periodic)}
        return tuple((name, value) for name, value in self.setting.parameters.items() if name not in own)

    @property
    def name(self) -> str:
        """A text that identifies the direction."""
        wave = ",".join(f"{name}={value:.6g}" for name, value in self.wave if self.setting.effect.parameter(name).fitted is None)
        return " ".join(filter(None, [*self.cause, wave, "cosine" if self.phase else ""]))


def directions_of(machine: Machine, axes: tuple[str, ...]) -> list[Direction]:
    """The directions of these axes."""
    found = []
    for name, effect in itertools.product(axes, EFFECTS.values()):
        axis = machine.axis(name)
        if axis not in effect.axes(machine) or not is_watched(effect):
            continue
        sources = [a.name for a in effect.axes(machine) if a.name != name] if effect.from_axis else [None]
        for source, values in itertools.product(sources, _values(effect, machine, axis)):
            settings = start_at(effect, machine, axis, source, values).settings
            if turned := next((p for p in effect.parameters if p.periodic and not p.shape), None):  # an angle: its two components
                settings = tuple(start_at(effect, machine, axis, source, {**values, turned.name: a}).settings[0] for a in (0.0, math.pi / 2))
            unit = values[effect.size.name] - (effect.size.neutral or 0.0) if effect.size.is_scaled else values[effect.size.name]
            found += [Direction(s, phase, unit) for phase, s in enumerate(settings)]
    return found


def is_watched(effect: Effect) -> bool:
    """Does an effect have a size whose small change changes the motion in proportion, in the same way in each recording?"""
    sized = effect.size.is_scaled or effect.size.is_spring
    return sized and not any(isinstance(p.scan, InTime) for p in effect.parameters)


def _values(effect: Effect, machine: Machine, axis: Axis) -> list[dict[str, float]]:
    """Values at a usual size: one for each wave that the effect may have."""
    choices = []
    for p in effect.parameters:
        if p.shape and p is not effect.size:
            continue
        choices.append([(p.name, value) for value in _value(p, p is effect.size, *p.usual_range(machine, axis))])
    return [dict(combination) for combination in itertools.product(*choices)]


def _value(p: Parameter, is_size: bool, low: float, high: float) -> list[float]:
    neutral = p.neutral or 0.0
    if is_size and p.is_scaled:
        end = high if abs(high - neutral) >= abs(low - neutral) or low >= neutral else low
        near = low if low >= neutral or high <= neutral else neutral
        return [0.5 * (near + end)] if near != end else [end]
    if p.periodic:
        return [0.0]
    if p.scan is None:
        return [math.sqrt(low * high) if p.logarithmic else 0.5 * (low + high)]
    if p.quantity == "number":  # periods in a turn
        return [float(n) for n in range(math.ceil(low), math.floor(high) + 1)]
    return np.geomspace(low, high, WAVES).tolist()
