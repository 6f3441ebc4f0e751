"""Mapped columns as channels: conversion to SI, and resampling of different intervals, gaps and skew to one even grid, block by block.

A number becomes SI by the unit of the file, the scale of the map, motor revolutions to travel, and force to motor torque. Samples on the grid are
copied. Between samples a cubic spline interpolates: positions of a jerk-limited move sampled every 4 ms are then off by less than 0.1 um, with linear
interpolation by 10 um.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from scipy.interpolate import CubicSpline

from twin.errors import InputError
from twin.limits import refuse_above
from twin.machine.machine import Machine
from twin.recordings.mapping import FOLLOWING_ERROR, ColumnMap
from twin.recordings.relations import without_sign_bit
from twin.recordings.signals import BLOCK, Signal
from twin.recordings.timing import Stretch, Timing
from twin.recordings.trace import BY_UNIT, DISTURBANCE, POSITIONS, QUANTITY, quantity_of, unit_of
from twin.units import RECORDED_UNITS, dimension_recorded

MOST_ROWS = 50_000_000
"""Most samples of one run: 14 hours at 1 kHz. They are written in blocks and take 400 MB per signal on disk."""
ON_GRID = 1e-3
"""A sample within this fraction of an interval from a grid time counts as on the grid."""
MARGIN = 16
"""Samples beside a block that the spline uses; the influence of samples further away is below 1e-9."""
_GRID_ROUNDING_S = 1e-9


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
    """A mapped column: its signal with timing, conversion, and lateness relative to the position [s]. `held`: it stood for several samples, of which
    the signal has one."""

    column: ColumnMap
    signal: Signal
    timing: Timing
    conversion: Conversion
    file: str
    skew_s: float
    held: bool

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
        both = f"the unit is [{signal.unit}] in the file, [{column.unit}] in the map"
        raise InputError(f"{where}: {both}; leave unit out of the map, or {remedy}")
    quantity, factor = dimension_recorded(unit), RECORDED_UNITS[unit][1]
    if column.signal in BY_UNIT:
        si = {"voltage": "V", "current": "A", "torque": "Nm", "force": "N"}.get(quantity, "")
        if not si:
            units = "N, Nm (external load, or effect of an injected command), V or A"
            raise InputError(f"{where}: [{unit}] is not a unit of {column.signal}; use {units}")
        return Conversion(column.factor * factor, column.offset * factor, unit, None, column.sign_bit, si)
    wanted = "position" if column.signal == FOLLOWING_ERROR else QUANTITY[column.signal]
    measured, kind = quantity_of(unit)
    if quantity in ("turns", "turning speed"):
        if per_turn is None:
            remedy = "give mm_per_rev or deg_per_rev in the map (a direct drive has none)"
            raise InputError(f"{where}: [{unit}] is a unit of the motor; {remedy}")
        factor, kind = factor * per_turn / (2.0 * math.pi), own_kind
    if quantity == "force" and wanted == "torque":
        if per_turn is None and own_kind is None:
            raise InputError(f"{where}: converting a force to motor torque needs the travel per revolution; give mm_per_rev in the map")
        factor *= per_turn / (2.0 * math.pi) if per_turn else 1.0  # a direct drive uses N in place of Nm
        measured = "torque"
    if measured != wanted:
        usual = _example(column.signal)
        raise InputError(f"{where}: [{unit}] is not a unit of a {column.signal}; use [{usual}] or the like, with scale if needed")
    if kind and own_kind and kind != own_kind:
        raise InputError(f"{where}: axis {column.axis} is {own_kind}, but [{unit}] is a unit of a {kind} axis; correct unit or axis")
    return Conversion(column.factor * factor, column.offset * factor, unit, kind or own_kind, column.sign_bit)


def _example(signal: str) -> str:
    if signal in BY_UNIT:
        return "N" if signal == DISTURBANCE else "A"
    return "mm" if signal == FOLLOWING_ERROR else unit_of(signal, "linear")


JUMP = 20.0
"""A position that jumps by more than this multiple of its largest step was not recorded before."""


def recorded_from(channels: Sequence[Channel]) -> float:
    """Time [s] of the first sample after those that a logger wrote as zeros, before the control was on; -inf without them.

    All channels are then zero, and a position is somewhere else in the next sample.
    """
    heads = [c.signal.head for c in channels]
    count = min(map(len, heads))
    first = int(np.argmax(np.any([head[:count] != 0.0 for head in heads], axis=0)))
    if first < 2 or len({id(c.signal.time) for c in channels}) > 1:
        return -math.inf
    after = [head[first:] for head, c in zip(heads, channels) if c.key[1] in POSITIONS]
    jumps = any(len(values) > 2 and abs(values[0]) > JUMP * float(np.abs(np.diff(values)).max()) > 0.0 for values in after)
    return float(channels[0].signal.time[first : first + 1][0]) if jumps else -math.inf


@dataclass(frozen=True)
class Piece:
    """One even grid without gaps: begin [s], period [s], number of samples. `filled`: number of gaps that were bridged."""

    begin: float
    period: float
    count: int
    filled: int = 0

    @property
    def end(self) -> float:
        return self.begin + self.period * (self.count - 1)


def pieces_of(channels: Sequence[Channel], period: float, begin_s: float, end_s: float, fill: bool) -> list[Piece]:
    """Grids over the times with samples of all channels. Unless gaps are filled, a grid ends at a gap of any of them."""
    spans = [(begin_s, end_s)]
    bridged = 0
    for channel in channels:
        own = [(s.begin - channel.skew_s, s.end - channel.skew_s) for s in channel.timing.stretches]
        if fill:
            bridged = max(bridged, len(own) - 1)
            own = [(own[0][0], own[-1][1])]
        spans = [(max(a, c), min(b, d)) for a, b in spans for c, d in own if min(b, d) > max(a, c)]
    # the grid passes through the samples of the first channel, so that they are copied
    lead = channels[0].timing.stretches[0].begin - channels[0].skew_s
    out = []
    for begin, end in spans:
        first = np.ceil((begin - lead) / period - ON_GRID)
        last = np.floor((end - lead) / period + ON_GRID)
        where = "period_ms of the map, or the times of the file"
        refuse_above(last - first, MOST_ROWS, "samples on the grid", where, "give a longer period")
        if last > first:
            out.append(Piece(float(lead + first * period), period, int(last - first) + 1, bridged))
    return out


def on_grid(channel: Channel, piece: Piece, first: int, last: int, fill: bool) -> np.ndarray:
    """Values (last - first,) [SI] of a channel at rows first to last - 1 of a piece."""
    times = piece.begin + piece.period * np.arange(first, last) + channel.skew_s
    signal, stretches = channel.signal, channel.timing.stretches
    if not fill:
        middle = 0.5 * (piece.begin + piece.end) + channel.skew_s
        stretches = (min(stretches, key=lambda s: max(s.begin - middle, middle - s.end)),)
    own = stretches[0]
    if own.even and len(stretches) == 1:
        at = (times - own.begin) / own.interval
        whole = np.rint(at)
        if np.all(np.abs(at - whole) < ON_GRID + _GRID_ROUNDING_S / own.interval):  # copied if all times are sample times
            rows = np.clip(whole.astype(int), 0, own.count - 1)
            low, high = int(rows[0]), int(rows[-1])
            return channel.conversion(np.asarray(signal.values[own.first + low : own.first + high + 1], float)[rows - low])
    # a cubic spline also bridges the gap between two stretches
    base, values = map(np.concatenate, zip(*(_samples(signal, own, times) for own in stretches)))
    if len(base) < 4:
        return channel.conversion(np.interp(times, base, values))
    return channel.conversion(CubicSpline(base, values)(np.clip(times, base[0], base[-1])))


def _samples(signal: Signal, own: Stretch, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of the samples of a stretch around these times, with a margin; beside a gap those at its end."""
    margin = int(np.ceil(own.spread / own.interval)) + MARGIN
    low = min(max(int((times[0] - own.begin) / own.interval) - margin, 0), max(own.count - margin, 0))
    high = max(min(int((times[-1] - own.begin) / own.interval) + margin + 2, own.count), min(margin, own.count))
    values = np.asarray(signal.values[own.first + low : own.first + high], float)
    if own.even:
        return own.begin + own.interval * np.arange(low, high), values
    base, kept = np.unique(np.asarray(signal.time[own.first + low : own.first + high], float), return_index=True)
    return base, values[kept]


def block_with_most_travel(channel: Channel, piece: Piece, fill: bool) -> tuple[int, int]:
    """Rows (first, last) of the block of a piece with the farthest travel of the channel; the whole piece if it is short."""
    best, most = (0, min(piece.count, BLOCK)), -1.0
    for first in range(0, piece.count, BLOCK):
        last = min(first + BLOCK, piece.count)
        if last - first < min(BLOCK // 2, piece.count):
            continue
        travel = float(np.abs(np.diff(on_grid(channel, piece, first, last, fill))).sum())
        if travel > most:
            best, most = (first, last), travel
    return best
