"""Screening: what each effect would close, from one simulated start of it, its size scaled linearly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.diagnose.candidates import Start, combine, is_lag, is_scaled, is_spring, size_parameter, softened
from twin.diagnose.fit import answer
from twin.diagnose.found import Found
from twin.effects import Setting
from twin.errors import TwinError

LEAST_DELAY = 1e-5
"""Share of what a lag delays at its start to which screening may go down."""

SOFTENED = (0.05, 2.0)
"""How much less or more than its start a spring may give in screening."""


@dataclass(frozen=True)
class Screened:
    """What screening says of a start.

    `gain` is the drop of half the squares with the best size, `setting` that size; `shows` are half the squares that the start, a usual
    size, makes beyond what re-tuning takes up: what a fit could gain if the machine had it.
    """

    gain: float
    setting: Setting
    shows: float


def screen(found: Found, start: Start, target: tuple[np.ndarray, np.ndarray]) -> Screened | None:
    """A start held against what is left, `target` remembered by the tuning; None where the machine with it is unstable."""
    tuning = found.tuning
    try:
        columns = [_remembered_answer(found, s) for s in start.settings]
    except TwinError:
        return None
    setting = start.settings[0]
    size = size_parameter(start.effect)
    inner = np.array([[tuning.product(a, b) for b in columns] for a in columns])
    with_target = np.array([tuning.product(c, target) for c in columns])
    if not np.all(np.isfinite(inner)):
        return None
    shows = 0.5 * float(np.diag(inner).mean())
    if not np.all(np.diag(inner) > 1e-9):
        return Screened(0.0, setting, shows)
    if is_spring(start.effect):
        share = float(np.clip(with_target[0] / inner[0, 0], *SOFTENED))
        gain = share * float(with_target[0] - 0.5 * share * inner[0, 0])
        return Screened(gain, softened(start, found.group.views[0].machine, share), shows)
    if not is_scaled(size):
        return Screened(float(with_target[0] - 0.5 * inner[0, 0]), setting, shows)
    sizes = np.linalg.solve(inner + 1e-12 * np.eye(len(inner)), with_target)
    if len(sizes) == 1:
        neutral = size.neutral or 0.0
        deviation = setting.parameters[size.name] - neutral
        low, high = (size.low - neutral) / deviation, (size.high - neutral) / deviation
        sizes = np.clip(sizes, max(min(low, high), -4.0), min(max(low, high), 4.0))
        if size.low >= neutral and size.name != "factor":
            sizes = np.maximum(sizes, LEAST_DELAY if is_lag(start.effect) else 0.02)
    scaled = combine(start, sizes.tolist(), found.group.views[0].machine)
    return Screened(float(sizes @ with_target - 0.5 * sizes @ inner @ sizes), scaled, shows)


def _remembered_answer(found: Found, setting: Setting) -> tuple[np.ndarray, np.ndarray]:
    key = repr(setting.table())
    if key not in found.answers:
        found.answers[key] = found.tuning.remembered(answer(found.group, [setting]).astype(np.float32))
    return found.answers[key]
