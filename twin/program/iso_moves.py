"""The moves of ISO programs: lines, arcs, polar coordinates, reference points, splines, threads, dwell, cutter radius; drilling cycles, G73 to G89."""

import math
import re

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.cycles import ASIDE, BACK, DWELL, MOVE, RAPID, Drilling, levels, pecks
from twin.program.expressions import WordError
from twin.program.frames import AXES, INDEX, LINEAR, OTHER, ROTARY
from twin.program.iso_blocks import MOST_REPEATS, POLAR, Iso
from twin.program.state import Block, Item

CYCLES = {73, 74, 76, 81, 82, 83, 84, 85, 86, 87, 88, 89}
USED_BY = {"P": {73, 74, 76, 82, 83, 84, 86, 87, 88, 89}, "Q": {73, 76, 83, 87}, "I": {76, 87}, "J": {76, 87}}
"""Word -> cycles that use it; its value is modal."""
CHIP_BREAK = 0.254e-3
"""Retract of G73; G83 resumes feed this far above the last depth [m]; LinuxCNC's value, a parameter on other controls."""
REFERENCES = {27, 28, 29, 30}
"""G codes of the reference point."""


def move_words(m: Iso, b: Block) -> None:
    """The motion of the block."""
    s, codes, w, places = m.state, b.codes, b.w, b.pick(*AXES)
    if w.keys() & set(POLAR):
        _radius_and_angle(m, b, places)
    if codes & REFERENCES:
        _reference(m, b, int(min(codes & REFERENCES)), places)
        return
    if m.linuxcnc and (codes & {5, 5.1} or (s.motion == 5 and places and not codes & {0, 1, 2, 3})):
        _spline(m, b, 5.1 if 5.1 in codes else 5, places)
        return
    if codes & {33, 33.1}:
        _thread(m, b, min(codes & {33, 33.1}), places)
        return
    vector, given = None, w.keys() & set("IJK")
    if 43.5 in codes or (s.out.modes.traori and s.motion in (0, 1) and given and not codes & {2, 3}):
        i, j, k = (b.take(n) for n in "IJK")
        vector = (i, j, k) if given else None
    if m.polar:
        _polar(m, places)
    if m.cycle is not None:
        drill_holes(m, b, places)
        return
    centre = b.pick("I", "J", "K") if s.motion in (2, 3) else {}
    if s.motion is None and places and not m.linuxcnc and not m.any_motion:
        s.motion = 0
        s.note("coordinates before any G0 or G1 are rapid moves; a parameter of the control decides this")
    m.any_motion = m.any_motion or s.motion is not None
    moves = bool(places or vector or (s.motion in (2, 3) and (centre or "R" in w)))
    if codes & {2, 3} and not moves:
        raise WordError("a circle needs its centre (I J K) or radius R, and an end point; add them")
    if not moves:
        return
    if s.motion is None:
        raise WordError("coordinates without a motion: G80 is in force; give G0 or G1")
    kind, machine = (mv.RAPID, mv.LINE, mv.ARC, mv.ARC)[s.motion], 53 in codes
    if machine and kind == mv.ARC:
        raise WordError("G53 goes with G0 or G1; give the arc in the work coordinates")
    start = m.corners.start()
    point, angles = m.control.target(places, machine, None if machine else start)
    arc = _arc(m, b, start, point, centre) if kind == mv.ARC else None
    corner = next(((n, w.pop(n)) for n in (",R", ",C") if n in w), None)
    if corner is not None and (kind == mv.RAPID or machine or vector):
        raise WordError(f"{corner[0]} belongs in a block with G1, G2 or G3 that another one follows; move it there", corner[1].column)
    move = m.control.move(kind, point, angles, vector, arc, machine)
    m.corners.queue(move, None if corner is None else (corner[0], corner[1].value * s.unit))
    if m.modal_macro is not None and all(frame.name != "G66" for frame in m.flow.frames):  # not after moves of the macro itself
        unit, at, variables = m.modal_macro
        m.flow.call(unit, at, dict(variables), "G66", style="macro")


