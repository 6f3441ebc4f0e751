"""All blocks that a machine file may list: importing this module fills `block.BLOCKS`. One name here for each file."""

from twin.control import (  # noqa: F401
    backlash_value,
    friction_pulse,
    pid,
    position_correction,
    set_point_filters,
    speed_set_point_filters,
    stepper,
)
from twin.control.block import BLOCKS as BLOCKS
