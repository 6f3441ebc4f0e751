"""The motion blocks of SINUMERIK programs: lines, arcs, tool axes, polar coordinates, fixed points, dwell; and their programmable frames."""

import math

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.control import Vector
from twin.program.expressions import WordError, needed
from twin.program.frames import AXES, INDEX, LINEAR, NO_FRAME, OTHER, ROTARY, Frame, rotation, rotation_xyz
from twin.program.sinumerik_blocks import Block, Sinumerik
from twin.program.sinumerik_values import Written
from twin.program.state import Item


def orientation(m: Sinumerik, b: Block) -> Vector | None:
    """The tool axis of a block, by a vector or by angles."""
    by_vector, by_angles = (not b.w.keys().isdisjoint(names) for names in (("A3", "B3", "C3"), ("A2", "B2", "C2")))
    if not by_vector and not by_angles:
        return None
    if not m.out.modes.traori:
        raise WordError("A3= B3= C3= need TRAORI; switch it on before, or program A= and C=")
    if by_vector:
        return b.take("A3"), b.take("B3"), b.take("C3")
    if m.state.angles_are_rpy is None:
        raise WordError("A2= B2= C2= count as the control is set; write ORIRPY or ORIEULER before")
    x, y, z = b.take("A2"), b.take("B2"), b.take("C2")
    matrix = rotation_xyz({"X": x, "Y": y, "Z": z}) if m.state.angles_are_rpy else rotation(2, x) @ rotation(0, y) @ rotation(2, z)
    return float(matrix[0, 2]), float(matrix[1, 2]), float(matrix[2, 2])


def motion_block(m: Sinumerik, b: Block, vector: Vector | None, machine: bool) -> None:
    """One motion block: target, tool axis, arc, corner."""
    s, codes, extra, places, centre = m.state, b.codes, b.w, b.pick(*AXES), b.pick("I", "J", "K")
    about_pole = bool(extra.keys() & {"AP", "RP"}) and not centre and "CR" not in extra
    _polar(m, b, places)
    _slanted(m, b, places)
    if vector and places.keys() & {"A", "C"}:
        raise WordError("the tool axis is given twice, by A3= B3= C3= and by A= C=; keep one")
    if "RNDM" in extra:
        m.corners.every_corner = max(0.0, b.take("RNDM")) * s.unit
    corner = next(((n, b.take(n) * s.unit) for n in ("RND", "CHF", "CHR") if n in extra), None)
    kind = (mv.RAPID, mv.LINE, mv.ARC, mv.ARC)[s.motion if s.motion is not None else 1]
    if codes & {331, 332, 63}:
        kind = mv.LINE
        _tap(m, b, centre)
    if extra.pop("POS", None) is not None and len(places) == 1 and not codes:
        kind = mv.RAPID
    by_words = extra.keys() & {"CR", "AR", "TURN", "I1", "J1", "K1"}
    moves = bool(places or vector or (centre and kind == mv.ARC) or (by_words and (codes & {2, 3} or b.curve)))
    if (centre or by_words) and (not moves or kind != mv.ARC):
        missing = "it to the block" if moves else "the motion and its end point"
        raise WordError(f"I J K, CR= (in .ngc files R) and TURN= belong to G2 or G3; add {missing}")
    if not moves and corner:
        raise WordError(f"{corner[0]} belongs in the block of a move; write it there")
    if not moves:
        return
    start = np.array(m.out.position[:3]) if machine else m.corners.start()
    if machine or places.keys() & set(ROTARY) or vector:
        m.corners.release()
    note_increments(m, places)
    point, angles = m.control.target(places, machine, start)
    if kind == mv.ARC and about_pole and not b.curve and "AR" not in extra:
        centre |= {"IJK"[i]: Item(m.pole[i] / s.unit, "AC") for i in arcs.PLANES[s.plane][:2]}
    arc = _arc(m, b, start, point, centre) if kind == mv.ARC else None
    m.corners.queue(m.control.move(kind, point, angles, vector, arc, machine), corner)


