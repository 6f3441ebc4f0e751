"""Lines of a machine file with a comment after each number, and the numbers that are marked as assumed."""

from collections.abc import Collection, Mapping, MutableMapping, Sequence
import functools
import re
from typing import Any

import tomlkit

from twin.documents import flat, toml_key, toml_text
from twin.machine.machine import Machine
from twin.machine.parameters import field_key, file_from_typed
from twin.units import in_words

MEASURED = "measured"
"""Word in the comment after a number that comes from a recording alone."""

ASSUMED = "assumed"
"""Word in the comment after a number that `twin machine new` assumed."""

TRIED = "tried"
"""Word in the comment after a number that `twin machine new` chose so that the simulated axis follows like the recorded one."""

BOUNDED = "bounded"
"""Word in the comment after a number that a recording gives within wide bounds only; the value is one of many that fit."""

UNSCALED = "unscaled"
"""Word in the comment after a number that is measured but for the scale of a channel. A change of it is one all the same: the scale cancels."""

GUESSED = (ASSUMED, TRIED, BOUNDED)
"""Words after numbers that no recording determines: an effect on such a number is a calibration, not a finding."""

UNSURE = (*GUESSED, UNSCALED)
"""All grades of a number that is not measured in its unit. Where a comment has several, the first one counts."""

Numbers = dict[str, tuple[float, str]]
"""Number of an axis -> its value and comment. A number is a field of `Axis` with its value in SI, or a key of the file below the axis."""


def head_lines(about: Sequence[str], name: str, model: str, tolerance: tuple[float, str], axes: Sequence[str]) -> list[str]:
    """Beginning of a machine file: `about` it in comments, and the keys before its first table."""
    return [
        *(f"# {line}" for line in about),
        "",
        f"name = {toml_text(name)}",
        f"model = {toml_text(model)}",
        "gravity_m_per_s2 = 9.81",
        number_line("parameter_tolerance", *tolerance),
        f"axis_order = [{', '.join(map(toml_text, axes))}]",
        "",
    ]


def axis_lines(
    name: str, drive: str, words: Mapping[str, Sequence[str]], numbers: Numbers, given: MutableMapping[str, float], source: str
) -> list[str]:
    """`[axis.NAME]` and the tables below it, each with its `words` (table -> lines) before its numbers.

    `given` are values by key of the file from the file `source`, which take the place of the numbers and are removed.
    """
    tables = {part: list(lines) for part, lines in words.items()}
    for field, (value, comment) in numbers.items():
        key = field_key(field, drive)
        part, _, leaf = key.rpartition(".")
        number = value if isinstance(value, int) else file_from_typed(leaf, value)
        if key in given:
            number, comment = given.pop(key), f"from {source}"
        tables.setdefault(part, []).append(number_line(leaf, number, comment))
    axis = f"axis.{toml_key(name)}"
    return ["", *(line for part, lines in tables.items() for line in (f"[{axis}.{part}]" if part else f"[{axis}]", *lines))]


def number_line(key: str, value: float, comment: str = ASSUMED) -> str:
    """`key = value  # comment` with nine significant digits, a TOML float unless the value is an int."""
    number = f"{value:.9g}"
    return commented(f"{key} = {number if isinstance(value, int) or any(c in number for c in '.en') else number + '.0'}", comment)


def of_unknown_scale(word: str, taken: Mapping[str, str]) -> str:
    """Comment of a number from signals in these units (signal -> unit) whose scale nobody gave; `word` without one."""
    return f"{UNSCALED}: {unknown_scales(taken)}; {word}" if taken else word


def unknown_scales(taken: Mapping[str, str]) -> str:
    """Signals with a stated unit that has no scale, and those whose unit nobody stated ("?"), in words."""
    scale = ", ".join(f"{in_words(signal)} in [{unit}]" for signal, unit in taken.items() if unit != "?")
    unit = ", ".join(in_words(signal) for signal, unit in taken.items() if unit == "?")
    return ", ".join(f"no {what} of {of}" for what, of in (("scale", scale), ("unit", unit)) if of)


def commented(text: str, comment: str) -> str:
    """A line with its comment in the column of comments; without a comment the line alone."""
    return f"{text:42} # {comment}" if comment else text


def guessed_values(machine: Machine, words: Collection[str] = GUESSED) -> dict[str, str]:
    """Path -> grade of the numbers of a machine whose grade is one of the words."""
    return {path: grade for path, grade in _grades(machine.text).items() if grade in words}


OF_SUM = "of the sum"
"""In the comment of a mass of which only the sum with another one is known: how both divide it is assumed."""


def divided_masses(machine: Machine) -> set[str]:
    """Axes whose file assumes how the mass divides between motor and load."""
    comments = {path: comment for path, (_, comment) in _commented_values(machine.text).items()}
    return {axis for axis in machine.axis_names if OF_SUM in comments.get(f"axis.{axis}.moving_mass_kg", "")}


_INTERVAL = re.compile(r"95 % (?:\+- (?P<half>[^\s,]+)(?P<share> %)?|(?P<low>\S+) \.\. (?P<high>[^\s,]+))")


def measured_interval(machine: Machine, path: str) -> tuple[float, float] | None:
    """The 95 % interval that a machine file states for a number that it does not call assumed, tried or bounded, in the unit of the file; None without one."""
    value, comment = _commented_values(machine.text).get(path, (None, ""))
    found = _INTERVAL.search(comment)
    if found is None or not isinstance(value, float) or _grades(machine.text)[path] in GUESSED:
        return None
    if found["low"]:
        return float(found["low"]), float(found["high"])
    half = float(found["half"]) * (abs(value) / 100.0 if found["share"] else 1.0)
    return value - half, value + half


@functools.lru_cache(maxsize=8)
def _grades(text: str) -> dict[str, str]:
    """Path -> grade of each value of a machine file: the first word of UNSURE in its comment, "" without one."""
    return {path: next((word for word in UNSURE if word in comment), "") for path, (_, comment) in _commented_values(text).items()}


@functools.lru_cache(maxsize=8)
def _commented_values(text: str) -> dict[str, tuple[Any, str]]:
    """Path -> value and comment in a machine file."""
    values = flat(tomlkit.parse(text), nested=Mapping)
    return {path: (value, value.trivia.comment if hasattr(value, "trivia") else "") for path, value in values.items()}
