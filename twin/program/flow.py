"""The file of a program and the order in which its blocks run: labels, REPEAT, IF .. GOTO, structured IF.

The file is read with bounded lines, so that a file without line ends or a binary file is reported at once. Jumps are
bounded too: a program that never ends is reported instead of filling the memory.
"""

from __future__ import annotations

from pathlib import Path
import re
from typing import Protocol

from twin.errors import InputError
from twin.program.words import Arithmetic, Word, WordError, split_words

LONGEST_LINE = 2000  # characters; the control itself allows 512
MOST_LINES = 2_000_000
MOST_BLOCKS = 2_000_000  # that run, with repeats
MOST_JUMPS = 100_000
_LABEL = re.compile(r"\s*(?:N\d+\s+)?([A-Z_][A-Z0-9_]+):(?!=)", re.A)
_NUMBER = re.compile(r"\s*N(\d+)", re.A)
_GOTO = re.compile(r"\s*GOTO([FBC]?)\s+([A-Z0-9_]+)\s*\Z", re.A)
_IF = re.compile(r"\s*IF\b(.*?)(?:\b(GOTO[FBC]?\s+[A-Z0-9_]+))?\s*\Z", re.A)
_REPEAT = re.compile(r"\s*(REPEATB?)\s+([A-Z_][A-Z0-9_]*)(?:\s+(?!P\d+\s*\Z)([A-Z_][A-Z0-9_]*))?(?:\s+P\s*=?\s*(\d+|R\d+))?\s*\Z", re.A)
_FLOW = re.compile(
    r"\s*(?:N\d+\s*)?(?:[A-Z_][A-Z0-9_]+:\s*)?(IF|ELSE|ENDIF|GOTO[FBC]?|REPEATB?|WHILE|ENDWHILE|FOR|ENDFOR|LOOP|ENDLOOP|UNTIL|ENDLABEL:?)\b(?!\s*=)",
    re.A,
)


class Source:
    """The lines of a program file, checked to be text."""

    def __init__(self, path: Path):
        self.path = path
        if not path.is_file():
            raise InputError(f"{path}: no such file; give a program (.mpf .spf .ngc .apt .cls)")
        self.lines: list[str] = []
        try:
            with path.open("rb") as file:
                self._read(file)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None

    def _read(self, file) -> None:  # type: ignore[no-untyped-def]
        lines, number = self.lines, 0
        while True:
            raw = file.readline(LONGEST_LINE + 2)
            if not raw:
                return
            number += 1
            if len(raw) > LONGEST_LINE and not raw.endswith(b"\n"):
                raise InputError(
                    f"{self.path}: line {number}: longer than {LONGEST_LINE} characters; this is no part program, or its line ends are lost"
                )
            if number > MOST_LINES:
                raise InputError(f"{self.path}: more than {MOST_LINES} lines; split the program")
            try:
                text = raw.decode("utf-8-sig" if number == 1 else "utf-8")
            except UnicodeDecodeError:
                text = raw.decode("latin-1")
            text = text.rstrip("\r\n")
            if not text.isprintable():
                for column, char in enumerate(text, start=1):
                    if not char.isprintable() and char not in "\t\xa0\x1a\xad":
                        code = f"0x{ord(char):02X}"
                        raise InputError(
                            f"{self.path}: line {number}, column {column}: character {code} is no text; this is not a part program"
                        )
            lines.append(text)


class Reader(Protocol):
    """What the flow needs from the reader of blocks."""

    arithmetic: Arithmetic
    line: int
    block: int

    def words(self, words: list[Word]) -> None: ...


