"""Unlisted filters of a control block: measured as a frequency response, identified as first-order lag, notch or dead time.

U is the nominal output of the block, Y the recorded one, as Fourier transforms of complete runs that begin and end at rest.

    H = sum(conj(U) Y / S) / sum(|U|^2 / S)         S: power of the noise and of the model error of U

is the measured response. The residual of a filter F with a free gain g of the block is sum(|Y - g F U|^2 / S). Each run
is left out in turn and predicted by the filter fitted to the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import itertools
import math

import numpy as np
from scipy.optimize import minimize

from twin.diagnose.law.measure import MeasuredCurve
from twin.diagnose.law.relations import Relation
from twin.diagnose.law.residual import ControllerRun, Samples
from twin.diagnose.law.shapes import Described
from twin.diagnose.settings import T
from twin.effects.law import Law, cycle_of
from twin.effects.law_filters import RING, response
from twin.effects.law_shapes import SHAPES, Shape
from twin.machine.machine import Machine

BAND_HZ = 1.0
"""Width of the frequency bands. The first band is omitted; it contains integrators and drift."""

LEAST_S = 1.0
"""Shortest evaluated run."""

HIGHEST = 0.9
"""Highest evaluated frequency as a fraction of the Nyquist frequency."""

STANDS_OUT = 30.0
"""Smallest signal-to-noise power ratio of a band whose response is shown."""

RESPONSE_POINTS = 40
"""Number of points of a measured response."""

PLACES = {
    "current": (
        (Relation("speed controller", "current", "current_setpoint"), ("notch", "dead time")),
        (Relation("measurement", "current", "current"), ("dead time",)),
    ),
    "received_speed": ((Relation("position controller", "received_speed", "speed_setpoint"), ("lag", "dead time")),),
    "speed": ((Relation("position controller", "speed", "speed_setpoint"), ("lag", "dead time")),),
    "torque": ((Relation("current loop", "torque", "current"), ("lag",)),),
}
"""Candidates of filters by output. A lag of the current set point is not among them, because it is an effect
of the library."""


@dataclass(frozen=True)
class _SpectralSums:
    """Sums over one run in each band: |U|^2 / S, conj(U) Y / S, |Y|^2 / S."""

    own: np.ndarray
    cross: np.ndarray
    given: np.ndarray


def filters_of(samples: Samples, machine: Machine) -> list[Described]:
    """Filters that explain a control block, best first; empty if the block has no recorded signal or the record is too short."""
    found = []
    for output in dict.fromkeys(p.output for p in samples.passed):
        passed = [p for p in samples.passed if p.output == output]
        highest = min(HIGHEST * 0.5 / passed[0].period, passed[0].highest_hz)
        bands = np.arange(1, max(int(highest / BAND_HZ), 3))
        runs = [lines for p in passed if len(p.wanted) * p.period > LEAST_S and (lines := _spectral_sums(p, bands)) is not None]
        if len(runs) < 2:
            continue
        for relation, names in PLACES[output]:
            for name in names:
                law = Law(relation.block, relation.output, relation.variable, SHAPES[name])
                found.append(_fit_filter(samples, relation, law.shape, cycle_of(law, machine), runs, (bands + 0.5) * BAND_HZ))
    return sorted(found, key=lambda d: -d.predicts)


def _spectral_sums(passed: ControllerRun, bands: np.ndarray) -> _SpectralSums | None:
    """Transforms of one run, summed in bands; None if the block had no input."""
    count = len(passed.wanted)
    u, y = (np.fft.rfft(values - passed.wanted[0]) for values in (passed.wanted, passed.given))
    power = passed.noise**2 * count + (T.doubt * np.abs(u)) ** 2
    if not np.any(np.abs(u[1:]) ** 2 > power[1:]):
        return None
    of = np.floor(np.fft.rfftfreq(count, passed.period) / BAND_HZ).astype(int)
    keep = (of >= bands[0]) & (of <= bands[-1])

    def summed(values: np.ndarray) -> np.ndarray:
        return np.bincount(of[keep] - bands[0], (values / power)[keep], len(bands))

    cross = np.conj(u) * y
    return _SpectralSums(summed(np.abs(u) ** 2), summed(cross.real) + 1j * summed(cross.imag), summed(np.abs(y) ** 2))


def _loss(runs: Sequence[_SpectralSums], f: np.ndarray) -> tuple[float, float]:
    """Residual of a filter (frequency,) with its optimal gain, and that gain."""
    cross = sum(float(np.sum((np.conj(f) * r.cross).real)) for r in runs)
    own = sum(float(np.sum(np.abs(f) ** 2 * r.own)) for r in runs)
    gain = cross / max(own, 1e-300)
    return sum(float(r.given.sum()) for r in runs) - gain * cross, gain


def _run_loss(run: _SpectralSums, f: np.ndarray, gain: float) -> float:
    """Residual of a filter with a gain in one run."""
    return float(np.sum(run.given - 2.0 * gain * (np.conj(f) * run.cross).real + gain**2 * np.abs(f) ** 2 * run.own))


def _fit_filter(
    samples: Samples, relation: Relation, shape: Shape, cycle: float, runs: Sequence[_SpectralSums], frequency: np.ndarray
) -> Described:
    """One filter, fitted to all runs and cross-validated run by run."""
    names = [n.name for n in shape.numbers]
    starts, low, high = _starts(shape, cycle, frequency)

    def of(logs: np.ndarray) -> np.ndarray:
        return response(shape, dict(zip(names, np.exp(np.clip(logs, low, high)))), cycle, frequency)

    def fit(some: Sequence[_SpectralSums], start: np.ndarray) -> np.ndarray:
        simplex = np.vstack([start, start + 0.2 * np.eye(len(names))])
        options = {"initial_simplex": simplex, "maxfev": 80 * len(names), "xatol": 1e-4}
        found = minimize(lambda logs: _loss(some, of(logs))[0], start, method="Nelder-Mead", options=options)
        return np.asarray(np.clip(found.x, low, high))

    best = fit(runs, min(starts, key=lambda logs: _loss(runs, of(logs))[0]))
    through = np.ones(len(frequency), complex)
    of_run, base = np.zeros(len(runs)), np.zeros(len(runs))
    for i, run in enumerate(runs):
        others = [*runs[:i], *runs[i + 1 :]]
        logs = fit(others, best)
        of_run[i] = _run_loss(run, of(logs), _loss(others, of(logs))[1])
        base[i] = _run_loss(run, through, _loss(others, through)[1])
    predicts = 1.0 - of_run.sum() / max(base.sum(), 1e-300)
    better = float(base[of_run < base].sum() / max(base.sum(), 1e-300))
    numbers = {n: float(math.exp(v)) for n, v in zip(names, best)}
    curve = _measured_response(relation, runs, frequency, predicts, better)
    return Described(relation, shape.name, numbers, predicts, curve, np.zeros(len(samples)))


def _starts(shape: Shape, cycle: float, frequency: np.ndarray) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Logarithms of the start values and of their bounds."""
    slowest = 0.5 / frequency[0]
    if shape.name == "notch":
        # order of the parameters as in the shape: width, frequency
        at = np.geomspace(2.0 * frequency[0], frequency[-1], 30)
        widths = (0.1, 0.4, 1.2)
        starts = [np.log([w, f]) for w, f in itertools.product(widths, at)]
        return starts, np.log([0.02, frequency[0]]), np.log([5.0, frequency[-1]])
    longest = min(slowest, (RING - 3) * cycle) if shape.name == "dead time" else slowest
    times = np.geomspace(0.5 * cycle, 0.5 * longest, 16)
    return [np.log([t]) for t in times], np.log([0.1 * cycle]), np.log([longest])


def _measured_response(
    relation: Relation, runs: Sequence[_SpectralSums], frequency: np.ndarray, predicts: float, better: float
) -> MeasuredCurve:
    """Magnitude of the measured response over frequency [Hz] in bands above noise. The standard deviation includes noise and the scatter between
    runs."""
    edges = np.geomspace(frequency[0], frequency[-1] * 1.0001, RESPONSE_POINTS + 1)
    x, y, band = [], [], []
    for low, high in itertools.pairwise(edges):
        rows = (frequency >= low) & (frequency < high)
        own = np.array([r.own[rows].sum() for r in runs])
        if not rows.any() or own.sum() < STANDS_OUT * rows.sum() * len(runs):
            continue
        of_run = np.array([r.cross[rows].sum() for r in runs]) / np.maximum(own, 1e-300)
        share = own / own.sum()
        mean = complex(share @ of_run)
        x.append(float(np.mean(frequency[rows])))
        y.append(abs(mean))
        band.append(math.sqrt(1.0 / own.sum() + float(share**2 @ np.abs(of_run - mean) ** 2)))
    return MeasuredCurve(relation, predicts, better, np.array(x), np.array(y), np.array(band))
