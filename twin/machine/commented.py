"""Lines of a machine file with a comment after each number, and the numbers that are marked as assumed."""

from __future__ import annotations

import tomlkit

from twin.machine.machine import Machine

ASSUMED = "assumed"
"""Word in the comment after a number that `twin machine new` assumed."""

TRIED = "tried"
"""Word in the comment after a number that `twin machine new` chose so that the simulated axis follows like the recorded one."""

BOUNDED = "bounded"
"""Word in the comment after a number that a recording gives within wide bounds only; the value is one of many that fit."""

GUESSED = (ASSUMED, TRIED, BOUNDED)
"""Words after numbers that no recording determines: an effect on such a number is a calibration, not a finding."""


def number_line(key: str, value: float, comment: str = ASSUMED) -> str:
    """`key = value  # comment` with nine significant digits, always a TOML float."""
    number = f"{float(value):.9g}"
    return commented(f"{key} = {number if any(c in number for c in '.en') else number + '.0'}", comment)


def commented(text: str, comment: str) -> str:
    """A line with its comment in the column of comments; without a comment the line alone."""
    return f"{text:42} # {comment}" if comment else text


def assumed_values(machine: Machine, words: tuple[str, ...] = (ASSUMED,)) -> list[str]:
    """Paths of the numbers whose comment in the machine file contains one of the words."""
    if machine.path is None or not machine.path.is_file():
        return []
    found: list[str] = []

    def walk(table: object, path: tuple[str, ...]) -> None:
        for key, value in getattr(table, "items", tuple)():
            if hasattr(value, "items"):
                walk(value, (*path, key))
            elif any(word in getattr(getattr(value, "trivia", None), "comment", "") for word in words):
                found.append(".".join((*path, key)))

    walk(tomlkit.parse(machine.path.read_text(encoding="utf-8-sig")), ())
    return found
