"""Relations between two recorded columns in any units: one follows another, one is the slope of another, one drives another.

follows:   x(t) = a s(t - d) + c             a set point s and a position x, or two encoders
slope:     v(t) = k dx/dt                    a speed
law:       w(t) = k (s - x) + a ds/dt        output of a position controller, which is more than the slope of its set point
balance:   f(t) = m a + d sign(v) + b v + c  a current, torque or voltage     (plus cos, sin of the position on a rotary axis, for gravity)

For a signed force m, d and b have the same sign: positive along the motion, negative if the control counts in the opposite direction. A
magnitude is never negative and fits |m a + d sign(v)| better, in both directions of motion.

`left` is always the share of the variance that a relation leaves, 0 to 1. All columns (sample,) lie on one even grid; `period` [s].
"""

from dataclasses import dataclass
import math

import numpy as np
import scipy  # scipy.signal at first use: it is slow to import

from twin.estimate.regression import solved

TINY = 1e-300
CLEAR, UNLIKE = 0.02, 0.5
"""Unexplained share of the variance: a relation is clear below the first; above the second it is none."""
WINDOWS = (1, 4, 16, 64)
"""A slope is averaged over these numbers of samples; the best average counts, so that neither noise nor few digits hide a slope."""
TRIMMED = 0.98
"""Share of the samples that count for the roughness: a step of a set point is no noise."""


@dataclass(frozen=True)
class Relation:
    """`factor` k or a; `left`: unexplained share of the variance; `lag` [samples]; `left_without`: the same without the lag, or without the sign."""

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
    # outside the record s rests at its first or last value
    wide = np.pad(s, reach, mode="edge")
    product = scipy.signal.correlate(wide, x, "valid", "fft")
    total, squares = (sums[n:] - sums[:-n] for sums in (_sums(wide), _sums(wide**2)))
    shape = product / np.sqrt(np.maximum(squares - total**2 / n, TINY))  # about the mean of what the shift leaves in the record
    shifts = np.r_[0 : reach + 1, -reach:0]
    k = int(shifts[np.argmax(shape[reach - shifts])])
    shifted = wide[reach - k : reach - k + n]
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
        best = min(best, multiple(summed[step:] - summed[:-step], x[step:] - x[:-step]), key=lambda found: found.left)
    return best


def multiple(y: np.ndarray, x: np.ndarray) -> Relation:
    """y as a multiple of x; `left`: of the mean square. No relation where one of them is zero."""
    xx, xy, yy = float(x @ x), float(x @ y), float(y @ y)
    return Relation(xy / xx, max(1.0 - xy * xy / (xx * yy), 0.0)) if xx > 0.0 and yy > 0.0 else Relation(0.0, 1.0)


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
    left, b = fitted(np.column_stack([s - x, np.gradient(s, period), np.ones_like(x)]), w)
    return Relation(float(b[0]), left)


def fitted(columns: np.ndarray, y: np.ndarray) -> tuple[float, np.ndarray]:
    """(unexplained share of the variance, coefficients) of the linear law y = columns b."""
    b = solved(columns, y)
    return float(np.var(y - columns @ b)) / max(float(np.var(y)), TINY), b


FORCE_BAND_HZ = 30.0
EXPLAINED = 0.25
"""Share of the force's variance that the balance must explain; below, the sign is not judged."""
BETTER = 1.2
"""A force is unsigned if the residual of |balance| is smaller than that of the signed balance by this factor."""
OPPOSED = 0.5
"""A sign is reversed if negative parts of the balance outweigh positive ones by this share: they are three times as large."""
LEAST_OF_BALANCE = 20
"""Fewest samples for the fit of a balance."""


@dataclass(frozen=True)
class ForceSign:
    """`sign` -1: reverse it. `unsigned`: only the magnitude is recorded. `remark` for the map."""

    sign: int = 1
    unsigned: bool = False
    remark: str = ""


def balance(force: np.ndarray, position: np.ndarray, period: float, kind: str) -> Relation:
    """A force (sample,) in any unit by the motion of a position (sample,) [m or rad; a linear axis: any unit].

    `factor`: 1 if all parts of the force are along the motion, -1 if all are against it. `left_without`: what |balance| leaves, 1 in one direction only.
    """
    if len(force) < LEAST_OF_BALANCE or not np.ptp(force) > 0.0 or not np.ptp(position) > 0.0:
        return Relation(0.0, 1.0)
    motion, f = low_passed(position, period, FORCE_BAND_HZ), low_passed(force, period, FORCE_BAND_HZ)
    speed = np.gradient(motion, period)
    acceleration = np.gradient(speed, period)
    moving = np.abs(speed) > 0.02 * np.abs(speed).max()
    direction = np.sign(speed) * moving
    inner = slice(len(f) // 50, len(f) - len(f) // 50)
    place = [np.cos(position), np.sin(position)] if kind == "rotary" else []
    left, coefficients = fitted(np.column_stack([acceleration, direction, speed, *place, np.ones_like(f)])[inner], f[inner])
    # few samples, fewer of them independent after the low-pass, explain anything
    independent = len(f[inner]) * min(1.0, 2.0 * min(FORCE_BAND_HZ * period, 0.15))
    left = min(left * max(independent - 1.0, 1.0) / max(independent - len(coefficients), 0.1), 1.0)
    left_magnitude = 1.0
    both_ways = min(np.count_nonzero(direction > 0), np.count_nonzero(direction < 0)) > 0.1 * np.count_nonzero(moving)
    if both_ways and (force.min() >= 0.0 or force.max() <= 0.0):
        along = np.sign(acceleration * speed) * np.abs(acceleration)
        left_magnitude, _ = fitted(np.column_stack([along, np.abs(direction), np.abs(speed), np.ones_like(f)])[inner], f[inner])
    # inertia, Coulomb and viscous friction weighted by their part of the force
    parts = coefficients[:3] * np.column_stack([acceleration, direction, speed])[inner].std(axis=0)
    return Relation(float(parts.sum() / max(np.abs(parts).sum(), TINY)), left, left_without=left_magnitude)


def force_sign(force: np.ndarray, position: np.ndarray, period: float, kind: str) -> ForceSign:
    """Sign of a current, torque or voltage (sample,) in any unit, relative to a position (sample,) [m or rad]."""
    found = balance(force, position, period, kind)
    if found.left_without * BETTER < found.left:
        return ForceSign(unsigned=True, remark="only the magnitude is recorded, without a sign")
    if found.left <= 1.0 - EXPLAINED and found.factor < -OPPOSED:
        return ForceSign(sign=-1, remark="sign reversed: as recorded it pushes against the motion")
    return ForceSign()


def low_passed(values: np.ndarray, period: float, band_hz: float) -> np.ndarray:
    """Zero-phase low-pass of second order, at most at 0.15 of the sampling rate. A motion that an end of the record cuts goes on there, until the filter settles."""
    band = min(band_hz * period, 0.15)
    settled = min(math.ceil(3.0 / band), len(values) - 1)
    return np.asarray(scipy.signal.sosfiltfilt(scipy.signal.butter(2, band, fs=1.0, output="sos"), values, padlen=settled))


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