def _arc(m: Sinumerik, b: Block, start: np.ndarray, point: np.ndarray, centre: dict[str, Item]) -> arcs.Arc:
    """The arc of the block; AR= sets the end `point` (3,)."""
    s, clockwise, turns = m.state, m.state.motion == 2, int(b.take("TURN"))
    if not 0 <= turns <= 10_000:
        raise WordError(f"TURN={turns} is out of range; give 0 to 10000")
    if b.curve == "CIP":
        middle = start.copy()
        for i, name in enumerate(("I1", "J1", "K1")):
            if name in b.w:
                item = b.w.pop(name)
                middle[i] = item.value * s.unit + (start[i] if s.is_relative(item.how) else 0.0)
        return arcs.through(start, middle, point)
    if b.curve == "CT":
        direction = needed(m.corners.direction(), "CT needs a move before it, whose direction it continues; use CIP or G2")
        return arcs.tangential(start, direction, point, s.plane)
    if "AR" in b.w:
        middle = _by_angle(m, b, start, point, centre, clockwise)
        return m.control.arc_about(start, point, middle, clockwise, turns)
    radius = b.take("CR") * s.unit if "CR" in b.w else None
    return m.control.arc_about(start, point, m.control.arc_centre(start, point, centre, radius), clockwise, turns)


def _by_angle(m: Sinumerik, b: Block, start: np.ndarray, point: np.ndarray, centre: dict[str, Item], clockwise: bool) -> np.ndarray:
    """Centre (3,) of an arc by its angle AR= and its end, or its centre, which then gives the end `point` (3,)."""
    item = b.w.pop("AR")
    if not 0.0 < item.value < 360.0:
        raise WordError(f"AR={item.value:g}: the angle of an arc lies between 0 and 360 degrees", item.column)
    *plane, across = arcs.PLANES[m.state.plane]
    angle = -item.value if clockwise else item.value
    if centre:
        middle = m.control.arc_centre(start, point, centre, None)
        point[plane] = (middle + rotation(across, angle) @ (start - middle))[plane]
        return middle
    middle, chord = start.copy(), point[plane] - start[plane]
    middle[plane] += 0.5 * chord + 0.5 / math.tan(math.radians(0.5 * angle)) * np.array([-chord[1], chord[0]])
    return middle


def _tap(m: Sinumerik, b: Block, centre: dict[str, Item]) -> None:
    """G331, G332: along the thread; the feed is pitch times speed. G63 uses the active feed."""
    if 63 in b.codes:
        return
    s, modes, across = m.state, m.out.modes, "IJK"[arcs.PLANES[m.state.plane][2]]
    pitch = abs(needed(centre.pop(across, None), f"G331 and G332 need the pitch {across}; add it").value)
    if not modes.spindle:
        raise WordError("G331 and G332 need a spindle speed; give S before")
    s.set_feed_mode(94)
    s.feed = pitch * modes.spindle * s.unit / modes.feed_unit


def _polar(m: Sinumerik, b: Block, places: dict[str, Item]) -> None:
    """AP= and RP=: angle and radius about the pole."""
    if not b.w.keys() & {"AP", "RP"}:
        return
    point = m.control.polar(m.pole, m.corners.start(), b.w.pop("RP", None), b.w.pop("AP", None))
    for i in arcs.PLANES[m.state.plane][:2]:
        if LINEAR[i] in places:
            raise WordError(f"{LINEAR[i]} cannot be combined with AP= and RP=; keep one", places[LINEAR[i]].column)
        places[LINEAR[i]] = Item(point[i] / m.state.unit, "AC", 1)


def _slanted(m: Sinumerik, b: Block, places: dict[str, Item]) -> None:
    """ANG=: a line at an angle to the first axis of the plane; one coordinate is given."""
    if "ANG" not in b.w:
        return
    item, s, here = b.w.pop("ANG"), m.state, m.corners.start()
    i, j, _ = arcs.PLANES[s.plane]
    if (LINEAR[i] in places) == (LINEAR[j] in places):
        raise WordError(f"ANG= needs one of {LINEAR[i]} and {LINEAR[j]} as the end of the line", item.column)
    slope = math.tan(math.radians(item.value))
    if LINEAR[j] in places:
        i, j, slope = j, i, 1.0 / slope if slope else math.inf
    if abs(slope) > 1e9:
        raise WordError("ANG= runs along the other axis; give that coordinate", item.column)
    value = places[LINEAR[i]]
    way = value.value * s.unit - (0.0 if s.is_relative(value.how) else here[i])
    places[LINEAR[j]] = Item((here[j] + way * slope) / s.unit, "AC", item.column)


