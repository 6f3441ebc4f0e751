"""A number of a machine file: its bounds, the unit at the end of its key (`max_velocity_m_per_min`), and the declaration of one of an axis."""

from __future__ import annotations

from dataclasses import dataclass
import functools
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


@functools.cache
def si_from_key(key: str) -> float:
    """Factor from the unit at the end of a key to SI; 1 for an SI unit."""
    for suffix, factor in _SUFFIX_TO_SI.items():
        if key.endswith(suffix):
            return factor
    return 1.0


@dataclass(frozen=True)
class Datum:
    """One machine datum: number, name, unit on the control, the plain key that it replaces, and the factor from datum to key."""

    number: int
    name: str
    unit: str
    key: str  # below the axis, e.g. loops.position_gain_per_s; travel_m.0 is the first of two numbers
    factor: float

    @property
    def label(self) -> str:
        return f"MD{self.number}"


@dataclass(frozen=True)
class Parameter:
    """One number of an axis: `field` of `twin.machine.axis.Axis`, and its key below `[axis.N]` for each drive ('' if it has none).

    `data`: machine data (number, name, unit, factor to the unit of the key) of a linear and of a rotary axis.
    """

    field: str
    screw: str
    gear: str
    direct: str
    bounds: Key
    data: tuple[tuple[int, str, str, float] | None, tuple[int, str, str, float] | None] = (None, None)

    def key(self, drive: str) -> str:
        """Key below `[axis.N]` for this drive."""
        return {"screw": self.screw, "gear": self.gear, "direct": self.direct}[drive]

    def unit(self, drive: str) -> str:
        """Unit for this drive, from the key; '1' for a plain number."""
        return unit_of_key(self.key(drive).rsplit(".", 1)[-1]) or "1"


def same_key(key: str, bounds: Key, datum: tuple[int, str, str, float] | None = None, *, field: str = "", direct: str = "") -> Parameter:
    """A number with the same key for screw and gear; `direct` is the last part of the key of a direct drive if it differs."""
    *tables, leaf = key.split(".")
    return Parameter(field or key, key, key, ".".join([*tables, direct or leaf]), bounds, (datum, datum))
