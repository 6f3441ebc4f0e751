"""Starting values read from the residual: spectral lines over motor angle, travel or time, resonances, levels of a saturated current."""

from collections.abc import Iterator
import math

import numpy as np
import scipy

from twin.diagnose.observe import Group
from twin.effects.effect import Parameter
from twin.machine.machine import Axis

PEAKS = 2
"""Spectral lines tried for an effect that is periodic in position or time."""

SAME_LINE = 0.02
"""Spectral lines closer than this share of their value are one start."""

LARGEST_ORDER_HZ = 60.0
"""Highest frequency of a disturbance that the current follows."""

LONGEST_WAVE = 4.0
"""Longest wave along the travel in the scan, over the longest usual one."""

OVERSAMPLED = 8.0
"""Trial wave numbers per resolved wave number."""

ENOUGH_HITS = 20.0
"""More samples in a bin add no weight."""

NO_WAVES = np.array([1.0]), np.array([0.0])
"""Result of an empty scan: one value without power."""

MOST_WAVES = 800.0
"""Largest number of waves over a motion in the scan; more take seconds."""

WAVES_AT_ONCE = 256
"""Waves per block of the scan; limits memory."""

MOST_BINS = 400_000
"""Largest number of bins along a motion; longer motions are not scanned."""

SLOW_ENOUGH = 0.1
"""Share of the motion that must be slow enough for a wavelength to be tried."""

PER_TURN, IN_TIME_HZ, RESONANCES_HZ = (0.5, 40.0), (1.0, 120.0), (12.0, 90.0)
"""Sought periods per motor turn, frequencies of a sine in time and of a resonance."""

RESONANCE_DAMPING = 0.05
LEVELS = (0.85, 0.96, 0.99, 1.02, 1.05, 1.08)
"""Trial levels of a clipped current, as fractions of the largest measured current."""


