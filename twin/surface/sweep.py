"""Lowest intersection of a ray with the volume swept by a moving tool: closed forms, compiled.

A ray is the line x(t) = p + t n. A tool is a union of convex elements around its axis; within a step each of its points moves
along a straight line, y(s, t) = x(t) - P(s), s in [0, 1]. The ray is cut at the lowest t of the region that the element covers in
the plane (s, t). For an element that only translates with velocity w this region is a conic bounded by straight lines,

    sphere     |y|^2 <= R^2
    frustum    |y - (y.u) u| <= r0 + k (y.u - a0),   a0 <= y.u <= a1

and its lowest point has a closed form, even if the ray misses the tool at both ends of the step. A turning axis u(s) = u0 + s du uses
the same forms with the velocity w of the contact point, iterated until this point converges; the condition that then holds (surface
normal perpendicular to the velocity) is exact. A miss is t = inf.

All lengths in m; `tests/reference/test_surface_random.py` compares every form with brute force.
"""

import math

from twin.compiled_functions import compiled

SPHERE, FRUSTUM, ROUNDED = 0, 1, 2
TINY = 1e-30
"""The tool is at rest if the squared length of a step [m2] is smaller."""
PARALLEL = 1e-6
"""The ends of the step are also tested if the squared sine between ray and motion is smaller."""
SETTLED = 1e-8
"""The contact point has converged if t changes by less [m]."""
SLAB_MARGIN = 2e-8
"""Least distance of a ray from the end faces of a turning tool to count as clear [m], besides their motion within the step."""
MOST_REPEATS = 12
STANDING_SAMPLES = 17
GOLDEN = 0.6180339887498949


