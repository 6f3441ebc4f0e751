"""The strongest vibration in what a regression leaves: frequency, amplitude, and whether it exceeds its own background.

The periodogram is averaged over pieces of the strokes. Under the hypothesis of no line, the power of a bin over its local background follows
chi squared with two degrees of freedom for each piece, divided by their number. A line is reported if its power has a probability below
LEVEL in any of the bins.
"""

from dataclasses import dataclass

import numpy as np

LEVEL = 1e-4
"""Probability of a line where there is none, over all bins."""
LONGEST = 512
"""Most samples of a piece."""
SHORTEST = 32
BACKGROUND = 15
"""Bins whose median is the background of their middle."""
LOWEST_BIN = 3
"""Slower waves are drifts of the residual, not vibrations."""


@dataclass(frozen=True)
class Line:
    """A vibration: frequency [Hz], amplitude in the unit of `signal` (SI)."""

    frequency: float
    amplitude: float
    signal: str


def strongest_line(values: np.ndarray, stroke: np.ndarray, period: float, signal: str) -> Line | None:
    """The strongest line of values (row,) whose rows belong to strokes (row,); None if nothing exceeds the background."""
    from scipy.ndimage import median_filter
    from scipy.stats import chi2

    lengths = np.bincount(np.unique(stroke, return_inverse=True)[1])
    size = min(LONGEST, 1 << int(np.log2(max(int(np.median(lengths)), 1))))
    if size < SHORTEST:
        return None
    window = np.hanning(size)
    pieces = [own[i : i + size] for s in np.unique(stroke) for own in [values[stroke == s]] for i in range(0, len(own) - size + 1, size)]
    if not pieces:
        return None
    x = np.arange(size)
    powers = []
    for piece in pieces:
        smooth = np.polyval(np.polyfit(x, piece, 2), x)
        powers.append(np.abs(np.fft.rfft((piece - smooth) * window)) ** 2)
    power = np.mean(powers, axis=0)[LOWEST_BIN:]
    if len(power) <= BACKGROUND or not power.any():
        return None
    # the median of chi squared over its mean turns the local median into a local mean
    freedom = 2 * len(pieces)
    background = median_filter(power, BACKGROUND, mode="nearest") * freedom / chi2.median(freedom)
    ratio = power / np.maximum(background, 1e-300)
    best = int(np.argmax(ratio))
    if chi2.sf(freedom * ratio[best], freedom) * len(power) > LEVEL:
        return None
    # a Hann window spreads a line over three bins
    around = slice(max(best - 1, 0), best + 2)
    amplitude = 2.0 * np.sqrt(max(float((power[around] - background[around]).sum()), 0.0) / (1.5 * window.sum() ** 2))
    frequencies = np.fft.rfftfreq(size, period)[LOWEST_BIN:]
    return Line(float(np.average(frequencies[around], weights=power[around])), float(amplitude), signal)
