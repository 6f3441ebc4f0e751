"""Decide whether the position loop is closed in the NC or in the drive (dynamic servo control, DSC).

The NC's speed set point v*(t) and the position x(t) are recorded. The two laws for the speed command that the axis follows:

    closed in the NC      u(T) = v*(T)
    closed in the drive   u(T) = v*(T - Td) - Kv (x(T) - x(T - Td))        the drive uses its newest encoder value

The axis follows u with the lag of the speed loop, v(T) = u(T - lag). Each law is fitted on the even pieces of the motion and judged on the
odd ones, then the other way round. At a steady speed the second law gives v* = (1 + Kv Td) v, so Td is well determined.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
import scipy
from scipy.optimize import least_squares

from twin.estimate.held_out_gain import rms_of
from twin.estimate.regression import NORMAL_95, regress
from twin.identify.axis_run import AxisRun
from twin.identify.position_law import loop_position
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

    @property
    def values(self) -> dict[str, float]:
        """The delay, if the drive closes the loop."""
        return {"dsc_delay_s": self.delay_s} if self.closed_in_drive else {}

    @property
    def half(self) -> dict[str, float]:
        """Its 95 % half interval."""
        return dict.fromkeys(self.values, NORMAL_95 * self.delay_deviation)

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
    alike = [r for r in runs if r.cycle == runs[0].cycle]  # pieces of other cycles have other numbers of rows
    pieces = [p for r in alike if (p := _pieces_of(axis, r, position_gain)) is not None]
    highest = np.concatenate([np.zeros(0), *(np.abs(p.speed).max(axis=1) for p in pieces)])
    moving = np.flatnonzero(highest > MOVES * highest.max(initial=0.0))
    if len(moving) < LEAST_PIECES:
        return None
    read = moving[np.unique(np.linspace(0, len(moving) - 1, MOST_PIECES_READ).astype(int))]
    every, cycle = _only(pieces, read), runs[0].cycle
    x, alone = (_fitted(every, cycle, drive) for drive in (True, False))
    left_nc, left_drive = (rms_of(_left(every, v).ravel()) for v in (alone, x))
    if left_nc < CLEARER * left_drive:  # not clearer even on the fitted pieces
        return DrivePositionLoop(False, float(x[0]), np.inf, float(alone[1]), left_nc, left_drive, len(read))
    squares = np.zeros((2, len(read)))
    for held_out in (0, 1):
        fitted, judged = _only(pieces, read[1 - held_out :: 2]), _only(pieces, read[held_out::2])
        for law in (0, 1):
            squares[law, held_out::2] = np.mean(_left(judged, _fitted(fitted, cycle, bool(law))) ** 2, axis=1)
    left_nc, left_drive = (float(np.sqrt(np.mean(s))) for s in squares)
    better = float(np.mean(squares[1] < squares[0]))
    h = 0.05 * cycle
    columns = np.column_stack([(_left(every, x + d) - _left(every, x - d)).ravel() / (2.0 * h) for d in h * np.eye(2)])
    left = _left(every, x)
    fit = regress(columns, left.ravel(), np.repeat(np.arange(len(left)), left.shape[1]))
    apart = bool(x[0] > max(4.0 * fit.deviations[0], LEAST_DELAY_CYCLES * cycle))
    closed = left_nc > CLEARER * left_drive and better >= MOST_PIECES and apart
    delay, lag = x.tolist()
    return DrivePositionLoop(closed, delay, float(fit.deviations[0]), lag, left_nc, left_drive, len(read))


@dataclass(frozen=True)
class _Pieces:
    """Pieces of one run: times (piece, row and the reach of the window), filtered speed (piece, row); v* and position of the whole run."""

    gain: float
    start: np.ndarray
    command: np.ndarray
    position: np.ndarray
    window: np.ndarray
    times: np.ndarray
    speed: np.ndarray

    def left(self, x: np.ndarray) -> np.ndarray:
        """Measured speed minus the law's (piece, row), for x = (Td, lag)."""
        at = self.times - x[1]
        u = np.interp(at - x[0], self.start, self.command)
        if x[0] != 0.0:
            u = u - self.gain * (np.interp(at, self.start, self.position) - np.interp(at - x[0], self.start, self.position))
        return self.speed - sliding_window_view(u, len(self.window), axis=1) @ self.window


def _pieces_of(axis: Axis, run: AxisRun, gain: float) -> _Pieces | None:
    position = loop_position(run, axis)
    if run.speed_setpoint is None or position is None:
        return None
    cycle = run.cycle
    window = np.ones(1)
    if cycle < 0.2 / PASS_HZ:
        window = scipy.signal.firwin(2 * round(REACH_S / cycle) + 1, PASS_HZ, fs=1.0 / cycle)
    half = len(window) // 2
    speed = np.convolve(np.pad(run.speed * axis.ratio, half, "edge"), window, "valid")
    n = max(round(PIECE_S / cycle), 8)
    skipped = min(MOST_CYCLES + half, len(speed) // 4)
    first = np.array([k for k in range(skipped, len(speed) - half - n + 1, n) if not run.limited[k : k + n].any()], dtype=int)[:, None]
    times = run.middle[np.clip(first + np.arange(-half, n + half), 0, len(speed) - 1)]
    return _Pieces(gain, run.start, run.speed_setpoint * axis.ratio, position, window, times, speed[first + np.arange(n)])


def _only(pieces: Sequence[_Pieces], places: np.ndarray) -> list[_Pieces]:
    """The pieces at these places among those of all runs."""
    ends = np.cumsum([len(p.speed) for p in pieces])
    own = [places[(places >= end - len(p.speed)) & (places < end)] - end for p, end in zip(pieces, ends)]
    return [replace(p, times=p.times[k], speed=p.speed[k]) for p, k in zip(pieces, own)]


def _left(pieces: Sequence[_Pieces], x: np.ndarray) -> np.ndarray:
    """(piece, row)"""
    return np.concatenate([p.left(x) for p in pieces])


def _fitted(pieces: Sequence[_Pieces], cycle: float, drive: bool) -> np.ndarray:
    """(Td, lag) with the smallest residual; Td = 0 where the loop is closed in the NC."""
    delays = np.arange(cycle, min(MOST_DELAY_S, MOST_CYCLES * cycle), cycle) if drive else np.zeros(1)
    lags = np.arange(0.0, min(MOST_LAG_S, MOST_CYCLES * cycle), cycle)
    start = np.array(min(((d, g) for d in delays for g in lags), key=lambda x: float(np.sum(_left(pieces, np.array(x)) ** 2))))
    free = slice(0 if drive else 1, 2)

    def left(moved: np.ndarray) -> np.ndarray:
        return _left(pieces, np.concatenate([start[: free.start], moved])).ravel()

    found = least_squares(left, start[free], x_scale=cycle, bounds=(0.0, np.inf), diff_step=1e-3).x
    return np.concatenate([start[: free.start], found])
