"""Decide whether the position loop is closed in the NC or in the drive (dynamic servo control, DSC).

The NC's speed set point v*(t) and the position x(t) are recorded. The two laws for the speed command that the axis follows:

    closed in the NC      u(T) = v*(T)
    closed in the drive   u(T) = v*(T - Td) - Kv (x(T) - x(T - Td))        the drive uses its newest encoder value

The axis follows u with the lag of the speed loop, v(T) = u(T - lag). Each law is fitted on the even pieces of the motion and judged on the
odd ones, then the other way round. At a steady speed the second law gives v* = (1 + Kv Td) v, so Td is well determined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from scipy.optimize import least_squares

from twin.estimate.held_out_gain import rms_of
from twin.estimate.regression import regress
from twin.identify.axis_run import AxisRun
from twin.identify.position_control import loop_position
from twin.machine.axis import Axis

MOST_DELAY_S, MOST_LAG_S = 0.03, 0.03
"""Longest delay of the drive's position loop and longest lag of the speed loop tried [s]."""

MOST_CYCLES = 10
"""Delay and lag are at most this many position cycles."""

PASS_HZ, REACH_S = 50.0, 0.02
"""Speed and set point are compared below this frequency; half length of the symmetric filter window."""

PIECE_S = 0.05
LEAST_PIECES = 4
MOVES = 0.05
"""Pieces slower than this share of the axis' highest speed are not used."""

MOST_PIECES_READ = 32
"""Largest number of pieces, evenly spread over the motion; more cost time without changing the result."""

LEAST_DELAY_CYCLES = 0.25
"""A delay shorter than this share of a position cycle is no evidence for DSC: a telegram to a drive takes longer."""

CLEARER = 1.3
"""On held-out pieces the residual of the drive-side law must be smaller than that of the NC-side law by this factor."""

MOST_PIECES = 0.75
"""The drive-side law must be better on this share of these pieces."""


@dataclass(frozen=True)
class DrivePositionLoop:
    """Result of the comparison: delay Td with its standard deviation and lag of the speed loop [s], and the evidence.

    `left_nc`, `left_drive`: RMS residual of the speed on held-out pieces [axis units a second]; `closed_in_drive` is the verdict.
    """

    closed_in_drive: bool
    delay_s: float
    delay_deviation: float
    lag_s: float
    left_nc: float
    left_drive: float
    pieces: int

    quantile = 1.96

    @property
    def values(self) -> dict[str, float]:
        """The delay, if the drive closes the loop."""
        return {"dsc_delay_s": self.delay_s} if self.closed_in_drive else {}

    @property
    def deviations(self) -> dict[str, float]:
        """Its standard deviation."""
        return dict.fromkeys(self.values, self.delay_deviation)

    def evidence(self, unit: str, factor: float) -> str:
        """One line of text; `factor` converts axis units a second to `unit`."""
        where = "drive" if self.closed_in_drive else "NC"
        return (
            f"position loop closed in the {where}: on {self.pieces} held-out pieces the speed differs from its law by {self.left_drive * factor:.3g} {unit} "
            f"(drive) and {self.left_nc * factor:.3g} {unit} (NC)"
        )


def drive_position_loop(axis: Axis, runs: Sequence[AxisRun], position_gain: float) -> DrivePositionLoop | None:
    """Compare both laws; None without speed set point, position or enough motion."""
    if runs and runs[0].cycle >= min(MOST_DELAY_S, MOST_LAG_S):  # such samples show no delay of a drive
        return None
    pieces = [p for r in runs for p in _pieces_of(axis, r, position_gain)]
    fastest = max((float(np.abs(p.speed).max()) for p in pieces), default=0.0)
    pieces = [p for p in pieces if np.abs(p.speed).max() > MOVES * fastest]
    if len(pieces) < LEAST_PIECES:
        return None
    pieces = [pieces[i] for i in np.unique(np.linspace(0, len(pieces) - 1, MOST_PIECES_READ).astype(int))]
    cycle = runs[0].cycle
    x, alone = (_fitted(pieces, cycle, drive) for drive in (True, False))
    left_nc, left_drive = (rms_of(_left(pieces, v)) for v in (alone, x))
    if left_nc < CLEARER * left_drive:  # not clearer even on the fitted pieces
        return DrivePositionLoop(False, float(x[0]), np.inf, float(alone[1]), left_nc, left_drive, len(pieces))
    squares = np.zeros((2, len(pieces)))
    for held_out in (0, 1):
        for law in (0, 1):
            of_half = _fitted([p for k, p in enumerate(pieces) if k % 2 != held_out], cycle, bool(law))
            squares[law, held_out::2] = [np.mean(p.left(of_half) ** 2) for p in pieces[held_out::2]]
    left_nc, left_drive = (float(np.sqrt(np.mean(s))) for s in squares)
    better = float(np.mean(squares[1] < squares[0]))
    h = 0.05 * cycle
    columns = np.column_stack([(_left(pieces, x + d) - _left(pieces, x - d)) / (2.0 * h) for d in h * np.eye(2)])
    fit = regress(columns, _left(pieces, x), np.repeat(np.arange(len(pieces)), [len(p.speed) for p in pieces]))
    apart = bool(x[0] > max(4.0 * fit.deviations[0], LEAST_DELAY_CYCLES * cycle))
    closed = left_nc > CLEARER * left_drive and better >= MOST_PIECES and apart
    delay, lag = x.tolist()
    return DrivePositionLoop(closed, delay, float(fit.deviations[0]), lag, left_nc, left_drive, len(pieces))


