"""A recording projected onto every way that its machine can change.

Residual r (recording minus the reference twin) and responses J (row, direction) to the unit effects, both weighted by noise, enter as

    G = J' P J,   b = J' P r                 P removes the zeros of the encoders

which is all that later questions need. A change theta of the machine moves b by G theta, whatever the twin lacks: its own fault moves b by the same
amount in each recording of the same program and cancels in a difference. J, P and the twin follow from the set points alone, and the noise is that of
the first recording of the program: a fault that makes a recording rough weighs nothing down. The noise of b has the covariance G.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
import functools
from typing import Self

import numpy as np

from twin.diagnose.axis_groups import axis_groups
from twin.diagnose.channel import Channel
from twin.diagnose.observe import Group, Variation, channels_of, observe
from twin.diagnose.plausible import CONTROL_BLOCKS
from twin.diagnose.simulations import Mapper, simulate_group
from twin.diagnose.tuning import FREE, zeros_of
from twin.diagnose.view import RunView, view_of
from twin.effects import with_effects
from twin.errors import TwinError
from twin.history.columns import Direction, changed, directions_of
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.gap import COMPARED
from twin.simulation.recorded_noise import with_recorded_noise

ANSWERS = (
    *COMPARED,
    "velocity_setpoint",
    "drive_velocity_setpoint",
    "current_setpoint",
    "torque_setpoint",
    "acceleration",
    "load_position",
)
"""Signals of the machine's answer; all others are its inputs."""

TOGETHER = 32
"""Directions that are simulated together: more need more memory and are no faster."""

Noise = Mapping[str, float]
"""RMS noise of each channel of a run, by 'axis channel' [SI]."""


@dataclass(frozen=True)
class Projection:
    """G and b of one group of axes in one run."""

    gram: np.ndarray  # (direction, direction)
    right: np.ndarray  # (direction,)

    def __add__(self, other: Self) -> Self:
        return replace(self, gram=self.gram + other.gram, right=self.right + other.right)


def reference_view(machine: Machine, run: MeasuredRun) -> RunView:
    """A run on the reference machine with the effects that it has."""
    return replace(view_of(machine, run), machine=machine.with_feedforward(run.feedforward))


@dataclass(frozen=True)
class Linearised:
    """The twin of a group of axes about the set points of a run, its responses, and the noise of its channels."""

    group: Group
    directions: Sequence[Direction]
    gram: np.ndarray  # G (direction, direction)
    onto: np.ndarray  # (row, direction): b of rows that are not weighted
    noise: Noise

    @property
    def view(self) -> RunView:
        return self.group.views[0]

    @property
    def _moving(self) -> list[str]:
        return [a for a in self.group.axes if self.view.moves(a)]

    def fits(self, run: MeasuredRun) -> bool:
        """Does a run have the same inputs and channels, so that all but its answers is known?"""
        trace, own, view = run.trace, self.view.trace, replace(self.view, trace=run.trace)
        return (
            (run.feedforward, run.started_at, run.own_zeros) == (view.feedforward, view.started_at, view.own_zeros)
            and run.ballbar is view.ballbar is None
            and trace.signals.keys() == own.signals.keys()
            and len(trace.time) == len(own.time)
            and np.allclose(np.diff(trace.time), np.diff(own.time), rtol=0.0, atol=1e-9)
            and all(np.array_equal(v, own.signals[key]) for key, v in trace.signals.items() if key[1] not in ANSWERS)
            and view.pushed == self.view.pushed
        )

    @functools.cached_property
    def grams(self) -> dict[str, np.ndarray]:
        """G of each channel (direction, direction), by 'axis channel'."""
        weight = np.sqrt(self.group.credit) * self.group.weights
        scale = np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0.0)[:, None]
        parts = {_key(c): _parts(self.onto[c.rows] * scale[c.rows]) for c in self.group.channels}
        return {key: sum((p.T.astype(float) @ p for p in own), np.zeros(self.gram.shape)) for key, own in parts.items()}

    def rights(self, trace: Trace, view: RunView | None = None) -> dict[str, np.ndarray]:
        """b of each channel (direction,) of a recording with these inputs, or of a trace with the inputs of a view."""
        view = view or replace(self.view, trace=trace)
        values, nominal = channels_of(trace, view, self._moving), self.group.nominal[0]
        return {_key(c): _times(values[c.axis, c.name] - nominal[c.axis, c.name], self.onto[c.rows]) for c in self.group.channels}

    def right(self, trace: Trace) -> np.ndarray:
        """b of a recording with these inputs (direction,)."""
        return np.asarray(sum(self.rights(trace).values()))

    def rights_of(self, changes: Sequence[tuple[Direction, float]]) -> dict[str, np.ndarray] | None:
        """b of each channel of simulated changes of size (direction,), each controller at its own position as in a recording; None if they cannot be simulated."""
        try:
            answer = simulate_group(self.view, self._moving, functools.partial(changed, changes=changes))
        except TwinError:
            return None
        return self.rights(answer.without_noise, self.view)


