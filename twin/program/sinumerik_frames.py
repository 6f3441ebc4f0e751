"""The programmable frames of SINUMERIK programs: TRANS, ROT, SCALE, MIRROR, G58, G59."""

from __future__ import annotations

import numpy as np

from twin.program import arcs
from twin.program.expressions import WordError
from twin.program.frames import INDEX, LINEAR, NO_FRAME, OTHER, ROTARY, Frame, mirrored, rotation, rotation_xyz, shifted
from twin.program.sinumerik_blocks import Block, Sinumerik
from twin.program.state import Item
from twin.program.words import Word


def note_increments(m: Sinumerik, coordinates: dict[str, Item]) -> None:
    """State the assumption where an axis goes on by an increment behind a change of its offset."""
    s = m.state
    for name, (_, how, _) in coordinates.items():
        i = INDEX.get(name)
        if i in s.shifted and s.is_relative(how) and s.shifted[i] == s.out.position[i]:
            s.note(
                "G91, IC() behind a change of the frame: the increment alone is moved, not the change (SD42440 0; with 1 the control adds it)"
            )


def frame_words(m: Sinumerik, b: Block, word: Word | None, shift: int | None) -> None:
    """TRANS, ROT, SCALE, MIRROR and their additions; G58, G59."""
    m.corners.release()
    values = {n: i.value for n, i in b.coordinates.items()}
    for name in OTHER:
        if values.pop(name, 0.0):
            raise WordError(f"a shift of {name} cannot be set on this machine", 1)
    name = word.name if word else ""
    if word is not None and word.text is not None and word.text.strip():
        raise WordError(f"{name} takes its axes as words, e.g. {name} X10", word.column)
    if not name.endswith("TRANS") and shift is None and set(values) & set(ROTARY):
        raise WordError(f"{name} of A or C is not supported; let the CAM system output the final coordinates", 1)
    before, way = m.state.frames["program"], {axis: m.state.si(axis, value) for axis, value in values.items()}
    if shift is not None:
        part = "program" if shift == 58 else "fine"
        old = m.state.frames[part]
        places = old.shift.copy()
        for axis, value in way.items():
            places[INDEX[axis]] = value
        m.state.set_frames(**{part: Frame(old.matrix, places)})
        return
    inner = NO_FRAME
    if name.endswith("TRANS"):
        inner = shifted(way)
    elif name in ("ROT", "AROT") and "RPL" in b.extra:
        inner = Frame(rotation(arcs.PLANES[m.state.plane][2], b.take("RPL")), np.zeros(5))
    elif name in ("ROT", "AROT"):
        inner = Frame(rotation_xyz(values), np.zeros(5))
    elif name.endswith("SCALE"):
        if not all(values.values()):
            raise WordError(f"{name} by 0 leaves nothing; give factors other than 0", 1)
        inner = Frame(np.diag([values.get(n, 1.0) for n in LINEAR]), np.zeros(5))
    elif name.endswith("MIRROR"):
        inner = Frame(mirrored(values), np.zeros(5))
    elif values:
        raise WordError(f"{name} is not supported: a turn by angles in space; use ROT with X Y Z", 1)
    if name.startswith("A"):
        m.state.set_frames(program=before @ inner)
    else:
        m.state.set_frames(program=inner, fine=NO_FRAME)
