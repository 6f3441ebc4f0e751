"""Noise of each sensor of an axis, from its records. The diagnosis, the gap and the identification use it in place of the machine file's.

The quiet stretches of a record show the white noise of a signal (`white_variance`). It is not that of its sensor alone, because the control
passes noise on: the current follows the noise of the speed, the speed that of the encoder which closes the position loop. How much depends
on gains, cycles and on which encoder closes the loop. The twin derives it: each run simulated with noise in one sensor at a time gives the
variance of every recorded signal in its quiet stretches. (A simulated standstill instead makes the speed noise of a rotary axis up to 37 % too large.)

    v = A s     v (signal,) recorded variances, s (sensor,) >= 0 variances of the sensors, A (signal, sensor) from the twin
    s = s_white + step^2 / 12       step: grid of the recorded values, the resolution of the encoder unless the file gives a finer one
A signal without visible white noise (noise-free, or hidden in its own steps) keeps the noise of the machine file.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import math

import numpy as np
from scipy.optimize import nnls

from twin.control.number import si_from_key
from twin.machine import keys
from twin.machine.machine import Axis, Machine, Noise
from twin.recordings.campaign import MeasuredRun
from twin.recordings.roughness import quiet_noise, step_of
from twin.recordings.trace import Trace
from twin.simulation.nominal_motion import recorded_job
from twin.simulation.prepared import SILENT
from twin.simulation.recorded_times import as_recorded
from twin.simulation.run import all_or_raise, simulate_each
from twin.system import cores
from twin.units import AXIS_UNITS, plain

UNIT = {"position": 1e-8, "motor": 1e-8, "speed": 1e-5, "current": 1e-2}
"""Noise of a sensor in a simulated run, SI: so small that a sticking axis keeps sticking."""

STEP = {"position": "position_resolution", "motor": "motor_resolution"}

MOST_SAMPLES = 60_000
"""Samples of a run that are used, from its start: a minute at 1 kHz."""

ENOUGH = 30
"""Runs of a signal that are used: the median of a thousand is that of thirty."""

AGREES = 1.5
"""Recorded and given noise that differ by a smaller factor agree: no note is given."""


def with_recorded_noise(machine: Machine, runs: Sequence[MeasuredRun]) -> tuple[Machine, list[str]]:
    """The machine with the noise of its axes in these runs, and one note for each kind of sensor whose noise the file does not give or gives otherwise."""
    found, _ = _found(machine, runs)
    return machine.with_noise(found), _notes(machine, found)


def _found(machine: Machine, runs: Sequence[MeasuredRun]) -> tuple[dict[str, Noise], dict[str, dict[str, float]]]:
    """Noise of each axis, and the variances of its sensors that the records show: medians over the runs, since a fault is louder in some of them."""
    with ThreadPoolExecutor(cores()) as pool:
        by_run = list(pool.map(lambda run: _variances(machine, run), _enough(machine, runs)))
    found, seen = {}, {}
    for axis in machine.axes:
        seen[axis.name] = {s: float(np.median(v)) for s in UNIT if (v := [of[axis.name, s] for of in by_run if (axis.name, s) in of])}
        steps = {
            s: max((step_of(run.trace.get(axis.name, of[s])) for run in runs if s in (of := _signals(axis, run))), default=0.0)
            for s in UNIT
        }
        found[axis.name] = _noise_of(machine.noise(axis), seen[axis.name], steps)
    return found, seen


def _enough(machine: Machine, runs: Sequence[MeasuredRun]) -> list[MeasuredRun]:
    """Runs, in an order without meaning, of which each has a signal that fewer than ENOUGH others have."""
    kept, known = [], Counter[tuple[str, str]]()
    for i in np.random.default_rng(0).permutation(len(runs)):
        signals = [(axis.name, sensor) for axis in machine.axes for sensor in _signals(axis, runs[i])]
        if any(known[signal] < ENOUGH for signal in signals):
            kept.append(runs[i])
            known.update(signals)
    return kept


def measurement_values(machine: Machine, runs: Sequence[MeasuredRun]) -> dict[str, float]:
    """Noise keys of `[measurement]`, in file units: the RMS over the axes of one kind, as far as the records show it."""
    squares: dict[str, list[float]] = {}
    found, seen = _found(machine, runs)
    for axis in machine.axes:
        for sensor in seen[axis.name]:
            key = keys.NOISE[axis.kind][sensor]
            value, step = getattr(found[axis.name], sensor), getattr(machine.noise(axis), STEP.get(sensor, sensor))
            # rounding hides noise: none is found only where the file gives the step of the rounding
            if (sensor != "motor" or axis.encoder == "motor") and max(value, step) > 0.0:
                squares.setdefault(key, []).append(value**2)
    return {key: float(f"{math.sqrt(np.mean(of)) / si_from_key(key):.4g}") for key, of in squares.items()}


def _signals(axis: Axis, run: MeasuredRun) -> dict[str, str]:
    """Recorded signals by sensor; the position that a ballbar measured is not that of the scale."""
    by_bar = run.ballbar is not None and axis.name in run.ballbar.axes
    signals = {"position": "position", "motor": "motor_position", "speed": "velocity", "current": axis.effort}
    return {s: key for s, key in signals.items() if run.trace.has(axis.name, key) and not (by_bar and s == "position")}


def _variances(machine: Machine, run: MeasuredRun) -> dict[tuple[str, str], float]:
    """Variance of each sensor (axis, sensor) in one run, with its quantisation, as far as its signal shows white noise.

    A signal that does not contain the noise of its sensor shows none, such as the voltage command of an axis. A recorded current or torque has noise
    of its own also where the machine has no current loop.
    """
    run = replace(run, trace=run.trace.samples(slice(MOST_SAMPLES)))
    silent, *noisy = _simulated(machine, run)
    out: dict[tuple[str, str], float] = {}
    for axis in machine.axes:
        signals = _signals(axis, run)
        levels = {s: quiet_noise(run.trace.get(axis.name, key) - silent.get(axis.name, key)) for s, key in signals.items()}
        gains = {
            s: [quiet_noise(trace.get(axis.name, key) - silent.get(axis.name, key))[0] / u**2 for u, trace in zip(UNIT.values(), noisy)]
            for s, key in signals.items()
        }
        if "current" in gains and axis.effort_has_noise and not axis.actuator.winding:
            gains["current"][list(UNIT).index("current")] = 1.0
        seen = {s: level for s, (level, white) in levels.items() if white and level > 0.0 and gains[s][list(UNIT).index(s)] > 0.0}
        if not seen:
            continue
        a = np.array([gains[s] for s in seen])
        own = [list(UNIT).index(s) for s in seen]
        others = [i for i in range(len(UNIT)) if i not in own]
        known = np.array([machine.noise(axis).total(s) ** 2 for s in UNIT])
        v = np.array(list(seen.values()))
        left = np.maximum(v - a[:, others] @ known[others], 0.0)
        out |= {(axis.name, s): float(x * y) for s, x, y in zip(seen, nnls(a[:, own] * v / v[:, None], left / v)[0], v)}
    return out


def _simulated(machine: Machine, run: MeasuredRun) -> list[Trace]:
    """A run without noise, then with noise of UNIT in one sensor at a time, at the times of its record."""
    job = recorded_job(machine, run, noise_seed=0)
    sensed = [SILENT, *(replace(SILENT, **{sensor: size}) for sensor, size in UNIT.items())]
    jobs = [job._replace(machine=job.machine.with_noise(dict.fromkeys(machine.axis_names, noise))) for noise in sensed]
    return [as_recorded(simulated.trace, run.trace.time, run.ballbar) for simulated in all_or_raise(simulate_each(jobs))]


def _noise_of(given: Noise, seen: Mapping[str, float], steps: Mapping[str, float]) -> Noise:
    """Noise from the variances that the record shows and the steps of its values; the given noise counts where it shows none."""
    numbers = vars(given).copy()
    for sensor, step in steps.items():
        square = max(seen.get(sensor, 0.0), step**2 / 12.0)
        if (key := STEP.get(sensor)) is not None:
            if not numbers[key] or (numbers[key] > 1.01 * step if step else sensor in seen and numbers[key] ** 2 / 12.0 > square):
                numbers[key] = step
            square -= numbers[key] ** 2 / 12.0
        if sensor in seen:
            numbers[sensor] = math.sqrt(max(square, 0.0))
        elif step:  # the noise is hidden in the steps
            numbers[sensor] = (min if sensor in STEP else max)(numbers[sensor], step / math.sqrt(12.0))
    return Noise(**numbers)


def _notes(machine: Machine, found: Mapping[str, Noise]) -> list[str]:
    words = {"position": "scale", "motor": "motor encoder", "speed": "speed", "current": "current"}
    notes = []
    for sensor, word in words.items():
        parts = []
        for axis in machine.axes:
            given, seen = machine.noise(axis).total(sensor), found[axis.name].total(sensor)
            if seen == given or (given > 0.0 and 1.0 / AGREES < seen / given < AGREES):
                continue
            units = AXIS_UNITS[axis.kind]
            unit, factor = {"speed": units.speed, "current": (axis.effort_unit, 1.0)}.get(sensor, units.error)
            parts.append(
                f"{axis.name} {plain(seen * factor, 2)} {unit}" + (f" (machine file: {plain(given * factor, 2)})" if given else "")
            )
        if parts:
            notes.append(f"noise of the {word} is taken from the record: {', '.join(parts)}")
    return notes
