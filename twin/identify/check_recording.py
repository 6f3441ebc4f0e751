"""Check a recording before identification and report what is wrong or missing.

Compares the feedforward flags with the signals, measures the skew of late channels, and detects limits and clipping. For each parameter
that the campaign cannot identify, it names the run that would.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.control.speed_controller import lateness_of_speed, law_weights
from twin.estimate.regression import regress
from twin.identify.axis_run import AxisRun, Runs, control_inertia, slides_above
from twin.identify.between_samples import fast_loop_of
from twin.identify.drive_balance import MeanCurrent
from twin.identify.position_control import fit_position_control, rms_left
from twin.identify.position_law import PositionLaw, loop_position, numbers_of_file
from twin.identify.recorded_axis import one_speed
from twin.identify.speed_control import regressors
from twin.machine.machine import Axis, Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.plausible import contradictions
from twin.recordings.profile_speed import PROFILE
from twin.recordings.skew import Skew
from twin.simulation.summary import once
from twin.units import in_words

SIGNALS = {
    "position": "position gain and delays",
    "velocity_setpoint": "feedforward weight, delays and position gain other than by fits of the simulated motion",
    "current": "inertia, friction and gravity",
    "velocity": "the current between samples, which the inertia depends on",
}


@dataclass(frozen=True)
class Finding:
    """One remark: a text that says what to do, axis and run ('' for all)."""

    text: str
    axis: str = ""
    run: str = ""

    def __str__(self) -> str:
        return in_sentences([self])[0]


def in_sentences(findings: Iterable[Finding]) -> list[str]:
    """The findings as sentences; those that differ in the axis alone are one."""
    lines = []
    for (run, text), axes in once(((f.run, f.text), f.axis) for f in findings).items():
        where = " ".join(w for w in (run and f"run {run}", axes) if w)
        lines.append(f"{where}: {text}" if where else text)
    return lines


def missing_signals(machine: Machine, runs: Sequence[MeasuredRun]) -> list[Finding]:
    """Findings about signals that no run contains and the parameters that need them."""
    out = []
    for axis in machine.axes:
        recorded = [r for r in runs if axis.name in r.trace.axes]
        if not recorded:
            out.append(Finding("no run contains this axis; the machine file's values are kept. Record it", axis.name))
            continue
        if any(axis.name in r.profiles for r in recorded):
            out.append(Finding(PROFILE, axis.name))
        # of a command that nothing measures only the motion is needed beside it
        motion = "motor_position" if axis.encoder == "motor" else "position"
        needed = SIGNALS if axis.actuator.winding else {motion: "anything", axis.effort: SIGNALS["current"]}
        for signal, cost in needed.items():
            if not any(r.trace.has(axis.name, signal) for r in recorded):
                out.append(Finding(f"no {in_words(signal)} in any run: cannot identify {cost}; record it", axis.name))
    return out


def checked_flags(machine: Machine, runs: Sequence[MeasuredRun], axis_runs: Runs) -> tuple[list[str | None], list[Finding]]:
    """The feedforward mode of each run as the signals show it, and a finding where `campaign.toml` differs.

    The weight of the velocity feedforward is the residual of v* after the machine file's position controller, projected on the feedforward;
    that of the torque feedforward is the residual of the current after the speed controller. A mode is on if the median over the axes
    exceeds half of the file's weight.
    """
    flags: list[str | None] = []
    out = []
    for i, run in enumerate(runs):
        recorded = [(axis, r) for axis in machine.axes if (r := axis_runs[axis.name][i]) is not None]
        shown: dict[str, float] = {}
        for word, weight_of in (("velocity", _velocity_weight), ("torque", _torque_weight)):
            weights = [w for axis, r in recorded if (w := weight_of(machine, axis, r)) is not None]
            if weights:
                shown[word] = float(np.median(weights))
        stated = run.feedforward
        velocity, torque = (shown[w] > 0.5 if w in shown else w in (stated or "velocity+torque") for w in ("velocity", "torque"))
        seen = (("velocity+torque" if torque else "velocity") if velocity else "off") if shown else stated
        if stated is not None and seen != stated:
            weights_text = ", ".join(f"{word} {weight:.2f}" for word, weight in shown.items())
            text = f"campaign.toml has feedforward '{stated}', but the signals show '{seen}' (weights: {weights_text}); '{seen}' is used, correct the file"
            out.append(Finding(text, "", run.name))
        flags.append(seen)
    return flags, out


def _velocity_weight(_machine: Machine, axis: Axis, run: AxisRun) -> float | None:
    """Weight of the velocity feedforward in one run over that of the machine file, with its gain and delays; None if the axis hardly moves."""
    if run.velocity_feedforward is not None and np.ptp(run.angle) * axis.ratio > 1e-5:
        return 1.0 if np.ptp(run.velocity_feedforward) > 0.0 else 0.0  # the feedforward itself is recorded
    if run.speed_setpoint is None or loop_position(run, axis) is None:
        return None
    law, x = PositionLaw(axis, [replace(run, feedforward=None, velocity_feedforward=None)], "cubic"), numbers_of_file(axis)
    slope = law.slopes(0, x)[:, 1]
    power = x[1] * float(slope @ slope)
    return (
        float(slope @ (law.given - law.wanted(0, x * [1.0, 0.0, 1.0, 1.0]))) / power
        if abs(power) > 1e-4 * len(slope) * axis.max_velocity**2
        else None
    )


def _torque_weight(machine: Machine, axis: Axis, run: AxisRun) -> float | None:
    """Weight of the torque feedforward in one run over that of the machine file: residual of the current after its PI law, projected on the feedforward.

    None if the axis hardly accelerates, or if this law explains no part of the current: the speed controller is another one.
    """
    if run.speed_setpoint is None or run.current is None or not axis.actuator.winding:
        return None
    loop = fast_loop_of(machine, axis, control_inertia(axis))
    columns, y = regressors(loop, replace(run, feedforward="velocity+torque"), run.current, axis.loops.feedforward_delay_s)
    gain, rate, weight = law_weights(axis.loops)
    left = y - columns[:, :2] @ np.array([gain, rate])
    t = columns[:, 2] * (weight or 1.0)
    power = float(t @ t)
    if not np.sqrt(power / len(t)) > 0.2 * axis.commissioned_torque_constant:
        return None
    weight = float(t @ left) / power
    return weight if np.std(left - weight * t) < np.std(y) else None


LEAST_SKEW_S = {"motor_position": 5e-5, "velocity": 1e-4, "velocity_setpoint": 1e-3, "current": 4e-4}
"""A smaller skew [s] is not corrected. An elastic drive train, or a current loop that differs from the file, causes as much (current: 0.1 ms)."""


def channel_skews(machine: Machine, axis: Axis, seen: AxisRun | None) -> list[Skew]:
    """Skew of motor position and speed against the scale, of the current against the motion, in one run; empty if the axis does not move enough."""
    if seen is None or np.ptp(seen.axis_position) < 1e-3 * (axis.max_velocity / 0.5) or seen.sliding.sum() < 100:
        return []
    out = []
    rows = seen.sliding
    groups = seen.strokes[rows]
    f = seen.filtered

    def add_skew(signal: str, columns: list[np.ndarray], y: np.ndarray, per: float | None = None) -> None:
        fit = regress(np.column_stack(columns), y, groups)
        # a lateness makes the signals differ; what they do not differ by, other terms of the law have taken back
        apart = np.std(y if per is None else regress(np.column_stack(columns[1:]), y, groups).residual)
        if np.std(fit.values[0] * columns[0]) > MOST_HIDDEN * apart:
            return
        # friction alone gives no timing
        if fit.seen[0] and (per is None or (fit.seen[1] and fit.values[1] > fit.quantile * fit.deviations[1])):
            scale = -1.0 if per is None else -1.0 / fit.values[1]
            out.append(Skew(axis.name, signal, float(scale * fit.values[0]), float(abs(scale) * fit.deviations[0])))

    speed, acceleration = f(seen.speed)[rows], f(seen.acceleration)[rows]
    ones, sign = np.ones(len(speed)), np.sign(speed)
    if seen.deflection is not None:
        add_skew("motor_position", [speed * axis.ratio, acceleration, sign, ones], f(seen.deflection)[rows])
    if seen.motor_speed is not None:
        # the mean time of a cycle's samples is half a sample before mid-cycle; the controller's own speed is late by its mean and its filter
        ahead = 0.5 * seen.cycle / seen.samples_per_cycle + lateness_of_speed(axis.loops, machine.speed_cycle)
        add_skew("velocity", [acceleration, speed, ones], (f(seen.motor_speed) - f(seen.speed) + ahead * f(seen.acceleration))[rows])
    if seen.current is not None:
        # the mean current of a cycle, corrected with the machine file's saw-tooth, belongs to the acceleration at mid-cycle
        mean_current = MeanCurrent.start(machine, axis, [seen], control_inertia(axis)).of(seen)
        assert mean_current is not None
        jerk = np.gradient(f(seen.acceleration), seen.cycle)[rows]
        turning = [f(np.cos(seen.axis_position))[rows], f(np.sin(seen.axis_position))[rows]] if axis.kind == "rotary" else []
        add_skew("current", [jerk, acceleration, sign, speed, ones, *turning], f(mean_current)[rows], per=1.0)
    return out


MOST_HIDDEN = 2.0
"""A lateness may move a signal by at most this multiple of the observed difference (RMS): the rest would be hidden by chance by another term,
such as a play of the opposite sign. An encoder that agrees to 8 um at 17 mm/s is not milliseconds late."""


def setpoint_shift(axis: Axis, seen: AxisRun) -> float:
    """Delay [s] of the speed set point against set point and scale, a whole number of samples (0: none).

    The residual of the position controller's law is smallest at the correct shift, with the file's gain and delays and with free ones: delays that
    the file does not know look like a lateness.
    """
    if seen.speed_setpoint is None or loop_position(seen, axis) is None:
        return 0.0
    moved = {cycles: np.roll(seen.speed_setpoint, -cycles) for cycles in range(-4, 5)}
    law = PositionLaw(axis, [replace(seen, velocity_feedforward=None)], "cubic").wanted(0, numbers_of_file(axis))
    rms = {c: float(np.sqrt(np.mean((v * axis.ratio - law)[8:-8] ** 2))) for c, v in moved.items()}
    best = min(rms, key=lambda c: rms[c])
    if not rms[best] < SHIFT_RATIO * rms[0]:
        return 0.0
    free = [fit_position_control(axis, [replace(seen, speed_setpoint=moved[c])]) for c in (best, 0)]
    return best * seen.cycle if rms_left(free[0]) < SHIFT_RATIO * rms_left(free[1]) else 0.0


SHIFT_RATIO = 0.2
"""A shift is accepted if it reduces the residual below this fraction. Gains and delays that differ from the file leave more."""


ONE_SPEED = "too narrow a range of speeds"
"""Begins the finding about an axis of which only the sum of Coulomb and viscous friction at one speed is known."""


def coverage(axis: Axis, runs: Sequence[AxisRun]) -> Iterator[str]:
    """What the runs of an axis do not excite, with the run that would."""
    least = slides_above(axis)
    if not runs or max(np.ptp(r.angle) for r in runs) < 0.2 * least:
        yield "never moves: friction, inertia and delays cannot be identified; run it there and back at three speeds ('twin plan')"
        return
    sliding = np.concatenate([r.speed[r.sliding] for r in runs])
    if len(sliding) == 0:
        unit = "m" if axis.drive == "direct" else "rad"
        yield f"never slides faster than {least:g} {unit}/s at the motor: the friction law cannot be identified; add constant speeds ('twin plan')"
        return
    if not 0.02 <= float(np.mean(sliding > 0)) <= 0.98:
        yield "moves in one direction only: Coulomb friction and constant force cannot be separated; add the return move"
    if one_speed(sliding) is not None:
        yield (
            f"{ONE_SPEED} to identify viscous friction well: Coulomb friction holds with the file's viscous friction at this speed; "
            "add constant speeds up to rapid ('twin plan')"
        )
    limited = sum(float(r.limited.sum() * r.cycle) for r in runs)
    if limited > 0.0:
        yield f"current at its limit or clipped, or another channel clipped, for {limited * 1e3:.0f} ms: these parts are not used"
    for signal in dict.fromkeys(s for r in runs for s in r.clipped):
        seconds = sum(r.clipped.get(signal, 0.0) for r in runs)
        yield f"{signal} stays at its largest value for {seconds * 1e3:.0f} ms while the axis moves on: clipped; record it with a wider range"


ABOVE_PEAK = 3.0
"""A recorded current above this multiple of the motor's peak current is implausible."""


