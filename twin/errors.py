"""Errors that a user can act on. Each message states where, what was given and what to do."""

from collections.abc import Iterable
import difflib
import os
from pathlib import Path
import re
import traceback

import twin

TRACEBACK = "TWIN_TRACEBACK"
"""Environment variable; if set, an unexpected error prints Python's traceback."""
LONGEST = 300
"""Characters of a message after the file name."""
LONGEST_WORD = 80
LONGEST_PATH = 240
MOST_LISTED = 24
"""Number of known words that a message lists."""


_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")
"""Characters that steer a terminal or turn its writing around; tab and end of line are none."""


def plain(text: str) -> str:
    """The text with control characters written as escapes (\\x1b): names in files of others may contain them."""
    return _CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


class TwinError(Exception):
    """Base of all errors of this package. The command line prints the message as one line and exits with 2."""


class InputError(TwinError):
    """An unusable file, value or argument."""


class SimulationError(TwinError):
    """A simulation that stopped early; `trace` is the recording up to that point, or None."""

    def __init__(self, message: str, trace: object | None = None) -> None:
        super().__init__(message)
        self.trace = trace


def nearest(word: object, known: Iterable[str]) -> str:
    """End of an error message: the nearest known word or, if none is near, a list of the known words."""
    known = sorted(known)
    match = difflib.get_close_matches(str(word), known, n=1, cutoff=0.6)
    if match:
        return f"did you mean '{match[0]}'?"
    listed = ", ".join(known[:MOST_LISTED])
    return f"known are: {listed}" + (f" and {len(known) - MOST_LISTED} more" if len(known) > MOST_LISTED else "")


def no_file(path: str | Path, give: str) -> InputError:
    """The error about a file that is not there, or is a folder; `give` says what to give."""
    return InputError(f"{path}: {'a folder, but a file is needed' if os.path.isdir(path) else 'no such file'}; {give}")


def one_line(message: object) -> str:
    """A message as the command line prints it: one line of `plain` text, with long words shortened.

    The middle of a message longer than `LONGEST` is cut out, since the start says what was given and the end what to do.
    """
    text = " ".join(_short(plain(word)) for word in str(message).split())
    where, _, said = text.partition(": ")  # a path is only shortened if no system could open it
    if len(said) > LONGEST:
        said = f"{said[: LONGEST * 6 // 10].rstrip()} ... {said[-LONGEST * 3 // 10 :].lstrip()}"
        return f"{where}: {said}"
    return text if said or len(text) <= LONGEST else f"{text[: LONGEST * 6 // 10].rstrip()} ... {text[-LONGEST * 3 // 10 :].lstrip()}"


def _short(word: str) -> str:
    """A word of a message; a path keeps its end, which names the file."""
    if "/" in word or "\\" in word:
        return word if len(word) <= LONGEST_PATH else f"{word[: LONGEST_PATH // 2]}...{word[-LONGEST_PATH // 3 :]}"
    return word if len(word) <= LONGEST_WORD else f"{word[: LONGEST_WORD // 2]}..."


def defect(error: Exception) -> str:
    """Message about an unexpected error: a defect of twin, or exhausted memory."""
    if isinstance(error, MemoryError):
        return "not enough memory; close other programs or use a smaller input"
    package = Path(__file__).parent
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename).is_relative_to(package)]
    place = f" at {Path(frames[-1].filename).relative_to(package.parent).as_posix()}:{frames[-1].lineno}" if frames else ""
    what = one_line(f"{type(error).__name__}: {error}")
    todo = f"please report this line with the command and its files ({TRACEBACK}=1 prints the traceback)"
    return f"defect in twin {twin.__version__}, not in your input: {what}{place}; {todo}"
