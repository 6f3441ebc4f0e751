"""Subprograms of SINUMERIK programs: calls with values, MCALL, CASE, declarations."""

from __future__ import annotations

from collections.abc import Callable
import re

from twin.errors import nearest
from twin.program.expressions import Value, WordError, needed
from twin.program.flow import Frame, Statement
from twin.program.sinumerik_blocks import Sinumerik
from twin.program.sinumerik_values import Store, Word, split_arguments
from twin.program.source import Unit

ADD_FILE = "add the file, or list it in [program] calls_without_motion of the machine file if it moves no axis"
_DEFINE = re.compile(r"\s*DEFINE\s+([A-Z_][A-Z0-9_]*)\s+AS\s+(.+?)\s*\Z", re.A)
_QUIET = re.compile(
    r"\s*(?:M\d*=?\d+|H\d*=?\d+|(?:\$A_OUTA?|\$AC_MARKER|\$AC_PARAM|\$AC_TIMER|\$R|\$A_DB\w+|\$A_DLB|\$AC_FIFO\d*)\s*(?:\[[^\]]*\])?\s*=\s*[^ ]+|SETAL\([^)]*\))",
    re.A,
)
_CASE = re.compile(r"\s*CASE\s*(.+?)\s+OF\b(.*)\Z", re.A)
_CASE_PART = re.compile(r"\s*(DEFAULT|[^\s].*?)\s+(GOTO[FBC]?)\s+([A-Z0-9_]+)", re.A)
_PROC = re.compile(r"\s*PROC\s+([A-Z_][A-Z0-9_]*)\s*(?:\((.*?)\))?", re.A)


def other_statement(m: Sinumerik, s: Statement, frame: Frame) -> None:
    """CASE, DEF, PROC and the like."""
    if s.kind == "case":
        _case(m, s, frame)
    elif s.kind in ("def", "redef"):
        m.values.define(s, frame)
    elif s.kind == "define":
        macro = needed(_DEFINE.match(s.text), "DEFINE needs a name and its words, e.g. DEFINE COOLANT AS M8", s.column)
        m.macros[macro[1]] = macro[2]
        frame.unit.statements.clear()
        frame.unit.partners = None
    elif s.kind == "synchronised":
        if _QUIET.sub("", s.text).strip() or not s.text.strip():
            raise WordError(f"DO{s.text[:30]}: {m.known['DO'].meaning}", s.column)
        m.state.note("DO: a synchronised action that sets outputs or marks, without effect on the motion")
    elif s.kind == "proc" and len(m.flow.frames) == 1:
        match = _PROC.match(s.text)
        for part, _ in split_arguments(match[2] or "") if match else []:
            m.values.unset.add(re.sub(r"\[[^\]]*\]|=.*", " ", part).split()[-1])
    elif s.kind == "extern":
        m.state.note("EXTERN: a declaration, without effect on the motion")


def _case(m: Sinumerik, s: Statement, frame: Frame) -> None:
    """CASE: the jump of the first value that fits."""
    match = needed(_CASE.match(s.text), "CASE needs values, e.g. CASE (R1) OF 1 GOTOF A1 DEFAULT GOTOF B1", s.column)
    value = m.value_of(match[1], s.column)
    for part in _CASE_PART.finditer(match[2]):
        if part[1] == "DEFAULT" or m.value_of(part[1], s.column) == value:
            m.flow.jump_to(frame, Statement("goto", column=s.column, rest=("", part[2][4:], part[3])))
            return


