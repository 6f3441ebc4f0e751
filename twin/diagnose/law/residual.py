"""Residuals of each block of an axis with the corrected machine, with the variables that they may depend on.

Each block is evaluated in open loop: the model of the block computes its output from its measured inputs, and the recorded output is
compared with it. The same evaluation of a simulated record of the corrected machine is subtracted; it contains the influence of smoothing,
sampling and known effects. The residuals:

    mechanics             force balance of the load:  M a - Kt i / r + friction + bias                    [N, Nm]
    transmission          motor position minus scale                                                      [m, rad]
    spring                transmitted force minus the force of the drive train's spring                   [N, Nm]
    position controller   speed set point minus that of the control law                                   [m/s, rad/s]
    speed controller      current minus that of the control law for the recorded speeds                   [A]
    current loop          the same at consecutive samples: it shows the response of the loop to a disturbance voltage
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
import functools
import math

import numpy as np
import scipy

from twin.diagnose.blocks import commanded_current, current_beyond_law, moving_mean
from twin.diagnose.control_law import law_error, law_sigma
from twin.diagnose.force_balance import MOTION, force_and_acceleration, force_beyond_model, smoothing_window, speed_of
from twin.diagnose.law.zero_force import zero_force_offset
from twin.diagnose.settings import T
from twin.diagnose.simulations import Mapper, SimulationRequest, Variant, simulate_groups
from twin.diagnose.view import RunView
from twin.effects import apply_effects
from twin.machine.machine import Axis
from twin.recordings.trace import Trace
from twin.simulation.motor_and_scale import has_both, motor_minus_scale
from twin.simulation.run import all_or_raise

OTHER_PERIOD_S = 4e-3
"""Sample period of motor minus scale. That of a force balance is a fifth of the smoothing window of the motion."""

MOST_SAMPLES = 800
"""Samples of an axis in a run. Of twice as many only every second one is used, of three times as many every third; more only take time."""

MOST_IN_A_ROW = 8000
"""Largest number of samples of an axis in a run for a block that needs consecutive samples."""

MOST_STRETCHES = 6
"""Largest number of stretches of a run for cross-validation."""

ONE_RUN = 0.95
"""A run with a larger fraction of the gap above noise can confirm a law only within itself."""

HIGHEST_IN_STEPS = 0.4
"""Highest frequency that a speed set point shows, as a fraction of the position cycle rate. It changes in steps, and their shape between the steps
is not a filter."""

NOISE_SEED = 977
"""Noise seed of the simulation that gives the noise level of a block."""

MECHANICS = "mechanics"
SPRING = "spring"
"""The spring of the transmission."""

CURRENT_LOOP = "current loop"


@dataclass(frozen=True)
class ControllerRun:
    """Output of a control block in one run (sample,): `wanted` by its law, `given` as recorded, every `period` [s]; `noise` of `given`.

    `output` names the signal: the output of the block, or its received input. `highest_hz` is the highest frequency that both signals show.
    """

    output: str
    wanted: np.ndarray
    given: np.ndarray
    noise: float
    period: float
    highest_hz: float = math.inf


@dataclass(frozen=True)
class Samples:
    """Residual `y` (sample,) of one block of one axis over all its runs, with the variables that it may depend on.

    `part` (sample,) numbers the parts of the cross-validation: runs, or stretches of few runs; `run` (sample,) the runs. `motion` holds the
    variables of `_motion`, `others` those of other moving axes by name. `sigma` is the standard deviation of noise in y. `first` (sample,) is
    the index of the first sample of each run. `passed` holds the outputs of a control block run by run, `through` the responses of a current
    loop to a voltage. Variables that only some runs recorded are left out.
    """

    axis: str
    block: str
    y: np.ndarray
    sigma: float
    part: np.ndarray
    run: np.ndarray
    first: np.ndarray
    motion: dict[str, np.ndarray]
    others: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    passed: tuple[ControllerRun, ...] = ()
    through: tuple[Callable[[np.ndarray], np.ndarray], ...] = ()

    def __len__(self) -> int:
        return len(self.y)


_Block = Callable[[RunView, Axis, Trace], tuple[np.ndarray, np.ndarray] | None]


def residuals_of(views: Sequence[RunView], machine_of: Variant, axis: str, mapper: Mapper) -> list[Samples]:
    """Residuals of all blocks of an axis; `machine_of` turns the nominal machine of a run into the corrected one."""
    shown = [r for r, view in enumerate(views) if view.moves(axis) and any(view.trace.has(axis, s) for s in MOTION)]
    actual = {r: replace(views[r], machine=machine_of(views[r].machine)) for r in shown}
    requests = [SimulationRequest(actual[r], [axis], noise_seed=seed) for r in shown for seed in (None, NOISE_SEED + r)]
    traces = all_or_raise(simulate_groups(requests, mapper, lambda _, run: run.trace))

    def of_run(r: int, twin: Trace, noisy: Trace) -> list[Samples]:
        return _residuals_of_run(r, views[r], actual[r], axis, twin, noisy)

    found: dict[str, list[Samples]] = {}
    for pieces in mapper(of_run, shown, traces[::2], traces[1::2]):
        for piece in pieces:
            found.setdefault(piece.block, []).append(piece)
    return [_concatenate(pieces) for pieces in found.values()]


def _concatenate(pieces: Sequence[Samples]) -> Samples:
    """The samples of all runs. Up to three runs are divided into stretches for cross-validation, and so is a run with almost all of the
    residual: a law that acts in one run only is predicted from the other stretches of that run."""
    power = np.array([float(np.sum(np.square(p.y - np.median(p.y)))) for p in pieces])
    alone = power > ONE_RUN * power.sum() if len(pieces) > 3 else np.zeros(len(pieces), bool)
    stretches = 1 if len(pieces) > 3 else 4 if len(pieces) > 1 else 6
    part = []
    for i, p in enumerate(pieces):
        place = np.arange(len(p)) / len(p)
        if alone[i]:  # stretches with equal shares of the residual
            loss = np.cumsum(np.square(p.y - np.median(p.y)))
            place = (loss - loss[0]) / loss[-1]
        count = MOST_STRETCHES if alone[i] else stretches
        part.append(i * MOST_STRETCHES + np.minimum((place * count).astype(int), count - 1))
    lengths = np.array([len(p) for p in pieces])
    zeros = {name: np.zeros(1) for name in ("position", "velocity", "acceleration")}

    def other(axis: str, name: str) -> np.ndarray:
        return np.concatenate([np.broadcast_to(p.others.get(axis, zeros)[name], len(p)) for p in pieces])

    return replace(
        pieces[0],
        y=np.concatenate([p.y for p in pieces]),
        sigma=float(np.sqrt(np.average([p.sigma**2 for p in pieces], weights=lengths))),
        part=np.concatenate(part),
        run=np.concatenate([p.run for p in pieces]),
        first=np.repeat(np.cumsum(lengths) - lengths, lengths),
        motion={
            name: np.concatenate([p.motion[name] for p in pieces]) for name in pieces[0].motion if all(name in p.motion for p in pieces)
        },
        others={axis: {name: other(axis, name) for name in zeros} for axis in sorted({axis for p in pieces for axis in p.others})},
        passed=tuple(passed for p in pieces for passed in p.passed),
        through=tuple(through for p in pieces for through in p.through),
    )


def _residuals_of_run(r: int, view: RunView, actual: RunView, name: str, twin: Trace, noisy: Trace) -> list[Samples]:
    """All blocks of an axis in run number `r`; `actual` is the run on the corrected machine, with its simulation without and with noise."""
    pieces: list[Samples] = []
    axis = actual.machine.axis(name)
    motion = _motion(view, name, axis)
    others = {other: _motion(view, other) for other in view.trace.axes if other != name and view.moves(other)}
    # two blocks share a law
    evaluated = functools.cache(functools.partial(_residual_of_block, actual, axis, (view.trace, twin, noisy)))
    for block, law, period in (
        (MECHANICS, force_beyond_model, 0.2 * T.smooth_s),
        ("transmission", _displacement, OTHER_PERIOD_S),
        (SPRING, _spring_force, 0.2 * T.smooth_s),
        ("position controller", _speed_set_point, 0.0),
        ("speed controller", current_beyond_law, 0.0),
        *([(CURRENT_LOOP, current_beyond_law, 0.0)] if axis.actuator.winding else []),
    ):
        found = None if name in view.pushed and block != "transmission" else evaluated(law)
        if found is None:
            continue
        measured, expected, shaken = found
        keep = np.flatnonzero(measured[1] & expected[1])
        step = max(1, round(period / view.trace.period))
        index = keep[keep % step == 0] if period else keep
        index = np.arange(len(measured[0]))[:MOST_IN_A_ROW] if block == CURRENT_LOOP else index[:: max(1, len(index) // MOST_SAMPLES)]
        if len(index) < T.enough_samples:
            continue
        difference = measured[0] - expected[0]
        noise = (shaken[0] - expected[0])[index] if block != "position controller" else np.full(len(index), law_sigma(view, axis))
        level = max(float(np.sqrt(np.mean(noise**2))), 1e-12)
        passed: tuple[ControllerRun, ...] = ()
        if block == "position controller":
            passed = (_position_controller_run(view, motion, difference, level),)
        elif block == "speed controller":
            passed = _speed_controller_run(actual, axis, twin, difference, level)
        elif block == MECHANICS and not axis.actuator.winding:
            passed = _actuator_run(actual, axis, np.where(measured[1] & expected[1], difference, 0.0), level)
        own = motion
        if block == CURRENT_LOOP:  # at rest, current noise around zero would switch the sign of a voltage
            moving = view.reference(name)[2]
            own = {**motion, "current": np.where(moving, motion["current"], moving_mean(motion["current"], smoothing_window(view)))}
        pieces.append(
            Samples(
                axis=name,
                block=block,
                y=difference[index],
                sigma=level,
                part=np.zeros(len(index), int),
                run=np.full(len(index), r),
                first=np.zeros(len(index), int),
                motion={key: values[index] for key, values in own.items()},
                others={other: {key: values[index] for key, values in of.items()} for other, of in others.items()},
                passed=passed,
                through=(voltage_to_current(actual, axis),) if block == CURRENT_LOOP else (),
            )
        )
    return pieces


def _residual_of_block(view: RunView, axis: Axis, traces: Sequence[Trace], law: _Block) -> list[tuple[np.ndarray, np.ndarray]] | None:
    """Residual (sample,) of a block in each of the traces and where it is valid; None if a signal is missing."""
    found = [off for trace in traces if (off := law(view, axis, trace)) is not None]
    return found if len(found) == len(traces) else None


def _position_controller_run(view: RunView, motion: dict[str, np.ndarray], difference: np.ndarray, noise: float) -> ControllerRun:
    """Nominal and recorded output of a position controller at its cycles; `difference` (sample,): recorded minus nominal."""
    every = view.samples_per_cycle
    wanted = motion["speed_setpoint"][::every]
    return ControllerRun("speed", wanted, wanted + difference[::every], noise, every * view.trace.period)


def _speed_controller_run(view: RunView, axis: Axis, twin: Trace, difference: np.ndarray, noise: float) -> tuple[ControllerRun, ...]:
    """Nominal and recorded output of a speed controller, with their `difference` (sample,), and its sent and received set point.

    The received set point is reconstructed from the residual by the inverse PI law, e = (T - I) / Kp, I += Kp h / Tn e, with the torque T and
    the sample period h. The current limit is not applied, because the law with the sent set point may exceed it.
    """
    trace = view.trace
    wanted = commanded_current(view, axis, trace)
    apart, of_twin = (t.get(axis.name, axis.effort) - commanded_current(view, axis, t, limited=False) for t in (trace, twin))
    to_speed = axis.commissioned_torque_constant / axis.loops.speed_gain_nm_s_per_rad * axis.ratio
    rate = trace.period / axis.loops.speed_integral_time_s
    # the integrator holds rate e of each earlier sample: e = T / Kp - rate sum(e before)
    error = scipy.signal.lfilter([1.0, -1.0], [1.0, -(1.0 - rate)], to_speed * (apart - of_twin))
    sent = trace.get(axis.name, "velocity_setpoint")
    return (
        ControllerRun("current", wanted, wanted + difference, noise, trace.period),
        ControllerRun("received_speed", sent, sent + error, to_speed * noise, trace.period, HIGHEST_IN_STEPS / view.machine.position_cycle),
    )


def _actuator_run(view: RunView, axis: Axis, difference: np.ndarray, noise: float) -> tuple[ControllerRun, ...]:
    """Commanded force of an actuator that acts at once in the model, and the delivered one: it differs by the force that the model lacks."""
    driven = force_and_acceleration(view, axis, view.trace)
    if driven is None:
        return ()
    return (ControllerRun("torque", driven[0], driven[0] + difference, noise, view.trace.period, 1.0 / T.smooth_s),)


def _displacement(view: RunView, axis: Axis, trace: Trace) -> tuple[np.ndarray, np.ndarray] | None:
    """Motor position minus scale (sample,), valid everywhere."""
    if not has_both(view.trace, axis.name):
        return None
    return motor_minus_scale(trace, axis.name), np.ones(len(trace.time), bool)


def _spring_force(view: RunView, axis: Axis, trace: Trace) -> tuple[np.ndarray, np.ndarray] | None:
    """Transmitted force minus the force of the drive train's spring (sample,), valid everywhere; None without a spring."""
    coupling = apply_effects(view.machine).couplings.get(axis.name)
    if coupling is None:
        return None
    deflection, force = deflection_of(view, axis, trace), transmitted_force(view, axis, trace)
    if deflection is None or force is None:
        return None
    stretch = np.sign(deflection) * np.maximum(np.abs(deflection) - coupling.clearance / 2.0, 0.0)
    return force - coupling.stiffness * stretch, np.ones(len(trace.time), bool)


