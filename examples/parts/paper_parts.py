"""The three parts of the paper as programs and part files; dimensions that the paper does not give are parameters.

From the paper: d10 ball-end, parallel XZ planes 0.25 mm apart, 0.1 m/min, one pass at 10 m/min, allowance 0.05 mm (part 1); d10 cylinder,
10 mm deep slow pass, then the same path 5 mm higher at high feed (part 2); a five-axis path with large rotations (part 3).
Chosen: radius 20 mm and planes at 20 degrees (part 1); an outer corner of 90 degrees with the centre on an arc, legs of 60 mm, 10 m/min
(part 2); a spiral over a dome of radius 40 mm, 200 degrees of C and 40 of A, 4 m/min, ball-end d10 (part 3); the corner rounding of each.
Slow passes are programmed only around the place of interest; tip positions are in the part frame (TRAORI).
"""

from __future__ import annotations

from dataclasses import dataclass
import math

BALL = 5.0
"""Radius of all three tools [mm]."""
HEAD = "G17 G71 G90 G94 G642 SOFT\nTRAORI\nORIWKS\n"


@dataclass(frozen=True)
class TangentPlanes:
    """Part 1: two planes and the cylinder portion between them; lengths in mm, feeds in mm/min."""

    radius: float = 20.0
    slope_deg: float = 20.0
    plane: float = 60.0
    slow_plane: float = 8.0
    pitch: float = 0.25
    passes: int = 12
    slow_feed: float = 100.0
    fast_feed: float = 10_000.0
    tolerance: float = 0.0048
    top: float = 180.0
    fast: bool = True

    def program(self) -> str:
        """Sinumerik G-code: all passes across the part, the middle one fast."""
        slope = math.radians(self.slope_deg)
        half = (self.radius + BALL) * math.sin(slope)
        drop = (self.radius + BALL) * (1.0 - math.cos(slope))

        def at(along: float) -> tuple[str, str]:
            return f"{half + along * math.cos(slope):.6f}", f"{self.top - drop - along * math.sin(slope):.6f}"

        lines = [
            "; Paper, part 1: two tangent planes and a cylinder portion, ball-end d10, XZ planes, one pass fast.",
            f"; Chosen: radius {self.radius:g} mm, planes {self.slope_deg:g} degrees up and down, rounding {self.tolerance:g} mm.",
            HEAD + f"CYCLE832({self.tolerance:g},3)",
        ]
        for k in range(-(self.passes // 2), self.passes - self.passes // 2 + 1):
            quick = k == 0 and self.fast
            reach, feed = (self.plane, self.fast_feed) if quick else (self.slow_plane, self.slow_feed)
            (x0, z0), (x1, z1), y = at(reach), at(0.0), k * self.pitch
            lines += [
                f"G0 X-{x0} Y{y:.6f} Z{self.top + 20:.6f} A3=0 B3=0 C3=1",
                f"G0 Z{z0}",
                f"G1 X-{x1} Z{z1} F{feed:g}",
                f"G18 G3 X{x1} Z{z1} CR={self.radius + BALL:.6f}",
                f"G1 X{x0} Z{z0}",
                f"G0 Z{self.top + 20:.6f}",
            ]
        return "\n".join([*lines, "M30", ""])

    def part(self, zone_um: float = 10.0) -> str:
        """The part file; the centre of the ball runs one tool radius above the surface."""
        slope = math.radians(self.slope_deg)
        run, arc = 12.0, 2.0 * slope * self.radius
        x0 = -(self.radius * math.sin(slope) + run * math.cos(slope))
        z0 = self.top - self.radius * (1.0 - math.cos(slope)) - run * math.sin(slope)
        return f"""# Paper, part 1: two tangent planes joined by a cylinder portion. The tip of the ball is programmed.
name = "part 1: tangent planes"
notes = ["radius {self.radius:g} mm and slopes of {self.slope_deg:g} degrees are chosen: the paper does not print them"]

[tool]
kind = "ball"
diameter_mm = 10.0

[stock]
allowance_mm = 0.05

[[surface]]
name = "hill"
kind = "profile"
plane = "xz"
start_mm = [{x0:.6f}, {z0:.6f}]
heading_deg = {self.slope_deg:g}
segments = [{{ length_mm = {run:g} }}, {{ radius_mm = {self.radius:g}, turn_deg = -{2 * self.slope_deg:g} }}, {{ length_mm = {run:g} }}]
across_mm = [-1.75, 1.75]
spacing_mm = 0.1
zone_um = {zone_um:g}
zone_along_mm = [{run - 6:.3f}, {run + arc + 6:.3f}]
zone_across_mm = [-1.0, 1.0]
"""


@dataclass(frozen=True)
class VerticalCorner:
    """Part 2: a vertical corner, flank milled deep and slow, then 5 mm higher and fast; mm, mm/min.

    `inner` False: an outer edge; the centre moves around it on an arc of the tool's radius (as with G450), and lag cuts into the edge.
    True: an inner corner with a sharp centre path, where lag leaves material.
    """

    turn_deg: float = 90.0
    inner: bool = False
    leg: float = 60.0
    slow_leg: float = 8.0
    slow_feed: float = 100.0
    fast_feed: float = 10_000.0
    tolerance: float = 0.0048
    top: float = 160.0

    def program(self) -> str:
        """Sinumerik G-code; the edge, or the sharp corner of the centre path, is at X0 Y0."""
        turn = math.radians(self.turn_deg) * (1.0 if self.inner else -1.0)
        c, s = math.cos(turn), math.sin(turn)
        side = 0.0 if self.inner else BALL
        lines = [
            "; Paper, part 2: vertical sharp corner in XY, flank milling, cylinder d10, deep and slow, then 5 mm higher and fast.",
            f"; Chosen: {'inner' if self.inner else 'outer'} corner of {self.turn_deg:g} degrees, fast {self.fast_feed / 1e3:g} m/min, "
            f"rounding {self.tolerance:g} mm{'' if self.inner else ', the centre rolls around the edge on an arc'}.",
            HEAD + f"CYCLE832({self.tolerance:g},3)",
        ]
        for leg, feed, z in ((self.slow_leg, self.slow_feed, self.top - 10.0), (self.leg, self.fast_feed, self.top - 5.0)):
            # the tool retracts to the left of the path, where there is air
            x1, y1 = -side * s + leg * c, side * c + leg * s
            lines += [
                f"G0 X-{leg:.6f} Y{side:.6f} Z{self.top + 20:.6f} A3=0 B3=0 C3=1",
                f"G0 Z{z:.6f}",
                f"G1 X0 Y{side:.6f} F{feed:g}",
                *([] if self.inner else [f"G17 G2 X{-side * s:.6f} Y{side * c:.6f} CR={side:.6f}"]),
                f"G1 X{x1:.6f} Y{y1:.6f}",
                f"G0 X{x1 - 3 * s:.6f} Y{y1 + 3 * c:.6f}",
                f"G0 Z{self.top + 20:.6f}",
            ]
        return "\n".join([*lines, "M30", ""])

    def part(self, zone_um: float = 20.0) -> str:
        """The part file: walls 5 mm beside the centre path; an inner corner has the fillet of the tool."""
        run, kind = 6.0, "inner" if self.inner else "outer"
        arc = math.radians(self.turn_deg) * BALL if self.inner else 0.0
        corner = (
            f"{{ radius_mm = {BALL:g}, turn_deg = {self.turn_deg:g} }}"
            if self.inner
            else f"{{ radius_mm = 0, turn_deg = -{self.turn_deg:g} }}"
        )
        return f"""# Paper, part 2: a vertical corner; the nominal surface is what the d10 cylinder leaves on the programmed path.
name = "part 2: vertical corner"
notes = ["{kind} corner of {self.turn_deg:g} degrees, {self.fast_feed / 1e3:g} m/min are chosen: the paper does not print them"]

[tool]
kind = "flat"
diameter_mm = 10.0
cutting_length_mm = 20.0

[stock]
allowance_mm = 0.3

[[surface]]
name = "walls"
kind = "profile"
plane = "xy"
start_mm = [{-run:.6f}, {-BALL if self.inner else 0.0:.6f}]
heading_deg = 0.0
segments = [{{ length_mm = {run:g} }}, {corner}, {{ length_mm = {run:g} }}]
across_mm = [{self.top - 10:g}, {self.top:g}]
spacing_mm = 0.1
zone_um = {zone_um:g}
zone_along_mm = [1.0, {run + arc + run - 1.0:.3f}]
zone_across_mm = [{self.top - 8:g}, {self.top - 2:g}]
"""


@dataclass(frozen=True)
class Dome:
    """Part 3: a spiral band on a dome with the tool axis turning; mm, mm/min."""

    radius: float = 40.0
    azimuth_deg: float = 200.0
    polar_deg: tuple[float, float] = (25.0, 65.0)
    lean_deg: float = 10.0
    zone_deg: tuple[float, float] = (92.0, 108.0)
    pitch: float = 0.25
    passes: int = 12
    chord: float = 0.2
    slow_feed: float = 100.0
    fast_feed: float = 4_000.0
    tolerance: float = 0.0048
    centre: float = 130.0

    def _polar(self, azimuth: float, offset: float) -> float:
        """Polar angle [rad] of the spiral at an azimuth [deg], `offset` [mm] further from the pole."""
        low, high = self.polar_deg
        return math.radians(low + (high - low) * azimuth / self.azimuth_deg) + offset / self.radius

    def _point(self, azimuth: float, offset: float) -> tuple[str, tuple[float, float, float]]:
        """G-code words of the pose at an azimuth [deg], `offset` [mm] further from the pole, and the tip [mm]."""
        polar = self._polar(azimuth, offset)
        phi, lean = math.radians(azimuth), polar - math.radians(self.lean_deg)
        normal = (math.sin(polar) * math.cos(phi), math.sin(polar) * math.sin(phi), math.cos(polar))
        axis = (math.sin(lean) * math.cos(phi), math.sin(lean) * math.sin(phi), math.cos(lean))
        tip = [(self.radius + BALL) * n - BALL * a for n, a in zip(normal, axis)]
        tip[2] += self.centre
        words = (
            " ".join(f"{w}{v:.6f}" for w, v in zip("XYZ", tip)) + " " + " ".join(f"{w}={v:.9f}" for w, v in zip(("A3", "B3", "C3"), axis))
        )
        return words, (tip[0], tip[1], tip[2])

    def _approach(self, azimuth: float, offset: float) -> str:
        """G-code words of A and C for the pose, with A < 0, because only this side of the cradle tilts far enough.

        In the part frame A < 0 tilts the axis along (-sin C, -cos C); here it tilts along (cos phi, sin phi), so C = -90 degrees - phi.
        """
        tilt = math.degrees(self._polar(azimuth, offset)) - self.lean_deg
        return f"A={-tilt:.6f} C={-90.0 - azimuth:.6f}"

    def program(self) -> str:
        """Sinumerik G-code in chords; passes from the pole outwards, the middle one fast and over the whole spiral.

        Each pass is approached in rapid motion with explicit A and C, which selects the solution that reaches the whole pass.
        """
        lines = [
            "; Paper, part 3: a five-axis path with large rotations, ball-end d10.",
            f"; Chosen: spiral over a dome of radius {self.radius:g} mm, {self.azimuth_deg:g} degrees around, {self.polar_deg[0]:g} to "
            f"{self.polar_deg[1]:g} from the pole, axis {self.lean_deg:g} degrees to the pole's side of the normal.",
            HEAD + f"CYCLE832({self.tolerance:g},13,0.05)",
        ]
        for k in range(-(self.passes // 2), self.passes - self.passes // 2 + 1):
            first, last = (0.0, self.azimuth_deg) if k == 0 else self.zone_deg
            feed = self.fast_feed if k == 0 else self.slow_feed
            middle = math.radians(sum(self.polar_deg) / 2.0)
            count = max(4, math.ceil(math.radians(last - first) * self.radius * math.sin(middle) / self.chord))
            poses = [self._point(first + (last - first) * i / count, k * self.pitch) for i in range(count + 1)]
            above = self.centre + self.radius + 40.0
            x, y, _ = poses[0][1]
            lines += [f"G0 X{x:.6f} Y{y:.6f} Z{above:.6f} {self._approach(first, k * self.pitch)}", f"G0 {poses[0][0]}"]
            lines += [f"G1 {words}" + (f" F{feed:g}" if i == 0 else "") for i, (words, _) in enumerate(poses[1:])]
            lines += [f"G0 Z{above:.6f}"]
        return "\n".join([*lines, "M30", ""])

    def part(self, zone_um: float = 15.0) -> str:
        """The part file: a band of the dome around the middle of the slow passes."""
        mid = sum(self.zone_deg) / 2.0
        polar = self.polar_deg[0] + (self.polar_deg[1] - self.polar_deg[0]) * mid / self.azimuth_deg
        around = self.radius * math.sin(math.radians(polar))
        wide = math.degrees(2.2 / self.radius)
        return f"""# Paper, part 3: a band of a dome, cut by a five-axis spiral with large rotations of A and C.
name = "part 3: dome"
notes = ["the whole geometry is chosen: the paper does not print it"]

[tool]
kind = "ball"
diameter_mm = 10.0
cutting_length_mm = 20.0

[stock]
allowance_mm = 0.05

[[surface]]
name = "band"
kind = "sphere"
centre_mm = [0.0, 0.0, {self.centre:g}]
radius_mm = {self.radius:g}
azimuth_deg = [{self.zone_deg[0] - 8:g}, {self.zone_deg[1] + 8:g}]
polar_deg = [{polar - wide:.4f}, {polar + wide:.4f}]
spacing_mm = 0.1
zone_um = {zone_um:g}
zone_along_mm = [{math.radians(mid - 4) * around:.3f}, {math.radians(mid + 4) * around:.3f}]
zone_across_mm = [{math.radians(polar) * self.radius - 1.0:.3f}, {math.radians(polar) * self.radius + 1.0:.3f}]
"""


PARTS = {"part1_tangent_planes": TangentPlanes(), "part2_vertical_corner": VerticalCorner(), "part3_dome": Dome()}
"""File name in examples/parts without ending -> part."""
