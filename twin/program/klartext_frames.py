"""The frames of HEIDENHAIN Klartext: preset (247), datum shift (7, TRANS DATUM), mirror (8), rotation (10), scale (11, 26), tilted plane (19, PLANE).

Outermost first: preset, shift, tilt, shift within the plane, mirror, rotation, scale. A shift that is changed to something else while
mirror, rotation or scale is in force is refused: whether it is turned by them depends on the control.
"""

from __future__ import annotations

import math
import re

import numpy as np

from twin.program import arcs
from twin.program.expressions import WordError
from twin.program.frames import INDEX, LINEAR, NO_FRAME, ROTARY, Frame, about, mirrored, rotation, rotation_xyz, shifted
from twin.program.klartext_blocks import Klartext
from twin.program.klartext_lines import VALUE
from twin.program.orientation import OK, choose_angles, unreachable_text

_SPATIAL = re.compile(rf"\s*SP[ABC]\s*{VALUE}", re.A)


def _in_force(m: Klartext) -> bool:
    """Whether mirror, rotation or scale is in force."""
    return any(not np.array_equal(m.state.frames[n].matrix, np.eye(3)) for n in ("mirror", "turn", "scale"))


def datum(m: Klartext, head: str, text: str, column: int) -> None:
    """Cycle 7 and TRANS DATUM AXIS: axes of a datum shift, absolute or in addition (I)."""
    state, name = m.state, "inner" if m.state.tilted else "shift"
    words = m.only_words(head, text, column, "X Y Z A B C U V W", "; a datum table is not simulated", added=True)
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


def trans_datum(m: Klartext, head: str, text: str, column: int) -> None:
    """TRANS DATUM AXIS X.. or RESET."""
    m.settle()
    text = text.strip()
    if not text.startswith(("AXIS", "RESET")):
        raise WordError("TRANS DATUM is read with AXIS or RESET; a datum table is not simulated", column)
    datum(m, head, "X0 Y0 Z0" if text == "RESET" else text[4:], column)


def mirror(m: Klartext, _: str, text: str, column: int) -> None:
    """Cycle 8: the axes named."""
    axes = set(text.split())
    if axes - set(LINEAR):
        raise WordError("a mirror of rotary axes is not supported; let the CAM system output the final coordinates", column)
    m.state.set_frames(mirror=Frame(mirrored(axes), np.zeros(5)))


def turn(m: Klartext, head: str, text: str, column: int) -> None:
    """Cycle 10: about the normal of the plane, absolute or in addition."""
    words = m.only_words(head, text, column, "ROT", added=True)
    if not words:
        raise WordError("cycle 10 needs its angle, e.g. CYCL DEF 10.1 ROT+35", column)
    angle, before = words["ROT"].value, m.state.frames["turn"].matrix
    inner = rotation(arcs.PLANES[m.state.plane][2], angle)
    m.state.set_frames(turn=Frame(before @ inner if words["ROT"].how else inner, np.zeros(5)))


def scale(m: Klartext, head: str, text: str, column: int) -> None:
    """Cycle 11: one factor SCL; cycle 26: one for each axis, about CCX CCY."""
    words = m.only_words(head, text, column, "SCL" if head.endswith("11") else "X Y Z CCX CCY CCZ")
    factors = np.array([words[n].value if n in words else 1.0 for n in LINEAR]) * (words["SCL"].value if "SCL" in words else 1.0)
    if not words or not np.all(factors > 0.0):
        raise WordError(f"{head} needs a factor above 0: cycle 11 SCL, cycle 26 axes, and CCX CCY as their centre", column)
    centre = np.array([words[f"CC{n}"].value * m.state.unit if f"CC{n}" in words else 0.0 for n in LINEAR])
    m.state.set_frames(scale=about(np.diag(factors), centre))


def preset(m: Klartext, _: str, text: str, column: int) -> None:
    """Cycle 247: the preset with the number Q339."""
    found = re.search(rf"Q339\s*=\s*({VALUE})", text)
    if found is None:
        raise WordError("cycle 247 needs Q339, the number of the preset", column)
    m.state.set_frames(preset=shifted(m.state.frame_table(f"PRESET{m.values.number_of(found[1], column):g}")))


def tilt_cycle(m: Klartext, head: str, text: str, column: int) -> None:
    """Cycle 19: an angle that is left out keeps its value; none at all ends the plane."""
    text = re.sub(rf"\bF\s*{VALUE}", "", re.sub(rf"\b([ABC])\s*(?={VALUE})", r"SP\1", text))
    given = {n[2:]: i.value for n, i in m.only_words(head, text, column, "SPA SPB SPC ABST DIST").items() if n.startswith("SP")}
    tilt(m, {**m.tilt_angles, **given} if given else {}, column)


def plane(m: Klartext, head: str, text: str, column: int) -> None:
    """PLANE SPATIAL SPA SPB SPC and how it turns, or PLANE RESET."""
    m.settle()
    how = _SPATIAL.sub("", text)
    match = re.fullmatch(
        rf"\s*(STAY|TURN|MOVE)?(?:\s*(?:DIST|MB)\s*(?:MAX|{VALUE}))?(?:\s*F\s*(?:MAX|AUTO|{VALUE}))?\s*(?:SEQ([-+]))?\s*(?:COORD ROT|TABLE ROT)?\s*",
        how,
    )
    if match is None:
        raise WordError(f"'{how.strip()[:20]}' is not read in PLANE; write SPA SPB SPC, STAY, TURN or MOVE, SEQ", column)
    words = m.only_words(head, " ".join(_SPATIAL.findall(text)), column, "SPA SPB SPC")
    tilt(m, {n[2]: i.value for n, i in words.items()}, column, match[2] or "")


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
        m.values.q[{"A": "Q120", "B": "Q121", "C": "Q122"}.get(letter, "Q120")] = math.degrees(float(angle))


def _solution(m: Klartext, axis: np.ndarray, now: np.ndarray, sign: float, chosen: np.ndarray, column: int) -> np.ndarray:
    """The solution (2,) of the rotary axes whose tilting axis has a sign (SEQ); the turning axis goes the shorter way."""
    pairs, _ = m.out.kinematics.angles(axis)
    for tilted, turned in pairs[:, 0]:
        if tilted * sign > 1e-9 and not math.isnan(turned):
            return np.array([tilted, now[1] + (turned - now[1] + math.pi) % (2.0 * math.pi) - math.pi])
    if abs(chosen[0]) > 1e-9:
        raise WordError("SEQ asks for a solution that the rotary axes of this machine do not have; remove it", column)
    return chosen
