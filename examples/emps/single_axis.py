"""Identify a single axis with another control: P position, P speed on a drive voltage, one encoder, no current loop (EMPS benchmark).

    qf(k) = (q(k) + q(k-1)) / 2,  dq(k) = (qf(k) - qf(k-1)) / Ts,  u = clip(kv (kp (s - q) - dq), +-u_max)
    g u = m dv/dt + Fv v + Fc sign(v) + offset                       g: drive gain [N/V]

Regression: both sides filtered with a zero-phase fourth-order Butterworth, intervals by strokes. Re-simulation: one compiled loop, exact
between samples while the axis slides; the axis sticks while the force is below the friction. It is independent of the five-axis cascade.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import butter, sosfiltfilt

from twin.compiled_functions import compiled
from twin.errors import InputError
from twin.estimate.regression import Fit, regress

NAMES = ("mass", "viscous", "coulomb", "offset")
BAND_HZ = 50.0
SETTLED_SAMPLES = 60
"""First samples that do not count in the score: the record starts in motion, and the state between samples is unknown."""

VOLTAGE_LIMIT = 10.0


@dataclass(frozen=True)
class Record:
    """One run: time [s], set point and position [m], drive voltage [V]; gains kp [1/s], kv [V s/m], drive gain [N/V]."""

    time: np.ndarray
    setpoint: np.ndarray
    position: np.ndarray
    voltage: np.ndarray
    position_gain: float
    speed_gain: float
    drive_gain: float

    @property
    def period(self) -> float:
        return float(self.time[1] - self.time[0])


@dataclass(frozen=True)
class SingleFit:
    """Values of NAMES [kg, N s/m, N, N] with their fit and the relative error of the force [1]."""

    values: np.ndarray
    fit: Fit
    force_error: float
    residual: np.ndarray  # N
    speed: np.ndarray  # m/s
    position: np.ndarray  # m


@dataclass(frozen=True)
class Resimulated:
    """Closed-loop re-simulation: position [m], voltage [V], RMS of the position's difference [m], relative force error (raw, below 50 Hz)."""

    position: np.ndarray
    voltage: np.ndarray
    position_rms: float
    force_error: float
    force_error_filtered: float


def read_emps(path: str | Path) -> Record:
    """Read a record of the EMPS benchmark (MATLAB file with t, qg, qm, vir, kp, kv, gtau)."""
    from scipy.io import loadmat

    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the benchmark's DATA_EMPS.mat")
    try:
        data = loadmat(path)
        columns = [np.asarray(data[k], float).ravel() for k in ("t", "qg", "qm", "vir", "kp", "kv", "gtau")]
    except (ValueError, KeyError, NotImplementedError) as error:
        raise InputError(f"{path}: not an EMPS record ({error}); it must hold t, qg, qm, vir, kp, kv, gtau") from None
    return Record(*columns[:4], *(float(c[0]) for c in columns[4:]))  # type: ignore[arg-type]


def low_passed(values: np.ndarray, period: float, band_hz: float = BAND_HZ) -> np.ndarray:
    """Fourth-order Butterworth low-pass, forwards and backwards."""
    return sosfiltfilt(butter(4, band_hz, fs=1.0 / period, output="sos"), values)


def fit_single_axis(record: Record, band_hz: float = BAND_HZ) -> SingleFit:
    """Regression of the force on acceleration, speed, sign of the speed and 1; all columns have the same filter."""
    period = record.period

    def slope(x: np.ndarray) -> np.ndarray:
        return np.gradient(x, period)

    smooth = low_passed(record.position, period, band_hz)
    speed, acceleration = slope(smooth), slope(slope(smooth))
    columns = np.column_stack([low_passed(c, period, band_hz) for c in (acceleration, speed, np.sign(speed), np.ones_like(speed))])
    force = low_passed(record.drive_gain * record.voltage, period, band_hz)
    inside = slice(50, -50)
    strokes = np.cumsum(np.diff(np.sign(speed), prepend=0.0) != 0)[inside]
    fit = regress(columns[inside], force[inside], strokes)
    error = float(np.linalg.norm(fit.residual) / np.linalg.norm(force[inside]))
    return SingleFit(fit.values, fit, error, fit.residual, speed[inside], record.position[inside])


def resimulate(record: Record, values: np.ndarray, initial_speed: float | None = None) -> Resimulated:
    """Simulate the axis on the record's set points from its measured position and speed; the score starts after SETTLED_SAMPLES."""
    v0 = float(np.polyfit(record.time[:12] - record.time[0], record.position[:12], 2)[1]) if initial_speed is None else initial_speed
    mass, viscous, coulomb, offset = (float(v) for v in values)
    position, voltage = _advance(
        record.setpoint, record.period, record.position_gain, record.speed_gain, record.drive_gain, mass, viscous, coulomb, offset,
        float(record.position[0]), v0, VOLTAGE_LIMIT,
    )  # fmt: skip
    kept = slice(SETTLED_SAMPLES, None)
    difference = (position - record.position)[kept]
    force = [float(np.linalg.norm(a - b) / max(float(np.linalg.norm(b)), 1e-12)) for a, b in _forces(record, voltage, kept)]
    return Resimulated(position, voltage, float(np.sqrt(np.mean(difference**2))), force[0], force[1])


