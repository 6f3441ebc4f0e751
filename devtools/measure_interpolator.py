#!/usr/bin/env python3
"""Measures what docs/interpolator.md claims about the interpolator, and prints every figure with its bound.

    python devtools/measure_interpolator.py [--programs 200] [--blocks 100000] [--simulate]

Needs toppra, the second opinion on time optimality: the extra `versus`.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
import tempfile
import time

import numpy as np

ROOT = Path(__file__).resolve().parents[1]

from tests.builders.random_programs import check, random_program  # noqa: E402
from tests.builders.second_planner import fastest_time, only_stretch  # noqa: E402
from twin.machine.machine import load_machine  # noqa: E402
from twin.program import interpolate, interpolator, lookahead, read_program, sampling  # noqa: E402
from twin.program.stretches import great_circle_rows, stretch_of, stretches  # noqa: E402


def written(folder: Path, text: str, name: str = "part.mpf") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def moving_time(trace) -> float:  # type: ignore[no-untyped-def]
    """Time from the first to the last change of a set point."""
    moved = np.flatnonzero(np.abs(np.diff(trace.matrix("setpoint"), axis=0)).max(axis=1) > 0.0)
    return (moved[-1] + 1 - moved[0]) * trace.period


def straight_time(way: float, speed: float, acceleration: float, jerk: float) -> float:
    """Closed form of the fastest rest-to-rest motion under the three limits."""

    def ramp(v: float) -> tuple[float, float]:
        peak = min(acceleration, math.sqrt(v * jerk))
        seconds = v / peak + peak / jerk
        return seconds, v * seconds / 2.0

    if 2.0 * ramp(speed)[1] <= way:
        return 2.0 * ramp(speed)[0] + (way - 2.0 * ramp(speed)[1]) / speed
    low, high = 0.0, speed
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if 2.0 * ramp(middle)[1] < way else (low, middle)
    return 2.0 * ramp(low)[0]


def straight_moves(machine, folder: Path) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Straight moves of every axis: greatest excess of the planned time over the closed form, and of the set points in cycles."""
    planned, cycles = 0.0, 0.0
    for name in ("X", "Y", "Z", "A", "C"):
        axis = machine.axis(name)
        for way in (0.1, 1.0, 10.0, 100.0, 200.0) if axis.kind == "linear" else (0.1, 1.0, 20.0, 90.0):
            # a first move of no length keeps the rapid from being taken as the start
            text = f"G603 G60\nG1 {name}0 F1\nG0 {name}{'-' if name == 'A' else ''}{way}\n"
            program = read_program(written(folder, text), machine)
            si = way * (1e-3 if axis.kind == "linear" else math.pi / 180.0)
            best = straight_time(si, axis.max_velocity, axis.max_acceleration, axis.max_jerk)
            law = planned_time(program, machine)
            planned = max(planned, law / best - 1.0)
            cycles = max(cycles, (moving_time(interpolate(program, machine)) - law) / machine.position_cycle)
    return planned, cycles


def planned_time(program, machine) -> float:  # type: ignore[no-untyped-def]
    """Time of the law of the only moving stretch, before it is cut into cycles."""
    starts = program.starts()
    (stretch,) = [s for a, b in stretches(program) if (s := stretch_of(program, starts, a, b, great_circle_rows(program, starts)))]
    law = lookahead.plan(interpolator.way_of(program, machine, stretch))
    return float(sampling.node_times(law.nodes, law.a, law.slope)[-1])


def short_path(seed: int) -> str:
    """Text of one of the 20 short paths: corner, line-arc-line, space corner with A, five-axis corner."""
    rng = np.random.default_rng(seed)
    way, angle, feed = 10 ** rng.uniform(-0.5, 1.3), rng.uniform(0.2, 2.8), 10 ** rng.uniform(2.5, 4)
    if seed % 4 == 0:
        return f"G64\nG1 X{way:.4f} F{feed:.0f}\nG1 X{way * (1 + math.cos(angle)):.4f} Y{way * math.sin(angle):.4f}"
    if seed % 4 == 1:
        return f"G64\nG1 X{way:.4f} F{feed:.0f}\nG3 X{2 * way:.4f} Y{way:.4f} I0 J{way:.4f}\nG1 Y{2 * way:.4f}"
    if seed % 4 == 2:
        return f"G642 CTOL={10 ** rng.uniform(-2.5, -1):.4f}\nG1 X{way:.4f} Z{0.3 * way:.4f} F{feed:.0f}\nG1 Y{way:.4f}\nG1 X0 A-5"
    return (
        f"TRAORI\nG642\nG0 X10 Y0 Z140 A3=0 B3=0 C3=1\nG1 X{10 + way:.4f} Y{0.2 * way:.4f} A3=0.1 B3=-0.2 C3=1 F{feed:.0f}\n"
        f"X{10 + way:.4f} Y{way:.4f} A3=0.1 B3=-0.3 C3=1"
    )


