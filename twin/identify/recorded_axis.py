"""What a recording alone says about an axis, without a model of the machine: samples in motion, lag, balance of its effort, noise.

    error     s - x = lag v + p d(s - x)/dt + c + H{k a + j da/dt + h sign(v) + b v}      s set point, x position, v its speed, a the acceleration of s
    effort    u(t - T) = d sign(v) + b v + m a + c  (gravity by angle) - f/K       u current, torque or voltage; v and a of x; f known load

An effort acts later than its sample by T: hold, computing time, lag of the drive. Unaligned, its samples give m + b T in place of m.

A delay or a feedforward acts on the motion of the set point, a gain on that of the axis: p d(s - x)/dt is their difference. A controller without an
integral part leaves an error h against friction, with H = 1. An integral part makes up for the forces with a time T: H = T s / (1 + T s). The law that
predicts held-out pieces of the motion best gives the value: else a friction would pass for a lag, and a lateness for viscous friction. The interval
covers all laws that fit the recording as well; of the lag the simplest of them gives the value.

Each is a regression on the samples in motion, with intervals whose clusters are strokes (`estimate.regression`). A stroke is a stretch
of motion in one direction. What the recorded speeds and directions cannot separate is given as the sum that they do determine. SI.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import functools
import itertools
import math

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import lfilter

from twin.control.actuator import EFFORTS
from twin.estimate.held_out_gain import held_out, is_better, pieces_of
from twin.estimate.regression import Fit, Range, regress, with_rounding
from twin.recordings.campaign import MeasuredRun
from twin.recordings.relations import low_passed
from twin.recordings.roughness import SECOND_DIFFERENCE, quiet_noise, resolution_of, roughness, step_of
from twin.simulation.motor_and_scale import motor_minus_scale

BAND_HZ = 40.0
"""Band of the speeds and accelerations, and of the efforts that belong to them [Hz]."""
MOVING = 0.02
"""An axis moves if it exceeds this share of the highest speed of the recording."""
NOISE_TRAVEL = 6.0
"""Below this travel, in standard deviations of the noise within BAND_HZ, a stretch of motion is noise."""
LEAST_SAMPLES = 16
"""Fewest samples of a run, and fewest samples in motion: twice the numbers of the largest regression and some more."""
LEAST_INNER = 0.5
"""Least share of the samples in motion away from the ends of strokes; shorter strokes are used whole."""
MOST_LATE = 4
"""An effort acts at most this many samples after its own."""
LEAST_TURN_RAD = 0.5
"""A weight that turns with a rotary axis shows on no smaller travel."""
LEAST_SPREAD = 2.5
"""From this ratio of the 97th to the 10th percentile of its speeds an axis has several. Ramps are a small share of motion at one speed, and their
friction is not that of steady speed."""


@dataclass(frozen=True)
class Strokes:
    """Samples of an axis in motion, of all runs in a row (row,): signals, run and stroke of each.

    `inner` marks those away from the ends of strokes, where the filter mixes motion with reversal; `steady` nearly constant speed.
    """

    run: np.ndarray
    stroke: np.ndarray
    time: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    position: np.ndarray
    inner: np.ndarray
    steady: np.ndarray


@dataclass(frozen=True)
class Friction:
    """Balance of an effort, in its unit. `at_speed` is the sum of Coulomb and viscous friction at `speed` [m/s, rad/s].

    Coulomb and viscous friction are None where only their sum is determined; in one direction Coulomb friction and the constant part are.
    `gravity`: factors of cos q - 1 and sin q, so that the constant part is that at q = 0; `per_load`: effort per N or Nm of a known load; `against`: all signs are reversed here.
    """

    effort: str
    speed: float
    at_speed: Range
    coulomb: Range | None
    viscous: Range | None
    inertia: Range
    constant: Range | None
    against: bool
    peak: float
    explained: float
    """Share of the variance of the effort in motion that the regression explains."""
    gravity: tuple[Range, Range] | None = None
    per_load: Range | None = None
    at_rest: float | None = None
    """Median of the effort where the axis rests; None if it never does."""
    by_place: Range | None = None
    """By how much more the effort is at the upper end of the travel than at the lower one; None if it does not go with the place."""


def position_of(run: MeasuredRun, axis: str) -> np.ndarray:
    """The measured position (sample,)."""
    return run.trace.get(axis, run.trace.measured_position(axis))


def slopes_of(values: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Speed and acceleration (sample,) within BAND_HZ."""
    speed = np.gradient(low_passed(values, period, BAND_HZ), period)
    return speed, np.gradient(speed, period)


