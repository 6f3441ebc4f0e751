"""The text of a program file: checked lines, the programs in one file, and subprograms in its folder."""

import contextlib
from dataclasses import dataclass, field
from pathlib import Path
import re
from typing import Any

from twin.errors import InputError, no_file

LONGEST_LINE = 2000  # characters; the control itself allows 512
MOST_LINES = 2_000_000
_HEAD = re.compile(r"%_N_(\w+?)_(MPF|SPF)\b|%(?:MPF|SPF)[ \t]*(\w+)", re.A | re.I)
_PREFIX = re.compile(r"^.*[/\\](?=.)|_N_|[_.](?:MPF|SPF)$", re.A)


class ProgramText:
    """The lines of a program file, checked to be text."""

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            raise no_file(path, "give a program (.mpf .spf .nc .ngc .apt .cls)")
        try:
            with path.open("rb") as file:
                raw_lines = iter(lambda: file.readline(LONGEST_LINE + 2), b"")
                self.lines = [self._line(raw, number) for number, raw in enumerate(raw_lines, start=1)]
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None

    def _line(self, raw: bytes, number: int) -> str:
        """The text of a line without relics of punched tape; other control characters are an error."""
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
        if text.isprintable():
            return text
        for column, char in enumerate(text, start=1):
            # tabs, end marks, soft hyphens, and the C1 range that old code pages use for letters in comments
            if not char.isprintable() and char not in "\t\r\xa0\x1a\xad\x00\x12\x14\ufeff\u200b" and not 0x7F <= ord(char) <= 0x9F:
                raise InputError(
                    f"{self.path}: line {number}, column {column}: character 0x{ord(char):02X} is no text; this is not a part program"
                )
        return re.sub(r"[\x1a\x00\x12\x14\ufeff\u200b]", "", text).replace("\r", " ").replace("\xa0", " ")


@dataclass(eq=False)
class Unit:
    """One program: its name, its file, its lines and the number of the first of them.

    The three dictionaries are filled by the flow: statements by line, structures, labels.
    """

    name: str
    path: Path
    lines: list[str]
    offset: int = 0
    statements: dict[int, Any] = field(default_factory=dict)
    partners: dict[int, tuple[int, ...]] | None = None
    labels: dict[str, list[int]] | None = None


def plain_name(name: str) -> str:
    """The name of a program without the marks of its folder: _N_PART_MPF, PART.MPF and PART are the same."""
    return _PREFIX.sub("", name.upper().strip())


def units_of(source: ProgramText) -> list[Unit]:
    """The programs in one file; an archive of a SINUMERIK has several, each after its line %_N_NAME_MPF."""
    heads = [(i, m) for i, line in enumerate(source.lines) if line.startswith("%") and (m := _HEAD.match(line))]
    own = plain_name(source.path.stem)
    if not heads:
        return [Unit(own, source.path, source.lines)]
    ends = [i for i, _ in heads[1:]] + [len(source.lines)]
    units = [
        Unit((m[1] or m[3]).upper(), source.path, source.lines[i + 1 : end], i + 1)
        for (i, m), end in zip(heads, ends)
        if m[2] is None or m[2].upper() in ("MPF", "SPF")
    ]
    if any(line.strip() for line in source.lines[: heads[0][0]]):
        units.insert(0, Unit(own, source.path, source.lines[: heads[0][0]]))
    mains = [k for k, (_, m) in enumerate(heads) if (m[2] or "MPF").upper() == "MPF"]
    if mains and mains[0] > 0 and len(units) == len(heads):
        units.insert(0, units.pop(mains[0]))
    return units


class Folder:
    """Subprograms in the folder of a program, by name without ending, in any case."""

    BESIDE = ("subs", "sub", "subroutines", "macros", "SUBS", "SPF", "spf")
    ENDINGS = ("", ".spf", ".mpf", ".ngc", ".nc", ".sub", ".min", ".cnc", ".tap", ".prg", ".txt", ".h")

    def __init__(self, path: Path, used: list[Path]) -> None:
        self.path, self.used = path, used  # the files that were read are added to `used`
        self.files: dict[str, Path] | None = None
        self.units: dict[str, Unit] = {}

    def find(self, *names: str) -> Unit | None:
        """The program in the first of these files that exists in the folder."""
        if self.files is None:
            self.files = {}
            files: list[Path] = []
            for folder in (self.path.parent, *(self.path.parent / name for name in self.BESIDE)):
                with contextlib.suppress(OSError):
                    files += sorted(folder.iterdir())
            for file in files[:20_000]:
                if file.suffix.lower() in self.ENDINGS and file != self.path:
                    self.files.setdefault(plain_name(file.stem), file)
        for name in map(plain_name, names):
            found = self.files.get(name)
            if found is not None and name not in self.units and found.is_file():
                self.units[name] = units_of(ProgramText(found))[0]
                self.used.append(found)
            if name in self.units:
                return self.units[name]
        return None
