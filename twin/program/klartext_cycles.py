"""The cycles of HEIDENHAIN Klartext: frames, tilted planes, dwell, tolerance, and drilling (200 to 209) by its Q parameters.

Frames, outermost first: preset (247), datum shift (7, TRANS DATUM), tilted plane (19, PLANE), shift within the plane, mirror (8), rotation (10),
scale (11, 26). A shift that is changed to something else while mirror, rotation or scale is in force is refused: whether it is turned by
them depends on the control.
"""

from collections.abc import Callable
from dataclasses import replace
import math
import re

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.cycles import ASIDE, BACK, DWELL, MOVE, RAPID, Drilling, Peck, Steps, levels, pecks
from twin.program.expressions import WordError, needed
from twin.program.frames import INDEX, LINEAR, NO_FRAME, ROTARY, Frame, about, mirrored, rotation, rotation_xyz, shifted
from twin.program.klartext_blocks import VALUE, Block, Klartext
from twin.program.orientation import OK, choose_angles, unreachable_text

NEEDS = {
    200: "200 201 206 202 203", 201: "200 201 206 203", 202: "200 201 206 203", 203: "200 201 206 202 203", 204: "200 249 250 251 252 253 254 203",
    205: "200 201 206 202 203", 206: "200 201 206 203", 207: "200 201 239 203", 208: "200 201 206 334 203 335", 209: "200 201 239 203 257 256",
}  # fmt: skip
"""Parameters that a cycle cannot do without."""
ADVANCED_STOP = 0.2
"""Cycle 200 begins feed again this far above the last depth, cycle 202 steps off the wall by it [mm]."""
DIRECTIONS = {0: (0.0, 0.0), 1: (-1.0, 0.0), 2: (0.0, -1.0), 3: (1.0, 0.0), 4: (0.0, 1.0)}

Parameters = Callable[..., float]
"""The value of a Q parameter by its number; a second number is the value of one that is not set, 0 without it."""
_SPATIAL = re.compile(rf"\s*SP[ABC]\s*{VALUE}", re.A)


def _in_force(m: Klartext) -> bool:
    """Whether mirror, rotation or scale is in force."""
    return any(not np.array_equal(m.state.frames[n].matrix, np.eye(3)) for n in ("mirror", "turn", "scale"))


def datum(m: Klartext, b: Block) -> None:
    """Cycle 7 and TRANS DATUM AXIS: axes of a datum shift, absolute or in addition (I)."""
    state, name = m.state, "inner" if m.state.tilted else "shift"
    words = m.only_words(b, "X Y Z A B C U V W", "; a datum table is not simulated", added=True)
    old = state.frames[name].shift
    new = old.copy()
    for axis, (value, how, at) in words.items():
        if axis not in INDEX:
            raise WordError(f"a datum shift of {axis} cannot be set on this machine", at)
        new[INDEX[axis]] = state.si(axis, value) + (old[INDEX[axis]] if how else 0.0)
    if np.any(new[:3] != old[:3]) and np.any(new[:3]) and _in_force(m):
        raise WordError("a datum shift while mirror, rotation or scale is in force is not simulated; write it before them")
    if np.any(new[3:] != old[3:]):
        state.out.settle()
    state.set_frames(**{name: shifted(new)})


def trans_datum(m: Klartext, b: Block) -> None:
    """TRANS DATUM AXIS X.. or RESET."""
    m.settle()
    text = b.text.strip()
    if not text.startswith(("AXIS", "RESET")):
        raise WordError("TRANS DATUM is read with AXIS or RESET; a datum table is not simulated", b.column)
    b.text = "X0 Y0 Z0" if text == "RESET" else text[4:]
    datum(m, b)


def mirror(m: Klartext, b: Block) -> None:
    """Cycle 8: the axes named."""
    axes = set(b.text.split())
    if axes - set(LINEAR):
        raise WordError("a mirror of rotary axes is not supported; let the CAM system output the final coordinates", b.column)
    m.state.set_frames(mirror=Frame(mirrored(axes), np.zeros(5)))


def turn(m: Klartext, b: Block) -> None:
    """Cycle 10: about the normal of the plane, absolute or in addition."""
    rot = needed(m.only_words(b, "ROT", added=True).get("ROT"), "cycle 10 needs its angle, e.g. CYCL DEF 10.1 ROT+35", b.column)
    before, inner = m.state.frames["turn"].matrix, rotation(arcs.PLANES[m.state.plane][2], rot.value)
    m.state.set_frames(turn=Frame(before @ inner if rot.how else inner, np.zeros(5)))