class Flow:
    """Runs blocks one after the other and follows the jumps."""

    def __init__(self, source: Source, reader: Reader):
        self.source = source
        self.reader = reader
        self.ran = self.jumps = 0
        self.labels: dict[str, list[int]] | None = None
        self.repeats: list[list[int]] = []  # [last line, line to return to, first line, times left]

    def advance(self, at: int) -> int:
        """The line after `at`, back to the start of a repeated part at its end."""
        self._count(at)
        while self.repeats and self.repeats[-1][0] == at:
            part = self.repeats[-1]
            part[3] -= 1
            if part[3] > 0:
                return part[2]
            self.repeats.pop()
            at = part[1]  # behind the REPEAT block, which may itself end a part
        return at + 1

    def _count(self, at: int) -> None:
        self.ran += 1
        if self.ran > MOST_BLOCKS:
            raise InputError(
                f"{self.source.path}: line {at + 1}: more than {MOST_BLOCKS} blocks have run; repeat less often or split the program"
            )

    def run(self, at: int, text: str) -> int:
        """Run the block on line `at` (cleaned text) and return the line that comes next."""
        label = _LABEL.match(text)
        if label:
            text = " " * label.end() + text[label.end() :]
        stripped = text.lstrip()
        if not stripped or stripped.startswith("%"):
            return self.advance(at)
        if stripped.startswith("/"):
            text = text.replace("/", " ", 1)  # block skip is off: the block runs
        flow = _FLOW.match(text)
        if not flow:
            self.reader.words(split_words(text))
            return self.advance(at)
        if number := _NUMBER.match(text):
            self.reader.block = int(number[1])
            text = " " * number.end() + text[number.end() :]
        column = flow.start(1) + 1
        if flow[1] == "IF":
            return self._if(at, text, column)
        if flow[1].startswith("GOTO"):
            return self._goto(at, text, column)
        if flow[1].startswith("REPEAT"):
            return self._repeat(at, text, column)
        if flow[1] == "ELSE":
            return self._behind(at, ("ENDIF",), column)  # the part before it has run
        if flow[1] in ("ENDIF", "ENDLABEL", "ENDLABEL:"):
            return self.advance(at)
        raise WordError(f"{flow[1]} is not supported; use IF .. GOTOB, or REPEAT with a label", column)

    def _if(self, at: int, text: str, column: int) -> int:
        match = _IF.match(text)
        assert match
        if not match[1].strip():
            raise WordError("IF needs a condition, e.g. IF R1<10 GOTOB LOOP1", column)
        true = bool(self.reader.arithmetic.value(match[1], match.start(1) + 1))
        if match[2]:
            return self._goto(at, match[2], match.start(2) + 1) if true else self.advance(at)
        return self.advance(at) if true else self._behind(at, ("ELSE", "ENDIF"), column)

    def _behind(self, at: int, ends: tuple[str, ...], column: int) -> int:
        """The line after the matching ELSE or ENDIF; a repeated part that ends among the skipped lines ends there."""
        end = self._matching(at, ends, column)
        if self.repeats and at <= self.repeats[-1][0] < end:
            end = self.repeats[-1][0]
        return self.advance(end)

    def _matching(self, at: int, ends: tuple[str, ...], column: int) -> int:
        """Line of the matching ELSE or ENDIF."""
        depth = 0
        for i in range(at + 1, len(self.source.lines)):
            text = self.source.lines[i].split(";")[0].upper()
            word = _FLOW.match(text)
            if not word:
                continue
            if word[1] == "IF" and "GOTO" not in text:
                depth += 1
            elif depth == 0 and word[1] in ends:
                return i
            elif word[1] == "ENDIF":
                depth -= 1
        raise WordError("IF has no ENDIF; add it", column)

    def _goto(self, at: int, text: str, column: int) -> int:
        match = _GOTO.match(text)
        if not match:
            raise WordError("GOTO needs one label or block number, e.g. GOTOF END1", column)
        self._count(at)
        self.jumps += 1
        if self.jumps > MOST_JUMPS:
            raise WordError(f"more than {MOST_JUMPS} jumps have run; the loop with this jump does not end, correct it", column)
        forward = [i for i in self._places(match[2]) if i > at]
        back = [i for i in self._places(match[2]) if i <= at]
        found = {"F": forward[:1], "B": back[-1:]}.get(match[1], forward[:1] or back[-1:])
        if not found:
            direction = {"F": " further on (GOTOF)", "B": " before (GOTOB)"}.get(match[1], "")
            raise WordError(f"there is no label or block '{match[2]}'{direction}; add it or correct the jump", column)
        self.repeats = [r for r in self.repeats if r[2] <= found[0] <= r[0]]
        return found[0]

    def _repeat(self, at: int, text: str, column: int) -> int:
        match = _REPEAT.match(text)
        if not match:
            raise WordError("REPEAT needs a label, e.g. REPEAT PART1 P=3 or REPEAT FROM1 TO1", column)
        first = self._label(match[2], column)
        if match[3]:
            last = self._label(match[3], column)
        elif match[1] == "REPEATB":
            last = first
        else:
            last = at - 1
            for i in range(first, at):
                if self.source.lines[i].strip().upper().startswith("ENDLABEL"):
                    last = i
                    break
        if last < first or first <= at <= last:
            raise WordError(f"REPEAT {match[2]}: the part to repeat holds the REPEAT itself or is empty; move the labels", column)
        times = 1
        if match[4]:
            times = int(self.reader.arithmetic.value(match[4], match.start(4) + 1))
        if len(self.repeats) >= 20:
            raise WordError("more than 20 REPEAT inside each other; correct the labels", column)
        if times <= 0:
            return self.advance(at)
        self._count(at)
        self.repeats.append([last, at, first, times])
        return first

    def _label(self, name: str, column: int) -> int:
        places = self._places(name)
        if not places:
            raise WordError(f"there is no label '{name}'; add '{name}:' before the part to repeat", column)
        return places[0]

    def _places(self, name: str) -> list[int]:
        """Lines that carry a label or block number."""
        if self.labels is None:
            self.labels = {}
            for i, line in enumerate(self.source.lines):
                text = line.upper()
                if match := _LABEL.match(text):
                    self.labels.setdefault(match[1], []).append(i)
                if match := _NUMBER.match(text):
                    self.labels.setdefault(f"N{match[1]}", []).append(i)
        return self.labels.get(name, [])
