"""Files with several recordings one below the other: the time starts again in each part."""

from __future__ import annotations

import numpy as np

PAUSE_S = 1.0
"""Gap [s] inserted between two parts, which splits the run. The file does not give the real pause."""
RUNS_ON = 3.0
"""After a true restart the next step forwards is at most this many intervals; after a damaged row it leads back to where the time was."""


class Restarts:
    """Makes the times of consecutive blocks increase across restarts. `count`: number of restarts so far.

    The time starts again where it goes back and then runs on in steps of the interval. A part has two rows or more. At the end of a block, where the next
    step is not known, a return to zero or to the first time of the file decides.
    """

    def __init__(self) -> None:
        self.count = 0
        self._first = self._interval = self._last = np.nan
        self._shift = 0.0

    def __call__(self, time: np.ndarray) -> np.ndarray:
        """Corrected times (sample,) [s] of the next block."""
        if np.isnan(self._first) and len(time) > 1:
            forwards = np.diff(time[: 1 << 12])
            forwards = forwards[forwards > 0.0]
            self._first, self._interval = float(time[0]), float(np.median(forwards)) if len(forwards) else np.nan
        if not np.isfinite(self._interval):
            return time
        before = np.concatenate([[self._last if np.isfinite(self._last) else time[0]], time[:-1]])
        after = np.concatenate([np.diff(time), [np.nan]])
        at_start = np.minimum(np.abs(time - self._first), np.abs(time)) <= 1.001 * self._interval
        runs_on = np.where(np.isnan(after), at_start, (after > 0.0) & (after <= RUNS_ON * self._interval))
        out = time + self._shift
        for row in np.flatnonzero((time < before) & runs_on):
            self._shift += float(before[row] - time[row]) + max(PAUSE_S, 10.0 * self._interval)
            out[row:] = time[row:] + self._shift
            self.count += 1
        self._last = float(time[-1])
        return out
