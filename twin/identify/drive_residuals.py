"""The problem of the closed-loop drive fit: its free numbers, and what the simulated axes leave of the recorded signals.

Of an axis whose speed controller commands an ideal actuator (structures P/PI and P/P) mechanics and gains are free. Position and command are
compared. If the controller gains are assumed, the simulated axis moves as they make it, and its command would give the errors of the gains to the
mechanics. Such an axis is fitted only along its recorded path, by its command; else the regression, which needs no control, is all there is.

The regression finds all values of an axis with a current loop, if its speed controller gets the recorded signals as they are. If a filter, a reference
model, a differentiated speed or a position loop in the drive is between, mechanics and speed controller are free here, too. Where no speed set point
is recorded, only gain, delay and feedforward of the position controller are.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
import functools
import math
from typing import Any

import numpy as np

from twin.control import current_controller, drive_position_loop, position_controller, speed_controller
from twin.control.number import Search
from twin.control.structures import NC_WEIGHTS, has_recorded_law
from twin.errors import InputError, TwinError
from twin.estimate.problem import Free, Values
from twin.estimate.regression import NORMAL_95
from twin.estimate.search import STEPS, Solution, search
from twin.identify.axis_run import moved_inertia
from twin.machine.axis import path_of
from twin.machine.commented import ASSUMED, TRIED, guessed_values
from twin.machine.machine import Axis, Machine
from twin.machine.parameters import key_of, parameter
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import ENCODERS
from twin.simulation.decoupled_plant import DecoupledPlant, Motion
from twin.simulation.gap import is_moving
from twin.simulation.nominal_motion import motion_of, nominal_motion
from twin.simulation.recorded_times import at_times, simulated_period
from twin.simulation.result import Run
from twin.simulation.run import SimulationJob, simulate_on_all_cores
from twin.simulation.setpoints import Setpoints, recorded_setpoints

CLUSTER_S = 0.1

NO_FRICTION, START_FRICTION = 1e-3, 0.03
"""If the file's Coulomb friction is below NO_FRICTION of the largest command, the search starts at START_FRICTION of it. From a start near zero
the search would not increase it."""

ONE_WAY = 1e-3
"""An axis moves in one direction only if its set point never moves back faster than this share of its highest speed."""

WIDEST = 2.0
"""Largest half width of the logarithm of an identified number: a factor of 7."""

NOISY_DEVIATION = 0.004
"""Relative standard deviation of the numbers of an axis with a current loop: noise helps a recorded axis over small friction, and the simulated one
has none. On the Mikron's X it moves them by 0.1 to 0.9 %; without noise they are right within 0.04 %."""

SLIP = "presliding_stiffness"
MODE = ("mode_frequency_hz", "mode_mass_share", "mode_damping_ratio")

Fitted = dict[str, tuple[float, float]]
"""Values of one axis by field with half widths of their 95 % intervals, SI at the motor; inf: not identified."""

SETTLING_S = 0.1
"""The position still counts for this time after a motion [s]; later vibration has other causes."""


def search_of(field_name: str, force: float = 1.0) -> Search:
    """How the fit moves a number, within the bounds of a machine file; a constant force as a share of `force`."""
    if field_name == "constant_force":
        return Search(unit=force, low=-math.inf)
    if field_name == "inertia":
        return Search()
    declared = parameter(field_name)
    search, bounds = declared.search or Search(), declared.bounds
    return replace(search, low=max(search.low, bounds.low), high=min(search.high, bounds.high))


def position_is_informative(machine: Machine, name: str, runs: Sequence[MeasuredRun]) -> bool:
    """Does the position of a simulated axis depend on its mechanics rather than on assumed gains?

    The gains of a drive with an integrating speed controller (P/PI) can be identified only if its speed set point is recorded; without it
    they are assumed and the position is not informative. The gains of a P/P structure are known, unless the machine file calls its position gain
    assumed or tried.
    """
    axis = machine.axis(name)
    tried_gain = f"axis.{name}.{key_of('position_gain_per_s', axis.kind)}" in guessed_values(machine, (ASSUMED, TRIED))
    known = axis.loops.one_law and not tried_gain
    tried = not (axis.actuator.winding or known) and not any(r.trace.has(name, "velocity_setpoint") for r in runs)
    return not (tried and any(r.trace.has(name, axis.effort) for r in runs))


