"""Relations between two recorded columns in any units: one follows another, one is the slope of another, one drives another.

follows:   x(t) = a s(t - d) + c             a set point s and a position x, or two encoders
slope:     v(t) = k dx/dt                    a speed
balance:   u(t) = m dv/dt + d sign(v) + b v + c      a current, torque or voltage     (plus cos, sin of the position on a rotary axis)
law:       w(t) = k (s - x) + a ds/dt        output of a position controller, which is more than the slope of its set point

`left` is always the share of the variance that a relation leaves, 0 to 1. All columns (sample,) lie on one even grid; `period` [s].
"""

from dataclasses import dataclass

import numpy as np

from twin.estimate.regression import solved
from twin.recordings.force_sign import force_balance

TINY = 1e-300
WINDOWS = (1, 4, 16, 64)
"""A slope is averaged over these numbers of samples; the best average counts, so that neither noise nor few digits hide a slope."""
TRIMMED = 0.98
"""Share of the samples that count for the roughness: a step of a set point is no noise."""


@dataclass(frozen=True)
class Relation:
    """`factor` k or a; `left`: unexplained share of the variance; `lag` [samples]; `left_without`: the same without the lag."""

    factor: float
    left: float
    lag: float = 0.0
    left_without: float = 1.0


def moves(values: np.ndarray) -> bool:
    """True if a column changes at all."""
    return len(values) > 3 and float(np.ptp(values)) > 0.0