def _arc(m: Iso, b: Block, start: np.ndarray, point: np.ndarray, centre: dict[str, Item]) -> arcs.Arc:
    """The arc of a block by I J K or R, with P - 1 turns more."""
    s, turns = m.state, 1.0
    radius = b.take("R") * s.unit if "R" in b.w else None
    if "P" in b.w:
        turns, _, column = b.w.pop("P")
        if turns != int(turns) or not 1 <= turns <= 10_000:
            raise WordError(f"P{turns:g}: the number of turns of an arc is a whole number from 1", column)
    in_plane = [n for n in centre if "IJK".index(n) in arcs.PLANES[s.plane][:2]]
    if s.centre_absolute and centre and len(in_plane) < 2:
        raise WordError("under G90.1 a circle needs both words of its centre; add the other")
    return m.control.arc_about(start, point, m.control.arc_centre(start, point, centre, radius), s.motion == 2, int(turns) - 1)


def _radius_and_angle(m: Iso, b: Block, places: dict[str, Item]) -> None:
    """@ and ^ of LinuxCNC: radius and angle about the program zero; a missing one is kept, with G91 they are added."""
    words, how = b.pick(*POLAR), "" if m.state.absolute else "IC"
    column = next(iter(words.values())).column
    if m.state.plane != 17 or places.keys() & {"X", "Y"}:
        raise WordError("@ and ^ stand for X and Y under G17; remove the other words", column)
    radius, angle = (words[n]._replace(how=how) if n in words else None for n in POLAR)
    _about_zero(m, places, radius, angle, column)


def _about_zero(m: Iso, places: dict[str, Item], radius: Item | None, angle: Item | None, column: int) -> None:
    """The first two axes of the plane from a radius and an angle about the zero of the program."""
    point = m.control.polar(np.zeros(3), m.corners.start(), radius, angle)
    places |= {LINEAR[i]: Item(point[i] / m.state.unit, "AC", column) for i in arcs.PLANES[m.state.plane][:2]}


def _polar(m: Iso, places: dict[str, Item]) -> None:
    """G16: the first axis of the plane is a radius, the second an angle, about the zero of the program; both are kept.

    With G91 the angle counts from the last one. A radius with G91 would be about the place of the tool, which is refused.
    """
    i, j, _ = arcs.PLANES[m.state.plane]
    if not places.keys() & {LINEAR[i], LINEAR[j]}:
        return
    if m.polar_place is None:
        u, v = m.corners.start()[[i, j]] / m.state.unit
        m.polar_place = math.hypot(u, v), math.degrees(math.atan2(v, u))
    radius, angle = m.polar_place
    column = next(iter(places.values())).column
    if LINEAR[i] in places and not m.state.absolute:
        text = f"{LINEAR[i]} under G16 and G91 is a radius about the place of the tool, which is not read; use G90"
        raise WordError(text, places[LINEAR[i]].column)
    if LINEAR[i] in places:
        radius = places[LINEAR[i]].value
    if LINEAR[j] in places:
        angle = places[LINEAR[j]].value + (0.0 if m.state.absolute else angle)
    m.polar_place = radius, angle
    _about_zero(m, places, Item(radius), Item(angle), column)


def _reference(m: Iso, b: Block, number: int, places: dict[str, Item]) -> None:
    """G28, G30: through the point of the block to the reference point; G29: back through that point; G27: to the point alone. Rapid."""
    s, control = m.state, m.control
    if number == 29 and m.between is not None:
        control.go(mv.RAPID, *m.between)
    if number in (27, 29):
        s.note("G27: a rapid move; that it ends at the reference point is not checked") if number == 27 else None
        control.go(mv.RAPID, *control.target(places))
        return
    home = m.offsets.reference[number]
    if number == 30 and "P" in b.w and (which := int(b.take("P"))) != 2:
        home = s.frame_table(f"G30P{which}")
    s.note("G28, G30: the reference point is the zero of the axes, or [frame.G28] x_m .. of the machine file")
    point, angles = control.target(places)
    if places:
        control.go(mv.RAPID, point, angles)
        m.between = point, angles
    s.other_axes |= dict.fromkeys(places.keys() - INDEX.keys(), 0.0)
    control.to_home(home, places or (*LINEAR, *ROTARY))