def scale(m: Klartext, b: Block) -> None:
    """Cycle 11: one factor SCL; cycle 26: one for each axis, about CCX CCY."""
    words = m.only_words(b, "SCL" if b.head.endswith("11") else "X Y Z CCX CCY CCZ")
    factors = np.array([words[n].value if n in words else 1.0 for n in LINEAR]) * (words["SCL"].value if "SCL" in words else 1.0)
    if not words or not np.all(factors > 0.0):
        raise WordError(f"{b.head} needs a factor above 0: cycle 11 SCL, cycle 26 axes, and CCX CCY as their centre", b.column)
    centre = np.array([words[f"CC{n}"].value * m.state.unit if f"CC{n}" in words else 0.0 for n in LINEAR])
    m.state.set_frames(scale=about(np.diag(factors), centre))


def preset(m: Klartext, b: Block) -> None:
    """Cycle 247: the preset with the number Q339."""
    found = needed(re.search(rf"Q339\s*=\s*({VALUE})", b.text), "cycle 247 needs Q339, the number of the preset", b.column)
    m.state.set_frames(preset=shifted(m.state.frame_table(f"PRESET{m.number_of(found[1], b.column):g}")))


def tilt_cycle(m: Klartext, b: Block) -> None:
    """Cycle 19: an angle that is left out keeps its value; none at all ends the plane."""
    b.text = re.sub(rf"\bF\s*{VALUE}", "", re.sub(rf"\b([ABC])\s*(?={VALUE})", r"SP\1", b.text))
    given = {n[2:]: i.value for n, i in m.only_words(b, "SPA SPB SPC ABST DIST").items() if n.startswith("SP")}
    tilt(m, {**m.tilt_angles, **given} if given else {}, b.column)


def plane(m: Klartext, b: Block) -> None:
    """PLANE SPATIAL SPA SPB SPC and how it turns, or PLANE RESET."""
    m.settle()
    how = _SPATIAL.sub("", b.text)
    match = re.fullmatch(
        rf"\s*(STAY|TURN|MOVE)?(?:\s*(?:DIST|MB)\s*(?:MAX|{VALUE}))?(?:\s*F\s*(?:MAX|AUTO|{VALUE}))?\s*(?:SEQ([-+]))?\s*(?:COORD ROT|TABLE ROT)?\s*",
        how,
    )
    if match is None:
        raise WordError(f"'{how.strip()[:20]}' is not read in PLANE; write SPA SPB SPC, STAY, TURN or MOVE, SEQ", b.column)
    b.text = " ".join(_SPATIAL.findall(b.text))
    tilt(m, {n[2]: i.value for n, i in m.only_words(b, "SPA SPB SPC").items()}, b.column, match[2] or "")


def tilt(m: Klartext, angles: dict[str, float], column: int, sequence: str = "") -> None:
    """A plane by its spatial angles A, B, C: turns about the fixed axes X, Y, Z, in this order; none or zeros end it."""
    state = m.state
    state.untilt()
    state.set_frames(inner=NO_FRAME)
    m.tilt_angles, m.turn_to, chosen = angles, None, np.zeros(2)
    if any(angles.values()):
        if _in_force(m):
            raise WordError("a tilted plane while mirror, rotation or scale is in force is not simulated; reset them before", column)
        matrix = rotation_xyz({"X": angles.get("A", 0.0), "Y": angles.get("B", 0.0), "Z": angles.get("C", 0.0)})
        state.tilt(Frame(matrix, np.zeros(5)))
        axis, now = matrix[:, arcs.PLANES[state.plane][2]], np.array(state.out.settle())
        found = choose_angles(state.out.kinematics, axis, now)
        if found.status[-1] != OK:
            raise WordError(unreachable_text(state.out.kinematics, axis, int(found.status[-1])), column)
        chosen = found.angles[-1]
        if sequence:
            chosen = _solution(m, axis, now, 1.0 if sequence == "+" else -1.0, chosen, column)
            m.turn_to = float(chosen[0]), float(chosen[1])
        state.note("PLANE SPATIAL, cycle 19: A and C turn with the next move to the nearest solution, the tool tip keeps its place")
    for slot, angle in zip(ROTARY, chosen):
        letter = next((own for own, place in state.slot_of.items() if place == slot), slot)
        m.q[{"A": "Q120", "B": "Q121", "C": "Q122"}.get(letter, "Q120")] = math.degrees(float(angle))


def _solution(m: Klartext, axis: np.ndarray, now: np.ndarray, sign: float, chosen: np.ndarray, column: int) -> np.ndarray:
    """The solution (2,) of the rotary axes whose tilting axis has a sign (SEQ); the turning axis goes the shorter way."""
    pairs, _ = m.out.kinematics.angles(axis)
    for tilted, turned in pairs[:, 0]:
        if tilted * sign > 1e-9 and not math.isnan(turned):
            return np.array([tilted, now[1] + (turned - now[1] + math.pi) % (2.0 * math.pi) - math.pi])
    if abs(chosen[0]) > 1e-9:
        raise WordError("SEQ asks for a solution that the rotary axes of this machine do not have; remove it", column)
    return chosen


