"""Arcs of CL data: centre, axis and angle from CIRCLE with the next point, or from TLON,GOFWD with a starting direction.

CIRCLE/ x,y,z,i,j,k[,r]          arc to the next GOTO, right-handed about its axis (NX, Creo; RhinoCAM without radius)
MOVARC/ x,y,z,i,j,k,r,ANGLE,a    the same; of the two senses the one that the angle fits (Fusion)
INDIRV/ i,j,k                    direction in which the tool leaves (CATIA); INDIRP/ x,y,z: the point it leaves towards
TLON,GOFWD/ (CIRCLE/ x,y,z,r),ON,[n,INTOF,](LINE/ x1,y1,z1,x2,y2,z2)
                                 along the circle about the tool axis to its first (n-th) meeting with the line;
                                 CIRCLE/CANON,x,y,z,i,j,k,r gives another axis, (PLANE/ i,j,k,d) replaces the line
"""

from __future__ import annotations

import math
import re

import numpy as np

from twin.program.apt_words import numbers_of
from twin.program.arcs import CLOSING_TOLERANCE, Arc, ArcError, angle_between

_PART = re.compile(r"\(?\s*(CIRCLE|LINE|PLANE)\s*/\s*([^()]*?)\s*\)?\s*(?=,\s*(?:ON|TO|PAST|TANTO|\d+\s*,\s*INTOF)\b|\s*\Z|,\s*\()", re.S)
_ORDINAL = re.compile(r",\s*(\d+)\s*,\s*INTOF")


ANGLE_FITS = math.radians(1.0)
"""Tolerance between the angle of MOVARC and that of its points [rad]: some posts round it to whole degrees."""


def arc_to(
    start: np.ndarray, end: np.ndarray, centre: np.ndarray, normal: np.ndarray, radius: float | None, sweep: float | None = None
) -> Arc:
    """The arc from start to end about an axis; equal places are a full circle.

    Without `radius` [m] the radius is that of the start. With `sweep` [rad] the direction is the one that gives this angle, because the
    older post of Fusion writes the axis of a clockwise arc as that of a counter-clockwise one.
    """
    arms = [_arm(p, centre, normal) for p in (start, end)]
    radius = float(np.linalg.norm(arms[0])) if radius is None else radius
    for arm, place in zip(arms, ("start", "end")):
        if abs(np.linalg.norm(arm) - radius) > CLOSING_TOLERANCE:
            raise ArcError(
                f"the arc does not close: its {place} lies {np.linalg.norm(arm) * 1e3:.4f} mm from the axis of CIRCLE/, "
                f"the radius is {radius * 1e3:.4f} mm; correct it"
            )
    angle = angle_between(arms[0], arms[1], normal)
    if sweep is not None and abs(angle - abs(sweep)) > ANGLE_FITS:
        back = 2.0 * math.pi - angle
        if abs(back - abs(sweep)) > ANGLE_FITS:
            raise ArcError(f"the arc turns by {math.degrees(angle):.3f} deg, and ANGLE says {math.degrees(abs(sweep)):.3f} deg; correct it")
        return centre, -normal, back
    return centre, normal, angle


