"""Add effects to a machine, in the notation of the command line."""

from __future__ import annotations

from twin.effects.change import with_effects
from twin.effects.setting import Setting, parse_setting, settings_of
from twin.machine.machine import Machine


def add_effects(machine: Machine, *effects: str | Setting) -> Machine:
    """The machine with these effects in addition to its own.

    Each is 'NAME:AXIS:PARAMETER=VALUE[,PARAMETER=VALUE]' as after `--effect`, or a Setting. A value is in SI or has its unit:
    'backlash:X:clearance=15e-6', 'backlash:X:clearance=15um'.
    Raises InputError for an unknown name, axis or parameter, a value out of bounds, or a duplicate effect on an axis.
    """
    settings = [parse_setting(effect, machine) if isinstance(effect, str) else effect for effect in effects]
    changed = with_effects(machine, [*settings_of(machine), *settings])
    settings_of(changed)
    return changed
