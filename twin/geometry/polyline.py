"""Douglas-Peucker simplification of a path, or of several points that move together, compiled."""

from __future__ import annotations

from twin.compiled_functions import compiled


@compiled(allocates=True)
def keep_shape(points, tolerance, keep):  # type: ignore[no-untyped-def]
    """Mark in `keep` (n,) the rows of `points` (n, 3 k) that represent the paths of k points within a tolerance.

    A row may be dropped if one common fraction of the straight move between the neighbouring kept rows brings all k points within the
    tolerance. Rows already marked stay and split the problem, which bounds the search.
    """
    n, columns = points.shape
    keep[0] = True
    keep[n - 1] = True
    stack = [(0, 0)]
    stack.pop()
    before = 0
    for i in range(1, n):
        if keep[i]:
            stack.append((before, i))
            before = i
    while len(stack) > 0:
        first, last = stack.pop()
        length = 0.0
        for c in range(columns):
            length += (points[last, c] - points[first, c]) ** 2
        worst = tolerance * tolerance
        at = -1
        for i in range(first + 1, last):
            part = 0.0
            if length > 0.0:
                for c in range(columns):
                    part += (points[i, c] - points[first, c]) * (points[last, c] - points[first, c])
                part = min(1.0, max(0.0, part / length))
            for start in range(0, columns, 3):
                square = 0.0
                for c in range(start, start + 3):
                    square += (points[i, c] - points[first, c] - part * (points[last, c] - points[first, c])) ** 2
                if square > worst:
                    worst = square
                    at = i
        if at >= 0:
            keep[at] = True
            stack.append((first, at))
            stack.append((at, last))
