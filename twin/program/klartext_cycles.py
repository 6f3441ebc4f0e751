"""Drilling cycles 200 to 209 of HEIDENHAIN Klartext. Their parameters are Q parameters, which the definition sets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.cycles import ASIDE, BACK, DWELL, FEED, Drilling, Peck, Steps, levels, pecks
from twin.program.expressions import WordError
from twin.program.klartext_blocks import Klartext

NEEDS = {
    200: "200 201 206 202 203", 201: "200 201 206 203", 202: "200 201 206 203", 203: "200 201 206 202 203", 204: "200 249 250 251 252 253 254 203",
    205: "200 201 206 202 203", 206: "200 201 206 203", 207: "200 201 239 203", 208: "200 201 206 334 203 335", 209: "200 201 239 203 257 256",
}  # fmt: skip
"""Parameters that a cycle cannot do without."""
ADVANCED_STOP = 0.2
"""Distance above the last depth at which feed begins again in cycle 200, and the step off the wall in cycle 202 [mm]."""
DIRECTIONS = {0: (0.0, 0.0), 1: (-1.0, 0.0), 2: (0.0, -1.0), 3: (1.0, 0.0), 4: (0.0, 1.0)}

Parameters = Callable[..., float]
"""The value of a Q parameter by its number; a second number is the value of one that is not set, 0 without it."""


def cycle_here(m: Klartext) -> None:
    """Carry out the cycle in force at this place."""
    m.settle()
    state, control, number = m.state, m.control, m.cycle
    if state.comp is not None:
        raise WordError("a cycle is called inside RL or RR; write R0 and a move before")
    if number is None:
        raise WordError("no cycle is defined that a call could carry out; add CYCL DEF before")

    def q(key: int, default: float = 0.0) -> float:
        return m.values.parameter(f"Q{key}", 1, default)

    if missing := [f"Q{n}" for n in NEEDS[number].split() if math.isnan(q(int(n), math.nan))]:
        raise WordError(f"cycle {number} needs {' '.join(missing)}; add them")
    safe, out, bottom = q(203) + q(200), q(203) + max(q(200), q(204)), q(203) + q(201)
    if number != 204 and not q(201) < 0.0:
        raise WordError(f"cycle {number}: the depth Q201={q(201):g} must be below 0, as the control is set when delivered; correct it")
    per_turn = number in (207, 209)
    pitch_feed = abs(q(239)) * state.out.modes.spindle * state.unit / state.out.modes.feed_unit
    feed = pitch_feed if per_turn else q(254) if number == 204 else q(206)
    if not feed > 0.0:
        raise WordError(f"cycle {number} needs a feed above 0" + (": a pitch Q239 and a spindle speed S" if per_turn else ""))
    before, mode_before = state.feed, state.out.modes.feed_mode
    state.set_feed_mode(94)
    state.feed = feed
    if abs(float(state.here()[arcs.PLANES[state.plane][2]]) / state.unit - safe) > 1e-9:
        control.height(safe)
    if number == 204:
        _back_boring(m, q, safe)
    elif number == 208:
        _bore_milling(m, q, safe, bottom)
    else:
        control.drill(_drilling(number, q, safe, bottom, 1e-3 / state.unit))
    if out > safe + 1e-9:
        control.height(out)
    state.set_feed_mode(mode_before)
    state.feed = before


def _drilling(number: int, q: Parameters, safe: float, bottom: float, mm: float) -> Drilling:
    """The cycle by its parameters; `mm` in program units."""
    surface, stop, back_share = q(203), ADVANCED_STOP * mm, q(208) / q(206) if q(208) > 0.0 and q(206) else 0.0
    plain = Drilling(safe, bottom, safe, dwell_last=q(211))
    if number in (201, 202, 206):
        leave = replace(plain, out=FEED, out_scale=back_share if back_share and number != 206 else 1.0)
        return leave if number != 202 else replace(leave, aside=_aside(q, stop))
    if number == 207 or (number == 209 and not q(257) > 0.0):
        return Drilling(safe, bottom, safe, out=FEED)
    if number == 209:
        depths, back, share = levels(surface, bottom, abs(q(257))), abs(q(256)) * abs(q(239)), abs(q(403, 1.0)) or 1.0
        infeeds = [Peck(depth, back or safe - at, True) for at, depth in zip([surface, *depths], depths)]
        return Drilling(safe, bottom, safe, tuple(infeeds), out=FEED, out_scale=share, between=share)
    if number == 200:
        return replace(plain, pecks=pecks(levels(surface, bottom, q(202)), stop, False), dwell_out=q(210))
    depths = levels(surface, bottom, q(202), q(212), q(205))
    if number == 203:
        breaks = int(q(213))
        infeeds = [Peck(d, q(256, stop), True) if breaks and k % (breaks + 1) else Peck(d, stop, False) for k, d in enumerate(depths)]
        leave = replace(plain, out=FEED, out_scale=back_share, between=back_share) if back_share else plain
        return replace(leave, pecks=tuple(infeeds), dwell_out=q(210))
    if q(379):
        raise WordError("cycle 205 with a deepened start Q379 is not supported; set Q379=0")
    infeeds, at = [], surface
    for k, depth in enumerate(depths):
        way = q(258, stop) + (k - 1) / max(1, len(depths) - 2) * (q(259, stop) - q(258, stop))
        parts = levels(at, depth, q(257))
        infeeds += [Peck(parts[0], way, False), *pecks(parts[1:], q(256, stop), True)]
        at = depth
    return replace(plain, pecks=tuple(infeeds))


def _aside(q: Parameters, way: float) -> tuple[float, float]:
    """The step in the direction Q214."""
    if int(q(214)) not in DIRECTIONS:
        raise WordError(f"Q214={q(214):g} is no direction; give 0 to 4")
    u, v = DIRECTIONS[int(q(214))]
    return u * way, v * way


def _back_boring(m: Klartext, q: Parameters, safe: float) -> None:
    """Cycle 204: aside through the hole, back to its axis, upwards at feed to the depth Q249, down, aside and out."""
    edge = q(203) - q(250) - q(200) - q(252)  # of the tip, with the edge one clearance below the lower side of the part
    depth, aside = q(203) - q(250) + q(249) - q(252), _aside(q, q(251))
    if aside == (0.0, 0.0) or not q(253) > 0.0:
        raise WordError("cycle 204 needs the direction Q214 (1 to 4), the distance Q251 and the feed Q253; correct them")
    to = q(253) / q(254)
    pause: Steps = [(DWELL, q(255), 1.0)] if q(255) > 0.0 else []
    m.control.steps([(ASIDE, safe, 1.0), (FEED, edge, to), (BACK, edge, 1.0), (FEED, depth, 1.0), *pause, (FEED, edge, to)], aside)
    m.control.steps([(ASIDE, edge, 1.0), (FEED, safe, to), (BACK, safe, 1.0)], aside)


def _bore_milling(m: Klartext, q: Parameters, safe: float, bottom: float) -> None:
    """Cycle 208: half a circle to the wall, a helix of Q334 a turn, one full turn at the bottom, half a circle back, out."""
    state, control = m.state, m.control
    radius = 0.5 * q(335) * state.unit - state.tools.radius(state.tools.name, 1)
    if not radius > 0.0 or not q(334) > 0.0:
        raise WordError("cycle 208: the bore Q335 must be larger than the tool, and the infeed Q334 above 0; correct them")
    if q(342):
        raise WordError("cycle 208 with a roughed bore Q342 is not supported; set Q342=0")
    state.note("cycle 208: the tool goes to the wall and back on half circles at the heights where the helix begins and ends")
    a, _, c = arcs.PLANES[state.plane]
    centre, clockwise = state.here(), q(351, 1.0) < 0.0
    turns = max(1, math.ceil((safe - bottom) / q(334) - 1e-9))

    def arc(to: float, height: float, middle: float, more: int) -> None:
        point, about = centre.copy(), centre.copy()
        point[a], point[c], about[a] = centre[a] + to, height * state.unit, centre[a] + middle
        control.go(mv.ARC, point, arc=control.arc_about(state.here(), point, np.asarray(about), clockwise, more))

    arc(radius, safe, 0.5 * radius, 0)
    arc(radius, bottom, 0.0, turns - 1)
    arc(radius, bottom, 0.0, 0)
    arc(0.0, bottom, 0.5 * radius, 0)
    control.height(safe)
