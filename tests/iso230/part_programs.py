"""Part programs of standard tests in closed form: the circle of ISO 230-4, and five-axis flank milling similar to ISO 10791-7.

circle         one and a half revolutions, counter-clockwise and clockwise, with lead-ins; the middle revolution is evaluated
cone frustum   axis tilted relative to the table; the flank of a cylinder along the generatrix
s shape        a ruled surface between two S-curves with swaying rulings

Lengths in mm, feeds in mm/min, tips in the part frame (TRAORI). In a five-axis pass the tool axis is the unit vector along the ruling, and
its centre line is one tool radius away from the surface: tip = point on the lower curve + radius n, with the outward normal n there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np

HEAD = "G17 G71 G90 G94 G642 SOFT\n"


@dataclass(frozen=True)
class Circle:
    """G3 and G2 about the origin of X and Y, at machine height z."""

    radius: float = 50.0
    feed: float = 3000.0

    def program(self) -> str:
        """SINUMERIK G-code: half a revolution lead-in, one evaluated revolution, half a revolution lead-out, in each direction."""
        r = self.radius
        lines = [
            f"; ISO 230-4: circle of radius {r:g} mm in XY at {self.feed:g} mm/min, both directions, half a turn before and after.",
            HEAD,
        ]
        for word in ("G3", "G2"):
            lines += [
                f"G0 X-{r:.6f} Y0 Z0",
                "G4 F0.5",
                f"{word} X{r:.6f} Y0 I{r:.6f} J0 F{self.feed:g}",
                f"{word} X{r:.6f} Y0 I-{r:.6f} J0",
            ]
            lines += [f"{word} X-{r:.6f} Y0 I-{r:.6f} J0", "G4 F0.5"]
        return "\n".join([*lines, "M30", ""])


@dataclass(frozen=True)
class FlankMilling:
    """Common data of both five-axis parts: tool radius, depth of the tip below the lower curve, feed, tolerance, steps."""

    tool_radius: float = 8.0
    overhang: float = 2.0
    feed: float = 1000.0
    tolerance: float = 0.01
    steps: int = 180

    def poses(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Tip (3,) [mm] and tool axis (3,) along the pass."""
        for i in range(self.steps + 1):
            point, ruling, normal = self.ruling(i / self.steps)
            yield point + self.tool_radius * normal - self.overhang * ruling, ruling

    def ruling(self, share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Point on the lower curve, unit ruling (upwards) and unit outward normal, at a share of the pass."""
        raise NotImplementedError

    def program(self) -> str:
        """SINUMERIK G-code in chords. A and C are given in the approach, with A < 0."""
        poses = list(self.poses())
        (x, y, z), axis = poses[0]
        tilt, turn = -math.degrees(math.acos(axis[2])), math.degrees(math.atan2(-axis[0], -axis[1]))
        words = [
            " ".join(f"{w}{v:.6f}" for w, v in zip("XYZ", tip)) + " " + " ".join(f"{w}={v:.9f}" for w, v in zip(("A3", "B3", "C3"), a))
            for tip, a in poses
        ]
        lines = [f"; {self.text}", HEAD + f"TRAORI\nORIWKS\nCYCLE832({self.tolerance:g},13,0.05)"]
        lines += [f"G0 X{x:.6f} Y{y:.6f} Z{z + 80.0:.6f} A={tilt:.6f} C={turn:.6f}", f"G0 {words[0]}"]
        lines += [f"G1 {w}" + (f" F{self.feed:g}" if i == 0 else "") for i, w in enumerate(words[1:])]
        return "\n".join([*lines, f"G0 Z{z + 80.0:.6f}", "M30", ""])

    @property
    def text(self) -> str:
        return "flank milling"


@dataclass(frozen=True)
class ConeFrustum(FlankMilling):
    """Base circle of `base` radius, half apex angle, axis tilted by `tilt_deg` about y, base centre at `centre`."""

    base: float = 40.0
    half_angle_deg: float = 15.0
    tilt_deg: float = 10.0
    centre: tuple[float, float, float] = (0.0, 0.0, 110.0)

    @property
    def text(self) -> str:
        return f"Cone frustum: base radius {self.base:g} mm, half angle {self.half_angle_deg:g} degrees, axis tilted by {self.tilt_deg:g} degrees."

    def ruling(self, share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        tilt, alpha, phi = math.radians(self.tilt_deg), math.radians(self.half_angle_deg), 2.0 * math.pi * share
        first, second = np.array([math.cos(tilt), 0.0, -math.sin(tilt)]), np.array([0.0, 1.0, 0.0])
        third = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
        radial = math.cos(phi) * first + math.sin(phi) * second
        point = np.array(self.centre) + self.base * radial
        return point, math.cos(alpha) * third - math.sin(alpha) * radial, math.cos(alpha) * radial + math.sin(alpha) * third


@dataclass(frozen=True)
class SShape(FlankMilling):
    """y = amplitude sin(2 pi s) over a length along x; the ruling leans in y by lean + sway sin(2 pi s)."""

    length: float = 160.0
    amplitude: float = 25.0
    lean_deg: float = 12.0
    sway_deg: float = 8.0
    height: float = 110.0

    @property
    def text(self) -> str:
        return f"S shape: {self.length:g} mm long, amplitude {self.amplitude:g} mm, rulings lean by {self.lean_deg:g} +- {self.sway_deg:g} degrees."

    def ruling(self, share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        turn = 2.0 * math.pi * share
        point = np.array([self.length * (share - 0.5), self.amplitude * math.sin(turn), self.height])
        along = np.array([self.length, 2.0 * math.pi * self.amplitude * math.cos(turn), 0.0])
        lean = math.radians(self.lean_deg + self.sway_deg * math.sin(turn))
        ruling = np.array([0.0, math.sin(lean), math.cos(lean)])
        normal = np.cross(along, ruling)
        return point, ruling, normal / np.linalg.norm(normal)


PROGRAMS = {"circle_xy": Circle(), "cone_frustum": ConeFrustum(), "s_shape": SShape()}
"""File names in examples/iso230 without ending."""
