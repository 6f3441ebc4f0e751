"""All blocks that a machine file may list: importing this module fills `block.BLOCKS`. One line here for each file."""

from twin.control import friction_pulse, set_point_filters
from twin.control.block import BLOCKS

__all__ = ["BLOCKS", "friction_pulse", "set_point_filters"]