@dataclass(frozen=True)
class _Piece:
    """A piece of one run: rows (row,), and times, v*, position and filtered speed of the whole run."""

    gain: float
    rows: slice
    start: np.ndarray
    middle: np.ndarray
    command: np.ndarray
    position: np.ndarray
    all_speed: np.ndarray
    window: np.ndarray

    @property
    def speed(self) -> np.ndarray:
        return self.all_speed[self.rows]

    def left(self, x: np.ndarray) -> np.ndarray:
        """Measured speed minus the law's (row,), for x = (Td, lag)."""
        half = len(self.window) // 2
        # only what the window of the piece covers
        low, high = max(self.rows.start - half, 0), min(self.rows.stop + half, len(self.middle))
        at = self.middle[low:high] - x[1]
        u = np.interp(at - x[0], self.start, self.command)
        if x[0] != 0.0:
            u = u - self.gain * (np.interp(at, self.start, self.position) - np.interp(at - x[0], self.start, self.position))
        padded = np.pad(u, (half - (self.rows.start - low), half - (high - self.rows.stop)), "edge")
        return self.speed - np.convolve(padded, self.window, "valid")


def _pieces_of(axis: Axis, run: AxisRun, gain: float) -> list[_Piece]:
    position = loop_position(run, axis)
    if run.speed_setpoint is None or position is None:
        return []
    cycle = run.cycle
    window = np.ones(1)
    if cycle < 0.2 / PASS_HZ:
        window = scipy.signal.firwin(2 * round(REACH_S / cycle) + 1, PASS_HZ, fs=1.0 / cycle)
    half = len(window) // 2
    speed = np.convolve(np.pad(run.speed * axis.ratio, half, "edge"), window, "valid")
    n = max(round(PIECE_S / cycle), 8)
    skipped = min(MOST_CYCLES + half, len(speed) // 4)
    out = []
    for first in range(skipped, len(speed) - half - n + 1, n):
        rows = slice(first, first + n)
        if not run.limited[rows].any():
            out.append(_Piece(gain, rows, run.start, run.middle, run.speed_setpoint * axis.ratio, position, speed, window))
    return out


def _left(pieces: Sequence[_Piece], x: np.ndarray) -> np.ndarray:
    return np.concatenate([p.left(x) for p in pieces])


def _fitted(pieces: Sequence[_Piece], cycle: float, drive: bool) -> np.ndarray:
    """(Td, lag) with the smallest residual; Td = 0 where the loop is closed in the NC."""
    delays = np.arange(cycle, min(MOST_DELAY_S, MOST_CYCLES * cycle), cycle) if drive else np.zeros(1)
    lags = np.arange(0.0, min(MOST_LAG_S, MOST_CYCLES * cycle), cycle)
    start = np.array(min(((d, g) for d in delays for g in lags), key=lambda x: float(np.sum(_left(pieces, np.array(x)) ** 2))))
    free = slice(0 if drive else 1, 2)

    def left(moved: np.ndarray) -> np.ndarray:
        return _left(pieces, np.concatenate([start[: free.start], moved]))

    found = least_squares(left, start[free], x_scale=cycle, bounds=(0.0, np.inf), diff_step=1e-3).x
    return np.concatenate([start[: free.start], found])
