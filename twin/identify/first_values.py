"""First values of each axis from its recording, without a data sheet: law of the control, lumped mechanics, what is assumed.

command:   u(t) as in `control.command_law`                     the recorded command is that of the speed controller itself
           w*(t) = Kv (s(t - d) - x(t)) + a f(t)                 or a speed set point w* is recorded (`position_control`)
in drive:  `drive_position_loop`                                 the NC or the drive closes the position loop
mechanics: u = m a + d sign(v) + b v + c - f/K                   `recorded_axis`; u: recorded current, voltage or torque; f: known load

Without lead, ratio and motor data, m, d, b and c are known only in units of the command: m is the inertia over the torque constant,
referred to the axis, in A/(m/s2) or the like. These are the lumped parameters. If a known external load is recorded, the response of
the command gives K [N or Nm per unit of the command], which converts them to kilograms and newtons. SI; positions in m or rad.
"""

from collections.abc import Sequence
import contextlib
from dataclasses import replace
import functools
import math
from pathlib import Path
import tempfile

import numpy as np

from twin.control.actuator import EFFORTS
from twin.control.speed_controller import MEAN_CYCLES
from twin.control.speed_set_point_filters import INSIDE_LAG, RECORD_LAG
from twin.control.structures import INTEGRAL
from twin.errors import InputError
from twin.estimate.regression import Range
from twin.identify.axis_run import AxisRun, axis_run
from twin.identify.between_samples import SHORTEST_LAG_S, sampled_inertia
from twin.identify.drive_position_loop import drive_position_loop
from twin.identify.position_control import (
    CLEARLY_LESS,
    PositionControl,
    fit_position_control,
    is_determined,
    plain_law,
    richest_law,
    rms_left,
)
from twin.identify.recorded_axis import (
    Friction,
    Strokes,
    effort_balance,
    friction_on_load,
    lags_of,
    least_noise,
    one_speed,
    position_of,
    slopes_of,
    strokes_of,
)
from twin.identify.recorded_command import DIGITS, agree, axis_control, commanded, direct_law, speed_signals
from twin.identify.speed_control import speed_law
from twin.machine.axis_lumps import ACCELERATION, LEAST_LAG_S, SPEED_GAIN, AxisControl, AxisLumps, Mechanics
from twin.machine.commented import ASSUMED, unknown_scales
from twin.machine.lumped_file import MOTOR_PART, write_lumped_machine
from twin.machine.machine import Axis, Machine, load_machine
from twin.recordings.campaign import MeasuredRun, any_unsigned, without_scale
from twin.recordings.profile_speed import PROFILE, SIGNAL, held_samples
from twin.recordings.skew import Skew
from twin.simulation.motor_and_scale import has_both, motor_minus_scale
from twin.simulation.plant_spec import with_commissioned_inertia

EXPLAINED = 0.5
"""Share of the command's variance that the mechanics must explain; otherwise they count as unknown."""

MOST_OF_PEAK = 2.0
"""Largest part of the balance as a multiple of the largest recorded command."""

LEAST_SAMPLES = 25
"""Fewest samples of a run that is read."""

ASSUMED_GAIN, ASSUMED_LAG_S = 50.0, 1.5e-3
"""Position gain [1/s] and lag of the speed loop where the recording shows neither."""

UNKNOWN = "mass and friction cannot be identified and are assumed"


def first_values(runs: Sequence[MeasuredRun], axes: Sequence[str]) -> list[AxisLumps]:
    """Law and lumped parameters of the axes from all runs of a campaign. Raises InputError if no position or motion of one is recorded."""
    outlines = [_outline(runs, name) for name in axes]
    found = _with_laws(outlines, runs)
    cycle = min(one.held for one in found)  # one axis shows it for all
    return found if cycle >= 1.0 else _with_laws([replace(one, held=cycle) for one in outlines], runs)


def _with_laws(outlines: Sequence[AxisLumps], runs: Sequence[MeasuredRun]) -> list[AxisLumps]:
    """The axes with their laws at the cycles of these outlines."""
    with tempfile.TemporaryDirectory(prefix="twin_first_") as scratch:
        file = Path(scratch) / "machine.toml"
        write_lumped_machine(file, outlines, "a recording")
        stand_in = with_commissioned_inertia(load_machine(file))
    return [_with_law(one, runs, stand_in) for one in outlines]


