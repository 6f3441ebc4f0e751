"""Figures of docs/results.md and docs/paper.md: speed against plain numpy, the paper's parts, and the influence of their geometry.

    python devtools/measure_surface.py                    everything, about two minutes
    python devtools/measure_surface.py --only speed       kernels alone; --only parts, --only geometry

Prints processor time of one core, which other work on the computer does not change, and wall time.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import sys
import tempfile
import time

import numpy as np

from examples.parts.paper_parts import PARTS, TangentPlanes, VerticalCorner
from twin.machine.machine import Machine, load_machine
from twin.simulation.summary import table
from twin.surface.height_rays import HeightRays, grid_rays
from twin.surface.levels import levels_of_program
from twin.surface.machining import machine_part, report_of
from twin.surface.part import read_part
from twin.surface.removal import cut
from twin.surface.steps import Steps, steps_between
from twin.surface.tools import Tool, end_mill, revolution

WANTED_RATE = 20.0
"""Million ray-step tests per second and core."""


def patch(spacing: float = 2e-5) -> HeightRays:
    """4 mm x 2 mm of a plane."""
    u, v = np.arange(0.0, 4e-3, spacing), np.arange(0.0, 2e-3, spacing)
    point = np.stack([*np.meshgrid(u, v), np.zeros((len(v), len(u)))], axis=-1)
    return grid_rays("plane", point, np.broadcast_to([0.0, 0.0, 1.0], point.shape), u, v, 5e-5, 1e-3)


def raster(tool: Tool, turning: bool, passes: int = 16) -> Steps:
    """Parallel passes 0.25 mm apart over the patch, with an upright axis or one that sways by 3 degrees."""
    tips = [np.column_stack([np.linspace(-2e-3, 6e-3, 40), np.full(40, -1e-3 + k * 0.25e-3), np.zeros(40)]) for k in range(passes)]
    lifted = [np.array([[6e-3, t[0, 1], 2e-3], [-2e-3, t[0, 1] + 0.25e-3, 2e-3]]) for t in tips]
    tip = np.concatenate([np.vstack(pair) for pair in zip(tips, lifted)])
    sway = 0.05 * np.sin(0.2 * np.arange(len(tip))) if turning else np.zeros(len(tip))
    return steps_between(tip, np.column_stack([sway, 0.0 * sway, np.ones(len(tip))]), tool.reach)


def plain_numpy(rays: HeightRays, steps: Steps, radius: float) -> np.ndarray:
    """Reference in plain numpy: every step against all rays, ball only, no culling; heights (ray,)."""
    height = rays.height.copy()
    n = rays.direction
    for tip, way, axis in zip(steps.tip, steps.way, steps.axis):
        y = rays.point - tip - radius * axis
        a, b, g = way @ way, -(n @ way), -(y @ way)
        e, f = np.einsum("ij,ij->i", y, n), np.einsum("ij,ij->i", y, y) - radius**2
        with np.errstate(invalid="ignore", divide="ignore"):
            cc, ee = 1.0 - b * b / a, e - b * g / a
            t = (-ee - np.sqrt(ee * ee - cc * (f - g * g / a))) / cc
            s = np.clip(np.where(np.isfinite(t), -(b * t + g) / a, 0.0), 0.0, 1.0)
            es = e + s * b
            t = -es - np.sqrt(es * es - (f + s * (2.0 * g + s * a)))
        np.fmin(height, np.where(np.isfinite(t), t, np.inf), out=height)
    return height


def measure_speed() -> int:
    """Tests per second of every tool, and of numpy on the same job."""
    rays, rows, missed = patch(), [], 0
    cone = revolution([(0.0, 0.0), (3e-3, 1e-3), (5e-3, 8e-3), (5e-3, 0.04)], name="cone")
    for tool in (end_mill(10e-3, 5e-3), end_mill(10e-3, 0.0), end_mill(10e-3, 1e-3), cone):
        for turning in (False, True):
            steps = raster(tool, turning, 2 if turning else 16)
            cut(rays, steps_between(steps.tip[:3], steps.axis[:3], tool.reach), tool, threads=1)  # compiled
            cpu, wall = time.process_time(), time.perf_counter()
            _, (pairs, tests) = cut(rays, steps, tool, threads=1)
            cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
            rate = tests / cpu / 1e6
            missed += rate < WANTED_RATE
            rows.append(
                [tool.name, "turning" if turning else "straight", f"{pairs / 1e6:.0f}", f"{tests / 1e6:.1f}",
                 f"{cpu:.2f}", f"{wall:.2f}", f"{rate:.1f}",
                 f"{pairs / cpu / 1e6:.0f}", "" if rate >= WANTED_RATE else "below"]
            )  # fmt: skip
    print(f"ray-step tests, one thread, {len(rays)} rays; tested: after culling; target {WANTED_RATE:g} million per second and core")
    print(table(["tool", "axis", "pairs M", "tested M", "cpu s", "wall s", "tested M/s", "pairs M/s", ""], rows, left=2))
    # comparison with numpy: the ball alone
    ball = replace(end_mill(10e-3, 5e-3), elements=end_mill(10e-3, 5e-3).elements[:1])
    steps = raster(ball, False)
    cpu = time.process_time()
    fast, (pairs, _) = cut(rays, steps, ball, threads=1)
    cpu, began = time.process_time() - cpu, time.process_time()
    slow = plain_numpy(rays, steps, 5e-3)
    numpy_cpu = time.process_time() - began
    off = np.abs(fast.height - slow).max()
    print(
        f"\nside by side, ball-end, {len(rays)} rays x {len(steps)} steps: compiled {cpu:.3f} s, "
        f"plain numpy {numpy_cpu:.2f} s, {numpy_cpu / cpu:.0f} times; "
        f"numpy {pairs / numpy_cpu / 1e6:.1f} million pairs per second; largest difference {off * 1e6:.1e} um"
    )
    return missed


def measure_parts(only: list[str], machine: Machine) -> None:
    """The paper's parts at every level, with feedforward on and off, and the times."""
    folder = Path(__file__).resolve().parent.parent / "examples" / "parts"
    rows, rotary = [], []
    for name in only:
        part = read_part(folder / f"{name}.toml")
        began = time.perf_counter()
        levels = levels_of_program(
            folder / f"{name}.mpf", machine, part.tool, ("programmed", "commanded", "followed"), ("velocity+torque", "off")
        )
        simulated = time.perf_counter() - began
        machining = machine_part(part, levels)
        cpu = time.process_time()
        machine_part(part, levels[-1:])
        cpu = time.process_time() - cpu
        rays = len(machining.cuts[0].finest)
        pairs, tests = machining.work
        print(
            f"{part.name}: {rays} rays in the zone, {len(levels[-1].path)} poses: "
            f"all {len(levels)} levels {machining.seconds:.1f} s wall, one level {cpu:.1f} s cpu "
            f"({tests / 1e6:.0f} of {pairs / 1e6:.0f} million pairs tested); "
            f"interpolation and two runs of the machine {simulated:.1f} s"
        )
        for one in machining.cuts:
            r = report_of(machining, one)
            cells = [r.get(f"against_programmed_{k}_um") for k in ("slow", "fast")]
            rows.append(
                [
                    part.name,
                    one.level.label,
                    *(f"{c['min']:.2f} .. {c['max']:.2f}" if c else "-" for c in cells),
                    f"{r.get('scallop_um', 0):.2f}",
                ]
            )
            rotary += [
                [
                    part.name,
                    one.level.label,
                    axis,
                    f"{one.level.errors[f'{axis}_deviation_rms_deg']:.5f}",
                    f"{one.level.errors[f'{axis}_deviation_deg']:.5f}",
                ]
                for axis in ("A", "C")
                if f"{axis}_deviation_deg" in one.level.errors
            ]
    print("\nagainst the programmed cut [um]; the paper: part 1 about 20 too deep at 10 m/min; part 2 about 5 slow, about 30 fast")
    print(table(["part", "level", "slow", "fast", "scallop"], rows, left=2))
    if rotary:
        print("\nrotary axes against their set points, without the constant delay [deg]; the paper: about 0.001")
        print(table(["part", "level", "axis", "RMS", "largest"], rotary, left=3))


