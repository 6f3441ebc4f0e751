"""The frames of ISO programs: zero offsets (G54 to G59, G10), shifts (G92, G52), turned and scaled planes (G68, G51), tilted planes (G68.2)."""

import numpy as np

from twin.program import arcs
from twin.program.expressions import WordError, needed
from twin.program.frames import AXES, INDEX, LINEAR, NO_FRAME, OTHER, ROTARY, Frame, about, mirrored, rotation, shifted
from twin.program.iso_blocks import ISO_FRAMES, Iso
from twin.program.iso_values import SYSTEMS
from twin.program.state import Block


def _named_offsets(m: Iso, b: Block) -> dict[int, float]:
    """Axes and values [m, rad] of the block."""
    for name, item in b.pick(*OTHER).items():
        if item.value:
            raise WordError(f"an offset of {name} cannot be set on this machine")
    return {INDEX[name]: m.state.si(name, item.value) for name, item in b.pick(*LINEAR, *ROTARY).items()}


def choose_system(m: Iso, b: Block, number: float) -> None:
    """G54 to G59.3; G54.1 P, G154 P and G110 to G129 are additional ones."""
    if 110 <= number < 130:  # Haas
        m.offsets.choose(f"G54.1P{number - 109:g}")
    elif number in (54.1, 154) or (number == 54 and "P" in b.w and not m.linuxcnc):
        extra = b.need("P", f"G{number:g} needs P, the number of the offset", b.column).value
        m.offsets.choose(f"G54.1P{int(extra)}")
    else:
        m.offsets.choose(f"G{number:g}")


def _g10_tool(m: Iso, b: Block, what: int) -> None:
    """G10 L10 to L13 of Fanuc (length, its wear, radius, its wear), L1 of LinuxCNC (Z, R).

    Without L (`what` 0): a Fanuc whose offsets are one list, where the same number serves as length and as radius.
    """
    s = m.state
    if what in (50, 51, 52) and not m.linuxcnc:
        s.note("G10 L50 .. G11: parameters of the control, understood, no effect on the motion")
        m.parameter_lines = True
        return
    length, radius = ("length",), ("radius",)
    of_r = {0: length + radius, 10: length, 11: length, 12: radius, 13: radius}
    given: dict[int, dict[str, tuple[str, ...]]] = (
        {1: {"Z": length, "R": radius}} if m.linuxcnc else {number: {"R": quantities} for number, quantities in of_r.items()}
    )
    text = f"G10 L{what} is not supported: it writes what is not simulated; give [tool] in the machine file"
    quantities = needed(given.get(what), text, b.column)
    name, wear = f"{b.need('P', 'G10 needs P, the number of the tool or offset; add it', b.column).value:g}", what in (11, 13)
    for letter, item in b.pick(*quantities).items():
        for quantity in quantities[letter]:
            adds = not s.absolute and not m.linuxcnc  # G91 adds on a Fanuc
            old = (s.tools.value(name, quantity, wear=wear) or 0.0) if adds else 0.0
            s.tools.set_value(name, quantity, old + item.value * s.unit, wear=wear)


def g10(m: Iso, b: Block, _: float) -> None:
    """G10: zero offsets (L2, L20) and tools."""
    s = m.state
    tool_alone = "L" not in b.w and not m.linuxcnc and "R" in b.w and not b.w.keys() & set(AXES)
    what = 0 if tool_alone else int(b.take("L", 2.0))
    if what not in (2, 20):
        _g10_tool(m, b, what)
        return
    number = int(b.take("P"))
    if what == 20 and not m.linuxcnc:
        s.note(
            f"G10 L20: it sets the additional offset G54.1 P{number}, as on a Fanuc; on LinuxCNC (.ngc), grbl and Mach this place gets the coordinates"
        )
        name, what = f"G54.1P{number}", 2
    elif 0 <= number <= len(SYSTEMS):
        name = SYSTEMS[number - 1] if number else m.offsets.system
    else:
        raise WordError(f"G10 P{number}: there is no such zero offset; use P1 to P9", b.column)
    m.offsets.turned[name] = b.take("R", m.offsets.turned.get(name, 0.0))
    place, turn = np.array(s.out.position[:3]), rotation(2, m.offsets.turned[name])
    new = m.offsets.of(name).copy()
    named = _named_offsets(m, b)
    if what == 20:
        shift = m.offsets.shift[:3]
        wanted = turn.T @ (place - new[:3]) - shift
        wanted = np.array([named.get(i, wanted[i]) for i in range(3)])
        new[:3] = place - turn @ (wanted + shift)
        for i in (3, 4):
            if i in named:
                new[i] = s.out.position[i] - named[i]
    else:
        for i, value in named.items():
            new[i] = value if s.absolute or m.linuxcnc else new[i] + value  # G91 adds on a Fanuc
    m.offsets.systems[name] = new
    if name == m.offsets.system:
        m.offsets.set_frames()