def keep_home(m: Iso, _: Block, number: float) -> None:
    """G28.1, G30.1: this place is the reference point."""
    m.offsets.reference[int(number)] = np.array([*m.out.position[:3], *m.values.place()[3:]])


def _spline(m: Iso, b: Block, number: float, places: dict[str, Item]) -> None:
    """G5 and G5.1 of LinuxCNC: a cubic or quadratic Bezier curve in the XY plane, as chords."""
    s = m.state
    if s.plane != 17 or places.keys() - {"X", "Y"} or s.comp is not None or not s.feed > 0.0:
        raise WordError(f"G{number:g} moves X and Y under G17 with a feed, outside G41 and G42; correct the block")
    needed = "IJPQ" if number == 5 else "IJ"
    given = {n: item.value * s.unit for n, item in b.pick(*needed).items()}
    if number == 5 and s.motion == 5 and not given.keys() & {"I", "J"}:
        given["I"], given["J"] = (-v for v in m.spline_arm)  # the next curve goes on smoothly
    if set(needed) - given.keys():
        raise WordError(f"G{number:g} needs {' '.join(needed)}; add them")
    start = s.here()
    point, _ = m.control.target(places)
    near = start + np.array([given["I"], given["J"], 0.0])
    far = point + np.array([given["P"], given["Q"], 0.0]) if number == 5 else near
    if number == 5.1:
        near, far = start + (near - start) * 2.0 / 3.0, point + (far - point) * 2.0 / 3.0
    for end in arcs.bezier_chords(np.array([start, near, far, point])):
        m.control.go(mv.LINE, end)
    s.note("G5, G5.1: the curve as chords within 0.5 um")
    s.motion, m.spline_arm = (5, (given["P"], given["Q"])) if number == 5 else (None, (0.0, 0.0))


def _thread(m: Iso, b: Block, number: float, places: dict[str, Item]) -> None:
    """G33 and G33.1 of LinuxCNC: a line with K per turn of the spindle; G33.1 (tapping) returns along it."""
    s = m.state
    text = f"G{number:g} needs K, the pitch, and a spindle speed S; add them"
    pitch = b.need("K", text).value
    if not s.out.modes.spindle > 0.0:
        raise WordError(text)
    start, feed = s.here(), s.feed
    s.feed = abs(pitch) * s.out.modes.spindle
    s.note("G33, G33.1: a line at K times S; the angle of the spindle is not simulated")
    m.control.go(mv.LINE, *m.control.target(places))
    if number == 33.1:
        m.control.go(mv.LINE, start)
    s.feed, s.motion = feed, None


def dwell(m: Iso, b: Block, _: float) -> None:
    """G4: P in s or, written whole on a Fanuc, in ms; X, U in s."""
    name = next((n for n in ("X", "U") if n in b.w and "P" not in b.w and not m.linuxcnc), "P")
    item = b.need(name, "G4 needs its time, e.g. G4 P1.5")
    seconds = item.value
    if name == "P" and not m.linuxcnc:
        text = m.flow.frame.unit.lines[m.flow.frame.at]
        if "." not in re.split(r"[^\d.+\-]", text[item.column :].lstrip())[0]:
            seconds /= 1000.0
            m.state.note("G4 P without a decimal point is in ms, as on a Fanuc; write P1.5 or a .ngc file for seconds")
    m.control.dwell(seconds)


