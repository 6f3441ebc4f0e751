"""Resampling of signals with different intervals, gaps and skew to one even grid, block by block.

Samples on the grid are copied. Between samples a cubic spline interpolates: positions of a jerk-limited move sampled every 4 ms
are then off by less than 0.1 um, with linear interpolation by 10 um.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from twin.limits import refuse_above
from twin.recordings.signals import BLOCK, Signal
from twin.recordings.timing import Stretch, Timing

MOST_ROWS = 50_000_000
"""Most samples of one run: 14 hours at 1 kHz. They are written in blocks and take 400 MB per signal on disk."""
ON_GRID = 1e-3
"""A sample within this fraction of an interval from a grid time counts as on the grid."""
MARGIN = 16
"""Samples beside a block that the spline uses; the influence of samples further away is below 1e-9."""
_GRID_ROUNDING_S = 1e-9


@dataclass(frozen=True)
class TimedSignal:
    """A signal with its timing, and its lateness relative to the position [s]."""

    signal: Signal
    timing: Timing
    skew_s: float = 0.0


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

    def times(self, first: int, last: int) -> np.ndarray:
        """Grid times [s] of rows first to last - 1."""
        return self.begin + self.period * np.arange(first, last)


def pieces_of(sources: Sequence[TimedSignal], period: float, begin_s: float, end_s: float, fill: bool) -> list[Piece]:
    """Grids over the times with samples of all signals. Unless gaps are filled, a grid ends at a gap of any signal."""
    spans = [(begin_s, end_s)]
    bridged = 0
    for source in sources:
        shift = source.skew_s
        own = [(s.begin - shift, s.end - shift) for s in source.timing.stretches]
        if fill:
            bridged = max(bridged, len(own) - 1)
            own = [(own[0][0], own[-1][1])]
        spans = [(max(a, c), min(b, d)) for a, b in spans for c, d in own if min(b, d) > max(a, c)]
    # the grid passes through the samples of the first signal, so that they are copied
    lead = sources[0].timing.stretches[0].begin - sources[0].skew_s
    out = []
    for begin, end in spans:
        first = np.ceil((begin - lead) / period - ON_GRID)
        last = np.floor((end - lead) / period + ON_GRID)
        refuse_above(
            last - first, MOST_ROWS, "samples on the grid", "period_ms of the map, or the times of the file", "give a longer period"
        )
        if last > first:
            out.append(Piece(float(lead + first * period), period, int(last - first) + 1, bridged))
    return out


def on_grid(source: TimedSignal, piece: Piece, first: int, last: int, fill: bool = False) -> np.ndarray:
    """Values (last - first,) of a signal at rows first to last - 1 of a piece."""
    times = piece.times(first, last) + source.skew_s
    signal, stretches = source.signal, source.timing.stretches
    if not fill:
        middle = 0.5 * (piece.begin + piece.end) + source.skew_s
        stretches = (min(stretches, key=lambda s: max(s.begin - middle, middle - s.end)),)
    own = stretches[0]
    if own.even and len(stretches) == 1:
        at = (times - own.begin) / own.interval
        whole = np.rint(at)
        if np.all(np.abs(at - whole) < ON_GRID + _GRID_ROUNDING_S / own.interval):  # copied if all times are sample times
            rows = np.clip(whole.astype(int), 0, own.count - 1)
            low, high = int(rows[0]), int(rows[-1])
            return np.asarray(signal.values[own.first + low : own.first + high + 1], float)[rows - low]
    # a cubic spline also bridges the gap between two stretches
    base, values = map(np.concatenate, zip(*(_samples(signal, own, times) for own in stretches)))
    if len(base) < 4:
        return np.interp(times, base, values)
    return CubicSpline(base, values)(np.clip(times, base[0], base[-1]))


def _samples(signal: Signal, own: Stretch, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of the samples of a stretch around these times, with a margin; beside a gap those at its end."""
    margin = int(np.ceil(own.spread / own.interval)) + MARGIN
    low = min(max(int((times[0] - own.begin) / own.interval) - margin, 0), max(own.count - margin, 0))
    high = max(min(int((times[-1] - own.begin) / own.interval) + margin + 2, own.count), min(margin, own.count))
    values = np.asarray(signal.values[own.first + low : own.first + high], float)
    if own.even or signal.time is None:
        return own.begin + own.interval * np.arange(low, high), values
    base, kept = np.unique(np.asarray(signal.time[own.first + low : own.first + high], float), return_index=True)
    return base, values[kept]


def block_with_most_travel(source: TimedSignal, piece: Piece, fill: bool) -> tuple[int, int]:
    """Rows (first, last) of the block of a piece with the farthest travel of the signal; the whole piece if it is short."""
    best, most = (0, min(piece.count, BLOCK)), -1.0
    for first in range(0, piece.count, BLOCK):
        last = min(first + BLOCK, piece.count)
        if last - first < min(BLOCK // 2, piece.count):
            continue
        travel = float(np.abs(np.diff(on_grid(source, piece, first, last, fill))).sum())
        if travel > most:
            best, most = (first, last), travel
    return best