def transmitted_force(view: RunView, axis: Axis, trace: Trace) -> np.ndarray | None:
    """Transmitted force of the drive train: motor force minus inertia force of the rotor (sample,); None without current."""
    driven = force_and_acceleration(view, axis, trace)
    return None if driven is None else np.asarray(driven[0] - axis.reflected_inertia * driven[1])


def deflection_of(view: RunView, axis: Axis, trace: Trace) -> np.ndarray | None:
    """Deflection of the drive train (sample,): smoothed motor position minus scale, relative to the unloaded drive train, or to the start of the
    run without a current; None if an encoder is missing.

    The encoders have no common zero, and under a weight a run begins with a deflected drive train.
    """
    displaced = _displacement(view, axis, trace)
    if displaced is None or len(trace.time) < 2 * smoothing_window(view):
        return None
    deflection = np.asarray(scipy.signal.savgol_filter(displaced[0], smoothing_window(view), 2))
    force = transmitted_force(view, axis, trace)
    return deflection - (displaced[0][0] if force is None else zero_force_offset(deflection, force))


def _speed_set_point(view: RunView, axis: Axis, trace: Trace) -> tuple[np.ndarray, np.ndarray] | None:
    """Speed set point minus that of the control law (sample,), at the position cycles, while the axis moves."""
    error = law_error(trace, view, axis)
    if error is None or not view.trace.has(axis.name, "velocity_setpoint"):
        return None
    every = view.samples_per_cycle
    out = np.zeros(len(trace.time))
    where = np.zeros(len(trace.time), bool)
    out[::every], where[::every] = error, True
    return out, where