def _outline(runs: Sequence[MeasuredRun], axis: str) -> AxisLumps:
    """What the recording says about an axis before its control is known; its law is assumed."""
    own = [run for run in runs if run.trace.has(axis, "setpoint")]
    kind = own[0].trace.kinds[axis]
    scale, motor = (all(r.trace.has(axis, signal) for r in own) for signal in ("position", "motor_position"))
    if not (scale or motor):
        by_speed = ", or import it without its set point: mass and friction then follow from its speed"
        known = all(r.trace.has(axis, "velocity") for r in own)
        raise InputError(f"axis {axis}: no position is recorded in every run; leave the axis out of the campaign{by_speed * known}")
    encoder = "motor" if motor and (kind == "rotary" or not scale) else "scale"
    moved = [r for r in own if len(r.trace.time) >= LEAST_SAMPLES and np.ptp(r.trace.get(axis, "setpoint")) > 0.0]
    if not moved:
        raise InputError(f"axis {axis}: it moves in no run of {LEAST_SAMPLES} samples or more; record a longer move")
    unsigned = {s for s in EFFORTS if any_unsigned(runs, axis, s)}
    effort = next((s for s in EFFORTS if s not in unsigned and all(r.trace.has(axis, s) for r in own)), "")
    notes = [f"{s} is recorded without a sign: not used; record it with its sign" for s in sorted(unsigned)]
    notes += [PROFILE] if any(axis in run.profiles for run in runs) else []
    signals = [s for s in (effort, "setpoint", "position", "motor_position") if s]
    taken = without_scale(own, axis, signals)
    if taken:
        notes.append(f"{unknown_scales(taken)} is given: give that of the column in the map")
    if not effort:
        notes.append(f"no signed current, voltage or torque is recorded: {UNKNOWN}")
    rows = strokes_of(moved, axis)
    found = effort_balance(moved, axis, effort, rows, kind) if effort and rows is not None else None
    mechanics = _mechanics(found[0], rows, kind, notes) if found is not None and rows is not None else None
    if effort and found is None:
        notes.append(f"neither friction nor inertia in the {effort} exceeds its interval: {UNKNOWN}")
    both = all(has_both(r.trace, axis) and np.ptp(motor_minus_scale(r.trace, axis)) > 0.0 for r in own)
    on_load = friction_on_load(moved, axis, rows, found[0], 1.0 - MOTOR_PART) if both and found and rows is not None else None
    paths = [r.trace.get(axis, "setpoint") for r in moved]
    speeds, accelerations = zip(*([float(np.abs(v).max()) for v in slopes_of(path, r.trace.period)] for path, r in zip(paths, moved)))
    held = held_samples([r.trace.get(axis, SIGNAL) for r in moved if r.trace.has(axis, SIGNAL)])
    noise, noise_below = least_noise([position_of(r, axis) for r in moved])
    effort_noise, effort_noise_below = least_noise([r.trace.get(axis, effort) for r in moved]) if effort else (0.0, 0.0)
    return AxisLumps(
        axis, kind, encoder, (min(float(p.min()) for p in paths), max(float(p.max()) for p in paths)), max(speeds), max(accelerations),
        moved[0].trace.period, axis_control(ASSUMED_GAIN, 0.0, 1.0, lag=ASSUMED_LAG_S), mechanics, noise, effort_noise,
        noise_below, effort_noise_below, tuple(notes), held=held or 1, unscaled=taken,
        most_inertia=max((float(np.abs(r.trace.get(axis, effort)).max()) for r in moved), default=0.0) / max(accelerations) if effort else 0.0,
        friction_on_load=on_load,
        both_encoders=both,
    )  # fmt: skip


