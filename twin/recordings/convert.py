"""Conversion of recorded numbers to SI: unit of the file, scale of the map, motor revolutions to travel, force to motor torque."""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from twin.errors import InputError
from twin.machine.machine import Machine
from twin.recordings.grid import TimedSignal
from twin.recordings.mapping import FOLLOWING_ERROR, ColumnMap
from twin.recordings.relations import without_sign_bit
from twin.recordings.signals import Signal
from twin.recordings.trace import BY_UNIT, DISTURBANCE, QUANTITY, quantity_of, unit_of
from twin.units import RECORDED_UNITS, dimension_recorded


@dataclass(frozen=True)
class Conversion:
    """value [SI] = factor * recorded + offset, after the sign bit of whole numbers. `unit`: assumed unit of the number. `kind` of the axis, if it is known."""

    factor: float
    offset: float
    unit: str
    kind: str | None
    sign_bit: int | None = None
    si: str = ""  # unit of the result for signals with several (disturbance, injected_command): V, A, Nm, N

    def __call__(self, values: np.ndarray) -> np.ndarray:
        if self.sign_bit is not None:
            values = without_sign_bit(values, self.sign_bit)
        return values * self.factor + self.offset if self.offset else values * self.factor


@dataclass(frozen=True)
class Channel:
    """A mapped column: its source, conversion and timing. `held`: it stood for several samples, of which the source has one."""

    column: ColumnMap
    source: TimedSignal
    conversion: Conversion
    file: str
    held: bool = False

    @property
    def key(self) -> tuple[str, str]:
        return self.column.key


def conversion_of(column: ColumnMap, signal: Signal, machine: Machine | None, where: str) -> Conversion:
    """Conversion of a recorded column to the mapped signal. Raises InputError if unit and signal do not match."""
    per_turn, own_kind = column.drive(machine)
    where = f"{where}: column '{column.name}'"
    unit = column.unit or signal.unit
    if not unit:
        raise InputError(f'{where}: the file gives no unit; give it in the map, e.g. unit = "{_example(column.signal)}"')
    if column.unit and signal.unit and column.unit != signal.unit and column.scale is None:
        alike = dimension_recorded(column.unit) == dimension_recorded(signal.unit)
        remedy = "give scale = 1.0 to overrule the file" if alike else f"give scale = ... [{column.unit} per {signal.unit}]"
        raise InputError(
            f"{where}: the unit is [{signal.unit}] in the file, [{column.unit}] in the map; leave unit out of the map, or {remedy}"
        )
    quantity, factor = dimension_recorded(unit), RECORDED_UNITS[unit][1]
    if column.signal in BY_UNIT:
        si = {"voltage": "V", "current": "A", "torque": "Nm", "force": "N"}.get(quantity, "")
        if not si:
            raise InputError(
                f"{where}: [{unit}] is not a unit of {column.signal}; use N, Nm (external load, or effect of an injected command), V or A"
            )
        return Conversion(column.factor * factor, column.offset * factor, unit, None, column.sign_bit, si)
    wanted = "position" if column.signal == FOLLOWING_ERROR else QUANTITY[column.signal]
    measured, kind = quantity_of(unit)
    if quantity in ("turns", "turning speed"):
        if per_turn is None:
            raise InputError(
                f"{where}: [{unit}] is a unit of the motor; give mm_per_rev or deg_per_rev in the map (a direct drive has none)"
            )
        factor *= per_turn / (2.0 * math.pi)
        kind = own_kind
    if quantity == "force" and wanted == "torque":
        if per_turn is None and own_kind is None:
            raise InputError(f"{where}: converting a force to motor torque needs the travel per revolution; give mm_per_rev in the map")
        factor *= per_turn / (2.0 * math.pi) if per_turn else 1.0  # a direct drive uses N in place of Nm
        measured = "torque"
    if measured != wanted:
        raise InputError(
            f"{where}: [{unit}] is not a unit of a {column.signal}; use [{_example(column.signal)}] or the like, with scale if needed"
        )
    if kind and own_kind and kind != own_kind:
        raise InputError(f"{where}: axis {column.axis} is {own_kind}, but [{unit}] is a unit of a {kind} axis; correct unit or axis")
    return Conversion(column.factor * factor, column.offset * factor, unit, kind or own_kind, column.sign_bit)


def kinds_of(columns: Sequence[ColumnMap], conversions: Sequence[Conversion], where: str) -> dict[str, str]:
    """Linear or rotary by axis, from the units of its positions and speeds."""
    kinds: dict[str, str] = {}
    for column, conversion in zip(columns, conversions):
        kind = conversion.kind
        if kind and kinds.setdefault(column.axis, kind) != kind:
            raise InputError(
                f"{where}: column '{column.name}': [{conversion.unit}] makes axis {column.axis} {kind}, another column makes it {kinds[column.axis]}; correct one unit"
            )
    for column in columns:
        if column.axis not in kinds:
            raise InputError(f"{where}: axis {column.axis} has no position or speed; map at least one of them")
    return kinds


def _example(signal: str) -> str:
    if signal in BY_UNIT:
        return "N" if signal == DISTURBANCE else "A"
    return "mm" if signal == FOLLOWING_ERROR else unit_of(signal, "linear")