@compiled(inline=True)
def dot(a, b):  # type: ignore[no-untyped-def]
    """Product of two vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled(ieee_division=True, allocates=True)
def _standing_sphere(e, f, b, g, length2, s):  # type: ignore[no-untyped-def]
    """Lowest t in the sphere at rest at the share s of its step, by the scalars of `swept_sphere`."""
    es = e + s * b
    disc = es * es - (f + s * (2.0 * g + s * length2))
    return -es - math.sqrt(disc) if disc >= 0.0 else math.inf


@compiled(ieee_division=True, allocates=True)
def swept_sphere(y, n, d, length2, square):  # type: ignore[no-untyped-def]
    """Lowest t in a sphere that moves by d (length2 = d.d); y = ray point - first centre."""
    e = dot(y, n)
    f = dot(y, y) - square
    if length2 <= TINY:
        return _standing_sphere(e, f, 0.0, 0.0, 0.0, 0.0)
    b = -dot(d, n)
    g = -dot(y, d)
    # lowest point of the unbounded conic: its derivative in s vanishes
    over = 1.0 / length2
    cc = 1.0 - b * b * over
    ee = e - b * g * over
    disc = ee * ee - cc * (f - g * g * over)
    if disc < 0.0:
        return math.inf
    s = min(1.0, max(0.0, -(b * (-ee - math.sqrt(disc)) / cc + g) * over)) if cc > 0.0 else 0.0
    best = _standing_sphere(e, f, b, g, length2, s)
    if cc <= PARALLEL:
        best = min(best, _standing_sphere(e, f, b, g, length2, 0.0), _standing_sphere(e, f, b, g, length2, 1.0))
    return best


@compiled(ieee_division=True, allocates=True)
def _lowest_on_line(a, b, c, low, high):  # type: ignore[no-untyped-def]
    """Lowest and highest x in [low, high] with a x^2 + 2 b x + c <= 0; (inf, -inf) if there is none.

    The region is convex within the bounds; for a < 0 (a double cone) they contain one of the branches outside the roots.
    """
    disc = b * b - a * c
    if abs(a) <= 1e-15 * (abs(b) + abs(c)) or a == 0.0:
        if abs(b) > 1e-30:
            low, high = (low, min(high, -0.5 * c / b)) if b > 0.0 else (max(low, -0.5 * c / b), high)
        elif c > 0.0:
            high = -math.inf
    elif disc >= 0.0:
        root = math.sqrt(disc)
        q = -(b + root) if b >= 0.0 else root - b
        x1 = q / a
        x2 = c / q if q != 0.0 else x1
        first, last = min(x1, x2), max(x1, x2)
        if a > 0.0:
            low, high = max(low, first), min(high, last)
        elif low <= first:
            high = min(high, first)
        else:
            low = max(low, last)
    elif a > 0.0:
        high = -math.inf
    return (low, high) if low <= high else (math.inf, -math.inf)


@compiled(ieee_division=True, allocates=True)
def moved_frustum(y, n, w, u, a0, a1, r0, k, top):  # type: ignore[no-untyped-def]
    """Lowest (t, s) in a frustum that translates by s w, s in [0, 1]; y = ray point - tip at s = 0.

    Also returns a state: 2 hit, 1 the ray meets the infinite cone beyond the ends only, 0 it misses the cone. Results at or above `top`
    may be inf.
    """
    z0, nz, wz = dot(y, u), dot(n, u), dot(w, u)
    rho = r0 + k * (z0 - a0)
    yn = dot(y, n) - z0 * nz
    yw = dot(y, w) - z0 * wz
    nw = dot(n, w) - nz * wz
    ww = max(dot(w, w) - wz * wz, 0.0)
    # Q(s, t) = A s^2 + 2 B s t + C t^2 + 2 D s + 2 E t + F <= 0
    kk = k * k
    a = ww - kk * wz * wz
    b = -nw + kk * wz * nz
    c = max(1.0 - nz * nz, 0.0) - kk * nz * nz
    d = -yw + k * rho * wz
    e = yn - k * rho * nz
    f = dot(y, y) - z0 * z0 - rho * rho
    if a > TINY:
        over = 1.0 / a
        cc = c - b * b * over
        ee = e - b * d * over
        disc = ee * ee - cc * (f - d * d * over)
        if cc > 0.0 and disc < 0.0:
            return math.inf, 0.0, 0
        # ellipse: the lower root; hyperbola (a cone): the lowest point of the upper branch, which is the other root
        if abs(cc) > 1e-9 and disc >= 0.0:
            t = (-ee - math.sqrt(disc)) / cc
            if cc > 0.0 and t >= top:
                return math.inf, 0.0, 1
            s = -(b * t + d) * over
            z = z0 + t * nz - s * wz
            if s >= 0.0 and s <= 1.0 and z >= a0 and z <= a1:
                return t, s, 2
    best, at = math.inf, 0.0
    # the two ends of the step
    for s in (0.0, 1.0):
        low, high = -1e6, 1e6
        base = z0 - s * wz
        if abs(nz) > 1e-15:
            low, high = (a0 - base) / nz, (a1 - base) / nz
            if low > high:
                low, high = high, low
        elif base < a0 or base > a1:
            low, high = 1.0, 0.0
        t1 = _lowest_on_line(c, e + s * b, f + s * (2.0 * d + s * a), low, high)[0]
        if t1 < best:
            best, at = t1, s
    # the two faces: z = face is a line in the plane (s, t)
    for face in (a0, a1):
        if abs(nz) > abs(wz) * 1e-9 and nz != 0.0:
            # t = t0 + m s
            t0, m = (face - z0) / nz, wz / nz
            s1, s2 = _lowest_on_line(a + m * (2.0 * b + m * c), d + b * t0 + m * (c * t0 + e), f + t0 * (2.0 * e + t0 * c), 0.0, 1.0)
            if s1 <= s2:
                s = s1 if m >= 0.0 else s2
                if t0 + m * s < best:
                    best, at = t0 + m * s, s
        elif wz != 0.0:
            s = (z0 - face) / wz
            if s >= 0.0 and s <= 1.0:
                t1 = _lowest_on_line(c, e + s * b, f + s * (2.0 * d + s * a), -1e6, 1e6)[0]
                if t1 < best:
                    best, at = t1, s
    return best, at, 2 if best < math.inf else 1


@compiled(ieee_division=True, allocates=True)
def _standing_frustum(y, n, d, u0, du, a0, a1, r0, k, s):  # type: ignore[no-untyped-def]
    """Lowest t in the frustum at rest at the share s of its step."""
    u = (u0[0] + s * du[0], u0[1] + s * du[1], u0[2] + s * du[2])
    norm = 1.0 / math.sqrt(dot(u, u))
    q = (y[0] - s * d[0], y[1] - s * d[1], y[2] - s * d[2])
    return moved_frustum(q, n, (0.0, 0.0, 0.0), (u[0] * norm, u[1] * norm, u[2] * norm), a0, a1, r0, k, math.inf)[0]


@compiled(ieee_division=True, allocates=True)
def _is_clear(y, n, d, u0, du, turning, a0, a1, r0, k, top):  # type: ignore[no-untyped-def]
    """Does the ray up to `top` certainly miss the frustum during the whole step, by its faces or by its cone?"""
    x = (y[0] + top * n[0], y[1] + top * n[1], y[2] + top * n[2])
    first = dot(x, u0)
    last = (x[0] - d[0]) * (u0[0] + du[0]) + (x[1] - d[1]) * (u0[1] + du[1]) + (x[2] - d[2]) * (u0[2] + du[2])
    rise = dot(n, u0)
    way = math.sqrt(dot(d, d))
    margin = SLAB_MARGIN + 0.25 * turning * way if turning > 0.0 else 0.0
    highest = max(first, last) + margin
    if rise < -turning:
        return min(first, last) >= a1 + margin
    if rise <= turning:
        return False
    if highest <= a0:
        return True
    steep = rise - turning
    if k <= 0.0 or steep * steep * (1.0 + k * k) <= 1.0:
        return False
    # the ray is steeper than the cone: outside at `top` means outside everywhere below
    u = (u0[0] + 0.5 * du[0], u0[1] + 0.5 * du[1], u0[2] + 0.5 * du[2])
    q = (x[0] - 0.5 * d[0], x[1] - 0.5 * d[1], x[2] - 0.5 * d[2])
    far, along = dot(q, q), dot(q, u)
    moved = way + 1.01 * turning * (math.sqrt(far) + way)
    wide = max(r0 + k * (highest - a0), 0.0) + 0.5 * moved
    return far - along * along / dot(u, u) > wide * wide


@compiled(ieee_division=True, allocates=True)
def swept_frustum(p, n, tip, d, u0, du, turning, a0, a1, r0, k, top):  # type: ignore[no-untyped-def]
    """Lowest t in a frustum whose tip moves from `tip` by d and whose axis turns from u0 by du; results above `top` may be inf."""
    y = (p[0] - tip[0], p[1] - tip[1], p[2] - tip[2])
    if top < math.inf and _is_clear(y, n, d, u0, du, turning, a0, a1, r0, k, top):
        return math.inf
    if not turning:
        t, _, _ = moved_frustum(y, n, d, u0, a0, a1, r0, k, top)
        return t
    # start at the ray's own point in the middle of the step (not at `top`: the result must not depend on it)
    s, t = 0.5, 0.0
    last, hit = math.inf, False
    for _ in range(MOST_REPEATS):
        u = (u0[0] + s * du[0], u0[1] + s * du[1], u0[2] + s * du[2])
        norm = 1.0 / math.sqrt(dot(u, u))
        u = (u[0] * norm, u[1] * norm, u[2] * norm)
        # the contact point relative to the tip at s, split into parts along and perpendicular to the axis
        q = (y[0] - s * d[0] + t * n[0], y[1] - s * d[1] + t * n[1], y[2] - s * d[2] + t * n[2])
        z = dot(q, u)
        z_held = min(max(z, a0), a1)
        tilt = dot(q, du) - z * dot(u, du)
        reach = max(r0, r0 + k * (a1 - a0))
        tilt = min(max(tilt, -reach * turning), reach * turning)
        w = (d[0] + z_held * du[0] - tilt * u[0], d[1] + z_held * du[1] - tilt * u[1], d[2] + z_held * du[2] - tilt * u[2])
        # tip of the frustum that translates with w and coincides with the tool at s
        back = (y[0] - s * d[0] + s * w[0], y[1] - s * d[1] + s * w[1], y[2] - s * d[2] + s * w[2])
        found, at, state = moved_frustum(back, n, w, u, a0, a1, r0, k, math.inf)
        if state == 2:
            hit = True
            if abs(found - last) < SETTLED or found - abs(found - last) > top:
                return found
            s, t, last = at, found, found
        else:
            # missed with this velocity: continue from the closest approach of ray and axis
            zz, nz, wz = dot(back, u), dot(n, u), dot(w, u)
            ww = dot(w, w) - wz * wz
            nn = 1.0 - nz * nz
            nw = dot(n, w) - nz * wz
            yn = dot(back, n) - zz * nz
            yw = dot(back, w) - zz * wz
            det = ww * nn - nw * nw
            at = min(1.0, max(0.0, (nn * yw - nw * yn) / det)) if det > 1e-12 * ww * nn and det > 0.0 else s
            found = (nw * at - yn) / nn if nn > 1e-12 else t
            if abs(at - s) < 1e-9 and abs(found - t) < 1e-9:
                break
            s, t = at, found
    # not converged (the ray meets an edge): sample the tool at rest, then golden section around the lowest
    best, at = math.inf, 0.0
    moments = STANDING_SAMPLES if hit else 2
    for i in range(moments):
        t = _standing_frustum(y, n, d, u0, du, a0, a1, r0, k, i / (moments - 1.0))
        if t < best:
            best, at = t, i / (moments - 1.0)
    if hit and best < math.inf:
        low, high = max(0.0, at - 1.0 / (moments - 1.0)), min(1.0, at + 1.0 / (moments - 1.0))
        while high - low > 1e-7:
            s1, s2 = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
            t1 = _standing_frustum(y, n, d, u0, du, a0, a1, r0, k, s1)
            t2 = _standing_frustum(y, n, d, u0, du, a0, a1, r0, k, s2)
            best = min(best, t1, t2)
            if t1 < t2:
                high = s2
            else:
                low = s1
    return best