def _mechanics(f: Friction, rows: Strokes, kind: str, notes: list[str]) -> Mechanics | None:
    """Lumped parameters of a balance, with physical signs; what it does not separate is one number."""
    if f.explained < EXPLAINED or f.against or f.inertia.high <= 0.0:
        turned = f"the {f.effort} opposes the motion" if f.against else f"motion explains {max(f.explained, 0.0):.0%} of the {f.effort}"
        notes.append(f"{turned}: {UNKNOWN}")
        return None
    largest = None
    if not f.inertia.known or f.inertia.value < 0.0:
        largest = f.inertia.high
        notes.append("the recorded accelerations give only a bound of the inertia; it is assumed below it")
    one_way, unit = f.constant is None, "m" if kind == "linear" else "rad"
    viscous = max(f.viscous.value, 0.0) if f.viscous is not None else 0.0
    coulomb = f.coulomb.value if f.coulomb is not None else f.at_speed.value - viscous * f.speed
    steady = f.speed if f.viscous is None and (one_way or f.coulomb is None) else None
    if one_way:  # as at rest, where nothing shows that more than friction opposes the motion
        direction = float(np.sign(np.sum(np.sign(rows.speed))))
        constant = direction * min(coulomb, max(direction * (f.at_rest or 0.0), 0.0))
        coulomb -= direction * constant
        whole = (
            f"{f.at_speed.number} {f.at_speed.interval} at {f.speed:.3g} {unit}/s" if f.at_speed.known else f"below {f.at_speed.high:.3g}"
        )
        notes.append(
            f"the axis moves one way only: only the sum of friction and constant {f.effort} is known, {whole}; what the axis takes at rest is given as constant"
        )
    else:
        assert f.constant is not None
        constant = f.constant.value
        if f.coulomb is None:
            shown = f"the axis moves at one speed, {f.speed:.3g} {unit}/s" if one_speed(rows.speed) else "their split is within the scatter"
            split = f"{shown}: only the sum of Coulomb and viscous friction at {f.speed:.3g} {unit}/s is known, which the two numbers of the file give together"
            none = f"no friction shows: it is below {f.at_speed.high:.3g}, in the unit of the {f.effort}, at {f.speed:.3g} {unit}/s"
            notes.append(f"{split}; record several speeds to separate them" if f.at_speed.known else none)
    gravity = (0.0, 0.0)
    if f.gravity is not None:
        cosine, sine = f.gravity
        size = math.hypot(cosine.value, sine.value)
        if not one_way and math.hypot(cosine.half, sine.half) < size < MOST_OF_PEAK * f.peak:
            gravity, constant = (cosine.value, sine.value), constant - cosine.value
        else:  # as it is where the axis moved
            constant += cosine.value * float(np.mean(np.cos(rows.position)) - 1.0) + sine.value * float(np.mean(np.sin(rows.position)))
    known = (("inertia", f.inertia if f.inertia.known else None), ("coulomb", f.coulomb or f.at_speed), ("viscous", f.viscous))
    force = None
    if f.per_load is not None and f.per_load.known and f.per_load.value > 0.0:
        force = 1.0 / f.per_load.value if EFFORTS[f.effort].constant else None
    elif f.per_load is not None:
        notes.append(
            f"the {f.effort} does not respond to the recorded load: the load is too small, or it is part of the {f.effort} "
            '(then map it as signal = "injected_command")'
        )
    return Mechanics(
        f.effort, 0.5 * largest if largest is not None else f.inertia.value, max(coulomb, 0.0), viscous, constant, gravity, f.peak,
        force, steady, one_way, largest,
        {n: v.half if v.value > 0.0 else v.high for n, v in known if v is not None and math.isfinite(v.half)},
    )  # fmt: skip


