"""Labels of responses for reports and plots: `control_deviation_max_X_um` -> largest control deviation of X [um]."""

import re

from twin.units import plain

UNITS = {unit.lower(): unit for unit in ("um", "arcsec", "deg", "ms", "s", "Hz", "A", "V", "Nm", "N", "W", "J", "dB")} | {"share": "1"}
"""Last word of a response's name -> unit for reports."""

PHRASES = {
    **{f"{limit}_limit_used": f"share of the {limit} limit used by {{}}" for limit in ("current", "voltage", "torque", "speed")},
    "torque_curve_used": "share of the motor's torque curve used by {}",
    "torque_rms_used": "share of the motor's rated torque used by {} (RMS)",
    "winding_heat_used": "share of the rated heat reached in the winding of {}",
    "motor_speed_used": "share of the motor's highest speed used by {}",
    "inertia_ratio": "load over rotor inertia of {}",
}
"""Phrases for responses whose names are no readable phrase."""

_LOOP = re.compile(r"(?P<what>phase_margin|gain_margin|crossover|bandwidth)_(?P<loop>current|speed|position)_loop")


def label_of(name: str) -> str:
    """A response in words, without its unit."""
    run, _, name = name.rpartition(".")
    words = name.split("_")
    if words[-1] in UNITS:
        words.pop()
    axis = words.pop() if len(words) > 1 and re.fullmatch(r"[A-Z][A-Z0-9]*", words[-1]) else ""
    stem = "_".join(words)
    if axis and stem in PHRASES:
        text = PHRASES[stem].format(axis)
    else:
        if loop := _LOOP.fullmatch(stem):
            words = [*loop["what"].split("_"), "of the", loop["loop"], "loop"]
        head = ""
        for word, said in (("smooth", "smooth "), ("max", "largest "), ("rms", "RMS ")):
            if word in words:
                words.remove(word)
                head = said + head
        if words[0] == "holding":
            head = "largest "
        text = f"{head}{' '.join(words)}{f' of {axis}' if axis else ''}"
    return f"{text}, run {run}" if run else text


def is_share(name: str) -> bool:
    """Is this response a share, to be shown in percent?"""
    return name.endswith("_share") or "_used_" in name


def unit_of(name: str) -> str:
    """Unit of a response in reports: percent for a share, '1' for a ratio."""
    return "%" if is_share(name) else UNITS.get(name.rsplit("_", 1)[-1], "1")


def scale_of(name: str) -> float:
    """Factor from the stored value to that unit."""
    return 100.0 if is_share(name) else 1.0


def titled(name: str, text: str | None = None) -> str:
    """Label (or another text on the response) and unit, for plots and tables."""
    text, unit = text or label_of(name), unit_of(name)
    return text if unit == "1" else f"{text} [{unit}]"


def valued(name: str, value: float) -> str:
    """A value with its unit; shares in percent."""
    if is_share(name):
        return f"{100.0 * value:.3g} %"
    number = plain(value, 4)
    return f"{number.rstrip('0').rstrip('.') if '.' in number else number} {unit_of(name)}".removesuffix(" 1")


def changed(name: str, value: float) -> str:
    """A difference of two values with its unit; percentage points for shares."""
    return f"{100.0 * value:.3g} percentage points" if is_share(name) else valued(name, value)
