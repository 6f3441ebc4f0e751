"""The law of a control whose command is recorded: current, voltage or torque u(k) from set point s and position x at its own cycle Ts.

    w*   = Kv (s(t - d) - x) + a_v ds/dt                 position controller with speed feedforward
    w    = sum_j b_j (x(k-j) - x(k-j-1)) / Ts            speed by differences, sum b = 1; or the recorded speed
    P    u = Kp (w* - w)                                 which is a PD controller of the position
    PI   u = Kp (w* - w) + Kp / Tn int (w* - w) dt

Written over the recorded signals both are linear: u = c_e (s - x) + sum a_j ds(k-j) - sum b_j dx(k-j) + c_i int (s - x) + c_x x + c, with
c_i = c_x = 0 for P. The steps of s and x take up any difference filter of the control. A PI law is found only where the command stays below
its limit, because the integrator holds there. The law with the fewest terms that the held-out pieces of the motion support is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import functools
import math

import numpy as np
from scipy.special import chdtri

from twin.estimate.held_out_gain import held_out, is_better, pieces_of
from twin.estimate.regression import Fit, regress

LONGEST_DIFFERENCE = 6
"""The control differentiates the position over at most this many cycles."""

AHEAD, BEHIND = 1, 2
"""Steps of the set point before and after the present cycle that the feedforward uses; a profile's own speed is a cycle ahead of its steps."""

NO_SPEED = -1
"""In place of a number of differences: the command does not answer the speed, as that of a valve. Then the law is another one."""

FIRST = LONGEST_DIFFERENCE + BEHIND
LARGEST_LEFT = 0.02
"""The command follows a law if less than this share (RMS) is left on the held-out pieces: rounding, and a tick within the cycle."""

ROUNDED = 1e-5
"""Laws that leave less than this share of the command are equally good: signals are recorded with some digits."""

PASSES = 50
"""Rounds of the correction for the lag of an integrator by a cycle."""

SAME_LAW = 0.02
"""With full feedforward Kv and 1/Tn can be exchanged: the smaller one is taken as Kv, unless the other way fits better by this share of their sum."""

LAGS, BY_CHANCE = 8, 1e-3
"""Cycles over which a residual is tested for whiteness, and the share of true laws that the test may refuse."""

NUMBERS = ("position_gain", "speed_gain", "integral_time", "feedforward", "delay")
BLOCK = 64
"""Cycles of a stretch whose errors may be related: several times the longest difference."""

AT_LIMIT = 0.995
"""A command beyond this share of its largest value may be limited and is not used."""


@dataclass(frozen=True)
class CommandRun:
    """Signals of one run at the cycles of the control (sample,), SI, and the steps to which command, set point and position are rounded."""

    period: float
    setpoint: np.ndarray
    position: np.ndarray
    speed: np.ndarray | None
    command: np.ndarray
    steps: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class CommandLaw:
    """Position gain [1/s], speed gain [command per m/s or rad/s], integral time [s] (inf: P), feedforward weight, delay of the set point [s].

    `mean_cycles`: the position is differentiated over so many cycles, 0 if the recorded speed is used. `left`: share of the command (RMS)
    that the law leaves on held-out pieces. `half`: 95 % half intervals of NUMBERS.
    """

    position_gain: float
    speed_gain: float
    integral_time: float
    feedforward: float
    delay: float
    mean_cycles: int
    left: float
    half: Mapping[str, float] = field(default_factory=dict)


