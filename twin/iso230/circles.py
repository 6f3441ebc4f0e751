"""Circles by ISO 230-4: deviations of a path from a circle, in both directions, and the share of each diagnosed effect in them.

A path has polar angles and distances from the nominal centre. With the least-squares circle (centre c, radius r) of a path:

    G(cw), G(ccw)   circular deviation: range of the distance from the path's own least-squares centre
    G(b)            bidirectional: the same range over both paths about the least-squares centre of both
    F max, F min    radial deviation: greatest and least distance from the nominal centre less the nominal radius, over both paths
    H               hysteresis: greatest difference between the two paths at one angle (edition of 1996)
    D               mean bidirectional radial deviation: radius of the least-squares circle of both less the nominal radius

A ballbar does not measure the position of its centre: `centred` removes the eccentricity, as ballbar software does. A reversal spike is
the largest excursion within SPIKE_WINDOW of a quadrant, relative to a parabola through the path on both sides. Lengths in m, angles in rad.

For a budget the corrected machine runs the circle, then again without one of its effects at a time:

    share = RMS over the angle, both directions, of radius(with) - radius(without)            [m]
    unknown = the same of radius(measured) - radius(corrected)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np

from twin.effects import with_effects
from twin.errors import InputError
from twin.machine.machine import Machine

DIRECTIONS = ("ccw", "cw")
"""Counter-clockwise: from the first axis to the second."""
GRID = np.arange(3600) * (2.0 * math.pi / 3600)
"""Angles at which two paths are compared [rad]."""
SPIKE_WINDOW = math.radians(8.0)
"""Half width of the window for a reversal spike around its quadrant."""
BESIDE = (math.radians(10.0), math.radians(16.0))
"""Range of angles beside a spike, on both sides, that the parabola is fitted to."""
LEAST_SWEEP = math.radians(345.0)
"""Least angle that a path must cover for the standard."""
QUADRANTS = (0, 90, 180, 270)
UNKNOWN = "unknown"
"""Name of the part of a circle that no diagnosed effect explains."""


@dataclass(frozen=True)
class CirclePath:
    """One path: polar `angle` (sample,) [rad], unwrapped and monotonic, `distance` (sample,) [m] from the nominal centre."""

    angle: np.ndarray
    distance: np.ndarray

    @property
    def direction(self) -> str:
        """'ccw' or 'cw'."""
        return "ccw" if self.angle[-1] > self.angle[0] else "cw"

    @property
    def points(self) -> np.ndarray:
        """(sample, 2) about the nominal centre."""
        return self.distance[:, None] * np.column_stack([np.cos(self.angle), np.sin(self.angle)])

    def about(self, centre: np.ndarray) -> CirclePath:
        """The same path relative to another centre (2,)."""
        x, y = (self.points - centre).T
        return CirclePath(np.unwrap(np.arctan2(y, x)), np.hypot(x, y))

    def at(self, angle: np.ndarray) -> np.ndarray:
        """Distances at angles [rad], by linear interpolation."""
        order = np.argsort(np.mod(self.angle, 2.0 * math.pi), kind="stable")
        return np.interp(np.mod(angle, 2.0 * math.pi), np.mod(self.angle, 2.0 * math.pi)[order], self.distance[order], period=2.0 * math.pi)


@dataclass(frozen=True)
class CircleTest:
    """A measured or predicted test: `axes` of the plane, nominal `radius` [m], `feed` [m/s] (NaN: unknown), paths by direction."""

    axes: tuple[str, str]
    radius: float
    feed: float
    paths: Mapping[str, CirclePath]

    @property
    def name(self) -> str:
        return "".join(self.axes)

    def centred(self) -> CircleTest:
        """The test about the least-squares centre of both paths, without eccentricity."""
        centre, _ = least_squares_circle(np.vstack([p.points for p in self.paths.values()]))
        return replace(self, paths={direction: path.about(centre) for direction, path in self.paths.items()})


def least_squares_circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius [m] of the circle with the least sum of squared radial distances to points (n, 2)."""
    from scipy.optimize import least_squares

    middle = points.mean(axis=0)
    size = float(np.hypot(*(points - middle).T).mean())

    def residual(p: np.ndarray) -> np.ndarray:
        return np.hypot(*((points - middle) / size - p[:2]).T) - p[2]

    found = least_squares(residual, [0.0, 0.0, 1.0], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    return middle + size * found[:2], size * float(found[2])


def circle_numbers(test: CircleTest) -> dict[str, float]:
    """Numbers of the standard [m]; bidirectional ones only if both directions were run."""
    numbers: dict[str, float] = {}
    for direction, path in test.paths.items():
        if abs(path.angle[-1] - path.angle[0]) < LEAST_SWEEP:
            raise InputError(
                f"ISO 230-4: the {direction} path covers {math.degrees(abs(path.angle[-1] - path.angle[0])):.0f} degrees; record a full turn"
            )
        centre, _ = least_squares_circle(path.points)
        numbers[f"G_{direction}"] = float(np.ptp(path.about(centre).distance))
    everything = np.vstack([path.points for path in test.paths.values()])
    distance = np.concatenate([path.distance for path in test.paths.values()])
    numbers["F_max"], numbers["F_min"] = float(distance.max() - test.radius), float(distance.min() - test.radius)
    centre, radius = least_squares_circle(everything)
    numbers["D"] = radius - test.radius
    numbers["centre_1"], numbers["centre_2"] = map(float, centre)
    if len(test.paths) == 2:
        numbers["G_b"] = float(np.ptp(np.hypot(*(everything - centre).T)))
        numbers["H"] = float(np.abs(test.paths["cw"].at(GRID) - test.paths["ccw"].at(GRID)).max())
    return numbers


def reversal_spikes(test: CircleTest) -> dict[str, dict[int, float]]:
    """Height [m] of the spike at each quadrant [deg] of each direction; positive outwards."""
    spikes: dict[str, dict[int, float]] = {}
    for direction, path in test.paths.items():
        spikes[direction] = {}
        for quadrant in QUADRANTS:
            off = np.mod(path.angle - math.radians(quadrant) + math.pi, 2.0 * math.pi) - math.pi
            beside = (np.abs(off) >= BESIDE[0]) & (np.abs(off) <= BESIDE[1])
            within = np.abs(off) <= SPIKE_WINDOW
            if beside.sum() < 4 or not within.any() or not (off[beside] < 0.0).any() or not (off[beside] > 0.0).any():
                continue
            smooth = np.polyfit(off[beside], path.distance[beside], 2)
            height = path.distance[within] - np.polyval(smooth, off[within])
            spikes[direction][quadrant] = float(height[np.argmax(np.abs(height))])
    return spikes


def circle_budget(
    corrected: Machine, diagnosis: Mapping[str, Any], measured: CircleTest, run: Callable[[Machine], CircleTest]
) -> tuple[CircleTest, list[dict[str, Any]]]:
    """The circle of the corrected machine, and the rows of the budget: largest share first, the unknown part last.

    A row has effect and axis, probability (None for the unknown part), share `rms_um`, and `adds_um`, its contribution to the numbers of the standard.
    `diagnosis` is the document of `twin diagnose`; `run` simulates the measured circle on a machine.
    """
    tables = [dict(table) for table in corrected.document.get("effect", [])]
    whole = run(corrected)
    try:
        probability = {(str(found["effect"]), str(found["axis"])): float(found["probability"]) for found in diagnosis.get("effects", [])}
    except (KeyError, TypeError, ValueError):
        raise InputError("diagnosis.json: an effect has no name, axis or probability; diagnose again") from None
    rows = []
    for i, table in enumerate(tables):
        without = run(with_effects(corrected, tables[:i] + tables[i + 1 :]))
        key = (str(table["name"]), str(table.get("axis", "")))
        rows.append(_row(*key, probability.get(key), whole, without))
    rows.sort(key=lambda row: -row["rms_um"])
    return whole, [*rows, _row(UNKNOWN, "", None, measured, whole)]


def _row(effect: str, axis: str, probability: float | None, a: CircleTest, b: CircleTest) -> dict[str, Any]:
    """The row of what makes one circle differ from another, over their common directions."""
    squares = [np.mean((a.paths[d].at(GRID) - b.paths[d].at(GRID)) ** 2) for d in a.paths if d in b.paths]
    rms = float(np.sqrt(np.mean(squares))) if squares else math.nan
    first, second = circle_numbers(a), circle_numbers(b)
    adds = {k: 1e6 * (first[k] - second[k]) for k in ("G_b", "G_ccw", "G_cw", "F_max", "F_min") if k in first and k in second}
    return {"effect": effect, "axis": axis, "probability": probability, "rms_um": 1e6 * rms, "adds_um": adds}