def strokes_of(runs: Sequence[MeasuredRun], axis: str) -> Strokes | None:
    """The samples in motion; None if the axis never moves further than its noise."""
    slopes = [slopes_of(position_of(run, axis), run.trace.period) for run in runs]
    fastest = max(float(np.abs(v).max()) for v, _ in slopes)
    travel = max(float(np.ptp(position_of(run, axis))) for run in runs)
    noise = max(noise_of(position_of(run, axis)) for run in runs)
    if fastest == 0.0 or travel < 10.0 * max(noise, step_of(position_of(runs[0], axis))):
        return None
    parts, count = [], 0
    for i, (run, (v, a)) in enumerate(zip(runs, slopes)):
        moving = np.abs(v) > MOVING * fastest
        edge = max(2, len(v) // 200)
        moving[:edge] = moving[-edge:] = False
        in_band = noise * math.sqrt(min(2.0 * BAND_HZ * run.trace.period, 1.0))
        sign = _without_noise(v * moving, NOISE_TRAVEL * in_band / run.trace.period, round(2.0 / BAND_HZ / run.trace.period))
        moving = sign != 0.0
        begins = np.diff(sign, prepend=0.0) != 0
        stroke = count + np.cumsum(begins & moving)
        count += int((begins & moving).sum())
        mixed = 2 * math.ceil(max(0.5 / BAND_HZ / run.trace.period, 3.0)) + 1
        inner = minimum_filter1d(sign, mixed) == maximum_filter1d(sign, mixed)
        keep = np.flatnonzero(moving)
        parts.append(
            (np.full(len(keep), i), stroke[keep], run.trace.time[keep], v[keep], a[keep], position_of(run, axis)[keep], inner[keep])
        )
    run_of, stroke_of, time, speed, acceleration, position, inner = (np.concatenate(column) for column in zip(*parts))
    if len(time) < LEAST_SAMPLES:
        return None
    steady = np.abs(acceleration) < 0.1 * np.abs(acceleration).max()
    return Strokes(run_of, stroke_of, time, speed, acceleration, position, inner | (inner.mean() < LEAST_INNER), steady)


def _without_noise(speed: np.ndarray, least: float, longest: int) -> np.ndarray:
    """Directions of motion (sample,), 0 at rest, from a speed that is 0 at rest, without stretches whose speeds add up to less than `least`, as of noise.

    Within `longest` samples between two of one direction they are part of its motion; else the axis rests there.
    """
    sign = np.sign(speed)
    first = np.flatnonzero(np.diff(sign, prepend=np.nan) != 0.0)
    end = np.append(first[1:], len(sign))
    short = (sign[first] != 0.0) & (np.abs(np.add.reduceat(speed, first)) < least)
    out = np.where(np.repeat(short, end - first), 0.0, sign)
    for a, b in itertools.pairwise(np.flatnonzero(out[first] != 0.0)):
        if short[a + 1 : b].any() and out[first[a]] == out[first[b]] and first[b] - end[a] <= longest:
            out[end[a] : first[b]] = out[first[a]]
    return out


def at_rows(runs: Sequence[MeasuredRun], rows: Strokes, values: Sequence[np.ndarray]) -> np.ndarray:
    """Values of each run (sample,) at the rows (row,)."""
    out = np.empty(len(rows.time))
    for i, run in enumerate(runs):
        own = rows.run == i
        out[own] = values[i][np.searchsorted(run.trace.time, rows.time[own] - 0.5 * run.trace.period)]
    return out


def value_of(fit: Fit, weights: Mapping[int, float]) -> Range | None:
    """A linear combination of the fitted numbers, by index, with its interval; None if the rows do not determine it."""
    at, w = list(weights), np.array(list(weights.values()))
    variance = float(w @ fit.covariance[np.ix_(at, at)] @ w)
    return Range.around(float(w @ fit.values[at]), fit.quantile * math.sqrt(max(variance, 0.0))) if math.isfinite(variance) else None


def value_of_all(fits: Sequence[Fit], weights: Mapping[int, float]) -> Range | None:
    """The same by the first of several laws, with an interval that covers those of all."""
    return _cover([value_of(fit, weights) for fit in fits])


def _cover(values: Sequence[Range | None]) -> Range | None:
    """The first of several values, with an interval that covers those of all."""
    best = values[0]
    return best and Range.around(best.value, max(abs(v.value - best.value) + v.half for v in values if v is not None))


def _inertia(fit: Fit, k: int) -> Range | None:
    """The inertia m of a balance whose column k is the jerk: that of the acceleration has the coefficient m + b T, that of the jerk m T."""
    mixed, viscous = float(fit.values[2]), float(fit.values[1])
    if len(fit.values) <= k or mixed == 0.0:
        return value_of(fit, {2: 1.0})
    late = float(fit.values[k]) / mixed
    found = value_of(fit, {2: 1.0, 1: -late, k: -viscous / mixed})
    return found and found.plus(viscous * late)


def one_speed(speeds: np.ndarray) -> float | None:
    """The single sliding speed of an axis, from its speeds (sample,) while it moves; None if it has several.

    Coulomb and viscous friction are separated only by several speeds: by a wide spread of them, or of the medians of the motions between two
    reversals, if fast ones are twice as fast as slow ones. Then friction at rest is no farther from those than they are from each other.
    """
    if len(speeds) == 0:
        return None
    size = np.abs(speeds)
    motions = np.split(size, np.flatnonzero(np.diff(np.sign(speeds))) + 1)
    medians = np.concatenate([np.full(len(motion), np.median(motion)) for motion in motions])
    several = (np.percentile(values, 97) >= ratio * np.percentile(values, 10) for values, ratio in ((size, LEAST_SPREAD), (medians, 2.0)))
    return None if any(several) else float(np.median(size))


def lags_of(runs: Sequence[MeasuredRun], axis: str, rows: Strokes) -> tuple[dict[str, Range], np.ndarray]:
    """Lag [s] of the position behind the set point by feedforward flag, and what the first terms of its law, without an integral part, leave of the error (row,)."""
    places = [(run.trace.get(axis, "setpoint"), position_of(run, axis)) for run in runs]
    asked, motion = ([slopes_of(place[i], run.trace.period) for place, run in zip(places, runs)] for i in (0, 1))
    error = at_rows(runs, rows, [s - x for s, x in places])
    change = at_rows(runs, rows, [s[0] - x[0] for s, x in zip(asked, motion)])
    forces = [_forces_of(run, slopes[0], asked[i][1], rows.time[rows.run == i]) for i, (run, slopes) in enumerate(zip(runs, motion))]
    flags = np.array([run.feedforward or "" for run in runs])[rows.run]
    lags, left, ones, sign = {}, np.zeros(len(error)), np.ones_like(error), np.sign(rows.speed)
    for flag in dict.fromkeys(flags.tolist()):
        own = flags == flag
        several = one_speed(rows.speed[own]) is None  # at one speed the lag is the whole error over it
        laws = []
        for slopes in (asked, motion):
            first = [at_rows(runs, rows, [v[i] for v in slopes]) for i in (0, 1)]
            laws += [np.column_stack([*first, ones, *more]) for more in ([], *([[sign]] if several else []))]
        plain = laws[_likely([law[own] for law in laws], error[own], rows.run[own])[0]][own]
        left[own] = regress(plain, error[own], rows.stroke[own]).residual
        few = len(laws)
        for time in INTEGRAL_S:
            which = [0, 1, *([2] if several else []), *([3] if math.isfinite(time) else [])]
            left_of = [at_rows(runs, rows, [_not_made_up(f[k], run.trace.period, time) for f, run in zip(forces, runs)]) for k in which]
            laws.append(np.column_stack([rows.speed, change, *left_of, ones]))
        inner = own & rows.inner
        parts = [inner, own] if inner.sum() >= LEAST_SAMPLES else [own]
        likely = _likely([law[parts[0]] for law in laws], error[parts[0]], rows.run[parts[0]])
        best, likely = likely[0], sorted(likely)  # the simplest gives the value
        if best > few:  # the time of an integral part lies between its neighbours
            likely += [i for i in (best - 1, best + 1) if few < i < len(laws) and i not in likely]
        # the filter mixes motion with reversal at the ends of strokes, and an interval says what they would change
        fits = [regress(laws[i][part], error[part], rows.stroke[part]) for part in parts for i in likely]
        if (lag := value_of_all(fits, {0: 1.0})) is not None:
            lags[flag] = lag
    return lags, left


INTEGRAL_S = (math.inf, *np.geomspace(0.006, 0.3, 12).tolist())
"""Times of an integral part that are compared [s]; the first is that of a control without one."""


def _forces_of(run: MeasuredRun, speed: np.ndarray, acceleration: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """What an axis takes to move (4, sample), each up to a factor: by its acceleration, by the lateness of that, by its direction at the times `moving`, by its speed.

    The acceleration is that of the set point: in that of the position a vibration, which is in the error too, would explain itself.
    """
    direction = np.sign(speed) * np.isin(run.trace.time, moving)
    return np.array([acceleration, np.gradient(acceleration, run.trace.period), direction, speed])


def _not_made_up(force: np.ndarray, period: float, time: float) -> np.ndarray:
    """What an integral part of this time has not yet made up for of a force (sample,), steady before its first sample: T s / (1 + T s)."""
    return force if math.isinf(time) else lfilter([1.0, -1.0], [1.0, -math.exp(-period / time)], force - force[0])


def _likely(laws: Sequence[np.ndarray], y: np.ndarray, run: np.ndarray) -> list[int]:
    """Indices of laws, columns (row, k): that with the largest density of held-out pieces of the runs, then those that fit the recording as well."""
    pieces = np.concatenate([pieces_of(int(count), k) for k, count in enumerate(np.unique(run, return_counts=True)[1])])
    least = 1e-6 * float(np.std(y)) + 1e-150
    squares = [held_out(law, y, pieces) for law in laws]
    best = min(range(len(laws)), key=lambda i: float(np.log(np.maximum(squares[i], least**2)).sum()))
    return [best, *(i for i in range(len(laws)) if i != best and not is_better(squares[best], squares[i], least))]


def _motion_of(runs: Sequence[MeasuredRun], rows: Strokes, positions: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Speed, acceleration, jerk and its derivative (row,) within BAND_HZ, of positions (sample,) of the runs."""
    slopes: list[list[np.ndarray]] = [[low_passed(x, run.trace.period, BAND_HZ)] for x, run in zip(positions, runs)]
    for run, own in zip(runs, slopes):
        for _ in range(4):  # by splines: a difference over two samples is an acceleration that is too small
            own.append(CubicSpline(run.trace.time, own[-1])(run.trace.time, 1))
    return [at_rows(runs, rows, [own[i] for own in slopes]) for i in range(1, 5)]


def effort_balance(runs: Sequence[MeasuredRun], axis: str, effort: str, rows: Strokes, kind: str) -> tuple[Friction, np.ndarray] | None:
    """Friction, inertia, weight and constant part of an effort, and what they leave (row,); None if the motion explains none of it."""
    sign = np.sign(rows.speed)
    motion = _motion_of(runs, rows, [position_of(run, axis) for run in runs])
    # in one direction Coulomb friction and a constant force are one column
    both_ways = bool((sign > 0).any() and (sign < 0).any())
    columns = [sign, *motion[:2], np.ones_like(sign) if both_ways else np.zeros_like(sign)]
    turns = kind == "rotary" and np.ptp(rows.position) > LEAST_TURN_RAD
    columns += [np.cos(rows.position) - 1.0, np.sin(rows.position)] if turns else []
    loads = [sum(run.trace.loads(axis).values(), np.zeros(len(run.trace.time))) for run in runs]
    loaded = any(np.ptp(load) > 0.0 for load in loads)
    columns += [-at_rows(runs, rows, [low_passed(f, run.trace.period, BAND_HZ) for f, run in zip(loads, runs)])] if loaded else []
    k = len(columns)
    laws = [np.column_stack(columns), np.column_stack([*columns, motion[2]])]
    efforts = [CubicSpline(run.trace.time, low_passed(run.trace.get(axis, effort), run.trace.period, BAND_HZ)) for run in runs]
    late, period = 0.0, max(run.trace.period for run in runs)
    for _ in range(3):
        u = at_rows(runs, rows, [e(np.clip(run.trace.time - late, *run.trace.time[[0, -1]])) for e, run in zip(efforts, runs)])
        b = regress(laws[1][rows.inner], u[rows.inner], rows.stroke[rows.inner]).values
        late = float(np.clip(late + b[k] / b[2], -MOST_LATE * period, MOST_LATE * period)) if b[2] != 0.0 else 0.0
    # a counterbalance or a cable pulls by the place: in a stroke that it knows, such a law explains whatever is its own, so both ways are left out
    placed = False
    if not turns:
        by_place = np.column_stack([laws[1], rows.position - rows.position.mean()])
        less, more = (held_out(law[rows.inner], u[rows.inner], rows.stroke[rows.inner] // 2) for law in (by_place, laws[1]))
        placed = is_better(less, more, 1e-6 * float(np.std(u)) + 1e-150)
        laws = [by_place] if placed else laws
    likely = _likely([law[rows.inner] for law in laws], u[rows.inner], rows.run[rows.inner])
    step, noise = rounding_of([run.trace.get(axis, effort) for run in runs])

    def regressed(law: np.ndarray, own: np.ndarray) -> Fit:
        return with_rounding(regress(law[own], u[own], rows.stroke[own]), law[own], step, noise)

    # the ends of the strokes are left out, but an interval says what they would change
    fits = [regressed(laws[i], own) for own in (rows.inner, np.ones_like(rows.inner)) for i in likely]
    left = u - laws[likely[0]] @ fits[0].values
    # so it does if all of the lateness but the hold is a lag: 1 / (1 + T s) is as late as exp(-T s), and differs by -(T s)^2 / 2
    lagged = laws[likely[0]].copy()
    lagged[:, 2] -= 0.5 * max(late - 0.5 * period, 0.0) ** 2 * motion[3]
    found = [_inertia(fit, k) for fit in (*fits, regressed(lagged, rows.inner))]
    speed = float(np.median(np.abs(rows.speed[rows.steady]))) if rows.steady.any() else float(np.median(np.abs(rows.speed)))
    number = functools.partial(value_of_all, fits)
    total = number({0: 1.0, 1: speed})
    if EFFORTS[effort].has_back_emf:  # by a lag of the current behind the voltage only friction comes late, not the back EMF
        found += [v and v.plus(late * fit.values[1]) for v, fit in zip(found, fits)]
    inertia = _cover(found)
    if total is None or inertia is None or not (total.known or inertia.known):
        return None
    # in one direction a weight may outweigh friction: the sign is then not judged
    turned = -1.0 if (total if total.known else inertia).value < 0.0 and both_ways else 1.0
    coulomb, viscous = number({0: turned}), number({1: turned})
    several = viscous is not None and one_speed(rows.speed) is None
    split = several and both_ways and coulomb is not None and coulomb.low > 0.0 and viscous.high > 0.0  # type: ignore[union-attr]
    slope = split or (several and not both_ways and viscous.low > 0.0)  # type: ignore[union-attr]
    peak = max(float(np.abs(run.trace.get(axis, effort)).max()) for run in runs)
    still = MOVING * float(np.abs(rows.speed).max())
    rests = [np.abs(slopes_of(position_of(run, axis), run.trace.period)[0]) < still for run in runs]
    resting = np.concatenate([run.trace.get(axis, effort)[rest] for run, rest in zip(runs, rests)])
    cosine, sine = (number({4: turned}), number({5: turned})) if turns else (None, None)
    return (
        Friction(
            effort, speed, total.times(turned), coulomb if split else None, viscous if slope else None,
            inertia.times(turned), number({3: turned}) if both_ways else None, turned < 0.0, peak,
            1.0 - float(np.var(left) / max(float(np.var(u)), 1e-300)),
            (cosine, sine) if cosine is not None and sine is not None else None, number({k - 1: 1.0}) if loaded else None,
            turned * float(np.median(resting)) if len(resting) else None,
            number({k + 1: turned * float(np.ptp(rows.position))}) if placed else None,
        ),
        turned * left,
    )  # fmt: skip


def friction_on_load(runs: Sequence[MeasuredRun], axis: str, rows: Strokes, balance: Friction, load_part: float) -> float | None:
    """Share of the friction that acts on a load of this part of the inertia, behind a spring between motor encoder and scale.

    Friction and acceleration of the load both deflect the spring, in the ratio of friction to load. A play passes for friction of the load; where that
    is more than all friction, half is assumed. None where acceleration shows no deflection.
    """
    twist = at_rows(runs, rows, [low_passed(motor_minus_scale(run.trace, axis), run.trace.period, BAND_HZ) for run in runs])
    offsets = [rows.run == i for i in range(len(runs))]
    columns = np.column_stack([np.sign(rows.speed), rows.speed, rows.acceleration, *offsets])[rows.inner]
    fit = regress(columns, twist[rows.inner], rows.stroke[rows.inner])
    by_friction, by_acceleration = float(fit.values[0]), float(fit.values[2])
    if balance.coulomb is None or not by_acceleration > fit.quantile * fit.deviations[2]:
        return None
    share = by_friction / by_acceleration * load_part * balance.inertia.value / balance.coulomb.value
    return max(share, 0.0) if share <= 1.0 else 0.5


def rounding_of(records: Sequence[np.ndarray]) -> tuple[float, float]:
    """Step to which records (sample,) of one signal are rounded, 0 without one, and their noise before that."""
    step = max(map(step_of, records))
    return step, math.sqrt(max(min(map(noise_of, records)) ** 2 - step**2 / 12.0, 0.0))


def noise_of(values: np.ndarray) -> float:
    """Standard deviation of single samples in the quiet parts; of a short record from second differences in its quietest fifth."""
    return _noise_shown(values)[0]


def least_noise(records: Sequence[np.ndarray]) -> tuple[float, float]:
    """The least noise of records (sample,) of one signal, and what it is only known to be below: their resolution, and what is not white in quiet parts."""
    shown = [_noise_shown(values) for values in records]
    below = [max(resolution_of(values), 0.0 if white else noise) for values, (noise, white) in zip(records, shown)]
    return min(noise for noise, _ in shown), max(below)


def _noise_shown(values: np.ndarray) -> tuple[float, bool]:
    """The noise of single samples, and whether it is white.

    A channel that was recorded at a longer interval is interpolated: its noise is white only at every second or fourth sample.
    """
    levels = [quiet_noise(values[::every]) for every in (1, 2, 4)]
    if shown := [level for level, white in levels if white and level]:
        return math.sqrt(shown[0]), True
    if levels[0][0]:
        return math.sqrt(levels[0][0]), False
    parts = [part for part in np.array_split(values, max(1, len(values) // 100)) if len(part) > 4]
    # most samples of a coarse record equal their neighbours: their median says nothing
    sizes = [roughness(part) or float(np.std(np.diff(part, 2))) for part in parts]
    sizes = [size for size in sizes if size > 0.0]
    return (float(np.percentile(sizes, 20) / np.sqrt(SECOND_DIFFERENCE)) if sizes else 0.0), False
