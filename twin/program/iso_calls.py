"""Subprograms of ISO programs: M98 and M99, macros (G65, G66), O-words."""

from __future__ import annotations

from typing import Any

from twin.program.expressions import WordError, as_number
from twin.program.flow import Frame, Statement
from twin.program.iso_blocks import Iso, between_percents
from twin.program.iso_moves import MOST_REPEATS
from twin.program.reader import ADD_CALL
from twin.program.source import Unit
from twin.program.state import Block

MACRO = dict(zip("ABCIJKDEFHMQRSTUVWXYZ", (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 13, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26)))
"""Letter of G65 -> variable that it sets."""


def other_statement(m: Iso, s: Statement, frame: Frame) -> None:
    """O-words of calls, program numbers, IF .. THEN."""
    flow = m.flow
    if s.kind == "then":
        if m.number_of(s.text, s.column):
            m.words(" " * s.rest[0] + s.key)
    elif s.kind == "words_goto":
        m.words(s.key)
        flow.jump_to(frame, s)
    elif s.kind == "program":  # the name of the program, or the start of the next one
        if frame.style == "m98" or (m.main_seen and len(flow.frames) == 1):
            raise WordError(f"the program runs on into O{s.key}; end it with M30 or M99 before")
        m.main_seen = m.main_seen or len(flow.frames) == 1
    elif s.kind == "call":
        _call_oword(m, s)
    elif s.kind in ("return", "endsub"):
        if s.kind == "return" and len(flow.frames) == 1:
            raise WordError("RETURN is outside a subprogram; remove it", s.column)
        if frame.style == "m98":
            raise WordError("a subprogram called by M98 ends with M99, not with endsub", s.column)
        m.values.returned_value = (m.number_of(s.text, s.column), 1.0) if s.text.strip() else (0.0, 0.0)
        flow.back()
    else:
        raise WordError(f"O.. {s.kind} does not fit here; correct the O-words", s.column)


def call_block(m: Iso, b: Block) -> bool:
    """M97 to M99, G65 and G66; True if the block is done."""
    codes = b.codes
    if codes & {65, 66}:
        p = b.need("P", "G65 and G66 need P, the number of the macro")
        times, variables = int(b.take("L", 1.0)), dict[Any, float]()
        for name, item in b.w.items():
            if name not in MACRO:
                raise WordError(f"{name} passes nothing to a macro", item.column)
            variables[MACRO[name]] = item.value
        place = _program_place(m, int(p.value), p.column)
        if place is not None and 66 in codes:
            m.modal_macro = *place, variables
        elif place is not None:
            m.flow.call(*place, variables, f"O{p.value:g}", times=min(times, MOST_REPEATS), style="macro", column=p.column)
        return True
    if 67 in codes:
        m.modal_macro = None
    own = 97 in b.m
    if own or 98 in b.m or (198 in b.m and not m.linuxcnc):
        if own and m.linuxcnc:
            raise WordError("M97 is no word of LinuxCNC; use M98 and O")
        p, times = b.need("P", f"M{97 if own else 98} needs P, the number of the {'block' if own else 'subprogram'}"), 1
        number = int(p.value)
        if "L" in b.w or "K" in b.w:
            word = b.w.pop("L" if "L" in b.w else "K")
            times = int(word.value)
            if times != word.value:
                raise WordError(f"M98 repeats {word.value:g} times; give a whole number", word.column)
        elif not m.linuxcnc and not own and number > 9999:
            times, number = divmod(number, 10000)
        if b.w or b.g:
            m.carry_out(Block(b.g, [n for n in b.m if n not in (97, 98, 198)], b.w))
        if times > MOST_REPEATS:
            raise WordError(f"M98 repeats more than {MOST_REPEATS} times", p.column)
        place = _program_place(m, number, p.column) if not own else None
        if own:
            if not (found := m.flow.labels(m.flow.frame.unit).get(f"N{number}")):
                raise WordError(f"M97 P{number}: this program has no block N{number}; add it", p.column)
            place = m.flow.frame.unit, found[0]
        if place is not None:
            name = f"{'N' if own else 'O'}{number}"
            m.flow.call(*place, m.flow.frame.variables, name, times=times, style="m98", column=p.column)
        return True
    if 99 not in b.m:
        return False
    if len(m.flow.frames) == 1:
        m.state.note("M99 ends the main program here, which the control would run again without end")
        m.flow.ended = True
        return True
    if m.flow.frame.style not in ("m98", "macro"):
        raise WordError("M99 ends a subprogram that O.. sub began; end it with endsub")
    target = f"N{int(b.take('P'))}" if "P" in b.w else ""
    if b.w:
        m.carry_out(Block(b.g, [n for n in b.m if n != 99], b.w))
    m.flow.back(target)
    return True


def _program_place(m: Iso, number: int, column: int) -> tuple[Unit, int] | None:
    """Unit and line of program O.., in this file or in the folder; None if the machine file lists it as a call without motion."""
    units = dict.fromkeys((m.flow.frame.unit, m.unit_read))
    for unit in units:
        if lines := m.flow.labels(unit).get(f"O{number}"):
            return unit, lines[0] + 1
    if any(f"SUB {number}" in m.flow.labels(unit) for unit in units):
        raise WordError(f"O{number} is a subprogram 'O{number} sub' and is called by 'O{number} call', not by M98", column)
    beside = m.folder.find(f"O{number:04d}", f"O{number}", f"{number:04d}", str(number))
    if beside is None:
        if m.moves_nothing(f"O{number}", f"O{number:04d}"):
            return None
        raise WordError(f"subprogram O{number} is neither in this file nor beside it (O{number:04d}.nc); {ADD_CALL}", column)
    beside = between_percents(beside)
    return beside, next((lines[0] + 1 for name, lines in m.flow.labels(beside).items() if name.startswith("O")), 0)


def _call_oword(m: Iso, s: Statement) -> None:
    """O.. call with its arguments in brackets."""
    name = str(int(m.number_of(s.key, s.column))) if s.key.startswith(("[", "#")) else s.key
    e, arguments = m.expression(s.text, s.column), dict[int, float]()
    while e.peek():
        if e.peek() != "[" or len(arguments) == 30:
            raise e.fail("a call takes up to 30 arguments in brackets, e.g. O100 call [1] [2]")
        arguments[len(arguments) + 1] = as_number(e.atom(), e.column + e.at)
    calling, found, at = m.flow.frame, None, None
    for unit in dict.fromkeys((calling.unit, m.unit_read)):
        at = m.flow.labels(unit).get(f"SUB {name}", [None])[0]
        if at is not None and not (name.isdigit() and unit is not m.unit_read and at > calling.at):
            found = unit  # a numbered subprogram of another file must stand before its call
            break
    else:
        found = m.folder.find(name.strip("<>"))
        at = None if found is None else m.flow.labels(found).get(f"SUB {name}", [None])[0]
    if found is None or at is None:
        fanuc = f"O{name}" in m.flow.labels(m.unit_read)
        where = f"subprogram O{name.lower()} is neither in this file nor beside it; add it"
        raise WordError(f"O{name} is called by M98 P{name}" if fanuc else where, s.column)
    if m.flow.table(found).get(at, (at,))[0] < 0:
        raise WordError("a subprogram begins inside another one; end the first with ENDSUB before", s.column)
    m.values.returned_value = (0.0, 0.0)
    m.flow.call(found, at + 1, arguments, name, style="oword", column=s.column)