def refine_single_axis(record: Record, start: np.ndarray) -> np.ndarray:
    """The second route: values with the smallest closed-loop gap of the force (voltage) below the band."""

    def residual(factors: np.ndarray) -> np.ndarray:
        voltage = resimulate(record, start * factors).voltage
        return low_passed(voltage - record.voltage, record.period, BAND_HZ)[SETTLED_SAMPLES:]

    found = least_squares(residual, np.ones(4), diff_step=1e-3, xtol=1e-7)
    return start * found.x


def residual_shapes(fit: SingleFit, period: float) -> dict[str, float]:
    """Shapes that remain in the residual -> share of its variance, from a regression on one additional shape at a time."""
    v, q = fit.speed, fit.position
    shapes: dict[str, list[np.ndarray]] = {
        "Stribeck excess (5 mm/s)": [np.exp(-((v / 5e-3) ** 2)) * np.sign(v)],
        "Stribeck excess (20 mm/s)": [np.exp(-((v / 20e-3) ** 2)) * np.sign(v)],
        "viscous friction by direction": [np.abs(v)],
        "friction growing as v|v|": [v * np.abs(v)],
        "slope over the travel": [q],
        "friction over the travel": [q * np.sign(v), q**2 * np.sign(v)],
    }
    variance = float(np.sum(fit.residual**2))
    base, _ = np.linalg.qr(np.column_stack([np.gradient(v, period), v, np.sign(v), np.ones_like(v)]))

    def beside(x: np.ndarray) -> np.ndarray:
        """Component of x orthogonal to the columns of the law."""
        return x - base @ (base.T @ x)

    unexplained = beside(fit.residual)

    def explained(columns: list[np.ndarray]) -> float:
        more = beside(np.column_stack(columns))
        left = unexplained - more @ np.linalg.lstsq(more, unexplained, rcond=None)[0]
        return 1.0 - float(left @ left) / variance

    out = {name: explained(columns) for name, columns in shapes.items()}
    best = max(
        ((explained([np.sin(2 * np.pi * q / p), np.cos(2 * np.pi * q / p)]), p) for p in np.geomspace(1e-3, 0.2, 400)), default=(0.0, 0.0)
    )
    out[f"periodic in position, {best[1] * 1e3:.2f} mm"] = best[0]
    out["lags outside the white band"] = coloured(fit.residual)
    return out


def coloured(residual: np.ndarray, lags: int = 40) -> float:
    """Share of the lags of the autocorrelation outside the 95 % band of white noise (0.05 for white noise)."""
    e, n = residual - residual.mean(), len(residual)
    correlation = np.array([np.dot(e[: n - k], e[k:]) for k in range(1, lags + 1)]) / np.dot(e, e)
    return float(np.mean(np.abs(correlation) > 1.96 / np.sqrt(n)))


def _forces(record: Record, voltage: np.ndarray, kept: slice) -> list[tuple[np.ndarray, np.ndarray]]:
    g = record.drive_gain
    filtered = [low_passed(g * x, record.period, BAND_HZ)[kept] for x in (voltage, record.voltage)]
    return [(g * voltage[kept], g * record.voltage[kept]), (filtered[0], filtered[1])]


@compiled(allocates=True)
def _advance(s, h, kp, kv, g, mass, viscous, coulomb, offset, q0, v0, limit):  # type: ignore[no-untyped-def]
    """Positions and voltages at the samples. Between samples the force is held, and the axis follows the exact solution or sticks."""
    n = len(s)
    position, voltage = np.empty(n), np.empty(n)
    q, v = q0, v0
    before, earlier = q0 - h * v0, q0 - 2.0 * h * v0
    for k in range(n):
        dq = (0.5 * (q + before) - 0.5 * (before + earlier)) / h
        u = min(max(kv * (kp * (s[k] - q) - dq), -limit), limit)
        position[k], voltage[k] = q, u
        earlier, before = before, q
        drive = g * u - offset
        left = h
        for _ in range(4):
            if v == 0.0:
                if abs(drive) <= coulomb:
                    break
                direction = math.copysign(1.0, drive)
            else:
                direction = math.copysign(1.0, v)
            # v' = (f - b v) / m with constant f: v -> f/b
            f = drive - coulomb * direction
            rate = viscous / mass
            final = f / viscous
            decay = math.exp(-rate * left)
            ahead = final + (v - final) * decay
            if ahead * direction >= 0.0:
                q += final * left + (v - final) * (1.0 - decay) / rate
                v = ahead
                break
            # the axis stops within the step: advance to the stop, then decide again
            stop = math.log((v - final) / (-final)) / rate
            q += final * stop + (v - final) * (1.0 - math.exp(-rate * stop)) / rate
            v = 0.0
            left -= stop
    return position, voltage