def call(m: Sinumerik, word: Word, times: int) -> None:
    """A subprogram by its name or L number."""
    name, unit = _unit_of(m, word)
    if unit is None and name == "L":
        raise WordError("L needs a number", word.column)
    if unit is None:
        if word.index is not None or (word.value is not None and word.name != "L"):
            raise WordError(f"word '{name}' is not known; remove it or replace it by moves", word.column)
        if m.moves_nothing(name):
            return
        hint = nearest(name, m.known) if len(name) > 2 else ""
        hint = f"{hint}; or " if hint.startswith("did you") else ""
        what = f"word '{name}' is not known and there is no subprogram {name}.SPF beside the program"
        raise WordError(f"{what}; {hint}{ADD_FILE}", word.column)
    m.corners.release()
    variables, first, written = arguments(m, unit, word)
    kept = _kept_modes(m) if first and re.search(r"\)?[^)]*\bSAVE\b", m.clean(unit.lines[first - 1])) else None

    def restore() -> None:
        if kept:
            kept()
        for target, store, column in written:
            m.values.assign(target, store[()], column)

    m.flow.call(unit, first, variables, name, times=times, column=word.column, on_return=restore)


def _unit_of(m: Sinumerik, word: Word) -> tuple[str, Unit | None]:
    """The name of a subprogram, and its program."""
    name = word.name if word.name != "L" or word.value is None else f"L{word.value:g}"
    return name, m.find(name)


def _kept_modes(m: Sinumerik) -> Callable[[], None]:
    """What PROC .. SAVE restores at the end of the subprogram: the modal G codes and the programmable frame."""
    kept, side, chosen = m.state.kept((m, ("corners_meet", "angles_are_rpy")), frames=("program", "fine")), m.state.comp, m.values.chosen

    def restore() -> None:
        m.corners.release()
        if (m.state.comp is None) != (side is None):
            raise WordError("SAVE with a change of G40, G41 or G42 in the subprogram is not supported; change it in the caller")
        kept()
        m.values.choose(chosen)

    return restore


def arguments(m: Sinumerik, unit: Unit, word: Word) -> tuple[dict[str, Store], int, list[tuple[str, Store, int]]]:
    """The values of a call: the variables of its PROC, the line that it begins at, and the VAR values to write back to their targets."""
    values = [(t, word.text_column + c) for t, c in split_arguments(word.text or "")]
    bodies = ((at, m.body(m.clean(line))[0].strip()) for at, line in enumerate(unit.lines))
    at, body = next(((at, body) for at, body in bodies if body and not body.startswith("EXTERN")), (0, ""))
    if not (match := _PROC.match(body)):
        if any(t for t, _ in values):
            raise WordError(f"{unit.name} takes no values (it has no PROC line); remove the brackets", word.column)
        return {}, 0, []
    variables: dict[str, Store] = {}
    written: list[tuple[str, Store, int]] = []
    for k, (part, _) in enumerate(split_arguments(match[2] or "")):
        declared, _, default = part.partition("=")
        words = re.sub(r"\[[^\]]*\]", " ", declared).split()
        if not words:
            continue
        start: Value = "" if any(w in declared for w in ("STRING", "CHAR", "AXIS")) else 0.0
        text, column = values[k] if k < len(values) and values[k][0] else (default.strip(), 1)
        store = m.values.store_of(text) if words[0] == "VAR" else None
        if store is not None:  # the variable of the caller itself
            store.setdefault(("default",), start)
        else:
            by_name = "AXIS" in declared and words[0] != "VAR"
            store = {(): start if not text else text if by_name else m.value_of(text, column), ("default",): start}
            if words[0] == "VAR" and text:
                written.append((text, store, column))
        variables[words[-1]] = store
    if len(values) > len(split_arguments(match[2] or "")):
        raise WordError(f"{unit.name} takes {len(variables)} values; the call gives {len(values)}", word.column)
    return variables, at + 1, written


def modal_call(m: Sinumerik, word: Word) -> Callable[[], None]:
    """The subprogram of MCALL, which is called behind each block with motion."""
    _, unit = _unit_of(m, word)
    if unit is None:
        raise WordError(f"MCALL: there is no cycle or subprogram '{word.name}'; add {word.name}.SPF", word.column)
    variables, first, _ = arguments(m, unit, word)

    return lambda: m.flow.call(unit, first, {k: dict(v) for k, v in variables.items()}, unit.name, column=word.column)
