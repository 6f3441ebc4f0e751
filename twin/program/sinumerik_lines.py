"""Lines of SINUMERIK programs: comments, labels, block numbers, and statements of the flow."""

from __future__ import annotations

import re

from twin.program.expressions import WordError
from twin.program.source import Unit
from twin.program.state import State
from twin.program.structures import Statement

_LABEL = re.compile(r"\s*(?:[N:]\d+\s*)?([A-Z_][A-Z_][A-Z0-9_]*)\s*:(?!=)", re.A)
_NUMBERED = re.compile(r"\s*[N:](\d+)", re.A)
_FLOW = re.compile(
    r"\s*(IF|ELSE|ENDIF|WHILE|ENDWHILE|FOR|ENDFOR|LOOP|ENDLOOP|UNTIL|GOTO[FBCS]?|REPEATB?|CASE|ENDLABEL|PROC|DEF|REDEF|DEFINE|EXTERN)\b(?!\s*=[^=])",
    re.A,
)
_SYNCHRONISED = re.compile(r"\s*(?:IDS?\s*=\s*\d+\s*)?(?:\b(?:WHEN|WHENEVER|EVERY|FROM)\b.*)?\bDO\b(.*)\Z", re.A)
_BLOCK_CALL = re.compile(r"\s*CALL\s+BLOCK\s+([A-Z_N][A-Z0-9_]*)\s+TO\s+([A-Z_N][A-Z0-9_]*)\s*\Z", re.A)
_COMMENT = re.compile(
    r"((?:^|:)\s*(?:N\d+\s*)?|\s[A-KM-Z]=?[-+]?(?:\d+\.?\d*|\.\d+)\s*|\b[A-Z_]\w*\s*=\s*[-+]?(?:\d+\.?\d*|\.\d+)\s+)\(([^()\"]*(?:\([^()\"]*\)[^()\"]*)*)\)(?=\s*(?:[A-Z]|\Z))",
    re.A,
)
_GOTO = re.compile(r"\s*GOTO([FBC]?)\s+([A-Z0-9_]+)\s*\Z", re.A)
_IF_GOTO = re.compile(r"\s*IF\b(.*?)\b(GOTO[FBCS]?\b.*)\Z", re.A)
_REPEAT = re.compile(
    r"\s*(REPEATB?)\s+([A-Z_N][A-Z0-9_]*)(?:\s+(?!P\s*=?\s*[\dR])([A-Z_][A-Z0-9_]*))?(?:\s+P\s*=?\s*(\d+|R\d+|[A-Z_]\w*))?\s*\Z", re.A
)
_FOR = re.compile(r"\s*FOR\s*([A-Z_][A-Z0-9_]*(?:\[[^\]]*\])?)\s*=\s*(.+?)\s+TO\s+(.+)\Z", re.A)


class SinumerikLines:
    """Reads lines."""

    def __init__(self, state: State) -> None:
        self.state = state
        self.macros: dict[str, str] = {}  # DEFINE .. AS

    def clean(self, text: str) -> str:
        """The block in capitals without comment; texts in quotes keep their length."""
        semicolon = text.find(";")
        while semicolon >= 0 and text.count('"', 0, semicolon) % 2:
            semicolon = text.find(";", semicolon + 1)
        if semicolon >= 0:
            text = text[:semicolon]
        text = text.upper().rstrip()
        stripped = text.lstrip()
        if stripped.startswith("%"):
            return ""
        if stripped.startswith("/"):
            text = re.sub(r"/\d?", lambda m: " " * len(m[0]), text, count=1)  # block skip is off: the block runs
        if "(" in text and (bare := _COMMENT.sub(lambda m: m[1] + " " * (len(m[0]) - len(m[1])), text)) != text:
            self.state.note("( ): a text in brackets that belongs to no word is a comment, as on older controls")
            text = bare
        if self.macros:
            parts = text.split('"')
            for name, meaning in self.macros.items():
                parts[::2] = [re.sub(rf"\b{name}\b(?!\s+AS\b)", meaning.replace("\\", r"\\\\"), part) for part in parts[::2]]
            text = '"'.join(parts)
        return text

    def body(self, text: str) -> tuple[str, int]:
        """The block without label and number, which keep their length; the number, -1 if there is none."""
        number = _NUMBERED.match(text)
        start = number.end() if number else 0
        if (label := _LABEL.match(text)) and label[1] != "ENDLABEL":
            start = label.end()
            if again := re.compile(r"\s*N(\d+)").match(text, start):
                number, start = again, again.end()
        return " " * start + text[start:], int(number[1]) if number else -1

    def statement(self, text: str) -> Statement | None:
        """The statement of the flow in a line."""
        body, _ = self.body(text)
        if not body.strip():
            return Statement("label")
        match = _FLOW.match(body)
        if not match:
            if call := _BLOCK_CALL.match(body):
                return Statement("repeat_label", column=call.start(1) + 1, rest=("REPEAT", call[1], call[2], None))
            if "DO" in body and (action := _SYNCHRONISED.match(body)):
                return Statement("synchronised", text=action[1], column=action.start(1) + 1)
            return None
        word, column = match[1], match.start(1) + 1
        rest = body[match.end(1) :]
        if word == "IF":
            if jump := _IF_GOTO.match(body):
                return self._jump(jump[2], jump[1], jump.start(1) + 1)
            return Statement("if", text=rest, column=match.end(1) + 1)
        if word.startswith("GOTO"):
            return self._jump(body, "", column)
        if word in ("WHILE", "UNTIL"):
            return Statement(word.lower(), text=rest, column=match.end(1) + 1)
        if word in ("ELSE", "ENDIF", "ENDWHILE", "ENDFOR", "LOOP", "ENDLOOP"):
            if rest.strip():
                raise WordError(f"{word} must be alone in its block; write the rest in the next one", column)
            return Statement(word.lower(), column=column)
        if word == "FOR":
            parts = _FOR.match(body)
            if not parts:
                raise WordError("FOR needs a variable and its ends, e.g. FOR I=1 TO 10", column)
            return Statement("for", column=column, rest=(parts[1], parts[2], parts[3]))
        if word in ("REPEAT", "REPEATB"):
            if not rest.strip():
                return Statement("repeat", column=column)
            parts = _REPEAT.match(body)
            if not parts:
                raise WordError("REPEAT needs a label, e.g. REPEAT PART1 P=3 or REPEAT FROM1 TO1", column)
            return Statement("repeat_label", column=column, rest=parts.groups())
        if word == "ENDLABEL":
            return Statement("label")
        return Statement(word.lower(), text=body, column=column)

    def _jump(self, text: str, condition: str, column: int) -> Statement:
        if text.strip().startswith("GOTOS"):
            return Statement("goto", column=column, rest=(condition, "S", ""))
        match = _GOTO.match(text)
        if not match:
            raise WordError("GOTO needs one label or block number, e.g. GOTOF END1", column)
        return Statement("goto", column=column, rest=(condition, match[1], match[2]))

    def labels(self, unit: Unit) -> dict[str, list[int]]:
        """Lines by label and block number."""
        found: dict[str, list[int]] = {}
        for i, line in enumerate(unit.lines):
            text = line.upper()
            if match := _LABEL.match(text):
                found.setdefault(match[1], []).append(i)
            if match := _NUMBERED.match(text):
                found.setdefault(f"N{match[1]}", []).append(i)
        return found
