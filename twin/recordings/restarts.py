"""Files with several recordings one below the other: the time starts again in each part."""

from __future__ import annotations

import numpy as np

PAUSE_S = 1.0
"""Gap [s] inserted between two parts, which splits the run. The file does not give the real pause."""
AT_LEAST = 20
"""Fewest samples of a part. If the time goes back sooner, the file is damaged and is refused."""


class Restarts:
    """Makes the times of consecutive blocks increase across restarts. `count`: number of restarts so far.

    The time restarts where it returns to the first time of the file or to zero, within one interval. A file that was cut begins in the middle of
    its first part.
    """

    def __init__(self) -> None:
        self.count = 0
        self._first = self._interval = self._last = np.nan
        self._shift = 0.0
        self._since = 0

    def __call__(self, time: np.ndarray) -> np.ndarray:
        """Corrected times (sample,) [s] of the next block."""
        if np.isnan(self._first) and len(time) > 1:
            self._first, self._interval = float(time[0]), abs(float(time[1] - time[0]))
        if np.isnan(self._first):
            return time
        before = np.concatenate([[self._last if np.isfinite(self._last) else time[0]], time[:-1]])
        at_start = np.minimum(np.abs(time - self._first), np.abs(time)) <= 1.001 * self._interval
        anew = np.flatnonzero((time < before) & at_start)
        out = time.copy()
        begin = -self._since
        for row in anew:
            if row - begin >= AT_LEAST:
                shift = float(before[row]) + self._shift + max(PAUSE_S, 10.0 * self._interval) - float(time[row])
                out[begin if begin > 0 else 0 : row] = time[begin if begin > 0 else 0 : row] + self._shift
                self._shift, begin = shift, int(row)
                self.count += 1
        out[max(begin, 0) :] = time[max(begin, 0) :] + self._shift
        self._last, self._since = float(time[-1]), len(time) - begin
        return out