def _with_law(one: AxisLumps, runs: Sequence[MeasuredRun], stand_in: Machine) -> AxisLumps:
    """An axis with the position controller that its signals show, or with an assumed one of the recorded lag."""
    own = [r for r in runs if r.trace.has(one.name, "setpoint") and len(r.trace.time) >= LEAST_SAMPLES]
    if any(r.path_is_motion(one.name) for r in own):
        note = "no set point is recorded, the recorded motion is the path: gain, delay and feedforward of the position loop are assumed"
        return replace(with_tried(one, replace(one.law, origin=ASSUMED)), notes=(*one.notes, note))
    axis = stand_in.axis(one.name)
    seen = _seen(own, stand_in, axis)
    axis, shown = _closed(axis, seen, stand_in.setpoint_interpolation, one.both_encoders)
    one = replace(one, encoder=axis.encoder)
    law = None if isinstance(shown, str) else _position_law(shown, seen, axis)
    if law and law.cycles > 1:
        one = replace(one, held=1.0 / law.cycles)
    one, commands, found = commanded(own, one, law is None)
    if found and found.limited and one.mechanics:
        one = replace(one, mechanics=replace(one.mechanics, limited=True))
    direct, at_samples, tried = direct_law(found, commands, one, law is None)
    facts = [(run.trace.period, run.fact(one.name, "velocity")) for run in own]
    cycles = max((Skew(one.name, "velocity", f.latency, f.latency_deviation).differenced(period) for period, f in facts), default=0)
    # a recorded speed follows the law at every sample, however often the control computes: only a difference of samples shows its cycle
    held = at_samples and direct is not None and max(direct[MEAN_CYCLES], cycles) > 0
    if law is None:
        law, one = direct, replace(one, others=tried)
    elif direct is not None and at_samples and agree(direct, law):
        speed = {n: h for n, h in direct.half.items() if n in (SPEED_GAIN, INTEGRAL, MEAN_CYCLES, ACCELERATION)}
        loops = {**law.loops, **{n: direct[n] for n in (INTEGRAL, MEAN_CYCLES)}}
        law = replace(law, loops=loops, speed_gain=direct.speed_gain, acceleration=direct.acceleration, half={**law.half, **speed})
    elif (of_speed := speed_law(speed_signals(own, one))) is not None:
        held = True
        loops = {**law.loops, INTEGRAL: of_speed.speed_integral_time_s, MEAN_CYCLES: cycles}
        law = replace(
            law, loops=loops, speed_gain=of_speed.speed_gain, acceleration=of_speed.acceleration, half={**law.half, **of_speed.half}
        )
    if not (law and law.direct and held):
        one = with_tried(one, one.law)
    if law is None:
        return _with_lag(one, own)
    lags = [(path, lag) for path, lag in law.blocks.items() if path.startswith(RECORD_LAG.name)]
    inside = [replace(law, blocks={path.replace(RECORD_LAG.name, INSIDE_LAG.name): lag}) for path, lag in lags]  # the record shows no place
    return replace(
        one, law=law, others=(*one.others, *inside), notes=(*one.notes, *([f"the position controller is {law.more}"] if law.more else []))
    )


def with_tried(one: AxisLumps, law: AxisControl) -> AxisLumps:
    """An axis with a law that its command does not show: the command may move between its samples, and then bounds the inertia only."""
    return replace(one, law=law, mechanics=one.mechanics and replace(one.mechanics, between=sampled_inertia(one.period)))


def _seen(runs: Sequence[MeasuredRun], stand_in: Machine, axis: Axis) -> list[AxisRun]:
    """The runs as the axis sees them."""
    seen = []
    for run in runs:
        with contextlib.suppress(InputError):  # a piece of a few cycles
            seen.append(axis_run(stand_in, axis, run))
    return [one for one in seen if one is not None]


def _closed(axis: Axis, seen: Sequence[AxisRun], interpolation: str, both: bool) -> tuple[Axis, PositionControl | str]:
    """The axis with the encoder that closes the position loop, and the law of its recorded speed set point, or why there is none.

    Of both encoders it is the one whose position leaves clearly less of the speed set point.
    """
    if not both:
        return axis, fit_position_control(axis, seen, interpolation, any_time=True)
    axes = (axis, replace(axis, encoder="motor" if axis.encoder == "scale" else "scale"))
    plain = [plain_law(one, seen, interpolation, any_time=True) for one in axes]
    left = [math.inf if isinstance(one, str) else one.left for one in plain]

    @functools.cache
    def law(k: int) -> PositionControl | str:
        searched = plain[k]
        return searched if isinstance(searched, str) else richest_law(searched, any_time=True)

    best = int(left[1] < left[0])
    # the richer laws take long, and where the plain ones differ clearly they decide
    if left[best] < CLEARLY_LESS * left[1 - best] and not isinstance(law(best), str):
        return axes[best], law(best)
    best = int(rms_left(law(1)) < CLEARLY_LESS * rms_left(law(0)))
    return axes[best], law(best)


