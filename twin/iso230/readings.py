"""Input of the evaluation: tables of readings and of ballbars, the standstills and the circles of a recorded run.

direction,position,cycle,target_mm,measured_mm      ISO 230-2; direction forward | backward; target_deg, measured_deg for a rotary axis
direction,angle_deg,deviation_um                    ISO 230-4; direction cw | ccw; ballbar export, radius minus nominal radius
"""

from collections.abc import Iterator
import csv
from itertools import combinations
import math
from pathlib import Path

import numpy as np

from twin.errors import InputError, nearest, no_file
from twin.iso230.circles import DIRECTIONS, LEAST_SWEEP, CirclePath, CircleTest, least_squares_circle
from twin.iso230.positioning import WAYS, Readings
from twin.recordings.trace import Trace

SHORTEST_REST = 0.2
"""Shortest standstill that counts as a measurement [s]."""
SETTLED = 0.5
"""Share of a standstill, at its end, that is averaged."""
SAME_TARGET = 1e-6
"""Targets closer than this are the same [m or rad]."""

LARGEST = 1e9
"""Largest reading in um, mm or degrees."""

ROUNDNESS, ROUNDING = 1e-4, 2e-6
"""Set points that deviate by less belong to a circle: share of the radius, and tolerance of the interpolator [m]."""
RADIAL = 0.05
"""Above this share of the speed along the radius a set point belongs to a lead-in."""
SMALLEST_RADIUS = 1e-3
"""Smallest radius [m]; smaller circles are corners."""
PLANES = (("X", "Y"), ("Y", "Z"), ("Z", "X"))
"""Planes in the order that defines counter-clockwise: ISO 841."""


def is_table(path: Path) -> bool:
    """True for a CSV table of readings, False for a trace."""
    if path.suffix.lower() != ".csv":
        return False
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        return file.readline().split(",")[0].strip().strip('"').lower() == "direction"


def read_positions(path: Path) -> tuple[Readings, str]:
    """Readings of one axis from a table, in m or rad, and the kind of the axis ('linear', 'rotary')."""
    rows = _rows(path)
    unit = "deg" if "target_deg" in rows[0] else "mm"
    needed = ("direction", "position", "cycle", f"target_{unit}", f"measured_{unit}")
    factor = 1e-3 if unit == "mm" else math.pi / 180.0
    found: dict[tuple[str, float], list[float]] = {}
    for direction, target, measured in _read(rows, needed, WAYS, path):
        found.setdefault((direction, target), []).append((measured - target) * factor)
    return _readings(found, factor, str(path)), "linear" if unit == "mm" else "rotary"


def read_ballbar(path: Path, radius: float, feed: float, axes: tuple[str, str]) -> CircleTest:
    """A circle test from a ballbar table, with `radius` [m] and `feed` [m/s] of the program."""
    paths: dict[str, list[tuple[float, float]]] = {}
    for direction, angle, deviation in _read(_rows(path), ("direction", "angle_deg", "deviation_um"), DIRECTIONS, path):
        paths.setdefault(direction, []).append((math.radians(angle), radius + deviation * 1e-6))
    out = {}
    for direction, points in paths.items():
        angle, distance = np.array(points).T
        angle = np.unwrap(angle)
        if len(angle) < 16:
            raise InputError(f"{path}: {len(angle)} readings {direction}; give at least 16 around the circle")
        if (direction == "ccw") != (angle[-1] > angle[0]):
            raise InputError(
                f"{path}: the angles of the {direction} path run the other way; correct the direction or the order of its lines"
            )
        out[direction] = CirclePath(angle, distance)
    return CircleTest(axes, radius, feed, out)


def positions_of_trace(trace: Trace, axis: str, where: str) -> Readings:
    """Readings at the standstills of an axis that are approached from both sides, [m] or [rad]."""
    if not trace.has(axis, "position"):
        raise InputError(f"{where}: no {axis}.position column; record the scale")
    setpoint, position = trace.get(axis, "setpoint"), trace.get(axis, "position")
    still = np.abs(np.diff(setpoint, prepend=setpoint[0])) < 1e-9
    edges = np.flatnonzero(np.diff(still.astype(int))) + 1
    found: dict[tuple[str, float], list[float]] = {}
    targets: list[float] = []
    for rows in np.split(np.arange(len(still)), edges):
        if not still[rows[0]] or len(rows) * trace.period < SHORTEST_REST or rows[0] == 0:
            continue
        target = float(setpoint[rows[-1]])
        direction = "forward" if target > setpoint[max(rows[0] - 2, 0)] else "backward"
        near = next((t for t in targets if abs(t - target) < SAME_TARGET), None)
        if near is None:
            targets.append(near := target)
        settled = rows[int(len(rows) * (1.0 - SETTLED)) :]
        found.setdefault((direction, near), []).append(float(position[settled].mean() - target))
    both = {t for t in targets if min(len(found.get((way, t), [])) for way in WAYS) >= 2}
    if len(both) < 2:
        raise InputError(
            f"{where}: axis {axis} has {len(both)} standstills that it approaches twice from both sides; "
            f"ISO 230-2 needs at least 2 (better 5, five times), with {SHORTEST_REST:g} s of rest"
        )
    return _readings({key: values for key, values in found.items() if key[1] in both}, 1.0, where)


