"""Friction of one axis at its load side: exact stick-slip, or a bristle if the axis has pre-sliding.

Level:   F(v, q) = Coulomb (1 + fraction sin(k q)) (1 + warming) + excess exp(-(v / velocity)^2)
Stick-slip (no bristle): over a step h the friction force brings the free motion v + h a to rest, limited to the level:
    force = clip(-(v / h + a) m, -F, F)
This is the implicit Coulomb law: the exact level while sliding, and true rest (no creep) while sticking.
Bristle:  z' = v - stiffness |v| z / F,   force = -(stiffness z + damping z')
integrated exactly over a step of constant v, because at rapid speed the bristle saturates much faster than any step:
    z -> zs + (z - zs) e^-x,   mean z = zs + (z - zs)(1 - e^-x)/x,   zs = F sign(v) / stiffness,   x = stiffness |v| h / F
Units N, m, s (Nm, rad, s at A and C). Source: effects.md, "stribeck, presliding"; the exact step is the linear ODE's solution.
"""

from __future__ import annotations

import math

from .compiled import compiled


@compiled(inline=True)
def friction_level(coulomb: float, wave: float, wave_number: float, excess: float, velocity: float, q: float, v: float) -> float:
    """F(v, q) of the module's docstring, at least 0."""
    level = coulomb
    if wave != 0.0:
        level *= 1.0 + wave * math.sin(wave_number * q)
    if excess != 0.0:
        x = v / velocity
        if abs(x) < 6.0:
            level += excess * math.exp(-x * x)
    return max(level, 0.0)


@compiled(inline=True)
def stick_slip_force(level: float, v: float, free_acceleration: float, mass: float, step: float) -> float:
    """Friction force of the implicit Coulomb law over one step."""
    force = -(v / step + free_acceleration) * mass
    return min(max(force, -level), level)


@compiled(inline=True)
def bristle_force(level: float, stiffness: float, damping: float, z: float, v: float, step: float) -> tuple[float, float]:
    """(mean force over the step, z at its end)."""
    if level <= 0.0:
        return 0.0, 0.0
    x = stiffness * abs(v) * step / level
    if x < 1e-6:
        z_end = z + v * step
        z_mean = z + 0.5 * v * step
    else:
        steady = level / stiffness * (1.0 if v > 0.0 else -1.0)
        decay = math.exp(-x)
        z_end = steady + (z - steady) * decay
        z_mean = steady + (z - steady) * (1.0 - decay) / x
    return -(stiffness * z_mean + damping * (z_end - z) / step), z_end
