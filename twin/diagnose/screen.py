"""Screening: what each effect would close, from one simulated start of it, its size scaled linearly."""

from __future__ import annotations

import numpy as np

from twin.diagnose.candidates import Start, combine, softened
from twin.diagnose.fit import answer
from twin.diagnose.state import Found
from twin.effects import Setting
from twin.errors import TwinError


def screen(found: Found, start: Start, target: tuple[np.ndarray, np.ndarray]) -> tuple[float, Setting] | None:
    """Gain of a start (half the drop of the squares) with its size scaled linearly, and the setting it stands for.

    `target` is what is left, remembered by the tuning; None where the start changes nothing or cannot be simulated.
    """
    tuning, t = found.tuning, found.thresholds
    try:
        columns = [remembered_answer(found, s) for s in start.settings]
    except TwinError:
        return None
    setting = start.settings[0]
    size = start.effect.size
    inner = np.array([[tuning.product(a, b) for b in columns] for a in columns])
    with_target = np.array([tuning.product(c, target) for c in columns])
    if not np.all(np.isfinite(inner)) or not np.all(np.diag(inner) > 1e-9):
        return None
    if size.is_spring:
        share = float(np.clip(with_target[0] / inner[0, 0], t.stiffest_spring, t.softest_spring))
        return share * float(with_target[0] - 0.5 * share * inner[0, 0]), softened(start, found.group.views[0].machine, share)
    if not size.is_scaled:
        return float(with_target[0] - 0.5 * inner[0, 0]), setting
    sizes = np.linalg.solve(inner + 1e-12 * np.eye(len(inner)), with_target)
    if len(sizes) == 1:
        neutral = size.neutral or 0.0
        deviation = setting.parameters[size.name] - neutral
        low, high = (size.low - neutral) / deviation, (size.high - neutral) / deviation
        sizes = np.clip(sizes, max(min(low, high), -t.screened_largest), min(max(low, high), t.screened_largest))
        if size.low >= neutral and not size.is_factor:
            sizes = np.maximum(sizes, t.screened_delay if size.lag_cycle else t.screened_least)
    scaled = combine(start, sizes.tolist(), found.group.views[0].machine)
    return float(sizes @ with_target - 0.5 * sizes @ inner @ sizes), scaled


def remembered_answer(found: Found, setting: Setting) -> tuple[np.ndarray, np.ndarray]:
    """What a setting changes (row,), simulated once, with its projection on the tuning."""
    return found.remembered(repr(setting.table()), lambda: answer(found.group, [setting]))
