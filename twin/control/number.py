"""A number of a machine file: its bounds, the unit at the end of its key (`max_velocity_m_per_min`), and the declaration of one of an axis.

The declaration says all that other rooms need: how a control holds the number, how people read it, how a fit moves it, which run shows it.
"""

from collections.abc import Callable, Mapping
import dataclasses
from dataclasses import MISSING, dataclass, fields
import functools
import itertools
import math
from typing import Any, NamedTuple


@dataclass(frozen=True)
class Key:
    """Bounds of a number in the unit of the file, and whether it is required."""

    low: float = -math.inf
    high: float = math.inf
    required: bool = True
    above: bool = False  # excludes the lower bound itself (a mass of 0)
    count: int = 1  # how many numbers
    whole: bool = False  # counts something


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


class OnControl(NamedTuple):
    """A number in the files of a control: name there, unit and its size in SI on a linear and on a rotary axis, grade of the source."""

    name: str
    units: tuple[str, str]
    si: tuple[float, float]
    grade: str = "A"

    @property
    def code(self) -> str:
        """The first word of the name, which stands in a file: MD32450."""
        return self.name.split(" ")[0]


Units = tuple[tuple[str, str], tuple[float, float]]


def alike(unit: str, si: float = 1.0) -> Units:
    """A unit and its size in SI on any axis."""
    return (unit, unit), (si, si)


def lengths(after: str = "") -> Units:
    """Millimetres and degrees, with what follows the unit: '/s'."""
    return (f"mm{after}", f"deg{after}"), (1e-3, math.pi / 180.0)


def held(**controls: tuple[str, str, float]) -> dict[str, OnControl]:
    """A number that controls hold in one unit on any axis: control -> name, unit and its size in SI."""
    return {c: OnControl(name, *alike(unit, si), "A" if c == "sinumerik" else "C") for c, (name, unit, si) in controls.items()}


@dataclass(frozen=True)
class Search:
    """How a fit moves a number: by its logarithm; by itself, in `unit` [SI], if it may be 0.

    step    step of the difference quotient, in what is moved
    low, high   bounds of the number
    softer  what a stabler loop adds to what is moved
    """

    unit: float = 0.0
    step: float = 0.02
    low: float = 0.0
    high: float = math.inf
    softer: float = 0.0

    def coded(self, value: float) -> float:
        """What is moved."""
        return value / self.unit if self.unit else math.log(max(value, 1e-300))

    def decoded(self, code: float) -> float:
        """The number [SI]."""
        return code * self.unit if self.unit else math.exp(code)

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of what is moved; a logarithm is kept from overflow."""
        if self.unit:
            return self.low / self.unit, self.high / self.unit
        return max(self.coded(self.low), -40.0), min(math.log(self.high), 40.0)


A_DELAY = Search(unit=1e-3)
"""A time that may be 0, in milliseconds."""


@dataclass(frozen=True)
class Parameter:
    """One number of an axis: `field` of `twin.machine.axis.Axis`, or of a block, and its key for each drive ('' if it has none).

    data      how controls hold it; the one place where this is stated
    absent    its value where the file omits it; None: required, or unknown
    shown     name, unit, and factor from SI or text of all numbers of the blocks, in a data sheet; None: not by itself
    search    how a fit in closed loop moves it; None: none does
    seen_in   the run that identifies it; '' if any motion does
    after     numbers without which no run identifies it
    """

    field: str
    screw: str
    gear: str
    direct: str
    bounds: Key
    data: Mapping[str, OnControl] = dataclasses.field(default_factory=dict, hash=False)
    absent: float | None = None
    shown: tuple[str, str, float | Callable[[Any], str]] | None = None
    search: Search | None = None
    seen_in: str = ""
    after: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The field without its table."""
        return self.field.rsplit(".", 1)[-1]

    def text(self, numbers: object) -> str:
        """The number as a data sheet shows it, from those of all blocks; '-' if the axis does not have it."""
        assert self.shown is not None
        size, value = self.shown[2], getattr(numbers, self.name)
        if not isinstance(size, float):
            return size(numbers)
        return "-" if self.is_absent(value) else f"{value * size:.4g}"

    def is_absent(self, value: float) -> bool:
        """True for the value of an axis without this number. A required weight or delay of 0 is one that the axis has."""
        return value == self.absent and (self.bounds.above or not self.bounds.required)

    def key(self, drive: str) -> str:
        """Key below `[axis.N]`, or in the table of its block, for this drive or kind of axis."""
        return {"screw": self.screw, "linear": self.screw, "gear": self.gear, "rotary": self.gear, "direct": self.direct}[drive]

    def unit(self, drive: str) -> str:
        """Unit for this drive, from the key; '1' for a plain number."""
        return unit_of_key(self.key(drive).rsplit(".", 1)[-1]) or "1"


def same_key(
    key: str, bounds: Key, data: Mapping[str, OnControl] | None = None, *, field: str = "", direct: str = "", **more: Any
) -> Parameter:
    """A number with the same key for screw and gear; `direct` is the last part of the key of a direct drive if it differs."""
    *tables, leaf = key.split(".")
    return Parameter(field or key, key, key, ".".join([*tables, direct or leaf]), bounds, data or {}, **more)


def number(bounds: Key, data: Mapping[str, OnControl] | None = None, absent: Any = MISSING, **more: Any) -> Any:
    """A field of the numbers of a block that every axis may have: bounds, data of controls, value where the file omits it; `more` as in `same_key`."""
    return dataclasses.field(
        default=absent, metadata={"declared": (bounds, data, {"absent": None if absent is MISSING else absent, **more})}
    )


def numbers_of(block: type, table: str = "loops") -> tuple[Parameter, ...]:
    """The numbers of a block, from its dataclass of values; the key of each is its name, or `key`, in `[axis.N.table]`."""
    declared = [(f.name, *f.metadata["declared"]) for f in fields(block)]
    return tuple(
        same_key(f"{table}.{more.pop('key', name)}", bounds, data, field=f"{table}.{name}", **more) for name, bounds, data, more in declared
    )
