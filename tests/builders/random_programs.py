"""Random part programs (lines, arcs and helices, five-axis and plane polylines) and what to check on their set points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.geometry.tool_path import nearest_along
from twin.machine.machine import Machine
from twin.program import blend, interpolate, interpolator, read_program
from twin.program.stretches import great_circle_rows, stretch_of, stretches

PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}


def random_program(seed: int) -> str:
    """The text of a random program."""
    rng = np.random.default_rng(seed)
    adis = f"G641 ADIS={rng.uniform(0.02, 1):.3f} ADISPOS=0.5"
    cycle = f"CYCLE832({10 ** rng.uniform(-3, -1):.4f},3)"
    out = ["G710 G90 G17 SOFT FFWON G603", str(rng.choice(["G64", "G642", adis, cycle, "G60"]))]
    out += (_shapes, _shapes, _five_axis, _polyline)[rng.integers(4)](rng)
    return "\n".join([*out, "M30", ""])


def _shapes(rng: np.random.Generator) -> list[str]:
    out, at = ["G0 X0 Y0 Z0 A0 C0 F3000"], np.zeros(3)
    with_arcs = rng.random() < 0.5
    for _ in range(rng.integers(2, 12)):
        kind, feed = rng.random(), 10 ** rng.uniform(2, 4.3)
        if kind < 0.1:
            out.append(str(rng.choice(["G60", "G64", "G642", f"G9 G1 X{at[0]:.3f}"])))
        if with_arcs and kind < 0.5:
            plane = int(rng.integers(17, 20))
            a, b, c = PLANES[plane]
            radius, begin, turn = 10 ** rng.uniform(-0.5, 1.5), rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 2 * np.pi)
            centre, end = at.copy(), at.copy()
            centre[[a, b]] += radius * np.cos(begin), radius * np.sin(begin)
            end[[a, b]] = centre[[a, b]] - radius * np.array([np.cos(begin + turn), np.sin(begin + turn)])
            end[c] += rng.uniform(-5, 5) if rng.random() < 0.3 else 0.0
            if np.abs(end).max() > 150:
                continue
            middle = f"{'IJK'[a]}{centre[a] - at[a]:.4f} {'IJK'[b]}{centre[b] - at[b]:.4f}"
            out.append(f"G{plane} G3 X{end[0]:.4f} Y{end[1]:.4f} Z{end[2]:.4f} {middle} F{feed:.0f}")
            at = np.round(end, 4)
        elif kind < 0.85:
            way = rng.normal(size=3)
            end = np.clip(at + way / np.linalg.norm(way) * 10 ** rng.uniform(-1, 1.5), -150, 150)
            out.append(f"G{rng.choice([0, 1, 1, 1])} X{end[0]:.4f} Y{end[1]:.4f} Z{end[2]:.4f} F{feed:.0f}")
            at = np.round(end, 4)
        else:
            out.append(f"G1 A{rng.uniform(-60, 10):.3f} C{rng.uniform(-90, 90):.3f} F{feed:.0f}")
    return [*out, "G1 X1 Y1 Z1 F1000"]


def _five_axis(rng: np.random.Generator) -> list[str]:
    count, chord = rng.integers(20, 200), 10 ** rng.uniform(-1.3, 0.5)
    t, phase = chord * np.arange(count), rng.uniform(0, 6, 6)
    rate = np.minimum(0.03, 0.01 * rng.random(6))
    tip = np.c_[30 * np.sin(rate[0] * t + phase[0]), 30 * np.sin(rate[1] * t + phase[1]), 140 + 10 * np.sin(rate[2] * t)]
    i, j = 0.3 * np.sin(rate[3] * t + phase[3]), -0.35 + 0.3 * np.sin(rate[4] * t + phase[4])
    rows = np.c_[tip, i, j, np.sqrt(1 - i * i - j * j)]
    blocks = ["X{:.4f} Y{:.4f} Z{:.4f} A3={:.6f} B3={:.6f} C3={:.6f}".format(*row) for row in rows]
    return ["TRAORI", "G0 " + blocks[0], f"G1 F{10 ** rng.uniform(2.5, 4):.0f}", *blocks[1:]]


def _polyline(rng: np.random.Generator) -> list[str]:
    count, chord = rng.integers(20, 300), 10 ** rng.uniform(-1.3, 0.5)
    turn = np.cumsum(rng.normal(0, 10 ** rng.uniform(-3, 0), count))
    points = np.cumsum(chord * np.c_[np.cos(turn), np.sin(turn), 0.1 * np.sin(3 * turn)], axis=0)
    points *= min(1.0, 150 / np.abs(points).max())
    blocks = ["X{:.4f} Y{:.4f} Z{:.4f}".format(*row) for row in points]
    return ["G0 " + blocks[0], f"G1 F{10 ** rng.uniform(2.5, 4.2):.0f}", *blocks[1:]]


@dataclass(frozen=True)
class Finding:
    """Worst of a program: set points over limits (1: at the limit), block ends in tolerances, jumps of the second derivative, feed."""

    limits: float
    block_end: float
    jump: float
    feed: float


def check(text: str, folder: Path, machine: Machine) -> Finding:
    """Interpolate a program and measure its set points and its path."""
    path = folder / "random.mpf"
    path.write_text(text)
    program = read_program(path, machine)
    trace = interpolate(program, machine)
    axes, period = trace.matrix("setpoint", program.kinematics.names), trace.period
    limits = interpolator.limits_of(machine)
    over = max(float((np.abs(np.diff(axes, k, axis=0)).max(axis=0) / period**k / limit).max()) for k, limit in enumerate(limits, 1))
    feed, speed = trace.get("program", "feed"), trace.get("program", "path_speed")
    reached = float(np.max(speed[feed > 0] / feed[feed > 0], initial=0.0))
    starts, ends, jump = program.starts(), 0.0, 0.0
    circles = great_circle_rows(program, starts)
    for first, last in stretches(program):
        stretch = stretch_of(program, starts, first, last, circles)
        if stretch is None:
            continue
        spline = interpolator.way_of(program, machine, stretch).spline
        ends = max(ends, _block_ends(stretch, spline))
        h, c = np.diff(spline.t)[:, None], spline.c
        for power in range(3):
            end = [sum(_falling(k, power) * c[:-1, k] * h[:-1] ** (k - power) for k in range(power, 4))]
            scale = h[1:] ** max(0, power - 1) if power else 1e3
            jump = max(jump, float(np.abs((end[0] - _falling(power, power) * c[1:, power]) * scale).max(initial=0.0)))
    return Finding(over, ends, jump, reached)


def _falling(k: int, power: int) -> int:
    """k (k - 1) .. (k - power + 1)."""
    out = 1
    for i in range(power):
        out *= k - i
    return out


def _block_ends(stretch, spline: blend.Spline) -> float:  # type: ignore[no-untyped-def]
    """Greatest distance of a block end from the path, in tolerances; the path is taken as a fine polyline."""
    share = np.linspace(0.0, 1.0, 17)[:-1]
    x = np.diff(spline.t)[:, None] * share
    fine = sum(spline.c[:, k, None, :] * x[..., None] ** k for k in range(4)).reshape(-1, 5)
    length = np.append((spline.t[:-1, None] + x).ravel(), spline.t[-1])
    e = stretch.elements
    ends = e.base + e.step
    ends[:, :3] += np.cos(e.angle)[:, None] * e.radius1 + np.sin(e.angle)[:, None] * e.radius2
    fine, joints = np.vstack([fine, ends[-1]]), ends[:-1]
    if not len(joints):
        return 0.0
    reach = 8.0 * np.diff(spline.t).max()
    off, _ = nearest_along(joints[:, :3], fine[:, :3], length, stretch.elements.u[1:-1], reach, reach)
    return float((off / stretch.tolerance[1:-1]).max())
