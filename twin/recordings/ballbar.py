"""Ballbar between two axes: it measures the radius at each angle of a circle, but not the tangential position.

measured = set point + (d - G g) u,    d = distance of the load from the centre, at the angle of the set point, minus the radius

u is the radial unit vector. The columns of G (sample, 5) are deviations that a radius cannot separate: position of the bar (cos, sin),
scale errors (cos^2, sin^2), squareness (sin cos). The factors g are fitted to both directions together. The same operation is applied to
recorded and simulated runs, so comparing positions compares radii. Set points extend OVERLAP beyond the measured arc of each direction.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import functools
import math

import numpy as np
from scipy.interpolate import CubicSpline

from twin.recordings.trace import Trace

OVERLAP = math.radians(90.0)
"""Travel before and after the measured circle, in each direction."""
FINEST = 1e-3
"""Longest sample period [s] of a simulation for a ballbar, since a reversal is shorter than the time between two readings."""
LEAD = math.radians(10.0)
"""Part of the overlap that is ignored, because a lagging axis has hardly started there."""
GEOMETRY = ("centre {0}", "centre {1}", "scale {0}", "scale {1}", "squareness")
"""Names of the columns of G. The first two factors are shares of the radius."""


@dataclass(frozen=True)
class Ballbar:
    """A ballbar between two `axes`. Their set points `commanded` (sample, 2) [m] at `time` (sample,) [s], from 0 on, form a circle.
    `noise` is the standard deviation of a radius [m]."""

    axes: tuple[str, str]
    time: np.ndarray
    commanded: np.ndarray
    noise: float

    @functools.cached_property
    def centre(self) -> np.ndarray:
        """(2,) [m]."""
        return 0.5 * (self.commanded.min(axis=0) + self.commanded.max(axis=0))

    @functools.cached_property
    def angle(self) -> np.ndarray:
        """Unwrapped polar angle of the set points (sample,) [rad]."""
        return np.unwrap(np.arctan2(*(self.commanded - self.centre).T[::-1]))

    @functools.cached_property
    def radial(self) -> np.ndarray:
        """Radial unit vectors u (sample, 2)."""
        return np.column_stack([np.cos(self.angle), np.sin(self.angle)])

    @functools.cached_property
    def radius(self) -> float:
        """Radius of the circle [m]."""
        return float(np.median(np.hypot(*(self.commanded - self.centre).T)))

    @functools.cached_property
    def measured(self) -> np.ndarray:
        """True (sample,) where the bar measures."""
        rows = np.zeros(len(self.angle), bool)
        for stretch in self._stretches():
            rows[stretch] |= self._away_from_ends(stretch, OVERLAP)
        return rows

    @functools.cached_property
    def geometry(self) -> np.ndarray:
        """G (sample, 5)."""
        x, y = self.radial.T
        return np.column_stack([x, y, x * x, y * y, x * y])

    def readings_of(self, axis: str) -> np.ndarray:
        """True (sample,) where the bar measures and is closer to this axis than to the other. Each reading belongs to one axis."""
        along = self.axes.index(axis)
        return self.measured & (np.argmax(np.abs(self.radial), axis=1) == along)

    def seen(self, trace: Trace, axis: str) -> np.ndarray:
        """Radial deviation [m] without geometry, at the readings of an axis (reading,), from a trace of ballbar positions."""
        rows, along = self.readings_of(axis), self.axes.index(axis)
        return np.asarray((trace.get(axis, "position") - self.commanded[:, along])[rows] / self.radial[rows, along])

    def noise_of(self, axis: str) -> np.ndarray:
        """Noise of the ballbar position of an axis (sample,) [m]."""
        return self.noise * np.abs(self.radial[:, self.axes.index(axis)]) * self.measured

    def deviation(self, trace: Trace) -> np.ndarray:
        """d (sample,) [m] of a simulated trace, which may have a shorter sample period."""
        signal = "load_position" if trace.has(self.axes[0], "load_position") else "position"
        from_centre = trace.matrix(signal, self.axes) - self.centre
        distance, angle = np.hypot(*from_centre.T), np.unwrap(np.arctan2(*from_centre.T[::-1]))
        deviation = np.zeros(len(self.time))
        for stretch in self._stretches():
            turn = np.sign(self.angle[stretch[-1]] - self.angle[stretch[0]])
            begin, end = self.time[stretch[self._away_from_ends(stretch, LEAD)][[0, -1]]]
            looked_at = (trace.time - trace.time[0] >= begin) & (trace.time - trace.time[0] <= end)
            behind = np.mean(np.interp(trace.time[looked_at] - trace.time[0], self.time, self.angle) - angle[looked_at])
            at = turn * (angle[looked_at] + 2.0 * math.pi * round(float(behind) / (2.0 * math.pi)))
            onward = np.diff(np.maximum.accumulate(at), prepend=-math.inf) > 0.0
            rows = stretch[self._away_from_ends(stretch, OVERLAP)]
            deviation[rows] = CubicSpline(at[onward], distance[looked_at][onward])(turn * self.angle[rows]) - self.radius
        return deviation

    def positions(self, deviation: np.ndarray) -> dict[tuple[str, str], np.ndarray]:
        """Ballbar positions of both axes from the radial deviation d (sample,) [m]."""
        left = np.where(self.measured, deviation - self.geometry @ self.sizes(deviation), 0.0)
        return {(axis, "position"): self.commanded[:, k] + left * self.radial[:, k] for k, axis in enumerate(self.axes)}

    def sizes(self, deviation: np.ndarray) -> np.ndarray:
        """Factors g (5,) [m] of the geometry in a radial deviation (sample,) [m]."""
        return np.linalg.lstsq(self.geometry[self.measured], deviation[self.measured], rcond=None)[0]

    def _stretches(self) -> Iterator[np.ndarray]:
        """Rows of each direction."""
        turn = np.sign(np.gradient(self.angle))
        edges = np.flatnonzero(np.diff(turn)) + 1
        for rows in np.split(np.arange(len(turn)), edges):
            if turn[rows[0]] and abs(self.angle[rows[-1]] - self.angle[rows[0]]) > 2.0 * OVERLAP:
                yield rows

    def _away_from_ends(self, stretch: np.ndarray, overlap: float) -> np.ndarray:
        """True (row,) for rows of a stretch at least `overlap` away from both of its ends."""
        swept = np.abs(self.angle[stretch] - self.angle[stretch[0]])
        return (swept >= overlap) & (swept <= swept[-1] - overlap)


def ballbar_of(trace: Trace, axes: Sequence[str], noise: float) -> Ballbar:
    """The bar between two axes of a recorded trace."""
    first, second = axes
    return Ballbar((first, second), trace.time - trace.time[0], trace.matrix("setpoint", (first, second)), noise)
