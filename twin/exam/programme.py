"""Set points of the examination's runs at 1 kHz, inside travel and limits of the machine file. Moves and contours: paths.py.

A `TestRun` holds set points [sample, axis] in SI (m, rad) and the feedforward of the control. Three kinds:
  "test"     ten runs of a test campaign like the recorded ones, with sizes and feeds varied by seed
  "program"  three runs of a customer's part programs
  "exam"     runs that the diagnosis does not get, for the held-out gap: a contour, a circle, random point to point
"""

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np

from .paths import DEG, MARGIN, PERIOD, Limits, contour, eased, hold, limits_of, move, path_of, together


@dataclass(frozen=True)
class TestRun:
    """name, kind ("test", "program", "exam"), feedforward (off | velocity | velocity+torque), set points [sample, axis] SI.

    `period_s` is the period of the set points; None: the sample period (1 ms)."""

    __test__ = False  # not a pytest class

    name: str
    kind: str
    feedforward: str
    set_points: np.ndarray
    period_s: float | None = None


def _vary(rng: np.random.Generator, value: float, by: float = 0.2) -> float:
    """A value drawn uniformly within 1 +- by."""
    return value * (1.0 + by * (2.0 * rng.random() - 1.0))


Motions = Iterator[tuple[str, str, np.ndarray]]
"""Name, feedforward and set points of runs of one kind."""


def ten_test_runs(lim: Limits, rng: np.random.Generator) -> Motions:
    """The ten runs of a test campaign."""
    acc = np.minimum(MARGIN * lim.acceleration, [2.0, 2.0, 2.1, 5.0, 5.0])
    home = np.array([0.0, 0.0, 0.0, _vary(rng, -35.0, 0.12) * DEG, 0.0])
    yield "constant_velocity", "velocity", _constant_speeds(lim, acc, rng, home)
    both = _accelerations(lim, acc, rng, home)
    yield "acceleration_ff_off", "off", both
    yield "acceleration", "velocity+torque", both
    yield "reversal", "velocity+torque", _reversals(rng)
    yield "tilt_hold", "velocity+torque", _tilts(lim, acc, rng)
    for name, first, second in (("circle_xy", 0, 1), ("circle_zx", 2, 0)):
        radius, feed = _vary(rng, 0.03, 0.3), _vary(rng, 0.05, 0.25)
        yield name, "velocity+torque", _circle(first, second, radius, feed, 2, lim)
    yield "chirp", "velocity", _chirp(lim, rng)
    yield "five_axis", "velocity+torque", _five_axis(lim, rng, home, (2, 3, 2, 1, 2))
    yield "corners", "velocity+torque", _corners(lim, rng, _vary(rng, 0.08), _vary(rng, 0.167, 0.2))


def _constant_speeds(lim: Limits, acc: np.ndarray, rng: np.random.Generator, home: np.ndarray) -> np.ndarray:
    """Constant speeds from very slow to rapid, there and back: friction over speed."""
    ladder = [np.array([5.0, 15.0, 40.0, 100.0, 250.0]) * 1e-3] * 3 + [np.array([0.3, 1.0, 4.0, 20.0, 50.0]) * DEG] * 2
    columns = []
    for k in range(5):
        speeds = [_vary(rng, v) for v in ladder[k]]
        targets, used = [], []
        for wanted, seconds in zip(speeds, (0.4, 0.45, 0.5, 0.35, 0.4)):
            v = min(wanted, 0.6 * lim.speed[k])
            reach = v * seconds + 0.5 * v * v / acc[k]
            reach = min(reach, 0.45 * (lim.high[k] - lim.low[k]), 0.5 * abs(home[3] - lim.low[3]) if k == 3 else 1e9)
            targets += [home[k] + reach, home[k] - reach]
            used += [v, v]
        columns.append(path_of(home[k], [*targets, home[k]], [*used, used[-1]], acc[k], MARGIN * lim.jerk[k], 0.1))
    return together(columns)


def _accelerations(lim: Limits, acc: np.ndarray, rng: np.random.Generator, home: np.ndarray) -> np.ndarray:
    """Full accelerations to two speeds, there and back."""
    columns = []
    for k in range(5):
        far = _vary(rng, 0.10, 0.15) if k < 3 else _vary(rng, 25.0 if k == 3 else 45.0, 0.15) * DEG
        fast = _vary(rng, 0.25, 0.15) if k < 3 else _vary(rng, 70.0 if k == 3 else 100.0, 0.12) * DEG
        fast = min(fast, MARGIN * lim.speed[k])
        targets = [home[k] + step * far for step in (1, -1, 1, -1, 0)]
        columns.append(path_of(home[k], targets, [fast, fast, 0.6 * fast, 0.6 * fast, fast], acc[k], MARGIN * lim.jerk[k], 0.15))
    return together(columns)


