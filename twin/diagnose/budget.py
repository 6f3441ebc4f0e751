"""The gap budget: the contribution of each effect, each normal imperfection, and the re-tuned values of each axis and body.

The corrected machine is simulated with and without a contribution. The difference is given as

    tool point    RMS of the true tool point in the part frame, including motion that no encoder measures
    position      RMS of the true position of the contribution's axis
    signals       RMS of the recorded signals of the axis: position, motor position, current
    times noise   RMS over all runs and those of these signals that were recorded, in multiples of their noise

Contributions overlap. `alone` is the same difference for the nominal machine with this contribution only. The root sum of squares of all
contributions is the combined change if they are independent. If it is larger than the combined change, contributions partly cancel; if it is
smaller, they add up in phase.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from twin.diagnose.corrected import limited_deviations, normal_imperfections
from twin.diagnose.simulations import Mapper, SimulationRequest, simulate_groups
from twin.diagnose.state import GroupState
from twin.diagnose.tolerance import tuned
from twin.diagnose.tool_point import LOAD, ToolPoint
from twin.diagnose.tuning import moved_by
from twin.diagnose.view import RunView
from twin.effects import Setting, settings_of, with_effects
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.recordings.trace import ENCODERS, Trace
from twin.simulation.gap import SignalGap, gap_unit, is_moving
from twin.units import AXIS_UNITS, plain

SIGNALS = (*ENCODERS, "current")
"""Signals of a row; its multiple of noise is taken over them."""

RETUNED = "values within tolerance"
"""Name of the row of all re-tuned values of an axis, or of mass and inertia of a body. One by one they mostly cancel each other."""

FINDINGS = ("effect", "law")
"""Kinds of rows that are findings."""

UNIT = "um at the tool point, RMS"


@dataclass(frozen=True)
class Row:
    """One contribution: RMS over all runs, SI. `largest` [m] is the largest change at the tool point, in run `run` at time `at_s`, with the tool point
    `at` [m] in the part frame.
    """

    kind: str  # effect, law, re-tuned or normal
    name: str
    axis: str
    tool_point: float
    alone: float
    position: float
    signals: dict[str, float]
    times_noise: float
    largest: float
    run: str
    at_s: float
    at: tuple[float, ...] = ()
    setting: Setting | None = None


@dataclass(frozen=True)
class Budget:
    """Contributions, largest at the tool point first, and the tool-point gap [m]: change from the nominal to the corrected machine (`explained`),
    remaining gap on held-out runs (`left`), noise (`floor`).
    """

    rows: tuple[Row, ...]
    explained: float
    left: float
    floor: float
    left_by_axis: dict[str, float]

    @property
    def one_out(self) -> float:
        """Root sum of squares of the contributions, each removed from the corrected machine."""
        return float(np.sqrt(sum(row.tool_point**2 for row in self.rows)))

    @property
    def one_in(self) -> float:
        """Root sum of squares of the contributions, each added alone to the nominal machine."""
        return float(np.sqrt(sum(row.alone**2 for row in self.rows)))

    @property
    def before(self) -> float:
        """Tool-point gap of the nominal machine: root sum of squares of the explained and the remaining gap, which are independent."""
        return float(np.hypot(self.explained, self.left))


class Part(NamedTuple):
    """A contribution that can be removed from the corrected machine."""

    kind: str
    name: str
    axis: str
    moved: tuple[str, ...]  # axes whose motion changes
    without: Machine
    alone: Machine
    setting: Setting | None


class _Change(NamedTuple):
    """Mean squares of a change in one run: tool point, true position of the axis, signals; and the largest change at the tool point."""

    tool: float
    position: float
    signals: dict[tuple[str, str], float]
    largest: float
    at_s: float
    at: tuple[float, ...]


UNCHANGED = _Change(0.0, 0.0, {}, 0.0, 0.0, ())


def budget_over(
    parts: Sequence[Part],
    machine: Machine,
    corrected: Machine,
    views: Sequence[RunView],
    residual: Sequence[Trace | None],
    noise: Mapping[tuple[str, str], float],
    mapper: Mapper = map,
) -> Budget:
    """The budget of these differences between two machines over the motion of `views`.

    `residual` is the position residual of the corrected machine in each run (None: not measured), `noise` the noise of each recorded signal [SI].
    """
    tool = ToolPoint(machine)
    read = {LOAD, *(axis.recorded_as(signal) for axis in machine.axes for signal in SIGNALS)}

    def motion(_: int, trace: Trace | None) -> Trace | None:
        """Copies of the signals that a change reads, without the record of the simulation."""
        return trace and replace(trace, signals={key: values.copy() for key, values in trace.signals.items() if key[1] in read})

    both = simulated_each([(view, own, machine.axis_names) for own in (corrected, machine) for view in views], mapper, motion)
    plan, nominal = both[: len(views)], both[len(views) :]
    jobs = [(part, run) for part in parts for run in range(len(views))]
    requested = [(views[run], own, part.moved) for part, run in jobs for own in (part.without, part.alone)]

    def change(i: int, trace: Trace | None) -> _Change:
        part, run = jobs[i // 2]
        return _change(machine, tool, views[run], (nominal if i % 2 else plan)[run], trace, part)

    each = simulated_each(requested, mapper, change)
    changes = list(zip(each[::2], each[1::2]))
    names = [view.name for view in views]
    rows = [_row(machine, part, [c for c, (p, _) in zip(changes, jobs) if p is part], names, noise) for part in parts]
    explained = _rms([tool.squares(plan[r], nominal[r], machine.axis_names) for r in range(len(views))])
    measured = [r for r, trace in enumerate(residual) if trace is not None]
    by_axis = {a: _rms([tool.squares_of(plan[r], residual[r], (a,)) for r in measured]) for a in machine.axis_names}
    floor = _rms([tool.noise_squares(plan[r]) for r in range(len(views))])
    whole = _rms([tool.squares_of(plan[r], residual[r], machine.axis_names) for r in measured])
    order = sorted(rows, key=lambda row: (-row.tool_point, row.axis, row.name))
    return Budget(tuple(order), explained, whole, floor, by_axis)


def parts_of(machine: Machine, corrected: Machine, states: Sequence[GroupState]) -> Iterable[Part]:
    """All differences between the corrected and the nominal machine."""
    rotary = tuple(a.name for a in machine.axes if a.kind == "rotary")
    settings = settings_of(corrected)
    effects = {s.key: s for f in states for s in f.fit.settings}
    normal = {s.key for s in normal_imperfections(machine, states)}
    for own in settings:  # an imperfection in series with an effect of the same name is in its row
        kind = "effect" if own.key in effects else "normal" if own.key in normal else "law"
        without = with_effects(corrected, [s for s in settings if s is not own])
        named = None if kind == "normal" else effects.get(own.key, own)
        yield Part(kind, own.effect.name, own.axis, moved_by([own], rotary), without, with_effects(machine, [own]), named)
    for f in states:
        nuisances, deviations = f.tuning.nuisances, limited_deviations(f)
        retuned = [i for i, n in enumerate(nuisances) if not n.is_imperfection and deviations[i]]
        for owner in dict.fromkeys(nuisances[i].owner for i in retuned):
            mine = [i for i in retuned if nuisances[i].owner == owner]
            values, by = [nuisances[i] for i in mine], deviations[mine]
            moved = values[0].axes(rotary)
            yield Part("re-tuned", RETUNED, owner, moved, tuned(values, -by / (1.0 + by))(corrected), tuned(values, by)(machine), None)


def simulated_each(
    requested: Sequence[tuple[RunView, Machine, Sequence[str]]], mapper: Mapper, of: Callable[[int, Trace | None], Any]
) -> list[Any]:
    """Result of `of` for the noise-free simulation of each request (view, machine, axes); `of` gets None if the simulation fails.

    Axes at rest are simulated too: their screws grow, and they are the lever of a rotary axis.
    """

    def request(view: RunView, machine: Machine, axes: Sequence[str]) -> SimulationRequest:
        own = machine.with_feedforward(view.feedforward) if view.feedforward else machine
        return SimulationRequest(view, axes, lambda _: own)

    outcomes = simulate_groups([request(*one) for one in requested], mapper, lambda i, run: of(i, run.without_noise))
    return [of(i, None) if isinstance(outcome, TwinError) else outcome for i, outcome in enumerate(outcomes)]


def _change(machine: Machine, tool: ToolPoint, view: RunView, base: Trace | None, other: Trace | None, part: Part) -> _Change:
    """Change of the motion of a run."""
    if base is None or other is None:
        return UNCHANGED
    shown = [a for a in part.moved if other.has(a, LOAD) and base.has(a, LOAD)]
    distance = tool.distance(base, other, shown)
    signals = {}
    for axis in shown:
        own = machine.axis(axis)
        for signal in SIGNALS:
            name = own.recorded_as(signal)
            difference = other.get(axis, name) - base.get(axis, name)
            if signal == "current":
                difference = difference[is_moving(view.trace, own)]
            signals[axis, signal] = float(np.mean(difference**2)) if difference.size else 0.0
    own_axis = part.axis if part.axis in shown else (shown[0] if shown else "")
    position = float(np.mean((other.get(own_axis, LOAD) - base.get(own_axis, LOAD)) ** 2)) if own_axis else 0.0
    at = int(np.argmax(distance))
    largest = float(distance[at])
    return _Change(float(np.mean(distance**2)), position, signals, largest, float(view.trace.time[at]), tool.at(base, at))


def _row(
    machine: Machine,
    part: Part,
    changes: Sequence[tuple[_Change, _Change]],
    names: Sequence[str],
    noise: Mapping[tuple[str, str], float],
) -> Row:
    out = [o for o, _ in changes]
    worst = max(range(len(out)), key=lambda i: out[i].largest)
    axis = part.axis if part.axis in machine.axis_names else part.moved[0]
    signals = {signal: _rms([c.signals.get((axis, signal), 0.0) for c in out]) for signal in SIGNALS}
    # a signal that was not recorded has no noise to compare with
    over_noise = [square / noise[key] ** 2 for c in out for key, square in c.signals.items() if key in noise]
    places = max(len(noise) * len(out), 1)
    return Row(
        kind=part.kind,
        name=part.name,
        axis=part.axis,
        tool_point=_rms([o.tool for o in out]),
        alone=_rms([a.tool for _, a in changes]),
        position=_rms([o.position for o in out]),
        signals=signals,
        times_noise=float(np.sqrt(sum(over_noise) / places)),
        largest=out[worst].largest,
        run=names[worst],
        at_s=out[worst].at_s,
        at=out[worst].at,
        setting=part.setting,
    )


def overlap_text(budget: dict[str, Any]) -> str:
    """Overlap of the contributions in `budget` of diagnosis.json, in words."""
    return (
        f"combined change {plain(budget['explained'])} um; removed one at a time {plain(budget['one_out'])} um (root sum of "
        f"squares), added one at a time {plain(budget['one_in'])} um"
    )


def positions_left(run: Trace, predicted: Trace, machine: Machine) -> Trace:
    """Position residual of a prediction: (axis, 'position') [m, rad]."""
    signals = {
        (axis.name, "position"): run.get(axis.name, signal) - predicted.get(axis.name, signal)
        for axis in machine.axes
        if (signal := run.measured_position(axis.name))
    }
    return Trace(run.time, signals, machine.kinds)


def noise_of(gaps: Mapping[str, Mapping[str, Mapping[str, SignalGap]]], machine: Machine) -> dict[tuple[str, str], float]:
    """Noise [SI] of each recorded signal of each axis, without that of a prediction, RMS over the runs; `gaps` by run, axis and signal."""
    found: dict[tuple[str, str], float] = {}
    for axis in machine.axes:
        for signal in SIGNALS:
            name = axis.recorded_as(signal)
            levels = [gap.own_noise for axes in gaps.values() if (gap := axes.get(axis.name, {}).get(name)) is not None and gap.noise > 0.0]
            if levels:
                found[axis.name, signal] = float(np.sqrt(np.mean(np.square(levels)))) / gap_unit(axis, name)[1]
    return found


def _rms(squares: Sequence[float]) -> float:
    """RMS over the runs from the mean square in each; every run counts alike."""
    return float(np.sqrt(np.mean(squares))) if len(squares) else 0.0


def document_of(
    budget: Budget, machine: Machine, probability: dict[Any, float], halves: dict[Any, float], calibrated: Collection[Any] = ()
) -> dict[str, Any]:
    """The value of `budget` in diagnosis.json. `probability` and `halves` (half interval over size) by effect and axis.

    Effects in `calibrated` are of the kind "calibrated": the machine file had assumed their numbers.
    """

    def row(r: Row) -> dict[str, Any]:
        key = r.setting.key if r.setting else None
        half = min(halves.get(key, 0.0), 1.0)
        unit, to = AXIS_UNITS[machine.axis(r.axis).kind if r.axis in machine.axis_names else "linear"].error
        return {
            "effect": r.name,
            "axis": r.axis,
            "kind": "calibrated" if key in calibrated else r.kind,
            **({"from_axis": r.setting.from_axis} if r.setting and r.setting.from_axis else {}),
            "probability": probability.get(key, 1.0) if r.setting else 1.0,
            "tool_point": 1e6 * r.tool_point,
            "alone": 1e6 * r.alone,
            "position": to * r.position,
            "position_unit": unit,
            "scale": to * r.signals["position"],
            "motor": to * r.signals["motor_position"],
            "current": r.signals["current"],
            "times_noise": r.times_noise,
            "low": 1e6 * r.tool_point * (1.0 - half),
            "high": 1e6 * r.tool_point * (1.0 + half),
            "largest": 1e6 * r.largest,
            "run": r.run,
            "at_s": r.at_s,
            "at_mm": [1e3 * x for x in r.at],
        }

    return {
        "unit": UNIT,
        "before": 1e6 * budget.before,
        "after": 1e6 * budget.left,
        "floor": 1e6 * budget.floor,
        "explained": 1e6 * budget.explained,
        "one_out": 1e6 * budget.one_out,
        "one_in": 1e6 * budget.one_in,
        "rows": [row(r) for r in budget.rows],
    }
