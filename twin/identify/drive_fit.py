"""Fit of an axis in closed loop: lumped inertia, friction, constant force, gains of the speed loop and the delay of its position loop.

For axes whose speed controller commands an ideal actuator (structures P/PI and P/P): a machine without a data sheet, a laboratory axis.
The values may be lumped: inertia and friction divided by the torque constant. Of a drive with a current loop it fits what the regression cannot
(`drive_residuals`). The whole loop is simulated on the recorded set points and
compared with every sample of the training rows, including short moves, reversals and the ringing of the speed loop (`estimate.search`). Each
axis is a part, so one simulation perturbs one value of every axis. Intervals come from clusters of a tenth of a second.

Richer laws are fitted together with all other values of the axis. A lag of the actuator, a reference model and a torque feedforward of the drive are taken
if they leave clearly less. Pre-sliding and a structural mode, which starts from several frequencies, are taken if their interval is narrow, they predict
held-out moves clearly better on average, and none clearly worse. Otherwise the axis is unchanged.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
import math

import numpy as np

from twin.control.actuator import EFFORTS
from twin.control.current_controller import ACTUATOR_LAG
from twin.errors import SimulationError
from twin.estimate.held_out_gain import LEAST_IMPROVEMENT, mean_log_rms, predicts_better
from twin.estimate.regression import NORMAL_95
from twin.estimate.search import Solution
from twin.identify.axis_run import moved_inertia
from twin.identify.between_samples import SHORTEST_LAG_S, is_hidden
from twin.identify.drive_residuals import MODE, SLIP, DriveResiduals, Fitted, search_of, with_constant_forces
from twin.machine.machine import Axis, Machine
from twin.machine.parameters import parameter
from twin.recordings.campaign import MeasuredRun
from twin.simulation.gap import is_moving

REFERENCE_LAGS_S = (0.3e-3, 3e-3)
REFERENCE_INTEGRAL_S = 0.01
"""Initial values for a reference model: bounds of the lag of the speed loop, and the least integral time [s]."""


FREQUENCIES_HZ = (8.0, 12.0, 18.0, 27.0, 41.0, 62.0)
"""Initial frequencies of a structural mode. Arms of large robots are below 10 Hz, beds on their mounts and columns between 10 and 80 Hz."""

MODE_START = (0.3, 0.05)
"""Initial mass share and damping ratio of a structural mode."""

BREAK_AWAY = {"linear": 10e-6, "rotary": 5e-5}
"""Initial travel to break-away [m, rad]: Coulomb friction over pre-sliding stiffness."""

ACTUATOR_LAG_S = 0.25e-3
"""Initial lag of an actuator: two speed cycles of a usual drive."""

REFERENCE_START_S = 0.2e-3
"""Initial lag of a reference model."""

NARROW = {SLIP: 4.0, "mode_frequency_hz": 1.25, "mode_mass_share": 4.0}
"""Largest ratio of two standard deviations above a value to the value. The interval of a few moves is wider; whether they agree is asked of the moves."""

FOLDS = 4
"""Largest number of folds of a cross-validation over the moves."""

SCREENING_STEPS, POLISHING_STEPS = 5, 25
"""Steps of the search from each initial frequency, and from the best of them."""


def fit_drives(
    machine: Machine,
    runs: Sequence[MeasuredRun],
    rows: Mapping[str, Sequence[np.ndarray]],
    known: Collection[tuple[str, str]] = (),
    say: Callable[[str], None] = lambda _text: None,
) -> tuple[Machine, dict[str, Fitted]]:
    """The machine with the fit of the axes that have `rows` (run, (sample,) bool), and this fit; loop values in `known` (axis, field) are kept.

    Axes with nothing free and axes without recorded motion and command are not fitted.
    """
    work = DriveResiduals(machine, runs, rows, known, rows, say)
    if not work.names:
        return machine, {}
    plain = work.searched() or work.searched(work.softer())
    if plain is None:
        raise SimulationError(
            "the simulated machine does not follow the recorded set points because its loops are unstable; correct its gains"
        )
    ends = dict.fromkeys(work.names, plain)
    controlled = [n for n in work.names if "speed_integral_time_s" in work.fields[n]]

    def taken(richer: Machine, plainer: Machine) -> list[str]:
        """Axes of which a richer machine leaves clearly less; it is then taken."""
        if not (changed := [a.name for a in plainer.axes if richer.axis(a.name) != a]):
            return []
        more = work.of(richer, changed)
        other = more.searched() if more.names else None
        better = [n for n in more.names if other is not None and other.scores[n] < ends[n].scores[n] - LEAST_IMPROVEMENT]
        ends.update({n: other for n in better if other is not None})
        return better

    lagged = machine
    if late := [n for n in controlled if shows_actuator_lag(machine, machine.axis(n))]:
        found = machine_found(machine, ends)
        lagged = with_actuator_lags(machine, taken(with_actuator_lags(found, late), found))
    modelled = with_reference_models(lagged, controlled)
    taken(modelled, lagged)
    # a torque feedforward of the drives
    fed_by_nc = any("torque" in (run.feedforward or "torque") for run in runs)
    off = [n for n in controlled if not fed_by_nc and machine.axis(n).loops.drive_torque_feedforward == 0.0]
    if off:
        taken(modelled.with_values({f"axis.{n}.loops.drive_torque_feedforward": 1.0 for n in off}), lagged)
    ends = _with_mechanics(work, ends)
    return machine_found(machine, ends), {n: end.problem.result(n, end) for n, end in ends.items()}


def shows_actuator_lag(machine: Machine, axis: Axis) -> bool:
    """Whether samples of an effort show a lag behind the controller's output that the machine file lacks.

    The effort is measured, and the samples are no further apart than the lag of the fastest speed controller.
    """
    close = machine.sample_period < SHORTEST_LAG_S * (1.0 + 1e-3)
    return is_hidden(machine, axis) and EFFORTS[axis.effort].noisy and close and not axis.loops.has(ACTUATOR_LAG)


def with_actuator_lags(machine: Machine, axes: Collection[str]) -> Machine:
    """A lag of the actuator on these axes."""
    return machine.with_values({f"axis.{n}.loops.{ACTUATOR_LAG}": ACTUATOR_LAG_S for n in axes}) if axes else machine


def with_reference_models(machine: Machine, axes: Collection[str]) -> Machine:
    """Add a reference model with the lag of the speed loop before the integrators of these axes; unchanged if all have one."""
    values: dict[str, object] = {}
    for name in axes:
        axis = machine.axis(name)
        if axis.loops.speed_reference_time_s == 0.0:
            inertia = axis.rotor_inertia_kg_m2 + moved_inertia(axis)
            lag = float(np.clip(inertia / axis.loops.speed_gain_nm_s_per_rad, *REFERENCE_LAGS_S))
            values[f"axis.{name}.loops.speed_reference_time_s"] = lag
            values[f"axis.{name}.loops.speed_gain_nm_s_per_rad"] = inertia / lag
            values[f"axis.{name}.loops.speed_integral_time_s"] = max(axis.loops.speed_integral_time_s, REFERENCE_INTEGRAL_S)
    return machine.with_values(values) if values else machine


def _with_mechanics(work: DriveResiduals, best: Mapping[str, Solution]) -> dict[str, Solution]:
    """`best` with richer mechanics on the axes where they are accepted.

    An axis needs at least two moves.
    """
    best, machine = dict(best), work.machine
    folds = {n: folds_of(machine.axis(n), work.runs, work.rows[n]) for n in best}
    asked = [n for n, s in best.items() if folds[n] and "inertia" in s.problem.fields[n] and _is_open(machine, n)]
    left_out = _scores_left_out(work, folds, {n: best[n] for n in asked})
    for slip, frequencies in ((True, ()), (False, FREQUENCIES_HZ), (True, FREQUENCIES_HZ)):
        found = _fitted(work, {n: best[n] for n in asked}, slip, frequencies)
        promising = {n: s for n, s in found.items() if s.scores[n] < best[n].scores[n] - LEAST_IMPROVEMENT and _is_narrow(s, n)}
        scores = _scores_left_out(work, folds, promising)
        for n, s in promising.items():
            if predicts_better(scores[n], left_out[n]):
                best[n], left_out[n] = s, scores[n]
    return best


def folds_of(axis: Axis, runs: Sequence[MeasuredRun], rows: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
    """Masks (fold, run) of (sample,): the `rows` of an axis by its moves in FOLDS parts or fewer; empty with a single move.

    A move has one direction. The rest after a move belongs to it, and so does the rest before the first one.
    """
    numbers, count = [], 0
    for run, used in zip(runs, rows):
        signs = np.sign(np.gradient(run.trace.get(axis.name, "setpoint"), run.trace.period)) * (is_moving(run.trace, axis) & used)
        moving = np.flatnonzero(signs)
        new = np.zeros(len(signs), bool)
        if len(moving):
            paused = np.diff(moving) > 1
            new[moving[1:]] = paused | (np.diff(signs[moving]) != 0)
        numbers.append(count + np.cumsum(new))
        count += int(new.sum()) + bool(len(moving))
    if count < 2:
        return []
    folds = min(count, FOLDS)
    return [[used & (number * folds // count == k) for number, used in zip(numbers, rows)] for k in range(folds)]


def _is_open(machine: Machine, name: str) -> bool:
    """True if the machine file has neither pre-sliding nor a structural mode on this axis."""
    axis = machine.axis(name)
    listed = any(e.get("name") == "presliding" and e.get("axis") == name for e in machine.effects)
    return not (listed or axis.presliding_stiffness or axis.mode_mass_share)


def _fitted(work: DriveResiduals, best: Mapping[str, Solution], slip: bool, frequencies: Sequence[float]) -> dict[str, Solution]:
    """Fit of a richer model to all axes: a few steps from each start, then to the end from the best start of each axis."""
    starts = _starts(machine_found(work.machine, best), best, slip, frequencies)
    first = [one for richer in starts if (one := work.of(richer, best).searched(steps=SCREENING_STEPS)) is not None]
    if not first:
        return {}
    nearest = {n: min(first, key=lambda end: end.scores[n]) for n in best}
    start = {f.name: nearest[f.part].values[f.name] for f in first[0].problem.free}
    end = first[0].problem.searched(start, POLISHING_STEPS)
    return dict.fromkeys(best, end) if end is not None else {}


def _starts(machine: Machine, best: Mapping[str, Solution], slip: bool, frequencies: Sequence[float]) -> Iterator[Machine]:
    """The machine with the searched mechanics added to the axes of `best`, once for each frequency."""
    values: dict[str, object] = {}
    for name, end in best.items():
        axis = machine.axis(name)
        values |= {f"axis.{name}.{parameter(f).key(axis.drive)}": 0.0 for f in (SLIP, *MODE)}
        if slip:
            values[f"axis.{name}.{parameter(SLIP).key(axis.drive)}"] = axis.coulomb_friction / BREAK_AWAY[axis.kind]
        if "speed_integral_time_s" in end.problem.fields[name] and axis.loops.speed_reference_time_s == 0.0:
            values[f"axis.{name}.loops.speed_reference_time_s"] = REFERENCE_START_S
    for frequency in frequencies or (0.0,):
        mode = zip(MODE, (frequency, *MODE_START)) if frequency else ()
        yield machine.with_values({**values, **{f"axis.{n}.{f}": v for f, v in mode for n in best}})


def _is_narrow(end: Solution, name: str) -> bool:
    """Whether the intervals of pre-sliding and mode are within NARROW and no value is at a bound of its range.

    The mass share may be at its upper bound if the rotor is fitted, too: then the whole load swings, as in a drive of two masses.
    """
    values = end.problem.found(name, end.values)
    highest = {f: search_of(f).high for f in MODE} | ({"mode_mass_share": math.inf} if end.problem.fits_rotor(name) else {})
    if any(not search_of(f).low * 1.01 < values[f] < high / 1.01 for f, high in highest.items() if f in values):
        return False
    names = end.problem.fields[name]
    apart = dict(zip(names, NORMAL_95 * end.linear[name].deviations()))
    return all(math.exp(min(apart[f], 40.0)) < NARROW[f] for f in NARROW if f in names)


def _scores_left_out(
    work: DriveResiduals, folds: Mapping[str, list[list[np.ndarray]]], best: Mapping[str, Solution]
) -> dict[str, list[float]]:
    """Mean log RMS (fold,) of each axis on the moves of each fold, after a fit to the other moves that starts from the fit to all moves."""
    scores: dict[str, list[float]] = {n: [] for n in best}
    for end in {id(s): s for s in best.values()}.values():
        own = [n for n, s in best.items() if s is end]
        for k in range(max(len(folds[n]) for n in own)):
            axes = [n for n in own if k < len(folds[n])]
            kept = {n: [r & ~f for r, f in zip(work.rows[n], folds[n][k])] for n in axes}
            fitted = work.of(end.problem.machine, axes, kept).searched(end.values)
            aside = work.of(end.problem.machine, axes, {n: folds[n][k] for n in axes})
            there = aside.residuals([fitted.values])[0] if fitted is not None else None
            for n in axes:
                # moves in one direction do not separate friction from a steady load: the mean command does not count
                effort, left = end.problem.machine.axis(n).effort, there[n] if there is not None else {}
                signals = [v - v.mean() if s == effort and len(v) else v for s, v in left.items()]
                scores[n].append(math.inf if there is None else mean_log_rms(signals))
    return scores


def machine_found(machine: Machine, best: Mapping[str, Solution]) -> Machine:
    """The machine with the final values of each axis."""
    values: dict[str, object] = {}
    forces: dict[str, float] = {}
    for name, end in best.items():
        own, force = end.problem.values(end.values, [name])
        values |= own
        forces |= force
    return with_constant_forces(machine, values, forces)