def _readings(found: dict[tuple[str, float], list[float]], factor: float, where: str) -> Readings:
    targets = sorted({target for _, target in found})
    columns = {}
    for direction in WAYS:
        counts = {len(found.get((direction, target), [])) for target in targets}
        if 0 in counts:
            raise InputError(f"{where}: not every target has a {direction} reading; measure each from both sides")
        # with unequal counts only the first cycles, which all positions have
        columns[direction] = np.array([found[direction, target][: min(counts)] for target in targets])
    return Readings(np.array(targets) * factor, columns["forward"], columns["backward"])


def circles_of_trace(trace: Trace, where: str = "trace") -> list[CircleTest]:
    """Circles in a recorded run, one per plane: two linear axes whose set points run a full circle, in one or both directions.

    Raises InputError if no two axes run a circle, or if a position is missing.
    """
    linear = [a for a in trace.axes if trace.kinds.get(a) == "linear" and trace.moves(a)]
    planes = [p for p in PLANES if set(p) <= set(linear)]
    planes += [p for p in combinations(linear, 2) if not any(set(p) == set(q) for q in PLANES)]
    found = [test for plane in planes if (test := _circle(trace, plane, where)) is not None]
    if not found:
        raise InputError(
            f"{where}: no two linear axes run a full circle; give a run with a circle in both directions (G2 and G3), or a table of readings"
        )
    return found


def _circle(trace: Trace, plane: tuple[str, str], where: str) -> CircleTest | None:
    commanded = np.column_stack([trace.get(axis, "setpoint") for axis in plane])
    velocity = np.gradient(commanded, trace.period, axis=0)
    speed = np.hypot(*velocity.T)
    moving = speed > 1e-6
    if moving.sum() < 16:
        return None
    # exclude lead-ins by repeated fits
    inside = moving
    for _ in range(20):
        centre, radius = least_squares_circle(commanded[inside][:: max(1, int(inside.sum()) // 2000)])
        from_centre = commanded - centre
        near = np.abs(np.hypot(*from_centre.T) - radius) < ROUNDNESS * radius + ROUNDING
        along_radius = np.abs(np.einsum("ij,ij->i", velocity, from_centre)) < RADIAL * speed * radius
        before, inside = inside, moving & near & along_radius
        if inside.sum() < 16:
            return None
        if np.array_equal(before, inside):
            break
    if radius < SMALLEST_RADIUS:
        return None
    for axis in plane:
        if not trace.has(axis, "position"):
            raise InputError(f"{where}: no {axis}.position column for the circle in {''.join(plane)}; record the scale")
    measured = np.column_stack([trace.get(axis, "position") for axis in plane])
    paths: dict[str, CirclePath] = {}
    speeds = []
    for rows in _stretches(inside, commanded, centre):
        x, y = (measured[rows] - centre).T
        path = CirclePath(np.unwrap(np.arctan2(y, x)), np.hypot(x, y))
        if abs(path.angle[-1] - path.angle[0]) >= LEAST_SWEEP:
            paths[path.direction] = _middle_revolution(path)
            speeds.append(float(np.median(np.hypot(*np.gradient(commanded[rows], trace.period, axis=0).T))))
    return CircleTest(plane, float(radius), float(np.median(speeds)), paths) if paths else None


def _stretches(inside: np.ndarray, commanded: np.ndarray, centre: np.ndarray) -> list[np.ndarray]:
    """Rows of each stretch on the circle with one direction of rotation."""
    angle = np.unwrap(np.arctan2(*(commanded - centre).T[::-1]))
    turn = np.sign(np.gradient(angle)) * inside
    edges = np.flatnonzero(np.diff(turn)) + 1
    return [rows for rows in np.split(np.arange(len(turn)), edges) if len(rows) > 16 and turn[rows[0]] != 0]


def _middle_revolution(path: CirclePath) -> CirclePath:
    """The middle revolution of a longer path; its ends contain start and stop."""
    swept = np.abs(path.angle - path.angle[0])
    spare = swept[-1] - 2.0 * math.pi
    if spare <= 0.0:
        return path
    keep = (swept >= spare / 2.0) & (swept <= spare / 2.0 + 2.0 * math.pi)
    return CirclePath(path.angle[keep], path.distance[keep])


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.is_file():
        raise no_file(path, "give a table of readings (.csv), a trace, a run or a campaign")
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [{(k or "").strip().lower(): v for k, v in row.items()} for row in csv.DictReader(file)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: not a readable table ({error}); save it as CSV in UTF-8") from None
    if not rows:
        raise InputError(f"{path}: the table is empty; give one reading a line below the heading")
    return rows


def _read(rows: list[dict[str, str]], needed: tuple[str, ...], ways: tuple[str, str], path: Path) -> Iterator[tuple[str, float, float]]:
    """Direction, one of `ways`, and the numbers of the last two columns of a table with the columns `needed`, line by line."""
    for name in needed:
        if name not in rows[0]:
            raise InputError(f"{path}: no column '{name}'; {nearest(name, [n for n in rows[0] if n])}; a table has {','.join(needed)}")
    for line, row in enumerate(rows, start=2):
        direction, numbers = str(row["direction"]).strip().lower(), []
        if direction not in ways:
            raise InputError(f"{path}: line {line}: direction '{row['direction']}'; write {' or '.join(sorted(ways, key=len))}")
        for name in needed[-2:]:
            try:
                numbers.append(float(row[name]))
            except (TypeError, ValueError):
                raise InputError(f"{path}: line {line}: {name} holds {row[name]!r}, which is not a number; correct it") from None
            if not abs(numbers[-1]) < LARGEST:
                raise InputError(f"{path}: line {line}: {name} = {numbers[-1]:g}: impossible reading; correct or remove the line")
        yield direction, numbers[0], numbers[1]