def measure_geometry() -> None:
    """The mark as a function of dimensions that the paper does not give: radius, slope, corner, rounding."""
    machine = load_machine()
    shapes: list[tuple[str, TangentPlanes | VerticalCorner]] = []
    base = TangentPlanes(passes=0, tolerance=0.005)
    shapes += [(f"part 1: radius {r:g} mm, slope 20 deg", replace(base, radius=r)) for r in (5.0, 10.0, 20.0, 40.0, 80.0)]
    shapes += [(f"part 1: radius 20 mm, slope {s:g} deg", replace(base, slope_deg=s)) for s in (5.0, 10.0, 30.0)]
    shapes += [(f"part 1: radius 20 mm, rounding {t * 1e3:g} um", replace(base, tolerance=t)) for t in (0.001, 0.0048, 0.0052, 0.02)]
    shapes += [(f"part 2: outer corner {a:g} deg", VerticalCorner(turn_deg=a, tolerance=0.005)) for a in (45.0, 90.0, 120.0)]
    shapes += [
        ("part 2: outer corner 90 deg, rounding 1 um", VerticalCorner(tolerance=0.001)),
        ("part 2: inner corner 90 deg", VerticalCorner(inner=True, tolerance=0.005)),
    ]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for text, shape in shapes:
            program, file = Path(folder) / "part.mpf", Path(folder) / "part.toml"
            program.write_text(shape.program(), encoding="utf-8")
            file.write_text(shape.part(zone_um=40.0), encoding="utf-8")
            part = read_part(file)
            levels = levels_of_program(program, machine, part.tool, ("programmed", "commanded", "followed"), ("velocity+torque", "off"))
            machining = machine_part(part, levels)
            marks = [report_of(machining, one)["mark"] for one in machining.cuts[1:]]
            fast = next(one for one in machining.cuts if one.level.feedforward == "off")
            feed = np.nanmin(np.where(fast.feed > fast.surface.zone_feed, fast.feed, np.nan)) * 60.0
            rows.append([text, *(f"{m['depth_um']:.2f}" for m in marks), *(f"{m['left_um']:.2f}" for m in marks), f"{feed:.1f}"])
    print("\nmark against the programmed cut [um]: too deep, and left; c: commanded, on, off: followed with and without feedforward")
    print(table(["geometry", "c deep", "on deep", "off deep", "c left", "on left", "off left", "lowest fast feed m/min"], rows, left=1))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("speed", "parts", "geometry"))
    parser.add_argument("--machine", metavar="FILE", help="--only parts: on this machine")
    parser.add_argument("--part", action="append", choices=list(PARTS), help="only this part (may be given several times)")
    args = parser.parse_args()
    if args.only in (None, "speed"):
        measure_speed()
    if args.only in (None, "parts"):
        measure_parts(args.part or list(PARTS), load_machine(args.machine))
    if args.only in (None, "geometry"):
        measure_geometry()
    return 0


if __name__ == "__main__":
    sys.exit(main())
