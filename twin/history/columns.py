"""Unit effects: every way that a machine can change, each at a usual size.

A change of size is a multiple theta of a unit effect: d parameter = theta x unit. For a spring it is its compliance that is multiplied. A
sinusoidal effect has two directions, sine and cosine; an effect whose wave is unknown has directions at several of its usual ones. Effects
without a small size (a limit that is reached or not) and waves locked to time have no direction: `NOT_WATCHED`.
"""

import cmath
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
import functools
import itertools
import math

import numpy as np

from twin.diagnose.starts import start_at
from twin.effects import EFFECTS, Effect, Setting, settings_of, with_effects
from twin.effects.effect import Parameter
from twin.machine.machine import Axis, Machine

WAVES = 5
"""Wavelengths, frequencies or speeds of an effect whose own one is not known."""


@dataclass(frozen=True)
class Direction:
    """A unit effect; `phase` is 1 for the cosine of a sinusoidal effect, `unit` the deviation of its size from neutral [SI], `most` the largest usual
    size in units, `least` the smallest change in units: no machine has less than no backlash.
    """

    setting: Setting
    phase: int
    unit: float
    most: float
    least: float = -math.inf

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
        return " ".join(filter(None, [*self.cause, wave, ("", "cosine", "opposite")[self.phase]]))


def directions_of(machine: Machine, axes: tuple[str, ...]) -> list[Direction]:
    """The directions of these axes."""
    found = []
    own = {s.key: s for s in settings_of(machine)}
    for name, effect in itertools.product(axes, filter(is_watched, EFFECTS.values())):
        axis = machine.axis(name)
        for source in effect.sources(machine, name):
            has = own.get((effect.key, name, source))
            turned = next((p.name for p in effect.parameters if p.periodic and not p.shape), None)
            for values in _values(effect, machine, axis, has):
                start = functools.partial(start_at, effect, machine, axis, source)
                settings = start(values).settings
                if turned is not None:  # at an angle: its two components, and its mass
                    settings = tuple(start({**values, turned: angle}).settings[0] for angle in (0.0, math.pi / 2, math.pi))
                unit = values[effect.size.name] - (effect.size.neutral or 0.0) if effect.size.is_scaled else values[effect.size.name]
                low, high = effect.size.usual_range(machine, axis)
                most = max(abs(end - (effect.size.neutral or 0.0)) for end in (low, high)) / abs(unit)
                most = unit / low if effect.size.is_spring else most
                found += [Direction(s, phase, unit, most, _least(effect, has, unit)) for phase, s in enumerate(settings)]
    return found


def _least(effect: Effect, own: Setting | None, unit: float) -> float:
    """The smallest change of the size of an effect [units], beside the one that the machine has."""
    size = effect.size
    if effect.phase or any(p.periodic for p in effect.parameters):
        return -math.inf
    if size.is_spring:
        return -unit / own.size if own else 0.0
    now = own.size if own else size.neutral or 0.0
    end = size.low if unit > 0.0 else size.high
    return (end / now - 1.0) / unit if size.is_factor else (end - now) / unit


def is_watched(effect: Effect) -> bool:
    """Does an effect have a size whose small change changes the motion in proportion, in the same way in each recording?"""
    sized = effect.size.is_scaled or effect.size.is_spring
    return sized and not any(p.scan == "time" for p in effect.parameters)


def _values(effect: Effect, machine: Machine, axis: Axis, own: Setting | None) -> list[dict[str, float]]:
    """Values at a usual size: one for each wave that the effect may have, or the wave that it has."""
    choices = []
    for p in effect.parameters:
        if p.shape and p is not effect.size:
            continue
        if own is not None and p is not effect.size and not p.periodic:
            choices.append([(p.name, own.parameters[p.name])])
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
    if not p.scan and (is_size or not p.logarithmic):
        return [math.sqrt(low * high) if p.logarithmic else 0.5 * (low + high)]
    if p.quantity == "number":  # periods in a turn
        return [float(n) for n in range(math.ceil(low), math.floor(high) + 1)]
    return np.geomspace(low, high, WAVES).tolist()


def waves_of(directions: Sequence[Direction], at: Iterable[int]) -> list[list[int]]:
    """The directions `at` these places by cause and wave: sine and cosine together."""
    found: dict[tuple[object, ...], list[int]] = {}
    for k in at:
        found.setdefault((directions[k].cause, directions[k].wave), []).append(k)
    return list(found.values())


def amplitude(theta: Sequence[float] | np.ndarray) -> float:
    """Size of a change along one direction, along sine and cosine, or of masses at 0, 90 and 180 degrees."""
    if len(theta) == 3:
        return float(np.hypot(theta[0] - theta[2], theta[1]))
    return float(np.linalg.norm(theta)) if len(theta) > 1 else float(theta[0])


def changed(machine: Machine, changes: Sequence[tuple[Direction, float]]) -> Machine:
    """The machine with each direction changed by `theta` usual sizes, next to the effects that it has; an effect that falls to nothing goes.

    Two amounts of an effect add up, factors multiply, springs act in series, waves of one kind add up as phasors.
    """
    settings = {s.key: s for s in settings_of(machine)}
    for direction, theta in changes:
        new, own = direction.setting, settings.get(direction.setting.key)
        if own is None:
            softened = [s for s in settings.values() if s.axis == new.axis and s.effect.name in new.effect.contains]
            kept = {f"contact_{name}": s.parameters[name] for s in softened for name in ("stiffness", "damping") if name in s.parameters}
            new = replace(new, parameters={**new.parameters, **kept})  # a backlash closes on the spring that is there
            settings = {key: s for key, s in settings.items() if s not in softened}
        settings[new.key] = _moved(new, own, direction, theta)
        if settings[new.key].is_nil:
            del settings[new.key]
    return with_effects(machine, list(settings.values()))


def _moved(new: Setting, own: Setting | None, direction: Direction, theta: float) -> Setting:
    """`own` (None: absent) changed by theta usual sizes of a direction."""
    size, change = new.effect.size, theta * direction.unit
    if size.is_spring:
        compliance = theta / direction.unit + (1.0 / own.size if own else 0.0)
        moved = {size.name: 1.0 / compliance if compliance > 0.0 else math.inf}
    elif (angle := new.effect.phase or next((p for p in new.effect.parameters if p.periodic), None)) is not None:
        wave = change * cmath.exp(1j * new.parameters[angle.name])
        wave += own.size * cmath.exp(1j * own.parameters[angle.name]) if own else 0.0
        moved = {size.name: abs(wave), angle.name: cmath.phase(wave) % (2.0 * math.pi)}
    else:
        now = own.size if own else size.neutral or 0.0
        moved = {size.name: min(max(now * (1.0 + change) if size.is_factor else now + change, size.low), size.high)}
    return replace(own or new, parameters={**(own or new).parameters, **moved})
