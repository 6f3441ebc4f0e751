"""Errors that a user can act on: each message says what was given, where, and what to do."""

from __future__ import annotations

from collections.abc import Iterable
import difflib


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


def nearest(word: str, known: Iterable[str]) -> str:
    """The tail of an error message: the nearest known word, or else the list of all known words."""
    known = sorted(known)
    match = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    if match:
        return f"did you mean '{match[0]}'?"
    return f"known are: {', '.join(known)}"
