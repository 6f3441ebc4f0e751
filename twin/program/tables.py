"""Meaning of each program word: tables used by the readers and printed in docs/programs.md.

ACTS: it changes the motion or the meaning of later words. NOTE: understood, without effect on the simulation, noted once.
REFUSED: known but not simulated; the text says what to do.
"""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

Handler = TypeVar("Handler")


class Word(NamedTuple, Generic[Handler]):
    """A word of a language: kind, meaning, what carries it out, and its modal group: a block takes one word of a group."""

    kind: str
    meaning: str
    handler: Handler | None = None
    group: str = ""


ACTS, NOTE, REFUSED = "acts", "note", "refused"
NOTHING = "understood, no effect on the motion"
STOPS: Word = Word(ACTS, "exact stop, then on")
UNKNOWN = "not known: what it does is set by the builder of the machine; here it changes nothing"


def named(kind: str, meaning: str, names: str, handler: Handler | None = None, group: str = "") -> dict[str, Word[Handler]]:
    """Words with one meaning; names of several words are separated by commas."""
    return dict.fromkeys(names.split(", ") if "," in names else names.split(), Word(kind, meaning, handler, group))
