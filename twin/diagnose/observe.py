"""Observation of one group of axes: channels, their noise, and the residual of the nominal twin.

Channels isolate single blocks of the loop where the recorded signals allow it, so that a fault is visible in its own block:

    controller         the control law: measured inputs in, measured output compared (`twin.diagnose.control_law`)
    motor_minus_scale  motor position minus scale while the set point moves: transmission and measurement
    position           scale (motor encoder if there is no scale), closed loop
    velocity           motor speed, closed loop
    current            while the set point moves: speed controller, current loop and mechanics, closed loop; the command (voltage or
                       torque) of an axis without current loop

At rest, the current of a sticking axis and the position of a rotor inside its backlash depend on history and chance.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import functools
import itertools
from typing import NamedTuple

import numpy as np

from twin.diagnose.channel import Channel, Scatter
from twin.diagnose.control_law import Characteristic, between_cycles, characteristic_of, law_error, law_model_error, law_sigma
from twin.diagnose.noise import with_noise
from twin.diagnose.settings import T
from twin.diagnose.simulations import Mapper, SimulationRequest, Variant, simulate_groups
from twin.diagnose.view import RunView
from twin.effects import Setting, settings_of
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation.gap import REALISATIONS
from twin.simulation.motor_and_scale import has_both, motor_minus_scale, with_equal_means
from twin.simulation.plant_spec import commissioned_inertia
from twin.simulation.run import Run, all_or_raise

CHANNELS = ("controller", "motor_minus_scale", "position", "velocity", "current")
"""Channels of an axis. What few effects touch comes first."""


class Variation(NamedTuple):
    """A variation of the nominal simulation: a variant of the run's machine, added effects, and the axes that change (default: all of the group).

    With `shaken` it and the nominal simulation have the same noise in the loop: an axis that creeps at rest creeps because of noise.
    """

    machine_of: Variant | None = None
    settings: Sequence[Setting] = ()
    axes: Sequence[str] = ()
    shaken: bool = False


@dataclass(frozen=True)
class Group:
    """Coupled axes, their channels in all runs, and the nominal simulation of these channels."""

    axes: tuple[str, ...]
    views: Sequence[RunView]
    channels: Sequence[Channel]
    nominal: list[dict[tuple[str, str], np.ndarray]]  # per run: (axis, channel) -> values without noise
    shaken: list[dict[tuple[str, str], np.ndarray]]  # the same with one realisation of the noise in the loop
    seed: int
    shakes: bool = False  # all responses are simulated with noise in the loop
    mapper: Mapper = field(default=map, repr=False, compare=False)  # maps over batches of simulations
    answers: dict[Hashable, np.ndarray | TwinError] = field(default_factory=dict, repr=False, compare=False)
    """Remembered responses (row,), not weighted, in single precision. Groups about the same machine share them, whatever their weights."""

    def __post_init__(self) -> None:
        placed, at = [], 0
        for channel in self.channels:
            placed.append(replace(channel, rows=slice(at, at + len(channel.residual))))
            at += len(channel.residual)
        object.__setattr__(self, "channels", tuple(placed))

    @property
    def size(self) -> int:
        """Number of rows of all channels."""
        return self.channels[-1].rows.stop if self.channels else 0

    @property
    def machine(self) -> Machine:
        """The machine file without effects."""
        return self.views[0].file

    @property
    def by_radius(self) -> bool:
        """True if these axes were only measured by the radius of circles. Then no channel isolates an axis or a block."""
        moving = [view for view in self.views if any(view.moves(a) for a in self.axes)]
        return bool(moving) and all(view.ballbar is not None for view in moving)

    @functools.cached_property
    def on_own_path(self) -> frozenset[str]:
        """Axes whose set point is their own recorded motion wherever they move: nothing shows their controllers, and the motion gives the force alone."""
        moving = {a: [view for view in self.views if view.trace.moves(a)] for a in self.axes}
        return frozenset(a for a, views in moving.items() if views and all(a in view.on_own_path for view in views))

    @property
    def seen_axes(self) -> tuple[str, ...]:
        """Axes with a channel."""
        return tuple(a for a in self.axes if any(c.axis == a for c in self.channels))

    def has(self, axis: str, channel: str | None) -> bool:
        """Has an axis this channel in any run?"""
        return any((c.axis, c.name) == (axis, channel) for c in self.channels)

    @functools.cached_property
    def weights(self) -> np.ndarray:
        """Weight of each row (row,)."""
        return np.concatenate([c.weight for c in self.channels] or [np.zeros(0)])

    @functools.cached_property
    def residual(self) -> np.ndarray:
        """Residual of all channels (row,), weighted."""
        return np.concatenate([c.residual for c in self.channels] or [np.zeros(0)]) * self.weights

    @functools.cached_property
    def expected(self) -> np.ndarray:
        """Expected square of each weighted row (row,) from noise and model error of effects."""
        return np.concatenate([c.expected for c in self.channels] or [np.zeros(0)])

    def responses(self, variations: Sequence[Variation], keys: Sequence[Hashable | None] = ()) -> list[np.ndarray | TwinError]:
        """Response (row,), weighted, to each variation: its simulation minus the nominal one, or the error of the simulation.

        `keys` name variations whose response is remembered for the next call (None: not remembered).
        """
        variations = [v._replace(shaken=v.shaken or self.shakes) for v in variations]
        keys = [None if key is None else (key, v.shaken) for key, v in zip(keys or [None] * len(variations), variations)]
        known = [None if key is None else self.answers.get(key) for key in keys]
        new = iter(self._simulated([v for v, answer in zip(variations, known) if answer is None]))
        out: list[np.ndarray | TwinError] = []
        for key, answer in zip(keys, known):
            rows = next(new) if answer is None else answer
            if key is not None:
                self.answers[key] = rows
            if isinstance(rows, np.ndarray):
                rows = rows if key is None else rows.copy()
                rows *= self.weights  # in place: a response is as long as all channels
            out.append(rows)
        return out

    def _simulated(self, variations: Sequence[Variation]) -> list[np.ndarray | TwinError]:
        """Response (row,) to each variation, not weighted, in single precision: a difference needs no more digits."""
        requests: list[SimulationRequest] = []
        # variation, run, whether it is shaken, what its controllers have beyond the machine file
        of_request: list[tuple[int, int, bool, Mapping[str, Characteristic]]] = []
        machine_of_runs = self.views[0].machine
        out: list[np.ndarray | TwinError] = []
        for v, (machine_of, settings, axes, shaken) in enumerate(variations):
            if not axes or any(view.ballbar is not None for view in self.views):  # a radius depends on all of its axes
                axes = self.axes
            try:
                effects = (*settings_of(machine_of_runs if machine_of is None else machine_of(machine_of_runs)), *settings)
                added = {a: values_of for a in axes if (values_of := characteristic_of(effects, machine_of_runs.axis(a))) is not None}
            except TwinError as error:
                out.append(error)
                continue
            out.append(np.zeros(self.size, np.float32))
            for run in sorted({channel.run for channel in self.channels if channel.axis in axes}):
                moving = tuple(a for a in axes if self.views[run].moves(a))
                requests.append(
                    SimulationRequest(self.views[run], moving, machine_of, settings, noise_seed(self.seed, run) if shaken else None)
                )
                of_request.append((v, run, shaken, added))

        def changes(i: int, simulation: Run) -> dict[tuple[str, str], np.ndarray]:
            view, moving, (_, run, shaken, added) = requests[i].view, requests[i].axes, of_request[i]
            values_of = channels_of(simulation.without_noise, view, moving, added)
            of_nominal = dict((self.shaken if shaken else self.nominal)[run])
            # the control law is compared at the inputs that the controller read, with noise and rounding; the nominal controller follows its law there
            for key in [(a, "controller") for a in moving if shaken and (a, "controller") in values_of]:
                seen = law_error(simulation.trace, view, view.machine.axis(key[0]), added.get(key[0]))
                assert seen is not None
                values_of[key], of_nominal[key] = seen, np.zeros(len(seen))
            return {key: (values - of_nominal[key]).astype(np.float32) for key, values in values_of.items() if key in of_nominal}

        for request, (v, run, _, _), changed in zip(requests, of_request, simulate_groups(requests, self.mapper, changes)):
            rows = out[v]
            if isinstance(changed, TwinError):
                out[v] = changed
            elif isinstance(rows, np.ndarray):
                for channel in self.channels:
                    if channel.run == run and channel.axis in request.axes:
                        rows[channel.rows] = changed[channel.axis, channel.name]
        return out

    def with_model_error(self, change: np.ndarray, residual: np.ndarray) -> Group:
        """The group with the model error of effects whose response is `change` (row,) added to the noise, and more where `residual` (row,) exceeds
        noise; both weighted.
        """
        plain, remaining = change / self.weights, residual / self.weights
        channels = [c.with_model_error(plain[c.rows], remaining[c.rows], self.views[c.run].trace.period) for c in self.channels]
        return replace(self, channels=channels)

    def searched(self) -> Group:
        """The group without what only a search uses again: remembered responses, and the realisations of the noise."""
        self.answers.clear()
        return replace(self, channels=[replace(c, scatter=None) for c in self.channels])

    @functools.cached_property
    def expected_loss(self) -> float:
        """Half the expected squares from noise and model error of effects."""
        return 0.5 * float(self.expected.sum())

    @functools.cached_property
    def credit(self) -> np.ndarray:
        """Weight of each row as evidence (row,)."""
        return self.credit_after_rests(0.0)

    def credit_after_rests(self, shortest_s: float) -> np.ndarray:
        """Weight of each row as evidence (row,), reduced at and after rests of at least `shortest_s`.

        How an axis stuck is a single random event that repeats in many samples.
        """
        out = np.ones(self.size)
        for channel in self.channels:
            out[channel.rows][~channel.settled(self.views[channel.run], shortest_s)] = T.unsettled_weight
        return out

    def confidence(self, axis: str) -> float:
        """Largest probability of an effect or a law on an axis. If a single run moves the axis, no other run can confirm it."""
        return T.confidence if sum(view.moves(axis) for view in self.views) > 1 else T.confidence_in_one_run

    def part(self, axes: Collection[str], runs: Collection[int]) -> tuple[Group, np.ndarray]:
        """The channels of these axes and runs as a group, and their rows (row,) in this one. Its responses are not to be remembered: they have other rows."""
        channels = [c for c in self.channels if c.axis in axes and c.run in runs]
        return replace(self, channels=channels), np.concatenate([np.arange(0), *(np.arange(c.rows.start, c.rows.stop) for c in channels)])


def noise_seed(seed: int, run: int, realisation: int = 0) -> int:
    """Seed of the noise of one realisation of a run."""
    return seed + 1000 * run + realisation


def channels_of(
    trace: Trace, view: RunView, axes: Sequence[str], added: Mapping[str, Characteristic] | None = None
) -> dict[tuple[str, str], np.ndarray]:
    """Channels of a trace, measured or simulated: (axis, channel) -> (sample,). `added` is that of `law_error`, by axis."""
    out = {}
    trace = with_equal_means(trace, view.machine, view.own_zeros.intersection(axes))
    for name in axes:
        axis = view.machine.axis(name)
        measured = view.trace
        moving = view.reference(name)[2]
        error = None if name in view.pushed else law_error(trace, view, axis, (added or {}).get(name))
        if error is not None:
            out[name, "controller"] = error
        if has_both(measured, name) and moving.sum() > T.enough_samples:
            apart = motor_minus_scale(trace, name)[moving]
            out[name, "motor_minus_scale"] = apart - apart.mean() if name in view.own_zeros else apart
        if name in view.pushed:
            continue  # at rest the other signals depend on how the axis stuck
        with_controller = name not in view.on_own_path  # against its own recorded motion only the assumed controller would err
        if with_controller and view.ballbar is not None and name in view.ballbar.axes:
            out[name, "position"] = view.ballbar.seen(trace, name)
        elif with_controller and (signal := measured.measured_position(name)):
            out[name, "position"] = trace.get(name, signal)
        if with_controller and measured.has(name, "velocity"):
            out[name, "velocity"] = trace.get(name, "velocity")
        if measured.has(name, axis.effort) and moving.sum() > T.enough_samples:
            out[name, "current"] = trace.get(name, axis.effort)[moving]
    return out


def observe(views: Sequence[RunView], axes: tuple[str, ...], seed: int = 0, mapper: Mapper = map) -> Group:
    """Residuals of the nominal twin and their noise, for one group of axes in all runs; `mapper` maps over batches of simulations."""
    channels: list[Channel] = []
    nominal: list[dict[tuple[str, str], np.ndarray]] = [{} for _ in views]
    shaken: list[dict[tuple[str, str], np.ndarray]] = [{} for _ in views]
    moving = {r: tuple(a for a in axes if view.moves(a)) for r, view in enumerate(views)}
    requests = [
        SimulationRequest(view, moving[r], noise_seed=drawn)
        for r, view in enumerate(views)
        if moving[r]
        for drawn in (None, *(noise_seed(seed, r, k) for k in range(REALISATIONS)))
    ]

    def both(i: int, run: Run) -> list[dict[tuple[str, str], np.ndarray]]:
        """Channels with and without noise, as copies: a channel may be a column of the record of a whole batch."""
        view, present = requests[i].view, requests[i].axes
        return [
            {key: np.array(values) for key, values in channels_of(trace, view, present).items()} for trace in (run.trace, run.without_noise)
        ]

    answers = iter(all_or_raise(simulate_groups(requests, mapper, both)))
    for r, view in enumerate(views):
        present = moving[r]
        if not present:
            continue
        nominal[r], _ = next(answers)
        seen, clean = zip(*itertools.islice(answers, REALISATIONS))
        shaken[r] = clean[0]
        for key, values in channels_of(view.trace, view, present).items():
            if key[1] == "controller":  # the error of the law itself: its inputs are recorded
                axis = view.machine.axis(key[0])
                sigma = np.full(len(values), law_sigma(view, axis))
                channels.append(Channel(r, *key, values, sigma, 1.0, model=law_model_error(view, axis)))
                continue
            expected = np.mean([c[key] for c in clean], axis=0)
            scatter = Scatter(np.array([s[key] for s in seen]) - expected, np.var([c[key] for c in clean], axis=0, ddof=1))
            channel = Channel(r, *key, values - expected, np.ones(len(values)), 1.0, model=_model_error(view, *key))
            channels.append(with_noise(channel, scatter, channel.residual, view))
    channels.sort(key=lambda c: (axes.index(c.axis), CHANNELS.index(c.name)))  # so that the rows that an effect changes are neighbours
    return Group(axes, views, channels, nominal, shaken, seed, mapper=mapper)


def _model_error(view: RunView, name: str, channel: str) -> np.ndarray | float:
    """Model error of a healthy twin in a closed-loop channel (sample,), due to the unknown interpolation between the cycles of the control.

    A set-point error d moves the position by d at the bandwidth Kv of the loop, the speed by Kv d, the acceleration by Kv^2 d.
    """
    axis = view.machine.axis(name)
    off = between_cycles(view, axis)
    if channel == "motor_minus_scale" or not off.any():
        return 0.0
    gain = axis.loops.position_gain_per_s
    if channel == "current":
        inertia = commissioned_inertia(view.machine)[view.machine.axis_names.index(name)]
        moving = view.reference(name)[2]
        return np.asarray(gain**2 * off[moving] * inertia / (axis.ratio * axis.motor.torque_constant_nm_per_a))
    return off[view.rows_of(name, channel)] if channel == "position" else gain * off
