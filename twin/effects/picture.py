"""What the picture of an effect shows: a short move on one axis, with the effect and without it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Move = Literal["acceleration", "reversal", "slow", "constant speed", "gentle", "jerk", "micro", "chirp", "turn", "again"]
"""Moves of the pictures. An effect of another axis is shown on an axis that moves steadily while `from_axis` accelerates."""


@dataclass(frozen=True)
class Picture:
    """The picture of an effect. A new effect needs none of this: it is shown on an acceleration of its first axis.

    `look` says what to look at. Sizes that are not given are the middle of the usual range. `axis` and `with_axes` count
    where the machine has them. The current is a mean over `smooth_s`, which takes out the staircase of the position cycle.
    """

    look: str = ""
    move: Move = "acceleration"
    axis: str = ""
    feedforward: str | None = None
    sizes: Mapping[str, float] = field(default_factory=dict)
    from_axis: str = ""
    with_axes: str = ""
    started_at: float = 0.0
    smooth_s: float = 0.002