def _motion(view: RunView, name: str, axis: Axis | None = None) -> dict[str, np.ndarray]:
    """Measured variables of laws (sample,): all of them with `axis`, otherwise only those that can act on another axis."""
    trace, window = view.trace, smoothing_window(view)
    own = axis or view.machine.axis(name)
    position = trace.get(name, trace.measured_position(name) or "setpoint")
    speed = speed_of(view, trace, own) if any(trace.has(name, s) for s in MOTION) else np.gradient(position, trace.period)
    if len(position) >= 2 * window:
        velocity = scipy.signal.savgol_filter(speed, window, 2)
        acceleration = scipy.signal.savgol_filter(speed, window, 2, deriv=1, delta=trace.period)
    else:
        velocity, acceleration = speed, np.gradient(speed, trace.period)
    found = {"position": position, "velocity": velocity, "acceleration": acceleration}
    if axis is None:
        return found
    motor = trace.get(name, "motor_position") if trace.has(name, "motor_position") else position
    found |= {"turn": motor / own.ratio, "motor_position": motor, "time": view.started_at + trace.time - trace.time[0]}
    found["travel"] = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(position)))])
    if (deflection := deflection_of(view, own, trace)) is not None:
        found["windup"] = deflection
        if (force := transmitted_force(view, own, trace)) is not None:
            found["transmitted_force"] = force
    if trace.has(name, own.effort):
        found["current"] = trace.get(name, own.effort)
    if trace.has(name, "velocity_setpoint") and trace.measured_position(name):
        command, delayed, _ = view.reference(name)
        found["following_error"] = delayed - position
        found["speed_setpoint"] = command + own.loops.position_gain_per_s * (delayed - position)
    return found


def voltage_to_current(view: RunView, axis: Axis) -> Callable[[np.ndarray], np.ndarray]:
    """Current [A] of the current loop of an axis that voltages [V] (sample, n) of one run cause, for a voltage that is linear between samples.

    i / u = s / (L s^2 + (R + Kp) s + Kp / Tn); the integrator rejects constant disturbances. As in the residual of the current, the moving
    mean is subtracted.
    """
    motor, loops, period = axis.motor, axis.loops, view.trace.period
    gain, integral = loops.current_gain_v_per_a, loops.current_gain_v_per_a / loops.current_integral_time_s
    numerator, denominator, _ = scipy.signal.cont2discrete(
        ([1.0, 0.0], [motor.inductance_h, motor.resistance_ohm + gain, integral]), period, method="foh"
    )

    def current(voltage: np.ndarray) -> np.ndarray:
        run = scipy.signal.lfilter(np.ravel(numerator), denominator, voltage - voltage[0], axis=0)
        return np.asarray(run - moving_mean(run, round(T.settled_s / period)))

    return current
