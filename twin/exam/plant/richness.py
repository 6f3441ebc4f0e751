"""Applies the small imperfections of `Richness` to settings: compliance, pre-sliding, cogging, Stribeck on every axis.

An effect of the same kind takes precedence. Values are drawn per axis; units and ranges: parameters.Richness.
"""

from __future__ import annotations

import math

import numpy as np

from .effects import SCREW
from .parameters import Richness, Settings, load_of


def apply_richness(s: Settings, richness: Richness, rng: np.random.Generator) -> None:
    """Change settings `s` in place, after the effects; the draws do not depend on the effects."""
    n = len(s.linear)
    draw = {kind: rng.random((3, n)) for kind in ("compliance", "presliding", "cogging", "stribeck")}

    def span(pair: tuple[float, float], u: np.ndarray) -> np.ndarray:
        return pair[0] + (pair[1] - pair[0]) * u

    load = load_of(s)
    at_axis = np.where(s.linear, 1.0, s.ratio / SCREW)  # metres at a screw to axis units at equal motor angle

    if richness.presliding:
        stiffness = s.coulomb / (span(richness.presliding, draw["presliding"][0]) * at_axis)
        damping = 2.0 * span((0.2, 0.6), draw["presliding"][1]) * np.sqrt(stiffness * load)
        free = s.presliding_stiffness == 0.0
        s.presliding_stiffness[free], s.presliding_damping[free] = stiffness[free], damping[free]
    if richness.compliance_hz:
        stiffness = (2.0 * math.pi * span(richness.compliance_hz, draw["compliance"][0])) ** 2 * load
        damping = 2.0 * span((0.04, 0.08), draw["compliance"][1]) * np.sqrt(stiffness * load)
        free = (s.stiffness == 0.0) & (s.gap == 0.0)
        s.stiffness[free], s.damping[free] = stiffness[free], damping[free]
    if richness.cogging:
        s.cogging += span(richness.cogging, draw["cogging"][0]) * s.coulomb * s.ratio
        s.cogging_n[:] = np.floor(span((6, 15), draw["cogging"][1]))
        s.cogging_phase[:] = 2.0 * math.pi * draw["cogging"][2]
    if richness.stribeck:
        free = s.stribeck_excess == 0.0
        s.stribeck_excess[free] = (span(richness.stribeck, draw["stribeck"][0]) * s.coulomb)[free]
        s.stribeck_velocity[free] = (span((1e-3, 4e-3), draw["stribeck"][1]) * at_axis)[free]
