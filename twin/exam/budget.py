"""The true budget of a case: the change of the second plant's signals when one effect is removed.

A row has the form of the recorded campaigns' budget.json: effect, axis, `times_noise` and `true_position_rms`.
    times_noise         RMS change of position, motor position and current over all axes and runs when this effect alone is
                        removed, as a multiple of the measuring noise of that signal, RMS over the runs, as `diagnosis.json` counts
    true_position_rms   RMS change of the true load position of its axis over all runs [m or rad]
Both are simulated without noise and rounding. The current counts only while the set point moves: the current of a sticking axis
depends on its history.

Axes that do not act on each other share a simulation: it removes one effect from each group of coupled axes and reads only the
signals of that group. A and C form one group (they share a mass matrix), as do axes joined by a coupling effect.
"""

from collections.abc import Sequence
from dataclasses import replace
import math

import numpy as np

from .draw import PAUSE_S, Case, simulate
from .paths import PERIOD
from .plant.parameters import AXES, sensor_values, settings_of
from .plant.plant import Trace
from .programme import TestRun

SIGNALS = ("position", "motor_position", "current")
SUBSTEPS = 2  # RK4 steps per tick: enough, because only differences between runs count
MOVING = (0.2e-3, math.radians(0.2))  # currents are compared while the set point is faster [m/s, rad/s]
ANOTHER_SEED = 421  # noise seed of the second recording that measures the noise
DIGITS = 4  # significant digits of a row, few enough for the seal to hold on another computer


def budget_of(case: Case, machine: dict, runs: Sequence[TestRun]) -> tuple[dict, ...]:
    """One row for each effect, largest times_noise first."""
    groups = groups_of(case)
    queues = [[i for i, e in enumerate(case.effects) if e["axis"] in group] for group in groups]
    squares, travel = np.zeros((len(case.effects), len(SIGNALS), len(AXES))), np.zeros(len(case.effects))
    noise_squares = np.zeros((len(SIGNALS), len(AXES)))
    fine = {k: (1e-15 if "resolution" in k else v) for k, v in machine["measurement"].items()}  # rounding is negligible
    exact = {**machine, "measurement": fine}
    still = replace(case, noise=False)
    at = 0.0
    for test in runs:
        base = simulate(still, exact, test, at, SUBSTEPS)
        noise_squares += noise_of(case, machine, test, at) ** 2
        for n in range(max(map(len, queues), default=0)):  # the n-th effect of each group is removed
            taken = {g: queue[n] for g, queue in enumerate(queues) if n < len(queue)}
            rest = tuple(e for i, e in enumerate(case.effects) if i not in taken.values())
            other = simulate(replace(still, effects=rest), exact, test, at, SUBSTEPS)
            changed = _mean_squares(base, other)
            moved = np.mean((other.load - base.load) ** 2, axis=0)
            for g, i in taken.items():
                axes = [AXES.index(a) for a in groups[g]]
                squares[i][:, axes] += changed[:, axes]
                travel[i] += moved[AXES.index(case.effects[i]["axis"])]
        at = round(at + len(base.time) * PERIOD + PAUSE_S, 3)
    times_noise = np.sqrt(np.mean(squares / noise_squares, axis=(1, 2)))
    rows = [
        {
            "effect": e["name"],
            "axis": e["axis"],
            **({"from_axis": e["from_axis"]} if "from_axis" in e else {}),
            "times_noise": float(f"{times_noise[i]:.{DIGITS}g}"),
            "true_position_rms": float(f"{math.sqrt(travel[i] / len(runs)):.{DIGITS}g}"),
        }
        for i, e in enumerate(case.effects)
    ]
    return tuple(sorted(rows, key=lambda row: -row["times_noise"]))


def groups_of(case: Case) -> list[tuple[str, ...]]:
    """Groups of mechanically or otherwise coupled axes, in machine order."""
    groups = [{"X"}, {"Y"}, {"Z"}, {"A", "C"}]
    for e in case.effects:
        if "from_axis" in e:
            joined = [g for g in groups if g & {e["axis"], e["from_axis"]}]
            groups = [g for g in groups if g not in joined] + [set().union(*joined)]
    return sorted((tuple(a for a in AXES if a in g) for g in groups), key=lambda g: AXES.index(g[0]))


def _mean_squares(one: Trace, other: Trace) -> np.ndarray:
    """Mean square difference [signal, axis]; for the current only while the set point moves."""
    speed = np.abs(np.gradient(one.setpoint, one.time, axis=0))
    moving = speed > np.array([MOVING[0]] * 3 + [MOVING[1]] * 2)
    rows = []
    for signal in SIGNALS:
        square = (getattr(other, signal) - getattr(one, signal)) ** 2
        weight = moving if signal == "current" else np.ones_like(moving)
        rows.append((square * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), 1))
    return np.array(rows)


def noise_of(case: Case, machine: dict, test: TestRun, at: float) -> np.ndarray:
    """Standard deviation [signal, axis] of noise and rounding in a run, not below that of the sensor itself.

    Taken from two noisy recordings. A comparison with a noise-free run would double it: without noise an axis comes to rest elsewhere.
    """
    one, other = (
        simulate(replace(case, noise=True, noise_seed=seed), machine, test, at, SUBSTEPS) for seed in (case.noise_seed, ANOTHER_SEED)
    )
    made = np.sqrt(_mean_squares(one, other) / 2.0)
    own = sensor_values(settings_of(machine, case.factors))
    scale = np.hypot(own["scale_noise"], own["scale_step"] / math.sqrt(12.0))
    least = np.array([scale, own["motor_step"] / math.sqrt(12.0), np.full(len(AXES), own["current_noise"])])
    return np.maximum(made, least)
