"""The first lines of a text file: its encoding, and its lines with cells that hold one thing each."""

from dataclasses import dataclass
from pathlib import Path

from twin.errors import InputError
from twin.recordings.formats.text_rewriting import Rewriting, rewriting_of
from twin.recordings.names import TERM

SAMPLE_BYTES = 1 << 18
"""Bytes at the start of a file that tell encoding and layout."""
MOST_LINES = 600
"""Lines that tell the layout."""
EASTERN = ("gb18030", "cp932", "big5")
"""Encodings of Chinese and Japanese text; the right encoding shows the most terms of drives."""
_NOT_TEXT = (
    (b"PK\x03\x04", "an archive: unpack it"),
    (b"\xd0\xcf\x11\xe0", "an old workbook: save it as .xlsx"),
)


@dataclass(frozen=True)
class Sample:
    """The first lines of a text file."""

    path: Path
    encoding: str
    lines: tuple[str, ...]
    rewritten: Rewriting = str
    """Rows of the file as in `lines`, see `text_rewriting`."""


def read_sample(path: Path, encoding: object = None) -> Sample:
    """Encoding and first lines; an incomplete last one is left out. `encoding`: given in a map."""
    with open(path, "rb") as file:
        head = file.read(SAMPLE_BYTES)
    encoding = str(encoding) if encoding else _encoding(head, path)
    try:
        text = head.decode(encoding, errors="ignore")
    except LookupError:
        raise InputError(f"{path}: [csv] encoding '{encoding}' is unknown; use utf-8, latin-1, utf-16, gb18030 or cp932") from None
    # the line ends of Python's text files; str.splitlines knows more
    lines = text.lstrip("\ufeff").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    lines = lines[:-1] if len(head) == SAMPLE_BYTES or not lines[-1] else lines
    rewritten = rewriting_of(lines[:MOST_LINES])
    return Sample(path, encoding, tuple(map(rewritten.heading, lines)), rewritten.rows)


def _encoding(head: bytes, path: Path) -> str:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\x00" in head:
        # Western text in UTF-16 without its mark has a zero in every second byte
        for at, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
            if head[at::2].count(0) > 0.9 * len(head[at::2]) and not head[1 - at :: 2].count(0):
                return encoding
        known = next(
            (what for magic, what in _NOT_TEXT if head.startswith(magic)), "not a text file (it holds zero bytes), and no known format"
        )
        raise InputError(f"{path}: {known}; export the recording as text")
    try:
        head[: len(head) - 4].decode("utf-8")
    except UnicodeDecodeError:
        return max(("latin-1", *EASTERN), key=lambda encoding: len(TERM.findall(head.decode(encoding, errors="ignore"))))
    return "utf-8"
