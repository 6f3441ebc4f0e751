"""The direct route: regression on the measured signals of some runs, block by block for all axes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import math

from twin.identify.axis_run import AxisRun, Runs, control_inertia
from twin.identify.drive_balance import ITERATIONS, Balance, MeanCurrent, fit_linear
from twin.identify.drive_position_loop import DrivePositionLoop, drive_position_loop
from twin.identify.position_control import PositionControl, false_set_point_block, fit_position_control, missing_parts
from twin.identify.rotary_pair import fit_pair, pair_of
from twin.identify.speed_control import SpeedControl, fit_speed_control
from twin.machine.machine import Axis, Machine


@dataclass(frozen=True)
class Regressions:
    """Results of the regression by block; each table lacks the axes whose signals were not recorded."""

    position: dict[str, PositionControl] = field(default_factory=dict)
    speed: dict[str, SpeedControl] = field(default_factory=dict)
    balance: dict[str, Balance] = field(default_factory=dict)  # by axis, and 'A C' for the pair of A and C
    current: dict[str, MeanCurrent] = field(default_factory=dict)
    drive_loop: dict[str, DrivePositionLoop] = field(default_factory=dict)  # where the drive closes the position loop, or does in the file
    unfitted: dict[str, str] = field(default_factory=dict)  # axis -> why it has no position controller
    missing: dict[str, list[str]] = field(default_factory=dict)  # axis -> parts that the file lists and the controller does not have

    def balance_of(self, axis: str) -> Balance | None:
        """The torque balance of an axis, for one of a rotary pair that of both."""
        return next((b for b in self.balance.values() if axis in b.rows), None)

    @property
    def unexcited(self) -> set[tuple[str, str]]:
        """(axis, field of the closed-loop fit) of mechanical values that the motion of a single axis does not excite."""
        fields = ("inertia", "coulomb_friction_nm", "viscous_friction_nm_s_per_rad")
        return {(a, f) for a, b in self.balance.items() if not b.paired for f, seen in zip(fields, b.fit.seen) if not seen}


def regress_blocks(
    machine: Machine, runs: Runs, simulated: Runs | None = None, say: Callable[[str], None] = lambda _text: None
) -> Regressions:
    """Regress all blocks; `simulated` holds the same runs of a noise-free simulation, the instruments of the speed controller."""
    out = Regressions()
    moving = {name: [r for r in axis_runs if r is not None] for name, axis_runs in runs.items()}
    for axis in machine.axes:
        here = moving.get(axis.name, [])
        if not here:
            continue
        position = fit_position_control(axis, here, machine.setpoint_interpolation, any_time=not axis.actuator.winding)
        false = false_set_point_block(machine, axis, here, position)
        if false or isinstance(position, str):
            out.unfitted[axis.name] = false or str(position)
        else:
            out.position[axis.name] = position
            out.missing[axis.name] = missing_parts(machine, axis, here, position)
        if any(r.current is not None for r in here):
            out.current[axis.name] = MeanCurrent.start(machine, axis, here, control_inertia(axis), _partners(machine, axis, runs))
    _one_interpolation(machine, moving, out)
    for axis in machine.axes:
        if axis.name in out.position:
            loop = drive_position_loop(axis, moving[axis.name], out.position[axis.name].values["position_gain_per_s"])
            if loop is not None and (loop.closed_in_drive or axis.loops.dsc_delay_s > 0.0):
                out.drive_loop[axis.name] = loop
    for said in ("torque balance", "torque balance, with the control's own weights"):
        # the saw-tooth depends on the speed controller: the second time with the identified torque weight
        for name, found in out.speed.items():
            axis, inertia = machine.axis(name), out.current[name].fit.loop.inertia
            weight = found.values["torque_feedforward"] if math.isfinite(found.half["torque_feedforward"]) else 1.0
            out.current[name] = MeanCurrent.start(machine, axis, moving[name], inertia, _partners(machine, axis, runs), weight)
        _balances(machine, runs, out)
        say(said)
        for name, mean in out.current.items():
            twins = [z for r, z in zip(runs[name], simulated[name]) if r is not None] if simulated else []
            law = out.position.get(name)
            delay = law.values["feedforward_delay_s"] if law else mean.axis.loops.feedforward_delay_s
            if (speed := fit_speed_control(mean, moving[name], twins, delay)) is not None:
                out.speed[name] = speed
        say("speed controller")
    return out


def _one_interpolation(machine: Machine, moving: Mapping[str, Sequence[AxisRun]], out: Regressions) -> None:
    """A control has one interpolation for all axes: if an axis shows another one than the file's, fit the other axes again with it."""
    shown = [p.interpolation for p in out.position.values() if p.interpolation != machine.setpoint_interpolation]
    for name, found in list(out.position.items()):
        if shown and found.interpolation != shown[0]:
            again = fit_position_control(machine.axis(name), moving[name], shown[0], only=True)
            if not isinstance(again, str):
                out.position[name] = again


def _partners(machine: Machine, axis: Axis, runs: Runs) -> list[AxisRun | None]:
    """The same runs of the other axis of a rotary pair; empty for a single axis."""
    pair = pair_of(machine)
    if pair is None or axis.name not in pair.axes or not runs.keys() >= set(pair.axes):
        return []
    other = pair.outer if axis.name == pair.inner else pair.inner
    return [b for a, b in zip(runs[axis.name], runs[other]) if a is not None]


def _balances(machine: Machine, runs: Runs, out: Regressions) -> None:
    """Torque balances of all axes; mean current and inertia are updated alternately."""
    pair = pair_of(machine)
    if pair is not None and not out.current.keys() >= set(pair.axes):
        pair = None
    for _ in range(ITERATIONS):
        for name, mean in out.current.items():
            if (pair is None or name not in pair.axes) and (one := fit_linear([r for r in runs[name] if r is not None], mean)) is not None:
                out.balance[name] = one
        if pair is not None:
            both = [(a, c) for a, c in zip(runs[pair.outer], runs[pair.inner]) if a is not None and c is not None]
            if (fitted := fit_pair(machine, pair, both, (out.current[pair.outer], out.current[pair.inner]))) is not None:
                out.balance[" ".join(pair.axes)] = fitted
        for balance in out.balance.values():
            for name in balance.rows:
                i, factor = balance.place(machine.axis(name), "inertia")
                if balance.fit.seen[i]:
                    out.current[name].update(float(balance.fit.values[i] * factor))
