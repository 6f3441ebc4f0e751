"""Lines of ISO programs: comments, statements of the flow, and the start of blocks and subprograms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import re

from twin.program.expressions import WordError
from twin.program.source import Unit
from twin.program.state import State
from twin.program.structures import Statement

OWORD = re.compile(
    r"\s*(?:N[\d.]+\s*)?O\s*(<[^>]*>|\d+|\[.*?\]|#\d+|#<[^>]*>)\s*"
    r"(SUB|ENDSUB|CALL|RETURN|IF|ELSEIF|ELSE|ENDIF|WHILE|ENDWHILE|DO|REPEAT|ENDREPEAT|BREAK|CONTINUE)\b\s*(.*)$",
    re.A,
)
PROGRAM = re.compile(r"\s*[O:]\s*(\d+|<[^>]*>)\s*$", re.A)
_NUMBERED = re.compile(r"\s*N\s*(\d+)(?:\.\d*)?", re.A)
_IF = re.compile(r"\s*IF\s*(\[.*\])\s*(?:GO(?:TO)?\s*(.+?)|TH(?:EN)?\s*(.+?))\s*$", re.A)
_WHILE = re.compile(r"\s*WH(?:ILE)?\s*(\[.*\])\s*DO\s*(\d+)\s*$", re.A)
_DO = re.compile(r"\s*(DO|END?)\s*(\d+)\s*$", re.A)
_GOTO = re.compile(r"\s*GO(?:TO)?\s*(.+?)\s*$", re.A)
_WORDS_GOTO = re.compile(r"(\s*(?:N\d+\s*)?#.*?=.*?[\d\]\s.])GO(?:TO)?\s*(\d+|#.+|\[.+\])\s*$", re.A)
_MAIN_BLOCK = re.compile(r"(\s*):(\d+)(?=\s*[A-Z])", re.A)
COMMENT = re.compile(r"\(([^()]*(?:\([^()]*\)[^()]*)*)\)?")
_ACTIVE = re.compile(r"\s*(DEBUG|PRINT|MSG)\s*,(.*)$", re.S | re.I)
_LOG = re.compile(r"\s*(LOGOPEN|LOGAPPEND|LOGCLOSE|LOG|PROBEOPEN|PROBECLOSE|PY|ABORT)\b\s*,?", re.I)
LINUXCNC = re.compile(r"^\s*(?:N\d+\s*)?O[ \t]*(?:<[^>]*>|\d+[ \t]*(?:SUB|IF|WHILE|DO|REPEAT|CALL)\b)|#[ \t]*<", re.I | re.M)
_OUTPUT = re.compile(r"(?:N\d+\s*)?(?:[BD]P(?:RNT)?\s*\[|PO(?:PEN)?\b\s*$|PC(?:LOS)?\b\s*$)", re.A)
"""Commands of a macro that print to a file or an interface."""
SEPARATOR = "\x01"
_IN_MESSAGE = re.compile(r"%[df]|%\.(\d)f|#(<[^>]*>|\d+)")


class IsoLines:
    """Reads lines."""

    def __init__(self, state: State) -> None:
        self.state = state

    def clean(self, text: str) -> str:
        """The block in capitals without comments; text that a comment prints follows a separator."""
        messages: list[str] = []

        def comment(match: re.Match[str]) -> str:
            inner = match[1]
            if active := _ACTIVE.match(inner):
                messages.append(f"{active[1].upper()},{active[2]}")
            elif (log := _LOG.match(inner)) and log[1].upper() not in ("PY", "ABORT"):
                self.state.note(f"({log[1].upper()}): understood, no effect on the motion")
            elif log and "," in inner:
                raise WordError(f"({log[1].lower()},..) runs code of the control, which is not simulated; remove it", match.start() + 1)
            return " " * len(match[0])

        if "(" in text or ";" in text:
            head, semicolon, tail = text.partition(";")
            text = COMMENT.sub(comment, head)
            if semicolon and (log := _LOG.match(tail)) and log[1].upper() in ("PY",) and "," in tail[:6]:
                raise WordError(";py,.. runs code of the control, which is not simulated; remove it", len(head) + 1)
            if semicolon and (active := _ACTIVE.match(tail)):
                messages.append(f"{active[1].upper()},{active[2]}")
        text = text.upper().rstrip()
        stripped = text.lstrip()
        if stripped.startswith(":") and (main := _MAIN_BLOCK.match(text)):
            text = f"{main[1]}N{main[2]}{text[main.end() :]}"
        if stripped.startswith("%") or _OUTPUT.match(stripped):
            text = ""
        elif stripped.startswith("/"):
            text = re.sub(r"/\d?", lambda m: " " * len(m[0]), text, count=1)  # block skip is off: the block runs
        return text + "".join(SEPARATOR + m for m in messages)

    def statement(self, text: str) -> Statement | None:
        """The statement of the flow in a line."""
        body = text.split(SEPARATOR)[0]
        if match := OWORD.match(body):
            word = match[2].lower()
            kind = {"repeat": "times", "endrepeat": "endtimes"}.get(word, word)
            return Statement(kind, plain_key(match[1]), match[3], match.start(3) + 1)
        if match := PROGRAM.match(body):
            return Statement("program", match[1].lstrip("0") or "0")
        if SEPARATOR in text:
            return None
        number = _NUMBERED.match(body)
        start = number.end() if number and re.match(r"\s*(?:IF|WH(?:ILE)?|DO|END?|GO(?:TO)?)(?:\b|\s*\d)", body[number.end() :]) else 0
        rest = " " * start + body[start:]
        if match := _IF.match(rest):
            if match[2]:
                return Statement("goto", column=match.start(1) + 1, rest=(match[1], "", self._target(match[2])))
            return Statement("then", match[3], match[1], match.start(1) + 1, (match.start(3),))
        if match := _WHILE.match(rest):
            return Statement("while", f"DO{match[2]}", match[1], match.start(1) + 1)
        if match := _DO.match(rest):
            return Statement("loop" if match[1] == "DO" else "endwhile", f"DO{match[2]}")
        if match := _GOTO.match(rest):
            return Statement("goto", column=match.start(1) + 1, rest=("", "", self._target(match[1])))
        if match := _WORDS_GOTO.match(rest):
            return Statement("words_goto", match[1], column=match.start(2) + 1, rest=("", "", self._target(match[2])))
        return None

    @staticmethod
    def _target(text: str) -> str:
        return f"N{int(text)}" if text.isdigit() else f"={text}"

    def labels(self, unit: Unit) -> dict[str, list[int]]:
        """Lines by block number (N100), number of a program (O100) and name of a subprogram of O-words (SUB 100, SUB <name>)."""
        found: dict[str, list[int]] = {}
        for i, line in enumerate(unit.lines):
            text = line.upper()
            if match := _NUMBERED.match(text.lstrip("/ ")):
                found.setdefault(f"N{int(match[1])}", []).append(i)
            if "O" in text or ":" in text:
                body = COMMENT.sub("", text.split(";")[0])
                if match := PROGRAM.match(body):
                    found.setdefault(f"O{match[1].lstrip('0') or '0'}", []).append(i)
                elif (match := OWORD.match(body)) and match[2] == "SUB":
                    found.setdefault(f"SUB {plain_key(match[1])}", []).append(i)
        return found


def between_percents(unit: Unit) -> Unit:
    """A program between two lines % ends at the second."""
    marks = [i for i, line in enumerate(unit.lines) if line.strip().startswith("%")]
    first = next((i for i, line in enumerate(unit.lines) if line.strip()), 0)
    if len(marks) >= 2 and marks[0] == first:
        return replace(unit, lines=[*unit.lines[: marks[1]], "M2"])
    return unit


def plain_key(key: str) -> str:
    return str(int(key)) if key.isdigit() else key.replace(" ", "")


def message_text(text: str, number_of: Callable[[str, int], float]) -> str:
    """The text of MSG, DEBUG or PRINT with the values of its parameters filled in."""
    kind, _, rest = text.partition(",")
    places = 6

    def value(match: re.Match[str]) -> str:
        nonlocal places
        if not match[2]:
            places = {"%d": 0, "%f": 4}.get(match[0], int(match[1] or 6))
            return ""
        try:
            number = number_of("#" + match[2].upper(), 1)
        except WordError:
            return "######"
        return f"{number:.{places}f}"

    return rest if kind == "MSG" else _IN_MESSAGE.sub(value, rest)
