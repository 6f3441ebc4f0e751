"""The picture of an effect: a short move of one axis with and without the effect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Move = Literal["acceleration", "reversal", "slow", "constant speed", "gentle", "jerk", "micro", "chirp", "turn", "again"]
"""Moves of the pictures. An effect with a `from_axis` is shown on an axis at constant speed while `from_axis` accelerates."""


@dataclass(frozen=True)
class Picture:
    """The picture of an effect. All fields are optional; the default is an acceleration of the first axis.

    `look` is the caption. `sizes` default to the middle of the usual range. `axis` and `with_axes` are ignored on machines
    without them. The current is averaged over `smooth_s`, which removes the steps of the position cycle.
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