def short_paths(machine, folder: Path, seeds=range(20)) -> list[float]:  # type: ignore[no-untyped-def]
    """Time of the set points over that of the second planner, per path."""
    ratios = []
    for seed in seeds:
        program = read_program(written(folder, short_path(seed)), machine)
        ratios.append(moving_time(interpolate(program, machine)) / fastest_time(program, machine))
    return ratios


def cam_polyline(blocks: int, feed: float, steep: bool) -> str:
    """A milled wave in XZ of short chords: flat (the feed binds), or steep in Z (its acceleration binds)."""
    x = np.linspace(0.0, 300.0, blocks + 1)
    height = 12.0 * np.sin(2 * np.pi * x / 40.0) if steep else 4.0 * np.sin(2 * np.pi * x / 150.0)
    lines = [f"X{a - 150:.4f} Z{b:.4f}" for a, b in zip(x, height)]
    return "\n".join(["G710 G90 G642", "CYCLE832(0.01,3)", "G0 " + lines[0], f"G1 F{feed:.0f}", *lines[1:], "M30"])


def over_toppra(machine, folder: Path, blocks: int, feed: float, steep: bool) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Time over that of toppra on the same path with the same limits but no jerk limit; share of the time at feed or acceleration."""
    import toppra
    import toppra.algorithm
    import toppra.constraint

    program = read_program(written(folder, cam_polyline(blocks, feed, steep)), machine)
    trace = interpolate(program, machine)
    spline, *_ = only_stretch(program, machine)
    u = np.unique(np.concatenate([spline.t, np.linspace(0.0, spline.t[-1], 4000)]))
    piece = np.clip(np.searchsorted(spline.t, u, side="right") - 1, 0, len(spline.t) - 2)
    x = (u - spline.t[piece])[:, None]
    points = sum(spline.c[piece, k] * x**k for k in range(4))[:, [0, 2]]
    limits = interpolator.limits_of(machine)
    path = toppra.SplineInterpolator(u, points)
    slope = path(u, 1)
    # the feed along the path as a speed limit of each axis in proportion to its share
    speed = np.minimum(limits.speed[[0, 2]], np.maximum(np.abs(slope), 1e-9) * feed / 60e3 / np.linalg.norm(slope, axis=1)[:, None])

    def limit(s: float) -> np.ndarray:
        bound = np.array([np.interp(s, u, speed[:, k]) for k in range(2)])
        return np.column_stack([-bound, bound])

    constraints = [
        toppra.constraint.JointVelocityConstraintVarying(limit),
        toppra.constraint.JointAccelerationConstraint(np.column_stack([-limits.acceleration[[0, 2]], limits.acceleration[[0, 2]]])),
    ]
    toppra.setup_logging("ERROR")
    best = toppra.algorithm.TOPPRA(constraints, path, gridpoints=u, parametrizer="ParametrizeConstAccel").compute_trajectory(0, 0)
    axes = trace.matrix("setpoint", ("X", "Z"))
    acceleration = (np.abs(np.diff(axes, 2, axis=0)) / trace.period**2 / limits.acceleration[[0, 2]]).max(axis=1)
    at_feed = trace.get("program", "path_speed")[1:-1] > 0.99 * feed / 60e3
    return moving_time(trace) / best.duration, float(np.mean(at_feed | (acceleration > 0.97)))


def long_program(blocks: int, five_axes: bool = True) -> str:
    """A generated program: the tip, and with five axes the tool axis, too, wander over the part in short blocks."""
    x, turns = np.linspace(0.0, 1.0, blocks), blocks / 10_000
    tip = np.c_[60 * np.cos(6 * np.pi * turns * x), 36 * np.sin(6 * np.pi * turns * x), 130 + 8 * np.sin(20 * np.pi * turns * x)]
    i, j = 0.35 * np.cos(6 * np.pi * turns * x + 0.5), 0.35 * np.sin(4 * np.pi * turns * x) - 0.3
    if not five_axes:
        lines = [f"N{10 * k} X{x:.4f} Y{y:.4f} Z{z:.4f}" for k, (x, y, z) in enumerate(tip)]
        return "\n".join(["G710 G90 FFWON SOFT", "CYCLE832(0.02,3)", "G0 " + lines[0].split(" ", 1)[1], "G1 F6000", *lines[1:], "M30"])
    rows = np.c_[tip, i, j, np.sqrt(1 - i * i - j * j)]
    lines = ["X{:.4f} Y{:.4f} Z{:.4f} A3={:.7f} B3={:.7f} C3={:.7f}".format(*row) for row in rows]
    head = ["G710 G90 FFWON SOFT", "TRAORI", "CYCLE832(0.02,3)", "G0 " + lines[0], "G1 F6000"]
    return "\n".join([*head, *(f"N{10 * k} {line}" for k, line in enumerate(lines[1:], 1)), "M30"])


def throughput(machine, folder: Path, blocks: int, simulate: bool, five_axes: bool = True) -> None:  # type: ignore[no-untyped-def]
    """Blocks per second of processor time of reading plus interpolation, after one small program that compiles.

    Windows are planned on several cores: what they share is the time on the clock against the processor time.
    """
    import resource  # not on Windows

    small = written(folder, long_program(500, five_axes), "small.mpf")
    interpolate(read_program(small, machine), machine)
    path = written(folder, long_program(blocks, five_axes), "long.mpf")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start, clock = time.process_time(), time.perf_counter()
    program = read_program(path, machine)
    read = time.process_time() - start
    trace = interpolate(program, machine)
    total, clock = time.process_time() - start, time.perf_counter() - clock
    memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    print(
        f"{blocks} blocks on {5 if five_axes else 3} axes, {path.stat().st_size / 1e6:.1f} MB: processor time: read {read:.2f} s, interpolated {total - read:.2f} s for"
        f" {trace.time[-1]:.0f} s of motion; "
        f"{blocks / total:.0f} blocks per second of processor time (bound 20000), {blocks / clock:.0f} by the clock, {memory:.0f} MB more memory"
    )
    if simulate:
        from twin.simulation.run import simulate as run
        from twin.simulation.setpoints import setpoints_of

        start = time.perf_counter()
        run(machine, setpoints_of(trace, machine))
        print(f"simulated in {time.perf_counter() - start:.1f} s, {trace.time[-1] / (time.perf_counter() - start):.1f} times real time")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--programs", type=int, default=200)
    parser.add_argument("--blocks", type=int, default=100_000)
    parser.add_argument("--simulate", action="store_true", help="run the long program through the drives too")
    options = parser.parse_args()
    machine = load_machine()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        findings = [check(random_program(seed), folder, machine) for seed in range(options.programs)]
        print(f"{len(findings)} random programs: limits {max(f.limits for f in findings):.5f} (bound 1.001), ", end="")
        print(f"block ends {max(f.block_end for f in findings):.3f} tolerances (bound 1), ", end="")
        print(f"jump of the path to its 2nd derivative {max(f.jump for f in findings):.1e}, feed {max(f.feed for f in findings):.5f}")
        planned, cycles = straight_moves(machine, folder)
        print(f"straight moves: {planned * 100:.2f} % above the closed form (bound 1), set points end {cycles:.2f} position cycles later")
        ratios = short_paths(machine, folder)
        print(f"20 short paths: time over second planner {min(ratios):.4f} .. {max(ratios):.4f} (bound 1.10)")
        # the jerk limits of X and Y are so low that the acceleration seldom binds on this machine: a stiffer one shows it
        stiff = machine
        for axis in machine.axes:
            stiff = stiff.with_axis(axis.name, max_jerk=20.0 * axis.max_jerk)
        cases = (
            ("feed binds", machine, 3000.0, False),
            ("acceleration binds (20 times the jerk limits)", stiff, 12000.0, True),
            ("steep, jerk binds", machine, 12000.0, True),
        )
        for title, which, feed, steep in cases:
            ratio, share = over_toppra(which, folder, 10_000, feed, steep)
            print(
                f"10000-block polyline, {title}: time over toppra {ratio:.4f} (bound 1.10), "
                f"at feed or acceleration {share * 100:.0f} % of the time"
            )
        throughput(machine, folder, options.blocks, options.simulate)
        throughput(machine, folder, options.blocks, False, five_axes=False)


if __name__ == "__main__":
    main()