def _reversals(rng: np.random.Generator) -> np.ndarray:
    """Slow reversals of two sizes, the second within pre-sliding."""
    turn = np.array([0.0, 0.0, 0.0, _vary(rng, -20.0, 0.3) * DEG, 0.0])
    u = eased(5.0, 0.8)
    waves = []
    for size in (_vary(rng, 2e-3), _vary(rng, 20e-6, 0.5)):
        amplitude = np.array([size] * 3 + [size / 2e-3 * DEG] * 2)
        waves.append(turn + np.sin(2 * math.pi * 4.0 * u)[:, None] * amplitude)
    return np.vstack(waves)


def _tilts(lim: Limits, acc: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Gravity at many tilts of A while C turns: static balance."""
    tilts = [-90, -70, -50, -30, -10, 10, 25, 0, -40, -90]
    stops = np.clip([s + 4.0 * (2.0 * rng.random() - 1.0) for s in tilts], -97.0, 28.0) * DEG
    jerk = MARGIN * lim.jerk
    tilt = path_of(stops[0], list(stops[1:]), [_vary(rng, 30.0, 0.1) * DEG] * 9, 4.0, jerk[3], 0.35)
    table = path_of(0.0, [x * DEG for x in (60, 120, 200, 300, 360)], [_vary(rng, 60.0, 0.1) * DEG] * 5, acc[4], jerk[4], 0.9, 1.1)
    return together([*np.zeros((3, 2)), tilt, table])


def _chirp(lim: Limits, rng: np.random.Generator) -> np.ndarray:
    """Chirp of constant speed amplitude on a slow travel."""
    n, length = hold(7.0), 7.0
    t = np.arange(n) * PERIOD
    low, high = _vary(rng, 1.0), _vary(rng, 60.0, 0.15)
    columns = []
    for k in range(5):
        top = high * (1.0 + 0.2 * (rng.random() - 0.5))
        phase = 2 * math.pi * (low * t + (top - low) * t * t / (2 * length))
        window = np.minimum(1.0, np.minimum(t, length - t) / 0.5)
        window = 0.5 - 0.5 * np.cos(math.pi * window)
        swing = 6e-3 if k < 3 else 0.11 * DEG * 18
        swing = min(swing, 0.8 * lim.acceleration[k] / (2 * math.pi * top))
        v = window * (_vary(rng, 0.018, 0.1) if k < 3 else _vary(rng, 5.5, 0.1) * DEG) + window * swing * np.sin(phase)
        start = -0.05 if k < 3 else (-40.0 * DEG if k == 3 else 0.0)
        columns.append(start + np.cumsum(v) * PERIOD)
    return together(columns, 0.0)


def program_runs(lim: Limits, rng: np.random.Generator) -> Motions:
    """Three part programs: a circle with Z plunge, a pocket with corners, a five-axis surface."""
    circle = _circle(0, 1, _vary(rng, 0.045, 0.3), _vary(rng, 0.08, 0.3), 3, lim)
    t = np.linspace(0.0, 1.0, len(circle))
    circle[:, 2] = -_vary(rng, 0.012) * (0.5 - 0.5 * np.cos(2 * math.pi * t))
    yield "program_circle", "velocity+torque", circle
    pocket = np.vstack([_corners(lim, rng, size, _vary(rng, 0.1, 0.3)) for size in (_vary(rng, 0.1), _vary(rng, 0.05))])
    yield "program_pocket", "velocity+torque", pocket
    home = np.array([0.0, 0.0, -0.02, -30.0 * DEG, 0.0])
    surface = np.vstack([_five_axis(lim, rng, home, cycles, size=0.6) for cycles in ((3, 1, 4, 2, 1), (1, 4, 3, 1, 2))])
    yield "program_surface", "velocity+torque", surface


def exam_runs(lim: Limits, rng: np.random.Generator) -> Motions:
    """Runs for the held-out gap: five-axis contour, YZ circle, random point-to-point moves of all axes."""
    home = np.array([0.02, -0.03, 0.01, -40.0 * DEG, 20.0 * DEG])
    yield "exam_five_axis", "velocity+torque", _five_axis(lim, rng, home, (1, 2, 3, 2, 1), size=0.8)
    yield "exam_circle_yz", "velocity+torque", _circle(1, 2, _vary(rng, 0.04, 0.3), _vary(rng, 0.07, 0.3), 2, lim)
    columns = []
    for k in range(5):
        low, high = (-0.12, 0.12) if k < 3 else ((-70 * DEG, 10 * DEG) if k == 3 else (-60 * DEG, 60 * DEG))
        targets = list(low + (high - low) * rng.random(7))
        speeds = list(lim.speed[k] * (0.15 + 0.6 * rng.random(7)))
        columns.append(path_of(home[k], targets, speeds, 0.8 * lim.acceleration[k], MARGIN * lim.jerk[k], 0.12))
    yield "exam_point_to_point", "velocity+torque", together(columns)


def programme(machine: dict, seed: int) -> list[TestRun]:
    """All runs of one case, the same for the same seed: ten tests, three programs, three exam runs."""
    streams, lim = np.random.SeedSequence([seed, 20]).spawn(3), limits_of(machine)
    makers = (("test", ten_test_runs), ("program", program_runs), ("exam", exam_runs))
    made = [(kind, *run) for (kind, maker), stream in zip(makers, streams) for run in maker(lim, np.random.default_rng(stream))]
    return [TestRun(name, kind, feedforward, points) for kind, name, feedforward, points in made]


def _circle(first: int, second: int, radius: float, feed: float, turns: int, lim: Limits) -> np.ndarray:
    """Full circles that start at 0, with the centre at -radius on `first`."""

    def curve(u: np.ndarray) -> np.ndarray:
        points = np.zeros((len(u), 5))
        angle = 2 * math.pi * turns * u
        points[:, first], points[:, second] = radius * (np.cos(angle) - 1.0), radius * np.sin(angle)
        return points

    points = contour(curve, 2 * math.pi * radius * turns / feed + 0.6, lim)
    return np.vstack([points, np.tile(points[-1], (hold(0.05), 1))])


def _five_axis(lim: Limits, rng: np.random.Generator, home: np.ndarray, cycles: tuple, size: float = 1.0) -> np.ndarray:
    """Closed Lissajous curve of all five axes, with whole numbers of cycles."""
    amplitude = size * np.array([_vary(rng, a) for a in (0.12, 0.09, 0.05, 30.0 * DEG, 60.0 * DEG)])
    amplitude[3] = min(amplitude[3], MARGIN * (home[3] - lim.low[3]), MARGIN * (lim.high[3] - home[3]))
    even = rng.random(5) < 0.4

    def curve(u: np.ndarray) -> np.ndarray:
        angle = 2 * math.pi * u[:, None] * np.array(cycles)
        return home + amplitude * np.where(even, 0.5 - 0.5 * np.cos(angle), np.sin(angle))

    return contour(curve, _vary(rng, 7.0, 0.15), lim, ramp=1.0)


def _corners(lim: Limits, rng: np.random.Generator, side: float, feed: float) -> np.ndarray:
    """A square whose moves overlap by the jerk ramp (rounded corners), a Z plunge, an XY zigzag back."""
    acc = np.minimum(0.8 * lim.acceleration, 1.6)
    points, at = [np.zeros((hold(0.2), 5))], np.zeros(5)

    def go(target: tuple[float, float, float], overlap: int) -> None:
        nonlocal at
        delta = np.asarray(target, dtype=float) - at[:3]
        length = float(np.linalg.norm(delta))
        moving = np.abs(delta) > 1e-12
        share = np.abs(delta[moving]) / length
        shape = move(
            length,
            min(feed, (lim.speed[:3][moving] / share).min()),
            (acc[:3][moving] / share).min(),
            (MARGIN * lim.jerk[:3][moving] / share).min(),
        )
        step = np.zeros((len(shape), 5))
        step[:, :3] = shape[:, None] / length * delta
        old = points[-1]
        n = min(overlap, len(old) - 1, len(step) - 1)
        if n:  # the new move begins before the last one ends
            points[-1] = np.vstack([old[:-n], old[-n:] + step[:n]])
            step = step[n:]
        at = at + np.concatenate([delta, [0.0, 0.0]])
        points.append(step + (at - np.concatenate([delta, [0.0, 0.0]])))

    for target in ((side, 0, 0), (side, side, 0), (0, side, 0), (0, 0, 0)):
        go(target, hold(0.06))
    points.append(np.tile(at, (hold(0.3), 1)))
    depth = _vary(rng, 0.03)
    go((0.25 * side, 0, -depth), 0)
    go((1.4 * side, 0.3 * side, -depth), hold(0.04))
    go((0, 0, 0), hold(0.04))
    points.append(np.tile(at, (hold(0.2), 1)))
    return np.vstack(points)
