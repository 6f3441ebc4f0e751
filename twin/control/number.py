"""A number of a machine file: its bounds, and the unit at the end of its key (`max_velocity_m_per_min`)."""

from __future__ import annotations

from dataclasses import dataclass
import itertools
import math

INFINITE = math.inf


@dataclass(frozen=True)
class Key:
    """Bounds of a number in the unit of the file, and whether it is required."""

    low: float = -INFINITE
    high: float = INFINITE
    required: bool = True
    above: bool = False  # excludes the lower bound itself (a mass of 0)
    count: int = 1  # how many numbers


def positive(required: bool = True) -> Key:
    return Key(low=0.0, above=True, required=required)


def not_negative(required: bool = True) -> Key:
    return Key(low=0.0, required=required)


# longest first, so that '_rev_per_s2' is not read as '_per_s'
_SUFFIX_TO_SI = {
    "_deg_per_s": math.pi / 180.0,
    "_rev_per_min": 2.0 * math.pi / 60.0,
    "_rev_per_s2": 2.0 * math.pi,
    "_rev_per_s3": 2.0 * math.pi,
    "_m_per_min": 1.0 / 60.0,
    "_deg_s": math.pi / 180.0,
    "_deg": math.pi / 180.0,
    "_us": 1e-6,
}


_UNIT_WORDS = {"nm": "Nm", "n": "N", "a": "A", "v": "V", "h": "H", "hz": "Hz", "per": "/"}
_UNIT_WORDS |= {word: word for word in ("m", "kg", "s", "us", "rad", "deg", "rev", "min", "ohm", "m2", "s2", "s3")}


def unit_of_key(key: str) -> str:
    """Unit at the end of a key: 'm/rev' for screw_lead_m_per_rev, 'Nm s/rad' for a damping; '' if the key has none."""
    units = [_UNIT_WORDS[word] for word in itertools.takewhile(_UNIT_WORDS.__contains__, reversed(key.split("_")))]
    return " ".join(reversed(units)).replace(" / ", "/").replace("/ ", "1/")


def si_from_key(key: str) -> float:
    """Factor from the unit at the end of a key to SI; 1 for an SI unit."""
    for suffix, factor in _SUFFIX_TO_SI.items():
        if key.endswith(suffix):
            return factor
    return 1.0