class StartValues:
    """Starting values for one axis from the weighted residual (row,) of its group."""

    def __init__(self, group: Group, axis: Axis, residual: np.ndarray) -> None:
        self.group, self.axis = group, axis
        self.values = residual / group.weights
        self.channels = {}
        for channel in group.channels:
            if channel.axis == axis.name:
                self.channels[channel.run, channel.name] = channel

    def of(self, parameter: Parameter) -> list[float]:
        """Starting values of a parameter with a scan: the strongest spectral lines, or levels of a limit."""
        match parameter.scan:
            case "turn":
                waves, power = self._along_turn(*PER_TURN, 2.0 * math.pi * self.axis.ratio)
                return _with_whole_number(_strongest(waves, power), waves, power)
            case "travel":
                shortest, longest = parameter.usual_range(self.group.machine, self.axis)
                return _strongest(*self._along_travel(shortest / 3.0, LONGEST_WAVE * longest))
            case "time":
                return _strongest(*self._in_time())
            case "resonance":
                return _strongest(*self._resonance())
            case "largest current":
                return self._current_levels()
        raise ValueError(f"parameter {parameter.name} has no scan")

    def _current_levels(self) -> list[float]:
        """Trial levels of a current limit, near the largest measured current.

        The current is a saw-tooth between two cycles, and a record samples it at one phase. The limit may therefore be higher.
        """
        level = 0.0
        for (run, name), _ in self.channels.items():
            trace = self.group.views[run].trace
            if name == "current":
                level = max(level, float(np.quantile(np.abs(trace.get(self.axis.name, self.axis.effort)), 0.9995)))
        level = level or 0.3 * self.axis.motor.peak_current_a
        return [share * level for share in LEVELS]

    def _pieces(self, name: str) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Residual, position, speed and time at the samples of a channel, run by run."""
        for (run, channel_name), channel in self.channels.items():
            if channel_name != name:
                continue
            view = self.group.views[run]
            a = view.machine.axis_names.index(self.axis.name)
            values = self.values[channel.rows]
            q, v = view.motion.position[:, a], view.motion.speed[:, a]
            t = view.trace.time - view.trace.time[0]
            rows = view.rows_of(self.axis.name, name)
            yield values, q[rows], v[rows], t[rows]

    def _slow_pieces(self, low: float, high: float, per: float) -> tuple[float, list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
        """Largest number of waves per length `per` for which enough of the motion is slow enough; and residual of the current, position and speed
        where it is slow enough, run by run.
        """
        parts = list(self._pieces("current"))
        speeds, top = np.abs(np.concatenate([v for _, _, v, _ in parts] or [np.zeros(0)])), high
        while parts and top > 4.0 * low and np.mean(speeds * top / 4.0 / per < LARGEST_ORDER_HZ) < SLOW_ENOUGH:
            top /= 2.0
        cut = [(values - np.median(values), q, v, np.abs(v) * top / 4.0 / per < LARGEST_ORDER_HZ) for values, q, v, _ in parts]
        return top, [(values[slow], q[slow], v[slow]) for values, q, v, slow in cut if slow.any()]

    def _along_turn(self, low: float, high: float, per: float) -> tuple[np.ndarray, np.ndarray]:
        """Waves per turn, and power of the current residual over position: averaged in bins of an eighth of the shortest wave, then Fourier
        transformed.
        """
        top, parts = self._slow_pieces(low, high, per)
        bin_width = per / high / 8.0
        start = min((float(q.min()) for _, q, _ in parts), default=0.0)
        count = int((max((float(q.max()) for _, q, _ in parts), default=0.0) - start) / bin_width) + 2
        if not parts or count > MOST_BINS:
            return NO_WAVES
        total, hits = np.zeros(count), np.zeros(count)
        for values, q, _ in parts:
            index = ((q - start) / bin_width).astype(int)
            np.add.at(total, index, values)
            np.add.at(hits, index, 1.0)
        mean = np.where(hits > 0, total / np.maximum(hits, 1.0), 0.0) * np.sqrt(np.minimum(hits, ENOUGH_HITS))
        mean -= np.where(hits > 0, mean[hits > 0].mean() if np.any(hits > 0) else 0.0, 0.0)
        size = 1 << (8 * count - 1).bit_length()
        waves = np.fft.rfftfreq(size, bin_width) * per
        keep = (waves >= low) & (waves <= top)
        return waves[keep], np.abs(np.fft.rfft(mean, size)[keep]) ** 2

    def _along_travel(self, shortest: float, longest: float) -> tuple[np.ndarray, np.ndarray]:
        """Wavelengths, and the squared current residual that a sine from q = 0, reversing with the direction of motion, explains.

        Each run and direction has its own mean. Therefore a wave as long as the motion is detected, and other friction is not.
        """
        top, parts = self._slow_pieces(1.0 / longest, 1.0 / shortest, 1.0)
        span = max((float(np.ptp(q)) for _, q, _ in parts), default=0.0)
        if span <= 0.0:
            return NO_WAVES
        top = min(top, MOST_WAVES / span)
        bin_width = 1.0 / top / 8.0
        waves = np.arange(1.0 / longest, top, min(1.0 / (OVERSAMPLED * span), 0.1 / longest))
        shown, own = np.zeros(len(waves)), np.zeros(len(waves))
        for values, q, v in parts:
            for direction in (-1.0, 1.0):
                there = np.sign(v) == direction
                if not there.any():
                    continue
                place, index = np.unique(np.floor(q[there] / bin_width), return_inverse=True)
                hits = np.bincount(index)
                counted = np.minimum(hits, ENOUGH_HITS)
                weight = counted / counted.sum()
                mean = direction * np.bincount(index, values[there]) / hits
                mean -= weight @ mean
                for block in np.array_split(np.arange(len(waves)), len(waves) // WAVES_AT_ONCE + 1):
                    sine = np.sin(2.0 * np.pi * np.outer(waves[block], (place + 0.5) * bin_width))
                    sine -= (sine @ weight)[:, None]
                    shown[block] += sine @ (counted * mean)
                    own[block] += np.square(sine) @ counted
        return (1.0 / waves, np.square(shown) / np.maximum(own, 1e-300)) if len(waves) else NO_WAVES

    def _in_time(self) -> tuple[np.ndarray, np.ndarray]:
        frequencies = np.arange(*IN_TIME_HZ, 0.02)
        power = np.zeros(len(frequencies))
        for values, _, _, t in self._pieces("current"):
            if len(t) < 200:
                continue
            period = float(np.median(np.diff(t)))
            grid = np.zeros(round(t[-1] / period) + 1)
            grid[np.rint(t / period).astype(int)] = values - np.median(values)
            size = 1 << max(16, (len(grid) - 1).bit_length())
            spectrum = np.abs(np.fft.rfft(grid, size)) ** 2 / len(grid)
            power += np.interp(frequencies, np.fft.rfftfreq(size, period), spectrum)
        return frequencies, power

    def _resonance(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies, and the squared motor minus scale (or position) that a swinging mass with this frequency explains.

        A run contributes nothing above half its sampling rate.
        """
        frequencies = np.geomspace(*RESONANCES_HZ, 40)
        power = np.zeros(len(frequencies))
        name = "motor_minus_scale" if any(n == "motor_minus_scale" for _, n in self.channels) else "position"
        for values, _, v, t in self._pieces(name):
            if len(t) < 3:
                continue
            period = float(np.median(np.diff(t)))
            a = np.gradient(v, period)
            for i in np.flatnonzero(frequencies < 0.5 / period):
                w = 2.0 * math.pi * float(frequencies[i])  # x'' + 2 z w x' + w^2 x = a, with a held over a sample
                b, recursion, _ = scipy.signal.cont2discrete(([1.0], [1.0, 2.0 * RESONANCE_DAMPING * w, w * w]), period)
                response = scipy.signal.lfilter(np.ravel(b), recursion, a)
                norm = float(response @ response)
                if norm > 0:
                    power[i] += float(response @ values) ** 2 / norm
        return frequencies, power


def _with_whole_number(chosen: list[float], waves: np.ndarray, power: np.ndarray) -> list[float]:
    """The chosen waves per turn, and the strongest whole number of them.

    Eccentricity, poles and slots repeat a whole number of times a turn. A residual with spikes at the reversals hides such a line among others.
    """
    whole = np.arange(math.ceil(waves[0]), math.floor(waves[-1]) + 1.0)
    if len(whole) == 0 or len(waves) < 3:
        return chosen
    best = float(whole[np.argmax(np.interp(whole, waves, power))])
    return chosen if any(abs(math.log(best / c)) <= SAME_LINE for c in chosen) else [*chosen, best]


def _strongest(values: np.ndarray, power: np.ndarray) -> list[float]:
    """Values at the strongest local maxima of the power, at most PEAKS, strongest first."""
    if len(power) < 3 or not np.any(power > 0):
        return [float(values[len(values) // 2])]
    inner = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])) + 1
    inner = inner[np.argsort(-power[inner])][: 4 * PEAKS]
    chosen: list[float] = []
    for i in inner:
        if all(abs(math.log(values[i] / c)) > SAME_LINE for c in chosen):
            chosen.append(float(values[i]))
        if len(chosen) == PEAKS:
            break
    return chosen or [float(values[int(np.argmax(power))])]
