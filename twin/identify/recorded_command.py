"""The recorded command of an axis: the signals of its control, the encoders that close its loops, and the law that the command follows.

Where no speed set point is recorded, the current, voltage or torque shows the control, as `control.command_law` says.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
from types import MappingProxyType
from typing import Any

import numpy as np

from twin.control import position_controller
from twin.control.actuator import EFFORTS
from twin.control.block import keyed
from twin.control.command_law import FILTER_TIME, NUMBERS, CommandLaw, command_law
from twin.control.command_run import CommandRun
from twin.control.speed_controller import MEAN_CYCLES
from twin.control.structures import INTEGRAL
from twin.identify.position_control import is_narrow
from twin.machine.axis_lumps import ACCELERATION, SPEED_GAIN, AxisControl, AxisLumps
from twin.machine.commented import TRIED
from twin.recordings.campaign import MeasuredRun
from twin.recordings.profile_speed import SIGNAL
from twin.recordings.roughness import quiet_noise, step_of

DIGITS = 12
"""Decimal places of a fitted number of a controller; a remainder of 1e-17 is zero."""


def axis_control(
    gain: float, delay: float, feedforward: float, more_loops: Mapping[str, float] = MappingProxyType({}), **how: Any
) -> AxisControl:
    """A control whose feedforward is as late as its set point unless its other numbers say more; `how` as in `AxisControl`."""
    loops = {"position_gain_per_s": gain, "position_delay_s": delay, "velocity_feedforward": feedforward, "feedforward_delay_s": delay}
    return AxisControl({**loops, **more_loops}, **how)


def agree(direct: AxisControl, law: AxisControl) -> bool:
    """Whether both have the position controller in common. A current behind an inner loop nearly follows such a law, with other numbers."""
    names = ("position_gain_per_s", "velocity_feedforward", "position_delay_s")
    numbers = [(gain, fed, delay, fed - gain * delay) for own in (direct, law) for gain, fed, delay in [[own[n] for n in names]]]
    half = [direct.half.get(name, 0.0) + law.half.get(name, 0.0) for name in names]
    half.append(half[1] + law[names[0]] * half[2])  # the sum of feedforward and delay
    return all(abs(a - b) <= h for a, b, h in zip(*numbers, half))


def commanded(runs: Sequence[MeasuredRun], one: AxisLumps, alone: bool) -> tuple[AxisLumps, list[CommandRun], CommandLaw | None]:
    """An axis with the encoder that closes its position loop, its command with the signals of its control, and the law of these.

    One of two encoders may give position and speed, or the scale the position and the motor encoder the speed, as on most machine tools. What leaves
    least of the command is taken. `alone`: no other signal shows which encoder closes the loop.
    """
    encoders = ("scale", "motor") if one.both_encoders and alone else (one.encoder,)
    options = [(replace(one, encoder=encoder), False) for encoder in sorted(encoders, key=lambda encoder: encoder != one.encoder)]
    options += [(replace(one, encoder="scale"), True)] if one.both_encoders and "scale" in encoders else []
    found = []
    for own, of_motor in options:
        commands = _commands(runs, own, of_motor)
        found.append((own, commands, _possible(command_law(commands))))
    return min(found, key=lambda option: option[2].left if option[2] else math.inf)


def _commands(runs: Sequence[MeasuredRun], one: AxisLumps, of_motor: bool = False) -> list[CommandRun]:
    """The recorded command of an axis and the signals of its control: the set point of a current where it is recorded.

    `of_motor`: the scale closes the position loop, and the motor encoder the speed loop.
    """
    effort = one.mechanics.effort if one.mechanics else next((s for s in EFFORTS if all(r.trace.has(one.name, s) for r in runs)), "")
    if not effort:
        return []
    unit, output = EFFORTS[effort].unit, EFFORTS[effort].output
    output = output if all(r.trace.has(one.name, output) for r in runs) else effort
    signals = []
    for t in (r.trace for r in runs):
        command = t.get(one.name, output) - t.injections(one.name).get(unit, np.zeros(len(t.time)))
        speed = t.signals.get((one.name, "velocity"))
        setpoint, position = t.get(one.name, "setpoint"), t.get(one.name, one.where)
        motor = t.get(one.name, "motor_position") if of_motor else None
        seen = [setpoint, position, *([] if motor is None else [motor])]
        steps = (step_of(command), *map(step_of, seen))
        noise = tuple(max(math.sqrt(quiet_noise(values)[0]), step / math.sqrt(12.0)) for values, step in zip(seen, steps[1:]))
        signals.append(CommandRun(t.period, setpoint, position, speed, command, steps, noise, motor))
    return signals


def speed_signals(runs: Sequence[MeasuredRun], one: AxisLumps) -> list[tuple[CommandRun, np.ndarray]]:
    """The signals of the speed controller, and its set point."""
    seen = [r for r in runs if all(r.trace.has(one.name, s) for s in ("setpoint", SIGNAL, "velocity"))]
    return [(command, r.trace.get(one.name, SIGNAL)) for r, command in zip(seen, _commands(seen, one))]


def _possible(law: CommandLaw | None) -> CommandLaw | None:
    """The law, or None if a machine file cannot hold its numbers: those that noise gives to a command that follows none."""
    bounds = {p.name: p.bounds for p in position_controller.PARAMETERS if p.name in NUMBERS}
    return law if law and all(key.low <= getattr(law, name) <= key.high for name, key in bounds.items()) else None


def direct_law(
    found: CommandLaw | None, commands: Sequence[CommandRun], one: AxisLumps, alone: bool
) -> tuple[AxisControl | None, bool, tuple[AxisControl, ...]]:
    """The law `found` of a controller that gives the recorded command itself, without a current loop; None if the command follows none.

    Also whether the law is known to answer the signals of whole samples, and the law to be tried where noise hides what the control does between them: the
    same, or, if no other signal shows one (`alone`), that of the nearest PD controller.
    """
    near = found or (_possible(command_law(commands, nearly=True)) if alone else None)
    tried: tuple[AxisControl, ...] = ()
    if near and not near.exact and one.mechanics:
        lag = one.mechanics.inertia / near.speed_gain
        tried = (
            axis_control(
                near.position_gain_per_s, near.position_delay_s, near.velocity_feedforward, {INTEGRAL: near.speed_integral_time_s},
                origin=TRIED, lag=lag, acceleration=near.acceleration,
            ),
        )  # fmt: skip
    if found is None:
        return None, False, tried
    v = {name: round(getattr(found, name), DIGITS) for name in NUMBERS}
    # it is 0 for a delay that the law does not have
    path = found.path
    half = {n: h if is_narrow(n, v[n], h) else math.inf for n, h in found.half.items() if n in v and h > 0.0}
    half |= {"feedforward_delay_s": half["position_delay_s"]} if "position_delay_s" in half else {}
    half |= {MEAN_CYCLES: math.inf} if MEAN_CYCLES in half else {}
    law = axis_control(
        v["position_gain_per_s"], v["position_delay_s"], v["velocity_feedforward"], {n: v[n] for n in (INTEGRAL, MEAN_CYCLES)},
        speed_gain=v[SPEED_GAIN], acceleration=v[ACCELERATION], half=half,
        more=f"one of signals that are recorded {found.late} cycles before its command" if found.late else "",
        blocks={} if path.filter is None else keyed(path.filter, {path.number: (path.cycles * one.period, found.half[FILTER_TIME])}, one.kind),
    )  # fmt: skip
    return law, found.late is not None, tried