def driven_arc(values: str, start: np.ndarray, direction: np.ndarray, tool_axis: np.ndarray, unit: float) -> tuple[Arc, np.ndarray]:
    """The arc of TLON,GOFWD and its end point (3,) [m]; `direction` (3,) is that of the start, `unit` [m] of the numbers."""
    parts = {m[1]: m[2] for m in _PART.finditer(values)}
    if "CIRCLE" not in parts or not {"LINE", "PLANE"} & parts.keys():
        raise ArcError("TLON,GOFWD needs (CIRCLE/ ..) and (LINE/ ..) or (PLANE/ ..); let the CAM system output points instead")
    circle = parts["CIRCLE"].removeprefix("CANON").lstrip(" ,")
    numbers = numbers_of(circle, "CIRCLE", (4, 7))
    if len(numbers) == 4:
        normal = tool_axis / np.linalg.norm(tool_axis)
        way = start - np.array(numbers[:3]) * unit
        if abs(float(way @ normal)) > CLOSING_TOLERANCE and abs(float(np.linalg.norm(way)) - numbers[3] * unit) <= CLOSING_TOLERANCE:
            normal = np.cross(way, direction)  # a contour of turning stands on edge: its plane is that of the start and its direction
            if not np.linalg.norm(normal) > 0.0:
                raise ArcError("INDIRV/ points along the radius of the circle, so the plane of the arc is not known; correct it")
            normal = normal / np.linalg.norm(normal)
    else:
        normal = np.array(numbers[3:6])
        if not np.linalg.norm(normal) > 0.0:
            raise ArcError("the axis of CIRCLE/CANON has no length; correct it")
        normal = normal / np.linalg.norm(normal)
    centre, radius = np.array(numbers[:3]) * unit, numbers[-1] * unit
    arm = _arm(start, centre, normal)
    if abs(np.linalg.norm(arm) - radius) > CLOSING_TOLERANCE or radius <= 0.0:
        raise ArcError(
            f"the arc does not begin here: the tool is {np.linalg.norm(arm) * 1e3:.4f} mm from the axis of CIRCLE/, the radius is {radius * 1e3:.4f} mm"
        )
    # the sense of the turn is that of the starting direction
    turn = float(np.cross(arm, direction) @ normal)
    if abs(turn) < 1e-6 * radius * float(np.linalg.norm(direction)):
        raise ArcError("INDIRV/ points along the radius of the circle, so the sense of the arc is not known; correct it")
    normal = math.copysign(1.0, turn) * normal
    meetings = [angle_between(arm, place, normal, 1e-6) for place in _meetings(parts, centre, normal, radius, unit)]
    ordinal = int(match[1]) if (match := _ORDINAL.search(values)) else 1
    if ordinal < 1 or ordinal > len(meetings):
        raise ArcError(f"the circle meets the line {len(meetings)} times, not {ordinal}; correct it")
    angle = sorted(meetings)[ordinal - 1]
    height = normal * float((start - centre) @ normal)
    end = centre + height + math.cos(angle) * arm + math.sin(angle) * np.cross(normal, arm)
    return (centre, normal, angle), end


def _meetings(parts: dict[str, str], centre: np.ndarray, normal: np.ndarray, radius: float, unit: float) -> list[np.ndarray]:
    """Where the circle meets the line or plane, as arms from its centre (3,)."""
    if "PLANE" in parts:
        numbers = numbers_of(parts["PLANE"], "PLANE", (4,))
        along, distance = np.array(numbers[:3]), numbers[3] * unit - float(np.array(numbers[:3]) @ centre)
        flat = along - normal * (along @ normal)
    else:
        numbers = numbers_of(parts["LINE"], "LINE", (4, 6))
        half = len(numbers) // 2
        first, second = (np.pad(np.array(p) * unit, (0, 3 - half)) for p in (numbers[:half], numbers[half:]))
        way = _arm(second, first, normal)
        flat = np.cross(normal, way)
        distance = float(_arm(first, centre, normal) @ flat)
    length = float(np.linalg.norm(flat))
    if length < 1e-12:
        raise ArcError("the line that ends the arc has no direction in the plane of its circle; correct it")
    across, offset = flat / length, distance / length
    if abs(offset) > radius + CLOSING_TOLERANCE:
        raise ArcError(f"the circle does not meet the line that ends it: it passes {(abs(offset) - radius) * 1e3:.4f} mm away; correct it")
    reach = math.sqrt(max(radius**2 - offset**2, 0.0))
    along_line = np.cross(across, normal)
    return [across * offset + along_line * reach, across * offset - along_line * reach]


def _arm(point: np.ndarray, centre: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """From the axis through the centre to a point (3,)."""
    return np.asarray(point - centre - normal * ((point - centre) @ normal))
