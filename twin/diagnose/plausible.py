"""Plausibility of effects: their size is found on machines and exceeds the normal spread, and their block is not healthy."""

import math

from twin.diagnose.observe import Group
from twin.diagnose.settings import T
from twin.diagnose.starts import Start
from twin.diagnose.state import SHOWS_IN
from twin.diagnose.tolerance import UNIFORM
from twin.effects import Parameter, Setting
from twin.machine.machine import Machine

CONTROL_BLOCKS = ("position controller", "speed controller")
"""Blocks whose law is set by parameters of the control."""


def is_ruled_out(group: Group, start: Start) -> bool:
    """True for an effect of a block that is isolated by a channel, if this channel is clean on its axis, and of a controller that nothing shows."""
    if start.axis in group.on_own_path and start.effect.block in CONTROL_BLOCKS:
        return True
    channel = SHOWS_IN.get(start.effect.block)
    mine = [c for c in group.channels if c.axis == start.axis and c.name == channel]
    return bool(mine) and all(c.is_clean for c in mine)


def is_plausible(setting: Setting, machine: Machine, isolated: bool = True) -> bool:
    """True for a size that is found on machines and exceeds their normal spread, with a shape near the usual ones.

    Sizes below the usual ones are plausible only in a block that the signals isolate (`isolated`).
    """
    axis, size, value = machine.axis(setting.axis), setting.effect.size, setting.size
    low, high = size.usual_range(machine, axis)
    if not _has_usual_shape(setting, machine):
        return False
    smallest = T.near_noise if isolated and setting.effect.block not in CONTROL_BLOCKS else T.remaining
    neutral = size.neutral or 0.0
    within = normal_deviation(setting, machine)
    if size.any_size:
        return not math.isfinite(neutral) or abs(value - neutral) > within
    if size.is_factor:
        least = min(abs(v - neutral) for v in (low, high)) if not low < neutral < high else 0.5 * min(neutral - low, high - neutral)
        return abs(value - neutral) > max(T.remaining * least, within)
    if not math.isfinite(neutral):  # a spring: the softer, the larger
        return low / T.largest_size <= value <= high / T.remaining
    if low < neutral < high:
        return abs(value - neutral) > max(smallest * 0.3 * min(neutral - low, high - neutral), within)
    if size.judged_with:
        other = setting.effect.parameter(size.judged_with)
        inner, outer = other.usual_range(machine, axis)
        value, low, high, smallest = value * setting.parameters[other.name], low * inner, high * outer, T.remaining
    return max(smallest * low, within) < abs(value) < T.largest_size * high


def normal_deviation(setting: Setting, machine: Machine) -> float:
    """Deviation of a size that is normal: what the tolerance of a parameter explains, or what every machine has; 0 if neither resembles the effect."""
    size = setting.effect.size
    if size.normal_size is not None:
        return size.normal_size(machine, machine.axis(setting.axis))
    if not size.beyond_tolerance or not (size.is_factor or size.part_of):
        return 0.0
    return (
        size.beyond_tolerance * machine.parameter_tolerance * (size.part_of(machine, machine.axis(setting.axis)) if size.part_of else 1.0)
    )


def _has_usual_shape(setting: Setting, machine: Machine) -> bool:
    """Are speeds, wavelengths and frequencies of an effect near the usual ones?"""
    effect, axis = setting.effect, machine.axis(setting.axis)
    for p in effect.parameters:
        if (
            p is effect.size
            or p.usual is None
            or p.periodic
            or p.fitted
            or p.name == effect.size.judged_with
            or p.name not in setting.parameters
        ):
            continue
        low, high = p.usual_range(machine, axis)
        if 0.0 < low <= high and not low / T.largest_size <= setting.parameters[p.name] <= T.largest_size * high:
            return False
    return True


def normal_spread(setting: Setting, parameter: Parameter, machine: Machine) -> float:
    """Standard deviation of the size of an effect due to the tolerance of the parameter that it changes; 0 for other parameters.

    A friction of 1.30 times the nominal equals 1.29 times that of a machine whose own friction is 1 % higher: no measurement separates them.
    """
    if parameter is not setting.effect.size or not parameter.beyond_tolerance:
        return 0.0
    whole = parameter.part_of(machine, machine.axis(setting.axis)) if parameter.part_of else setting.size
    return machine.parameter_tolerance * float(UNIFORM) * abs(whole)
