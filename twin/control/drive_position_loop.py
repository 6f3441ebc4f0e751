"""Position loop that the drive closes (dynamic servo control, DSC; cyclic position of CiA 402).

The drive receives w*_NC and T_ff,NC of the NC with the delay Td and corrects w* for the motion since then, at every speed cycle:

    w*(T) = w*_NC(T - Td) - Kv (x(T) - x(T - Td)) / r,    T_ff(T) = T_ff,NC(T - Td)

It takes x at each speed cycle, while w*_NC holds x for a position cycle of m speed cycles, so the open loop is

    L(z) = Kv P(z) (1 - z^-(Td/Ts) (1 - (1 + z^-1 + ... + z^-(m-1)) / m))

which is exact except for aliasing by sampling at the position cycle. Td itself costs no phase in the loop. In cyclic position mode the drive gets
the set points themselves: the same law with position cycle = speed cycle and Td = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from twin.compiled_functions import compiled
from twin.control.linear import with_past
from twin.control.number import A_DELAY, Key, held, number, numbers_of


@dataclass(frozen=True, kw_only=True)
class DriveLoopNumbers:
    """Td: above 0 the drive closes the position loop and receives the NC's command this much later."""

    dsc_delay_s: float = number(
        Key(0.0, 1.0, required=False), held(sinumerik=("MD32644 STIFFNESS_DELAY_TIME", "s", 1.0)), absent=0.0, search=A_DELAY,
        shown=("loop closed in", "", lambda n: f"drive, {n.dsc_delay_s * 1e3:.4g} ms late" if n.dsc_delay_s else "NC"),
    )  # fmt: skip


PARAMETERS = numbers_of(DriveLoopNumbers)


@compiled(inline=True)
def drive_position_loop(a, drives, state, sent, position):  # type: ignore[no-untyped-def]
    """w* of axis `a` whose drive closes the position loop (DSC): the delayed w* of the NC, corrected for the motion since then.

    `sent` (axis, cycle, 2) is the ring buffer of what the NC sent.
    """
    moved = drives.position_gain[a] * position / drives.ratio[a]
    ring = sent[a]
    if state.newest[a] < 0:  # first cycle: the axis was at rest here
        ring[:, 0] = state.commanded_speed[a] + moved
        ring[:, 1] = state.commanded_torque[a]
    at = state.newest[a] + 1
    if at >= len(ring):
        at = 0
    state.newest[a] = at
    ring[at, 0] = state.commanded_speed[a] + moved
    ring[at, 1] = state.commanded_torque[a]
    late = at - drives.dsc_cycles[a]
    if late < 0:
        late += len(ring)
    later = late - 1 if late > 0 else len(ring) - 1
    part = drives.dsc_part[a]
    state.speed_setpoint[a] = ring[late, 0] + part * (ring[later, 0] - ring[late, 0]) - moved
    state.torque_feedforward[a] = ring[late, 1] + part * (ring[later, 1] - ring[late, 1])


def closed_in_drive(
    delay: float, cycles: int, a: np.ndarray, b: np.ndarray, position: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The plant, extended by past encoder values, and the row that the drive's position loop sees. `delay`, `cycles` in speed cycles."""
    weights = np.zeros(math.ceil(delay) + cycles + 1)  # of the encoder values, newest first
    weights[0] = 1.0
    whole = math.floor(delay)
    for late, part in ((whole, 1.0 - (delay - whole)), (whole + 1, delay - whole)):
        if part > 0.0:
            weights[late] -= part
            weights[late : late + cycles] += part / cycles
    return *with_past(a, b, position, len(weights) - 1), np.concatenate([weights[0] * position, weights[1:]])