def _position_law(found: PositionControl, seen: Sequence[AxisRun], axis: Axis) -> AxisControl:
    """The law of a recorded speed set point, and where the position loop is closed."""
    v = {name: round(value, DIGITS) for name, value in found.values.items()}
    half = {n: h if is_determined(found, n) else math.inf for n, h in found.half.items()}
    gain, delay = v["position_gain_per_s"], max(v["position_delay_s"], 0.0)
    fed = max(v["feedforward_delay_s"], 0.0)
    # a feedforward before its set point: the control computes between the samples, and the delays take that up
    if fed > v["feedforward_delay_s"] + half["feedforward_delay_s"]:
        half |= dict.fromkeys(("velocity_feedforward", "position_delay_s", "feedforward_delay_s"), math.inf)
    # what a delay below 0 would do, less feedforward does: without the delay its weight is not known
    half["velocity_feedforward"] = math.inf if math.isinf(half["position_delay_s"]) else half["velocity_feedforward"]
    weight = v["velocity_feedforward"] + gain * (delay - v["position_delay_s"])
    law = axis_control(
        gain, delay, weight, {"feedforward_delay_s": fed}, half=half, more=found.more, blocks=found.blocks, cycles=found.cycles
    )
    loop = drive_position_loop(axis, seen, gain)
    if loop is None:
        return law
    return replace(law, lag=max(loop.lag_s, LEAST_LAG_S), loops={**law.loops, "dsc_delay_s": loop.delay_s if loop.closed_in_drive else 0.0})


def _with_lag(one: AxisLumps, runs: Sequence[MeasuredRun]) -> AxisLumps:
    """An axis without a recorded speed set point: a lag between set point and position, by the gain or by a delay under feedforward."""
    rows = strokes_of(runs, one.name)
    lags = lags_of(runs, one.name, rows)[0] if rows is not None else {}
    flag = next(iter(lags), "")
    shown = lags.get(flag, Range.around(0.0, math.inf))
    lag = max(shown.value, SHORTEST_LAG_S)
    delay = max(lag - ASSUMED_LAG_S, 0.0)
    quick = max(min(2e-3, 0.1 * lag), LEAST_LAG_S)
    delayed = axis_control(ASSUMED_GAIN, delay, 1.0, origin=ASSUMED, lag=ASSUMED_LAG_S)
    by_gain, partly = (axis_control(gain, 0.0, fed, origin=ASSUMED, lag=quick) for gain, fed in ((1.0 / lag, 0.0), (0.5 / lag, 0.5)))
    laws = [by_gain] if flag == "off" else [delayed, partly] if flag else [delayed, by_gain, partly]
    ahead, off = next((lag for word, lag in lags.items() if word != "off" and lag.known), None), lags.get("off")
    if ahead and off and off.known and off.value - max(ahead.value, 0.0) > SHORTEST_LAG_S:  # by a delay, and 1/Kv more without feedforward
        delay = max(ahead.value, 0.0)
        laws = [
            axis_control(1.0 / (off.value - delay), delay, 1.0, origin=ASSUMED, lag=ASSUMED_LAG_S),
            axis_control(1.0 / off.value, 0.0, 1.0 - delay / off.value, origin=ASSUMED, lag=quick),
        ]
    size = f"{1e3 * shown.value:.2f} ms (+-{1e3 * shown.half:.2g} ms)"
    if not shown.known:
        size = f"below {1e3 * (abs(shown.value) + shown.half):.2g} ms"
    note = (
        "no speed set point that follows a position controller is recorded: only (1 - feedforward) / gain + delays is measured, "
        f"the lag of the position, {size if math.isfinite(shown.half) else 'unknown here'}; how it is divided is tried"
    )
    return replace(one, law=laws[0], others=(*laws[1:], *one.others), notes=(*one.notes, note))