class Reference:
    """Projects the runs of a machine, whose sensors have the noise of the runs `first`; a run with the inputs of the one before it needs no simulation."""

    def __init__(self, machine: Machine, mapper: Mapper, first: Callable[[], Sequence[MeasuredRun]]) -> None:
        self.file, self.mapper, self._first = machine, mapper, first
        self.directions = functools.cache(lambda axes: directions_of(machine, axes))
        self._known: dict[tuple[int, tuple[str, ...]], Linearised] = {}

    @functools.cached_property
    def machine(self) -> Machine:
        """The machine with the noise of the first runs."""
        return with_recorded_noise(self.file, self._first())[0]

    def groups_of(self, runs: Sequence[MeasuredRun]) -> list[tuple[str, ...]]:
        """Coupled axes with a motion in these runs."""
        moving = sorted({axis for run in runs for axis in run.trace.axes if run.trace.moves(axis)})
        return axis_groups(with_effects(self.file, []), moving)

    def linearised(
        self, runs: Sequence[MeasuredRun], axes: tuple[str, ...], noise: Sequence[Noise] = ()
    ) -> Iterator[tuple[MeasuredRun, Linearised]]:
        """Each run that recorded some of these axes, with `noise` of its channels instead of its own."""
        for i, run in enumerate(runs):
            known = self._known.get((i, axes))
            if known is None or not known.fits(run):
                known = self._about(run, axes, noise[i] if i < len(noise) else {})
            if known is not None:
                self._known[i, axes] = known
                yield run, known

    def forget(self) -> None:
        """Release the memory of what is linearised."""
        self._known.clear()

    def _about(self, run: MeasuredRun, axes: tuple[str, ...], noise: Noise) -> Linearised | None:
        """A run linearised; None if it shows nothing of these axes."""
        inputs = {key: values for key, values in run.trace.signals.items() if key[1] not in ANSWERS}
        view = replace(reference_view(self.machine, replace(run, trace=replace(run.trace, signals=inputs))), trace=run.trace)
        moving = [a for a in axes if view.moves(a)]
        if not moving:
            return None
        answers = simulate_group(view, moving).trace.signals
        signals = {
            key: v if key in inputs or key[0] in view.pushed | view.on_own_path else answers.get(key, v)
            for key, v in run.trace.signals.items()
        }
        group = observe([replace(view, trace=replace(run.trace, signals=signals))], axes)  # the same for all recordings with these inputs
        if not group.size:
            return None
        noise = noise or {_key(c): _rms(c.sigma) for c in observe([view], axes).channels}
        channels = [replace(c, sigma=c.sigma * (noise.get(_key(c), own) / own)) for c in group.channels for own in [_rms(c.sigma)]]
        group = replace(group, channels=channels, mapper=self.mapper)
        directions = self.directions(axes)
        onto = np.zeros((group.size, len(directions)), np.float32)
        for first in range(0, len(directions), TOGETHER):
            several = [Variation(functools.partial(changed, changes=[(d, 1.0)])) for d in directions[first : first + TOGETHER]]
            for k, answer in enumerate(group.responses(several), first):
                one = directions[k].setting
                hidden = one.axis in view.on_own_path and one.effect.block in CONTROL_BLOCKS  # nothing shows its controllers
                if isinstance(answer, np.ndarray) and not hidden:  # else zero, as where it cannot be simulated
                    onto[:, k] = answer
        return Linearised(group, directions, _projected(onto, group), onto, noise)


def _projected(columns: np.ndarray, group: Group) -> np.ndarray:
    """G of weighted columns (row, direction), which become the projector of rows that are not weighted. Rows that depend on how an axis stuck hardly
    count.
    """
    weight = np.sqrt(group.credit)[:, None]
    columns *= weight
    zeros = zeros_of(group).part() * weight
    parts = list(zip(_parts(columns), _parts(zeros), _parts(weight * group.weights[:, None])))
    gram, cross = sum(c.T.astype(float) @ c for c, _, _ in parts), sum(z.T @ c for c, z, _ in parts)
    left = np.linalg.solve(zeros.T @ zeros + FREE * np.eye(zeros.shape[1]), cross)
    for c, z, w in parts:
        c -= z @ left
        c *= w
    stored = np.asarray(gram - cross.T @ left, np.float32)  # so a history is judged the same when it is read again
    return stored.astype(float)


def _times(rows: np.ndarray, onto: np.ndarray) -> np.ndarray:
    return np.asarray(sum(r @ o for r, o in zip(_parts(rows), _parts(onto))))


def _parts(rows: np.ndarray) -> list[np.ndarray]:
    """Views of rows, in parts that are small in double precision."""
    return np.array_split(rows, 64)


def _key(channel: Channel) -> str:
    return f"{channel.axis} {channel.name}"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
