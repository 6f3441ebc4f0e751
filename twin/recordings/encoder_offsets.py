"""Constant difference between the two encoders of an axis, which have no common zero."""

from collections.abc import Iterator, Mapping

import numpy as np

from twin.recordings.channels import Piece
from twin.recordings.trace import ENCODERS
from twin.units import AXIS_UNITS

SETTLED = 20
"""Samples that a set point rests before an axis stands."""
NEARER = 3.0
"""An encoder is clearly nearer to the set point than another one that is so many times as far."""

SMALL_OFFSET = 2e-6
"""Smallest constant difference between two encoders that is reported [m or rad]."""


def encoder_offset(encoders: Mapping[str, np.ndarray], setpoint: np.ndarray) -> tuple[str, float]:
    """The encoder that does not have the zero of the set point, and the median of its difference to the other one [m or rad]."""
    encoder = _further(encoders, setpoint)
    other = next(signal for signal in ENCODERS if signal != encoder)
    return encoder, float(np.median(encoders[encoder] - encoders[other]))


def _further(encoders: Mapping[str, np.ndarray], setpoint: np.ndarray) -> str:
    """The encoder that does not close the position loop: the motor encoder if the scale is clearly nearer to the set point at the end of its rests."""
    still = setpoint[SETTLED:-1] == setpoint[: -SETTLED - 1]
    ends = SETTLED + np.flatnonzero(still & (np.diff(setpoint)[SETTLED:] != 0.0))
    scale, motor = (float(np.abs(encoders[signal] - setpoint)[ends].sum()) for signal in ENCODERS)
    return "motor_position" if NEARER * scale < motor else "position"


def offset_notes(offsets: Mapping[tuple[Piece, str], tuple[str, float]], kinds: Mapping[str, str], centred: bool) -> Iterator[str]:
    """Notes on offsets above SMALL_OFFSET, one per axis."""
    for axis, kind in kinds.items():
        own = [(encoder, value) for (_, a), (encoder, value) in offsets.items() if a == axis]
        unit, factor = AXIS_UNITS[kind].error
        if own and max(abs(value) for _, value in own) > SMALL_OFFSET:
            shown = ", ".join(f"{value * factor:.4g}" for _, value in own[:3]) + (", ..." if len(own) > 3 else "")
            names = " and ".join(f"{axis}.{encoder}" for encoder in dict.fromkeys(encoder for encoder, _ in own))
            done = "removed" if centred else "left as it is"
            yield f"{names} differs from the other encoder by a constant {shown} {unit}; {done}"
