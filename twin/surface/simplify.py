"""Which poses of a motion may be left out: a compiled Douglas-Peucker on two points of the tool at once."""

from __future__ import annotations

from numba import njit


@njit(cache=True, nogil=True)
def keep_motion(points, tolerance, keep):  # type: ignore[no-untyped-def]
    """Mark in `keep` (n,) the rows of `points` (n, 6; two points of the tool) that hold both ways within a tolerance.

    A row may be left out if one and the same part of the straight motion between the kept rows brings both of its points
    within the tolerance. The search for the worst row is bounded: pieces are at most MOST rows long.
    """
    n = len(points)
    keep[0] = True
    keep[n - 1] = True
    most = 512
    for start in range(0, n - 1, most):
        stack = [(start, min(start + most, n - 1))]
        keep[start] = True
        while len(stack) > 0:
            first, last = stack.pop()
            length = 0.0
            for c in range(6):
                length += (points[last, c] - points[first, c]) ** 2
            worst = tolerance * tolerance
            at = -1
            for i in range(first + 1, last):
                part = 0.0
                if length > 0.0:
                    for c in range(6):
                        part += (points[i, c] - points[first, c]) * (points[last, c] - points[first, c])
                    part = min(1.0, max(0.0, part / length))
                for half in range(2):
                    square = 0.0
                    for c in range(3 * half, 3 * half + 3):
                        square += (points[i, c] - points[first, c] - part * (points[last, c] - points[first, c])) ** 2
                    if square > worst:
                        worst = square
                        at = i
            if at >= 0:
                keep[at] = True
                stack.append((first, at))
                stack.append((at, last))
