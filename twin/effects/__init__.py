"""Effects: deviations of a machine from its nominal model, each a switch.

EFFECTS          all effects by name, found in the modules of this package and in the files that `--effects` gives
with_effects     a machine with these effects
parse_setting    an effect from the command line
apply_effects    the changes that the effects make, for `twin.simulation.run.simulate`
"""

import importlib
import pkgutil

from twin.effects.change import Change, apply_effects, load_inertia, with_effects
from twin.effects.control_blocks import add_effects_of_blocks
from twin.effects.effect import BLOCKS, EFFECTS, Effect, Parameter, find_effect
from twin.effects.setting import Setting, check_setting, parse_setting, settings_of
from twin.effects.user_files import load_from_environment

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
add_effects_of_blocks()
load_from_environment()

__all__ = [
    "BLOCKS",
    "EFFECTS",
    "Change",
    "Effect",
    "Parameter",
    "Setting",
    "apply_effects",
    "check_setting",
    "find_effect",
    "load_inertia",
    "parse_setting",
    "settings_of",
    "with_effects",
]