def g92(m: Iso, b: Block, _: float) -> None:
    """G92: this place gets the coordinates."""
    named = _named_offsets(m, b)
    if not named:
        raise WordError("G92 needs a coordinate, e.g. G92 X0", b.column)
    here, shift = m.values.place(), m.offsets.shift.copy()
    for i, value in named.items():
        shift[i] += here[i] - value
    m.offsets.shift_kept, m.offsets.shift_on = shift, True
    m.offsets.set_frames()


def g92_off(m: Iso, _: Block, number: float) -> None:
    """G92.1 clears the shift, G92.2 keeps it, G92.3 restores it."""
    if number == 92.1:
        m.offsets.shift_kept = np.zeros(5)
    m.offsets.shift_on = number == 92.3
    m.offsets.set_frames()


def g52(m: Iso, b: Block, _: float) -> None:
    """G52: a local shift; that of G92 on LinuxCNC."""
    if not m.linuxcnc:
        m.state.note("G52: a local shift beside that of G92, as on a Fanuc; in .ngc files the same as G92")
    for i, value in _named_offsets(m, b).items():
        if m.linuxcnc:
            m.offsets.shift_kept, m.offsets.shift_on = m.offsets.shift.copy(), True
            m.offsets.shift_kept[i] = value
        else:
            m.offsets.local[i] = value
    m.offsets.set_frames()


def local_map(m: Iso, b: Block, number: float) -> None:
    """G51.1 and G101 (mirror), G51 (scale), G68 (turn) and the codes that end them."""
    s = m.state
    if number == 69:
        s.untilt()
    if np.any(m.offsets.shift):
        s.note("G68, G51: their centre is in the coordinates before G92")
    places = {LINEAR.index(n): item.value * s.unit for n, item in b.pick(*LINEAR).items()}
    if number in (51.1, 101):
        if number == 101 and any(places.values()):
            raise WordError("G101 mirrors about the zero of the program; write 0 behind its axes, or use G51.1", b.column)
        m.mirrors |= places
    elif number in (50.1, 100):
        m.mirrors = {i: at for i, at in m.mirrors.items() if places and i not in places}
    elif number == 51:
        factors = [b.take(n, 1.0) for n in "IJK"] if b.w.keys() & set("IJK") else []
        factors = [b.take("P")] * 3 if "P" in b.w else factors
        factors = [f / 1000.0 if abs(f) > 100 else f for f in factors]  # a whole number above 100 counts in thousandths
        if not factors or not all(factors):
            raise WordError("G51 needs one factor P, or I J K, other than 0", b.column)
        s.frames["scale"] = about(np.diag(factors), _centre(m, "scale", places))
    elif number == 68:
        s.frames["turn"] = about(rotation(arcs.PLANES[s.plane][2], b.take("R")), _centre(m, "turn", places))
    else:
        s.frames["scale" if number == 50 else "turn"] = NO_FRAME
    s.set_frames(mirror=about(mirrored([LINEAR[i] for i in m.mirrors]), np.array([m.mirrors.get(i, 0.0) for i in range(3)])))


def _centre(m: Iso, name: str, places: dict[int, float]) -> np.ndarray:
    """The centre (3,) of a frame in its outer coordinates: as programmed, else the position of the tool."""
    whole = NO_FRAME
    for inner in ISO_FRAMES[ISO_FRAMES.index(name) : -1]:
        whole = whole @ m.state.frames[inner]
    here = (whole @ shifted(np.append(m.state.here(), [0.0, 0.0]))).shift
    return np.array([places.get(i, here[i]) for i in range(3)])


def tilt(m: Iso, b: Block, _: float) -> None:
    """G68.2: a plane by its origin and the Euler angles I (about z), J (about x), K (about z)."""
    origin = [b.take(n) * m.state.unit for n in LINEAR]
    matrix = rotation(2, b.take("I")) @ rotation(0, b.take("J")) @ rotation(2, b.take("K"))
    m.state.tilt(Frame(matrix, np.array([*origin, 0.0, 0.0])))
    m.state.note("G68.2: the tool is perpendicular to the plane at once; A and C turn with the next move")
