"""Material removal: tests all steps of a tool against all rays, tile by tile, compiled, on several threads.

A tile is a patch of neighbouring rays inside a capsule. A step is tested against the rays of a tile (`twin.surface.sweep`) only if the
swept element comes near its capsule. A ray keeps the lowest height of all steps and elements:

    height <- min(height, t)          with t >= -depth

A minimum does not depend on order, tiling or threads. `cutter` is the sample whose step first reached the final height.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import math

import numpy as np

from twin.compiled_functions import compiled
from twin.surface.height_rays import TILE, HeightRays, tile_bounds, tiles_of
from twin.surface.steps import Steps
from twin.surface.sweep import FRUSTUM, PARALLEL, SPHERE, TINY, dot, swept_frustum, swept_sphere
from twin.surface.swept_rim import swept_rim
from twin.surface.tools import Tool
from twin.system import cores

GROUP = 32
"""Consecutive steps that are culled together."""
BOUND_MARGIN = 1e-9
"""Subtracted from the computed bound of a ray to cover rounding [m]."""
UNDER = 1e-9
"""A rounded element is skipped down to this depth below its lower plane [m]; the element with that plane cuts there."""
REORDERED = {"contract", "nsz", "arcp"}
"""Floating-point changes allowed in the vectorised loop over rays."""
TILES_AT_ONCE = 64
"""Tiles per task of a thread; limits the time between progress reports."""


def cut(
    rays: HeightRays,
    steps: Steps,
    tool: Tool,
    *,
    threads: int | None = None,
    tile: int = TILE,
    progress: Callable[[float], None] | None = None,
) -> tuple[HeightRays, np.ndarray]:
    """The rays after all steps of the tool, and the work of the cut: all pairs of ray and step, and those tested after culling.

    `progress` is called with the completed share. Memory beyond rays and steps is a few numbers per tile.
    """
    height, cutter = rays.height.copy(), rays.cutter.copy()
    pairs = len(rays) * len(steps) * len(tool.elements)
    if len(steps) == 0 or len(rays) == 0:
        return rays, np.array([pairs, 0])
    order, starts = tiles_of(rays, tile)
    bounds = tile_bounds(rays, order, starts)
    groups = group_bounds(steps, tool)
    # one row per coordinate and contiguous tiles, so that the compiler can vectorise over rays
    lines = np.ascontiguousarray(np.hstack([rays.point, rays.direction])[order].T)
    h, c = height[order], cutter[order]
    moves = np.ascontiguousarray(np.hstack([steps.tip, steps.way, steps.axis, steps.turn, steps.angle[:, None], steps.rim]))
    tests = np.zeros(len(bounds), np.int64)
    sample = np.ascontiguousarray(steps.sample, np.int64)

    def work(first: int) -> int:
        last = min(first + TILES_AT_ONCE, len(bounds))
        cut_tiles(first, last, starts, bounds, lines, h, c, -rays.depth, moves, sample, groups, tool.elements, tests)
        return last - first

    done = 0
    pieces = range(0, len(bounds), TILES_AT_ONCE)
    with ThreadPoolExecutor(threads or cores()) as pool:
        for count in pool.map(work, pieces):
            done += count
            if progress:
                progress(done / len(bounds))
    height[order], cutter[order] = h, c
    return replace(rays, height=height, cutter=cutter), np.array([pairs, tests.sum()])


def group_bounds(steps: Steps, tool: Tool) -> np.ndarray:
    """Bounding spheres (group, element, 4) of each element over GROUP steps: centre and radius [m]."""
    starts = np.arange(0, len(steps), GROUP)
    out = np.empty((len(starts), len(tool.elements), 4))
    for e, (kind, z0, z1, r, slope) in enumerate(tool.elements):
        radius = r if kind == SPHERE else r + slope if kind != FRUSTUM else max(r, r + slope * (z1 - z0))
        ends = [(steps.tip + part * steps.way) + z * (steps.axis + part * steps.turn) for z in (z0, z1) for part in (0.0, 1.0)]
        low = np.minimum.reduceat(np.minimum.reduce(ends), starts, axis=0)
        high = np.maximum.reduceat(np.maximum.reduce(ends), starts, axis=0)
        out[:, e, :3] = (low + high) / 2.0
        out[:, e, 3] = np.linalg.norm(high - low, axis=1) / 2.0 + radius
    return out


@compiled(ieee_division=True, allocates=True)
def segments_apart(a, b, p, q):  # type: ignore[no-untyped-def]
    """Smallest distance between the segments a .. b and p .. q."""
    u = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
    v = (q[0] - p[0], q[1] - p[1], q[2] - p[2])
    w = (a[0] - p[0], a[1] - p[1], a[2] - p[2])
    uu, vv, uv = dot(u, u), dot(v, v), dot(u, v)
    uw, vw = dot(u, w), dot(v, w)
    det = uu * vv - uv * uv
    s = min(1.0, max(0.0, (uv * vw - vv * uw) / det)) if det > 1e-12 * uu * vv and det > 0.0 else 0.0
    t = min(1.0, max(0.0, (uv * s + vw) / vv)) if vv > 0.0 else 0.0
    s = min(1.0, max(0.0, (uv * t - uw) / uu)) if uu > 0.0 else 0.0
    t = min(1.0, max(0.0, (uv * s + vw) / vv)) if vv > 0.0 else 0.0
    x = (w[0] + s * u[0] - t * v[0], w[1] + s * u[1] - t * v[1], w[2] + s * u[2] - t * v[2])
    return math.sqrt(dot(x, x))


@compiled(ieee_division=True, allocates=True)
def element_entry(kind, p, n, m, z0, z1, r, slope, top):  # type: ignore[no-untyped-def]
    """Lowest t where ray p + t n lies in an element during the step m (a row of `moves`); results above `top` may be inf."""
    tip, way = (m[0], m[1], m[2]), (m[3], m[4], m[5])
    axis, turn = (m[6], m[7], m[8]), (m[9], m[10], m[11])
    if kind == FRUSTUM:
        return swept_frustum(p, n, tip, way, axis, turn, m[12], z0, z1, r, slope, top)
    y = (p[0] - tip[0] - z0 * axis[0], p[1] - tip[1] - z0 * axis[1], p[2] - tip[2] - z0 * axis[2])
    d = (way[0] + z0 * turn[0], way[1] + z0 * turn[1], way[2] + z0 * turn[2])
    dd = dot(d, d)
    if kind == SPHERE:
        return swept_sphere(y, n, d, dd, r * r)
    # a rounded element lies within its bounding sphere; most rays end here
    if swept_sphere(y, n, d, dd, (r + slope) * (r + slope)) >= top:
        return math.inf
    if top < math.inf:
        # it also lies above its lower plane: height over s of the ray's point at `top` above the circle, a parabola
        x = (y[0] + top * n[0], y[1] + top * n[1], y[2] + top * n[2])
        first = dot(x, axis)
        bend = dot(d, turn)
        slant = dot(x, turn) - dot(d, axis)
        most = max(first, first + slant - bend)
        if bend > 0.0 and 0.0 < slant < 2.0 * bend:
            most = first + 0.25 * slant * slant / bend
        rise = dot(n, axis)
        if rise > m[12] and most <= UNDER - slope:
            return math.inf
    return swept_rim(y, n, d, (m[13], m[14], m[15]), (m[16], m[17], m[18]), (m[19], m[20], m[21]), (m[22], m[23], m[24]), r, slope)


@compiled(ieee_division=True, allocates=True)
def near(bound, m, kind, z0, z1, radius):  # type: ignore[no-untyped-def]
    """May an element during step m touch the capsule of a tile?"""
    a, b = (bound[0], bound[1], bound[2]), (bound[3], bound[4], bound[5])
    if kind == FRUSTUM:
        # the axis in the middle of the step; its points move by at most half their path from there
        p = (
            m[0] + 0.5 * m[3] + z0 * (m[6] + 0.5 * m[9]),
            m[1] + 0.5 * m[4] + z0 * (m[7] + 0.5 * m[10]),
            m[2] + 0.5 * m[5] + z0 * (m[8] + 0.5 * m[11]),
        )
        rise = z1 - z0
        q = (p[0] + rise * (m[6] + 0.5 * m[9]), p[1] + rise * (m[7] + 0.5 * m[10]), p[2] + rise * (m[8] + 0.5 * m[11]))
        extra = 0.5 * (math.sqrt(m[3] * m[3] + m[4] * m[4] + m[5] * m[5]) + max(abs(z0), abs(z1)) * m[12])
        # capsules beyond the end faces are not near
        low = (a[0] - p[0]) * m[6] + (a[1] - p[1]) * m[7] + (a[2] - p[2]) * m[8]
        high = (b[0] - p[0]) * m[6] + (b[1] - p[1]) * m[7] + (b[2] - p[2]) * m[8]
        wide = bound[6] + extra + m[12] * (radius + bound[6] + max(abs(low), abs(high)))
        if max(low, high) < -wide or min(low, high) > rise + wide:
            return False
    else:
        p = (m[0] + z0 * m[6], m[1] + z0 * m[7], m[2] + z0 * m[8])
        q = (p[0] + m[3] + z0 * m[9], p[1] + m[4] + z0 * m[10], p[2] + m[5] + z0 * m[11])
        extra = 0.0
    return segments_apart(a, b, p, q) <= bound[6] + radius + extra


@compiled(ieee_division=True, allocates=True, fastmath=REORDERED)
def sphere_bounds(begin, end, lines, m, z0, square, bounded):  # type: ignore[no-untyped-def]
    """Lower bound of each ray's t in the infinitely extended path of a sphere: -inf parallel to the path, NaN if missed.

    Without branches; the conic is that of `swept_sphere`, which computes the final value.
    """
    cx, cy, cz = m[0] + z0 * m[6], m[1] + z0 * m[7], m[2] + z0 * m[8]
    dx, dy, dz = m[3] + z0 * m[9], m[4] + z0 * m[10], m[5] + z0 * m[11]
    length2 = dx * dx + dy * dy + dz * dz
    over = 1.0 / length2 if length2 > TINY else 0.0
    px, py, pz = lines[0, begin:end], lines[1, begin:end], lines[2, begin:end]
    nx, ny, nz = lines[3, begin:end], lines[4, begin:end], lines[5, begin:end]
    for i in range(end - begin):
        yx, yy, yz = px[i] - cx, py[i] - cy, pz[i] - cz
        e = yx * nx[i] + yy * ny[i] + yz * nz[i]
        f = yx * yx + yy * yy + yz * yz - square
        b = -(dx * nx[i] + dy * ny[i] + dz * nz[i])
        g = -(yx * dx + yy * dy + yz * dz)
        cc = 1.0 - b * b * over
        ee = e - b * g * over
        disc = ee * ee - cc * (f - g * g * over)
        t = (-ee - math.sqrt(disc)) / cc - BOUND_MARGIN
        bounded[i] = t if cc > PARALLEL else -math.inf


@compiled(ieee_division=True, allocates=True)
def cut_tiles(first, last, starts, bounds, lines, height, cutter, floor, moves, sample, groups, elements, tests):  # type: ignore[no-untyped-def]
    """Cut the rays of the tiles first .. last; updates height, cutter and tests."""
    most = 0
    for tile in range(first, last):
        most = max(most, starts[tile + 1] - starts[tile])
    bounded = np.empty(most)
    for tile in range(first, last):
        bound = bounds[tile]
        middle = (0.5 * (bound[0] + bound[3]), 0.5 * (bound[1] + bound[4]), 0.5 * (bound[2] + bound[5]))
        half = 0.5 * math.sqrt((bound[3] - bound[0]) ** 2 + (bound[4] - bound[1]) ** 2 + (bound[5] - bound[2]) ** 2) + bound[6]
        count = 0
        for e in range(len(elements)):
            kind, z0, z1, r, slope = int(elements[e, 0]), elements[e, 1], elements[e, 2], elements[e, 3], elements[e, 4]
            radius = r if kind == SPHERE else max(r, r + slope * (z1 - z0)) if kind == FRUSTUM else r + slope
            for g in range(len(groups)):
                x, y, z = groups[g, e, 0] - middle[0], groups[g, e, 1] - middle[1], groups[g, e, 2] - middle[2]
                if math.sqrt(x * x + y * y + z * z) > groups[g, e, 3] + half:
                    continue
                for k in range(g * GROUP, min((g + 1) * GROUP, len(moves))):
                    m = moves[k]
                    if not near(bound, m, kind, z0, z1, radius):
                        continue
                    begin, end = starts[tile], starts[tile + 1]
                    count += end - begin
                    if kind == SPHERE:
                        sphere_bounds(begin, end, lines, m, z0, r * r, bounded)
                    for i in range(begin, end):
                        if kind == SPHERE and not bounded[i - begin] < height[i]:
                            continue
                        p = (lines[0, i], lines[1, i], lines[2, i])
                        n = (lines[3, i], lines[4, i], lines[5, i])
                        t = element_entry(kind, p, n, m, z0, z1, r, slope, height[i])
                        if not t < height[i]:
                            continue
                        if t < floor:
                            # below the lower end of the ray: does the tool cover the ray at all?
                            back = (-n[0], -n[1], -n[2])
                            out = -element_entry(kind, p, back, m, z0, z1, r, slope, math.inf)
                            if out < floor:
                                continue
                            t = floor
                        if t < height[i]:
                            height[i] = t
                            cutter[i] = sample[k]
        tests[tile] = count
