"""A sparse regression of the residual force (SINDy) with `pysindy`, as its authors advise.

The force that the machine file does not explain, along the recorded motion, against a library of terms; both sides with the same zero-phase
low-pass filter, columns normalised, sequentially thresholded least squares on bagged samples (`EnsembleOptimizer`), the threshold from the
second half of the record. Its intervals are the spread over the bags. Terms kept beyond the four numbers of the axis are its causes.
"""

from __future__ import annotations

import numpy as np

from twin.machine.machine import Axis
from twin.recordings.campaign import MeasuredRun

from .answer import Answer
from .inputs import Input
from .numbers import MECHANICS, drive_force, motor_motion, numbers_of, with_numbers

BAND_HZ = 50.0
SLOW = 4e-3
"""Speed [m/s, rad/s] at which the Stribeck term fades."""
BAGS = 20
THRESHOLDS = (0.02, 0.05, 0.1, 0.2)
"""A term is dropped if it is smaller than this share of the largest normalised term; the second half of the record chooses."""

CAUSES = {
    "|v|": "viscous_asymmetry",
    "v|v|": "friction as v|v|",
    "stribeck": "stribeck",
    "sin turn": "torque_ripple",
    "cos turn": "torque_ripple",
    "q": "force over the travel",
}


def columns_of(axis: Axis, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> dict[str, np.ndarray]:
    """The library: the four numbers of the axis first."""
    turn, sign = q / axis.ratio, np.tanh(v / 1e-3)
    return {
        "inertia": a, "coulomb_friction": sign, "viscous_friction": v, "constant_force": np.ones_like(v),
        "|v|": np.abs(v), "v|v|": v * np.abs(v), "stribeck": sign * np.exp(-np.abs(v) / SLOW), "q": q,
        "sin turn": np.sin(turn), "cos turn": np.cos(turn),
    }  # fmt: skip


def force_rows(axis: Axis, run: MeasuredRun, start: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Residual force (sample,) and library (sample, term) of a run, filtered alike, every tenth sample."""
    from scipy.signal import butter, sosfiltfilt

    sos = butter(4, BAND_HZ, fs=1.0 / run.trace.period, output="sos")
    q = sosfiltfilt(sos, motor_motion(axis, run.trace))
    v = np.gradient(q, run.trace.period)
    library = columns_of(axis, q, v, np.gradient(v, run.trace.period))
    force = drive_force(axis, run.trace)
    if axis.effort == "voltage":  # a command is held for the cycle that begins: half a cycle later than the position
        force = 0.5 * (force + np.roll(force, 1))
    force = force - sum(start[n] * library[n] for n in MECHANICS)
    kept = slice(100, -100, 10)
    return sosfiltfilt(sos, force)[kept], sosfiltfilt(sos, np.column_stack(list(library.values())), axis=0)[kept]


def sindy_fit(one: Input) -> Answer:
    """Corrections of the four numbers and further terms, by sparse regression."""
    import pysindy

    (axis,) = one.machine.axes
    start = numbers_of(one.machine)
    rows = [force_rows(axis, run, start) for run in one.fitted]
    force, library = np.concatenate([r[0] for r in rows]), np.concatenate([r[1] for r in rows])
    names = list(columns_of(axis, *np.zeros((3, 1))))
    size, scale = np.sqrt(np.mean(library**2, axis=0)), float(np.std(force))
    half = len(force) // 2
    tried = []
    for threshold in THRESHOLDS:
        optimizer = pysindy.EnsembleOptimizer(pysindy.STLSQ(threshold=threshold, alpha=1e-6), bagging=True, n_models=BAGS)
        optimizer.fit(library[:half] / size, force[:half, None] / scale)
        left = force[half:] / scale - library[half:] / size @ np.median(optimizer.coef_list, axis=0)[0]
        tried.append((float(left @ left), threshold))
    optimizer = pysindy.EnsembleOptimizer(pysindy.STLSQ(threshold=min(tried)[1], alpha=1e-6), bagging=True, n_models=BAGS)
    optimizer.fit(library / size, force[:, None] / scale)
    bags = np.array(optimizer.coef_list)[:, 0, :] * scale / size
    found = dict(zip(names, np.median(bags, axis=0).tolist()))
    low, high = np.percentile(bags, [2.5, 97.5], axis=0)
    intervals = {n: tuple(start[n] + d for d in (found[n], low[i], high[i])) for i, n in enumerate(MECHANICS)}
    more = {n: c for n, c in found.items() if n not in MECHANICS and c != 0.0}

    def load(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        terms = columns_of(axis, q, v, a)
        return sum((c * terms[n] for n, c in more.items()), np.zeros_like(v))

    left = force - library @ np.array([found[n] for n in names])
    said = f"explains {100 * (1 - float(left @ left) / float(force @ force)):.0f} % of the residual force"
    machine = with_numbers(one.machine, {n: intervals[n][0] for n in MECHANICS})
    return Answer(machine, intervals, said, tuple(sorted({CAUSES[n] for n in more})), load if more else None)


sindy_fit.written_by_user = (columns_of, force_rows, sindy_fit)  # type: ignore[attr-defined]
