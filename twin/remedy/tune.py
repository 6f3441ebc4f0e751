"""Gains, feedforward and delays of a healthy machine: as fast as the asked margins allow, delays fitted along the program.

    speed loop     Kp = J / (a T),  Tn = a^2 T       symmetrical optimum in its general form; a = 2 is that of the textbooks
                   T: the small times of the loop together, from the phase of the sampled model;  a: the smallest that keeps the margins
    position loop  Kv: the largest that keeps the margins on every axis; one value, because unequal gains of axes distort contours
    feedforward    speed 1, torque 1 where the control has one
    delays         tau of an axis: delay of the set point of the position controller behind its feedforward that leaves the smallest error on
                   the program; the whole delay is that of the slowest axis, and the feedforward of the others waits. An axis that the
                   program does not move counts as the slowest.

If the tuned machine reaches more than LARGEST_SHARE of a peak current that the old one does not, its speed loops are slowed. Margins: those of `twin
machine check`, sampled, in the home pose. Without a spring in the machine file no mode limits the gains; the caller says so.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np

from twin.control.speed_controller import symmetrical_optimum
from twin.effects import EFFECTS, Setting, apply_effects, settings_of, with_effects
from twin.effects.change import load_inertia, reduced_mass
from twin.effects.elasticity import COMPLIANCE_DAMPING_RATIO
from twin.errors import InputError
from twin.machine.check import LARGEST_SHARE, Asked
from twin.machine.loops import Margins, loops_of, margins_of
from twin.machine.machine import Axis, Machine
from twin.remedy.predict import Motionful, ToolError, decoupled, tool_error
from twin.simulation.errors_of_run import AxisErrors, axis_errors
from twin.simulation.plant_spec import home_inertia_at_motor

SPRING = "transmission_compliance"
TEXTBOOK, SLOWEST = 2.0, 16.0
"""Range of a: the symmetrical optimum, and a loop so slow that no margin is the reason."""
SLOWER = 1.15
"""Factor on a while a current comes near its limit."""
LAGS = np.linspace(0.0, 4e-3, 17)
"""Delays that are tried first [s]."""
FIRST_CYCLES = 4.0
"""First guess of the small times, in speed cycles."""
LOWEST_MODE_HZ, HIGHEST_MODE, STEP = 5.0, 0.1, 1.1
"""Modes that are tried: the highest, in periods a tick, then down by a factor."""


@dataclass(frozen=True)
class Tuned:
    """One set of values, judged on the program: machine, margins of speed and position loop and errors by axis, error of the tool point."""

    name: str
    machine: Machine
    margins: dict[str, tuple[Margins, Margins]]
    errors: dict[str, AxisErrors]
    tool: ToolError


def tune(machine: Machine, on: Motionful, asked: Asked, say: Callable[[str], None] = lambda _text: None) -> tuple[Tuned, Tuned, Tuned]:
    """The values in the file, the symmetrical optimum, and the tuned ones. Raises InputError if no gain keeps the margins."""
    springs = [s for s in settings_of(machine) if s.effect.name == SPRING]
    # its default damping would rise with the gain that is sought
    fixed = [_spring(machine, machine.axis(s.axis), **s.parameters) for s in springs]
    healthy = with_effects(machine, fixed)
    small = {axis.name: small_times(healthy, axis) for axis in healthy.axes}
    say("judging the values in the file")
    before = _judged("in the file", healthy, on)
    textbook = _with_speed_loops(healthy, small, dict.fromkeys(small, TEXTBOOK))
    textbook = _with_position_gain(textbook, min(1.0 / (8.0 * t) for t in small.values()))
    factors = {axis.name: _fastest(healthy, axis, small, asked) for axis in healthy.axes}
    while True:
        say("tuning")
        tuned = _with_speed_loops(healthy, small, factors)
        tuned = _with_position_gain(tuned, min(_largest_gain(tuned, axis.name, asked) for axis in tuned.axes))
        torque = {a.name: {"torque_feedforward": 1.0} if a.loops.torque_feedforward else {} for a in tuned.axes}
        fed = tuned.with_loops({name: {"velocity_feedforward": 1.0, **own} for name, own in torque.items()})
        after = _judged("tuned", _with_delays(fed, on), on)
        if (
            all(after.tool.shares[a] <= max(LARGEST_SHARE, share) for a, share in before.tool.shares.items())
            or max(factors.values()) > SLOWEST
        ):
            return before, _judged("symmetrical optimum", textbook, on), after
        factors = {name: SLOWER * a for name, a in factors.items()}


def changed_numbers(old: Machine, new: Machine) -> dict[str, tuple[float, float]]:
    """Key of the machine file -> old and new value, of the numbers that tuning moves."""
    out = {}
    for axis in old.axes:
        for key in vars(axis.loops):
            was, now = (getattr(m.axis(axis.name).loops, key) for m in (old, new))
            if not math.isclose(was, now, rel_tol=1e-9, abs_tol=1e-12):
                out[f"axis.{axis.name}.loops.{key}"] = (was, now)
    return out


def small_times(machine: Machine, axis: Axis) -> float:
    """T [s]: phase of the open speed loop without integral part beyond that of an inertia, over the frequency, at 1 / (2 T)."""
    slow = machine.with_loops({axis.name: {"speed_integral_time_s": 1e3}})
    loop = loops_of(slow, slow.axis(axis.name))[-2]
    inertia = float(home_inertia_at_motor(machine)[machine.axis_names.index(axis.name)])
    small = FIRST_CYCLES * machine.speed_cycle
    for _ in range(20):
        w = 0.5 / small
        friction = math.atan2(axis.viscous_friction_nm_s_per_rad, w * inertia)  # leads
        lag = -math.pi / 2.0 + friction - float(np.angle(loop.open_response(np.array([w / (2.0 * math.pi)])))[0])
        small = max(lag / w, 0.5 * machine.speed_cycle)
    return small


def mode_needed(machine: Machine, axis: Axis, asked: Asked) -> float | None:
    """The lowest first mode [Hz] that leaves the loops of an axis half of the margins, to STEP; None if the file has a spring."""
    if axis.name in apply_effects(machine).couplings:
        return None
    settings = settings_of(machine)
    load = load_inertia(machine, axis)
    half = Asked({name: 0.5 * phase for name, phase in asked.phase.items()}, math.sqrt(asked.gain), math.inf)

    def keeps(hz: float) -> bool:
        spring = _spring(machine, axis, (2.0 * math.pi * hz) ** 2 * load)
        return not half.missed_by(with_effects(machine, [*settings, spring]), axis.name)

    # from above: far below the bandwidth a mode is another loop, whose margins say nothing about this one
    hz = HIGHEST_MODE / machine.base_tick
    while hz > LOWEST_MODE_HZ and keeps(hz / STEP):
        hz /= STEP
    return hz


def _spring(machine: Machine, axis: Axis, stiffness: float, damping: float | None = None) -> Setting:
    """A spring between motor and load with a damping that does not depend on the gains."""
    if damping is None:
        damping = 2.0 * COMPLIANCE_DAMPING_RATIO * math.sqrt(stiffness * reduced_mass(machine, axis))
    return Setting(EFFECTS[SPRING], axis.name, {"stiffness": stiffness, "damping": damping})


def _with_speed_loops(machine: Machine, small: Mapping[str, float], factors: Mapping[str, float]) -> Machine:
    inertia = zip(machine.axis_names, home_inertia_at_motor(machine).tolist())
    return machine.with_loops({name: symmetrical_optimum(own, factors[name], small[name]) for name, own in inertia})


def _with_position_gain(machine: Machine, gain: float) -> Machine:
    return machine.with_loops({name: {"position_gain_per_s": gain} for name in machine.axis_names})


def _fastest(machine: Machine, axis: Axis, small: Mapping[str, float], asked: Asked) -> float:
    """The smallest a that keeps the margins of the speed loop of an axis."""

    def keeps(a: float) -> bool:
        own = _with_speed_loops(machine, small, {**dict.fromkeys(small, TEXTBOOK), axis.name: a})
        return not asked.missed(loops_of(own, own.axis(axis.name))[-2])

    return _edge(keeps, TEXTBOOK, SLOWEST, f"axis {axis.name}: no gain of the speed loop keeps the asked margins; ask for less")


def _largest_gain(machine: Machine, axis: str, asked: Asked) -> float:
    """The largest Kv [1/s] that keeps the margins of the position loop of an axis."""

    def keeps(slowness: float) -> bool:
        own = machine.with_loops({axis: {"position_gain_per_s": 1.0 / slowness}})
        return not asked.missed(loops_of(own, own.axis(axis))[-1])

    cycle = machine.position_cycle
    return 1.0 / _edge(keeps, cycle, 1e4 * cycle, f"axis {axis}: no position gain keeps the asked margins; ask for less")


def _edge(keeps: Callable[[float], bool], low: float, high: float, refusal: str) -> float:
    """The smallest number in a range that keeps, to 1 %; numbers above it keep as well. Raises InputError if none does."""
    if keeps(low):
        return low
    if not keeps(high):
        raise InputError(refusal)
    while high > 1.01 * low:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if keeps(middle) else (middle, high)
    return high


def _with_delays(machine: Machine, on: Motionful) -> Machine:
    """The machine with delays fitted along the program: all axes equally late, the Kv branch of each tau behind its feedforward."""
    first = [a.loops.feedforward_delay_s for a in machine.axes]

    def late(lags: Sequence[float]) -> Machine:
        return machine.with_loops({a.name: {"position_delay_s": f + lag} for a, f, lag in zip(machine.axes, first, lags)})

    tried = [late([lag] * len(first)) for lag in LAGS]
    errors = np.array(
        [[axis_errors(t, m.axis(a.name)).without_delay_rms for a in machine.axes] for m, t in zip(tried, decoupled(tried, on))]
    )
    moved = [errors[:, i].max() > 0.0 for i in range(len(first))]
    if not any(moved):
        raise InputError(f"{on.name}: no axis moves; give a program that moves the axes to be tuned")
    found = [_lowest(errors[:, i]) if moved[i] else None for i in range(len(first))]
    slowest = max(lag for lag in found if lag is not None)
    lags = [slowest if lag is None else lag for lag in found]
    whole = max(f + lag for f, lag in zip(first, lags))
    delays = {a.name: {"position_delay_s": whole, "feedforward_delay_s": whole - lag} for a, lag in zip(machine.axes, lags)}
    return machine.with_loops({name: {key: round(s, 5) for key, s in own.items()} for name, own in delays.items()})  # 0.01 ms, as shown


def _lowest(values: np.ndarray) -> float:
    """Lag at the lowest point of a parabola through the smallest value and its neighbours [s]."""
    i = int(np.clip(np.argmin(values), 1, len(values) - 2))
    a, b, c = values[i - 1 : i + 2] ** 2
    bend = a - 2.0 * b + c
    return float(LAGS[i] + (0.5 * (a - c) / bend if bend > 0.0 else 0.0) * (LAGS[1] - LAGS[0]))


def _judged(name: str, machine: Machine, on: Motionful) -> Tuned:
    [trace] = decoupled([machine], on)
    axes = [a for a in machine.axes if trace.has(a.name, "position")]
    return Tuned(
        name,
        machine,
        {a.name: tuple(margins_of(loop) for loop in loops_of(machine, a)[-2:]) for a in axes},  # type: ignore[misc]
        {a.name: axis_errors(trace, a) for a in axes},
        tool_error(trace, machine),
    )
