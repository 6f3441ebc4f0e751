"""The declaration of a number of an axis: typed field, key in the machine file, bounds, SINUMERIK machine datum."""

from __future__ import annotations

from dataclasses import dataclass

from twin.control.number import Key, unit_of_key


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
