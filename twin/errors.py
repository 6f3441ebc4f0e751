"""Errors that a user can act on: each message says what was given, where, and what to do."""

from __future__ import annotations

from collections.abc import Iterable
import difflib
from pathlib import Path
import traceback

import twin

TRACEBACK = "TWIN_TRACEBACK"
"""Environment variable: where it is set, an unexpected error ends in Python's traceback."""
LONGEST = 300
"""Characters of a message behind the file that it is about."""
LONGEST_WORD = 80
MOST_LISTED = 24
"""Known words that a message lists."""


class TwinError(Exception):
    """Base of all errors of this package; the command line prints it as one line and exits with 2."""


class InputError(TwinError):
    """A file, a value or an argument that cannot be used."""


class SimulationError(TwinError):
    """A simulation that stopped before its end.

    `trace` holds what was recorded up to there (None if nothing was).
    """

    def __init__(self, message: str, trace: object | None = None) -> None:
        super().__init__(message)
        self.trace = trace


def nearest(word: object, known: Iterable[str]) -> str:
    """The tail of an error message: the nearest known word, or else the list of all known words."""
    known = sorted(known)
    match = difflib.get_close_matches(str(word), known, n=1, cutoff=0.6)
    if match:
        return f"did you mean '{match[0]}'?"
    listed = ", ".join(known[:MOST_LISTED])
    return f"known are: {listed}" + (f" and {len(known) - MOST_LISTED} more" if len(known) > MOST_LISTED else "")


def one_line(message: object) -> str:
    """A message as the command line prints it: one line, in which a long word or text of a file is not echoed whole.

    What was given stands at the beginning, what to do at the end: of a message that is longer than `LONGEST` the middle goes.
    """
    words = [word if len(word) <= LONGEST_WORD or "/" in word else f"{word[: LONGEST_WORD // 2]}..." for word in str(message).split()]
    text = " ".join(words)
    where, _, said = text.partition(": ")  # a path is given whole
    if len(said) > LONGEST:
        said = f"{said[: LONGEST * 6 // 10].rstrip()} ... {said[-LONGEST * 3 // 10 :].lstrip()}"
        return f"{where}: {said}"
    return text if said or len(text) <= LONGEST else f"{text[: LONGEST * 6 // 10].rstrip()} ... {text[-LONGEST * 3 // 10 :].lstrip()}"


def defect(error: Exception) -> str:
    """The line about an error that nobody expected: a defect of twin, or memory that is used up."""
    if isinstance(error, MemoryError):
        return "not enough memory; end other programs or give a smaller input"
    package = Path(__file__).parent
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename).is_relative_to(package)]
    place = f" at {Path(frames[-1].filename).relative_to(package.parent).as_posix()}:{frames[-1].lineno}" if frames else ""
    what = one_line(f"{type(error).__name__}: {error}")
    todo = f"report this line with the command and its files ({TRACEBACK}=1 shows where it comes from)"
    return f"a defect of twin {twin.__version__}, not of your input: {what}{place}; {todo}"