def path_mode(m: Iso, b: Block, number: float) -> None:
    """G61, G61.1, G64: exact path, exact stop, rounding within P."""
    s = m.state
    if number == 64:
        if "R" in b.w and 19 in b.m:
            raise WordError("R may belong to G64 or to M19 here; write two blocks", b.w["R"].column)
        if b.pick("R"):
            s.note("G64 R: a setting of the planner of LinuxCNC, without effect on the path")
        if b.pick("Q"):
            s.note("G64 Q: merging of collinear blocks, which the rounding here always does")
        s.set_tolerances(b.take("P"), None)
    elif number == 61.1 and not m.linuxcnc:
        s.note("G61.1: high accuracy of Mazak and Mitsubishi, corners are rounded as under G64; in .ngc files an exact stop")
    elif number == 61 and m.linuxcnc:
        s.out.change(tolerance=1e-6)
        s.note("G61: exact path, a rounding of 1 um")
    elif number == 61:
        s.note("G61: exact stop; in .ngc files exact path, without a stop")
    s.out.change(rounding=60 if number == (61.1 if m.linuxcnc else 61) else 64)


def _radius_of(m: Iso, d: Item) -> float:
    """Radius [m] selected by a D word of a Fanuc; D0 selects none."""
    return 0.0 if d.value == 0 else m.state.tools.radius(f"{d.value:g}", d.column)


def other_radius(m: Iso, d: Item) -> None:
    """D without G41 or G42 on a Fanuc: the radius of the next G41 or G42; inside one it must not change the radius."""
    m.edge = d
    if m.state.comp is not None and abs(_radius_of(m, d)) != m.state.comp.tool_radius:
        raise WordError("D changes the radius inside G41 or G42; write G40 and a move before", d.column)


def compensation(m: Iso, b: Block, number: float) -> None:
    """G40 to G42.1: the radius is that of D, else that of the last D, else that of the tool."""
    s, d = m.state, b.w.pop("D", None)
    if number == 40:
        m.control.compensate(0, 0.0)
        return
    if number in (41.1, 42.1) and d is None:
        raise WordError("G41.1 and G42.1 need D, the diameter of the tool", b.column)
    if d is not None and number in (41.1, 42.1):
        radius = 0.5 * d.value * s.unit
    else:
        m.edge = d or (m.edge and m.edge._replace(column=b.column))
        radius = _radius_of(m, m.edge) if m.edge else s.tools.radius(s.tools.name, b.column)
    if not radius:
        s.note("G41, G42 with radius 0: the contour is the path")
    elif not m.linuxcnc:
        s.note("G41, G42: the tool comes to the contour at a right angle to it, as on a Fanuc; in .ngc files beside its first corner")
    m.control.compensate(1 if number < 42 else -1, radius)