def command_law(runs: Sequence[CommandRun]) -> CommandLaw | None:
    """The law that the recorded command follows, or None.

    Of the laws that the rounding of the signals does not tell apart, that with the fewest terms gives the values; the intervals cover all.
    """
    runs = [r for r in runs if len(r.command) > 4 * FIRST]
    if not runs:
        return None
    y = np.concatenate([r.command[FIRST:-AHEAD] for r in runs])
    pieces = np.concatenate([pieces_of(len(r.command) - FIRST - AHEAD, k) for k, r in enumerate(runs)])
    use = np.abs(y) <= AT_LIMIT * np.abs(y).max()
    size = float(np.sqrt(np.mean(y[use] ** 2)))
    measured = [0] if all(r.speed is not None for r in runs) else []
    forms = [(n, integral) for integral in (False, True) for n in (NO_SPEED, *range(1, LONGEST_DIFFERENCE + 1), *measured)]
    squares = [held_out(_columns(runs, *form), y, pieces, use) for form in forms]
    best = 0
    for i in range(1, len(forms)):
        if is_better(squares[i], squares[best], ROUNDED * size):
            best = i
    left = [float(np.mean(square)) for square in squares]
    if not math.sqrt(left[best]) < LARGEST_LEFT * size or forms[best][0] == NO_SPEED:
        return None

    @functools.cache
    def fit_of(i: int) -> Fit:
        return regress(_columns(runs, *forms[i])[use], y[use], _blocks_of(runs)[use])

    def law_of(i: int, b: np.ndarray) -> CommandLaw | None:
        return _read(b, *forms[i], runs[0].period, math.sqrt(left[i]) / size)

    def rounding(i: int) -> float:
        """Mean square of the command that rounding makes."""
        return max(_rounding(runs, fit_of(i).values, forms[i][0]), ROUNDED * size) ** 2

    likely = [i for i in range(best + 1) if forms[i][0] != NO_SPEED and left[i] - left[best] <= min(left[best], rounding(best))]
    first = likely[0]
    residual = fit_of(first).residual
    if not _is_noise(residual) and float(np.mean(residual**2)) > rounding(first):
        return None
    laws = [law_of(i, fit_of(i).values) for i in likely]
    law = laws[0]
    if law is None:
        return None
    half = _half_intervals(fit_of(first), functools.partial(law_of, first))
    apart = {
        name: max(abs(getattr(other, name) - getattr(law, name)) for other in laws if other)
        for name in NUMBERS
        if math.isfinite(getattr(law, name))
    }
    return replace(law, half={name: half[name] + off for name, off in apart.items()})


