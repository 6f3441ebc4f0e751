"""The drilling cycles of ISO programs, G73 to G89."""

from __future__ import annotations

from twin.program import arcs
from twin.program import moves as mv
from twin.program.cycles import ASIDE, BACK, DWELL, FEED, RAPID, Drilling, levels, pecks
from twin.program.expressions import WordError
from twin.program.frames import INDEX, LINEAR, OTHER, ROTARY
from twin.program.iso_blocks import Iso
from twin.program.state import Block, Item

CYCLES = {73, 74, 76, 81, 82, 83, 84, 85, 86, 87, 88, 89}
USED_BY = {"P": {73, 74, 76, 82, 83, 84, 86, 87, 88, 89}, "Q": {73, 76, 83, 87}, "I": {76, 87}, "J": {76, 87}}
"""Word -> cycles that use it; its value is modal."""
MOST_REPEATS = 10_000
CHIP_BREAK = 0.254e-3
"""Retract of G73, and distance above the last depth at which G83 resumes feed [m]; LinuxCNC's value, a parameter on other controls."""


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
    if s.comp is not None:
        raise WordError("a drilling cycle is inside G41 or G42; write G40 before")
    if repeats > MOST_REPEATS:
        raise WordError(f"the cycle repeats more than {MOST_REPEATS} times")
    initial, start_height = m.initial / s.unit, float(s.here()[across]) / s.unit
    as_given = {"R": s.absolute, "Z": s.absolute} if linuxcnc else m.given_absolute
    safe = m.sticky["R"] + (0.0 if as_given["R"] else initial)
    depth = m.sticky["Z"] + (0.0 if as_given["Z"] else safe)
    if (as_given["R"], as_given["Z"]) != (m.given_absolute["R"], m.given_absolute["Z"]):
        s.note("G90, G91 in an active cycle: R and Z are taken anew by the mode in force, as on LinuxCNC; other controls keep the levels")
    elif not linuxcnc and not s.absolute == as_given["R"] == as_given["Z"]:
        s.note("G90, G91 in an active cycle: R and Z keep their levels, as on a Fanuc; in .ngc files they are taken anew")
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
            wait = [(DWELL, cycle.dwell, 1.0)] if cycle.dwell else []
            inward = [(ASIDE, start_height, 1.0), (RAPID, safe, 1.0), (BACK, safe, 1.0), (FEED, depth, 1.0), *wait]
            m.control.steps([*inward, (ASIDE, depth, 1.0), (RAPID, initial, 1.0), (BACK, initial, 1.0)], cycle.aside)
            continue
        if abs(s.here()[across] / s.unit - safe) > 1e-12:
            m.control.height(safe)
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
    out = FEED if number in (74, 84, 85, 89) else RAPID
    way = pecks(infeeds, CHIP_BREAK / s.unit, number == 73)
    return Drilling(safe, depth, clear, way, pause, out=out, feed_all_the_way=linuxcnc, aside=aside)