def set_pole(m: Sinumerik, b: Block, number: float) -> None:
    """G110 to G112: from the position, the zero of the work, the last pole."""
    base = {110: m.corners.start(), 111: np.zeros(3), 112: m.pole}[int(number)].copy()
    if b.w.keys() & {"AP", "RP"}:
        radius, angle = Item(b.take("RP")), Item(b.take("AP"))
        base = m.control.polar(base, base, radius, angle)
    for name, item in b.pick(*AXES).items():
        if name not in LINEAR:
            raise WordError(f"{name} is no coordinate of a pole", item.column)
        base[INDEX[name]] += item.value * m.state.unit
    m.pole = base


def fixed_point(m: Sinumerik, b: Block, number: float) -> None:
    """G74, G75: rapid move of the named axes to their zero, or to [frame.G75]."""
    m.corners.release()
    b.w.pop("FP", None)
    m.state.note("G74, G75: the point is the zero of the axes, or [frame.G75] x_m .. of the machine file")
    traori = m.out.modes.traori
    m.state.transform(False)
    m.control.to_home(m.state.frame_table(f"G{number:g}"), b.pick(*AXES))
    m.state.transform(traori)


def dwell(m: Sinumerik, b: Block) -> None:
    """G4: F in s, S in turns of the spindle."""
    alone = not (b.names or b.calls) and b.codes == {4}
    if not alone or b.w.keys() not in ({"F"}, {"S"}):
        raise WordError("G4 must be alone in its block with one time, e.g. G4 F<seconds>; write the rest in another block")
    m.corners.release()
    if "S" in b.w and not m.out.modes.spindle:
        raise WordError("G4 S<turns> needs a spindle speed before; give S or use G4 F<seconds>")
    m.control.dwell(b.take("F") if "F" in b.w else b.take("S") * 60.0 / m.out.modes.spindle)


def note_increments(m: Sinumerik, coordinates: dict[str, Item]) -> None:
    """State the assumption where an axis goes on by an increment behind a change of its offset."""
    s = m.state
    for name, (_, how, _) in coordinates.items():
        i = INDEX.get(name)
        if i in s.shifted and s.is_relative(how) and s.shifted[i] == s.out.position[i]:
            s.note(
                "G91, IC() behind a change of the frame: the increment alone is moved, not the change (SD42440 0; with 1 the control adds it)"
            )


def frame_words(m: Sinumerik, b: Block, word: Written | float) -> None:
    """TRANS, ROT, SCALE, MIRROR and their additions; G58, G59."""
    m.corners.release()
    values = {n: i.value for n, i in b.pick(*AXES).items()}
    for name in OTHER:
        if values.pop(name, 0.0):
            raise WordError(f"a shift of {name} cannot be set on this machine")
    if not isinstance(word, Written):
        part = "program" if word == 58 else "fine"
        old = m.state.frames[part]
        places = old.shift.copy()
        for axis, value in values.items():
            places[INDEX[axis]] = m.state.si(axis, value)
        m.state.set_frames(**{part: Frame(old.matrix, places)})
        return
    name = word.name
    if word.text is not None and word.text.strip():
        raise WordError(f"{name} takes its axes as words, e.g. {name} X10", word.column)
    if not name.endswith("TRANS") and set(values) & set(ROTARY):
        raise WordError(f"{name} of A or C is not supported; let the CAM system output the final coordinates")
    if name.endswith("ROTS") and values:
        raise WordError(f"{name} is not supported: a turn by angles in space; use ROT with X Y Z")
    inner = m.values.frame_of("ROT" if "ROT" in name else name.removeprefix("A"), values)
    if name.endswith("ROT") and "RPL" in b.w:
        inner = Frame(rotation(arcs.PLANES[m.state.plane][2], b.take("RPL")), np.zeros(5))
    if name.startswith("A"):
        m.state.set_frames(program=m.state.frames["program"] @ inner)
    else:
        m.state.set_frames(program=inner, fine=NO_FRAME)