def follows(x: np.ndarray, s: np.ndarray, reach: int | None = None) -> Relation:
    """x as a copy of s that is `lag` samples later (negative: earlier), at most `reach`, by default an eighth of the record."""
    x, s = x - x.mean(), s - s.mean()
    xx = float(x @ x)
    if not moves(x) or not moves(s):
        return Relation(0.0, 1.0)
    n = len(x)
    reach = min(max(n // 8, 1), reach or n)
    size = 1 << (2 * n - 1).bit_length()
    product = np.fft.irfft(np.fft.rfft(x, size) * np.conj(np.fft.rfft(s, size)), size)
    shifts = np.r_[np.arange(reach + 1), np.arange(-reach, 0)]
    # outside the record s rests at its first or last value
    ends = np.r_[s[0] * _sums(x)[: reach + 1], s[-1] * _sums(x[::-1])[reach:0:-1]]
    late = s[0] ** 2 * np.arange(reach + 1) - _sums(s[::-1] ** 2)[: reach + 1]
    early = s[-1] ** 2 * np.arange(reach, 0, -1) - _sums(s**2)[reach:0:-1]
    square = float(s @ s) + np.r_[late, early]
    k = int(shifts[np.argmax((product[shifts] + ends) / np.sqrt(np.maximum(square, TINY)))])
    shifted = s[np.clip(np.arange(n) - k, 0, n - 1)]
    speed = np.gradient(shifted)
    factor, still = solved(np.column_stack([shifted, np.ones(n)]), x)
    rest = x - factor * shifted - still
    # the fraction of a sample that is left
    vv = float(speed @ speed)
    part = float(np.clip(-(rest @ speed) / (factor * vv), -1.0, 1.0)) if vv > 0.0 and factor else 0.0
    rest = rest + part * factor * speed
    alone = x - float(s @ x) / max(float(s @ s), TINY) * s
    return Relation(float(factor), float(rest @ rest) / xx, k + part, float(alone @ alone) / xx)


def _sums(values: np.ndarray) -> np.ndarray:
    """Sums of the first 0, 1, 2, .. values."""
    return np.concatenate([[0.0], np.cumsum(values)])


def follows_in_part(x: np.ndarray, s: np.ndarray) -> Relation:
    """The same for the part of the record where x follows s best: an axis follows slow motion even where it cannot follow the rest."""
    size = len(x) // PARTS
    parts = [slice(i * size, (i + 1) * size) for i in range(PARTS)] if size >= LEAST_OF_PART else []
    wide = [p for p in parts if np.ptp(s[p]) > 0.3 * np.ptp(s)]
    return min([follows(x, s), *(follows(x[p], s[p]) for p in wide)], key=lambda r: r.left)


PARTS = 6
LEAST_OF_PART = 50


def slope(v: np.ndarray, x: np.ndarray, period: float) -> Relation:
    """v as a multiple of the slope of x."""
    summed = _sums(0.5 * (v[1:] + v[:-1])) * period
    best = Relation(0.0, 1.0)
    for step in WINDOWS:
        if step * 4 > len(v):
            break
        factor, left = multiple(summed[step:] - summed[:-step], x[step:] - x[:-step])
        if left < best.left:
            best = Relation(factor, left)
    return best


def multiple(y: np.ndarray, x: np.ndarray) -> tuple[float, float]:
    """y as a multiple of x: (factor, unexplained share of the mean square); (0, 1) where one of them is zero."""
    xx, xy, yy = float(x @ x), float(x @ y), float(y @ y)
    return (xy / xx, max(1.0 - xy * xy / (xx * yy), 0.0)) if xx > 0.0 and yy > 0.0 else (0.0, 1.0)


def second_slope(a: np.ndarray, x: np.ndarray, period: float) -> Relation:
    """a as a multiple of the second slope of x."""
    return slope(a, np.gradient(x, period), period)


EXACT = 1e-5
"""Share of the variance that a speed leaves of the slope of a set point, up to the rounding of differences, if it is nothing else."""


def plain_course(y: np.ndarray) -> float:
    """Share of the variance that is left of y beside a cubic of the time: little, if it neither reverses often nor jumps."""
    fit = np.polynomial.chebyshev.Chebyshev.fit(np.arange(len(y)), y, 3)
    return float(np.var(y - fit(np.arange(len(y))))) / max(float(np.var(y)), TINY)


def law(w: np.ndarray, s: np.ndarray, x: np.ndarray, period: float) -> Relation:
    """w as output of a position controller."""
    speed, error = np.gradient(s, period), s - x
    columns = np.column_stack([error, speed, np.ones_like(error)])
    b = solved(columns, w)
    return Relation(float(b[0]), float(np.var(w - columns @ b)) / max(float(np.var(w)), TINY))


def balance(u: np.ndarray, x: np.ndarray, period: float, kind: str) -> Relation:
    """u as the force that moves x. `factor` < 0: it pushes against the motion."""
    found = force_balance(u, x, period, kind)
    return Relation(found.direction, found.left)


def uneven(values: np.ndarray) -> float:
    """RMS third difference without the largest ones: what is not smooth motion (noise, steps of an encoder)."""
    third = np.sort(np.abs(np.diff(values, 3)))
    kept = third[: max(int(TRIMMED * len(third)), 1)]
    return float(np.sqrt(np.mean(kept**2))) if len(kept) else 0.0


def ahead(m: np.ndarray, x: np.ndarray) -> float:
    """How far m is ahead of x in the direction of motion, over the spread of their difference: a motor winds up what it moves."""
    motion = np.gradient(x)
    direction = np.sign(motion) * (np.abs(motion) > 0.1 * np.abs(motion).max())
    apart = (m - x) - np.median(m - x)
    if not direction.any() or not apart.any():
        return 0.0
    return float(np.mean(apart[direction != 0] * direction[direction != 0]) / max(np.std(apart), TINY))


def settled(s: np.ndarray, x: np.ndarray) -> float:
    """Spread of s - x where s rests; the encoder that closes the position loop has the smaller spread. NaN if s never rests."""
    step = np.abs(np.diff(s, prepend=s[0]))
    quiet = max(20, len(s) // 200)
    resting = np.convolve((step > 0.0).astype(float), np.ones(quiet), "full")[: len(s)] == 0.0
    resting[:quiet] = False
    return float(np.std((s - x)[resting])) if np.count_nonzero(resting) > quiet else float("nan")


def supplies(voltage: np.ndarray) -> bool:
    """True if a voltage only wavers about a constant: a supply, no command."""
    return abs(float(voltage.mean())) > SUPPLY * float(voltage.std())


SUPPLY = 20.0
"""Least mean over standard deviation of the voltage of a supply; a command of an axis that moves passes through zero or changes."""


def stuck(values: np.ndarray) -> str:
    """Where and how long a column stands at the limit of a counter (the largest or smallest number of 8, 16 or 32 bits); "" if it does not."""
    for end in (float(values.min()), float(values.max())):
        if end in LIMITS and 1 < (count := np.count_nonzero(values == end)) < len(values):
            return f"stands at {end:.0f}, the end of its counter, in {count / len(values):.0%} of the samples"
    return ""


LIMITS = {float(sign * 2**bits - over) for bits in (7, 15, 31) for sign, over in ((1, 1), (-1, 0), (-1, -1))} | {65535.0, 4294967295.0}


def sign_bit(values: np.ndarray, positive: np.ndarray) -> int | None:
    """Bit that carries the sign of whole numbers (33118 = -350 in a 16-bit word), if the decoded values go with `positive`; else None."""
    if not whole(values) or values.min() < 0.0:
        return None
    for bit in (15, 10, 11, 31):
        high = values >= 2.0**bit
        if high.any() and not high.all() and values.max() < 2.0 ** (bit + 1):
            signed = without_sign_bit(values, bit)
            moving = (signed != 0.0) & (positive != 0.0)
            if np.count_nonzero(moving) > 3 and abs(np.mean(np.sign(signed[moving]) * np.sign(positive[moving]))) > 0.7:
                return bit
    return None


def without_sign_bit(values: np.ndarray, bit: int) -> np.ndarray:
    """Whole numbers whose sign is a bit of the word, with their sign."""
    return np.where(values >= 2.0**bit, 2.0**bit - values, values)


def whole(values: np.ndarray) -> bool:
    """True if all values are whole numbers."""
    return bool(np.all(values == np.rint(values)))


def even_step(values: np.ndarray) -> float | None:
    """Step of a column that increases evenly from its first to its last row."""
    if len(values) <= 10 or not np.all(np.isfinite(values)):
        return None
    steps = np.diff(values)
    usual = float(np.median(steps))
    even = usual > 0.0 and float(np.abs(steps - usual).max()) <= EVEN * usual
    return usual if even else None


EVEN = 0.02
"""Largest deviation of the steps of a time column without a name, relative to their median: printed times are rounded."""