def dwell(m: Klartext, b: Block) -> None:
    """Cycle 9."""
    found = needed(re.fullmatch(rf"[A-Z. ]*({VALUE})", b.text), "cycle 9 needs its time, e.g. CYCL DEF 9.1 DWELL 0.5", b.column)
    m.control.dwell(m.number_of(found[1], b.column))


def tolerance(m: Klartext, b: Block) -> None:
    """Cycle 32: T of the path, TA of the orientation; without them as switched on."""
    b.text = re.sub(r"\bHSC-MODE:\s*\d", "", b.text)
    words = m.only_words(b, "T TA", " and HSC-MODE")
    m.state.set_tolerances(*(words[n].value if n in words else 0.0 for n in ("T", "TA")))


# ------------------------------------------------------------------ drilling


def drilling(m: Klartext, b: Block) -> None:
    """Cycles 200 to 209: their parameters, then the cycle for the next call."""
    for word in re.finditer(rf"(Q\d+)\s*=\s*({VALUE})", b.text):
        m.assign(word[1], m.number_of(word[2], b.column), b.column)
    m.cycle, m.cycle_everywhere = int(b.head.split()[-1]), False


def cycle_here(m: Klartext) -> None:
    """Carry out the cycle in force at this place."""
    m.settle()
    state, control = m.state, m.control
    state.outside_compensation("a cycle is called")
    number = needed(m.cycle, "no cycle is defined that a call could carry out; add CYCL DEF before")

    def q(key: int, default: float = 0.0) -> float:
        return m.parameter(f"Q{key}", 1, default)

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
    with control.own_feed(feed):
        control.height(safe)
        if number == 204:
            _back_boring(m, q, safe)
        elif number == 208:
            _bore_milling(m, q, safe, bottom)
        else:
            control.drill(_drilling(number, q, safe, bottom, 1e-3 / state.unit))
        control.height(out)


def _drilling(number: int, q: Parameters, safe: float, bottom: float, mm: float) -> Drilling:
    """The cycle by its parameters; `mm` in program units."""
    surface, stop, back_share = q(203), ADVANCED_STOP * mm, q(208) / q(206) if q(208) > 0.0 and q(206) else 0.0
    plain = Drilling(safe, bottom, safe, dwell_last=q(211))
    if number in (201, 202, 206):
        leave = replace(plain, out=back_share if back_share and number != 206 else 1.0)
        return leave if number != 202 else replace(leave, aside=_aside(q, stop))
    if number == 207 or (number == 209 and not q(257) > 0.0):
        return Drilling(safe, bottom, safe, out=1.0)
    if number == 209:
        depths, back, share = levels(surface, bottom, abs(q(257))), abs(q(256)) * abs(q(239)), abs(q(403, 1.0)) or 1.0
        infeeds = [Peck(depth, back or safe - at, True) for at, depth in zip([surface, *depths], depths)]
        return Drilling(safe, bottom, safe, tuple(infeeds), out=share, between=share)
    if number == 200:
        return replace(plain, pecks=pecks(levels(surface, bottom, q(202)), stop, False), dwell_out=q(210))
    less, least = q(212), q(205)
    depths = levels(
        surface, bottom, q(202), lambda step, _: max(step - less, least if least > 0.0 else step if less <= 0.0 else 1e-3 * step)
    )
    if number == 203:
        breaks = int(q(213))
        infeeds = [Peck(d, q(256, stop), True) if breaks and k % (breaks + 1) else Peck(d, stop, False) for k, d in enumerate(depths)]
        return replace(plain, out=back_share, between=back_share, pecks=tuple(infeeds), dwell_out=q(210))
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
    u, v = needed(DIRECTIONS.get(int(q(214))), f"Q214={q(214):g} is no direction; give 0 to 4")
    return u * way, v * way


def _back_boring(m: Klartext, q: Parameters, safe: float) -> None:
    """Cycle 204: aside through the hole, back to its axis, upwards at feed to the depth Q249, down, aside and out."""
    edge = q(203) - q(250) - q(200) - q(252)  # of the tip, with the edge one clearance below the lower side of the part
    depth, aside = q(203) - q(250) + q(249) - q(252), _aside(q, q(251))
    if aside == (0.0, 0.0) or not q(253) > 0.0:
        raise WordError("cycle 204 needs the direction Q214 (1 to 4), the distance Q251 and the feed Q253; correct them")
    to = q(253) / q(254)
    pause: Steps = [(DWELL, q(255), RAPID)] if q(255) > 0.0 else []
    inward = [(ASIDE, safe, RAPID), (MOVE, edge, to), (BACK, edge, RAPID), (MOVE, depth, 1.0), *pause, (MOVE, edge, to)]
    m.control.steps([*inward, (ASIDE, edge, RAPID), (MOVE, safe, to), (BACK, safe, RAPID)], aside)


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