def follows_recorded_path(axis: Axis, runs: Sequence[MeasuredRun]) -> bool:
    """Is the set point of an axis its recorded path in all runs that move it, as for a drive whose control is unknown?"""
    moved = [r.trace for r in runs if r.trace.moves(axis.name)]
    recorded = [[t.get(axis.name, s) for s in ENCODERS if t.has(axis.name, s)] for t in moved]
    return bool(moved) and all(any(np.array_equal(t.get(axis.name, "setpoint"), q) for q in paths) for t, paths in zip(moved, recorded))


class DriveResiduals:
    """The problem of the fitted axes: each axis is a part, its free numbers are (axis, field) in the code of `search_of`."""

    def __init__(
        self,
        machine: Machine,
        runs: Sequence[MeasuredRun],
        rows: Mapping[str, Sequence[np.ndarray]],
        known: Collection[tuple[str, str]],
        axes: Collection[str],
        say: Callable[[str], None] = lambda _text: None,
    ) -> None:
        """`rows` of each axis are (sample,) bool of each run; loop values in `known` (axis, field) are kept; `say` reports the steps of a search."""
        self.machine, self.runs, self.rows, self.known, self.say = machine, runs, rows, known, say
        self.fields = {a.name: own for a in machine.axes if a.name in axes and (own := self._fields_of(a))}
        self.names = list(self.fields)
        self.free = [self._free(n, f) for n in self.names for f in self.fields[n]]
        self.used = {
            (n, s): {i: rows[n][i] & self._counts(run, n, s) for i, run in enumerate(runs) if run.trace.has(n, s)}
            for n in self.names
            for s in self.signals(n)
        }
        """Rows (sample,) of each axis and signal by the runs that have it."""
        self.setpoints = [recorded_setpoints(r.trace, machine) for r in runs]
        self.motions = [_motion_of(machine.with_feedforward(r.feedforward), s) for r, s in zip(runs, self.setpoints)]
        self.scale = {(n, s): max(1e-12, *(float(np.ptp(runs[i].trace.get(n, s))) for i in used)) for (n, s), used in self.used.items()}

    def of(self, machine: Machine, axes: Collection[str], rows: Mapping[str, Sequence[np.ndarray]] | None = None) -> "DriveResiduals":
        """The same problem of some axes of another machine, on the same rows or others."""
        return DriveResiduals(machine, self.runs, rows or self.rows, self.known, axes, self.say)

    def searched(self, start: Values | None = None, steps: int = STEPS) -> Solution | None:
        """The end of a search from `start`; None if there are no residuals there."""
        return search(self, start, steps, lambda k: self.say(f"drive fit step {k}"))

    def fed(self, axis: Axis) -> list[str]:
        """Weights of the NC's feedforward that may act in a run; without a note in the recording, that of the speed, and that of the torque if the file has it."""
        unsaid = "velocity+torque" if axis.loops.torque_feedforward else "velocity"
        return [name for word, name in NC_WEIGHTS.items() if any(word in (r.feedforward or unsaid) for r in self.runs)]

    def _counts(self, run: MeasuredRun, name: str, signal: str) -> np.ndarray:
        """Mask (sample,): the command counts while the set point moves, because at rest it depends on history; a position until it has settled."""
        moving = is_moving(run.trace, self.machine.axis(name))
        if signal == self.machine.axis(name).effort:
            return moving
        since = np.arange(len(moving)) - np.maximum.accumulate(np.where(moving, np.arange(len(moving)), -len(moving)))
        return since * run.trace.period <= SETTLING_S

    def signals(self, name: str) -> list[str]:
        """Recorded signals of an axis that are compared."""
        axis = self.machine.axis(name)
        wanted = ("position", "motor_position", axis.effort) if position_is_informative(self.machine, name, self.runs) else (axis.effort,)
        return [s for s in wanted if any(r.trace.has(name, s) for r in self.runs)]

    def _fields_of(self, axis: Axis) -> list[str]:
        """The free numbers of an axis; none if the recording does not show them."""
        moved = [r.trace for r in self.runs if r.trace.moves(axis.name) and r.trace.has(axis.name, axis.effort)]
        decided = position_is_informative(self.machine, axis.name, self.runs) or follows_recorded_path(axis, self.runs)
        if not decided or not any(trace.has(axis.name, s) for trace in moved for s in ENCODERS):
            return []
        speed_recorded = any(r.trace.has(axis.name, "velocity_setpoint") for r in self.runs)
        if axis.actuator.winding and not speed_recorded:
            return axis.loops.searched(position_controller.PARAMETERS, self.fed(axis))
        if axis.actuator.winding and has_recorded_law(axis.loops, axis.blocks):
            return []
        fields = ["inertia", "coulomb_friction_nm", "viscous_friction_nm_s_per_rad", "constant_force"]
        if speed_recorded and not axis.loops.one_law:
            fields += axis.loops.searched((*speed_controller.PARAMETERS, *current_controller.PARAMETERS), self.fed(axis))
        fields += axis.loops.searched(drive_position_loop.PARAMETERS)
        fields += [f for f in (SLIP, *MODE) if getattr(axis, f) > 0.0]
        return [f for f in fields if (axis.name, f) not in self.known]

    def _free(self, n: str, field_name: str) -> Free:
        search = self._search(n, field_name)
        code = search.coded(self._value(n, field_name))
        return Free((n, field_name), float(np.clip(code, *search.bounds)), search.step, n, *search.bounds)

    def softer(self) -> dict[Any, float]:
        """Initial values with half the gains and twice the integral time, for a machine file whose loops are unstable."""
        return {f.name: f.start + search_of(f.name[1]).softer for f in self.free}  # type: ignore[index]

    def _value(self, name: str, field_name: str) -> float:
        axis = self.machine.axis(name)
        if field_name == "inertia":
            return axis.rotor_inertia_kg_m2 + moved_inertia(axis)
        if field_name == "constant_force":
            listed = [e for e in self.machine.effects if e.get("name") == "constant_force" and e.get("axis") == name]
            return axis.constant_force + sum(float(e["force"]) for e in listed)
        if hasattr(axis.loops, field_name):  # a weight of 0 becomes 1 where a run has the feedforward on
            return float(getattr(axis.loops, field_name)) or float(field_name in NC_WEIGHTS.values())
        value, peak = float(getattr(axis, field_name)), self._peak(name)
        if field_name in (SLIP, *MODE):
            return value
        if field_name == "coulomb_friction_nm" and value < NO_FRICTION * peak:
            return START_FRICTION * peak
        return max(value, 1e-6 * peak)

    def _peak(self, name: str) -> float:
        """Largest recorded command as a torque at the motor [Nm]."""
        axis = self.machine.axis(name)
        largest = max(float(np.abs(r.trace.get(name, axis.effort)).max()) for r in self.runs if r.trace.has(name, axis.effort))
        return max(largest * axis.motor.torque_constant_nm_per_a, 1e-12)

    def _search(self, name: str, field_name: str) -> Search:
        return search_of(field_name, self._peak(name) / self.machine.axis(name).ratio if field_name == "constant_force" else 1.0)

    def found(self, name: str, x: Values) -> dict[str, float]:
        """The numbers of an axis at these values of the search."""
        return {f: self._search(name, f).decoded(x[name, f]) for f in self.fields[name]}

    def values(self, x: Values, axes: Collection[str]) -> tuple[dict[str, object], dict[str, float]]:
        """Values of some axes by their paths in the file, and constant forces [N or Nm at the axis] by axis."""
        values: dict[str, object] = {}
        forces = {}
        for n in axes:
            axis = self.machine.axis(n)
            for f, value in self.found(n, x).items():
                if f == "constant_force":
                    forces[n] = value
                elif f == "inertia":
                    values.update(self._inertia(n, value))
                else:
                    values[f"axis.{n}.{key_of(f, axis.kind)}"] = value
        return values, forces

    def _inertia(self, name: str, inertia: float) -> dict[str, object]:
        """File values for a total inertia at the motor: rotor and load scale together, or the part that the file has changes."""
        axis = self.machine.axis(name)
        load = moved_inertia(axis)
        if axis.rotor_inertia_kg_m2 > 0.0:
            # keep the shares of rotor and load if the load is known
            share = load / (load + axis.rotor_inertia_kg_m2) if axis.moving_mass_kg is not None else 0.0
            out: dict[str, object] = {path_of(axis, "rotor_inertia"): inertia * (1.0 - share) if share else max(inertia - load, 1e-12)}
            if share:
                out[path_of(axis, "moving_mass")] = inertia * share / axis.ratio**2
            return out
        return {path_of(axis, "moving_mass"): inertia / axis.ratio**2}

    def fits_rotor(self, name: str) -> bool:
        """Is `inertia` that of the rotor alone, beside a load whose inertia is that of the model?"""
        axis = self.machine.axis(name)
        return "inertia" in self.fields[name] and axis.moving_mass_kg is None and axis.rotor_inertia_kg_m2 > 0.0

    def residuals(self, many: Sequence[Values]) -> list[dict[str, dict[str, np.ndarray]] | None]:
        """Measured less simulated on the training rows, by axis and signal, in units of the signal's range; None where it diverges."""
        jobs: list[SimulationJob] = []
        first: list[int | None] = []
        for x in many:
            try:
                machine = with_constant_forces(self.machine, *self.values(x, self.names))
            except InputError:
                first.append(None)
                continue
            first.append(len(jobs))
            fed = {word: machine.with_feedforward(word) for word in {run.feedforward for run in self.runs}}
            for run, setpoints, motion in zip(self.runs, self.setpoints, self.motions):
                plant = functools.partial(DecoupledPlant, motion=motion)
                period = simulated_period(machine, run.trace.period)
                jobs.append(SimulationJob(fed[run.feedforward], setpoints, plant, period, run.started_at))
        outcomes = simulate_on_all_cores(jobs)
        return [self._compared(outcomes[i : i + len(self.runs)]) if i is not None else None for i in first]

    def _compared(self, outcomes: Sequence[Run | TwinError]) -> dict[str, dict[str, np.ndarray]] | None:
        if any(isinstance(o, TwinError) for o in outcomes):
            return None
        traces = [at_times(o.trace, run.trace.time) for o, run in zip(outcomes, self.runs) if isinstance(o, Run)]
        out: dict[str, dict[str, np.ndarray]] = {n: {} for n in self.names}
        for (n, s), used in self.used.items():
            left = (
                np.concatenate([(self.runs[i].trace.get(n, s) - traces[i].get(n, s))[rows] for i, rows in used.items()]) / self.scale[n, s]
            )
            # the zero of an encoder is arbitrary
            out[n][s] = left if s == self.machine.axis(n).effort else left - float(np.median(left))
        return out

    def clusters(self, name: str) -> dict[str, np.ndarray]:
        """Cluster (row,) of the rows of each signal of an axis; all signals of an interval CLUSTER_S form one cluster."""
        times = [run.trace.time - run.trace.time[0] for run in self.runs]
        of_runs = [1_000_000 * i + (time / CLUSTER_S).astype(int) for i, time in enumerate(times)]
        return {s: np.concatenate([of_runs[i][rows] for i, rows in used.items()]) for (n, s), used in self.used.items() if n == name}

    def _moves_one_way(self, name: str) -> bool:
        """Do the set points of an axis move in one direction only on its training rows?"""
        moving = [is_moving(run.trace, self.machine.axis(name)) & rows for run, rows in zip(self.runs, self.rows[name])]
        steps = np.concatenate([np.diff(run.trace.get(name, "setpoint"))[rows[1:]] for run, rows in zip(self.runs, moving)])
        return min(steps.max(initial=0.0), -steps.min(initial=0.0)) <= ONE_WAY * np.abs(steps).max(initial=0.0)

    def result(self, n: str, end: Solution) -> Fitted:
        """Values of one axis with their intervals at the end of a search."""
        found, values, half = end.half_widths(n), self.found(n, end.values), {}
        for f, value in values.items():
            h, unit = found[n, f], self._search(n, f).unit
            if self.machine.axis(n).actuator.winding and not unit:
                h = math.hypot(h, NORMAL_95 * NOISY_DEVIATION)
            if not math.isfinite(h) or (not unit and h > WIDEST) or (f == "constant_force" and h > 1.0):  # beyond the largest command
                h = math.inf
            half[f] = float(h * (unit or value))
        if self._moves_one_way(n) and "coulomb_friction_nm" in values and "constant_force" in values:
            # Only the stops of such an axis separate friction from load, and no model of friction at rest is accurate enough for that.
            half["coulomb_friction_nm"] = math.inf
            half["constant_force"] = math.hypot(half["constant_force"], values["coulomb_friction_nm"] / self.machine.axis(n).ratio)
        return {f: (value, half[f]) for f, value in values.items()}


def _motion_of(machine: Machine, setpoints: Setpoints) -> Motion:
    """The motion along which inertia and gravity are evaluated; along the set points if the machine file does not follow them."""
    try:
        return nominal_motion(machine, setpoints)
    except TwinError:
        return motion_of(setpoints.position, setpoints.period)


def with_constant_forces(machine: Machine, values: Mapping[str, object], forces: Mapping[str, float]) -> Machine:
    """The machine with these values of the file, and constant forces [N or Nm at the axis] in place of effects `constant_force` on these axes."""
    loads = {f"axis.{n}.constant_torque_nm": f * machine.axis(n).ratio for n, f in forces.items()}
    kept = [dict(e) for e in machine.effects if not (e.get("name") == "constant_force" and e.get("axis") in forces)]
    return machine.with_values({**values, **loads, **({"effect": kept} if len(kept) < len(machine.effects) else {})})