def _blocks_of(runs: Sequence[CommandRun]) -> np.ndarray:
    """(row,) Number of the stretch of BLOCK cycles of each row; stretches count as independent."""
    ends = np.cumsum([0, *(len(run.command) for run in runs)])
    return np.concatenate([(end + np.arange(FIRST, len(run.command) - AHEAD)) // BLOCK for end, run in zip(ends, runs)])


def _is_noise(residual: np.ndarray) -> bool:
    """Whether what a law leaves (row,) is white: the test of Box and Pierce on LAGS cycles. A law that lacks a part leaves something that lasts."""
    square = max(float(residual @ residual), 1e-300)
    related = np.array([residual[lag:] @ residual[:-lag] for lag in range(1, LAGS + 1)]) / square
    return len(residual) * float(related @ related) < chdtri(LAGS, BY_CHANCE)


def _rounding(runs: Sequence[CommandRun], b: np.ndarray, n: int) -> float:
    """RMS of the command that the rounding of the recorded signals makes in a law with the coefficients of `_columns`."""
    fed = AHEAD + BEHIND + 1
    of_steps = np.concatenate([b[1 : 1 + fed], b[1 + fed : 1 + fed + max(n, 1)]]) / runs[0].period
    of_setpoint, of_position = np.convolve(of_steps[:fed], [1.0, -1.0]), np.convolve(of_steps[fed:], [1.0, -1.0])
    of_setpoint[AHEAD] += b[0]
    of_position[0] -= b[0]
    sizes = (1.0, float(np.linalg.norm(of_setpoint)), float(np.linalg.norm(of_position)))
    return math.hypot(*(size * max(steps) for size, steps in zip(sizes, zip(*(run.steps for run in runs))))) / math.sqrt(12.0)


def _half_intervals(fit: Fit, read: Callable[[np.ndarray], CommandLaw | None]) -> dict[str, float]:
    """95 % half intervals of gains and times, along the principal directions of the covariance of their coefficients."""
    covariance = np.where(np.isfinite(fit.covariance), fit.covariance, 0.0)  # a column of zeros
    variances, directions = np.linalg.eigh(covariance)
    sums = np.zeros(len(NUMBERS))
    for step in (directions * np.sqrt(np.maximum(variances, 0.0))).T:
        ends = [read(fit.values + step), read(fit.values - step)]
        values = [[getattr(law, name) if law else math.inf for name in NUMBERS] for law in ends]
        sums += np.array([0.25 * (a - b) ** 2 if a != b else 0.0 for a, b in zip(*values)])
    return {name: fit.quantile * math.sqrt(square) for name, square in zip(NUMBERS, sums.tolist())}


def _columns(runs: Sequence[CommandRun], n: int, integral: bool) -> np.ndarray:
    """Columns (row, k): error, steps of the set point, steps of the position (or the speed), a constant of each run, integral terms."""
    parts = []
    for k, run in enumerate(runs):
        at = np.arange(FIRST, len(run.command) - AHEAD)
        error = run.setpoint - run.position
        ds, dx = (np.diff(v, prepend=v[0]) / run.period for v in (run.setpoint, run.position))
        speeds = [dx[at - j] for j in range(n)] if n else [run.speed[at]]  # type: ignore[index]  # none for NO_SPEED
        constant = [np.full(len(at), float(k == other)) for other in range(len(runs))]
        # the integrator of this cycle holds the errors up to the last one
        terms = [(np.cumsum(error) * run.period)[at - 1], run.position[at - 1] - run.position[0]] if integral else []
        parts.append(np.column_stack([error[at], *(ds[at + j] for j in range(AHEAD, -BEHIND - 1, -1)), *speeds, *constant, *terms]))
    return np.concatenate(parts)


def _read(b: np.ndarray, n: int, integral: bool, period: float, share: float) -> CommandLaw | None:
    """Gains and times from the coefficients of `_columns`; None if they are those of no controller."""
    fed = AHEAD + BEHIND + 1
    on_error, on_setpoint, gain = float(b[0]), float(b[1 : 1 + fed].sum()), -float(b[1 + fed : 1 + fed + max(n, 1)].sum())
    if on_error <= 0.0 or gain <= 0.0:
        return None
    # a set point that acts late takes from the weight of its slope what the position gain adds in this time
    steps, weight, position_gain, rate = gain, on_setpoint / gain, on_error / gain, 0.0
    for _ in range(PASSES if integral else 0):
        # the position sees Kv + 1/Tn and Kv / Tn; the set point sees Kv + a_v / Tn, which tells both apart unless a_v is 1
        whole, product = (on_error - float(b[-1])) / gain, float(b[-2]) / gain
        if product <= 0.0 or whole <= 0.0:
            return None
        apart = math.sqrt(max(whole**2 - 4.0 * product, 0.0))
        low, high = 0.5 * (whole - apart), 0.5 * (whole + apart)
        misfit = [abs(kv + weight * y - on_error / gain) for kv, y in ((low, high), (high, low))]
        position_gain, rate = (high, low) if misfit[1] + SAME_LAW * whole < misfit[0] else (low, high)
        # the integrator is a cycle behind, and the mean of n differences (n - 1) / 2 more: part of the steps is its lag
        late = rate * period
        gain = steps / (1.0 - late * (0.5 * max(n - 1, 0) + weight))
        weight = on_setpoint / (gain * (1.0 - late))
    delay = max(-weight, 0.0) / position_gain
    delay = delay if delay > 0.1 * period else 0.0
    return CommandLaw(position_gain, gain, 1.0 / rate if rate > 0.0 else math.inf, max(weight, 0.0), delay, n, share)
