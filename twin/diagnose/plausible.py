"""Which effects are believed: sizes that are found on machines and are more than their normal spread, in blocks that are not clean."""

from __future__ import annotations

import math

from twin.diagnose.candidates import Start, size_parameter
from twin.diagnose.observe import Group
from twin.diagnose.state import SHOWS_IN, Found
from twin.diagnose.tolerance import NORMAL, UNIFORM
from twin.effects import Parameter, Setting
from twin.effects.change import load_inertia
from twin.effects.mechanics import upward
from twin.machine.machine import Axis, Machine

SMALLEST, LARGEST = 0.12, 4.0
"""Sizes, as multiples of the usual range's lower and upper end, beyond which an effect is not believed."""

BEYOND_TOLERANCE = {"torque_constant": 2.0, "inertia": 2.0, "constant_force": 3.0, "coulomb_friction": 3.0, "viscous_friction": 4.0}
"""Multiples of the tolerance from which a deviation is an effect: friction is what slip, lubrication and load change first; a constant force
is held against the weight that its axis carries."""

IMITATED = 5.0
"""Multiple of the tolerance up to which inertia is not believed on an axis whose drive train gives a little."""


def is_ruled_out(group: Group, start: Start) -> bool:
    """An effect that must show in a cut channel which is clean on its axis: the block's own law holds, whatever else is wrong."""
    channel = SHOWS_IN.get(start.effect.block)
    mine = [c for c in group.channels if c.axis == start.axis and c.name == channel]
    return bool(mine) and all(c.is_clean for c in mine)


def is_plausible(setting: Setting, machine: Machine) -> bool:
    """Is the size one that is found on machines, and more than their normal spread?"""
    axis = machine.axis(setting.axis)
    size = size_parameter(setting.effect)
    value = setting.parameters[size.name]
    low, high = size.usual_range(machine, axis)
    neutral = size.neutral or 0.0
    if size.name == "factor":
        deviation = abs(value - neutral)
        least = min(abs(v - neutral) for v in (low, high)) if not low < neutral < high else 0.5 * min(neutral - low, high - neutral)
        return deviation > max(SMALLEST * least, BEYOND_TOLERANCE.get(setting.effect.name, 0.0) * machine.parameter_tolerance)
    if not math.isfinite(neutral):  # springs and limits: the softer, the larger
        if size.name == "limit_a":
            return True
        return low / LARGEST <= value <= high / SMALLEST
    if low < neutral < high:
        least = SMALLEST * 0.3 * min(neutral - low, high - neutral)
        if setting.effect.name == "constant_force":
            least = max(least, BEYOND_TOLERANCE["constant_force"] * machine.parameter_tolerance * weight_of(machine, axis))
        return abs(value - neutral) > least
    if setting.effect.name == "table_unbalance":  # what gravity tells is mass times radius; how it is shared out, little
        radius = setting.effect.parameter("radius_m")
        inner, outer = radius.usual_range(machine, axis)
        value, low, high = value * setting.parameters[radius.name], low * inner, high * outer
    if setting.effect.name == "inertia":
        return _share_of_inertia(setting, machine) > BEYOND_TOLERANCE["inertia"] * machine.parameter_tolerance
    return SMALLEST * low < abs(value) < LARGEST * high


def normal_spread(setting: Setting, parameter: Parameter, machine: Machine) -> float:
    """Standard deviation that the tolerance gives to the size of an effect which changes a toleranced parameter, 0 to that of any other.

    A friction of 1.30 times the nominal is one of 1.29 times that of a machine whose own is 1 % higher: no measurement parts these.
    """
    if setting.effect.name not in BEYOND_TOLERANCE or parameter is not size_parameter(setting.effect):
        return 0.0
    whole = setting.parameters[parameter.name]
    if setting.effect.name == "inertia":
        whole /= max(_share_of_inertia(setting, machine), 1e-12)
    if setting.effect.name == "constant_force":
        whole = weight_of(machine, machine.axis(setting.axis))
    return machine.parameter_tolerance * float(UNIFORM) * abs(whole)


def is_imitated(found: Found, setting: Setting, machine: Machine) -> bool:
    """A little inertia on an axis whose drive train gives: mass on the load side and a softer spring look alike."""
    gives = any(n.owner == setting.axis and NORMAL.get(n.quantity) == "transmission_compliance" for n in found.tuning.nuisances)
    return setting.effect.name == "inertia" and gives and _share_of_inertia(setting, machine) < IMITATED * machine.parameter_tolerance


def weight_of(machine: Machine, axis: Axis) -> float:
    """Weight that a linear axis holds [N]: what its mass differs by is a constant force of that share."""
    return (axis.moving_mass_kg or 0.0) * machine.gravity * abs(upward(machine, axis)) if axis.kind == "linear" else 0.0


def _share_of_inertia(setting: Setting, machine: Machine) -> float:
    """Added inertia as a share of all that the axis moves."""
    axis = machine.axis(setting.axis)
    return abs(setting.parameters["added"]) / max(load_inertia(machine, axis) + axis.reflected_inertia, 1e-12)
