"""The tilting pair A/C: closed-form Lagrangian of two rotary axes with cradle, table, workpiece and clamped masses.

A body on the table with centre p = (x, y, z), mass m, inertia diag(I1, I2, I3), table frame offset o = (0, oy, oz) from
the A axis. In the cradle frame its centre is rho = o + Rz(C) p, d = Rz(C) p, zeta = oz + z, and with A' about x, C' about z
    velocity = A' x_hat x rho + C' z_hat x d,     T = 1/2 Maa A'^2 + Mac A' C' + 1/2 Mcc C'^2
    Maa = I_cradle + sum m (rho_y^2 + zeta^2) + I1 cos^2 C + I2 sin^2 C
    Mac = -sum m zeta d_x          Mcc = sum m (x^2 + y^2) + I3
    V   = g sum m (sin A rho_y + cos A zeta)
Lagrange's equations, ' = d/dC:
    Maa A" + Mac C" + Maa' A' C' + Mac' C'^2 + dV/dA = Q_A
    Mac A" + Mcc C" - 1/2 Maa' A'^2          + dV/dC = Q_C
Rotors enter elsewhere as diagonal terms. `pair` holds the sums over the bodies (parameters.pair_of). Units kg m2, Nm, rad.
Source: own derivation, checked by energy conservation in tests/exam.
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import compiled


@compiled(inline=True)
def pair_terms(pair: np.ndarray, a: float, c: float, va: float, vc: float) -> tuple[float, float, float, float, float]:
    """(Maa, Mac, Mcc, h_A, h_C): mass matrix and h = Coriolis + centrifugal + gravity torques, on the left side of the equations."""
    g, cradle_i, cradle_y, cradle_z = pair[0], pair[1], pair[2], pair[3]
    m, mx, my, mz, oy = pair[4], pair[5], pair[6], pair[7], pair[8]
    sxx, syy, sxy, szz, szx, szy = pair[9], pair[10], pair[11], pair[12], pair[13], pair[14]
    i1, i2, i3 = pair[15], pair[16], pair[17]
    sc, cc, sa, ca = math.sin(c), math.cos(c), math.sin(a), math.cos(a)
    dx, dy = mx * cc - my * sc, mx * sc + my * cc  # sums of m d_x, m d_y
    maa = cradle_i + oy * oy * m + 2.0 * oy * dy + sxx * sc * sc + 2.0 * sxy * sc * cc + syy * cc * cc + szz + i1 * cc * cc + i2 * sc * sc
    mac = -(szx * cc - szy * sc)
    mcc = sxx + syy + i3
    dmaa = 2.0 * (oy * dx + (sxx - syy + i2 - i1) * sc * cc + sxy * (cc * cc - sc * sc))
    dmac = szx * sc + szy * cc
    ha = dmaa * va * vc + dmac * vc * vc + g * (ca * (cradle_y + oy * m + dy) - sa * (cradle_z + mz))
    hc = -0.5 * dmaa * va * va + g * sa * dx
    return maa, mac, mcc, ha, hc


def holding_torque(pair: np.ndarray, a: float, c: float) -> tuple[float, float]:
    """Torques [Nm] on A and C that hold the pair at rest: dV/dA, dV/dC."""
    _, _, _, ha, hc = pair_terms(pair, a, c, 0.0, 0.0)
    return ha, hc
