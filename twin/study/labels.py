"""Responses in words and with their units, for reports and plots: `control_deviation_max_X_um` -> largest control deviation of X [um]."""

from __future__ import annotations

import re

UNITS = {
    "um": "um",
    "arcsec": "arcsec",
    "deg": "deg",
    "ms": "ms",
    "s": "s",
    "hz": "Hz",
    "a": "A",
    "v": "V",
    "nm": "Nm",
    "n": "N",
    "w": "W",
    "j": "J",
    "db": "dB",
    "share": "1",
}
"""Last word of a response's name -> unit as people write it."""


def label_of(name: str) -> str:
    """A response in words, without its unit; a name of another form keeps its words."""
    run, _, name = name.rpartition(".")
    words = name.split("_")
    if words[-1] in UNITS:
        words.pop()
    axis = ""
    if len(words) > 1 and re.fullmatch(r"[A-Z][A-Z0-9]*", words[-1]):
        axis = f" of {words.pop()}"
    head = ""
    for word, said in (("max", "largest "), ("rms", "RMS ")):
        if word in words:
            words.remove(word)
            head = said
    text = f"{head}{' '.join(words)}{axis}"
    return f"{text}, run {run}" if run else text


def unit_of(name: str) -> str:
    """Unit of a response; '1' for a share or a ratio."""
    return UNITS.get(name.rsplit("_", 1)[-1], "1")


def titled(name: str) -> str:
    """Label and unit, as a plot has it."""
    unit = unit_of(name)
    return label_of(name) if unit == "1" else f"{label_of(name)} [{unit}]"


def valued(name: str, value: float) -> str:
    """A value with its unit; shares in percent."""
    if name.endswith("_share"):
        return f"{100.0 * value:.3g} %"
    unit = unit_of(name)
    return f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"