def unusable_channels(machine: Machine, run: MeasuredRun) -> dict[tuple[str, str], Finding]:
    """Channels (axis, signal) that contradict their heading, with the reason.

    A channel is unusable if it never changes while the axis' set point does, if its unit or sign contradicts the other signals, if it exceeds
    what the motor can take, or if it is a force recorded without its sign.
    """
    out: dict[tuple[str, str], Finding] = {}
    for axis in machine.axes:
        if axis.name not in run.trace.axes or np.ptp(run.trace.get(axis.name, "setpoint")) < 1e-5:
            continue
        texts: dict[str, str] = {}
        own = {s: v for (a, s), v in run.trace.signals.items() if a == axis.name}
        for signal in ("position", "motor_position", "velocity", "velocity_setpoint", axis.effort):
            if signal in own and np.ptp(own[signal]) == 0.0:
                texts[signal] = f"{signal} never changes while the set point moves: not used; check the recording of this channel"
        moving = {s: v for s, v in own.items() if s not in texts}
        texts |= {
            d.signal: f"{d.text}; {d.signal} is not used" for d in contradictions(axis.name, moving, run.trace.period, axis.kind) if d.known
        }
        if axis.effort not in texts and run.is_unsigned(axis.name, axis.effort):
            texts[axis.effort] = (
                f"{axis.effort} is recorded without its sign: not used, so mass and friction cannot be identified; "
                f"record {axis.name}.{axis.effort} with its sign"
            )
        peak, unit = axis.motor.peak_current_a, axis.effort_unit
        largest = float(np.abs(own[axis.effort]).max()) if axis.effort in own else 0.0
        if largest > ABOVE_PEAK * peak:
            texts[axis.effort] = (
                f"{axis.effort} up to {largest:.4g} {unit}, the motor's peak is {peak:g} {unit}: not used; check the unit of the column"
            )
        out |= {(axis.name, signal): Finding(text, axis.name, run.name) for signal, text in texts.items()}
    return out