def drill_holes(m: Iso, b: Block, places: dict[str, Item]) -> None:
    """A drilling cycle at the holes of the block."""
    s, w, number, linuxcnc = m.state, b.w, m.cycle, m.linuxcnc
    assert number is not None
    across = arcs.PLANES[s.plane][2]
    turned = {n: places.pop(n) for n in (*ROTARY, *OTHER) if n in places}
    for name in turned if linuxcnc else ():
        raise WordError(f"Cannot put {name} in a canned cycle; move {name} in a block before", turned[name].column)
    absolute = {n: s.absolute or places[n].how == "AC" for n in places}  # G16 gives places
    for name in "RPQIJ":
        if name in w:
            if number not in USED_BY.get(name, CYCLES) or (linuxcnc and name == "P" and number in (73, 83)):
                s.note(f"G{number}: {name} is not used by this cycle; one that uses it finds it")
            m.sticky[name], m.given_absolute[name] = b.take(name), s.absolute
    depth_axis, named = LINEAR[across], {n: item.value for n, item in places.items()}
    if depth_axis in named:
        m.sticky["Z"], m.given_absolute["Z"] = named.pop(depth_axis), s.absolute
    repeats = 1
    for name, item in b.pick("L", "K").items():
        repeats = int(item.value)
        if repeats != item.value:
            raise WordError(f"{name}{item.value:g} is not a whole number of repetitions; correct it", item.column)
    if not (places or turned or b.codes & CYCLES or repeats != 1):
        return
    if "Z" not in m.sticky or "R" not in m.sticky:
        raise WordError(f"G{number} needs {depth_axis if 'Z' not in m.sticky else 'R'}; add it")
    if number in (73, 83) and not m.sticky.get("Q", 0.0) > 0.0:
        raise WordError(f"G{number} needs Q, the depth of one peck, above 0; add it")
    if not s.feed > 0.0:
        m.control.feed_given(0.0)
    s.outside_compensation("a drilling cycle is")
    if repeats > MOST_REPEATS:
        raise WordError(f"the cycle repeats more than {MOST_REPEATS} times")
    initial, start_height = m.initial / s.unit, float(s.here()[across]) / s.unit
    kept = m.given_absolute["R"], m.given_absolute["Z"]
    of_r, of_z = (s.absolute, s.absolute) if linuxcnc else kept
    safe = m.sticky["R"] + (0.0 if of_r else initial)
    depth = m.sticky["Z"] + (0.0 if of_z else safe)
    if kept != (s.absolute, s.absolute):
        here = "are taken anew by the mode in force, as on LinuxCNC; other controls keep the levels"
        s.note(
            f"G90, G91 in an active cycle: R and Z {here if linuxcnc else 'keep their levels, as on a Fanuc; in .ngc files they are taken anew'}"
        )
    if linuxcnc and s.plane != 17 and number in (74, 84):
        raise WordError(f"G{number} outside G17 is not read: LinuxCNC itself moves other axes there; write the moves")
    if (depth > safe) != (number == 87) and depth != safe:
        where = "below" if number == 87 else "above"
        raise WordError(f"G{number}: {depth_axis} {depth:g} lies {where} R {safe:g}; correct one")
    cycle = _drilling(m, number, safe, depth, max(safe, initial) if s.retract_to_start else safe)
    angles = m.control.target(turned)[1]
    if start_height < safe and number != 87:
        m.control.height(safe)
    for _ in range(repeats):
        point = s.here()
        for name, value in named.items():
            i = INDEX[name]
            point[i] = value * s.unit + (0.0 if absolute[name] else point[i])
        m.control.go(mv.RAPID, point, angles)
        if number == 87:
            wait = [(DWELL, cycle.dwell, RAPID)] if cycle.dwell else []
            inward = [(ASIDE, start_height, RAPID), (MOVE, safe, RAPID), (BACK, safe, RAPID), (MOVE, depth, 1.0), *wait]
            m.control.steps([*inward, (ASIDE, depth, RAPID), (MOVE, initial, RAPID), (BACK, initial, RAPID)], cycle.aside)
            continue
        m.control.drill(cycle)


def _drilling(m: Iso, number: int, safe: float, depth: float, clear: float) -> Drilling:
    """The cycle with its modal words."""
    s, linuxcnc, aside = m.state, m.linuxcnc, (0.0, 0.0)
    if number in (76, 87):
        aside = m.sticky.get("I", 0.0), m.sticky.get("J", 0.0)
        if not any(aside):
            aside = abs(m.sticky.get("Q", 0.0)), 0.0
            s.note("G76, G87: the tool steps aside by Q along the first axis, towards +; a parameter on the control")
    if number == 88:
        s.note("G88: the halt at the bottom is omitted")
    pause = m.sticky.get("P", 0.0) if number in USED_BY["P"] and not (linuxcnc and number in (73, 83)) else 0.0
    if pause and not linuxcnc:
        pause /= 1000.0
        s.note("P of drilling cycles is a dwell in ms, as on a Fanuc; in .ngc files in s, and G81, G83 use none")
    infeeds = levels(safe, depth, m.sticky["Q"]) if number in (73, 83) else ()
    if number in (73, 83):
        s.note("G73, G83: the tool backs off by 0.254 mm, a parameter on the control")
    out = 1.0 if number in (74, 84, 85, 89) else RAPID
    way = pecks(infeeds, CHIP_BREAK / s.unit, number == 73)
    return Drilling(safe, depth, clear, way, pause, out=out, feed_all_the_way=linuxcnc, aside=aside)
